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

"""Bounds eight at a time: one comparison of the processor for all, and a bit for each.

numba makes eight comparisons one after another of such a loop, which takes eight times as long
(15 and 1.8 ns a block): so LLVM is told. Every processor can do it, by several steps where its
vectors are shorter.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import config as _config
from numba.core import types
from numba.extending import intrinsic

from obb_collision.typing import Floats

config: Any = _config  # its attributes are set at run time

#: Bounds in a block: eight doubles are one vector of AVX-512, two of AVX.
LANES = 8
#: The same as a power of two.
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
    """Return which of the bounds of ``nodes[block]`` (6, LANES) overlap others, a bit for each.

    x0 to z0 and x1 to z1: minimum and maximum of the others.
    """
    signature = types.int64(nodes, types.int64, *[types.float64] * 6)
    doubles = ir.VectorType(ir.DoubleType(), LANES)
    index = ir.IntType(64)

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        array = context.make_array(nodes)(context, builder, given[0])
        first = builder.mul(given[1], ir.Constant(index, 6 * LANES))

        def bound(k: int) -> Any:
            place = builder.add(first, ir.Constant(index, k * LANES))
            pointer = builder.bitcast(builder.gep(array.data, [place]), doubles.as_pointer())
            loaded = builder.load(pointer)
            loaded.align = 8  # as numpy does
            return loaded

        def spread(number: Any) -> Any:
            none = ir.Constant(doubles, ir.Undefined)
            one = builder.insert_element(none, number, ir.Constant(ir.IntType(32), 0))
            lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
            return builder.shuffle_vector(one, none, lanes)

        mask = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [1] * LANES)
        for k in range(3):
            low = builder.fcmp_ordered("<=", bound(k), spread(given[5 + k]))
            high = builder.fcmp_ordered("<=", spread(given[2 + k]), bound(3 + k))
            mask = builder.and_(mask, builder.and_(low, high))
        return builder.zext(builder.bitcast(mask, ir.IntType(LANES)), index)

    return signature, generate


def _lowest_in_python(mask: int) -> int:
    return (int(mask) & -int(mask)).bit_length() - 1


def _lowest_in_lanes(context: Any, mask: Any) -> Any:
    """Return the number of the lowest bit that is set; there must be one."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.cttz(given[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), generate


interpreted = bool(config.DISABLE_JIT)
overlaps: Any = _overlaps_in_python if interpreted else intrinsic(_overlaps_in_lanes)
lowest: Any = _lowest_in_python if interpreted else intrinsic(_lowest_in_lanes)
