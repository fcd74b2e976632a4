# Copyright 2026 The obb_collision developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Boxes about placed meshes: those of the first nodes of their trees, rounded outwards."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.trees.node_fit import HALF
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.queries.meshes.meshes import PlacedMeshes
from obb_collision.queries.meshes.tree_boxes import BOX_BOUND


def root_boxes(bodies: PlacedMeshes) -> Boxes:
    """Return boxes (n,) that certainly contain placed meshes.

    Larger by ``BOX_BOUND`` of the reach of a mesh and of its centre: more than the products of
    poses are off by, and than axes do that are orthonormal to 80 u.
    """
    trees, meshes = bodies.trees, bodies.meshes
    nodes = trees.nodes[trees.roots[meshes]]
    axes = nodes[:, 3:HALF].reshape(-1, 3, 3)
    centers = bodies.centers + np.einsum("nij,nj->ni", bodies.rotations, nodes[:, :3])
    sizes = np.abs(bodies.centers).sum(axis=1) + trees.radii[meshes]
    half_extents = nodes[:, HALF : HALF + 3] + (BOX_BOUND * sizes + MESH_UNDERFLOW)[:, None]
    return Boxes.trusted(centers, bodies.rotations @ axes, half_extents)
