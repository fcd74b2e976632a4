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
lives; freed slots are used again, the lowest first. Arrays grow by doubling.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from itertools import count

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import as_poses
from obb_collision.scene.store.placed import PlacedBoxes, as_slice
from obb_collision.typing import Floats, Mask, Rows
from obb_collision.words import shown

LocalBox = tuple[Floats, Floats, Floats]

FIRST_CAPACITY = 16
NO_ROWS: Rows = np.empty(0, np.int64)
_versions = count(1)


class ObjectStore(PlacedBoxes):
    """Named objects, each with a local box and a pose; ``changed`` marks what moved."""

    def __init__(self) -> None:
        self.slots: dict[str, int] = {}
        self.version = next(_versions)  # changes with the names; no two stores share one
        self._name_tuple: tuple[int, tuple[str | None, ...]] = (0, ())
        self._free: list[int] = []
        super().__init__(FIRST_CAPACITY)

    def _allocate(self, capacity: int) -> None:
        super()._allocate(capacity)
        self.names: list[str | None] = [None] * capacity
        self.enabled = np.zeros(capacity, np.bool_)  # used, and to take part in collisions
        self.near = np.ones(capacity, np.bool_)  # to the region that is checked
        self.active = np.zeros(capacity, np.bool_)  # enabled and near: takes part
        self.accuracies = np.full(capacity, Accuracy.OBB, np.int8)
        self.kinds = np.zeros(capacity, np.int8)  # see ``kinds``
        self.twists = np.zeros((capacity, 6))
        self.born = np.zeros(capacity, np.int64)  # version in which the object came
        self._free = list(range(capacity))

    def _grow(self) -> None:
        size = len(self.names)
        before = vars(self).copy()
        self._allocate(2 * size)
        for key, value in before.items():
            if isinstance(value, np.ndarray):
                getattr(self, key)[:size] = value
        self.names[:size] = before["names"]
        self._free = [*before["_free"], *range(size, 2 * size)]

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

    def enable(self, rows: Rows | int, enabled: ArrayLike) -> None:
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

    def put(self, name: str, local_box: LocalBox, pose: Floats, padding: float) -> int:
        """Add an object, or replace the one of that name in its slot; return the slot."""
        positions, rotations = as_poses(pose[None], "pose")
        slot = self.slots.get(name)
        if slot is None:
            self.version = next(_versions)
            if not self._free:
                self._grow()
            slot = heapq.heappop(self._free)
            self.slots[name] = slot
            self.names[slot] = name
            self.used[slot] = self.near[slot] = True
            self.born[slot] = self.version
            self.twists[slot] = self.growths[slot] = 0.0
        self.local_centers[slot], self.local_rotations[slot], extents = local_box
        self.local_half_extents[slot] = extents
        self.poses[slot] = pose
        self.enable(slot, True)
        rows = np.array([slot])
        self._place(rows, positions, rotations)
        self.pad(rows, padding)
        return slot

    def put_boxes(
        self, names: Sequence[str], half_extents: Floats, poses: Floats, padding: float | Floats
    ) -> Rows:
        """Add boxes (n,) about their origins, or replace the objects of those names; all distinct.

        Returns their slots; all or, on a ValueError, none.
        """
        positions, rotations = as_poses(poses)
        self.begin([name for name in names if name not in self.slots])
        slots = np.array([self.slots[name] for name in names], np.int64)
        self.poses[slots] = poses
        self.enable(slots, True)
        self.shape_boxes(slots, half_extents, padding)
        self._place(slots, positions, rotations)
        return slots

    def begin(self, names: Sequence[str], instead: Rows = NO_ROWS) -> Rows:
        """Begin objects of new names, all distinct; returns their slots, without box and pose.

        instead: slots of objects that go: the first ones are used for those that come.
        """
        if len(names) == 0:
            return NO_ROWS
        self.version = next(_versions)
        instead = instead[: len(names)]
        self.mark(instead)
        taken = instead.tolist()
        for slot in taken:
            del self.slots[self.names[slot]]
        taken += self._take_free(len(names) - len(taken))
        self.slots.update(zip(names, taken, strict=True))
        for name, slot in zip(names, taken, strict=True):
            self.names[slot] = name
        slots = np.array(taken, np.int64)
        rows = as_slice(slots)
        self.used[rows], self.near[rows], self.born[rows] = True, True, self.version
        self.enabled[rows] = self.active[rows] = True
        self.twists[rows] = self.growths[rows] = 0.0
        return slots

    def _take_free(self, count: int) -> list[int]:
        """Return slots that are not in use, the lowest first; they are from now on."""
        while len(self._free) < count:
            self._grow()
        self._free.sort()  # a sorted list is a heap
        free = self._free[:count]
        del self._free[:count]
        return free

    def shape_boxes(
        self, rows: Rows, half_extents: Floats, padding: float | Floats | None = None
    ) -> None:
        """Make objects boxes about their origins; where they are is not computed anew.

        padding: None for what they have.
        """
        some = as_slice(rows)
        self.local_centers[some], self.local_rotations[some] = 0.0, np.eye(3)
        self.local_half_extents[some] = half_extents
        if padding is None:
            self._extend(rows)
        else:
            self.pad(rows, padding)

    def rename(self, rows: Rows, names: Sequence[str]) -> None:
        """Give objects other names, all new and distinct."""
        self.version = next(_versions)
        for slot, name in zip(rows.tolist(), names, strict=True):
            del self.slots[str(self.names[slot])]
            self.slots[name], self.names[slot] = slot, name
        self.mark(rows)

    def renew(self, rows: Rows) -> None:
        """Make objects new ones, as if each had been removed and added again with its pose."""
        self.version = next(_versions)
        self.born[rows], self.twists[rows] = self.version, 0.0
        self.mark(rows)

    def remove(self, name: str) -> int:
        """Remove an object; return the slot it had."""
        slot = self.slot(name)
        self.version = next(_versions)
        del self.slots[name]
        self.names[slot] = None
        self.mark(slot)
        self.used[slot] = False
        self.enable(slot, False)
        heapq.heappush(self._free, slot)
        return slot

    def remove_rows(self, rows: Rows) -> None:
        """Remove objects by their slots, all in use and distinct."""
        if len(rows) == 0:
            return
        self.version = next(_versions)
        for slot in rows.tolist():
            name = self.names[slot]
            assert name is not None
            del self.slots[name]
            self.names[slot] = None
        self.mark(rows)
        self.used[rows] = False
        self.enable(rows, False)
        self._free = sorted([*self._free, *rows.tolist()])  # a sorted list is a heap

    def slots_of(self, names: Iterable[str]) -> Rows:
        """Return the slots of names; KeyError naming the first unknown one."""
        several = isinstance(names, Iterable) and getattr(names, "ndim", 1) > 0
        if isinstance(names, str) or not several:
            raise TypeError(f"names must be several names, got {shown(names)}")
        return np.array([self.slot(name) for name in names], np.int64)
