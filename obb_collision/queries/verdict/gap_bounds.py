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

"""Bounds of the gaps along all 15 axes of two boxes, from one matrix of dot products.

For finding the largest: only axes that may have it need careful calculation. The axes and their
numbers are those of ``separation``, and so are u, T and what is known of the rough formulas.

Error analysis: a gap not divided by the length of its axis, plus the careful bound, is off by at
most 510 u T (``separation``). The length of an edge axis: let A = Q (I + E) be the rotation of a,
Q orthonormal and abs(E) <= 96 u (from 64 u in each entry of A^T A, three to a row). In the frame
of Q the axis is (e_i + E e_i) x w, and the dot products used for it are those of e_k + E e_k with
w, for the two k other than i. Both differ from e_i x w by at most 96 u, in sum and with rounding
by 256 u: times gap / length, at most T. Face normals are shorter or longer than 1 by 64 u at most.
Together less than 800 u T over the length; the bound used is 1024 u T over the computed length.
Its relative error, 256 u / SHORT, is nothing beside what is left over.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.numerics.constants import FAST_BOUND, SHORT_SQUARE, UNDERFLOW
from obb_collision.queries.verdict.sat import Pair, dot, dot_abs
from obb_collision.typing import Floats


@njit
def bound_gaps(pair: Pair, size: float, most: Floats) -> float:
    """Write the most that each gap can be (15,), and return the least the largest must be.

    size: T. Of edges nearly parallel nothing is told: infinity.
    """
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    error = FAST_BOUND * size + UNDERFLOW
    u, v, w = (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])
    gap0 = abs(d[0]) - (h[0] + dot_abs(f, u))
    gap1 = abs(d[1]) - (h[1] + dot_abs(f, v))
    gap2 = abs(d[2]) - (h[2] + dot_abs(f, w))
    gap3 = abs(dot(d, x)) - (f[0] + dot_abs(h, x))
    gap4 = abs(dot(d, y)) - (f[1] + dot_abs(h, y))
    gap5 = abs(dot(d, z)) - (f[2] + dot_abs(h, z))
    most[0] = gap0 + error
    most[1] = gap1 + error
    most[2] = gap2 + error
    most[3] = gap3 + error
    most[4] = gap4 + error
    most[5] = gap5 + error
    least = max(max(gap0, gap1, gap2), max(gap3, gap4, gap5)) - error
    for j in range(3):
        low0, most[6 + j] = _bound_edge(
            d[1], d[2], x[1], x[2], h[1], h[2], f[1], f[2], y[0], z[0], error
        )
        low1, most[9 + j] = _bound_edge(
            d[2], d[0], x[2], x[0], h[2], h[0], f[1], f[2], y[1], z[1], error
        )
        low2, most[12 + j] = _bound_edge(
            d[0], d[1], x[0], x[1], h[0], h[1], f[1], f[2], y[2], z[2], error
        )
        least = max(max(least, low0), max(low1, low2))
        x, y, z = y, z, x
        f = f[1], f[2], f[0]
    return least


@njit
def _bound_edge(
    dk: float, dm: float, uk: float, um: float, hk: float, hm: float,
    fp: float, fq: float, p: float, q: float, error: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the least and the most of the gap along unit edge i of a crossed with edge u of b.

    k, m: components after i; p, q: component i of the axes of b after u.
    """
    square = uk * uk + um * um
    if square < SHORT_SQUARE:
        return -math.inf, math.inf
    scale = 1.0 / math.sqrt(square)
    gap = abs(dm * uk - dk * um) - (hk * abs(um) + hm * abs(uk)) - (fp * abs(q) + fq * abs(p))
    return (gap - error) * scale, (gap + error) * scale
