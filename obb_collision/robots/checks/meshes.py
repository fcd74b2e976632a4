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

"""Pairs of bodies that collide at "hull" decided by trees: of triangles, or of boxes over them.

As in ``scene.refinement.mesh_pairs``: only pairs with a mesh, without padding, whose model is the
mesh; other pairs of convex shapes are decided by their hulls.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import as_poses, compose_poses
from obb_collision.geometry.trees.pool import TreePool
from obb_collision.obb import OBB
from obb_collision.queries.meshes.meshes import PlacedMeshes, mesh_collisions, mesh_verdicts
from obb_collision.queries.verdict.verdict import SEPARATE
from obb_collision.robots.bodies.world import World
from obb_collision.robots.kinematics.kinematics import Tree, link_poses
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.kinds import BOX, TRIANGLES, kind_of
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats, Integers, Mask, Rows


class MeshBodies:
    """Shapes (b,) at poses (b, 7) in frames (b,), and which of them are padded."""

    def __init__(
        self, shapes: Sequence[Shape | OBB], poses: Floats, frames: Rows, padded: Mask
    ) -> None:
        self.frames, self.padded = frames, padded
        self.meshes = np.array([kind_of(shape) == TRIANGLES for shape in shapes], np.bool_)
        self.poses = poses.copy()
        self._pool, rows = TreePool(), []
        built: dict[Shape, int] = {}
        for n, shape in enumerate(shapes):
            if isinstance(shape, Box):
                rows.append(self._pool.append(self._pool.built(shape.local_box[2])))
                continue
            if isinstance(shape, OBB):
                self.poses[n] = compose_poses(poses[n], np.append(shape.center, shape.quaternion))
                rows.append(self._pool.append(self._pool.built(shape.half_extents)))
                continue
            if shape not in built:
                built[shape] = self._pool.append(self._pool.built(shape))
            rows.append(built[shape])
        self._rows = np.array(rows, np.int64)

    def placed(self, tree: Tree, states: Floats, bodies: Rows) -> PlacedMeshes:
        """Return bodies (m,), each in the state (m, joints) of its row."""
        links = link_poses(tree, np.ascontiguousarray(states))
        poses = compose_poses(
            links[np.arange(len(bodies)), self.frames[bodies]], self.poses[bodies]
        )
        return PlacedMeshes.trusted(self._pool.all, self._rows[bodies], *as_poses(poses))


def collide_as_meshes(
    own: MeshBodies, scene: Scene, world: World, tree: Tree, states: Floats, pairs: Integers,
    origin: Floats, level: Accuracy,
) -> Mask:  # fmt: skip
    """Return (m,) which pairs (m, 2) of bodies collide in the state (m, joints) of their row."""
    count, store = len(own.frames), scene._store
    i, j = pairs[:, 0], pairs[:, 1]
    outside = j >= count
    slots = world.slots[np.where(outside, j - count, 0)] if len(world.slots) else np.zeros_like(j)
    inner = np.where(outside, 0, j)
    mesh = own.meshes[i] | np.where(outside, store.kinds[slots] == TRIANGLES, own.meshes[inner])
    padded = own.padded[i] | np.where(outside, store.paddings[slots] > 0.0, own.padded[inner])
    result = np.ones(len(pairs), np.bool_)
    for rows in (np.flatnonzero(mesh & ~padded & part) for part in (outside, ~outside)):
        if len(rows) == 0:
            continue
        a = own.placed(tree, states[rows], i[rows])
        if outside[rows[0]]:
            b = _objects(scene, slots[rows], origin)
        else:
            b = own.placed(tree, states[rows], j[rows])
        result[rows] = (
            mesh_collisions(a, b, depth=scene.tree_depth)
            if level == Accuracy.OBB_TREE
            else mesh_verdicts(a, b) != SEPARATE
        )
    return result


def _objects(scene: Scene, slots: Rows, origin: Floats) -> PlacedMeshes:
    """Return objects of a scene as meshes."""
    store, cache = scene._store, scene._cache
    outside, cache.outside = cache.outside, None  # what is needed is built now
    try:
        cache.build(store, np.unique(slots), False, None)
    finally:
        cache.outside = outside
    trees, rows = cache.trees(slots)
    centers, rotations = as_poses(store.poses[slots], warn=False)
    boxes = store.kinds[slots] == BOX
    centers[boxes], rotations[boxes] = store.centers[slots[boxes]], store.rotations[slots[boxes]]
    return PlacedMeshes.trusted(trees, rows, centers - origin, rotations)
