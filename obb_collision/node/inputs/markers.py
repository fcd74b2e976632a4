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

"""The topic ``objects``: messages wait as bytes and are applied together, at the next cycle.

A sender that is faster than the cycles can't hold them up or make the node grow: the queue is
bounded in bytes and applied early beyond that, and of the waiting states of an object one is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.node.inputs.batch import (
    Batch,
    Faults,
    Settled,
    find_faults,
    gather,
    put_rows,
    settle,
)
from obb_collision.node.inputs.boxes import OWNED
from obb_collision.node.inputs.marker_lists import MarkerLists
from obb_collision.node.inputs.senders import ALONE
from obb_collision.node.messages.cdr import Items, markers_from_bytes
from obb_collision.node.messages.conversions import Kinds, name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_shapes import (
    ANNOTATIONS,
    IMMEDIATE,
    MarkerShape,
    ShapePlan,
    plan_shape,
)
from obb_collision.node.objects.conditions import (
    LIVE,
    POSE_OVERTAKEN,
    RESHAPED,
    SHAPE_CONFIRMED,
    UNPLACED,
)
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.refusals import UnknownObjects
from obb_collision.node.objects.states import OLDER, State
from obb_collision.node.objects.table import PRIMITIVES
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.typing import Mask, Rows

MAX_WAITING_BYTES = 64 << 20
MAX_WAITING_MESSAGES = 1000
MAX_TRIES = 3
"""States of an object that are tried where the last one can't be built."""
DELETIONS = Marker.DELETE, Marker.DELETEALL
NO_NUMBER = -(1 << 40)
"""In place of the number of a namespace that is not in the table; no namespace has it."""


class Waiting(NamedTuple):
    """A waiting message: bytes, time of receipt (ns), sender, and how many had come by then."""

    data: bytes
    received: int
    sender: int
    number: int


class MarkerInput:
    """Receives messages of ``objects``, and applies their outcome.

    unknown: takes the names of objects that are deleted.
    """

    def __init__(self, objects: Objects, clock: Callable[[], int], unknown: UnknownObjects) -> None:
        self._objects, self._clock, self._unknown = objects, clock, unknown
        self._monitor, self._guard = objects.monitors["objects"], objects.guard
        self._lists = MarkerLists(objects)
        self._waiting: list[Waiting] = []
        self.size = 0
        """Bytes that wait."""

    def queue(self, data: bytes, now: int) -> None:
        """Queue a serialised MarkerArray for the next cycle."""
        self._waiting.append(Waiting(data, now, self._monitor.sender, self._monitor.messages))
        self.size += len(data)
        if self.size > MAX_WAITING_BYTES or len(self._waiting) > MAX_WAITING_MESSAGES:
            self.apply()

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self._waiting = [
            message._replace(received=message.received + shift) for message in self._waiting
        ]

    def apply(self) -> None:
        """Apply the waiting messages."""
        waiting, self._waiting, self.size = self._waiting, [], 0
        messages = self._scan_all(waiting) if waiting else []
        if not messages or self._apply_messages(messages):
            return
        for message in messages:  # one that fails takes no other with it
            if not self._apply_messages([message]):
                self._monitor.refuse_whole(INTERNAL_ERROR, sender=message[-1])
                self._objects.broken = "input objects"

    def _scan_all(self, waiting: list[Waiting]) -> list[tuple[Items, int, int]]:
        """Return the markers of messages with their times of receipt and senders.

        The newest message is read first: what comes before a DELETEALL is dropped unread, and it
        does not matter if it was lost.
        """
        messages: list[tuple[Items, int, int]] = []
        read: set[int] = set()  # senders of which a newer message could be read
        missed = self._monitor.missed
        for message in reversed(waiting):
            part = self._scan(message, message.sender in read)
            if part is None:
                continue
            if message.sender >= ALONE:
                read.add(message.sender)
            if len(part):
                messages.insert(0, (part, message.received, message.sender))
                deletes = part.numbers["head"]["action"] == Marker.DELETEALL
                if (deletes & (part.of("ns")[:, 1] == 0)).any():
                    if missed is not None and missed.number <= message.number:
                        self._monitor.missed = None
                    break
        return messages

    def _scan(self, message: Waiting, is_read_since: bool) -> Items | None:
        """Return the markers of a message, None if it is refused.

        is_read_since: whether a newer one of its sender could be read.
        """
        try:
            return markers_from_bytes(message.data)
        except Exception as error:
            refusal = self._guard.refusal("input objects", error, "whole message")
            if is_read_since:
                self._monitor.refuse(refusal.reason, "whole message", refusal.detail)
            else:
                self._monitor.refuse_whole(refusal.reason, refusal.detail, message.sender)
        return None

    def _apply_messages(self, messages: list[tuple[Items, int, int]]) -> bool:
        """Apply the markers of messages; return whether that went through."""
        with self._guard.catching("input objects", "whole message"):
            markers, lists = self._lists.expand(gather(*zip(*messages, strict=True)))
            MarkerUpdate(markers, self._clock(), self._objects, self._unknown).apply(lists)
            return True
        return False


