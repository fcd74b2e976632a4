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

"""Trees of shapes: of their triangles, or of a convex mesh about them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.shapes.primitives import Shape
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.typing import Floats, Rows


def mesh_tree(mesh: Mesh) -> MeshTrees:
    """Return the tree of a mesh's triangles, scaled; its first node has the mesh's local box.

    ValueError for a mesh without faces.
    """
    used, faces = np.unique(mesh.faces, return_inverse=True)  # unused vertices do not count
    vertices = mesh.vertices[used] * np.array(mesh.scale)
    root = mesh.local_box if len(used) else None
    return MeshTrees.of(vertices, faces.reshape(-1, 3), root=root)


def box_tree(half_extents: Floats) -> MeshTrees:
    """Return the tree of a box (3,) about the origin."""
    return MeshTrees.from_half_extents(half_extents)


@lru_cache(maxsize=256)
def segment_tree(half: float) -> MeshTrees:
    """Return the tree of a segment from -half to half along z, or of a point, as a triangle."""
    ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half], [0.0, 0.0, half]])
    return MeshTrees.of(ends, np.array([[0, 1, 2]]))


def segment_trees(halves: Floats) -> tuple[MeshTrees, Rows]:
    """Return ``segment_tree`` of half lengths (n,), each once, and the row (n,) of each."""
    each, rows = np.unique(halves, return_inverse=True)
    return MeshTrees.join([segment_tree(half) for half in each.tolist()]), rows.ravel()


def hull_tree(shape: Shape) -> MeshTrees:
    """Return the tree of a convex mesh that certainly contains a shape (see ``hull_mesh``).

    It may exceed the largest coordinate accepted for a shape.
    """
    return MeshTrees.of(*hull_mesh(shape))
