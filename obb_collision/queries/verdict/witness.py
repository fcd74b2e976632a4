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

"""The witness of a verdict: the signed gap of two boxes, its axis, and a point of the contact.

``careful_gap`` is the gap along one axis, nearly exact: cross products without cancellation.
The result doesn't depend on the order of the boxes, or of their axes: sums are sorted. Its error
analysis is that of ``verdict``.

``gap_bounds`` bounds the gaps along all 15 axes, from one matrix of dot products: only axes that
may have the largest need careful calculation. The axes and their numbers are those of ``sat``; u, T
and the bound of the rough formulas those of ``verdict``.

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

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import FAST_BOUND, PARALLEL, SHORT_SQUARE, UNDERFLOW
from obb_collision.numerics.vec3 import (
    careful_cross,
    clamped,
    combined,
    dot,
    max_abs,
    max_of,
    minus,
    negated,
    norm,
    scaled,
)
from obb_collision.queries.verdict.sat import (
    AXES,
    BoxAt,
    Pair,
    along_b,
    edge_axes,
    edge_gaps,
    face_gaps_of_a,
    face_gaps_of_b,
    factors,
    pair_of,
    projected_radius,
    rows_of,
)
from obb_collision.typing import Axes, Vector


@njit
def careful_gap(a: BoxAt, b: BoxAt, axis: int) -> tuple[float, Vector]:
    """Return the gap along a unit axis (numbers as in ``sat``), and the axis, from a towards b.

    Face normals are cross products too: stored axes are orthonormal to rounding only.

    Edges shorter than PARALLEL in their product count as parallel: doubles can't distinguish them.
    Such an axis can separate only if another one does up to its bound (the argument of
    ``verdict._implied_margin``, with a margin below every bound), so its gap is minus infinity.
    """
    u, v = factors(a.axes, b.axes, axis)
    x, y, z = careful_cross(u, v)
    size = norm((x, y, z))
    if size < PARALLEL:
        return -np.inf, (0.0, 0.0, 0.0)
    n = x / size, y / size, z / size
    along = dot(n, minus(b.center, a.center))
    gap = abs(along) - (
        projected_radius(n, a.axes, a.half_extents) + projected_radius(n, b.axes, b.half_extents)
    )
    return gap, negated(n) if along < 0.0 else n


#: Of three axes each: faces of a, faces of b, and an edge of a with each edge of b.
Bounds = tuple[Vector, Vector, Vector, Vector, Vector]


@njit(inline=True)
def possible_axes(pair: Pair, size: float) -> float:
    """Return which axes may have the largest gap: a sum of powers of two; without a branch.

    size: T.
    """
    least, (p, q, u, v, w) = gap_bounds(pair, size)
    faces = _powers(p, least, 1.0) + _powers(q, least, 8.0)
    edges = _powers(u, least, 64.0) + _powers(v, least, 512.0) + _powers(w, least, 4096.0)
    return faces + edges


@njit(inline=True)
def _powers(most: Vector, least: float, power: float) -> float:
    x, y, z = most
    first, second = power if x >= least else 0.0, 2.0 * power if y >= least else 0.0
    return first + second + (4.0 * power if z >= least else 0.0)


@njit(inline=True)
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


@njit(inline=True)
def _bound_edges(gaps: Vector, x: Vector, error: float) -> tuple[float, Vector]:
    """Return a lower bound of the largest gap along x crossed with each edge of a, and all bounds.

    gaps: not divided by the lengths of the axes.
    """
    low0, most0 = _bound_edge(gaps[0], x[1], x[2], error)
    low1, most1 = _bound_edge(gaps[1], x[2], x[0], error)
    low2, most2 = _bound_edge(gaps[2], x[0], x[1], error)
    return max(max(low0, low1), low2), (most0, most1, most2)


@njit(inline=True)
def _bound_edge(gap: float, p: float, q: float, error: float) -> tuple[float, float]:
    """Return bounds of the gap along a unit edge axis, whose components are p and q but for signs.

    gap: not divided by the length of the axis.
    """
    square = p * p + q * q
    parallel = square < SHORT_SQUARE
    scale = 1.0 / math.sqrt(SHORT_SQUARE if parallel else square)
    low, most = (gap - error) * scale, (gap + error) * scale
    return -math.inf if parallel else low, math.inf if parallel else most


#: Signed gap, unit axis, number of the axis.
Witness = tuple[float, Vector, int]


@njit
def box_witness(a: BoxAt, b: BoxAt) -> tuple[Witness, Pair]:
    """Return signed gap, unit axis from a towards b, its number; and the boxes in the frame of a.

    The largest of the 15 gaps along normalised axes: positive, it proves that the boxes are
    apart (by at least that much); negative, it is the least translation along any of the 15 that
    separates them. Equal gaps are decided by the axes themselves, so that swapping the boxes only
    reverses the axis. Where the centres agree along the axis, its sign carries no meaning.

    Only axes that may have the largest gap, by a rough calculation with its error bound, are
    computed carefully: typically one or two of the 15.
    """
    pair, size = pair_of(a, b)
    return largest_gap(a, b, int(possible_axes(pair, size))), pair


@njit
def largest_gap(a: BoxAt, b: BoxAt, axes: int) -> Witness:
    """Return the witness, which is on one of some axes: a bit for each.

    If all stored axes of both boxes are equal, only three of the 15 differ, the first ones: all
    products are theirs but for signs, to the last bit.
    """
    best = -np.inf
    n = 0.0, 0.0, 0.0
    number = -1
    different = 3 if _are_equal(a.axes, b.axes) else AXES
    for axis in range(different):
        if not (axes >> axis) & 1:
            continue
        gap, m = careful_gap(a, b, axis)
        if gap > best or (gap == best and _before(m, n)):
            best, n, number = gap, m, axis
    return best, n, number


@njit
def _are_equal(a: Axes, b: Axes) -> bool:
    equal = True
    for k in range(3):
        equal &= (a[k][0] == b[k][0]) & (a[k][1] == b[k][1]) & (a[k][2] == b[k][2])
    return equal


@njit
def _before(u: Vector, v: Vector) -> bool:
    """Order axes by magnitudes, then by relative signs: the same for both axes reversed."""
    for k in range(3):
        if abs(u[k]) != abs(v[k]):
            return abs(u[k]) > abs(v[k])
    if u[0] * u[1] != v[0] * v[1]:
        return u[0] * u[1] > v[0] * v[1]
    if u[1] * u[2] != v[1] * v[2]:
        return u[1] * u[2] > v[1] * v[2]
    return u[0] * u[2] > v[0] * v[2]


#: Rounds of alternating projections: each moves the point into one box, then into the other.
#: A few are enough, but for thin wedges.
PROJECTION_ROUNDS = 32
#: They end when the point moves less than this, relative to the sum of the half extents: what
#: is drawn needs no more.
DRAWN_SETTLED = 1e-4


@njit
def common_point(pair: Pair) -> Vector:
    """Return a point near both boxes: inside both, or nearly, where they overlap.

    Alternating projections onto convex sets (von Neumann; Bregman 1965), from between the
    centres, in the frame of a. A place to draw the contact at, not a contact manifold: unlike the
    witness it is not the same to the last bit when the boxes are swapped or relabelled.
    """
    d, h, f = pair.d, pair.h, pair.f
    settled = DRAWN_SETTLED * (h[0] + h[1] + h[2] + f[0] + f[1] + f[2])
    s = scaled(d, 0.5)
    for _ in range(PROJECTION_ROUNDS):
        s = clamped(s, h)
        t = along_b(pair, minus(s, d))
        t = minus(t, clamped(t, f))
        s = minus(s, combined(pair.r, t))
        if max_abs(t) <= settled:
            break
    return s
