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

"""The effect ``sweep``: what objects pass through between checks, and what they run into next.

Between the check before and this one every box moves from its pose then to its pose now; pairs
that are apart at both and were not in between are *passed*. From now on objects with a twist keep
it over the horizon, the others stay; pairs that meet by then are *predicted*. What collides already
is in the report itself. Between checks the centre of a box goes straight; ahead it goes round the
origin of its pose, as the twist says. Pairs of which it is not known whether they meet are
*undecided*: whoever must not miss a collision treats them as colliding from then on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from obb_collision.queries.sweep.motion import sweep_needed, swept_bounds
from obb_collision.queries.sweep.sweep import (
    LEAST_TOLERANCE,
    TOLERANCE,
    Sweeps,
    sweep,
    sweep_twists,
)
from obb_collision.queries.sweep.twists import twist_bounds
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.effects.base import (
    Cycle,
    Option,
    Outcome,
    Setting,
    Table,
    isolated,
)
from obb_collision.scene.effects.candidates import meeting_pairs
from obb_collision.typing import Floats

FIELDS = ("hits", "undecided", "free_until", "points", "normals")
BLANK: Table = (*np.empty((2, 0), np.bool_), np.empty(0), *np.empty((2, 0, 3)))


@dataclass(frozen=True, eq=False)
class Hits:
    """First contacts of k pairs (k, 2) of object indices, sorted by pair.

    times (k,), points (k, 3) metres, at that time, normals (k, 3) from the first to the second.
    """

    pairs: Pairs
    times: Floats
    points: Floats
    normals: Floats

    def __len__(self) -> int:
        return len(self.pairs)


@dataclass(frozen=True, eq=False)
class Undecided:
    """Pairs (k, 2) of object indices of which it is not known whether they meet, sorted.

    free_until (k,): until when they are certainly apart.
    """

    pairs: Pairs
    free_until: Floats

    def __len__(self) -> int:
        return len(self.pairs)


@dataclass(frozen=True, eq=False)
class SweptPairs:
    """What ``sweep`` found.

    passed, passed_undecided: times are shares of the step, 0 at the check before, 1 now.
    predicted, predicted_undecided: times are seconds from now.
    """

    passed: Hits
    predicted: Hits
    passed_undecided: Undecided
    predicted_undecided: Undecided


class Sweep:
    """Continuous collision between checks, and prediction by twists."""

    name = "sweep"
    options: Mapping[str, Option] = {
        "horizon": Option(1.0, 0.0, 3600.0, "How far twists are followed (s). 0: not at all."),
        "tolerance": Option(
            TOLERANCE,
            LEAST_TOLERANCE,
            1.0,
            "Turning boxes nearer than this share of the smaller one's radius count as touching.",
        ),
    }
    lazy = False

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Sweep both ways, each only for objects that move far enough to need it."""
        behind, ahead = _passed(cycle, setting), _predicted(cycle, setting)
        result = SweptPairs(behind.hits, ahead.hits, behind.undecided, ahead.undecided)
        return Outcome(result, behind.ran + ahead.ran, behind.failures + ahead.failures)


class Found(NamedTuple):
    """What one way of sweeping found, on how many pairs it ran, and what failed."""

    hits: Hits
    undecided: Undecided
    ran: int = 0
    failures: tuple[str, ...] = ()


NO_PAIRS = np.empty((0, 2), np.int64)
NOTHING = Found(Hits(NO_PAIRS, np.empty(0), *np.empty((2, 0, 3))), Undecided(NO_PAIRS, np.empty(0)))


def _passed(cycle: Cycle, setting: Setting) -> Found:
    before = cycle.before
    if before is None:
        return NOTHING
    count = min(len(before.active), len(cycle.active))
    same = cycle.active[:count] & before.active[:count]
    same &= cycle.store.born[:count] == before.born[:count]
    same &= (cycle.boxes.half_extents[:count] == before.boxes.half_extents[:count]).all(axis=1)
    slots = np.flatnonzero(same)
    start, end = before.boxes.take(slots), cycle.boxes.take(slots)
    callers = sweep_needed(start, end)
    if setting.wanted is not None:
        callers &= setting.wanted[slots]
    if not callers.any():
        return NOTHING
    pairs = meeting_pairs(cycle, slots, *swept_bounds(start, end), callers)
    pairs = _apart(pairs, cycle.pairs, len(cycle.active))
    query = partial(sweep, start, end, tolerance=setting.values["tolerance"])
    found = _swept(query, pairs, np.searchsorted(slots, pairs))
    hits = found.hits
    begun = hits.times > 0.0  # the others collided before, and were reported then
    hits = Hits(hits.pairs[begun], hits.times[begun], hits.points[begun], hits.normals[begun])
    return found._replace(hits=hits)


def _predicted(cycle: Cycle, setting: Setting) -> Found:
    horizon, tolerance = setting.values["horizon"], setting.values["tolerance"]
    callers = cycle.active & cycle.store.twists.any(axis=1)
    if setting.wanted is not None:
        callers &= setting.wanted
    if horizon == 0.0 or not callers.any():
        return NOTHING
    slots = np.flatnonzero(cycle.active)
    boxes, twists = cycle.boxes.take(slots), cycle.store.twists[slots]
    origins = cycle.store.poses[slots, :3]
    bounds = twist_bounds(boxes, twists, origins, horizon)
    pairs = _apart(
        meeting_pairs(cycle, slots, *bounds, callers[slots]), cycle.pairs, len(cycle.active)
    )
    query = partial(
        sweep_twists, boxes, twists, horizon=horizon, tolerance=tolerance, origins=origins
    )
    return _swept(query, pairs, np.searchsorted(slots, pairs))


def _apart(pairs: Pairs, colliding: Pairs, slots: int) -> Pairs:
    """Return those of pairs (k, 2) that do not collide now."""
    keys, known = (p[:, 0] * slots + p[:, 1] for p in (pairs, colliding))
    return pairs[~np.isin(keys, known)]


def _swept(query: Callable[[Pairs], Sweeps], pairs: Pairs, rows: Pairs) -> Found:
    """Return what a query finds on rows (k, 2) of its boxes, by pairs (k, 2) of slots."""

    def compute(some: Pairs) -> Table:
        found = query(some)
        return tuple(getattr(found, field) for field in FIELDS)

    good, (hits, open_, times, *columns), failures = isolated(compute, rows, BLANK)
    hit, unknown = (mask.astype(np.bool_) for mask in (hits, open_))
    pairs = pairs[good]
    return Found(
        Hits(pairs[hit], times[hit], *(column[hit] for column in columns)),
        Undecided(pairs[unknown], times[unknown]),
        len(rows),
        failures,
    )
