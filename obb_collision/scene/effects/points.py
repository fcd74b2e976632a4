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

"""The effect ``points``: which obstacle points lie inside which objects of a scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.convex.support import ConvexBodies
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.points.points import PointsInside, points_in_bodies
from obb_collision.scene.building.shape_cache import CLOUD
from obb_collision.scene.effects.base import (
    ACCURACY,
    ACCURACY_OPTION,
    OBB,
    Cycle,
    Effect,
    Option,
    Outcome,
    Setting,
    isolated,
)
from obb_collision.scene.refinement.budget import Levels
from obb_collision.scene.refinement.placed_shapes import PlacedShapes
from obb_collision.typing import Floats, Integers, Rows


@dataclass
class _PointRows:
    """The columns of ``PointsInside`` that have a row per object."""

    indices: Rows
    counts: Integers
    first: Integers
    nearest: Integers
    distances: Floats


Shapes: TypeAlias = "ConvexBodies | PlacedMeshes"
NONE = np.empty(0, np.int64)
BLANK = _PointRows(NONE, NONE, NONE, NONE, np.empty(0))


class PointsEffect(Effect):
    """The ``PointsInside`` of ``Scene.obstacle_points``, in objects or within ``margin`` of them.

    Above OBB an object is its shape, else its box.
    """

    name = "points"
    description = "Obstacle points in objects"
    options: Mapping[str, Option] = {
        "margin": Option(
            0.0, 0.0, 1e6, "Points this near to an object count as inside (m).", reaches=True
        ),
        ACCURACY: ACCURACY_OPTION._replace(
            description="Geometry of objects: obb, hull, mesh, or pairs (by the accuracy of the "
            "object)."
        ),
    }

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Count the points of all selected objects at once."""
        selected = setting.selected
        slots = cycle.own(
            np.flatnonzero(cycle.active if selected is None else cycle.active & selected)
        )
        slots = slots[cycle.store.kinds[slots] != CLOUD]
        if cycle.obstacle_points is None or len(cycle.obstacle_points) == 0 or len(slots) == 0:
            return Outcome(_nothing(slots), 0)
        cloud, ignored = cycle.obstacle_points, [0]
        levels = np.full(len(cycle.active), OBB)
        if cycle.shapes is not None:
            levels[slots] = cycle.shapes.object_levels(slots, setting.values[ACCURACY])

        def compute(objects: Rows) -> _PointRows:
            counts, first, nearest = np.zeros((3, len(objects)), np.int64)
            table = _PointRows(objects, counts, first, nearest, np.zeros(len(objects)))
            for rows in _by_level(cycle, levels, objects):
                level = levels[objects[rows[0]]]
                boxes = cycle.boxes[objects[rows]]
                bodies: Shapes | None = None
                radii: Floats | None = None
                if level > OBB and cycle.shapes is not None:
                    bodies, radii = BY_LEVEL[level](cycle.boxes, cycle.shapes, objects[rows])
                margin = setting.values["margin"]
                inside = points_in_bodies(boxes, bodies, cloud, margin, radii)
                ignored[0] = inside.ignored
                for name in ("counts", "first", "nearest", "distances"):
                    vars(table)[name][rows] = vars(inside)[name]
            return table

        _, table, failures = isolated(compute, slots, BLANK, cycle.name)
        high = levels[table.indices]
        return Outcome(
            *(PointsInside(**vars(table), ignored=ignored[0]), len(cloud), failures),
            accuracies=high if (high > OBB).any() else None,
        )


def _by_level(cycle: Cycle, levels: Levels, slots: Rows) -> Iterator[Rows]:
    """Yield the rows of slots by level; lowers levels that the budget has no time for."""
    rows, done = np.flatnonzero(levels[slots] > OBB), 0
    for portion in () if cycle.shapes is None else cycle.shapes.portions(len(rows)):
        high, done = rows[portion], portion.stop
        for level in np.unique(levels[slots[high]]):
            yield high[levels[slots[high]] == level]
    levels[slots[rows[done:]]] = OBB
    rest = np.flatnonzero(levels[slots] == OBB)
    if len(rest):
        yield rest


def _nothing(slots: Rows) -> PointsInside:
    first, count = np.full(len(slots), -1), np.zeros(len(slots), np.int64)
    return PointsInside(slots, count, first, first.copy(), np.full(len(slots), np.inf), 0)


def _hulls(boxes: Boxes, shapes: PlacedShapes, slots: Rows) -> tuple[ConvexBodies, None]:
    return shapes.convex_bodies(boxes, slots), None  # padded


def _meshes(boxes: Boxes, shapes: PlacedShapes, slots: Rows) -> tuple[PlacedMeshes, Floats]:
    meshes, _ = shapes.meshes(boxes, slots)
    return meshes, shapes.paddings[slots]


BY_LEVEL: Mapping[Accuracy, Callable[[Boxes, PlacedShapes, Rows], tuple[Shapes, Floats | None]]] = {
    Accuracy.HULL: _hulls,
    Accuracy.MESH: _meshes,
}
"""Functions that return shapes for objects above OBB, and radii about these."""
EFFECT: Effect = PointsEffect()
