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

"""The effect ``points``: how many points of each cloud lie inside which objects of a scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

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
    join_rows,
)
from obb_collision.scene.refinement.budget import Levels
from obb_collision.scene.refinement.placed_shapes import PlacedShapes
from obb_collision.typing import Floats, Integers, Rows


@dataclass
class _PointRows:
    """The columns of ``PointsInside`` that have a row per pair of cloud and object."""

    indices: Rows
    counts: Integers
    first: Integers
    nearest: Integers
    distances: Floats
    clouds: Integers
    positions: Floats


class _Question(NamedTuple):
    """A cloud, and the objects in which its points are counted."""

    cloud: int  #: index of its object, -1 - k for cloud k of ``Scene.watched``
    points: NDArray[Any]  #: (p, 3) metres, in the frame of the scene
    ignored: int  #: points that were left out before
    reach: float  #: metres from an object within which points count
    slots: Rows  #: (n,)

    def blank(self) -> _PointRows:
        """Return rows (n,) without points inside."""
        count = len(self.slots)
        none, zero = np.full(count, -1), np.zeros(count, np.int64)
        far, places = np.full(count, np.inf), np.full((count, 3), np.nan)
        return _PointRows(
            self.slots, zero, none, none.copy(), far, np.full(count, self.cloud), places
        )


Shapes: TypeAlias = "ConvexBodies | PlacedMeshes"
NO_ROWS = _Question(0, np.empty((0, 3)), 0, 0.0, np.empty(0, np.int64)).blank()


class PointsEffect(Effect):
    """The ``PointsInside`` of clouds in objects, or within ``margin`` of them.

    Each row is a pair: a cloud and another object, if their pair counts, or watched points and an
    object. A point of a cloud with a radius counts where its ball reaches into the object. Above
    OBB an object is its shape, else its box.
    """

    name = "points"
    description = "Points of clouds in objects"
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
        """Count the points of each cloud in all its objects at once."""
        tables, levels, failures = [NO_ROWS], [np.empty(0, np.int8)], list[str]()
        ignored = count = 0
        for question in (*_watched(cycle, setting), *_clouds(cycle, setting)):
            table, own, left_out, failed = _answer(cycle, setting, question)
            tables.append(table)
            levels.append(own)
            failures += failed
            ignored += left_out
            count += len(question.points) if len(question.slots) else 0
        result = PointsInside(**vars(join_rows(tables)), ignored=ignored)
        high = np.concatenate(levels)
        some_high = bool((high > OBB).any())
        return Outcome(result, count, tuple(failures), accuracies=high if some_high else None)


def _watched(cycle: Cycle, setting: Setting) -> Iterator[_Question]:
    """Yield the points that are watched, with all selected objects."""
    selected = setting.selected
    chosen = cycle.active if selected is None else cycle.active & selected
    slots = cycle.own(np.flatnonzero(chosen))
    if cycle.shapes is not None:
        slots = slots[cycle.shapes.kinds[slots] != CLOUD]
    for number, points in enumerate(cycle.watched.values()):
        yield _Question(-1 - number, points, 0, setting.values["margin"], slots)


def _clouds(cycle: Cycle, setting: Setting) -> Iterator[_Question]:
    """Yield the clouds among the objects, with the others of their pairs that count."""
    margin, active = setting.values["margin"], np.flatnonzero(cycle.active)
    if cycle.shapes is None or not (clouds := cycle.shapes.kinds[active] == CLOUD).any():
        return
    sides = np.meshgrid(np.flatnonzero(clouds), np.flatnonzero(~clouds), indexing="ij")
    low = cycle.boxes[active].world_bounds()[0] - np.nextafter(0.5 * margin, np.inf)
    pairs = cycle.counted(active, low, np.stack(sides, axis=2).reshape(-1, 2))
    pairs = pairs[setting.select(pairs)]
    for slot in np.unique(pairs[:, 0]).tolist():
        points, ignored, radius = cycle.shapes.points(slot)
        yield _Question(slot, points, ignored, margin + radius, pairs[pairs[:, 0] == slot, 1])


def _answer(
    cycle: Cycle, setting: Setting, question: _Question
) -> tuple[_PointRows, Levels, int, list[str]]:
    """Return rows, the level of each, how many points are ignored, and failures."""
    ignored, points = [question.ignored], question.points
    levels = np.full(len(cycle.active), OBB)
    if len(points) == 0 or len(question.slots) == 0:
        return question.blank(), levels[question.slots], question.ignored, []
    if cycle.shapes is not None:
        choice = setting.values[ACCURACY]
        levels[question.slots] = cycle.shapes.object_levels(question.slots, choice)

    def compute(objects: Rows) -> _PointRows:
        table = question._replace(slots=objects).blank()
        for rows in _by_level(cycle, levels, objects):
            level = levels[objects[rows[0]]]
            boxes = cycle.boxes[objects[rows]]
            bodies: Shapes | None = None
            radii: Floats | None = None
            if level > OBB and cycle.shapes is not None:
                bodies, radii = BY_LEVEL[level](cycle.boxes, cycle.shapes, objects[rows])
            inside = points_in_bodies(boxes, bodies, points, question.reach, radii)
            ignored[0] = question.ignored + inside.ignored
            for name in ("counts", "first", "nearest", "distances"):
                vars(table)[name][rows] = vars(inside)[name]
        held = np.flatnonzero(table.counts)
        table.positions[held] = points[table.nearest[held]]
        return table

    _, table, failures = isolated(compute, question.slots, NO_ROWS, cycle.name)
    return table, levels[table.indices], ignored[0], list(failures)


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
