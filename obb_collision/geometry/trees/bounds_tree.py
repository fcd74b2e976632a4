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

from obb_collision import _threads
from obb_collision._jit import njit
from obb_collision.geometry.trees.morton import morton_order_shared
from obb_collision.numerics.intrinsics import LANES, fetch_row
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
    """Bounds (n, 3) to (n, 3), which may be empty (minimum above maximum), and a tree over them.

    order (n,): the rows, neighbours side by side. nodes (m, 6, LANES): blocks of bounds, minimum
    and maximum; starts: where each level begins in them, from the boxes themselves to the root.
    """

    minimum: Floats
    maximum: Floats
    order: NDArray[np.int64]
    nodes: Floats
    starts: NDArray[np.int64]

    @classmethod
    def build(cls, minimum: Floats, maximum: Floats) -> BoundsTree:
        """Return the tree over bounds, which are not copied."""
        order, spare = np.empty(len(minimum), np.int64), np.empty(len(minimum), np.int64)
        morton_order_shared(minimum, maximum, order, spare)
        starts = _level_starts(len(minimum))
        nodes = np.empty((starts[-1], 6, LANES))  # not in a kernel: numpy asks for large pages
        _threads.run(_fill_boxes, int(starts[1]), FEWEST_BLOCKS, minimum, maximum, order, nodes)
        if len(starts) > 2:
            first = nodes, int(starts[0]), int(starts[1])
            _threads.run(_fill_level, int(starts[2] - starts[1]), FEWEST_BLOCKS, *first)
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
