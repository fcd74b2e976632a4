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

"""What a level needs besides the time of its pairs: preparation, once per shape, and memory."""

from __future__ import annotations

from dataclasses import dataclass
from time import thread_time

import numpy as np

from obb_collision.benchmarks.price.levels import Level
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.fitting.fit import fit_points
from obb_collision.geometry.representations import to_compact
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees, TreeArrays
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.geometry.trees.shape_trees import mesh_tree

#: Arrays with a row per node of a tree: its numbers, children, triangles and level.
NODE_ARRAYS = ("nodes", "children", "starts", "levels")


@dataclass(frozen=True)
class Prepared:
    """What is made of a mesh once: its trees, and the milliseconds each took."""

    mesh: MeshTrees
    hull: Hulls
    box_ms: float
    mesh_ms: float
    hull_ms: float


def prepare(mesh: Mesh) -> Prepared:
    """Fit the box and build the trees of a mesh, timed."""
    start = thread_time()
    fit_points(mesh._points())
    box_ms = 1e3 * (thread_time() - start)
    _ = mesh.local_box  # the same again, kept: trees begin with it
    start = thread_time()
    triangles = mesh_tree(mesh)
    built = thread_time()
    hull = Hulls.of(hull_mesh(mesh)[0])
    mesh_ms, hull_ms = 1e3 * np.diff([start, built, thread_time()])
    return Prepared(triangles, hull, box_ms, float(mesh_ms), float(hull_ms))


def prepare_ms(level: Level, prepared: list[Prepared]) -> float:
    """Return the mean milliseconds that a level needs once for a shape; boxes need none."""
    if not prepared:
        return 0.0
    extra = {"obb_tree": "mesh_ms", "mesh": "mesh_ms", "hull": "hull_ms"}.get(level.accuracy)
    return float(np.mean([p.box_ms + (getattr(p, extra) if extra else 0.0) for p in prepared]))


def memory(level: Level, boxes: Boxes, prepared: list[Prepared]) -> float:
    """Return the bytes that a level reads of one object, float64, the mean over the shapes.

    A tree, hull or mesh is stored once for all objects of one shape.
    """
    count = len(boxes)
    if level.accuracy == "sphere":
        return (boxes.centers.nbytes + boxes.half_extents[:, 0].nbytes) / count
    if level.accuracy == "aabb":
        return sum(bound.nbytes for bound in boxes.world_bounds()) / count
    if level.accuracy in ("obb_faces", "obb"):
        return (boxes.centers.nbytes + boxes.rotations.nbytes + boxes.half_extents.nbytes) / count
    if level.accuracy == "obb_tree":
        assert level.depth is not None
        return float(np.mean([tree_bytes(p.mesh.arrays, level.depth) for p in prepared]))
    stored = [p.hull if level.accuracy == "hull" else p.mesh.arrays for p in prepared]
    return float(np.mean([sum(array.nbytes for array in arrays) for arrays in stored]))


def tree_bytes(tree: TreeArrays, depth: int) -> int:
    """Return the bytes of the nodes of a tree down to a depth."""
    nodes = int((tree.levels <= depth).sum())
    return nodes * sum(getattr(tree, name)[0].nbytes for name in NODE_ARRAYS)


def compact_numbers() -> int:
    """Return the numbers of a box whose third axis is left to be computed."""
    return to_compact(Boxes(np.zeros((1, 3)), np.eye(3)[None], np.ones((1, 3)))).size
