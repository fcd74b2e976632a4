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

Cells are cubes; a code has as many bits along an axis as fit, so boxes on a line or in a plane get
as many cells as others. Where more boxes than a leaf holds share a cell, it is divided in the same
way, so that a far outlier, or tight clusters far apart, do not make cells too coarse.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.numerics.sorting import (
    BUCKET_BITS,
    DIGIT_BITS,
    FEWEST_NUMBERS,
    bits_of,
    deal,
    is_dealt,
    run_buckets,
    sort_numbers,
)
from obb_collision.typing import Floats

#: Bits of a cell's number along an axis: three of them in a 64-bit number.
AXIS_BITS = 21
#: Bits of a code.
BITS = 3 * AXIS_BITS
#: Bits of a code beyond those that number the boxes; boxes that share a cell are sorted again.
SPARE_BITS = 2
#: Most boxes of one cell.
CELL = 8
#: Shorter sides count as zero: their reciprocals might overflow.
SHORTEST = 1e-280
#: The last cell along an axis.
LAST = 2.0**AXIS_BITS - 1.0
#: Where cells begin along x, y and z, and how many there are per metre.
Cells = tuple[float, float, float, float]


@njit
def morton_order(minimum: Floats, maximum: Floats, order: np.ndarray, spare: np.ndarray) -> None:
    """Write the rows of bounds (n, 3) to (n, 3) along the curve to ``order``; empty ones are last.

    order, spare (n,) int64; ``spare`` is scratch space.
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
    if _sort_cells(minimum, maximum, order[:full], spare[:full], row_bits):
        _divide(minimum, maximum, order[:full], spare[:full], row_bits)


@njit
def _divide(
    minimum: Floats, maximum: Floats, rows: np.ndarray, spare: np.ndarray, row_bits: int
) -> None:
    """Sort rows further where more than CELL share a cell; spare: the codes of the cells."""
    starts = np.empty(len(rows) // CELL + 1, np.int64)
    stops = np.empty(len(rows) // CELL + 1, np.int64)
    waiting = _push_cells(spare, 0, len(rows), starts, stops, 0)
    while waiting > 0:
        waiting -= 1
        start, stop = starts[waiting], stops[waiting]
        if _sort_cells(minimum, maximum, rows[start:stop], spare[start:stop], row_bits):
            waiting = _push_cells(spare, start, stop, starts, stops, waiting)


@njit
def _push_cells(
    codes: np.ndarray, start: int, stop: int, starts: np.ndarray, stops: np.ndarray, waiting: int
) -> int:
    """Append the runs of equal codes that are longer than CELL; return how many wait then."""
    first = start
    for n in range(start, stop):
        if n + 1 == stop or codes[n + 1] != codes[first]:
            if n + 1 - first > CELL:
                starts[waiting], stops[waiting] = first, n + 1
                waiting += 1
            first = n + 1
    return waiting


@njit
def _sort_cells(
    minimum: Floats, maximum: Floats, rows: np.ndarray, spare: np.ndarray, row_bits: int
) -> bool:
    """Sort rows by the codes of their cells, which are written to ``spare``.

    False, with nothing done, for rows of one centre, or with bounds that are NaN: the caller may
    have written to arrays since they were checked, and NaN has no code.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for row in rows:
        for k in range(3):
            middle = 0.5 * minimum[row, k] + 0.5 * maximum[row, k]
            low[k], high[k] = min(low[k], middle), max(high[k], middle)
    side = max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    if len(rows) < 2 or not SHORTEST <= side < np.inf:
        return False
    bits, cells = code_bits(len(rows), row_bits), (low[0], low[1], low[2], LAST / side)
    for n in range(len(rows)):
        code = _code(minimum, maximum, rows[n], cells)
        rows[n] |= code >> (BITS - bits) << row_bits
    sort_numbers(rows, spare, row_bits, row_bits + bits)
    _part(rows, rows, spare, row_bits)
    return True


@njit
def code_bits(count: int, row_bits: int) -> int:
    """Return how many bits of a code ``count`` rows are sorted by."""
    digits = (bits_of(count) + SPARE_BITS + DIGIT_BITS - 1) // DIGIT_BITS
    return min(digits * DIGIT_BITS, BITS - row_bits)


