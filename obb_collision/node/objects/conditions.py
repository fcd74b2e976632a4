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

"""The condition of each object: one number, and the events that change it.

Its bits are facts. ``STATES`` names the condition by the first fact of its list that holds: an
object is in one state. Nothing but the events below writes the column, and each is legal in some
conditions only.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from obb_collision.typing import Mask, Rows

Conditions: TypeAlias = npt.NDArray[np.uint16]
"""(rows,) one of each object; 0: none."""
Indices: TypeAlias = Rows | slice | int

LIVE = 1 << 0
"""There is an object; every other fact needs this one."""
UNPLACED = 1 << 1
"""No pose of it has been placed."""
UNSHAPED = 1 << 2
"""Its first shape is being built."""
RESHAPED = 1 << 3
"""A shape is being built for it, the first one or a newer one."""
ASIDE = 1 << 4
"""Checks fail with it, so it takes part in none for now."""
BAD_POSE = 1 << 5
"""Its latest pose was refused: the last one stays."""
BAD_SHAPE = 1 << 6
"""Its latest shape was refused: the last one stays."""
OVERTAKEN = 1 << 7
"""States with an older stamp came since the latest."""
HELD_BACK = 1 << 8
"""So they did, and nothing newer has come for some time."""
FUTURE = 1 << 9
"""The stamp of the state placed is from the future."""
WAITING = 1 << 10
"""Its latest pose is not placed yet."""
TIRED = 1 << 11
"""That has waited too long, and was counted for it."""
LATE = 1 << 12
"""Poses have waited too long since the last one that was placed."""
STALE = 1 << 13
"""The state placed is older than its limit."""
IGNORED = 1 << 14
"""It is stale, and to be in no pair then."""
LOST = 1 << 15
"""It is stale, and where it is is not known."""

ALL = (1 << 16) - 1
ABSENT = UNPLACED | UNSHAPED | ASIDE
"""Any of these: it takes part in no check."""
REFUSED = BAD_POSE | BAD_SHAPE | LATE
"""Any of these: its latest shape or pose could not be used, or not in time."""
DOUBTS = REFUSED | STALE | FUTURE | HELD_BACK | RESHAPED | ASIDE
"""Any of these: its box is not known to be where it should be, and is shown grey."""

STATES = {
    "internal_error": ASIDE,
    "shape_building": UNSHAPED | RESHAPED,
    "refused": BAD_POSE | BAD_SHAPE | HELD_BACK,
    "unplaced": UNPLACED,
    "late_frame": LATE,
    "stale": LOST,
}
"""The states other than placed, by their codes, each with the facts that mean it."""


class Event(NamedTuple):
    """What happens to objects: the facts it needs, and those that it ends and begins."""

    name: str
    needs: int = LIVE
    ends: int = 0
    begins: int = 0


RENEWED = Event("deleted, and sent again as it was", ends=ALL ^ (LIVE | UNPLACED | UNSHAPED))
POSE_GIVEN = Event("given a pose", ends=OVERTAKEN | BAD_POSE | TIRED, begins=WAITING)
POSE_REFUSED = Event("its pose refused", begins=BAD_POSE)
POSE_OVERTAKEN = Event("given a pose older than its latest", begins=OVERTAKEN)
FOLLOWING = Event("to be placed again by its latest pose", begins=WAITING)
PLACED = Event("placed", ends=UNPLACED | WAITING | TIRED | LATE)
PLACED_EARLIER = Event("placed by an earlier pose", LIVE | WAITING, ends=UNPLACED | LATE)
PLACED_TIRED = Event("placed by a much earlier pose", LIVE | WAITING | TIRED, ends=UNPLACED)
UNPLACEABLE = Event("its latest pose cannot be placed", ends=WAITING | TIRED, begins=LATE)
TIMED_OUT = Event("an earlier pose was not placed in time", begins=LATE)
TIRED_OUT = Event("its latest pose was not placed in time", LIVE | WAITING, begins=TIRED | LATE)
FIRST_SHAPE_ASKED = Event("to have a first shape", LIVE | UNPLACED, begins=UNSHAPED | RESHAPED)
SHAPE_ASKED = Event("to have another shape", begins=RESHAPED)
SHAPE_GIVEN = Event("given a shape", ends=UNSHAPED)
SHAPE_SETTLED = Event("waits for no shape any more", ends=RESHAPED)
SHAPE_CONFIRMED = Event("its shape accepted", ends=BAD_SHAPE)
SHAPE_REFUSED = Event("its shape refused", begins=BAD_SHAPE)
SET_ASIDE = Event("set aside", begins=ASIDE)
TRIED_AGAIN = Event("no longer set aside", LIVE | ASIDE, ends=ASIDE)

JUDGED = OVERTAKEN | HELD_BACK | FUTURE | STALE | IGNORED | LOST
"""Facts that go by the clock: each cycle judges them anew."""


def begin(conditions: Conditions, rows: Indices) -> None:
    """Begin new objects: with a shape, not placed."""
    conditions[rows] = LIVE | UNPLACED


def end(conditions: Conditions, rows: Indices) -> None:
    """End objects."""
    conditions[rows] = 0


def happen(conditions: Conditions, rows: Indices, event: Event) -> None:
    """Let an event happen to objects; ValueError where one is in no condition for it."""
    before = conditions[rows]
    if np.any((before & event.needs) != event.needs):
        unfit = np.atleast_1d(before)[np.atleast_1d((before & event.needs) != event.needs)]
        raise ValueError(
            f"event {event.name!r} is not allowed for an object in state {unfit[0]:#x}"
        )
    conditions[rows] = (before & (ALL ^ event.ends)) | event.begins


def judge(conditions: Conditions, fact: int, holds: Mask) -> None:
    """Let a fact of JUDGED hold for the live ones of some objects (rows,), and for no others."""
    if not fact & JUDGED:
        raise ValueError(f"fact {fact:#x} does not depend on the clock")
    before = (conditions & fact) != 0
    if holds.any() or before.any():
        now = holds & ((conditions & LIVE) != 0)
        conditions[before & ~now] &= ALL ^ fact
        conditions[now & ~before] |= fact
