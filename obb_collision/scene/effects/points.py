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

"""The effect ``points``: which obstacle points lie inside which boxes of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from obb_collision.queries.points.points import PointsInside, points_inside
from obb_collision.scene.effects.base import Cycle, Effect, Option, Outcome, Setting, isolated
from obb_collision.typing import Floats, Integers, Rows


@dataclass
class _Held:
    """The columns of ``PointsInside`` with a row per object."""

    indices: Rows
    counts: Integers
    first: Integers
    nearest: Integers
    distances: Floats


NONE = np.empty(0, np.int64)
BLANK = _Held(NONE, NONE, NONE, NONE, np.empty(0))


class PointsEffect:
    """The ``PointsInside`` of ``Scene.obstacle_points``, in boxes or within ``margin`` of them.

    Nothing to do without a cloud.
    """

    name = "points"
    description = "Obstacle points in boxes"
    options: Mapping[str, Option] = {
        "margin": Option(
            0.0, 0.0, 1e6, "Points this near to a box count as inside (m).", reaches=True
        ),
    }
    lazy = True

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Count the points of all selected objects at once."""
        selected = setting.selected
        slots = cycle.own(
            np.flatnonzero(cycle.active if selected is None else cycle.active & selected)
        )
        if cycle.obstacle_points is None or len(cycle.obstacle_points) == 0 or len(slots) == 0:
            return Outcome(_nothing(slots), 0)
        cloud, ignored = cycle.obstacle_points, [0]

        def compute(some: Rows) -> _Held:
            found = points_inside(cycle.boxes[some], cloud, setting.values["margin"])
            ignored[0] = found.ignored
            return _Held(some, found.counts, found.first, found.nearest, found.distances)

        _, held, failures = isolated(compute, slots, BLANK, cycle.name)
        return Outcome(PointsInside(**vars(held), ignored=ignored[0]), len(cloud), failures)


def _nothing(slots: Rows) -> PointsInside:
    none, count = np.full(len(slots), -1), np.zeros(len(slots), np.int64)
    return PointsInside(slots, count, none, none.copy(), np.full(len(slots), np.inf), 0)


EFFECT: Effect = PointsEffect()
