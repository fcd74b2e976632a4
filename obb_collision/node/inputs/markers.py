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

A sender that is faster than the cycles can't hold them up or make the node grow: what waits is
bounded in bytes and applied early beyond that, and however many states of an object wait, one of
them is looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs.batch import (
    GOOD,
    MAX_TRIES,
    Faults,
    Gathered,
    Outcome,
    each,
    find_faults,
    gather,
    join,
    remaining,
    settle,
)
from obb_collision.node.inputs.boxes import OWNED
from obb_collision.node.messages.conversions import name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_scan import ACTION, FILE, MESH, NS, Scanned, scan_markers
from obb_collision.node.messages.marker_shapes import (
    ANNOTATIONS,
    IMMEDIATE,
    MarkerShape,
    Plan,
    plan_shape,
)
from obb_collision.node.objects.conditions import LIVE, UNPLACED
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.refusals import UnknownObjects
from obb_collision.node.objects.shapes import have_shapes, put_primitives, renew_slots, touch_slots
from obb_collision.node.objects.states import OLDER, State
from obb_collision.node.objects.table import NEVER, PRIMITIVES
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard
from obb_collision.typing import Mask, Rows

NO_NUMBER = -(1 << 40)
"""In place of the number of a namespace that is not in the table; no namespace has it."""