class MarkerUpdate:
    """Applies the outcome of markers at a time (ns): objects are removed, added or changed."""

    def __init__(self, markers: Batch, now: int, objects: Objects, unknown: UnknownObjects) -> None:
        self._markers, self._now, self._unknown = markers, now, unknown
        self._objects, self._table, self._shapes = objects, objects.table, objects.shapes
        self._monitor = objects.monitors["objects"]
        self._plans: dict[int, ShapePlan] = {}
        self._again = np.zeros(len(markers), np.bool_)  # which follow another one of their object
        self._orders = np.zeros(len(markers), np.int64)  # stamps before which others are late
        self._kinds: Kinds = np.zeros(len(markers), np.int8)  # of the poses

    def apply(self, lists: Mapping[int, RefusedError]) -> None:
        """Apply the markers, and count those that are not used; lists: faults of lists, by row."""
        markers, objects = self._markers, self._objects
        faults = find_faults(markers, objects.placement.frame_index)
        for row, error in lists.items():
            faults.note(np.arange(len(markers)) == row, error, of_shape=True)
        self._kinds = faults.kinds
        outcome = settle(markers, faults, self._now, objects.states.stamp_tolerance, self._newest())
        mine = self._without_owned(outcome)
        slots, added = self._remove(mine), np.flatnonzero(mine.winner >= 0)
        added = added[np.argsort(mine.winner[added])]
        self._again, self._orders = outcome.previous >= 0, outcome.newest
        self._add(mine.winner[added], slots[added], outcome.previous)
        self._mark_bad(mine.bad[mine.bad >= 0], faults)
        slots = self._find_slots(mine.overtaken[mine.overtaken >= 0])
        self._table.mark(slots[slots >= 0], POSE_OVERTAKEN)
        self._count(faults, outcome)

    def _newest(self) -> Rows:
        """Return the newest stamps (n,) of the objects, 0 where older ones may follow."""
        slots, table = self._find_slots(np.arange(len(self._markers))), self._table
        since = self._markers.received - table.received[slots]
        mine = (slots >= 0) & (table.of_set[slots] == 0)  # others are refused in any case
        orders = mine & (since <= self._objects.states.order_timeout)
        return np.where(orders, table.order[slots], 0)

    def _mark_bad(self, rows: Rows, faults: Faults) -> None:
        """Mark objects whose latest markers have faults; one of the pose may tell a new shape."""
        if len(rows) == 0:
            return
        slots, of_shape = self._find_slots(rows), faults.are_of_shape[rows]
        same = self._have_shapes(rows, slots) & ~self._table.has(RESHAPED, slots) & ~of_shape
        self._table.mark(slots[same], SHAPE_CONFIRMED)
        for row, is_same in zip(rows.tolist(), same.tolist(), strict=True):
            self._mark(row, faults.of(row).error.reason, not is_same)

    def _count(self, faults: Faults, outcome: Settled) -> None:
        """Count refused, late and superseded markers."""
        for rows, fault in faults:
            self._refuse(rows, fault.error)
        self._refuse(np.flatnonzero(outcome.late), RefusedError(OLDER))
        new = (self._markers.action == Marker.ADD) & faults.good & ~outcome.late
        new[outcome.winner[outcome.winner >= 0]] = False
        self._monitor.superseded += int(new.sum())

    def _refuse(self, rows: Rows, error: RefusedError, marks: bool = False) -> None:
        """Count refused markers; marks: their objects have not the shapes that were sent last."""
        if len(rows):
            item = name_from_key(self._markers.key(int(rows[-1])))
            self._monitor.refuse(error.reason, item, error.detail, len(rows))
        for row in rows.tolist() if marks else ():
            self._mark(row, error.reason)

    def _mark(self, row: int, reason: str, of_shape: bool = True) -> None:
        """Mark that the latest state of an object could not be used."""
        expiry = int(self._markers.expiry[row])
        self._shapes.refuse(self._markers.key(row), reason, of_shape, expiry)

    def _number_of(self, name: str) -> int:
        """Return the number of a namespace in the table, NO_NUMBER for none."""
        number = self._table.namespaces.find(name)
        return NO_NUMBER if number is None else number

    def _keys(self, rows: Rows) -> tuple[Rows, Rows]:
        """Return numbers of namespaces, NO_NUMBER for those not in the table, and ids."""
        ns = self._markers.ns
        numbers = [
            NO_NUMBER if index in ns.bad else self._number_of(name)
            for index, name in enumerate(ns.texts)
        ]
        return np.array(numbers, np.int64)[ns.of[rows]], self._markers.id[rows]

    def _find_slots(self, rows: Rows) -> Rows:
        return self._table.find(*self._keys(rows))

    def _without_owned(self, outcome: Settled) -> Settled:
        """Exclude, and count, markers that name objects of sets of boxes, or links of robots."""
        slots = self._find_slots(outcome.first)
        owned = (slots >= 0) & ((self._table.of_set[slots] > 0) | self._table.of_robot[slots])
        if not owned.any():
            return outcome
        winner, remover = outcome.winner[owned], outcome.remover[owned]
        self._refuse(winner[winner >= 0], OWNED, marks=True)
        for row in outcome.bad[owned & (outcome.bad >= 0)].tolist():  # counted by its own reason
            self._mark(row, OWNED.reason)
        self._refuse(remover[(remover >= 0) & (winner < 0)], OWNED)
        return outcome.of_objects(~owned)

    def _remove(self, outcome: Settled) -> Rows:
        """Remove deleted objects; return the slots (k,) of the others, -1 for none.

        An object that is deleted and comes again as it was, in the fixed frame, stays in its place.
        """
        markers, objects, table = self._markers, self._objects, self._table
        added = (markers.action == Marker.ADD) & ~np.isin(markers.type, ANNOTATIONS)
        everything = markers.ns.of[markers.action == Marker.DELETEALL]
        was_something = not objects.is_empty or bool(objects.unplaceable) or added.any()
        doomed, removed = self._deleted_by_all(everything), outcome.remover >= 0
        slots = self._find_slots(outcome.first)
        doomed[slots[removed & (slots >= 0)]] = True
        deleted = [markers.key(row) for row in outcome.first[removed].tolist()]
        for key in deleted if objects.unplaceable else ():
            self._shapes.unplaceable.delete(key)
        again = np.flatnonzero((slots >= 0) & (outcome.winner >= 0))
        again = again[doomed[slots[again]]]
        if len(again):
            again = again[self._come_as_they_were(outcome.winner[again], slots[again])]
            doomed[slots[again]] = False
        gone = np.flatnonzero(doomed & table.live)
        self._unknown.deleted((*deleted, *table.keys(gone)), self._now)
        objects.shapes.remove(gone)
        of_all = any(not markers.ns.texts[index] for index in everything.tolist())
        if of_all or (was_something and np.isin(markers.action, DELETIONS).any()):
            objects.declare_empty()
        objects.shapes.readd(slots[again])
        return np.where((slots >= 0) & table.has(LIVE, slots), slots, -1)

    def _come_as_they_were(self, rows: Rows, slots: Rows) -> Mask:
        """Return which objects have the shapes of markers, and those the fixed frame."""
        frame, frames = self._markers.frame, self._objects.placement.frame_table
        same = self._have_shapes(rows, slots)
        for index in np.flatnonzero(~np.isin(self._markers.type[rows], IMMEDIATE)).tolist():
            with suppress(Exception):  # reported when it is added
                signature = self._plan(int(rows[index])).signature
                same[index] = self._table.signatures.get(int(slots[index])) == signature
        same &= np.array([frames.is_fixed(name) for name in frame.texts])[frame.of[rows]]
        return same & ~self._table.has(UNPLACED, slots)

    def _deleted_by_all(self, namespaces: Rows) -> Mask:
        """Return which slots are deleted by DELETEALL, of all or of a namespace, as in RViz."""
        table, ns = self._table, self._markers.ns
        doomed = np.zeros(len(table.condition), np.bool_)
        for index in np.unique(namespaces).tolist():
            name = ns.texts[index]
            self._shapes.unplaceable.delete_all(name or None)
            if not name:
                doomed |= table.live
            elif index not in ns.bad:
                doomed |= table.live & (table.ns == self._number_of(name))
        return doomed & ~((table.of_set > 0) | table.of_robot)

    def _have_shapes(self, rows: Rows, slots: Rows) -> Mask:
        """Return which objects (n,), -1 for none, have the shapes of primitive markers."""
        return self._table.have_shapes(slots, self._markers.type[rows], self._markers.scales[rows])

    def _add(self, rows: Rows, slots: Rows, previous: Rows) -> None:
        """Give objects the shapes and poses of markers."""
        markers, states = self._markers, self._objects.states
        old = states.find_late(slots, markers.stamp[rows], markers.received[rows])
        self._refuse(rows[old], RefusedError(OLDER, "a newer state was received"))
        rows, slots = rows[~old], slots[~old]
        same = self._have_shapes(rows, slots)
        self._put_rows(rows[same], self._touch)
        simple = ~same & np.isin(markers.type[rows], PRIMITIVES)
        primitives, ns = rows[simple], markers.ns

        def refuse(bad: Mask, error: RefusedError) -> None:
            self._refuse(primitives[bad], error, marks=True)

        def admit(index: int) -> int:
            return self._table.namespaces.admit(ns.texts[index])

        with self._shapes.room(slots[simple] < 0, ns.of[primitives], admit, refuse) as admitted:
            self._put_rows(primitives[admitted], self._put_many)
        for row in rows[~same & ~simple].tolist():
            self._put_one_of(row, previous)

    def _put_one_of(self, last: int, previous: Rows) -> None:
        """Give an object the last of its shapes that can be built."""
        self._put_what_stays(last, previous)
        row = last
        for _ in range(MAX_TRIES):
            if self._put_rows(np.array([row]), self._put):
                break
            if (row := int(previous[row])) < 0:
                return
        if row != last:
            self._mark(last, "")  # it has an earlier one

    def _put_what_stays(self, row: int, previous: Rows) -> None:
        """Put the last shape before one that has to be built: it stays if that can't be."""
        kinds = self._markers.type
        if kinds[row] in IMMEDIATE:
            return
        while row >= 0 and kinds[row] not in IMMEDIATE:
            row = int(previous[row])
        if row >= 0:
            self._put_rows(np.array([row]), self._put)

    def _put_rows(self, rows: Rows, put: Callable[[Rows], None]) -> bool:
        """Call ``put`` on all rows or, where that fails, on fewer; return whether none failed."""

        def fail(row: int, error: RefusedError) -> None:
            self._refuse(np.array([row]), error, marks=True)

        def name(row: int) -> str:
            return name_from_key(self._markers.key(row))

        return put_rows(rows, put, fail, self._objects.guard, "input objects", name)

    def _touch(self, rows: Rows) -> None:
        """Extend objects whose shapes are unchanged."""
        slots = self._find_slots(rows)
        self._shapes.touch(slots, self._markers.expiry[rows])
        self._store(rows, slots)

    def _put_many(self, rows: Rows) -> None:
        """Add objects of primitive shapes, or change them."""
        m, keys = self._markers, self._keys(rows)
        columns = m.type[rows], m.scales[rows], m.poses[rows], m.expiry[rows]
        self._store(rows, self._shapes.put_primitives(keys, *columns))

    def _put(self, rows: Rows) -> None:
        """Add the object of one marker of any type, or change it."""
        row = int(rows[0])
        expiry = int(self._markers.expiry[row])
        slot = self._shapes.put_planned(self._markers.key(row), self._plan(row), expiry)
        self._store(rows, np.array([slot]))

    def _plan(self, row: int) -> ShapePlan:
        """Return how to get the shape of a marker; RefusedError where it has none.

        Of copies: a view would hold the whole message in memory.
        """
        if row not in self._plans:
            markers = self._markers
            part, at = markers.parts[markers.part[row]], int(markers.row[row])
            shape = MarkerShape(
                int(markers.type[row]),
                markers.scales[row].copy(),
                part.points("points", at).copy(),
                part.text("mesh", at).decode(errors="replace"),
                part.text("file", at).decode(errors="replace"),
                part.text("content", at),
            )
            self._plans[row] = plan_shape(shape)
        return self._plans[row]

    def _store(self, rows: Rows, slots: Rows) -> None:
        """Store the poses of markers, those of the same frame together."""
        markers, states = self._markers, self._objects.states
        self._table.maker[slots] = markers.sender[rows]
        of = markers.frame.of[rows]
        for index in np.unique(of).tolist():
            rows_there = rows[of == index]
            state = State(
                markers.frame.texts[index],
                markers.stamp[rows_there],
                markers.received[rows_there],
                sender=markers.sender[rows_there],
            )
            kinds = self._kinds[rows_there]
            states.store(slots[of == index], markers.poses[rows_there], state, kinds=kinds)
        table = self._table
        table.repeated[slots[self._again[rows]]] = True
        table.order[slots] = np.maximum(table.order[slots], self._orders[rows])
        locked = markers.locked[rows]
        if locked.any():
            states.lock(slots[locked])
