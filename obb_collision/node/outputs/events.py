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

"""The topic ``events``: what began and ended in a check, and regularly all that lasts."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from obb_collision.node.outputs.pair_events import NOT_CHECKED, REMOVED, Limits, PairEvents, Parted
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.topics.rows import CheckedState, StructuredRows
from obb_collision.node.topics.topics import EVENTS
from obb_collision.queries.verdict.separations import pair_separations
from obb_collision.scene.effects.settings import OFF
from obb_collision.scene.store.region import owns

PERIOD = 2.0
"""Seconds after which all lasting collisions are sent again."""


class Events:
    """Makes the rows of the topic. listeners: returns how many subscribers it has."""

    def __init__(self, parameters: Parameters, listeners: Callable[[], int]) -> None:
        self._parameters, self._listeners = parameters, listeners
        self.pairs = PairEvents(EVENTS.dtype)
        self._subscribers = 0  # subscribers that were there at the last message
        self._next = 0.0  # when all that lasts is due

    def forget(self) -> None:
        """Stop counting: nobody asks."""
        self.pairs.forget()
        self._subscribers = 0

    def rows(
        self, found: StructuredRows, given: CheckedState, measured: bool
    ) -> StructuredRows | None:
        """Return the rows of one message, None for no message.

        found: rows of ``collisions``; measured: whether distances are computed.
        """
        limits = Limits(*(self._parameters.option("events", key) for key in Limits._fields))
        if self._parameters.mode("separations") == OFF:  # there are no distances
            limits = limits._replace(begin_distance=0.0, clear_distance=0.0)
        rows = self.pairs.update(
            given.now,
            found,
            limits,
            lambda rows: _part(rows, given, limits.clear_distance, measured),
            whole=not given.report.truncated,
        )
        listeners, now = self._listeners(), perf_counter()
        due = listeners > self._subscribers or now >= self._next
        self._subscribers = listeners
        if due:
            self._next = now + PERIOD
            rows = np.concatenate((rows, self.pairs.lasting(given.now)))
        return rows if len(rows) or due else None


def _part(rows: StructuredRows, given: CheckedState, distance: float, measured: bool) -> Parted:
    """Return what is known of rows that do not collide."""
    a, b = (
        given.table.find(rows[ns].astype(np.int64), rows[number].astype(np.int64))
        for ns, number in (("ns_a", "id_a"), ("ns_b", "id_b"))
    )
    cycle = given.report.cycle
    reasons = np.where((a < 0) | (b < 0), REMOVED, 0)
    checked = cycle.active[a] & cycle.active[b]
    with cycle.snapshot:
        checked &= cycle.owned(np.stack((a, b), axis=1))
    if cycle.pair_filter is not None:
        checked &= cycle.pair_filter(a, b)
    if cycle.region is not None and len(rows):
        with cycle.snapshot:  # what another region answers for may collide there
            checked &= owns(cycle.region, np.maximum(cycle.bounds(a)[0], cycle.bounds(b)[0]))
    reasons[(reasons == 0) & ~checked] = NOT_CHECKED
    apart = np.full(len(rows), distance <= 0.0)
    known = np.flatnonzero(reasons == 0)
    if distance > 0.0 and measured and len(known):
        with cycle.snapshot:
            pairs = np.stack((a[known], b[known]), axis=1)
            apart[known] = pair_separations(cycle.boxes, pairs).separations > distance
    return Parted(reasons, apart)