@njit
def _code(minimum: Floats, maximum: Floats, row: int, cells: Cells) -> int:
    """Return the number of a row's cell along the curve."""
    x, y, z, scale = cells
    code = 0
    for k, low in enumerate((x, y, z)):
        middle = 0.5 * minimum[row, k] + 0.5 * maximum[row, k]
        code |= _spread_bits(int(min(max(0.0, (middle - low) * scale), LAST))) << k
    return code


@njit
def _part(numbers: np.ndarray, rows: np.ndarray, codes: np.ndarray, row_bits: int) -> None:
    """Split numbers into rows and codes of their cells."""
    for n in range(len(numbers)):
        number = numbers[n]
        codes[n] = number >> row_bits
        rows[n] = number & ((1 << row_bits) - 1)


@njit
def _spread_bits(x: int) -> int:
    """Put two zero bits between the 21 lowest bits."""
    x = (x | (x << 32)) & 0x001F00000000FFFF
    x = (x | (x << 16)) & 0x001F0000FF0000FF
    x = (x | (x << 8)) & 0x100F00F00F00F00F
    x = (x | (x << 4)) & 0x10C30C30C30C30C3
    return (x | (x << 2)) & 0x1249249249249249


def morton_order_shared(
    minimum: Floats, maximum: Floats, order: NDArray[np.int64], spare: NDArray[np.int64]
) -> None:
    """`morton_order`, to the bit, by several threads where they pay."""
    count = len(minimum)
    if is_dealt(count):
        ends = np.array(run(_extent_kernel, count, FEWEST_NUMBERS, minimum, maximum))
        low = ends[:, :3].min(axis=0)
        side = float((ends[:, 3:6].max(axis=0) - low).max())
        if ends[:, 6].all() and SHORTEST <= side < np.inf:
            row_bits = int(count).bit_length()
            bits = int(code_bits(count, row_bits))
            where = (*low.tolist(), LAST / side)
            run(_code_kernel, count, FEWEST_NUMBERS, minimum, maximum, where, bits, row_bits, order)
            starts = deal(order, spare, row_bits + bits)
            sort = minimum, maximum, order, spare, starts, bits, row_bits
            run_buckets(lambda first, last: _bucket_kernel(*sort, first, last), starts)
            return
    morton_order(minimum, maximum, order, spare)


@njit
def _extent_kernel(
    minimum: Floats, maximum: Floats, start: int, stop: int
) -> tuple[float, float, float, float, float, float, bool]:
    """Return the extent of the centres, and whether no bounds are empty or NaN."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    usual = True
    for n in range(start, stop):
        usual &= minimum[n, 0] <= maximum[n, 0]
        for k in range(3):
            middle = 0.5 * minimum[n, k] + 0.5 * maximum[n, k]
            usual &= middle == middle
            low[k], high[k] = min(low[k], middle), max(high[k], middle)
    return low[0], low[1], low[2], high[0], high[1], high[2], usual


@njit
def _code_kernel(
    minimum: Floats, maximum: Floats, cells: Cells, bits: int, row_bits: int, numbers: np.ndarray,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Write the numbers of rows ``start`` to ``stop``: the code in the bits above the row."""
    for n in range(start, stop):
        code = _code(minimum, maximum, n, cells)
        numbers[n] = n | (code >> (BITS - bits) << row_bits)


@njit
def _bucket_kernel(
    minimum: Floats, maximum: Floats, order: np.ndarray, spare: np.ndarray, starts: np.ndarray,
    bits: int, row_bits: int, first: int, last: int,
) -> None:  # fmt: skip
    """Write the order of buckets ``first`` to ``last`` of numbers in ``spare``."""
    for bucket in range(first, last):
        start, stop = starts[bucket], starts[bucket + 1]
        rows, numbers = order[start:stop], spare[start:stop]
        sort_numbers(numbers, rows, row_bits, row_bits + bits - BUCKET_BITS)
        _part(numbers, rows, numbers, row_bits)
        _divide(minimum, maximum, rows, numbers, row_bits)
