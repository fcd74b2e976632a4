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

"""The bodies of robots as meshes, where they are in many states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from obb_collision.geometry.poses import as_poses, compose_poses
from obb_collision.geometry.trees.pool import TreePool, segment_trees
from obb_collision.obb import OBB
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.robots.kinematics.kinematics import Tree, link_poses
from obb_collision.scene.store.kinds import ROUND, TRIANGLES, kind_of, round_sizes
from obb_collision.shapes import Box, Capsule, Shape
from obb_collision.typing import Floats, Rows


class MeshBodies:
    """Shapes (b,) at poses (b, 7) in frames (b,), with paddings (b,).

    Spheres and capsules are there twice: as segments with radii, and as convex meshes around them.
    """

    def __init__(
        self, shapes: Sequence[Shape | OBB], poses: Floats, frames: Rows, paddings: Floats
    ) -> None:
        self.frames, self.paddings, self.radii = frames, paddings, paddings.copy()
        self.meshes = np.array([kind_of(shape) == TRIANGLES for shape in shapes], np.bool_)
        self.poses = poses.copy()
        self._pool = TreePool()
        self._solid = np.zeros(len(shapes), np.int64)
        built: dict[Shape, int] = {}
        for n, shape in enumerate(shapes):
            if isinstance(shape, (Box, OBB)):
                self._solid[n] = self._box(n, shape)
                continue
            if shape not in built:
                built[shape] = self._pool.append(self._pool.built(shape))
            self._solid[n] = built[shape]
        self._thin = self._solid.copy()
        for n, shape in enumerate(shapes):
            if isinstance(shape, Shape) and kind_of(shape) == ROUND:
                radius, half = round_sizes(shape)
                half = half if isinstance(shape, Capsule) else 0.0
                self._thin[n] = self._pool.append(segment_trees(np.array([half]))[0])
                self.radii[n] += radius

    def _box(self, n: int, shape: Box | OBB) -> int:
        """Add the tree of box n, which is in the middle of its pose from now on."""
        if isinstance(shape, Box):
            return self._pool.append(self._pool.built(shape.local_box[2]))
        place = np.append(shape.center, shape.quaternion)
        self.poses[n] = compose_poses(self.poses[n], place)
        return self._pool.append(self._pool.built(shape.half_extents))

    def placed(self, tree: Tree, states: Floats, bodies: Rows, thin: bool) -> PlacedMeshes:
        """Return bodies (m,), each in the state (m, joints) of its row.

        thin: whether spheres and capsules are segments.
        """
        links = link_poses(tree, np.ascontiguousarray(states))
        poses = compose_poses(
            links[np.arange(len(bodies)), self.frames[bodies]], self.poses[bodies]
        )
        rows = (self._thin if thin else self._solid)[bodies]
        return PlacedMeshes.trusted(self._pool.all, rows, *as_poses(poses))
