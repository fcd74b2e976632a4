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
from obb_collision.numerics.sorting import DIGIT_BITS, bits_of, sort_by_keys
from obb_collision.typing import Floats

#: Bits of a cell's number along an axis: three of them in a 64-bit number.
AXIS_BITS = 21
#: Code of what is empty: behind all others.
BITS = 3 * AXIS_BITS
#: Bits of a code beyond those that number the boxes: what shares a cell is sorted once more.
SPARE_BITS = 3
#: Most boxes of one cell.
CELL = 8
#: Sides shorter than this are taken as none: their reciprocals might overflow.
SHORTEST = 1e-280


@njit
def morton_order(minimum: Floats, maximum: Floats) -> np.ndarray:
    """Return (n,) the rows of bounds (n, 3) to (n, 3) along the curve; empty ones are last."""
    count = len(minimum)
    order = np.empty(count, np.int64)
    full, empty = 0, count
    for n in range(count):
        if minimum[n, 0] <= maximum[n, 0]:
            order[full] = n
            full += 1
        else:
            empty -= 1
            order[empty] = n
    codes = np.empty(full, np.int64)
    starts = np.empty(full // CELL + 1, np.int64)
    stops = np.empty(full // CELL + 1, np.int64)
    starts[0], stops[0] = 0, full
    waiting = 1
    while waiting > 0:
        waiting -= 1
        start, stop = starts[waiting], stops[waiting]
        if not _sort_cells(minimum, maximum, order[start:stop], codes[start:stop]):
            continue  # all in one place
        first = start
        for n in range(start + 1, stop + 1):
            if n == stop or codes[n] != codes[first]:
                if n - first > CELL:
                    starts[waiting], stops[waiting] = first, n
                    waiting += 1
                first = n
    return order


@njit
def _sort_cells(minimum: Floats, maximum: Floats, rows: np.ndarray, codes: np.ndarray) -> bool:
    """Sort rows by the codes of their cells; False, and nothing done, if they have one centre."""
    low = np.full(3, np.inf)
    side = 0.0
    for k in range(3):
        high = -np.inf
        for row in rows:
            middle = 0.5 * minimum[row, k] + 0.5 * maximum[row, k]
            low[k], high = min(low[k], middle), max(high, middle)
        side = max(side, high - low[k])
    if len(rows) < 2 or side < SHORTEST:
        return False
    digits = (bits_of(len(rows)) + SPARE_BITS + DIGIT_BITS - 1) // DIGIT_BITS
    bits = min(digits * DIGIT_BITS, BITS)
    last = 2.0**AXIS_BITS - 1.0
    scale = last / side
    for n in range(len(rows)):
        code = 0
        for k in range(3):
            middle = 0.5 * minimum[rows[n], k] + 0.5 * maximum[rows[n], k]
            code |= _spread_bits(int(min((middle - low[k]) * scale, last))) << k
        codes[n] = code >> (BITS - bits)
    sort_by_keys(codes, rows, bits)
    return True


@njit
def _spread_bits(x: int) -> int:
    """Put two zero bits between the 21 lowest bits."""
    x = (x | (x << 32)) & 0x001F00000000FFFF
    x = (x | (x << 16)) & 0x001F0000FF0000FF
    x = (x | (x << 8)) & 0x100F00F00F00F00F
    x = (x | (x << 4)) & 0x10C30C30C30C30C3
    return (x | (x << 2)) & 0x1249249249249249
