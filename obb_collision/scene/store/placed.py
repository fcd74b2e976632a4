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

"""Boxes in slots: where poses place them, what has changed, and what they were for reports in use.

A structure of arrays with one row (slot) per box.
"""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._threads import run
from obb_collision.geometry.boxes import Boxes, add_outwards
from obb_collision.geometry.poses import as_poses, place_boxes
from obb_collision.geometry.validation import as_array
from obb_collision.scene.store.moving import UNUSUAL, find_moves, write_moves
from obb_collision.scene.store.snapshot import Snapshot
from obb_collision.typing import Floats, Rows

#: Rows below which a second thread doesn't pay: 30 us of moves.
LEAST_MOVES = 1024
#: Snapshots in use that have changes noted; older ones get a copy.
MOST_LENT = 4


class PlacedBoxes:
    """Local boxes, poses and the world boxes they make; ``changed`` marks what differs."""

    def __init__(self, capacity: int) -> None:
        self.revision = 0  # changes with all but poses and twists
        self.touched = False  # whether anything may be marked changed
        self._allocate(capacity)

    def _allocate(self, capacity: int) -> None:
        self.used = np.zeros(capacity, np.bool_)
        self.changed = np.zeros(capacity, np.bool_)  # since the last check
        self.paddings = np.zeros(capacity)  # with what they are grown by
        self.own_paddings = np.zeros(capacity)  # without it
        self.growths = np.zeros(capacity)
        self.poses = np.zeros((capacity, 7))
        self.local_centers = np.zeros((capacity, 3))
        self.local_rotations = np.zeros((capacity, 3, 3))
        self.local_half_extents = np.zeros((capacity, 3))
        self.centers = np.zeros((capacity, 3))
        self.rotations = np.zeros((capacity, 3, 3))
        self.half_extents = np.zeros((capacity, 3))
        self._lent: list[weakref.ref[Snapshot]] = []
        self._extents_lent = False

    def mark(self, rows: Rows | int) -> None:
        """Mark slots as changed in more than their poses; before they are, for interrupts."""
        if np.size(rows) == 0:
            return
        self.changed[rows] = True
        self.touched = True
        self.revision += 1

    def settle(self) -> None:
        """Mark nothing as changed: it has been checked."""
        self.changed[:] = False
        self.touched = False

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
        known = (rows >= 0) & (rows < len(self.used))
        known[known] = self.used[rows[known]]
        if not known.all():
            raise KeyError(f"no object with index {int(rows[~known][0])}")
        return rows

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
        else:
            rows = rows.copy()  # another thread must not change what is checked
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
        as_poses(new, "poses", numbers)
        self._write(rows, np.ascontiguousarray(new), np.arange(len(rows)), False)

    def place(self, rows: Rows, poses: Floats) -> None:
        """Give slots (m,), all distinct, new poses (m, 7), finite, with quaternions not zero."""
        moved = np.flatnonzero((self.poses[rows] != poses).any(axis=1))
        if len(moved):
            self._write(rows, np.ascontiguousarray(poses), moved, False)

    def _write(self, rows: Rows, new: Floats, which: Rows, ascending: bool) -> None:
        """Give rows the poses new (m, 7) that ``which`` names; ascending: whether they are so."""
        self._forget_unused()
        if self._lent:
            everything = ascending and len(which) == np.count_nonzero(self.used)
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
        self.changed[rows] = self.touched = True
        place_boxes(
            *(positions, rotations, self.local_centers, self.local_rotations, rows),
            *(self.centers, self.rotations),
        )

    def pad(self, rows: Rows, padding: float | Floats) -> None:
        """Grow slots by ``padding`` metres, one or (n,), on every side beyond their local box."""
        pad = as_array(padding, "padding", np.shape(padding))
        if (pad < 0.0).any():
            raise ValueError("padding must not be negative")
        self.own_paddings[rows] = pad
        self._extend(rows)

    def set_growths(self, rows: Rows, growths: Floats) -> None:
        """Grow slots by (n,) metres beyond their padding, in place of what they were grown by."""
        other = growths != self.growths[rows]
        if other.any():
            self.growths[rows] = growths
            self._extend(rows[other])

    def _extend(self, rows: Rows) -> None:
        """Write half extents anew."""
        self._detach(rows)
        if self._extents_lent:
            self.half_extents, self._extents_lent = self.half_extents.copy(), False
        self.mark(rows)
        some = as_slice(rows)
        paddings = add_outwards(self.own_paddings[some], self.growths[some])
        self.paddings[some] = paddings
        extents = self.local_half_extents[some]
        self.half_extents[some] = add_outwards(extents, paddings[:, None])

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
        self._forget_unused()
        latest = self._lent[-1]() if self._lent else None
        if latest is None or not latest.is_current:
            latest = Snapshot(self.all_boxes())
            self._lent.append(weakref.ref(latest))
            self._extents_lent = True
        return latest

    def _forget_unused(self) -> None:
        """Forget the latest snapshots where nobody has them any more."""
        while self._lent and self._lent[-1]() is None:
            self._lent.pop()

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


def as_slice(rows: Rows) -> Rows | slice:
    """Return rows (n,) as a slice if they follow one another: columns are written faster so."""
    if len(rows) == 0:
        return rows
    first, last = int(rows[0]), int(rows[-1])
    if last - first + 1 == len(rows) and (np.diff(rows) == 1).all():
        return slice(first, last + 1)
    return rows


def _suits(value: object, kind: type) -> bool:
    """Return whether a kernel can take an array as it is."""
    return isinstance(value, np.ndarray) and value.dtype == kind and value.flags.carray
