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

"""States that wait for their transform: a short queue per object, stored in one table.

The latest state of each object is in the table of objects. Where a newer one comes before that
could be placed it goes here, so that the newest state that *can* be placed is, as with tf2's
MessageFilter: a transform that is always a little late must not freeze an object.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.node.objects.conditions import TIRED
from obb_collision.node.objects.table import ObjectTable, Slots
from obb_collision.typing import Mask

States = npt.NDArray[Any]
"""Rows of ``STATE``."""

STATE = np.dtype(
    [
        ("slot", np.int64),
        ("number", np.int64),  # the later it came, the higher
        ("frame", np.int64),
        ("stamp", np.int64),
        ("received", np.int64),
        ("topic", np.int64),
        ("counted", np.bool_),  # as one that was not placed in time
        ("pose", np.float64, (7,)),
        ("twist", np.float64, (6,)),
    ]
)
MAX_WAITING = 100_000
"""Maximum number of states (15 MB): 10,000 objects at 50 Hz whose transform is 0.2 s late."""
LONGEST_LAG = 10 * NANOSECONDS
"""For so long (ns) a state waits for a transform that lags, though its object is late by then."""
MOST_LATE, MAX_LATE = 64, 20_000
"""Maximum number of states that are late by then, of an object and, at two or more each, of all."""


def latest_states(table: ObjectTable, slots: Slots) -> States:
    """Return the latest state of objects, as rows."""
    states = np.empty(len(slots), STATE)
    states["slot"] = slots
    for field, column in (
        ("number", table.number),
        ("frame", table.frame),
        ("stamp", table.stamp),
        ("received", table.received),
        ("topic", table.topic),
        ("pose", table.given),
        ("twist", table.twist),
    ):
        states[field] = column[slots]
    states["counted"] = table.has(TIRED, slots)
    return states


def newest_per_object(states: States) -> npt.NDArray[np.int64]:
    """Return the rows that are the newest ones of their objects."""
    order = np.lexsort((states["number"], states["slot"]))
    slots = states["slot"][order]
    last = np.append(slots[1:] != slots[:-1], True)[: len(slots)]
    return order[last]


def spaced(slots: Slots, received: Slots) -> Mask:
    """Return which states (n,), in the order of receipt, are to be kept, so that they are few.

    received: times within LONGEST_LAG of each other. Of an object with too many the oldest one in
    each span of time stays: that is placed some day, though newer ones keep coming.
    """
    _, which, counts = np.unique(slots, return_inverse=True, return_counts=True)
    most = min(max(MAX_LATE // max(len(counts), 1), 2), MOST_LATE)
    kept: Mask = counts[which] <= most
    if not kept.all():
        spans = received // (2 * LONGEST_LAG // most)
        kept[np.unique(np.column_stack((slots, spans)), axis=0, return_index=True)[1]] = True
    return kept


class WaitingStates:
    """States that could not be placed so far, in the order of receipt; ``most``: maximum rows."""

    def __init__(self, most: int = MAX_WAITING) -> None:
        self._most = most
        self._parts: list[States] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> States:
        """All of them."""
        if len(self._parts) != 1:
            self._parts = [np.concatenate([np.empty(0, STATE), *self._parts])]
        return self._parts[0]

    @rows.setter
    def rows(self, states: States) -> None:
        self._parts, self._count = [states], len(states)

    def add(self, states: States) -> None:
        """Keep more.

        Where they are too many, every other one of each object goes: the time they reach back,
        which decides whether there is a transform, stays.
        """
        self._parts.append(states)
        self._count += len(states)
        if self._count > self._most:
            kept = _every_other(self.rows)
            self.rows = kept[np.argsort(kept["number"], kind="stable")][-self._most :]


def _every_other(states: States) -> States:
    """Return every other state of each object, counted from the newest, and the oldest."""
    order = np.lexsort((-states["number"], states["slot"]))
    slots = states["slot"][order]
    starts = np.flatnonzero(np.append(True, slots[1:] != slots[:-1])[: len(slots)])
    ranks = np.arange(len(slots)) - np.repeat(starts, np.diff(np.append(starts, len(slots))))
    ends = np.append(starts[1:], len(slots)) - 1
    ranks[ends[ends >= 0]] = 0
    return states[order[ranks % 2 == 0]]
