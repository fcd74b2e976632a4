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

"""Markers -> objects: those with the shapes they had, those of a formula, and all others singly."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import numpy as np

from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs.marker_batch import (
    MAX_TRIES,
)
from obb_collision.node.inputs.marker_rows import Gathered
from obb_collision.node.inputs.pieces import each
from obb_collision.node.messages.conversions import name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_kernels import FILE, MESH
from obb_collision.node.messages.shape_plans import IMMEDIATE, MarkerShape, Plan, plan_shape
from obb_collision.node.objects.many import (
    have_shapes,
    put_primitives,
    touch_slots,
)
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.states import OLDER, State
from obb_collision.node.objects.table import NEVER, PRIMITIVES
from obb_collision.node.runtime.guard import Guard
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
