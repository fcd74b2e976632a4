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
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._threads import run
from obb_collision.geometry.boxes import Boxes, add_outwards
from obb_collision.geometry.poses import FrameArrays, as_poses, place_boxes
from obb_collision.geometry.validation import as_array
from obb_collision.scene.store.completed import completed
from obb_collision.scene.store.moving import UNUSUAL, find_moves, write_moves
from obb_collision.scene.store.snapshot import Snapshot
from obb_collision.typing import Floats, Rows

LocalBoxes = tuple[Floats, Floats, Floats]
"""Centers (n, 3), rotations (n, 3, 3) and half extents (n, 3) in frames of their own."""
#: Rows below which a second thread doesn't pay: 30 us of moves.
LEAST_MOVES = 1024
#: Snapshots in use that have changes noted; older ones get a copy.
MOST_LENT = 4


class PlacedBoxes:
    """Local boxes, poses and the world boxes they make; ``changed`` marks what differs."""

    def __init__(self, capacity: int) -> None:
        self.revision = 0  # changes with all but poses and twists
        self.touched = False  # whether anything may be marked changed
        self.used = np.zeros(capacity, np.bool_)
        self.changed = np.zeros(capacity, np.bool_)  # since the last check
        self.padded = np.zeros(capacity, np.bool_)  # by a padding of their own
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
        self._shared: set[str] = set()  # columns that are copied before they are written to

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

    @completed
    def _write(self, rows: Rows, new: Floats, which: Rows, ascending: bool) -> None:
        """Give rows the poses new (m, 7) that ``which`` names; ascending: whether they are so."""
        self._forget_unused()
        if self._lent:
            everything = ascending and len(which) == np.count_nonzero(self.used)
            self._detach(rows if everything else rows[which], everything)
        self.touched = True
        local = FrameArrays(self.local_centers, self.local_rotations)
        out = FrameArrays(self.centers, self.rotations)
        # a row that is there twice is written by one thread, so that its last pose counts
        least = LEAST_MOVES if ascending else len(which)
        run(write_moves, len(which), least, rows, new, which, self.poses, local, out, self.changed)

    @completed
    def write(self, rows: Rows, columns: Mapping[str, Any]) -> None:
        """Write columns of slots, and mark these as changed; all or, should memory end, none."""
        self._part(rows)
        self._assign(rows, columns)

    def _part(self, rows: Rows) -> None:
        """Leave to snapshots in use what slots are, which are about to change."""
        self._detach(rows)
        if self._shared:
            copies = {name: getattr(self, name).copy() for name in self._shared}
            vars(self).update(copies, _shared=set())

    def _assign(self, rows: Rows, columns: Mapping[str, Any]) -> None:
        some = as_slice(rows)
        self.mark(rows)
        for name, values in columns.items():
            getattr(self, name)[some] = values

    def pad(self, rows: Rows, padding: Floats, of_its_own: bool = False) -> None:
        """Grow slots by (n,) metres, not negative, on every side beyond their local box."""
        columns = extents(self.local_half_extents[rows], padding, self.growths[rows])
        self.write(rows, {"padded": of_its_own, **columns})

    def set_growths(self, rows: Rows, growths: Floats) -> None:
        """Grow slots by (n,) metres beyond their padding, in place of what they were grown by."""
        other = growths != self.growths[rows]
        rows, growths = rows[other], growths[other]
        own = self.own_paddings[rows]
        self.write(rows, extents(self.local_half_extents[rows], own, growths))

    def resize(self, rows: Rows, half_extents: Floats) -> None:
        """Make slots boxes about their origins; where these are is not computed anew."""
        own, growths = self.own_paddings[rows], self.growths[rows]
        box = {"local_centers": 0.0, "local_rotations": np.eye(3)}
        self.write(rows, {**box, **extents(half_extents, own, growths)})

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
            self._shared.add("half_extents")
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
        left = [found for found in lent if found not in kept]
        if any(found.is_current for found in left):  # before it parts: should memory end, it stays
            anew = np.empty_like if everything else np.copy
            self.centers, self.rotations = anew(self.centers), anew(self.rotations)
        for found in left:
            found.detach()
        self._lent = [weakref.ref(found) for found in kept]


def about_origins(half_extents: Floats) -> LocalBoxes:
    """Return local boxes about the origins, along the axes."""
    count = len(half_extents)
    return np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1)), half_extents


def placed(local_boxes: LocalBoxes, poses: Floats, name: str = "poses") -> dict[str, Floats]:
    """Return the columns of places of n slots with local boxes, by poses (n, 7)."""
    positions, matrices = as_poses(poses, name)
    local_centers, local_rotations, _ = local_boxes
    centers, rotations = np.empty_like(positions), np.empty_like(matrices)
    local, out = FrameArrays(local_centers, local_rotations), FrameArrays(centers, rotations)
    place_boxes(FrameArrays(positions, matrices), local, np.arange(len(poses)), out)
    return {
        "poses": poses,
        "local_centers": local_centers,
        "local_rotations": local_rotations,
        "centers": centers,
        "rotations": rotations,
    }


def extents(local_half_extents: Floats, own_paddings: Floats, growths: Floats) -> dict[str, Floats]:
    """Return the columns of sizes of n slots."""
    paddings = add_outwards(own_paddings, growths)
    return {
        "local_half_extents": local_half_extents,
        "own_paddings": own_paddings,
        "growths": growths,
        "paddings": paddings,
        "half_extents": add_outwards(local_half_extents, paddings[:, None]),
    }


def doubled(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return arrays with as many rows of zeros at their ends as they have."""
    return {name: np.concatenate((rows, np.zeros_like(rows))) for name, rows in columns.items()}


def as_slice(rows: Rows) -> Rows | slice:
    """Return rows (n,) as a slice if they follow one another: columns are written faster so."""
    if len(rows) == 0:
        return rows
    first, last = int(rows[0]), int(rows[-1])
    if last - first + 1 == len(rows) and (len(rows) == 1 or (np.diff(rows) == 1).all()):
        return slice(first, last + 1)
    return rows


def _suits(value: object, kind: type) -> bool:
    """Return whether a kernel can take an array as it is."""
    return isinstance(value, np.ndarray) and value.dtype == kind and value.flags.carray
