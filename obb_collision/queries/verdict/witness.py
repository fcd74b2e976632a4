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
Its relative error, 256 u / SHORT, is far below the rest.

Many pairs are computed a block at a time. The numbers of a block are gathered first, each kind in
one run of memory; then the processor computes several pairs at once. Each number is that of the
formulas in ``sat``, bit for bit. Bounds of all 15 gaps leave one axis of nearly every pair; its gap
is computed carefully. Pairs with more than one are left to ``largest_gap``.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.numerics.constants import FAST_BOUND, PARALLEL, SHORT_SQUARE, UNDERFLOW
from obb_collision.numerics.intrinsics import fetch_pairs
from obb_collision.numerics.vec3 import (
    ZERO,
    careful_cross,
    clamped,
    combined,
    components,
    dot,
    max_abs,
    max_of,
    minus,
    negated,
    norm,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.queries.verdict.sat import (
    AXIS_COUNT,
    AXIS_EDGES,
    BoxAt,
    BoxPair,
    all_edge_axes,
    along_b,
    box_at,
    edge_axes,
    edge_gaps,
    face_gaps_of_a,
    face_gaps_of_b,
    factors,
    in_frame,
    pair_of,
    pair_size,
    projected_radius,
    rows_of,
)
from obb_collision.typing import Axes, Floats, Vector


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
        return -np.inf, ZERO
    n = x / size, y / size, z / size
    along = dot(n, minus(b.center, a.center))
    gap = abs(along) - (
        projected_radius(n, a.axes, a.half_extents) + projected_radius(n, b.axes, b.half_extents)
    )
    return gap, negated(n) if along < 0.0 else n


#: Of three axes each: faces of a, faces of b, and an edge of a with each edge of b.
AxisBounds = tuple[Vector, Vector, Vector, Vector, Vector]


@njit(inline=True)
def possible_axes(pair: BoxPair, size: float) -> float:
    """Return which axes may have the largest gap, as a sum of powers of two; size: T. No branch."""
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
def gap_bounds(pair: BoxPair, size: float) -> tuple[float, AxisBounds]:
    """Return a lower bound of the largest gap, and upper bounds of all; inf if parallel."""
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
    """Return bounds of the gap along a unit edge axis, whose components are p and q up to signs.

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
def box_witness(a: BoxAt, b: BoxAt) -> tuple[Witness, BoxPair]:
    """Return signed gap, unit axis from a towards b, its number; and the boxes in the frame of a.

    The largest of the 15 gaps along normalised axes. If positive, the boxes are apart by at least
    that; if negative, it is minus the least translation along any of the 15 that separates them.
    Equal gaps are decided by the axes themselves, so that swapping the boxes only reverses the
    axis. If the centres agree along the axis, its sign carries no meaning.

    A rough calculation with its error bound selects the axes that may have the largest gap,
    typically one or two; only these are computed carefully.
    """
    pair, size = pair_of(a, b)
    return largest_gap(a, b, int(possible_axes(pair, size))), pair


@njit
def largest_gap(a: BoxAt, b: BoxAt, axes: int) -> Witness:
    """Return the witness among some axes, a bit for each.

    If all stored axes of both boxes are equal, only the first three of the 15 differ: all products
    are theirs up to signs, to the last bit.
    """
    best = -np.inf
    n = 0.0, 0.0, 0.0
    number = -1
    different = 3 if _are_equal(a.axes, b.axes) else AXIS_COUNT
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
    """Return whether u comes before v, by magnitudes, then by signs: the same for -u and -v."""
    for k in range(3):
        if abs(u[k]) != abs(v[k]):
            return abs(u[k]) > abs(v[k])
    if u[0] * u[1] != v[0] * v[1]:
        return u[0] * u[1] > v[0] * v[1]
    if u[1] * u[2] != v[1] * v[2]:
        return u[1] * u[2] > v[1] * v[2]
    return u[0] * u[2] > v[0] * v[2]


#: Rounds of alternating projections: each moves the point into one box, then into the other.
#: A few are enough, except for thin wedges.
PROJECTION_ROUNDS = 32
#: They end when the point moves less than this, relative to the sum of the half extents: enough
#: for drawing.
DRAWN_SETTLED = 1e-4


@njit
def common_point(pair: BoxPair) -> Vector:
    """Return a point near both boxes: inside both, or nearly, where they overlap.

    Alternating projections onto convex sets (von Neumann; Bregman 1965), from between the centres,
    in the frame of a. A place to draw the contact at, not a contact manifold: unlike the witness it
    is not the same to the last bit when the boxes are swapped or relabelled.
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


#: Pairs in a block: their numbers (15 kB) stay in the fastest memory.
PAIR_BLOCK = 64
#: First rows of the numbers of a block; the results are the largest gap and its bound.
OFFSET, AXES_A, AXES_B, EXTENTS_A, EXTENTS_B, GAP, BOUND, BLOCK_ROWS = 0, 3, 12, 21, 24, 27, 28, 29


@njit(refcount=False)
def gather_pairs(pairs: RowPairs, start: int, count: int, block: Floats) -> None:
    """Write pairs ``start`` to ``start + count`` into a block (BLOCK_ROWS, PAIR_BLOCK)."""
    (a, rows_a, b, rows_b) = pairs
    for n in range(count):
        i, j = rows_a[start + n], rows_b[start + n]
        for k in range(3):
            block[OFFSET + k, n] = b.centers[j, k] - a.centers[i, k]
            block[EXTENTS_A + k, n] = a.half_extents[i, k]
            block[EXTENTS_B + k, n] = b.half_extents[j, k]
            for m in range(3):
                block[AXES_A + 3 * k + m, n] = a.rotations[i, m, k]
                block[AXES_B + 3 * k + m, n] = b.rotations[j, m, k]


@njit
def bound_block(block: Floats, count: int) -> None:
    """Write the largest gap of each pair, not divided by the length of its axis, and its bound."""
    for n in range(count):  # without a branch
        offset, h, f = (
            vector_in(block, OFFSET, n),
            vector_in(block, EXTENTS_A, n),
            vector_in(block, EXTENTS_B, n),
        )
        pair = in_frame(offset, axes_in(block, AXES_A, n), h, axes_in(block, AXES_B, n), f)
        faces = max(max_of(face_gaps_of_a(pair)), max_of(face_gaps_of_b(pair)))
        x, y, z = all_edge_axes(pair)
        edges = max(max_of(edge_gaps(x)), max_of(edge_gaps(y)))
        block[GAP, n] = max(faces, max(edges, max_of(edge_gaps(z))))
        block[BOUND, n] = FAST_BOUND * pair_size(offset, h, f) + UNDERFLOW


@njit
def vector_in(block: Floats, row: int, n: int) -> Vector:
    """Return three rows of column n of a block."""
    return block[row, n], block[row + 1, n], block[row + 2, n]


@njit
def axes_in(block: Floats, row: int, n: int) -> Axes:
    """Return nine rows of column n of a block as axes."""
    return vector_in(block, row, n), vector_in(block, row + 3, n), vector_in(block, row + 6, n)


@njit
def write_in(block: Floats, row: int, n: int, vector: Vector) -> None:
    """Write three rows of column n of a block."""
    block[row, n], block[row + 1, n], block[row + 2, n] = vector


#: Rows beyond those of ``blocks``: the boxes in the frame of a; the two edges whose cross product
#: is the axis, and its number; which axes may have the largest gap; the witness; a common point.
(
    FRAME_OFFSET,
    FRAME_AXES,
    FIRST_EDGE,
    SECOND_EDGE,
    AXIS_NUMBER,
    POSSIBLE_AXES,
    LARGEST_GAP,
    NORMAL,
    POINT,
    WITNESS_ROWS,
) = (*(27, 30, 39, 42, 45, 46, 47, 48, 51, 54),)
#: Rows of the search for a common point, in place of those of the edges: the point, when it is
#: settled, and whether it is not. Its inputs are in the rows from EXTENTS_A on.
MOVING_POINT, SETTLED_STEP, STILL_MOVING = 39, 42, 43


@njit
def witness_kernel(
    boxes: BoxArrays,
    pairs: np.ndarray,
    gaps: Floats,
    axes: Floats,
    points: Floats,
    start: int,
    stop: int,
) -> None:
    """Write gap (m,), axis (m, 3) and a point (m, 3) of the contact of some pairs of (m, 2)."""
    block = np.empty((WITNESS_ROWS, PAIR_BLOCK))
    columns = np.empty(PAIR_BLOCK, np.int64)
    for first in range(start, stop, PAIR_BLOCK):
        count = min(PAIR_BLOCK, stop - first)
        witness_block(boxes, pairs, first, count, block)
        _common_points(block, count, columns)
        for n in range(count):
            point = combined(axes_in(block, AXES_A, n), vector_in(block, POINT, n))
            point = plus(vector_at(boxes.centers, pairs[first + n, 0]), point)
            gaps[first + n] = block[LARGEST_GAP, n]
            for k in range(3):
                axes[first + n, k], points[first + n, k] = block[NORMAL + k, n], point[k]


@njit(inline=True)
def witness_block(
    boxes: BoxArrays, pairs: np.ndarray, start: int, count: int, block: Floats
) -> None:
    """Write gap, unit axis and its number of some pairs of (m, 2), and the boxes in the frame of a.

    block (WITNESS_ROWS, PAIR_BLOCK).
    """
    gather_pairs(RowPairs(boxes, pairs[:, 0], boxes, pairs[:, 1]), start, count, block)
    fetch_pairs(boxes, pairs, start + count, start + 2 * count)
    _bound_axes(block, count)
    for n in range(count):
        number, axes = 0, int(block[POSSIBLE_AXES, n])
        while number < AXIS_COUNT - 1 and not (axes >> number) & 1:
            number += 1
        block[AXIS_NUMBER, n] = number
        i, j = AXES_A + 3 * AXIS_EDGES[number, 0], AXES_A + 3 * AXIS_EDGES[number, 1]
        for k in range(3):
            block[FIRST_EDGE + k, n], block[SECOND_EDGE + k, n] = block[i + k, n], block[j + k, n]
    _careful_gaps(block, count)
    for n in range(count):
        number, axes = int(block[AXIS_NUMBER, n]), int(block[POSSIBLE_AXES, n])
        if axes == 1 << number and block[LARGEST_GAP, n] > -np.inf:
            continue
        a, b = box_at(boxes, pairs[start + n, 0]), box_at(boxes, pairs[start + n, 1])
        block[LARGEST_GAP, n], axis, number = largest_gap(a, b, axes)
        write_in(block, NORMAL, n, axis)
        block[AXIS_NUMBER, n] = number


@njit(inline=True)
def _bound_axes(block: Floats, count: int) -> None:
    """Write the boxes in the frame of a, and which axes may have the largest gap."""
    for n in range(count):  # without a branch
        offset = vector_in(block, OFFSET, n)
        h, f = vector_in(block, EXTENTS_A, n), vector_in(block, EXTENTS_B, n)
        pair = in_frame(offset, axes_in(block, AXES_A, n), h, axes_in(block, AXES_B, n), f)
        write_in(block, FRAME_OFFSET, n, pair.d)
        write_in(block, FRAME_AXES, n, pair.r[0])
        write_in(block, FRAME_AXES + 3, n, pair.r[1])
        write_in(block, FRAME_AXES + 6, n, pair.r[2])
        block[POSSIBLE_AXES, n] = possible_axes(pair, pair_size(offset, h, f))


@njit(inline=True)
def _careful_gaps(block: Floats, count: int) -> None:
    """Write ``careful_gap`` of the first possible axis of each pair."""
    for n in range(count):  # without a branch
        offset = vector_in(block, OFFSET, n)
        x, y, z = careful_cross(vector_in(block, FIRST_EDGE, n), vector_in(block, SECOND_EDGE, n))
        largest = max_abs((x, y, z))
        largest = largest if largest > 0.0 else 1.0
        s, t, w = x / largest, y / largest, z / largest
        size = largest * math.sqrt((s * s + t * t) + w * w)
        parallel = size < PARALLEL
        size = 1.0 if parallel else size
        m = x / size, y / size, z / size
        along = dot(m, offset)
        a = projected_radius(m, axes_in(block, AXES_A, n), vector_in(block, EXTENTS_A, n))
        b = projected_radius(m, axes_in(block, AXES_B, n), vector_in(block, EXTENTS_B, n))
        gap = abs(along) - (a + b)
        block[LARGEST_GAP, n] = -np.inf if parallel else gap
        sign = -1.0 if along < 0.0 else 1.0
        write_in(block, NORMAL, n, (sign * m[0], sign * m[1], sign * m[2]))


@njit(inline=True)
def _common_points(block: Floats, count: int, columns: np.ndarray) -> None:
    """Write ``common_point`` of each pair, all rounds of a block at once.

    columns (PAIR_BLOCK,) is work space: once half of the pairs are settled, the others move up.
    """
    for n in range(count):
        h, f = vector_in(block, EXTENTS_A, n), vector_in(block, EXTENTS_B, n)
        block[SETTLED_STEP, n] = DRAWN_SETTLED * (h[0] + h[1] + h[2] + f[0] + f[1] + f[2])
        write_in(block, MOVING_POINT, n, scaled(vector_in(block, FRAME_OFFSET, n), 0.5))
        block[STILL_MOVING, n] = 1.0
        columns[n] = n
    for _ in range(PROJECTION_ROUNDS):
        going = _project(block, count)
        if going == 0:
            break
        if 2 * going <= count:
            count = _move_up(block, count, columns)
    for n in range(count):
        write_in(block, POINT, columns[n], vector_in(block, MOVING_POINT, n))


@njit(inline=True)
def _project(block: Floats, count: int) -> int:
    """Move the points that are not settled into a, then into b; return how many are still not."""
    going = 0
    for n in range(count):  # without a branch
        d, r = vector_in(block, FRAME_OFFSET, n), axes_in(block, FRAME_AXES, n)
        before = vector_in(block, MOVING_POINT, n)
        s = clamped(before, vector_in(block, EXTENTS_A, n))
        t = components(r, minus(s, d))
        t = minus(t, clamped(t, vector_in(block, EXTENTS_B, n)))
        s = minus(s, combined(r, t))
        moves = block[STILL_MOVING, n] > 0.0
        for k in range(3):
            block[MOVING_POINT + k, n] = s[k] if moves else before[k]
        goes = moves and not max_abs(t) <= block[SETTLED_STEP, n]
        block[STILL_MOVING, n] = 1.0 if goes else 0.0
        going += goes
    return going


@njit
def _move_up(block: Floats, count: int, columns: np.ndarray) -> int:
    """Write the points that are settled, and move the other pairs up; return their number."""
    kept = 0
    for n in range(count):
        if block[STILL_MOVING, n] == 0.0:
            write_in(block, POINT, columns[n], vector_in(block, MOVING_POINT, n))
            continue
        for row in range(EXTENTS_A, STILL_MOVING + 1):
            block[row, kept] = block[row, n]
        columns[kept] = columns[n]
        kept += 1
    return kept