class MarkerAdder:
    """Gives objects the shapes and poses of markers, at a time (ns)."""

    def __init__(self, objects: Objects, monitor: InputMonitor, guard: Guard, now: int) -> None:
        self._objects, self._monitor, self._guard, self._now = objects, monitor, guard, now
        self._plans: dict[int, Plan] = {}

    def refuse(self, markers: Gathered, rows: Rows, error: RefusedError) -> None:
        """Count refused markers."""
        if len(rows):
            item = name_from_key(markers.key(int(rows[-1])))
            self._monitor.refuse(self._now, error.reason, item, error.detail, len(rows))

    def number_of(self, namespace: str) -> int:
        """Return the number of a namespace in the table, NO_NUMBER for none."""
        number = self._objects.table.namespaces.find(namespace)
        return NO_NUMBER if number is None else number

    def find_slots(self, markers: Gathered, rows: Rows) -> Rows:
        """Return the slots of the objects of markers, -1 for none."""
        return self._objects.table.find(self._numbers(markers, rows), markers.id[rows])

    def _numbers(self, markers: Gathered, rows: Rows) -> Rows:
        """Return the numbers of the namespaces of markers, NO_NUMBER for none in the table."""
        numbers = [
            NO_NUMBER if index in markers.bad_namespaces else self.number_of(name)
            for index, name in enumerate(markers.namespaces)
        ]
        return np.array(numbers, np.int64)[markers.ns[rows]]

    def have_shapes(self, markers: Gathered, rows: Rows, slots: Rows) -> Mask:
        """Return which objects (n,), -1 for none, have the shapes of primitive markers."""
        same = (slots >= 0) & np.isin(markers.type[rows], PRIMITIVES)
        some = rows[same]
        same[same] = have_shapes(
            self._objects.table, slots[same], markers.type[some], markers.scales[some]
        )
        return same

    def have_built_shapes(self, markers: Gathered, rows: Rows, slots: Rows) -> Mask:
        """Return which objects have the shapes of markers, where those take time to build."""
        same = np.zeros(len(rows), np.bool_)
        for index in np.flatnonzero(~np.isin(markers.type[rows], IMMEDIATE)).tolist():
            with suppress(Exception):  # reported when it is added
                signature = self._plan(markers, int(rows[index])).signature
                same[index] = self._objects.table.signatures.get(int(slots[index])) == signature
        return same

    def add(self, markers: Gathered, rows: Rows, slots: Rows, previous: Rows) -> None:
        """Give objects the shapes and poses of markers."""
        current = ~self._are_old(markers, rows, slots)
        rows, slots = rows[current], slots[current]
        same = self.have_shapes(markers, rows, slots)
        self._each(markers, rows[same], lambda some: self._touch(markers, some))
        simple = ~same & np.isin(markers.type[rows], PRIMITIVES)
        with self._room(markers, rows[simple], slots[simple]) as admitted:
            self._each(markers, rows[simple][admitted], lambda some: self._put_many(markers, some))
        for row in rows[~same & ~simple].tolist():
            self._put_one_of(markers, row, previous)

    def _put_one_of(self, markers: Gathered, last: int, previous: Rows) -> None:
        """Give an object the last of its states that can be built."""
        self._put_what_stays(markers, last, previous)
        row = last
        for _ in range(MAX_TRIES):
            if self._each(markers, np.array([row]), lambda one: self._put(markers, int(one[0]))):
                break
            row = int(previous[row])
            if row < 0:
                return
        if row != last:
            self._objects.shapes.refuse(
                markers.key(last), "", shape=True, expiry=int(markers.expiry[last])
            )  # what it has is not the last

    def _put_what_stays(self, markers: Gathered, row: int, previous: Rows) -> None:
        """Put the last shape before one that has to be built: it stays if that can't be."""
        if markers.type[row] in IMMEDIATE:
            return
        while row >= 0 and markers.type[row] not in IMMEDIATE:
            row = int(previous[row])
        if row >= 0:
            self._each(markers, np.array([row]), lambda one: self._put(markers, int(one[0])))

    def _are_old(self, markers: Gathered, rows: Rows, slots: Rows) -> Mask:
        """Return which states are older than those their objects have; they are counted."""
        old = self._objects.states.find_late(slots, markers.stamp[rows], markers.received[rows])
        self.refuse(markers, rows[old], RefusedError(OLDER, "a newer state is known"))
        return old

    @contextmanager
    def _room(self, markers: Gathered, rows: Rows, slots: Rows) -> Iterator[Mask]:
        """Give for which objects (n,) there is room in the tables; new ones beyond are refused."""
        objects, table = self._objects, self._objects.table
        admitted, numbers = np.ones(len(rows), np.bool_), []
        for index in np.unique(markers.ns[rows[slots < 0]]).tolist():
            try:
                numbers.append(table.namespaces.admit(markers.namespaces[index]))
                table.namespaces.use(numbers[-1])  # so that it stays till its objects are there
            except RefusedError as error:
                bad = (slots < 0) & (markers.ns[rows] == index)
                self.mark(markers, rows[bad], error)
                admitted &= ~bad
        surplus = np.flatnonzero(admitted & (slots < 0))[
            max(0, objects.shapes.max_objects - len(table)) :
        ]
        if len(surplus):
            full = RefusedError("too many objects", f"{objects.shapes.max_objects} is the limit")
            self.mark(markers, rows[surplus], full)
            admitted[surplus] = False
        try:
            yield admitted
        finally:
            for number in numbers:
                table.namespaces.leave(number)

    def mark(self, markers: Gathered, rows: Rows, error: RefusedError) -> None:
        """Count refused states, and mark their objects."""
        self.refuse(markers, rows, error)
        for row in rows.tolist():
            expiry = int(markers.expiry[row])
            self._objects.shapes.refuse(markers.key(row), error.reason, shape=True, expiry=expiry)

    def _each(self, markers: Gathered, rows: Rows, put: Callable[[Rows], None]) -> bool:
        """Call ``put`` on all rows or, where that fails, on fewer; return whether none failed."""
        return each(
            *(rows, put, lambda row, error: self.mark(markers, np.array([row]), error)),
            *(self._guard, "input objects", lambda row: name_from_key(markers.key(row))),
        )

    def _touch(self, markers: Gathered, rows: Rows) -> None:
        slots = self.find_slots(markers, rows)
        touch_slots(self._objects.shapes, slots, markers.expiry[rows])
        self._store(markers, rows, slots)

    def _put_many(self, markers: Gathered, rows: Rows) -> None:
        slots = put_primitives(
            self._objects.shapes,
            self._numbers(markers, rows),
            markers.id[rows],
            *(markers.type[rows], markers.scales[rows], markers.poses[rows], markers.expiry[rows]),
        )
        self._store(markers, rows, slots)

    def _put(self, markers: Gathered, row: int) -> None:
        """Add one object of any type, or change it."""
        expiry = int(markers.expiry[row])
        slot = self._objects.shapes.take(
            markers.key(row), self._plan(markers, row), None if expiry == NEVER else expiry
        )
        self._store(markers, np.array([row]), np.array([slot]))

    def _plan(self, markers: Gathered, row: int) -> Plan:
        """Return how to get the shape of a marker; RefusedError where it has none."""
        if row not in self._plans:
            self._plans[row] = plan_shape(_shape(markers, row))
        return self._plans[row]

    def _store(self, markers: Gathered, rows: Rows, slots: Rows) -> None:
        """Store the poses of markers, those of the same frame together."""
        for index in np.unique(markers.frame[rows]).tolist():
            some = markers.frame[rows] == index
            given = rows[some]
            state = State(markers.frames[index], markers.stamp[given], markers.received[given])
            self._objects.states.store(slots[some], markers.poses[given], state)
        locked = markers.locked[rows]
        if locked.any():
            self._objects.states.lock(slots[locked])


