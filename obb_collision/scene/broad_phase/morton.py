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

"""Bounds in the order of a Z-order curve (Morton 1966) through their centres: neighbours are near.

Cells are cubes, as fine along the longest side as there are bits; so boxes on a line or in a plane
get as many of them. Where more boxes than a leaf holds share a cell, it is divided in the same way:
a far outlier, or tight clusters far from each other, take nothing from the others.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.sorting import DIGIT_BITS, bits_of, sort_numbers
from obb_collision.typing import Floats

#: Bits of a cell's number along an axis: three of them in a 64-bit number.
AXIS_BITS = 21
#: Code of what is empty: behind all others.
BITS = 3 * AXIS_BITS
#: Bits of a code beyond those that number the boxes: what shares a cell is sorted once more.
SPARE_BITS = 2
#: Most boxes of one cell.
CELL = 8
#: Sides shorter than this are taken as none: their reciprocals might overflow.
SHORTEST = 1e-280


@njit
def morton_order(minimum: Floats, maximum: Floats, order: np.ndarray, spare: np.ndarray) -> None:
    """Write the rows of bounds (n, 3) to (n, 3) along the curve to ``order``; empty ones are last.

    order, spare (n,) int64; what is in ``spare`` afterwards means nothing.
    """
    count = len(minimum)
    full, empty = 0, count
    for n in range(count):
        if minimum[n, 0] <= maximum[n, 0]:
            order[full] = n
            full += 1
        else:
            empty -= 1
            order[empty] = n
    row_bits = bits_of(count)
    starts = np.empty(full // CELL + 1, np.int64)
    stops = np.empty(full // CELL + 1, np.int64)
    starts[0], stops[0] = 0, full
    waiting = 1
    while waiting > 0:
        waiting -= 1
        start, stop = starts[waiting], stops[waiting]
        if not _sort_cells(minimum, maximum, order[start:stop], spare[start:stop], row_bits):
            continue  # all in one place
        first = start
        for n in range(start, stop):  # spare: the codes of the cells
            if n + 1 == stop or spare[n + 1] != spare[first]:
                if n + 1 - first > CELL:
                    starts[waiting], stops[waiting] = first, n + 1
                    waiting += 1
                first = n + 1


@njit
def _sort_cells(
    minimum: Floats, maximum: Floats, rows: np.ndarray, spare: np.ndarray, row_bits: int
) -> bool:
    """Sort rows by the codes of their cells, which are written to ``spare``.

    False, and nothing done, if they have one centre, or bounds that are no numbers: arrays that
    were valid once may have been written since, and a code must be one whatever they hold.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for row in rows:
        for k in range(3):
            middle = 0.5 * minimum[row, k] + 0.5 * maximum[row, k]
            low[k], high[k] = min(low[k], middle), max(high[k], middle)
    side = max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    if len(rows) < 2 or not SHORTEST <= side < np.inf:
        return False
    digits = (bits_of(len(rows)) + SPARE_BITS + DIGIT_BITS - 1) // DIGIT_BITS
    bits = min(digits * DIGIT_BITS, BITS - row_bits)
    last = 2.0**AXIS_BITS - 1.0
    scale = last / side
    for n in range(len(rows)):
        code = 0
        for k in range(3):
            middle = 0.5 * minimum[rows[n], k] + 0.5 * maximum[rows[n], k]
            code |= _spread_bits(int(min(max(0.0, (middle - low[k]) * scale), last))) << k
        rows[n] |= code >> (BITS - bits) << row_bits
    sort_numbers(rows, spare, row_bits, row_bits + bits)
    for n in range(len(rows)):
        spare[n] = rows[n] >> row_bits
        rows[n] &= (1 << row_bits) - 1
    return True


@njit
def _spread_bits(x: int) -> int:
    """Put two zero bits between the 21 lowest bits."""
    x = (x | (x << 32)) & 0x001F00000000FFFF
    x = (x | (x << 16)) & 0x001F0000FF0000FF
    x = (x | (x << 8)) & 0x100F00F00F00F00F
    x = (x | (x << 4)) & 0x10C30C30C30C30C3
    return (x | (x << 2)) & 0x1249249249249249
