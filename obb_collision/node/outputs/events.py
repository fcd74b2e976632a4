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
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.node.objects.table import NO_TIME
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.topics.rows import (
    BEGIN,
    END,
    LASTING,
    NORMAL_FIELDS,
    NOT_CHECKED,
    PAIR_FIELDS,
    POSITION_FIELDS,
    REMOVED,
    CheckedState,
    StructuredRows,
)
from obb_collision.node.topics.topics import EVENTS
from obb_collision.queries.verdict.verdict import pair_separations
from obb_collision.scene.effects.settings import OFF
from obb_collision.scene.store.region import owns
from obb_collision.typing import Floats, Mask, Rows

PERIOD = 2.0
"""Seconds after which all lasting collisions are sent again."""
TAKEN = (*POSITION_FIELDS, *NORMAL_FIELDS)


class Events:
    """Makes the rows of the topic ``events``. listeners: returns its number of subscribers."""

    def __init__(self, parameters: Parameters, listeners: Callable[[], int]) -> None:
        self._parameters, self._listeners = parameters, listeners
        self.pairs = PairEvents(EVENTS.dtype)
        self._subscribers = 0  # subscribers that were there at the last message
        self._next = 0.0  # when all that lasts is due

    def forget(self) -> None:
        """Stop counting: the topic is not requested."""
        self.pairs.forget()
        self._subscribers = 0

    def rows(
        self, collisions: StructuredRows, state: CheckedState, measured: bool
    ) -> StructuredRows | None:
        """Return the rows of one message, None for no message.

        collisions: rows of that topic; measured: whether distances are computed.
        """
        limits = EventLimits(
            *(self._parameters.option("events", key) for key in EventLimits._fields)
        )
        if self._parameters.mode("separations") == OFF:  # there are no distances
            limits = limits._replace(begin_distance=0.0, clear_distance=0.0)
        rows = self.pairs.update(
            state.now,
            collisions,
            limits,
            lambda rows: _part(rows, state, limits.clear_distance, measured),
            whole=not state.report.truncated,
        )
        listeners, now = self._listeners(), perf_counter()
        due = listeners > self._subscribers or now >= self._next
        self._subscribers = listeners
        if due:
            self._next = now + PERIOD
            rows = np.concatenate((rows, self.pairs.lasting(state.now)))
        return rows if len(rows) or due else None


def _part(rows: StructuredRows, state: CheckedState, distance: float, measured: bool) -> Parted:
    """Return why rows that do not collide any more end, and which objects are apart."""
    a, b = (
        state.table.find(rows[ns].astype(np.int64), rows[number].astype(np.int64))
        for ns, number in (("ns_a", "id_a"), ("ns_b", "id_b"))
    )
    cycle = state.report.cycle
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
    comparable = np.flatnonzero(reasons == 0)
    if distance > 0.0 and measured and len(comparable):
        with cycle.snapshot:
            pairs = np.stack((a[comparable], b[comparable]), axis=1)
            apart[comparable] = pair_separations(cycle.boxes, pairs).separations > distance
    return Parted(reasons, apart)


class EventLimits(NamedTuple):
    """Distances (m) and times (s) for a collision to begin and to clear."""

    begin_distance: float = 0.0
    clear_distance: float = 0.0
    begin_time: float = 0.0
    clear_time: float = 0.0


class Parted(NamedTuple):
    """The end of n collisions.

    reasons (n,): 0, or why the pairs are not checked any more: REMOVED or NOT_CHECKED; apart (n,):
    whether the objects are certainly apart by more than the distance to clear.
    """

    reasons: npt.NDArray[np.int64]
    apart: Mask


