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

"""Verdicts of pairs of boxes: the certified separating axis test, and exact integers behind it.

The axes are in ``sat``. A verdict is certified: SEPARATE and OVERLAP are given only when the
rounding errors of the computed gaps can't change them, with the doubles of the boxes taken as exact
numbers. The rest is TOUCHING. Two stages:

``fast_verdict`` is the usual test on the matrix of dot products. Its error bound is coarse, and
it leaves a pair undecided when any axis is within that bound.
``careful_verdict`` decides the undecided pairs. It projects both boxes fully on each axis
actually computed, and takes the cross products without error. Its sums don't depend on the order
of boxes or axes, so its verdicts have every symmetry of the question bit for bit. As its bound
is the tighter one, a pair that the fast stage decides gets the same verdict from it.

Error analysis: u = 2^-53, T = abs(d) + sum h + sum f. The careful gap along the computed n is off
by at most 8 u abs(n) T, and n itself by 2 u abs(n): together 10 u abs(n) T, bounded by 16 u. The
fast stage assumes orthonormal axes. If R^T R differs from I by at most 64 u, its gaps are off by
at most 490 u T; with the careful bound added 510 u, bounded by 1024 u.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.boxes import Boxes
from obb_collision.numerics.constants import CAREFUL_BOUND, FAST_BOUND, UNDERFLOW
from obb_collision.numerics.exact import (
    Exact,
    exact_axes,
    exact_cross,
    exact_dot,
    exact_integers,
    sum_sorted,
)
from obb_collision.numerics.intrinsics import fetch_box
from obb_collision.numerics.vec3 import minus, norm
from obb_collision.queries.verdict.pair_rows import RowPairs, as_pairs, as_sides, one_set
from obb_collision.queries.verdict.sat import (
    AXIS_COUNT,
    AXIS_EDGES,
    BoxAt,
    BoxPair,
    all_edge_axes,
    box_at,
    edge_gaps,
    face_gaps_of_a,
    face_gaps_of_b,
    pair_of,
)
from obb_collision.queries.verdict.witness import (
    BLOCK_ROWS,
    BOUND,
    GAP,
    PAIR_BLOCK,
    bound_block,
    careful_gap,
    gather_pairs,
    witness_kernel,
)
from obb_collision.typing import Floats, Integers, Vector

Verdicts = NDArray[np.int8]


class Verdict(IntEnum):
    """What is certain about two closed bodies.

    Examples
    --------
    >>> box = oc.OBB(half_extents=[1, 1, 1])
    >>> oc.verdicts(oc.Boxes.from_obbs([box]), oc.Boxes.from_obbs([box])) == oc.Verdict.OVERLAP
    array([ True])
    """

    SEPARATE = 0  #: no common point
    TOUCHING = 1  #: undecided by doubles; with exact=True: common boundary only
    OVERLAP = 2  #: common interior


SEPARATE = int(Verdict.SEPARATE)
TOUCHING = int(Verdict.TOUCHING)
OVERLAP = int(Verdict.OVERLAP)
UNDECIDED = -1

#: Pairs below which a second thread does not pay: 20 us or so.
FEWEST_VERDICTS = 1024
#: Edges count as nearly parallel in the fast stage when all off-axis dot products are below.
NEARLY_PARALLEL = 2.0**-20


def box_verdicts(
    a: Boxes, b: Boxes, pairs: ArrayLike | None = None, *, exact: bool = False
) -> Verdicts:
    """Return the verdicts of boxes, (m,) int8."""
    first, second = as_sides(a, b, pairs)
    return pair_verdicts(a, first, b, second, exact)


def pair_verdicts(
    a: Boxes, rows_a: NDArray[np.int64], b: Boxes, rows_b: NDArray[np.int64], exact: bool = False
) -> Verdicts:
    """Return the verdicts of ``a[rows_a[n]]`` against ``b[rows_b[n]]``, (n,) int8."""
    result = np.empty(len(rows_a), np.int8)
    pairs = RowPairs(a.arrays, rows_a, b.arrays, rows_b)
    run(verdict_kernel, len(result), FEWEST_VERDICTS, pairs, result)
    if exact:
        decide_exactly(a, rows_a, b, rows_b, result)
    return result


def decide_exactly(
    a: Boxes, rows_a: NDArray[np.int64], b: Boxes, rows_b: NDArray[np.int64], verdicts: Verdicts
) -> None:
    """Replace TOUCHING among verdicts (n,) by what integer arithmetic says."""
    for n in np.flatnonzero(verdicts == TOUCHING):
        verdicts[n] = exact_verdict(a, rows_a[n], b, rows_b[n])


@njit
def verdict_kernel(pairs: RowPairs, out: np.ndarray, start: int, stop: int) -> None:
    """Write the certified verdicts (m,) of pairs ``start`` to ``stop``, as ``box_verdict``."""
    block = np.empty((BLOCK_ROWS, PAIR_BLOCK))
    for first in range(start, stop, PAIR_BLOCK):
        for n in range(first + PAIR_BLOCK, min(first + 2 * PAIR_BLOCK, stop)):  # of the next block
            fetch_box(pairs.a, pairs.rows_a[n])
            fetch_box(pairs.b, pairs.rows_b[n])
        decide_block(pairs, first, min(PAIR_BLOCK, stop - first), block, out)


@njit(refcount=False)
def decide_block(pairs: RowPairs, first: int, count: int, block: Floats, out: np.ndarray) -> None:
    """Write the verdicts of ``count`` pairs from ``first`` on, at most PAIR_BLOCK."""
    gather_pairs(pairs, first, count, block)
    bound_block(block, count)
    for n in range(first, first + count):
        gap, bound = block[GAP, n - first], block[BOUND, n - first]
        if gap > bound:
            out[n] = SEPARATE
        elif gap < -bound:
            out[n] = OVERLAP
        else:
            a = box_at(pairs.a, pairs.rows_a[n])
            out[n] = box_verdict(a, box_at(pairs.b, pairs.rows_b[n]))


@njit
def box_verdict(a: BoxAt, b: BoxAt) -> int:
    """Return the certified verdict of two boxes."""
    pair, size = pair_of(a, b)
    verdict = fast_verdict(pair, size)
    return careful_verdict(a, b) if verdict == UNDECIDED else verdict


@njit
def fast_verdict(pair: BoxPair, size: float) -> int:
    """Return SEPARATE or OVERLAP where certain by a coarse bound, else UNDECIDED; size: T."""
    bound = FAST_BOUND * size + UNDERFLOW
    u, v, w = face_gaps_of_a(pair)
    faces = max(u, v, w)
    if faces > bound:
        return SEPARATE
    u, v, w = face_gaps_of_b(pair)
    faces = max(faces, u, v, w)
    if faces > bound:
        return SEPARATE
    axes_x, axes_y, axes_z = all_edge_axes(pair)
    p, q, r = edge_gaps(axes_x), edge_gaps(axes_y), edge_gaps(axes_z)
    edges = max(max(p[0], p[1], p[2]), max(q[0], q[1], q[2]), max(r[0], r[1], r[2]))
    if edges > bound:
        return SEPARATE
    if max(faces, edges) < -bound:
        return OVERLAP

    # Edges that are parallel, or so nearly that the axis is lost in noise: see _implied_margin.
    (x, y, z), f = pair.r, pair.f
    margin = max(
        _implied_margins(p, bound, f[0], _off_axis(x, y, z)),
        _implied_margins(q, bound, f[1], _off_axis(y, x, z)),
        _implied_margins(r, bound, f[2], _off_axis(z, x, y)),
    )
    if margin == np.inf:
        return UNDECIDED
    certain = faces
    for gap in (*p, *q, *r):
        if gap < -bound:
            certain = max(certain, gap)
    if certain < -(bound + margin):
        return OVERLAP
    return UNDECIDED


@njit
def _off_axis(u: Vector, v: Vector, w: Vector) -> Vector:
    """Return for each edge i of a how far it is from parallel to edge u of b.

    The largest dot product of one of the two with the other edges of the other box.
    """
    return (
        max(abs(u[1]), abs(u[2]), abs(v[0]), abs(w[0])),
        max(abs(u[0]), abs(u[2]), abs(v[1]), abs(w[1])),
        max(abs(u[0]), abs(u[1]), abs(v[2]), abs(w[2])),
    )


@njit
def _implied_margins(gaps: Vector, bound: float, extent: float, off_axis: Vector) -> float:
    """Return the largest margin of the three axes of one edge of b (see ``_implied_margin``)."""
    return max(
        _implied_margin(gaps[0], bound, extent, off_axis[0]),
        _implied_margin(gaps[1], bound, extent, off_axis[1]),
        _implied_margin(gaps[2], bound, extent, off_axis[2]),
    )


@njit
def _implied_margin(gap: float, bound: float, extent: float, off_axis: float) -> float:
    """Return by how much other axes must overlap so that this uncertain edge axis can't separate.

    Nearly parallel edges a_i, b_j: look along a_i, and leave b_j's sliver out of box b. What is
    left are two parallelograms in the plane, whose separating axes are two faces of a and two
    edge axes, all of length near 1. If they overlap along these, they overlap along every
    direction of the plane, the doubtful one included, and box b only adds to that. Their gaps
    here include the sliver, at most ``extent * off_axis`` each. An axis that is certain needs no
    margin; one that is not nearly parallel can't be implied (infinity).
    """
    if gap < -bound:
        return 0.0
    if off_axis > NEARLY_PARALLEL:
        return np.inf
    return 2.0 * extent * off_axis


@njit
def careful_verdict(a: BoxAt, b: BoxAt) -> int:
    """Return SEPARATE or OVERLAP where certain by the tight bound, else TOUCHING."""
    bound = careful_bound(a, b)
    verdict = OVERLAP
    for axis in range(AXIS_COUNT):
        gap, _ = careful_gap(a, b, axis)
        if gap > bound:
            return SEPARATE
        if gap >= -bound:
            verdict = TOUCHING
    return verdict


@njit
def careful_bound(a: BoxAt, b: BoxAt) -> float:
    """Return the error bound of ``careful_gap``."""
    h, f = a.half_extents, b.half_extents
    extents = sum_sorted(h[0], h[1], h[2]) + sum_sorted(f[0], f[1], f[2])
    return CAREFUL_BOUND * (norm(minus(b.center, a.center)) + extents) + UNDERFLOW


Index = int | np.integer


def exact_verdict(a: Boxes, row_a: Index, b: Boxes, row_b: Index) -> int:
    """Return 0 separate, 1 touching or 2 overlap of two boxes, decided exactly.

    Doubles are exact numbers. All 15 axes are exact cross products, also the face normals. Null
    ones (parallel edges) are skipped.
    """
    axes_a, power_a = exact_axes(a.rotations[row_a])
    axes_b, power_b = exact_axes(b.rotations[row_b])
    power = max(power_a, power_b)
    axes_a = _scaled(axes_a, power - power_a)
    axes_b = _scaled(axes_b, power - power_b)
    parts = a.centers[row_a], b.centers[row_b], a.half_extents[row_a], b.half_extents[row_b]
    numbers, _ = exact_integers([number for part in parts for number in part.tolist()])
    # lengths along an axis vector come as (length) x (axis entry): the offset needs the factor
    offset = (
        (numbers[3] - numbers[0]) << power,
        (numbers[4] - numbers[1]) << power,
        (numbers[5] - numbers[2]) << power,
    )
    edges = list(zip(numbers[6:], axes_a + axes_b, strict=True))
    touching = False
    for i, j in AXIS_EDGES.tolist():
        axis = exact_cross(edges[i][1], edges[j][1])
        if axis == (0, 0, 0):
            continue
        reach = sum(extent * abs(exact_dot(axis, edge)) for extent, edge in edges)
        gap = abs(exact_dot(axis, offset)) - reach
        if gap > 0:
            return 0
        touching = touching or gap == 0
    return 1 if touching else 2


def _scaled(axes: tuple[Exact, Exact, Exact], power: int) -> tuple[Exact, Exact, Exact]:
    x, y, z = ((v[0] << power, v[1] << power, v[2] << power) for v in axes)
    return x, y, z


#: Pairs below which a second thread does not pay: 50 us or so.
FEWEST_WITNESSES = 512


@dataclass(frozen=True, eq=False)
class Separations:
    """Signed separations of m pairs of boxes.

    pairs (m, 2): rows of a and b, in a report indices of objects; separations (m,): metres,
    negative where the boxes overlap; normals (m, 3): unit, from the first to the second; positions
    (m, 3): metres, a place near both boxes.
    """

    pairs: Integers
    separations: Floats
    normals: Floats
    positions: Floats

    @classmethod
    def blank(cls, pairs: Integers) -> Separations:
        """Return uninitialised separations of pairs (m, 2)."""
        return cls(pairs, np.empty(len(pairs)), *np.empty((2, len(pairs), 3)))

    def __len__(self) -> int:
        return len(self.pairs)


@dataclass(frozen=True, eq=False)
class CertifiedSeparations(Separations):
    """Separations with the certified verdicts (m,) int8 of the pairs."""

    verdicts: Verdicts


def box_separations(a: Boxes, b: Boxes, pairs: ArrayLike | None = None) -> CertifiedSeparations:
    """Return the signed separations of boxes, with their verdicts."""
    rows = as_pairs(a, b, pairs)
    arrays = vars(pair_separations(*one_set(a, b, rows)))
    verdicts = pair_verdicts(a, rows[:, 0].copy(), b, rows[:, 1].copy())
    return CertifiedSeparations(**{**arrays, "pairs": rows}, verdicts=verdicts)


def pair_separations(boxes: Boxes, pairs: Integers) -> Separations:
    """Return the separations (``witness``) of pairs (m, 2) of rows of boxes."""
    result = Separations.blank(pairs)
    out = result.separations, result.normals, result.positions
    run(witness_kernel, len(pairs), FEWEST_WITNESSES, boxes.arrays, pairs, *out)
    return result
