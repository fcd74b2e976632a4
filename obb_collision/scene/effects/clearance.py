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

"""The effect ``clearance``: how far apart pairs are that are nearer than a limit, and where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from obb_collision.queries.clearance.clearance import clearances_within
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.effects.base import Cycle, Option, Outcome, Setting, Table, isolated
from obb_collision.scene.effects.candidates import meeting_pairs
from obb_collision.typing import Floats

FIELDS = ("distances", "points_a", "points_b", "normals")
BLANK: Table = (np.empty((0, 2), np.int64), np.empty(0), *np.empty((3, 0, 3)))


@dataclass(frozen=True, eq=False)
class PairClearances:
    """The clearances of k pairs of objects, sorted; colliding ones are among them.

    pairs (k, 2): object indices; distances (k,) metres, negative minus the depth; points_a,
    points_b (k, 3): the closest points of the first and the second; normals (k, 3): from first to
    second. As in ``queries.clearance``.
    """

    pairs: Pairs
    distances: Floats
    points_a: Floats
    points_b: Floats
    normals: Floats

    def __len__(self) -> int:
        return len(self.pairs)


class Clearance:
    """Distance and closest points of all pairs of boxes nearer than ``limit``."""

    name = "clearance"
    options: Mapping[str, Option] = {
        "limit": Option(0.1, 0.0, 1e6, "Pairs farther apart than this are left out (m)."),
    }
    lazy = True

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Look at pairs whose bounds are near enough; most of those need no closest points."""
        limit = setting.values["limit"]
        slots = np.flatnonzero(cycle.active)
        minimum, maximum = cycle.boxes.take(slots).world_bounds()
        half = np.nextafter(0.5 * limit, np.inf)
        callers = None if setting.wanted is None else setting.wanted[slots]
        low, high = np.nextafter(minimum - half, -np.inf), np.nextafter(maximum + half, np.inf)
        pairs = meeting_pairs(cycle, slots, low, high, callers)

        def compute(some: Pairs) -> Table:
            rows, found = clearances_within(cycle.boxes, some, limit)
            return (some[rows], *(getattr(found, field) for field in FIELDS))

        _, columns, failures = isolated(compute, pairs, BLANK)
        return Outcome(PairClearances(*columns), len(pairs), failures)
