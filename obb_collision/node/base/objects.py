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


"""Objects of the scene about a base: boxes, and the points of clouds, in the frame of the base."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from typing import Any

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import as_poses, compose_poses, inverse_poses
from obb_collision.geometry.trees.convex_proxy import outer_points
from obb_collision.node.base.observations import placed
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.scene.building.shape_cache import BOX, CLOUD
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.patterns import matching
from obb_collision.shapes import Hull, Mesh
from obb_collision.typing import Floats, Mask, Rows
from obb_collision.zones import gate

SIGNS = np.array([corner[::-1] for corner in product((-1.0, 1.0), repeat=3)])
"""Of the corners (8, 3) of a box, as ``box_outlines`` takes them."""


MOST_POINTS = 2000
"""Of a mesh whose hull is asked for: that of a larger one counts by its box."""


class SceneObjects:
    """Finds the objects of a scene that count, near a base, by parameters that are live."""

    def __init__(self, scene: Scene, parameters: Parameters) -> None:
        self._scene, self._parameters = scene, parameters
        self._key: tuple[object, ...] = ()
        self._counted: Mask = np.empty(0, np.bool_)
        """Which slots of the scene count, for this version of it and these parameters."""

    @property
    def is_empty(self) -> bool:
        """Whether no object counts."""
        return not self._parameters.zone_objects or len(self._scene) == 0

    def about(
        self, points: Mapping[str, Floats], base_pose: Callable[[], Floats], reach: float
    ) -> gate.Surroundings:
        """Return what is within a reach (m) of the base; base_pose: (7,) in the frame of the scene.

        points: of observation sources, in the frame of the base.
        """
        if self.is_empty:
            return gate.Surroundings(points)
        store, pose = self._scene.objects.store, base_pose()
        chosen, own = self._parameters.zone_objects, self._parameters.own_objects
        if self._key != (store.version, chosen, own):
            self._key = store.version, chosen, own
            self._counted = matching(chosen, store.names) & ~matching(own, store.names)
        slots = np.flatnonzero(store.used & store.enabled & self._counted)
        offsets, halves = store.centers[slots] - pose[:3], store.half_extents[slots]
        distances = np.sqrt((offsets**2).sum(axis=1)) - np.sqrt((halves**2).sum(axis=1))
        slots = slots[distances <= reach]
        clouds: dict[str, gate.Cloud] = {}
        is_cloud = store.kinds[slots] == CLOUD
        for slot in slots[is_cloud].tolist():
            shape: Any = self._scene.objects.cache.shape(slot)
            own = compose_poses(inverse_poses(pose[None]), store.poses[slot : slot + 1])[0]
            clouds[str(store.names[slot])] = gate.Cloud(placed(own, shape.points), shape.radius)
        slots, hulls = self._hulls(slots[~is_cloud], pose)
        boxes = slots[: len(slots) - len(hulls)]
        axes = store.rotations[boxes] * store.half_extents[boxes][:, None, :]
        corners = np.einsum("nij,kj->nki", axes, SIGNS) + store.centers[boxes][:, None]
        names = [str(store.names[slot]) for slot in slots.tolist()]
        return gate.Surroundings(points, clouds, names, seen_from(pose, corners), hulls)

    def _hulls(self, slots: Rows, pose: Floats) -> tuple[Rows, list[Floats]]:
        """Return the slots, those of hulls last, and their points (k, 3) in the frame of a pose.

        Hulls stand for what is on a level above "obb" and has no padding.
        """
        store, hulls = self._scene.objects.store, list[Floats]()
        is_fine = (store.accuracies[slots] >= Accuracy.HULL) & (store.kinds[slots] > BOX)
        is_fine &= store.paddings[slots] == 0.0
        for row in np.flatnonzero(is_fine).tolist():
            points = hull_points(self._scene.objects.cache.shape(int(slots[row])))
            if points is None:
                is_fine[row] = False
            else:
                hulls.append(seen_from(pose, placed(store.poses[slots[row]], points)))
        return np.concatenate([slots[~is_fine], slots[is_fine]]), hulls


def seen_from(pose: Floats, points: Floats) -> Floats:
    """Return points (..., 3) in the frame of a pose (7,)."""
    (position,), (rotation,) = as_poses(pose[None], warn=False)
    return np.einsum("...i,ij->...j", points - position, rotation)


def hull_points(shape: Any) -> Floats | None:
    """Return points (k, 3) whose hull contains a shape, None where they are too many."""
    if isinstance(shape, (Hull, Mesh)):
        points: Floats = shape.vertices if isinstance(shape, Mesh) else shape.points
        return points * np.array(shape.scale) if len(points) <= MOST_POINTS else None
    return outer_points(shape)