def _shape(markers: Gathered, row: int) -> MarkerShape:
    """Return the shape of a marker as a copy: a view would hold the whole message in memory."""
    kind, scale = int(markers.type[row]), markers.scales[row].copy()
    if markers.source[row] < 0:  # nothing else of these is stored
        return MarkerShape(kind, scale)
    part, at = markers.sources[markers.source[row]], int(markers.row[row])
    return MarkerShape(
        kind,
        scale,
        part.points(at).copy(),
        part.text(at, MESH).decode(errors="replace"),
        part.text(at, FILE).decode(errors="replace"),
        bytes(part.content(at)),
    )


class MarkerApplication:
    """Applies markers at a time (ns)."""

    def __init__(
        self,
        objects: Objects,
        monitor: InputMonitor,
        guard: Guard,
        now: int,
        unknown: UnknownObjects,
    ) -> None:
        self._objects, self._now, self._unknown = objects, now, unknown
        self._adder = MarkerAdder(objects, monitor, guard, now)

    def settle(self, markers: Gathered) -> tuple[Faults, Outcome]:
        """Return the faults of markers, which are counted, and their outcome."""
        faults = find_faults(markers, self._objects.placement.frame_index)
        outcome = settle(markers, faults, self._now, self._objects.states.stamp_tolerance)
        for number, error in enumerate(faults.errors):
            bad = (faults.number == number) & ~markers.counted
            self._adder.refuse(markers, np.flatnonzero(bad), error)
        late = outcome.late & ~markers.counted
        self._adder.refuse(markers, np.flatnonzero(late), RefusedError(OLDER))
        new = (markers.action == Marker.ADD) & (faults.number == GOOD) & ~markers.counted
        new[outcome.winner[outcome.winner >= 0]] = False
        self._objects.states.superseded["objects"] += int(np.count_nonzero(new & ~outcome.late))
        markers.counted[:] = True
        return faults, outcome

    def run(self, markers: Gathered, faults: Faults, outcome: Outcome) -> None:
        """Apply them."""
        objects = self._objects
        outcome = self._without_boxes(markers, outcome)
        slots = self._remove(markers, outcome)
        there = np.flatnonzero(outcome.winner >= 0)
        there = there[np.argsort(outcome.winner[there])]
        self._adder.add(markers, outcome.winner[there], slots[there], outcome.previous)
        for row in outcome.bad[outcome.bad >= 0].tolist():
            number = faults.number[row]
            error, of_shape = faults.errors[number], faults.of_shape[number]
            expiry = int(markers.expiry[row])
            objects.shapes.refuse(markers.key(row), error.reason, of_shape, expiry)

    def _without_boxes(self, markers: Gathered, outcome: Outcome) -> Outcome:
        """Exclude, and count, markers that name objects of sets of boxes, or links of robots."""
        table = self._objects.table
        slots = self._adder.find_slots(markers, outcome.first)
        owned = (slots >= 0) & ((table.of_set[slots] > 0) | table.of_robot[slots])
        if not owned.any():
            return outcome
        winner, removed = outcome.winner[owned], outcome.removed[owned]
        self._adder.mark(markers, winner[winner >= 0], OWNED)
        self._adder.refuse(markers, outcome.remover[owned][removed & (winner < 0)], OWNED)
        return outcome._replace(
            first=outcome.first[~owned],
            winner=outcome.winner[~owned],
            bad=outcome.bad[~owned],
            removed=outcome.removed[~owned],
            remover=outcome.remover[~owned],
        )

    def _remove(self, markers: Gathered, outcome: Outcome) -> Rows:
        """Take out what was there and is deleted; return the slots (k,) of the rest, -1 for none.

        What is deleted and comes again as it was, in the fixed frame, stays in its place.
        """
        objects, table = self._objects, self._objects.table
        added, deletes = markers.action == Marker.ADD, markers.action == Marker.DELETE
        added &= ~np.isin(markers.type, ANNOTATIONS)
        everything = markers.ns[markers.action == Marker.DELETEALL]
        was_something = not objects.is_empty or bool(objects.unplaceable) or added.any()
        doomed = self._deleted_by_all(markers)
        slots = self._adder.find_slots(markers, outcome.first)
        doomed[slots[outcome.removed & (slots >= 0)]] = True
        deleted = [markers.key(row) for row in outcome.first[outcome.removed].tolist()]
        for key in deleted if objects.unplaceable else ():
            objects.shapes.unplaceable.delete(key)
        again = np.flatnonzero((slots >= 0) & (outcome.winner >= 0))
        again = again[doomed[slots[again]]]
        if len(again):
            rows = outcome.winner[again]
            is_fixed = [objects.placement.frame_table.is_fixed(frame) for frame in markers.frames]
            fixed = np.array(is_fixed)[markers.frame[rows]]
            same = self._adder.have_shapes(markers, rows, slots[again])
            same |= self._adder.have_built_shapes(markers, rows, slots[again])
            same &= fixed
            again = again[same & ~table.has(UNPLACED, slots[again])]
            doomed[slots[again]] = False
        gone = np.flatnonzero(doomed & table.live)
        self._unknown.deleted((*deleted, *table.keys(gone)), self._now)
        objects.shapes.remove(gone)
        told = was_something and (len(everything) or deletes.any())
        if told or any(not markers.namespaces[index] for index in everything.tolist()):
            objects.declare_empty()
        renew_slots(objects.shapes, slots[again])
        return np.where((slots >= 0) & table.has(LIVE, slots), slots, -1)

    def _deleted_by_all(self, markers: Gathered) -> Mask:
        """Return which slots are deleted by DELETEALL, of all or of a namespace, as in RViz."""
        objects, table = self._objects, self._objects.table
        doomed = np.zeros(len(table.condition), np.bool_)
        for index in np.unique(markers.ns[markers.action == Marker.DELETEALL]).tolist():
            name = markers.namespaces[index]
            objects.shapes.unplaceable.delete_all(name or None)
            if not name:
                doomed |= table.live
            elif index not in markers.bad_namespaces:
                doomed |= table.live & (table.ns == self._adder.number_of(name))
        return doomed & ~((table.of_set > 0) | table.of_robot)


