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


"""The objects of sets of boxes: added, changed, and removed when a set lacks them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.node.inputs.marker_batch import GOOD, Faults
from obb_collision.node.inputs.pieces import each
from obb_collision.node.messages.conversions import Key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import namespace_number, stand_in
from obb_collision.node.objects.conditions import POSE_REFUSED, SHAPE_REFUSED
from obb_collision.node.objects.many import have_shapes, put_primitives, touch_slots
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.states import OLDER, State
from obb_collision.node.objects.table import NEVER
from obb_collision.node.objects.unplaceable import MAX_UNPLACEABLE
from obb_collision.node.runtime.guard import Guard
from obb_collision.typing import Floats, Mask, Rows


class Source(NamedTuple):
    """An input of complete sets: its topic, the namespace of boxes without one, its number."""

    topic: str
    namespace: str
    number: int


BOXES = Source("object_boxes", "boxes", 1)
REPEATED = RefusedError("repeated", "the last row of an object counts")
BAD_KEY = RefusedError("bad key", "ns and id must be int32")
UNMARKED = (REPEATED.reason, BAD_KEY.reason)
"""Reasons that do not concern an object: another row has the same key, or the key is invalid."""
OWNED = RefusedError("object of another input", "markers, boxes and robots do not share objects")


class BoxSet:
    """Updates the objects that were added by sets of boxes to the newest set."""

    def __init__(self, objects: Objects, guard: Guard, source: Source = BOXES) -> None:
        self._objects, self._guard, self._source = objects, guard, source
        self._table = objects.table
        self._unplaceable: list[Key] = []  # new objects of the last set that were refused

    def key(self, number: int, ident: int) -> Key:
        """Key of a box, by the number of its namespace, and its id."""
        return self._table.namespaces.names.get(number, stand_in(number)), ident

    @property
    def _own(self) -> Mask:
        """(rows,) the objects of these sets."""
        return np.asarray(self._table.live & (self._table.of_set == self._source.number))

    def doubt(self) -> None:
        """Mark that a newer set could not be used: the boxes of the last one stay."""
        self._table.mark(np.flatnonzero(self._own), POSE_REFUSED)

    def refuse(self, numbers: Rows, ids: Rows, reason: str) -> None:
        """Mark that a set could not be used, with the boxes in it that are not known yet."""
        self.doubt()
        new = np.flatnonzero(self._table.find(numbers, ids) < 0)
        self._refuse_new(numbers[new], ids[new], reason)

    def apply(
        self, numbers: Rows, ids: Rows, poses: Floats, sizes: Floats, faults: Faults, state: State
    ) -> None:
        """Bring the objects in line with a set of keys (n,), poses (n, 7) and sizes (n, 3).

        What else is found to be wrong is noted in ``faults``, with those that are known already.
        """
        table = self._table
        slots = table.find(numbers, ids)
        faults.note((slots >= 0) & ~self._own[slots], OWNED)
        self._forget_unplaceable()

        def fail(row: int, error: RefusedError) -> None:
            faults.note(np.arange(len(ids)) == row, error, of_shape=True)

        with self._removed(slots), self._room(numbers, slots, faults):

            def put(rows: Rows) -> None:
                slots[rows] = self._put(numbers[rows], ids[rows], poses[rows], sizes[rows])

            rows = np.flatnonzero(faults.number == GOOD)
            each(rows, put, fail, self._guard, f"input {self._source.topic}")
        rows = np.flatnonzero(faults.number == GOOD)
        old = np.zeros(len(ids), np.bool_)
        old[rows] = self._objects.states.store(slots[rows], poses[rows], state)
        self._mark(numbers, ids, slots, faults)
        faults.note(old, RefusedError(OLDER, "a newer pose is known"))

    @contextmanager
    def _removed(self, slots: Rows) -> Iterator[None]:
        """Remove the boxes at other slots than these, in the scene once others may take theirs."""
        shapes, gone = self._objects.shapes, self._own
        gone[slots[slots >= 0]] = False
        shapes.release(np.flatnonzero(gone))
        try:
            yield
        finally:
            shapes.scene.remove_indices(shapes.strangers())
            self._objects.declare_empty()

    def _put(self, numbers: Rows, ids: Rows, poses: Floats, sizes: Floats) -> Rows:
        """Create boxes, and resize those that have other sizes; returns their slots."""
        table, shapes = self._table, self._objects.shapes
        slots, kinds = table.find(numbers, ids), np.full(len(ids), Marker.CUBE)
        same = slots >= 0
        never = np.full(len(ids), NEVER)
        if same.any():
            same &= have_shapes(table, slots, kinds, sizes)
            touch_slots(shapes, slots[same], never[same])
        rest = np.flatnonzero(~same)
        if len(rest):
            keys = numbers[rest], ids[rest], kinds[rest]
            given = sizes[rest], poses[rest], never[rest]
            slots[rest] = put_primitives(shapes, *keys, *given, shapes.strangers())
            table.of_set[slots[rest]] = self._source.number
        return slots

    @contextmanager
    def _room(self, numbers: Rows, slots: Rows, faults: Faults) -> Iterator[None]:
        """Make room in the tables for new boxes; those beyond are noted in ``faults``."""
        table, admitted = self._table, []
        new = (slots < 0) & (faults.number == GOOD)
        most = self._objects.shapes.max_objects
        surplus = np.flatnonzero(new)[max(0, most - len(table)) :]
        if len(surplus):
            new[surplus] = False
            full = RefusedError("too many objects", f"{most} is the limit")
            faults.note(np.isin(np.arange(len(new)), surplus), full, of_shape=True)
        refused: dict[str, tuple[RefusedError, list[int]]] = {}
        for number in np.unique(numbers[new]).tolist():
            try:
                self._admit(number)
                table.namespaces.use(number)  # so that it stays till its objects are there
                admitted.append(number)
            except RefusedError as error:
                refused.setdefault(error.reason, (error, []))[1].append(number)
        for reason, several in refused.values():
            faults.note(new & np.isin(numbers, several), reason, of_shape=True)
        try:
            yield
        finally:
            for number in admitted:
                table.namespaces.leave(number)

    def _admit(self, number: int) -> None:
        if number == namespace_number(self._source.namespace):
            self._table.namespaces.admit(self._source.namespace)
        else:
            self._table.namespaces.admit_number(number)

    def _mark(self, numbers: Rows, ids: Rows, slots: Rows, faults: Faults) -> None:
        """Mark boxes whose latest row can't be used, and remember those that are not there."""
        for index, error in enumerate(faults.errors):
            rows = np.flatnonzero(faults.number == index)
            if error.reason in UNMARKED:
                continue
            known = slots[rows] >= 0
            known[known] = self._own[slots[rows[known]]]
            event = SHAPE_REFUSED if faults.of_shape[index] else POSE_REFUSED
            self._table.mark(slots[rows[known]], event)
            self._refuse_new(numbers[rows[~known]], ids[rows[~known]], error.reason)

    def _refuse_new(self, numbers: Rows, ids: Rows, reason: str) -> None:
        numbers, ids = numbers[-MAX_UNPLACEABLE:], ids[-MAX_UNPLACEABLE:]
        pairs = zip(numbers.tolist(), ids.tolist(), strict=True)
        for key in [self.key(*pair) for pair in pairs]:
            self._objects.shapes.unplaceable.add(key, reason, of_set=True)
            self._unplaceable.append(key)
        del self._unplaceable[:-MAX_UNPLACEABLE]

    def _forget_unplaceable(self) -> None:
        for key in self._unplaceable:
            self._objects.shapes.unplaceable.forget(key)
        self._unplaceable.clear()
