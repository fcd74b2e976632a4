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

"""A hierarchy over axis-aligned bounds: blocks of neighbours in Morton order.

As Karras 2012 without the pointers: eight neighbours are a leaf, eight leaves a block of the next
level, and so on up to one block. Blocks hold their bounds number by number, so that a processor
compares all eight at once. Bounds are merged, never rounded.

A loop over a block compares one number after another, 15 ns instead of 1.8: numba does not
vectorise it. So the comparison is written for LLVM. Processors with shorter vectors take several
steps.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import config as _config
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.numerics.intrinsics import LANES, fetch_row
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
from obb_collision.typing import Floats, Vector

config: Any = _config  # its attributes are set at run time

#: LANES, the bounds in a block, as a power of two.
LANE_BITS = 3


def _overlaps_in_python(
    nodes: Floats, block: int, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float
) -> int:
    low, high = nodes[block, :3], nodes[block, 3:]
    mask = 0
    for k in range(LANES):
        inside = (x0 <= high[0, k]) & (low[0, k] <= x1) & (y0 <= high[1, k])
        inside &= (low[1, k] <= y1) & (z0 <= high[2, k]) & (low[2, k] <= z1)
        mask |= int(inside) << k
    return mask


def _overlaps_in_lanes(
    context: Any, nodes: Any, block: Any,
    x0: Any, y0: Any, z0: Any, x1: Any, y1: Any, z1: Any,
) -> Any:  # fmt: skip
    """Return which bounds in ``nodes[block]`` (6, LANES) overlap a box, a bit for each.

    x0 to z0 and x1 to z1: minimum and maximum of that box.
    """
    signature = types.int64(nodes, types.int64, *[types.float64] * 6)
    doubles = ir.VectorType(ir.DoubleType(), LANES)
    index = ir.IntType(64)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array = context.make_array(nodes)(context, builder, values[0])
        first = builder.mul(values[1], ir.Constant(index, 6 * LANES))

        def bound(k: int) -> Any:
            place = builder.add(first, ir.Constant(index, k * LANES))
            pointer = builder.bitcast(builder.gep(array.data, [place]), doubles.as_pointer())
            loaded = builder.load(pointer)
            loaded.align = 8  # as numpy does
            return loaded

        def spread(number: Any) -> Any:
            empty = ir.Constant(doubles, ir.Undefined)
            first_lane = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
            lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
            return builder.shuffle_vector(first_lane, empty, lanes)

        mask = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [1] * LANES)
        for k in range(3):
            low = builder.fcmp_ordered("<=", bound(k), spread(values[5 + k]))
            high = builder.fcmp_ordered("<=", spread(values[2 + k]), bound(3 + k))
            mask = builder.and_(mask, builder.and_(low, high))
        return builder.zext(builder.bitcast(mask, ir.IntType(LANES)), index)

    return signature, generate


def _lowest_in_python(mask: int) -> int:
    return (int(mask) & -int(mask)).bit_length() - 1


def _lowest_in_lanes(context: Any, mask: Any) -> Any:
    """Return the number of the lowest bit that is set; there must be one."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.cttz(values[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), generate


interpreted = bool(config.DISABLE_JIT)
overlaps: Any = _overlaps_in_python if interpreted else intrinsic(_overlaps_in_lanes)
lowest: Any = _lowest_in_python if interpreted else intrinsic(_lowest_in_lanes)


#: Levels of blocks: enough for 8^21 boxes.
LEVELS = 21
#: Depth-first traversal leaves at most LANES - 1 blocks a level behind.
STACK = LEVELS * LANES
#: Bounds of lanes without a box: nothing overlaps them, not even infinite bounds.
NOTHING = np.nan
#: Blocks filled before a second thread pays.
FEWEST_BLOCKS = 1024
#: Boxes ahead of the loop that are fetched from memory.
AHEAD = 32


class BoundsTree(NamedTuple):
    """Axis-aligned bounds, and a tree over them.

    minimum, maximum (n, 3): bounds; empty ones have a minimum above the maximum. order (n,): their
    rows along the Morton curve. nodes (m, 6, LANES): blocks of minima and maxima. starts: the first
    block of each level, from the level of the boxes to the root, and the end.
    """

    minimum: Floats
    maximum: Floats
    order: NDArray[np.int64]
    nodes: Floats
    starts: NDArray[np.int64]

    @classmethod
    def build(cls, minimum: Floats, maximum: Floats) -> BoundsTree:
        """Build the tree over bounds, which are not copied."""
        order, spare = np.empty(len(minimum), np.int64), np.empty(len(minimum), np.int64)
        morton_order_shared(minimum, maximum, order, spare)
        starts = _level_starts(len(minimum))
        nodes = np.empty((starts[-1], 6, LANES))  # not in a kernel: numpy asks for large pages
        run(_fill_boxes, int(starts[1]), FEWEST_BLOCKS, minimum, maximum, order, nodes)
        if len(starts) > 2:
            first = nodes, int(starts[0]), int(starts[1])
            run(_fill_level, int(starts[2] - starts[1]), FEWEST_BLOCKS, *first)
            _fill_levels(nodes, starts)
        return cls(minimum, maximum, order, nodes, starts)

    @property
    def leaves(self) -> int:
        """Number of blocks of boxes."""
        return int(self.starts[1])


