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
import weakref
from collections.abc import Iterable, Sequence
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes, add_outwards
from obb_collision.geometry.poses import as_poses, place_boxes
from obb_collision.geometry.validation import as_array
from obb_collision.scene.store.moving import UNUSUAL, find_moves, write_moves
from obb_collision.scene.store.snapshot import Snapshot
from obb_collision.typing import Floats, Rows
from obb_collision.words import shown

LocalBox = tuple[Floats, Floats, Floats]

FIRST_CAPACITY = 16
#: Rows below which a second thread doesn't pay: 30 us of moves.
LEAST_MOVES = 1024
#: Snapshots in use that have changes noted; older ones get a copy.
MOST_LENT = 4
_versions = count(1)


class ObjectStore:
    """Named objects, each with a local box and a pose; ``changed`` marks what moved."""

    def __init__(self) -> None:
        self.slots: dict[str, int] = {}
        self.version = next(_versions)  # changes with the names; no two stores share one
        self.revision = 0  # changes with all but poses and twists
        self.touched = False  # whether anything may be marked changed
        self._name_tuple: tuple[int, tuple[str | None, ...]] = (0, ())
        self._free: list[int] = []
        self._allocate(FIRST_CAPACITY)

    def _allocate(self, capacity: int) -> None:
        self.names: list[str | None] = [None] * capacity
        self.used = np.zeros(capacity, np.bool_)
        self.active = np.zeros(capacity, np.bool_)  # used and enabled
        self.changed = np.zeros(capacity, np.bool_)  # since the last check
        self.accuracies = np.full(capacity, Accuracy.OBB, np.int8)
        self.kinds = np.zeros(capacity, np.int8)  # see ``kinds``
        self.paddings = np.zeros(capacity)
        self.poses = np.zeros((capacity, 7))
        self.twists = np.zeros((capacity, 6))
        self.born = np.zeros(capacity, np.int64)  # version in which the object came
        self.local_centers = np.zeros((capacity, 3))
        self.local_rotations = np.zeros((capacity, 3, 3))
        self.local_half_extents = np.zeros((capacity, 3))
        self.centers = np.zeros((capacity, 3))
        self.rotations = np.zeros((capacity, 3, 3))
        self.half_extents = np.zeros((capacity, 3))
        self._lent: list[weakref.ref[Snapshot]] = []
        self._extents_lent = False
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
            self.used[slot] = True
            self.born[slot] = self.version
            self.twists[slot] = 0.0
        self.local_centers[slot], self.local_rotations[slot], extents = local_box
        self.local_half_extents[slot] = extents
        self.poses[slot] = pose
        self.active[slot] = True
        rows = np.array([slot])
        self._place(rows, positions, rotations)
        self.pad(rows, padding)
        return slot

    def put_boxes(
        self, names: Sequence[str], half_extents: Floats, poses: Floats, padding: float
    ) -> Rows:
        """Add boxes (n,) about their origins, or replace the objects of those names; all distinct.

        Returns their slots; all or, on a ValueError, none.
        """
        positions, rotations = as_poses(poses)
        self.begin([name for name in names if name not in self.slots])
        slots = np.array([self.slots[name] for name in names], np.int64)
        self.active[slots], self.poses[slots] = True, poses
        self.shape_boxes(slots, half_extents, padding)
        self._place(slots, positions, rotations)
        return slots

    def begin(self, names: Sequence[str]) -> Rows:
        """Begin objects of new names, all distinct; returns their slots, without box and pose."""
        if len(names) == 0:
            return np.empty(0, np.int64)
        self.version = next(_versions)
        while len(self._free) < len(names):
            self._grow()
        self._free.sort()  # a sorted list is a heap
        free = self._free[: len(names)]
        del self._free[: len(names)]
        self.slots.update(zip(names, free, strict=True))
        for name, slot in zip(names, free, strict=True):
            self.names[slot] = name
        slots = np.array(free, np.int64)
        self.used[slots], self.active[slots], self.born[slots] = True, True, self.version
        self.twists[slots] = 0.0
        return slots

    def shape_boxes(self, rows: Rows, half_extents: Floats, padding: float) -> None:
        """Make objects boxes about their origins; where they are is not computed anew."""
        self.local_centers[rows], self.local_rotations[rows] = 0.0, np.eye(3)
        self.local_half_extents[rows] = half_extents
        self.pad(rows, padding)

    def rename(self, rows: Rows, names: Sequence[str]) -> None:
        """Give objects other names, all new and distinct."""
        self.version = next(_versions)
        for slot, name in zip(rows.tolist(), names, strict=True):
            del self.slots[str(self.names[slot])]
            self.slots[name], self.names[slot] = slot, name
        self.mark(rows)

    def mark(self, rows: Rows | int) -> None:
        """Mark slots as changed in more than their poses."""
        if np.size(rows) == 0:
            return
        self.changed[rows] = True
        self.touched = True
        self.revision += 1

    def settle(self) -> None:
        """Mark nothing as changed: it has been checked."""
        self.changed[:] = False
        self.touched = False

    def renew(self, rows: Rows) -> None:
        """Make objects new ones, as if each had been removed and added again with its pose."""
        self.version = next(_versions)
        self.born[rows], self.twists[rows] = self.version, 0.0
        self.mark(rows)

    def move_indices(self, indices: ArrayLike, poses: ArrayLike) -> None:
        """Give the objects of indices (m,) poses (m, 7); all or, on an error, none.

        What has its pose already is not marked changed. KeyError naming the first index that is
        not in use; ValueError for bad poses.
        """
        rows: Any = indices
        new: Any = poses
        if not (_suits(rows, np.int64) and _suits(new, np.float64) and new.shape == (len(rows), 7)):
            rows, new = self.check_slots(indices), as_array(poses, "poses", (None, 7))
            if len(new) != len(rows):
                got = f"{len(new)} for {len(rows)} objects"
                raise ValueError(f"poses must have one row per object, got {got}")
            new = new if new.flags.writeable else new.copy()
        which = np.empty(len(rows), np.int64)
        count, ascending = find_moves(rows, new, self.used, self.poses, which)
        if count == UNUSUAL:
            self._move(self.check_slots(rows), as_array(new, "poses", (None, 7)))
        elif count:
            if count < len(rows) and not ascending and len(np.unique(rows)) < len(rows):
                which, count = np.arange(len(rows)), len(rows)  # the last pose of each counts
            self._write(rows, new, which[:count], ascending)

    def _move(self, rows: Rows, new: Floats) -> None:
        """Do what ``move_indices`` does, with a word about whatever is wrong with poses (m, 7)."""
        moved = (self.poses[rows] != new).any(axis=1)
        numbers = None
        if not moved.all() and len(np.unique(rows)) == len(rows):
            rows, new, numbers = rows[moved], new[moved], np.flatnonzero(moved)
        positions, rotations = as_poses(new, "poses", numbers)
        self.poses[rows] = new
        self._place(rows, positions, rotations)

    def place(self, rows: Rows, poses: Floats) -> None:
        """Give slots (m,), all distinct, new poses (m, 7), finite, with quaternions not zero."""
        moved = np.flatnonzero((self.poses[rows] != poses).any(axis=1))
        if len(moved):
            self._write(rows, np.ascontiguousarray(poses), moved, False)

    def _write(self, rows: Rows, new: Floats, which: Rows, ascending: bool) -> None:
        """Give rows the poses new (m, 7) that ``which`` names; ascending: whether they are so."""
        if self._lent:
            everything = ascending and len(which) == len(self.slots)
            self._detach(rows if everything else rows[which], everything)
        self.touched = True
        arguments = (
            *(rows, new, which, self.poses, self.local_centers, self.local_rotations),
            *(self.centers, self.rotations, self.changed),
        )
        # a row that is there twice is written by one thread, so that its last pose counts
        least = LEAST_MOVES if ascending else len(which)
        run(write_moves, len(which), least, *arguments)

    def _place(self, rows: Rows, positions: Floats, rotations: Floats) -> None:
        if len(rows) == 0:
            return
        self._detach(rows)
        place_boxes(
            *(positions, rotations, self.local_centers, self.local_rotations, rows),
            *(self.centers, self.rotations),
        )
        self.changed[rows] = True
        self.touched = True

    def pad(self, rows: Rows, padding: float) -> None:
        """Grow slots by ``padding`` metres on every side beyond their local box."""
        pad = as_array(padding, "padding", ())
        if pad < 0.0:
            raise ValueError("padding must not be negative")
        self._detach(rows)
        if self._extents_lent:
            self.half_extents, self._extents_lent = self.half_extents.copy(), False
        self.paddings[rows] = pad
        self.half_extents[rows] = add_outwards(self.local_half_extents[rows], pad)
        self.mark(rows)

    def remove(self, name: str) -> int:
        """Remove an object; return the slot it had."""
        slot = self.slot(name)
        self.version = next(_versions)
        del self.slots[name]
        self.names[slot] = None
        self.used[slot] = False
        self.active[slot] = False
        self.mark(slot)
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
        self.used[rows] = self.active[rows] = False
        self.mark(rows)
        self._free = sorted([*self._free, *rows.tolist()])  # a sorted list is a heap

    def check_slots(self, slots: ArrayLike) -> Rows:
        """Return slots as an index array; KeyError naming the first that is not in use."""
        try:
            rows = np.atleast_1d(np.asarray(slots))
        except ValueError as error:  # ragged
            raise ValueError(f"index or indices must be integers (n,): {error}") from None
        if rows.ndim != 1 or (rows.dtype.kind not in "iu" and rows.size):
            got = f"{rows.dtype} of shape {rows.shape}"
            raise ValueError(f"index or indices must be integers of shape (n,), got {got}")
        rows = rows.astype(np.int64)
        known = (rows >= 0) & (rows < len(self.names))
        known[known] = self.used[rows[known]]
        if not known.all():
            raise KeyError(f"no object with index {int(rows[~known][0])}")
        return rows

    def boxes(self, rows: Rows) -> Boxes:
        """Return the world boxes of slots."""
        return Boxes.trusted(self.centers[rows], self.rotations[rows], self.half_extents[rows])

    def all_boxes(self) -> Boxes:
        """Return the world boxes of all slots, used or not, as views."""
        return Boxes.trusted(self.centers, self.rotations, self.half_extents)

    def snapshot(self) -> Snapshot:
        """Return the world boxes of all slots; they stay as they are when the store changes.

        Nothing is copied now: what changes is noted, or copied, if the snapshot is in use then.
        """
        while self._lent and self._lent[-1]() is None:
            self._lent.pop()
        latest = self._lent[-1]() if self._lent else None
        if latest is None or not latest.is_current:
            latest = Snapshot(self.all_boxes())
            self._lent.append(weakref.ref(latest))
            self._extents_lent = True
        return latest

    def _detach(self, rows: Rows, everything: bool = False) -> None:
        """Copy on write: have the snapshots in use note rows, or leave the arrays to them.

        everything: whether all objects are about to be placed anew, so that nothing is copied.
        """
        if not self._lent:
            return
        lent = [found for link in self._lent if (found := link()) is not None and found.attached]
        kept = [found for found in lent[-MOST_LENT:] if found.note(rows)]
        left = [found.detach() for found in lent if found not in kept]
        if any(left):
            anew = np.empty_like if everything else np.copy
            self.centers, self.rotations = anew(self.centers), anew(self.rotations)
        self._lent = [weakref.ref(found) for found in kept]

    def slots_of(self, names: Iterable[str]) -> Rows:
        """Return the slots of names; KeyError naming the first unknown one."""
        several = isinstance(names, Iterable) and getattr(names, "ndim", 1) > 0
        if isinstance(names, str) or not several:
            raise TypeError(f"names must be several names, got {shown(names)}")
        return np.array([self.slot(name) for name in names], np.int64)


def _suits(value: object, kind: type) -> bool:
    """Return whether a kernel can take an array as it is."""
    return isinstance(value, np.ndarray) and value.dtype == kind and value.flags.carray