MAX_WAITING_BYTES = 64 << 20
MAX_WAITING_MESSAGES = 1000


class MarkerInput:
    """Receives messages of ``objects``, and applies their outcome."""

    def __init__(
        self,
        objects: Objects,
        monitor: InputMonitor,
        clock: Callable[[], int],
        guard: Guard,
    ) -> None:
        self._objects, self._monitor, self._clock, self._guard = objects, monitor, clock, guard
        self._waiting: list[tuple[bytes, int]] = []
        self._kept: Gathered | None = None  # of messages before those
        self._size = 0
        self._messages = 0
        self.unknown = UnknownObjects(objects.table)
        """What takes the names of objects that are deleted."""

    def take(self, data: bytes) -> None:
        """Queue a serialised MarkerArray for the next cycle."""
        now = self._clock()
        self._monitor.received(now)
        self._waiting.append((data, now))
        self._size += len(data)
        if self._size > MAX_WAITING_BYTES or len(self._waiting) > MAX_WAITING_MESSAGES:
            self._coalesce()

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self._waiting = [(data, at + shift) for data, at in self._waiting]
        if self._kept is not None:
            self._kept.received += shift
            self._kept.expiry[self._kept.expiry != NEVER] += shift

    def _gather(self) -> Gathered | None:
        """Return all queued messages, and empty the queue.

        The newest message is read first: what comes before a DELETEALL is dropped unread.
        """
        kept, waiting = self._kept, self._waiting
        self._waiting, self._kept, self._size = [], None, 0
        parts: list[Scanned] = []
        received: list[int] = []
        is_read = False
        for data, at in reversed(waiting):
            part = self._scan(data, is_read)
            is_read |= part is not None
            if part is not None and len(part):
                parts.append(part)
                received.append(at)
                if _deletes_all(part):
                    kept = None
                    break
        if not parts:
            return kept
        new = gather(parts[::-1], received[::-1], self._messages)
        self._messages += len(parts)
        return new if kept is None else join(kept, new)

    def _scan(self, data: bytes, is_read_since: bool) -> Scanned | None:
        """Return the markers of a message, None if it is refused.

        is_read_since: whether a newer one could be read.
        """
        now, refuse = self._clock(), self._monitor.refuse_whole
        try:
            return scan_markers(data)
        except RefusedError as error:
            refuse(now, error.reason, error.detail)
        except Exception as error:
            self._guard.caught("input objects", error, "whole message")
            refuse(now, INTERNAL_ERROR, str(error))
        if is_read_since:
            self._monitor.unreadable = ""
        return None

    def _coalesce(self) -> None:
        """Reduce the queue to its outcome, or apply that if it is still too large."""
        markers = self._gather()
        if markers is None:
            return
        _, outcome = self._application().settle(markers)
        self._kept = remaining(markers, outcome)
        self._size = self._kept.nbytes
        if self._size > MAX_WAITING_BYTES // 2:
            self.apply()

    def apply(self) -> None:
        """Apply what waits."""
        markers = self._gather()
        if markers is None or self._run(markers):
            return
        for number in np.unique(markers.message).tolist():  # one that fails takes no other with it
            if not self._run(markers.take(np.flatnonzero(markers.message == number))):
                self._monitor.refuse_whole(self._clock(), INTERNAL_ERROR)
                self._objects.broken = "input objects"

    def _run(self, markers: Gathered) -> bool:
        """Apply markers; return whether that went through."""
        application = self._application()
        return self._guard.run(
            "input objects",
            lambda: application.run(markers, *application.settle(markers)),
            "whole message",
        )

    def _application(self) -> MarkerApplication:
        given = self._objects, self._monitor, self._guard, self._clock()
        return MarkerApplication(*given, self.unknown)


def _deletes_all(scanned: Scanned) -> bool:
    deletes = scanned.integers[:, ACTION] == Marker.DELETEALL
    return bool((deletes & (scanned.integers[:, NS + 1] == 0)).any())
