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

"""The store of objects: names and slots, local boxes, poses, and the world boxes they make.

A structure of arrays with one row (slot) per object. A slot keeps its number while the object
lives; freed slots are used again, the lowest first. Arrays grow by doubling. A change of a store
either happens or does not: what can fail comes before the first write.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.accuracy import Accuracy
from obb_collision.scene.store.completed import completed
from obb_collision.scene.store.placed import (
    LocalBoxes,
    PlacedBoxes,
    as_slice,
    doubled,
    extents,
    placed,
)
from obb_collision.typing import Floats, Mask, Rows
from obb_collision.words import shown

FIRST_CAPACITY = 16
NO_ROWS: Rows = np.empty(0, np.int64)
_versions = count(1)


class ObjectStore(PlacedBoxes):
    """Named objects, each with a local box and a pose; ``changed`` marks what moved."""

    def __init__(self) -> None:
        super().__init__(FIRST_CAPACITY)
        self.slots: dict[str, int] = {}
        self.version = next(_versions)  # changes with the names; no two stores share one
        self._name_tuple: tuple[int, tuple[str | None, ...]] = (0, ())
        self._lowest = 0  # all slots before it are in use
        self.names: list[str | None] = [None] * FIRST_CAPACITY
        self.enabled = np.zeros(FIRST_CAPACITY, np.bool_)  # used, and to take part in collisions
        self.near = np.zeros(FIRST_CAPACITY, np.bool_)  # to the region that is checked
        self.active = np.zeros(FIRST_CAPACITY, np.bool_)  # enabled and near: takes part
        self.accuracies = np.zeros(FIRST_CAPACITY, np.int8)
        self.levelled = np.zeros(FIRST_CAPACITY, np.bool_)  # with an accuracy of their own
        self.kinds = np.zeros(FIRST_CAPACITY, np.int8)  # see ``kinds``
        self.twists = np.zeros((FIRST_CAPACITY, 6))
        self.born = np.zeros(FIRST_CAPACITY, np.int64)  # version in which the object came

    def _grow(self) -> None:
        """Double the arrays: all are there before the first takes its place, in one step."""
        columns = {k: value for k, value in vars(self).items() if isinstance(value, np.ndarray)}
        names = [*self.names, *[None] * len(self.names)]
        vars(self).update(doubled(columns), names=names, _lent=[], _shared=set())

    def free_rows(self, count: int) -> Rows:
        """Return the lowest slots (count,) that are not in use; there is room for them now."""
        while len(self.slots) + count > len(self.used):
            self._grow()
        first = self._lowest + int(self.used[self._lowest :].argmin()) if count else 0
        self._lowest = first
        if count == 1:  # at once, however many there are
            return np.array([first])
        return first + np.flatnonzero(~self.used[first:])[:count]

    def __len__(self) -> int:
        return len(self.slots)

    def slot(self, name: str) -> int:
        """Return the slot of a name; KeyError naming it if there is none."""
        slot = self.slots.get(name) if isinstance(name, str) else None
        if slot is None:
            raise KeyError(f"no object named {shown(name)}")
        return slot

    def name_tuple(self) -> tuple[str | None, ...]:
        """Return the names by slot, None where there is no object."""
        if self._name_tuple[0] != self.version:
            self._name_tuple = self.version, tuple(self.names)
        return self._name_tuple[1]

    def enable(self, rows: Rows | slice | int, enabled: ArrayLike) -> None:
        """Let objects take part in collisions, or not."""
        self.enabled[rows] = enabled
        self.active[rows] = self.enabled[rows] & self.near[rows]

    def set_near(self, rows: Rows, near: Mask) -> None:
        """Set which objects are near to the region that is checked; the others take no part."""
        differ = self.near[rows] != near
        self.mark(rows[differ])
        self.near[rows] = near
        self.active[rows] = self.enabled[rows] & near

    def live(self) -> Rows:
        """Return the slots in use, ascending."""
        return np.flatnonzero(self.used)

    def with_shapes(self) -> ObjectStore:
        """Return a copy whose kinds, sizes, paddings and accuracies stay as they are."""
        self._shared.update(("kinds", "accuracies", "paddings", "local_half_extents"))
        return copy(self)

    def with_body(
        self, local_boxes: LocalBoxes, pose: Floats, padding: float, kind: int, level: Accuracy
    ) -> tuple[ObjectStore, int]:
        """Return a copy with a body besides, in a slot that no object has, for a question.

        It shares the arrays, in which no object changes.
        """
        columns: dict[str, Any] = {**placed(local_boxes, pose[None], "pose")}
        columns |= extents(local_boxes[2], np.array([padding]), np.zeros(1))
        rows = self.free_rows(1)
        self._part(rows)  # a snapshot may know an object that was there
        body = copy(self)
        body._lent, body.enabled = [], self.enabled.copy()
        body.changed, body.active = self.changed.copy(), self.active.copy()
        body.write(rows, {**columns, "kinds": kind, "accuracies": level})
        body.enabled[rows] = body.active[rows] = True
        return body, int(rows[0])

    @completed
    def put(
        self,
        rows: Rows,
        columns: Mapping[str, Any],
        new: Rows,
        names: Sequence[str],
        gone: Sequence[str] = (),
    ) -> None:
        """Write columns of slots, of which new ones get names; all are enabled.

        names: of ``new``, which no other object has. gone: of the objects that had such slots.
        All or, should memory end, none.
        """
        begun = as_slice(new)
        self._part(rows)
        try:
            self.slots.update(zip(names, new.tolist(), strict=True))
        except MemoryError:
            for name in names:
                self.slots.pop(name, None)
            raise
        self._assign(rows, columns)
        for before in gone:
            self.slots.pop(before, None)
        for slot, name in zip(new.tolist(), names, strict=True):
            self.names[slot] = name
        if len(new):
            self.version = next(_versions)
            self.used[begun], self.near[begun], self.born[begun] = True, True, self.version
            self.twists[begun] = 0.0
        self.enable(as_slice(rows), True)

    @completed
    def rename(self, rows: Rows, names: Sequence[str]) -> None:
        """Give objects other names, all new and distinct."""
        slots, by_slot = dict(self.slots), list(self.names)
        for slot, name in zip(rows.tolist(), names, strict=True):
            slots.pop(by_slot[slot], None)
            slots[name], by_slot[slot] = slot, name
        self.mark(rows)
        self.version, self.slots, self.names = next(_versions), slots, by_slot

    @completed
    def renew(self, rows: Rows) -> None:
        """Make objects new ones, as if each had been removed and added again with its pose."""
        self.version = next(_versions)
        self.mark(rows)
        self.born[rows], self.twists[rows] = self.version, 0.0

    @completed
    def remove_rows(self, rows: Rows) -> None:
        """Remove objects by their slots, all in use and distinct."""
        if len(rows) == 0:
            return
        slots = rows.tolist()
        self.version = next(_versions)
        self.mark(rows)
        self._lowest = min(self._lowest, *slots)
        for slot in slots:
            self.slots.pop(self.names[slot], None)
            self.names[slot] = None
        self.used[rows] = False
        self.enable(rows, False)

    def slots_of(self, names: Iterable[str]) -> Rows:
        """Return the slots of names; KeyError naming the first unknown one."""
        several = isinstance(names, Iterable) and getattr(names, "ndim", 1) > 0
        if isinstance(names, str) or not several:
            raise TypeError(f"names must be several names, got {shown(names)}")
        return np.array([self.slot(name) for name in names], np.int64)
