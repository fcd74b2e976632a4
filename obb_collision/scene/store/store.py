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

"""The store of objects: names and slots, local boxes, poses and world boxes.

A structure of arrays with one row (slot) per object. An object keeps its slot; free slots are used
again, the lowest first. Arrays grow by doubling. If memory ends, a change is made fully or not at
all: memory is allocated before the first write.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.boxes import Boxes
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.validation import as_array
from obb_collision.scene.store.placing import (
    UNUSUAL,
    LocalBoxes,
    as_slice,
    doubled,
    extents,
    find_moves,
    placed,
    suits,
    write_moves,
)
from obb_collision.typing import Floats, Mask, Rows
from obb_collision.words import shown

#: If fewer than one object in this many has moved, their old boxes are noted, else all are copied.
NOTED_SHARE = 4


class Snapshot:
    """The world boxes of all slots at one time, over arrays that the store goes on writing to.

    Before the store writes, the snapshot notes the rows, or the store leaves it the arrays: always
    the latter while a thread reads it, in a block ``with snapshot:``.
    """

    __slots__ = ("__weakref__", "_boxes", "_lock", "_notes", "_readers", "_room", "attached")

    def __init__(self, boxes: Boxes) -> None:
        self._boxes = boxes
        self._notes: list[tuple[Rows, Floats, Floats]] = []
        self._room = len(boxes) // NOTED_SHARE
        self._readers = 0
        self._lock = threading.Lock()
        self.attached = True
        """Whether the arrays are still those of the store."""

    def __enter__(self) -> None:
        with self._lock:
            self._readers += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._readers -= 1

    @property
    def is_current(self) -> bool:
        """Whether nothing has changed since."""
        return self.attached and not self._notes

    @property
    def boxes(self) -> Boxes:
        """The boxes; use them within ``with snapshot:``."""
        with self._lock:
            if self._notes:
                self._copy()
            return self._boxes

    def note(self, rows: Rows) -> bool:
        """Note rows that are about to change; False where the arrays are needed instead."""
        with self._lock:
            if self._readers or len(rows) > self._room:
                return False
            self._room -= len(rows)
            boxes = self._boxes
            self._notes.append((rows.copy(), boxes.centers[rows], boxes.rotations[rows]))
            return True

    def detach(self) -> None:
        """Detach from the store, which leaves its arrays to a current snapshot."""
        with self._lock:
            if self._notes:
                self._copy()
            self.attached = False

    def _copy(self) -> None:
        """Detach from the store by a copy, with the noted rows restored."""
        centers, rotations = self._boxes.centers.copy(), self._boxes.rotations.copy()
        for rows, old_centers, old_rotations in reversed(self._notes):
            centers[rows], rotations[rows] = old_centers, old_rotations
        self._boxes = Boxes.trusted(centers, rotations, self._boxes.arrays.half_extents)
        self.attached = False
        self._notes.clear()


#: Rows below which a second thread doesn't pay: 30 us of moves.
LEAST_MOVES = 1024
#: Snapshots in use that note changes; older ones get a copy.
MOST_LENT = 4
FIRST_CAPACITY = 16
NO_ROWS: Rows = np.empty(0, np.int64)
_versions = count(1)


class ObjectStore:
    """Named objects, each with a local box and a pose; ``changed`` marks those that moved."""

    def __init__(self) -> None:
        self.revision = 0  # changes with all but poses and twists
        self.touched = False  # whether any slot may be changed
        self.used = np.zeros(FIRST_CAPACITY, np.bool_)
        self.changed = np.zeros(FIRST_CAPACITY, np.bool_)  # since the last check
        self.padded = np.zeros(FIRST_CAPACITY, np.bool_)  # with a padding of their own
        self.paddings = np.zeros(FIRST_CAPACITY)  # own paddings and growths
        self.own_paddings = np.zeros(FIRST_CAPACITY)
        self.growths = np.zeros(FIRST_CAPACITY)  # see ``SceneObjects.grow``
        self.poses = np.zeros((FIRST_CAPACITY, 7))
        self.local_centers = np.zeros((FIRST_CAPACITY, 3))
        self.local_rotations = np.zeros((FIRST_CAPACITY, 3, 3))
        self.local_half_extents = np.zeros((FIRST_CAPACITY, 3))
        self.centers = np.zeros((FIRST_CAPACITY, 3))
        self.rotations = np.zeros((FIRST_CAPACITY, 3, 3))
        self.half_extents = np.zeros((FIRST_CAPACITY, 3))
        self._lent: list[weakref.ref[Snapshot]] = []
        self._shared: set[str] = set()  # columns that are copied before they are written to
        self.slots: dict[str, int] = {}
        self.version = next(_versions)  # changes with the names; no two stores share one
        self._name_tuple: tuple[int, tuple[str | None, ...]] = (0, ())
        self._lowest = 0  # all slots before it are in use
        self.names: list[str | None] = [None] * FIRST_CAPACITY
        self.enabled = np.zeros(FIRST_CAPACITY, np.bool_)  # included in checks
        self.near = np.zeros(FIRST_CAPACITY, np.bool_)  # near the region that is checked
        self.active = np.zeros(FIRST_CAPACITY, np.bool_)  # enabled and near: takes part
        self.accuracies = np.zeros(FIRST_CAPACITY, np.int8)
        self.levelled = np.zeros(FIRST_CAPACITY, np.bool_)  # with an accuracy of their own
        self.kinds = np.zeros(FIRST_CAPACITY, np.int8)  # see ``kind_of``
        self.twists = np.zeros((FIRST_CAPACITY, 6))
        self.born = np.zeros(FIRST_CAPACITY, np.int64)  # version in which the object was added

    def columns(self) -> dict[str, Any]:
        """Return the columns for pickling."""
        own = {"_lent", "_shared", "version", "_name_tuple"}
        return {name: value for name, value in vars(self).items() if name not in own}

    @classmethod
    def of_columns(cls, columns: dict[str, Any]) -> ObjectStore:
        """Return a store of pickled columns, all slots changed."""
        store = cls()
        vars(store).update(columns)
        store.changed, store.touched = store.used.copy(), True
        store.born[:] = store.version
        return store

    def _grow(self) -> None:
        """Double the arrays: all are allocated before one step replaces them."""
        columns = {k: value for k, value in vars(self).items() if isinstance(value, np.ndarray)}
        names = [*self.names, *[None] * len(self.names)]
        vars(self).update(doubled(columns), names=names, _lent=[], _shared=set())

    def free_rows(self, count: int) -> Rows:
        """Return the lowest free slots (count,), after making room for them."""
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
        """Return the slot of a name; KeyError for an unknown name."""
        slot = self.slots.get(name) if isinstance(name, str) else None
        if slot is None:
            raise KeyError(f"no object named {shown(name)}")
        return slot

    def name_tuple(self) -> tuple[str | None, ...]:
        """Return the names by slot, None for free slots."""
        if self._name_tuple[0] != self.version:
            self._name_tuple = self.version, tuple(self.names)
        return self._name_tuple[1]

    def enable(self, rows: Rows | slice, enabled: ArrayLike) -> None:
        """Include objects in checks, or exclude them."""
        active = np.logical_and(self.near[rows], enabled)
        self.enabled[rows], self.active[rows] = enabled, active

    def set_near(self, rows: Rows, near: Mask) -> None:
        """Set which objects are near the checked region; the others take no part."""
        active = self.enabled[rows] & near
        self.mark(rows[self.near[rows] != near])
        self.near[rows], self.active[rows] = near, active

    def live(self) -> Rows:
        """Return the slots in use, ascending."""
        return np.flatnonzero(self.used)

    def with_shapes(self) -> ObjectStore:
        """Return a copy whose kinds, sizes, paddings and accuracies do not change."""
        self._shared.update(("kinds", "accuracies", "paddings", "local_half_extents"))
        return copy(self)

    def with_body(
        self, local_boxes: LocalBoxes, pose: Floats, padding: float, kind: int, level: Accuracy
    ) -> tuple[ObjectStore, int]:
        """Return a copy with one more body, and its slot, for a query.

        The copy shares the arrays, of which only that free slot is written.
        """
        columns: dict[str, Any] = {**placed(local_boxes, pose[None], "pose")}
        columns |= extents(local_boxes[2], np.array([padding]), np.zeros(1))
        rows = self.free_rows(1)
        self._detach_columns(rows)  # a snapshot may show an earlier object of the slot
        body = copy(self)
        body._lent, body.enabled = [], self.enabled.copy()
        body.changed, body.active = self.changed.copy(), self.active.copy()
        body.write(rows, {**columns, "kinds": kind, "accuracies": level})
        body.enabled[rows] = body.active[rows] = True
        return body, int(rows[0])

    def put(
        self,
        rows: Rows,
        columns: Mapping[str, Any],
        new: Rows,
        names: Sequence[str],
        gone: Sequence[str] = (),
    ) -> None:
        """Write columns of slots, of which new slots get names; all are enabled.

        names: of ``new``, used by no other object. gone: names of earlier objects in such slots.
        If memory ends, nothing changes.
        """
        new_rows, all_rows, numbers = as_slice(new), as_slice(rows), new.tolist()
        self.near[new_rows] = True  # these slots are not in use until the end
        prepared = self._prepared(rows, columns)
        active = self.near[all_rows]
        try:
            self.slots.update(zip(names, numbers, strict=True))
        except MemoryError:
            for name in names:
                self.slots.pop(name, None)
            raise
        self._assign(rows, all_rows, prepared)
        for name in gone:
            self.slots.pop(name, None)
        for slot, name in zip(numbers, names, strict=True):
            self.names[slot] = name
        if len(new):
            self.version = next(_versions)
            self.used[new_rows], self.born[new_rows] = True, self.version
            self.twists[new_rows] = 0.0
        self.enabled[all_rows], self.active[all_rows] = True, active

    def rename(self, rows: Rows, names: Sequence[str], columns: Mapping[str, Any]) -> None:
        """Set names of objects, all new and distinct, and columns that depend on them."""
        slots, by_slot = dict(self.slots), list(self.names)
        for slot, name in zip(rows.tolist(), names, strict=True):
            slots.pop(by_slot[slot], None)
            slots[name], by_slot[slot] = slot, name
        self.write(rows, columns)
        self.version, self.slots, self.names = next(_versions), slots, by_slot

    def renew(self, rows: Rows) -> None:
        """Treat objects as new, as if each were removed and added again with its pose."""
        self.version = next(_versions)
        self.mark(rows)
        self.born[rows], self.twists[rows] = self.version, 0.0

    def remove_rows(self, rows: Rows) -> None:
        """Remove objects by their slots, all in use and distinct."""
        if len(rows) == 0:
            return
        slots = rows.tolist()
        self.enable(rows, False)
        self.version = next(_versions)
        self.mark(rows)
        self._lowest = min(self._lowest, *slots)
        for slot in slots:
            self.slots.pop(self.names[slot], None)
            self.names[slot] = None
        self.used[rows] = False

    def slots_of(self, names: Iterable[str]) -> Rows:
        """Return the slots of names; KeyError for the first unknown name."""
        many = isinstance(names, Iterable) and getattr(names, "ndim", 1) > 0
        if isinstance(names, str) or not many:
            raise TypeError(f"names must be a sequence of names, got {shown(names)}")
        return np.array([self.slot(name) for name in names], np.int64)

    def mark(self, rows: Rows | int) -> None:
        """Mark slots as changed in more than their poses."""
        if np.size(rows) == 0:
            return
        self.changed[rows] = True
        self.touched = True
        self.revision += 1

    def settle(self) -> None:
        """Mark all slots as unchanged, after a check."""
        self.changed[:] = False
        self.touched = False

    def check_slots(self, slots: ArrayLike) -> Rows:
        """Return slots as an index array; KeyError for the first that is not in use."""
        try:
            rows = np.atleast_1d(np.asarray(slots))
        except ValueError as error:  # ragged
            raise ValueError(f"index or indices must be integers (n,): {error}") from None
        if rows.ndim != 1 or (rows.dtype.kind not in "iu" and rows.size):
            got = f"{rows.dtype} of shape {rows.shape}"
            raise ValueError(f"index or indices must be integers of shape (n,), got {got}")
        rows = rows.astype(np.int64)
        valid = (rows >= 0) & (rows < len(self.used))
        valid[valid] = self.used[rows[valid]]
        if not valid.all():
            raise KeyError(f"no object with index {int(rows[~valid][0])}")
        return rows

    def move_indices(self, indices: ArrayLike, poses: ArrayLike) -> None:
        """Set poses (m, 7) of the objects of indices (m,); on an error none.

        Objects that have their pose already are not marked changed. KeyError for the first index
        that is not in use.
        """
        rows: Any = indices
        new: Any = poses
        if not (suits(rows, np.int64) and suits(new, np.float64) and new.shape == (len(rows), 7)):
            rows, new = self.check_slots(indices), as_array(poses, "poses", (None, 7))
            if len(new) != len(rows):
                got = f"{len(new)} for {len(rows)} objects"
                raise ValueError(f"poses must have one row per object, got {got}")
        else:
            rows = rows.copy()  # another thread must not change checked numbers
        which = np.empty(len(rows), np.int64)
        count, ascending = find_moves(rows, new, self.used, self.poses, which)
        if count == UNUSUAL:
            self._move(self.check_slots(rows), as_array(new, "poses", (None, 7)))
        elif count:
            if count < len(rows) and not ascending and len(np.unique(rows)) < len(rows):
                which, count = np.arange(len(rows)), len(rows)  # the last pose of each counts
            self._write(rows, new, which[:count], ascending)

    def _move(self, rows: Rows, new: Floats) -> None:
        """`move_indices` for unusual poses (m, 7), with an error or a warning."""
        moved = (self.poses[rows] != new).any(axis=1)
        numbers = None
        if not moved.all() and len(np.unique(rows)) == len(rows):
            rows, new, numbers = rows[moved], new[moved], np.flatnonzero(moved)
        as_poses(new, "poses", numbers)
        self._write(rows, np.ascontiguousarray(new), np.arange(len(rows)), False)

    def place(self, rows: Rows, poses: Floats) -> None:
        """Set poses (m, 7) of distinct slots (m,): finite, with quaternions not zero."""
        moved = np.flatnonzero((self.poses[rows] != poses).any(axis=1))
        if len(moved):
            self._write(rows, np.ascontiguousarray(poses), moved, False)

    def _write(self, rows: Rows, new: Floats, which: Rows, ascending: bool) -> None:
        """Write the new poses numbered ``which`` to their rows; ascending: whether rows ascend."""
        self._forget_unused()
        if self._lent:
            everything = ascending and LEAST_MOVES <= len(which) == np.count_nonzero(self.used)
            if everything:  # load the kernel before the arrays for it are allocated
                self._place(rows, new, which[:0], LEAST_MOVES)
            self._detach(rows if everything else rows[which], everything)
        self.touched = True
        # one thread, unless rows are distinct: the last pose of a row counts
        self._place(rows, new, which, LEAST_MOVES if ascending else len(which))

    def _place(self, rows: Rows, new: Floats, which: Rows, least: int) -> None:
        local, out = (self.local_centers, self.local_rotations), (self.centers, self.rotations)
        run(write_moves, len(which), least, rows, new, which, self.poses, local, out, self.changed)

    def write(self, rows: Rows, columns: Mapping[str, Any]) -> None:
        """Write columns of slots, and mark these changed; if memory ends, nothing changes."""
        self._assign(rows, as_slice(rows), self._prepared(rows, columns))

    def _prepared(self, rows: Rows, columns: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        """Return columns as they are stored; after that no write of them fails."""
        self._detach_columns(rows)
        return {k: np.asarray(values, getattr(self, k).dtype) for k, values in columns.items()}

    def _detach_columns(self, rows: Rows) -> None:
        """Let snapshots keep slots that are about to change, and copy shared columns."""
        self._detach(rows)
        if self._shared:
            copies = {name: getattr(self, name).copy() for name in self._shared}
            vars(self).update(copies, _shared=set())

    def _assign(self, rows: Rows, index: Rows | slice, columns: Mapping[str, NDArray[Any]]) -> None:
        self.mark(rows)
        for name, values in columns.items():
            getattr(self, name)[index] = values

    def pad(self, rows: Rows, padding: Floats, of_its_own: bool = False) -> None:
        """Set paddings (n,) of slots, metres, not negative."""
        columns = extents(self.local_half_extents[rows], padding, self.growths[rows])
        self.write(rows, {"padded": of_its_own, **columns})

    def boxes(self, rows: Rows) -> Boxes:
        """Return the world boxes of slots."""
        return Boxes.trusted(self.centers[rows], self.rotations[rows], self.half_extents[rows])

    def all_boxes(self) -> Boxes:
        """Return the world boxes of all slots, used or not, as views."""
        return Boxes.trusted(self.centers, self.rotations, self.half_extents)

    def snapshot(self) -> Snapshot:
        """Return the world boxes of all slots, which do not change with the store.

        Nothing is copied now: later changes are noted, or copied, while the snapshot is in use.
        """
        self._forget_unused()
        latest = self._lent[-1]() if self._lent else None
        if latest is None or not latest.is_current:
            latest = Snapshot(self.all_boxes())
            self._lent.append(weakref.ref(latest))
            self._shared.add("half_extents")
        return latest

    def _forget_unused(self) -> None:
        """Forget the latest snapshots that are no longer in use."""
        while self._lent and self._lent[-1]() is None:
            self._lent.pop()

    def _detach(self, rows: Rows, everything: bool = False) -> None:
        """Copy on write: snapshots in use note rows, or keep the arrays.

        everything: whether all objects are about to be placed anew, so that nothing is copied.
        """
        if not self._lent:
            return
        lent = [shot for link in self._lent if (shot := link()) is not None and shot.attached]
        kept = [shot for shot in lent[-MOST_LENT:] if shot.note(rows)]
        left = [shot for shot in lent if shot not in kept]
        if any(shot.is_current for shot in left):  # first, in case memory ends
            anew = np.empty_like if everything else np.copy
            self.centers, self.rotations = anew(self.centers), anew(self.rotations)
        for shot in left:
            shot.detach()
        self._lent = [weakref.ref(shot) for shot in kept]
