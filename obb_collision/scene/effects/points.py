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

from obb_collision.queries.points.points import points_inside
from obb_collision.scene.effects.base import Cycle, Option, Outcome, Setting
from obb_collision.typing import Floats, Rows


@dataclass(frozen=True, eq=False)
class ObjectPoints:
    """What the boxes of n objects hold of the cloud ``Scene.points``.

    indices (n,): the objects that call for it, ascending; counts, first, nearest, distances (n,)
    and ignored: as in ``PointsInside``, row by row.
    """

    indices: Rows
    counts: Rows
    first: Rows
    nearest: Rows
    distances: Floats
    ignored: int

    def __len__(self) -> int:
        return len(self.indices)


class Points:
    """Points inside boxes, or within ``margin`` of them; nothing to do without a cloud."""

    name = "points"
    options: Mapping[str, Option] = {
        "margin": Option(0.0, 0.0, 1e6, "Points this near to a box count as inside (m)."),
    }
    lazy = True

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Count the points of all callers at once."""
        called = cycle.active if setting.wanted is None else cycle.active & setting.wanted
        slots = np.flatnonzero(called)
        if cycle.points is None or len(cycle.points) == 0 or len(slots) == 0:
            return Outcome(_nothing(slots), 0)
        found = points_inside(cycle.boxes.take(slots), cycle.points, setting.values["margin"])
        result = ObjectPoints(
            slots, found.counts, found.first, found.nearest, found.distances, found.ignored
        )
        return Outcome(result, len(cycle.points))


def _nothing(slots: Rows) -> ObjectPoints:
    none, count = np.full(len(slots), -1), np.zeros(len(slots), np.int64)
    return ObjectPoints(slots, count, none, none.copy(), np.full(len(slots), np.inf), 0)
