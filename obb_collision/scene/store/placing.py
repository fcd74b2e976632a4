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

"""Places and sizes of boxes in slots: columns of new boxes, and kernels that write new poses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.geometry.boxes import add_outwards
from obb_collision.geometry.poses import (
    BLOCK,
    ROWS,
    FrameArrays,
    as_poses,
    matrix_in,
    place_box,
    place_boxes,
    turn_block,
)
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.typing import Columns, Floats, Rows

#: Squared lengths of quaternions well within ``UNIT_TOLERANCE``.
LEAST_SQUARE, MOST_SQUARE = 0.85, 1.15
#: Result of ``find_moves`` for poses that need an error or a warning.
UNUSUAL = -1


LocalBoxes = tuple[Floats, Floats, Floats]
"""Centers (n, 3), rotations (n, 3, 3) and half extents (n, 3) in frames of their own."""


@njit
def find_moves(
    rows: np.ndarray, new: Floats, used: np.ndarray, poses: Floats, which: np.ndarray
) -> tuple[int, bool]:
    """Write which new poses (m, 7) differ from the present poses of rows (m,); return how many.

    UNUSUAL for a row not in use, or a pose that is not finite or far from unit length. Also returns
    whether the rows ascend, so that none occurs twice.
    """
    count, ascending, before = 0, True, -1
    for n in range(len(rows)):
        row = rows[n]
        if row < 0 or row >= len(used) or not used[row]:
            return UNUSUAL, False
        ascending &= row > before
        before = row
        differs, usual, square = False, True, 0.0
        for k in range(7):
            number = new[n, k]
            usual &= abs(number) <= MAX_MAGNITUDE  # False for NaN, too
            differs |= number != poses[row, k]
            if k > 2:
                square += number * number
        if not usual or (differs and not LEAST_SQUARE <= square <= MOST_SQUARE):
            return UNUSUAL, False
        if differs:
            which[count] = n
            count += 1
    return count, ascending


@njit
def write_moves(
    rows: np.ndarray,
    new: Floats,
    which: np.ndarray,
    poses: Floats,
    local: Columns,
    placed: Columns,
    changed: np.ndarray,
    start: int,
    stop: int,
) -> None:
    """Write the new poses numbered ``which[start:stop]`` to their rows, and place the boxes."""
    own, out = FrameArrays(*local), FrameArrays(*placed)
    block = np.empty((ROWS, BLOCK))
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        for n in range(count):
            for k in range(4):
                block[k, n] = new[which[first + n], 3 + k]
        turn_block(block, count)
        for n in range(count):
            number = which[first + n]
            row = rows[number]
            for k in range(7):
                poses[row, k] = new[number, k]
            changed[row] = True
            position = new[number, 0], new[number, 1], new[number, 2]
            rotation = matrix_in(block, n)
            place_box(position, rotation, own, row, out)


def about_origins(half_extents: Floats) -> LocalBoxes:
    """Return local boxes about the origin, along the axes."""
    count = len(half_extents)
    return np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1)), half_extents


def placed(local_boxes: LocalBoxes, poses: Floats, name: str = "poses") -> dict[str, Floats]:
    """Return the store's columns of n local boxes at poses (n, 7): local and world, by name."""
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
    """Return the store's columns of n boxes that depend on sizes and paddings (m), by name."""
    paddings = add_outwards(own_paddings, growths)
    return {
        "local_half_extents": local_half_extents,
        "own_paddings": own_paddings,
        "growths": growths,
        "paddings": paddings,
        "half_extents": add_outwards(local_half_extents, paddings[:, None]),
    }


def doubled(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays with twice as many rows; the new rows are zero."""
    return {name: np.concatenate((rows, np.zeros_like(rows))) for name, rows in columns.items()}


def as_slice(rows: Rows) -> Rows | slice:
    """Return consecutive rows (n,) as a slice, by which columns are written faster."""
    if len(rows) == 0:
        return rows
    first, last = int(rows[0]), int(rows[-1])
    if last - first + 1 == len(rows) and (len(rows) == 1 or (np.diff(rows) == 1).all()):
        return slice(first, last + 1)
    return rows


def suits(value: object, kind: type) -> bool:
    """Return whether a value is an array that kernels take without conversion."""
    return isinstance(value, np.ndarray) and value.dtype == kind and value.flags.carray