class PairEvents:
    """The pairs whose collisions last, and those that are about to begin or to end.

    dtype: of a row of the topic ``events``. Pairs are known by the keys of their objects, so one
    that is removed and added again between two checks is the same.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._dtype = dtype
        self.forget()

    def forget(self) -> None:
        """Begin anew: what collides at the next update lasts already."""
        self._new = True
        self._reset(np.empty(0, "S16"))

    def _reset(self, keys: npt.NDArray[np.bytes_]) -> None:
        """Take pairs of which nothing is known."""
        self._keys, size = keys, len(keys)
        self._rows: StructuredRows = np.zeros(size, self._dtype)
        self._rows["depth"] = np.nan
        self._begun: Mask = np.zeros(size, np.bool_)
        self._since: Rows = np.full(size, NO_TIME)  # of what is about to begin or to end
        self._start: Rows = np.zeros(size, np.int64)

    def interrupt(self) -> None:
        """Note a pause of checks; the pause does not count as time apart."""
        self._since[self._begun] = NO_TIME

    def clock_jumped(self, shift: int) -> None:
        """Continue all times from the new time, ``shift`` (ns) later."""
        self._start += shift
        self._since[self._since != NO_TIME] += shift

    def update(
        self,
        now: int,
        collisions: StructuredRows,
        limits: EventLimits,
        part: Callable[[StructuredRows], Parted],
        whole: bool = True,
    ) -> StructuredRows:
        """Return the collisions that began and ended, sorted by the keys of the objects.

        now: ns; collisions: sorted rows of the topic; part: takes rows that do not collide and
        returns their ``Parted``; whole: whether ``collisions`` has all that collide.
        """
        collides, depths = self._merge(collisions)
        deep = collides & ~(depths < limits.begin_distance)  # NaN: not known, which counts
        # ends first: should ``part`` raise, no begin is lost
        ends = self._end(now, collides, limits, part, whole)
        begins = self._begin(now, deep, limits, kept=~collides & (not whole))
        events = self._rows[begins | ends]
        gone = ends | ((self._since == NO_TIME) & ~self._begun)
        if gone.any():
            self._keep(~gone)
        first, self._new = self._new, False
        return events[:0] if first else events

    def lasting(self, now: int) -> StructuredRows:
        """Return the collisions that last."""
        rows = self._rows[self._begun]
        rows["event"], rows["duration"] = LASTING, (now - self._start[self._begun]) / NANOSECONDS
        return rows

    def _merge(self, collisions: StructuredRows) -> tuple[Mask, Floats]:
        """Add colliding pairs to those that last; return (k,) which collide, and how deep."""
        keys = _keys(collisions)
        if not np.array_equal(keys, self._keys):
            self._grow(np.union1d(self._keys, keys))
        where = np.searchsorted(self._keys, keys)
        collides, depths = np.zeros(len(self._keys), np.bool_), np.zeros(len(self._keys))
        collides[where], depths[where] = True, collisions["depth"]
        for name in (*TAKEN, *PAIR_FIELDS):
            self._rows[name][where] = collisions[name]
        self._rows["depth"][where] = np.fmax(self._rows["depth"][where], collisions["depth"])
        return collides, depths

    def _grow(self, keys: npt.NDArray[np.bytes_]) -> None:
        old, where = self._state, np.searchsorted(keys, self._keys)
        self._reset(keys)
        for column, values in zip(self._state, old, strict=True):
            column[where] = values

    @property
    def _state(self) -> tuple[npt.NDArray[Any], ...]:
        return self._rows, self._begun, self._since, self._start

    def _keep(self, kept: Mask) -> None:
        self._keys = self._keys[kept]
        self._rows, self._begun, self._since, self._start = (c[kept] for c in self._state)

    def _begin(self, now: int, deep: Mask, limits: EventLimits, kept: Mask) -> Mask:
        """Begin collisions that were deep for long enough; kept: pairs that were not checked."""
        waits = ~self._begun & deep
        self._since[waits & (self._since == NO_TIME)] = now
        self._since[~self._begun & ~deep & ~kept] = NO_TIME
        begins = waits & (self._new | (self._since <= now - _nanoseconds(limits.begin_time)))
        self._begun |= begins
        self._since[begins], self._start[begins] = NO_TIME, now
        self._rows["event"][begins] = BEGIN
        return begins

    def _end(
        self,
        now: int,
        collides: Mask,
        limits: EventLimits,
        part: Callable[[StructuredRows], Parted],
        whole: bool,
    ) -> Mask:
        """End collisions of pairs that are apart for long enough, or not checked any more."""
        self._since[self._begun & collides] = NO_TIME
        ends = np.zeros(len(self._keys), np.bool_)
        which = np.flatnonzero(self._begun & ~collides)
        if len(which) == 0:
            return ends
        parted = part(self._rows[which])
        apart = parted.apart & whole
        since = np.where(apart, np.minimum(self._since[which], now), NO_TIME)
        self._since[which] = since
        over = (parted.reasons > 0) | (apart & (since <= now - _nanoseconds(limits.clear_time)))
        ended = which[over]
        ends[ended] = True
        self._rows["event"][ended], self._rows["reason"][ended] = END, parted.reasons[over]
        self._rows["duration"][ended] = (now - self._start[ended]) / NANOSECONDS
        return ends


def _nanoseconds(seconds: float) -> int:
    return round(seconds * NANOSECONDS)


def _keys(rows: StructuredRows) -> npt.NDArray[np.bytes_]:
    """Return the keys of pairs (n,) as bytes that are ordered as the rows are."""
    numbers = np.empty((len(rows), len(PAIR_FIELDS)), ">u4")
    for column, name in enumerate(PAIR_FIELDS):
        numbers[:, column] = rows[name].astype(np.int64) + 2**31
    return numbers.view("S16").reshape(-1)
