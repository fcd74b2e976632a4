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

"""The axis with the largest gap of two boxes, of the 15 of the separating axis test.

A quick calculation in the frame of a (see ``separation`` for the axes and for what is certain):
good for where to look first, and each gap is a lower bound of the distance up to rounding.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.numerics.constants import SHORT_SQUARE
from obb_collision.queries.verdict.sat import Pair, Vector, axis_of_b, dot, dot_abs, replaced

Axis = tuple[float, int]


@njit
def best_face(pair: Pair) -> Axis:
    """Return the largest gap along a face normal, and its number: 0 to 2 of a, 3 to 5 of b."""
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    best = -math.inf, 0
    best = _larger(best, abs(d[0]) - h[0] - dot_abs(f, (x[0], y[0], z[0])), 0)
    best = _larger(best, abs(d[1]) - h[1] - dot_abs(f, (x[1], y[1], z[1])), 1)
    best = _larger(best, abs(d[2]) - h[2] - dot_abs(f, (x[2], y[2], z[2])), 2)
    best = _larger(best, abs(dot(d, x)) - f[0] - dot_abs(h, x), 3)
    best = _larger(best, abs(dot(d, y)) - f[1] - dot_abs(h, y), 4)
    return _larger(best, abs(dot(d, z)) - f[2] - dot_abs(h, z), 5)


@njit
def best_edge(pair: Pair, best: Axis) -> Axis:
    """Return the largest gap along a unit edge axis i, j, number 6 + 3 i + j; else ``best``.

    Only positive gaps count. The largest by a quick calculation: not certain among equals and
    among nearly parallel edges.
    """
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    for j in range(3):
        best = _larger(
            best, _edge_gap(d[1], d[2], x[1], x[2], h[1], h[2], f[1], f[2], y[0], z[0]), 6 + j
        )
        best = _larger(
            best, _edge_gap(d[2], d[0], x[2], x[0], h[2], h[0], f[1], f[2], y[1], z[1]), 9 + j
        )
        best = _larger(
            best, _edge_gap(d[0], d[1], x[0], x[1], h[0], h[1], f[1], f[2], y[2], z[2]), 12 + j
        )
        x, y, z = y, z, x
        f = f[1], f[2], f[0]
    return best


@njit
def _edge_gap(
    dk: float, dm: float, uk: float, um: float, hk: float, hm: float,
    fp: float, fq: float, p: float, q: float,
) -> float:  # fmt: skip
    """Return the gap along edge i of a crossed with edge u of b; minus infinity if not positive.

    k, m: components after i; p, q: component i of the axes of b after u.
    """
    gap = abs(dm * uk - dk * um) - (hk * abs(um) + hm * abs(uk)) - (fp * abs(q) + fq * abs(p))
    square = uk * uk + um * um
    if gap > 0.0 and square > SHORT_SQUARE:
        return gap / math.sqrt(square)
    return -math.inf


@njit
def _larger(best: Axis, gap: float, number: int) -> Axis:
    return (gap, number) if gap > best[0] else best


@njit
def unit_axis(pair: Pair, number: int) -> Vector:
    """Return the unit vector of an axis, from a to b."""
    if number < 3:
        n = replaced((0.0, 0.0, 0.0), number, 1.0)
    elif number < 6:
        n = axis_of_b(pair, number - 3)
    else:
        i = (number - 6) // 3
        u = axis_of_b(pair, (number - 6) % 3)
        if i == 0:
            n = 0.0, -u[2], u[1]
        elif i == 1:
            n = u[2], 0.0, -u[0]
        else:
            n = -u[1], u[0], 0.0
        norm = math.sqrt(dot(n, n))
        n = n[0] / norm, n[1] / norm, n[2] / norm
    if dot(n, pair.d) < 0.0:
        return -n[0], -n[1], -n[2]
    return n
