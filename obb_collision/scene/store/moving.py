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

"""Kernels that give objects new poses: one look at what came, then one write of what differs."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.poses import BLOCK, ROWS, FrameArrays, matrix_in, place_box, turn_block
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.typing import Floats

#: Squared lengths of quaternions that need no second look: well within ``UNIT_TOLERANCE``.
LEAST_SQUARE, MOST_SQUARE = 0.85, 1.15
#: What ``find_moves`` returns for poses that need more than a kernel: an error, or a warning.
UNUSUAL = -1


@njit
def find_moves(
    rows: np.ndarray, new: Floats, used: np.ndarray, poses: Floats, which: np.ndarray
) -> tuple[int, bool]:
    """Write which of new poses (m, 7) differ from those of their rows (m,); return how many.

    UNUSUAL if a row is not used, or a pose not finite or its quaternion far from unit length. Also
    returns whether the rows ascend, so that none is there twice.
    """
    found, ascending, before = 0, True, -1
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
            which[found] = n
            found += 1
    return found, ascending


@njit
def write_moves(
    rows: np.ndarray,
    new: Floats,
    which: np.ndarray,
    poses: Floats,
    local: FrameArrays,
    placed: FrameArrays,
    changed: np.ndarray,
    start: int,
    stop: int,
) -> None:
    """Give rows the new poses that ``which[start:stop]`` names, and place their boxes."""
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
            place_box(position, rotation, local, row, placed)