@lru_cache(64)
def _level_starts(count: int) -> NDArray[np.int64]:
    """Return where each level of a tree of ``count`` boxes starts in its blocks, and the end."""
    starts, size = [0], count
    while size > 1 or len(starts) == 1:
        size = max(1, (size + LANES - 1) // LANES)
        starts.append(starts[-1] + size)
    return np.array(starts)


@njit
def _fill_boxes(
    minimum: Floats, maximum: Floats, order: np.ndarray, nodes: Floats, start: int, stop: int
) -> None:
    """Write blocks ``start`` to ``stop`` of the boxes."""
    for block in range(start, stop):
        for lane in range(LANES):
            place = LANES * block + lane
            if place + AHEAD < len(order):
                fetch_row(minimum, order[place + AHEAD], 3)
                fetch_row(maximum, order[place + AHEAD], 3)
            if place < len(order):
                for k in range(3):
                    nodes[block, k, lane] = minimum[order[place], k]
                    nodes[block, 3 + k, lane] = maximum[order[place], k]
            else:
                nodes[block, :, lane] = NOTHING


@njit
def _fill_levels(nodes: Floats, starts: np.ndarray) -> None:
    """Write the blocks from the third level on."""
    for level in range(2, len(starts) - 1):
        _fill_level(nodes, starts[level - 1], starts[level], 0, starts[level + 1] - starts[level])


@njit
def _fill_level(nodes: Floats, below: int, first: int, start: int, stop: int) -> None:
    """Write blocks ``start`` to ``stop`` of the level from ``first`` on, from the one below it."""
    nodes[first + start : first + stop] = NOTHING
    for child in range(LANES * start, min(LANES * stop, first - below)):
        _merge(nodes, below + child, first + (child >> LANE_BITS), child & (LANES - 1))


@njit
def _merge(nodes: Floats, block: int, parent: int, lane: int) -> None:
    """Write the bounds of a whole block into a lane of its parent."""
    for k in range(3):
        low, high = nodes[block, k, 0], nodes[block, 3 + k, 0]
        for n in range(1, LANES):
            low, high = min(low, nodes[block, k, n]), max(high, nodes[block, 3 + k, n])
        nodes[parent, k, lane], nodes[parent, 3 + k, lane] = low, high


@njit
def move_kernel(tree: BoundsTree, places: np.ndarray) -> None:
    """Update the bounds at places in the order, and all blocks above them."""
    minimum, maximum, order, nodes, starts = tree
    for place in places:
        block, lane = place >> LANE_BITS, place & (LANES - 1)
        for k in range(3):
            nodes[block, k, lane] = minimum[order[place], k]
            nodes[block, 3 + k, lane] = maximum[order[place], k]
        for level in range(1, len(starts) - 1):
            child, block = block, block >> LANE_BITS
            _merge(nodes, starts[level - 1] + child, starts[level] + block, child & (LANES - 1))


@njit(inline=True)
def overlapping(tree: BoundsTree, low: Vector, high: Vector, least: int, out: np.ndarray) -> int:
    """Write the rows from ``least`` on whose bounds overlap a box; return their number.

    In the order of the tree, until ``out`` is full.
    """
    order, nodes, starts = tree.order, tree.nodes, tree.starts
    levels, waiting = np.empty(STACK, np.int64), np.empty(STACK, np.int64)
    levels[0], waiting[0] = len(starts) - 2, 0
    depth, count = 1, 0
    while depth > 0:
        depth -= 1
        level, block = levels[depth], waiting[depth]
        mask = overlaps(
            nodes, starts[level] + block, low[0], low[1], low[2], high[0], high[1], high[2]
        )
        while mask != 0:
            child = LANES * block + lowest(mask)
            mask &= mask - 1
            if level > 0:
                levels[depth], waiting[depth] = level - 1, child
                depth += 1
            elif order[child] >= least:
                if count == len(out):
                    return count
                out[count] = order[child]
                count += 1
    return count


# Bounds in the order of a Z-order curve (Morton 1966) through their centres: neighbours are near.
# Cells are cubes; a code has as many bits along an axis as fit, so boxes on a line or in a plane
# get as many cells as others. Where more boxes than a leaf holds share a cell, it is divided in the
# same way, so that a far outlier, or tight clusters far apart, do not make cells too coarse.

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
    """Write the rows of bounds to ``order`` along the Morton curve; empty bounds come last.

    minimum, maximum (n, 3); order, spare (n,) int64; ``spare`` is scratch space.
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
    """Write the same order as ``morton_order``, by several threads where that is faster."""
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
