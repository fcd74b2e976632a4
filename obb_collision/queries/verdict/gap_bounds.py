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

from obb_collision._jit import njit
from obb_collision.numerics.constants import FAST_BOUND, SHORT_SQUARE, UNDERFLOW
from obb_collision.queries.verdict.pair_frame import Pair
from obb_collision.queries.verdict.sat import edge_axes, edge_gaps, face_gaps_of_a, face_gaps_of_b
from obb_collision.typing import Floats


@njit
def bound_gaps(pair: Pair, size: float, most: Floats) -> float:
    """Write an upper bound of each gap (15,); return a lower bound of their maximum.

    size: T. The bound is infinite where edges are nearly parallel.
    """
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    error = FAST_BOUND * size + UNDERFLOW
    faces_a, faces_b = face_gaps_of_a(pair), face_gaps_of_b(pair)
    least = max(max(faces_a[0], faces_a[1], faces_a[2]), max(faces_b[0], faces_b[1], faces_b[2]))
    least -= error
    for k in range(3):
        most[k], most[3 + k] = faces_a[k] + error, faces_b[k] + error
    for j in range(3):
        gaps = edge_gaps(edge_axes(d, h, x, y, z, f[1], f[2]))
        low0, most[6 + j] = _bound_edge(gaps[0], x[1], x[2], error)
        low1, most[9 + j] = _bound_edge(gaps[1], x[2], x[0], error)
        low2, most[12 + j] = _bound_edge(gaps[2], x[0], x[1], error)
        least = max(max(least, low0), max(low1, low2))
        x, y, z = y, z, x
        f = f[1], f[2], f[0]
    return least


@njit
def _bound_edge(gap: float, p: float, q: float, error: float) -> tuple[float, float]:
    """Return bounds of the gap along a unit edge axis, whose components are p and q but for signs.

    gap: not divided by the length of the axis.
    """
    square = p * p + q * q
    if square < SHORT_SQUARE:
        return -math.inf, math.inf
    scale = 1.0 / math.sqrt(square)
    return (gap - error) * scale, (gap + error) * scale
