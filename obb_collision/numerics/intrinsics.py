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

"""Instructions of the processor that numba does not offer: eight numbers at once, and prefetching.

In a loop numba compares numbers one by one: four points take 5 ns. As vectors of LLVM forty do;
processors with shorter vectors take several steps. Without prefetching, rows in random order take
two to nine times as long with a hundred thousand boxes and more.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils as _cgutils
from numba.core import config as _config
from numba.core import types
from numba.extending import intrinsic

from obb_collision._jit import njit
from obb_collision.typing import Floats, Vector

config: Any = _config  # numba has no types, and its settings are set at run time
cgutils: Any = _cgutils

#: Points in a block: eight doubles are one vector of AVX-512, two of AVX.
LANES = 8


def in_blocks(points: Floats) -> Floats:
    """Return points (n, 3), n >= 1, as blocks (m, 3, LANES), filled up with the last point."""
    count = -(-len(points) // LANES) * LANES
    rows = np.minimum(np.arange(count), len(points) - 1)
    return np.ascontiguousarray(points[rows].reshape(-1, LANES, 3).transpose(0, 2, 1))


@njit(refcount=False)
def farthest(blocks: Floats, first: int, last: int, n: Vector) -> Vector:
    """Return the first point of blocks ``first`` to ``last`` - 1 that reaches farthest along n."""
    row = _farthest_row(blocks, first, last, n[0], n[1], n[2])
    block, lane = row // LANES, row % LANES
    return blocks[block, 0, lane], blocks[block, 1, lane], blocks[block, 2, lane]


def _row_in_python(blocks: Floats, first: int, last: int, x: float, y: float, z: float) -> int:
    reach = x * blocks[first:last, 0] + y * blocks[first:last, 1] + z * blocks[first:last, 2]
    return first * LANES + int(reach.argmax())


def _row_in_lanes(context: Any, blocks: Any, first: Any, last: Any, x: Any, y: Any, z: Any) -> Any:
    """Return LANES times the block, plus the lane, of the first point that reaches farthest."""
    signature = types.int64(blocks, types.int64, types.int64, *[types.float64] * 3)
    number, index = ir.DoubleType(), ir.IntType(64)
    doubles, longs = ir.VectorType(number, LANES), ir.VectorType(index, LANES)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(blocks)(context, builder, arguments[0])
        axes = [_spread(builder, doubles, arguments[k]) for k in (3, 4, 5)]
        best = cgutils.alloca_once_value(builder, ir.Constant(doubles, [float("-inf")] * LANES))
        where = cgutils.alloca_once_value(builder, _spread(builder, longs, arguments[1]))
        with cgutils.for_range(builder, arguments[2], start=arguments[1], intp=index) as loop:
            start = builder.mul(loop.index, ir.Constant(index, 3 * LANES))
            terms = []
            for k in range(3):
                place = builder.add(start, ir.Constant(index, k * LANES))
                pointer = builder.bitcast(builder.gep(array.data, [place]), doubles.as_pointer())
                loaded = builder.load(pointer)
                loaded.align = 8  # as numpy does
                terms.append(builder.fmul(axes[k], loaded))
            reach = builder.fadd(builder.fadd(terms[0], terms[1]), terms[2])
            old, block = builder.load(best), _spread(builder, longs, loop.index)
            more = builder.fcmp_ordered(">", reach, old)
            builder.store(builder.select(more, reach, old), best)
            builder.store(builder.select(more, block, builder.load(where)), where)
        return _first_of_largest(builder, builder.load(best), builder.load(where))

    return signature, generate


def _spread(builder: Any, kind: Any, number: Any) -> Any:
    """Return a vector with a number in every lane."""
    undefined = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, undefined, lanes)


def _first_of_largest(builder: Any, best: Any, where: Any) -> Any:
    """Return the least row among those of the lanes with the largest value."""
    index, rows = ir.IntType(64), []
    for k in range(LANES):
        lane = ir.Constant(ir.IntType(32), k)
        block = builder.mul(builder.extract_element(where, lane), ir.Constant(index, LANES))
        own = builder.add(block, ir.Constant(index, k))
        rows.append((builder.extract_element(best, lane), own))
    while len(rows) > 1:  # two by two: each comparison waits for three others, not for seven
        rows = [_better(builder, *rows[k : k + 2]) for k in range(0, len(rows), 2)]
    return rows[0][1]


def _better(builder: Any, first: tuple[Any, Any], second: tuple[Any, Any]) -> tuple[Any, Any]:
    """Return the value and row with the larger value; of equal values the lesser row."""
    more = builder.fcmp_ordered(">", second[0], first[0])
    same = builder.fcmp_ordered("==", second[0], first[0])
    sooner = builder.and_(same, builder.icmp_signed("<", second[1], first[1]))
    chosen = builder.or_(more, sooner)
    value, row = (builder.select(chosen, y, x) for x, y in zip(first, second, strict=True))
    return value, row


_farthest_row: Any = _row_in_python if config.DISABLE_JIT else intrinsic(_row_in_lanes)


def _fetch_in_python(array: Any, index: int) -> None:
    """Do nothing: Python has no prefetching."""


def _fetch_in_llvm(context: Any, array: Any, index: Any) -> Any:
    """Prefetch an element; index: its place in the flattened C-contiguous array."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        text, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        data = context.make_array(array)(context, builder, arguments[0]).data
        name = "llvm.prefetch.p0i8"
        kind = ir.FunctionType(ir.VoidType(), [text, number, number, number])
        fetch = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
        place = builder.bitcast(builder.gep(data, [arguments[1]]), text)
        builder.call(fetch, [place, number(0), number(3), number(1)])  # to read, near, data
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


fetch: Any = _fetch_in_python if config.DISABLE_JIT else intrinsic(_fetch_in_llvm)


@njit(refcount=False)
def fetch_row(array: Any, row: int, size: int) -> None:
    """Prefetch a row of ``size`` doubles, at most nine, of a C-contiguous array."""
    fetch(array, row * size)
    fetch(array, row * size + size - 1)


@njit(refcount=False)
def fetch_box(boxes: Any, row: int) -> None:
    """Prefetch a box of ``BoxArrays``."""
    fetch_row(boxes.centers, row, 3)
    fetch_row(boxes.rotations, row, 9)
    fetch_row(boxes.half_extents, row, 3)


@njit(refcount=False)
def fetch_pairs(boxes: Any, pairs: Any, start: int, stop: int) -> None:
    """Prefetch the boxes of pairs ``start`` to ``stop`` of (m, 2), as far as there are any."""
    for n in range(start, min(stop, len(pairs))):
        fetch_box(boxes, pairs[n, 0])
        fetch_box(boxes, pairs[n, 1])
