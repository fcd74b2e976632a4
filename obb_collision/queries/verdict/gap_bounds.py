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
numbers are those of ``sat``; u, T and the bound of the rough formulas those of ``verdict``.

Error analysis: a gap not divided by the length of its axis, plus the careful bound, is off by at
most 510 u T (``verdict``). The length of an edge axis: let A = Q (I + E) be the rotation of a,
Q orthonormal and abs(E) <= 96 u (from 64 u in each entry of A^T A, three to a row). In the frame
of Q the axis is (e_i + E e_i) x w, and the dot products used for it are those of e_k + E e_k with
w, for the two k other than i. Both differ from e_i x w by at most 96 u, in sum and with rounding
by 256 u: times gap / length, at most T. Face normals are shorter or longer than 1 by 64 u at most.
Together less than 800 u T over the length; the bound used is 1024 u T over the computed length.
Its relative error, 256 u / SHORT, is nothing beside what is left over.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit_inlined
from obb_collision.numerics.constants import FAST_BOUND, SHORT_SQUARE, UNDERFLOW
from obb_collision.numerics.vec3 import max_of
from obb_collision.queries.verdict.pair_frame import Pair
from obb_collision.queries.verdict.sat import (
    edge_axes,
    edge_gaps,
    face_gaps_of_a,
    face_gaps_of_b,
    rows_of,
)
from obb_collision.typing import Vector

#: Of three axes each: faces of a, faces of b, and an edge of a with each edge of b.
Bounds = tuple[Vector, Vector, Vector, Vector, Vector]


@njit_inlined
def possible_axes(pair: Pair, size: float) -> float:
    """Return which axes may have the largest gap: a sum of powers of two; without a branch.

    size: T.
    """
    least, (p, q, u, v, w) = gap_bounds(pair, size)
    faces = _powers(p, least, 1.0) + _powers(q, least, 8.0)
    edges = _powers(u, least, 64.0) + _powers(v, least, 512.0) + _powers(w, least, 4096.0)
    return faces + edges


@njit_inlined
def _powers(most: Vector, least: float, power: float) -> float:
    x, y, z = most
    first, second = power if x >= least else 0.0, 2.0 * power if y >= least else 0.0
    return first + second + (4.0 * power if z >= least else 0.0)


@njit_inlined
def gap_bounds(pair: Pair, size: float) -> tuple[float, Bounds]:
    """Return a lower bound of the largest gap, and upper bounds of all.

    Infinite where edges are nearly parallel.
    """
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    error = FAST_BOUND * size + UNDERFLOW
    p, q = face_gaps_of_a(pair), face_gaps_of_b(pair)
    least = max(max_of(p), max_of(q)) - error
    low_u, u = _bound_edges(edge_gaps(edge_axes(d, h, x, y, z, f[1], f[2])), x, error)
    low_v, v = _bound_edges(edge_gaps(edge_axes(d, h, y, z, x, f[2], f[0])), y, error)
    low_w, w = _bound_edges(edge_gaps(edge_axes(d, h, z, x, y, f[0], f[1])), z, error)
    least = max(max(least, low_u), max(low_v, low_w))
    p, q = (p[0] + error, p[1] + error, p[2] + error), (q[0] + error, q[1] + error, q[2] + error)
    return least, (p, q, *rows_of((u, v, w)))


@njit_inlined
def _bound_edges(gaps: Vector, x: Vector, error: float) -> tuple[float, Vector]:
    """Return a lower bound of the largest gap along x crossed with each edge of a, and all bounds.

    gaps: not divided by the lengths of the axes.
    """
    low0, most0 = _bound_edge(gaps[0], x[1], x[2], error)
    low1, most1 = _bound_edge(gaps[1], x[2], x[0], error)
    low2, most2 = _bound_edge(gaps[2], x[0], x[1], error)
    return max(max(low0, low1), low2), (most0, most1, most2)


@njit_inlined
def _bound_edge(gap: float, p: float, q: float, error: float) -> tuple[float, float]:
    """Return bounds of the gap along a unit edge axis, whose components are p and q but for signs.

    gap: not divided by the length of the axis.
    """
    square = p * p + q * q
    parallel = square < SHORT_SQUARE
    scale = 1.0 / math.sqrt(SHORT_SQUARE if parallel else square)
    low, most = (gap - error) * scale, (gap + error) * scale
    return -math.inf if parallel else low, math.inf if parallel else most
