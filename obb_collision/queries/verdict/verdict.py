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

"""Do two boxes collide? The certified separating axis test of two oriented boxes.

Two convex boxes are apart exactly when one of 15 axes separates them: the 3 + 3 face normals and
the 9 cross products of an edge of each (Gottschalk, Lin, Manocha 1996; Ericson 2005, 4.4.1).
Along an axis n with centre offset d the gap is

    abs(n.d) - sum_i h_i abs(n.a_i) - sum_j f_j abs(n.b_j)

A verdict is certified: SEPARATE and OVERLAP are given only when the rounding errors of the
computed gaps can't change them, with the doubles of the boxes taken as exact numbers. The rest
is TOUCHING. Two stages:

``classify_fast`` is the usual test on the matrix of dot products. Its error bound is coarse, and
it leaves a pair open when any axis is within that bound.
``classify_careful`` decides what is left open. It projects both boxes fully on each axis
actually computed, and takes the cross products without error. Its sums don't depend on the order
of boxes or axes, so its verdicts have every symmetry of the question bit for bit. As its bound
is the tighter one, a pair that the fast stage decides gets the same verdict from it.

Error analysis: u = 2^-53, T = abs(d) + sum h + sum f. The careful gap along the computed n is off
by at most 8 u abs(n) T, and n itself by 2 u abs(n): together 10 u abs(n) T, bounded by 16 u. The
fast stage assumes orthonormal axes. If R^T R differs from I by at most 64 u, its gaps are off by
at most 490 u T; with the careful bound added 510 u, bounded by 1024 u.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.kinds import as_flag
from obb_collision.numerics.constants import CAREFUL_BOUND, FAST_BOUND, UNDERFLOW
from obb_collision.numerics.error_free import length, sum_sorted
from obb_collision.queries.verdict.careful import careful_gap, columns
from obb_collision.queries.verdict.exact import exact_verdict
from obb_collision.queries.verdict.pair_rows import as_sides, check_boxes
from obb_collision.queries.verdict.sat import Vector
from obb_collision.typing import Floats

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
    TOUCHING = 1  #: not told from touching by doubles; with exact=True: common boundary only
    OVERLAP = 2  #: common interior


SEPARATE = int(Verdict.SEPARATE)
TOUCHING = int(Verdict.TOUCHING)
OVERLAP = int(Verdict.OVERLAP)
UNDECIDED = -1

#: Edges count as nearly parallel in the fast stage when all off-axis dot products are below.
NEARLY_PARALLEL = 2.0**-20


def verdicts(
    a: Boxes, b: Boxes, pairs: ArrayLike | None = None, *, exact: bool = False
) -> Verdicts:
    """Return whether boxes collide, with certainty.

    Parameters
    ----------
    a, b : Boxes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    exact : bool
        Decide by integer arithmetic what doubles can't: then TOUCHING means touching exactly.

    Returns
    -------
    (m,) array of int8
        Of ``Verdict``; SEPARATE and OVERLAP are certain, for the doubles as stored.

    Raises
    ------
    ValueError
        For pairs that are no rows, and without pairs for different lengths.
    TypeError
        For anything but boxes.

    References
    ----------
    Gottschalk, Lin, Manocha, OBBTree (SIGGRAPH 1996); Ericson 2005, 4.4.1.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [2, 0, 0], [4.5, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.verdicts(boxes, boxes, [[0, 1], [1, 2]], exact=True).tolist()  # touching, separate
    [1, 0]
    """
    check_boxes(a, b)
    first, second = as_sides(a, b, pairs)
    return pair_verdicts(a, first, b, second, as_flag(exact, "exact"))


def pair_verdicts(
    a: Boxes, rows_a: NDArray[np.int64], b: Boxes, rows_b: NDArray[np.int64], exact: bool = False
) -> Verdicts:
    """Return the verdicts of ``a[rows_a[n]]`` against ``b[rows_b[n]]``, (n,) int8."""
    result = np.empty(len(rows_a), np.int8)
    verdict_kernel(
        *(a.centers, a.rotations, a.half_extents, rows_a),
        *(b.centers, b.rotations, b.half_extents, rows_b),
        result,
    )
    if exact:
        for n in np.flatnonzero(result == TOUCHING):
            result[n] = exact_verdict(a.row(rows_a[n]), b.row(rows_b[n]))
    return result


@njit
def verdict_kernel(
    centers_a: Floats,
    rotations_a: Floats,
    half_extents_a: Floats,
    rows_a: np.ndarray,
    centers_b: Floats,
    rotations_b: Floats,
    half_extents_b: Floats,
    rows_b: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write the certified verdict of each pair of rows.

    centers (n, 3), rotations (n, 3, 3), half extents (n, 3) of both sides; rows and out (m,).
    """
    for n in range(len(rows_a)):
        out[n] = pair_verdict(
            *(centers_a, rotations_a, half_extents_a, rows_a[n]),
            *(centers_b, rotations_b, half_extents_b, rows_b[n]),
        )


@njit
def pair_verdict(
    ca: Floats, a: Floats, h: Floats, i: int, cb: Floats, b: Floats, f: Floats, j: int
) -> int:
    """Return the certified verdict of box i of the first against box j of the second."""
    verdict = classify_fast(ca, a, h, i, cb, b, f, j)
    if verdict == UNDECIDED:
        verdict = classify_careful(ca[i], a[i], h[i], cb[j], b[j], f[j])
    return verdict


@njit
def classify_fast(
    ca: Floats, a: Floats, h: Floats, i: int, cb: Floats, b: Floats, f: Floats, j: int
) -> int:
    """Return SEPARATE or OVERLAP where certain by a coarse bound, else UNDECIDED.

    ca, cb: centres (n, 3); a, b: axes (n, 3, 3); h, f: half extents (n, 3). Box i of the first
    against box j of the second: handing over slices would cost more than the test itself.
    """
    dx = cb[j, 0] - ca[i, 0]
    dy = cb[j, 1] - ca[i, 1]
    dz = cb[j, 2] - ca[i, 2]
    h0, h1, h2 = h[i, 0], h[i, 1], h[i, 2]
    f0, f1, f2 = f[j, 0], f[j, 1], f[j, 2]
    bound = abs(dx) + abs(dy) + abs(dz) + (h0 + h1 + h2) + (f0 + f1 + f2)
    bound = FAST_BOUND * bound + UNDERFLOW

    # dot products r_ij = a_i . b_j, and the offset t in the frame of a
    r00 = a[i, 0, 0] * b[j, 0, 0] + a[i, 1, 0] * b[j, 1, 0] + a[i, 2, 0] * b[j, 2, 0]
    r01 = a[i, 0, 0] * b[j, 0, 1] + a[i, 1, 0] * b[j, 1, 1] + a[i, 2, 0] * b[j, 2, 1]
    r02 = a[i, 0, 0] * b[j, 0, 2] + a[i, 1, 0] * b[j, 1, 2] + a[i, 2, 0] * b[j, 2, 2]
    r10 = a[i, 0, 1] * b[j, 0, 0] + a[i, 1, 1] * b[j, 1, 0] + a[i, 2, 1] * b[j, 2, 0]
    r11 = a[i, 0, 1] * b[j, 0, 1] + a[i, 1, 1] * b[j, 1, 1] + a[i, 2, 1] * b[j, 2, 1]
    r12 = a[i, 0, 1] * b[j, 0, 2] + a[i, 1, 1] * b[j, 1, 2] + a[i, 2, 1] * b[j, 2, 2]
    r20 = a[i, 0, 2] * b[j, 0, 0] + a[i, 1, 2] * b[j, 1, 0] + a[i, 2, 2] * b[j, 2, 0]
    r21 = a[i, 0, 2] * b[j, 0, 1] + a[i, 1, 2] * b[j, 1, 1] + a[i, 2, 2] * b[j, 2, 1]
    r22 = a[i, 0, 2] * b[j, 0, 2] + a[i, 1, 2] * b[j, 1, 2] + a[i, 2, 2] * b[j, 2, 2]
    t0 = a[i, 0, 0] * dx + a[i, 1, 0] * dy + a[i, 2, 0] * dz
    t1 = a[i, 0, 1] * dx + a[i, 1, 1] * dy + a[i, 2, 1] * dz
    t2 = a[i, 0, 2] * dx + a[i, 1, 2] * dy + a[i, 2, 2] * dz
    q00, q01, q02 = abs(r00), abs(r01), abs(r02)
    q10, q11, q12 = abs(r10), abs(r11), abs(r12)
    q20, q21, q22 = abs(r20), abs(r21), abs(r22)

    faces = max(
        abs(t0) - (h0 + (f0 * q00 + f1 * q01 + f2 * q02)),
        abs(t1) - (h1 + (f0 * q10 + f1 * q11 + f2 * q12)),
        abs(t2) - (h2 + (f0 * q20 + f1 * q21 + f2 * q22)),
    )
    if faces > bound:
        return SEPARATE
    faces = max(
        faces,
        abs(t0 * r00 + t1 * r10 + t2 * r20) - (f0 + (h0 * q00 + h1 * q10 + h2 * q20)),
        abs(t0 * r01 + t1 * r11 + t2 * r21) - (f1 + (h0 * q01 + h1 * q11 + h2 * q21)),
        abs(t0 * r02 + t1 * r12 + t2 * r22) - (f2 + (h0 * q02 + h1 * q12 + h2 * q22)),
    )
    if faces > bound:
        return SEPARATE

    # edge a_i against edge b_j: e_ij
    e00 = abs(t2 * r10 - t1 * r20) - (h1 * q20 + h2 * q10 + f1 * q02 + f2 * q01)
    e01 = abs(t2 * r11 - t1 * r21) - (h1 * q21 + h2 * q11 + f0 * q02 + f2 * q00)
    e02 = abs(t2 * r12 - t1 * r22) - (h1 * q22 + h2 * q12 + f0 * q01 + f1 * q00)
    e10 = abs(t0 * r20 - t2 * r00) - (h0 * q20 + h2 * q00 + f1 * q12 + f2 * q11)
    e11 = abs(t0 * r21 - t2 * r01) - (h0 * q21 + h2 * q01 + f0 * q12 + f2 * q10)
    e12 = abs(t0 * r22 - t2 * r02) - (h0 * q22 + h2 * q02 + f0 * q11 + f1 * q10)
    e20 = abs(t1 * r00 - t0 * r10) - (h0 * q10 + h1 * q00 + f1 * q22 + f2 * q21)
    e21 = abs(t1 * r01 - t0 * r11) - (h0 * q11 + h1 * q01 + f0 * q22 + f2 * q20)
    e22 = abs(t1 * r02 - t0 * r12) - (h0 * q12 + h1 * q02 + f0 * q21 + f1 * q20)
    edges = max(max(e00, e01, e02), max(e10, e11, e12), max(e20, e21, e22))
    if edges > bound:
        return SEPARATE
    if max(faces, edges) < -bound:
        return OVERLAP

    # Edges that are parallel, or so nearly that the axis is lost in noise: see _implied_margin.
    margin = max(
        max(
            _implied_margin(e00, bound, f0, max(q10, q20, q01, q02)),
            _implied_margin(e01, bound, f1, max(q11, q21, q00, q02)),
            _implied_margin(e02, bound, f2, max(q12, q22, q00, q01)),
        ),
        max(
            _implied_margin(e10, bound, f0, max(q00, q20, q11, q12)),
            _implied_margin(e11, bound, f1, max(q01, q21, q10, q12)),
            _implied_margin(e12, bound, f2, max(q02, q22, q10, q11)),
        ),
        max(
            _implied_margin(e20, bound, f0, max(q00, q10, q21, q22)),
            _implied_margin(e21, bound, f1, max(q01, q11, q20, q22)),
            _implied_margin(e22, bound, f2, max(q02, q12, q20, q21)),
        ),
    )
    if margin == np.inf:
        return UNDECIDED
    certain = faces
    for gap in (e00, e01, e02, e10, e11, e12, e20, e21, e22):
        if gap < -bound:
            certain = max(certain, gap)
    if certain < -(bound + margin):
        return OVERLAP
    return UNDECIDED


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
def classify_careful(ca: Floats, a: Floats, h: Floats, cb: Floats, b: Floats, f: Floats) -> int:
    """Return SEPARATE or OVERLAP where certain by the tight bound, else TOUCHING."""
    p, q = (ca[0], ca[1], ca[2]), (cb[0], cb[1], cb[2])
    u, v = (h[0], h[1], h[2]), (f[0], f[1], f[2])
    axes_a, axes_b = columns(a), columns(b)
    bound = _careful_bound(p, u, q, v)
    verdict = OVERLAP
    for axis in range(15):
        gap, _ = careful_gap(p, axes_a, u, q, axes_b, v, axis)
        if gap > bound:
            return SEPARATE
        if gap >= -bound:
            verdict = TOUCHING
    return verdict


@njit
def careful_axis(
    ca: Floats, a: Floats, h: Floats, cb: Floats, b: Floats, f: Floats, axis: int
) -> tuple[float, float, float, float, float]:
    """Return the gap along a unit axis, its error bound, and the axis, from a towards b.

    axis: as in ``careful_gap``.
    """
    p, q = (ca[0], ca[1], ca[2]), (cb[0], cb[1], cb[2])
    u, v = (h[0], h[1], h[2]), (f[0], f[1], f[2])
    gap, (nx, ny, nz) = careful_gap(p, columns(a), u, q, columns(b), v, axis)
    if nx == ny == nz == 0.0:
        return gap, 0.0, nx, ny, nz
    return gap, _careful_bound(p, u, q, v), nx, ny, nz


@njit
def _careful_bound(p: Vector, h: Vector, q: Vector, f: Vector) -> float:
    """Return the bound of the careful stage for boxes at p and q."""
    distance = length(q[0] - p[0], q[1] - p[1], q[2] - p[2])
    extents = sum_sorted(h[0], h[1], h[2]) + sum_sorted(f[0], f[1], f[2])
    return CAREFUL_BOUND * (distance + extents) + UNDERFLOW
