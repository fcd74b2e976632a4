"""When do two boxes that move without turning first touch? The swept separating axis test.

Along each of the 15 axes of ``separation`` the centre offset is linear in time, s(t), and the sum
of the projected radii r is constant: the axis separates while abs(s(t)) > r. Turning neither box
keeps the axes, so the boxes touch exactly during the common part of 15 intervals of time
(Eberly, "Dynamic Collision Detection using Oriented Bounding Boxes"; Ericson 2005, 5.5).

Certified like the verdicts, and in two stages like them: a coarse pass that settles most misses,
then the axes that may decide the entry, or the exit, taken carefully. Every r is widened by the
error bound of its stage, so intervals only grow: no hit is missed and no time is late. What this
may cost: a miss by less than the bound, 4e-15 of T, counts as a hit, and at the time given the
boxes are apart by less than that (T: the offsets of the centres at the start and at the end, their
components summed, plus all half extents). A time is early by at most that over the speed along
the axis entered last: 1e-12 of it where the way along that axis is a hundredth of T or more.

Both offsets are differences of stored centres, so a motion that two
boxes share costs no accuracy.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.error_free import length
from obb_collision.geometry.validation import Floats
from obb_collision.queries.box_frame import column, vector
from obb_collision.queries.careful_gap import PARALLEL, columns, cross, projected_radius
from obb_collision.queries.separation import CAREFUL_BOUND, FAST_BOUND, UNDERFLOW

#: A time is a quotient of two differences: off by 3 unit roundoffs, bounded by 8.
TIME_ROUNDING = 2.0**-50

AXES = 15

Hit = tuple[float, float, float, float]
MISS: Hit = (np.inf, np.nan, np.nan, np.nan)


@njit
def sweep_linear(
    starts: Floats,
    ends: Floats,
    rotations: Floats,
    half_extents: Floats,
    i: int,
    j: int,
    spans: Floats,
) -> Hit:
    """Return time in [0, 1] and unit normal of the first contact of boxes i and j, or MISS.

    starts, ends: centres (n, 3) at times 0 and 1; rotations (n, 3, 3); half extents (n, 3);
    ``spans`` (15, 3) is work space. At time 0 the normal is not given (NaN).
    """
    bound = _fill_spans(starts, ends, rotations, half_extents, i, j, spans)
    if bound < 0.0:
        return MISS
    # No branches below: nothing foretells in which order axes are entered.
    enter = 0.0
    for axis in range(AXES):
        first, last, reach = spans[axis, 0], spans[axis, 1], spans[axis, 2] + bound
        when = (abs(first) - reach) / abs(first - last)
        enter = when if when > enter else enter
    enter *= 1.0 - TIME_ROUNDING
    left = False
    for axis in range(AXES):
        left |= _left_by(spans, axis, -bound, enter)
    if left:
        return MISS

    time, nx, ny, nz = 0.0, np.nan, np.nan, np.nan
    for axis in range(AXES):
        if not _may_be_entered(spans, axis, bound, enter):
            continue
        first, last, reach, x, y, z = _careful_span(
            starts, ends, rotations, half_extents, i, j, axis
        )
        when = _entry(first, last, reach)
        if when > time:
            time, nx, ny, nz = when, x, y, z
    time *= 1.0 - TIME_ROUNDING
    if time > 1.0:
        return MISS
    for axis in range(AXES):
        if _left_by(spans, axis, bound, time):
            first, last, reach, _, _, _ = _careful_span(
                starts, ends, rotations, half_extents, i, j, axis
            )
            if time > _exit(first, last, reach) * (1.0 + TIME_ROUNDING):
                return MISS
    return time, nx, ny, nz


@njit
def _may_be_entered(spans: Floats, axis: int, bound: float, time: float) -> bool:
    """Return whether the span, uncertain by ``bound``, may be entered at ``time`` or later."""
    first, last = spans[axis, 0], spans[axis, 1]
    outside = abs(first) - (spans[axis, 2] - bound)
    return (outside > 0.0) & (outside >= time * (first - last if first > 0.0 else last - first))


@njit
def _left_by(spans: Floats, axis: int, doubt: float, time: float) -> bool:
    """Return whether the span, shorter by ``doubt``, has been left for good by ``time``.

    By the error bound: whether it may have been; by its negative: whether it surely has.
    """
    first, last = spans[axis, 0], spans[axis, 1]
    flip = 1.0 if last > 0.0 else -1.0
    first *= flip
    last *= flip
    least = spans[axis, 2] - doubt
    return (last > least) & (least - first <= time * (last - first))


@njit
def _careful_span(
    starts: Floats,
    ends: Floats,
    rotations: Floats,
    half_extents: Floats,
    i: int,
    j: int,
    axis: int,
) -> tuple[float, float, float, float, float, float]:
    """Return s at 0, s at 1, r with its error bound, and the unit axis, s at 0 not negative.

    All zero for parallel edges, which have no axis: such a span is never left.
    """
    # which two columns: as in ``careful_gap``
    k, m = axis % 3, axis // 3
    one = j if m == 1 else i
    other = i if m == 0 else j
    nx, ny, nz = cross(
        column(rotations, one, (k + 1) % 3 if m < 2 else m - 2),
        column(rotations, other, (k + 2) % 3 if m < 2 else k),
    )
    norm = length(nx, ny, nz)
    if norm < PARALLEL:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    px, py, pz = _offset(starts, i, j)
    qx, qy, qz = _offset(ends, i, j)
    first = (nx * px + ny * py) + nz * pz
    norm = norm if first >= 0.0 else -norm
    nx /= norm
    ny /= norm
    nz /= norm
    first /= norm
    last = (nx * qx + ny * qy) + nz * qz
    reach = projected_radius(nx, ny, nz, columns(rotations[i]), vector(half_extents, i))
    reach += projected_radius(nx, ny, nz, columns(rotations[j]), vector(half_extents, j))
    size = (abs(px) + abs(py) + abs(pz)) + (abs(qx) + abs(qy) + abs(qz))
    for n in range(3):
        size += half_extents[i, n] + half_extents[j, n]
    return first, last, reach + (CAREFUL_BOUND * size + UNDERFLOW), nx, ny, nz


@njit
def _entry(first: float, last: float, reach: float) -> float:
    """Return when s, from ``first`` at 0 to ``last`` at 1, comes within ``reach`` of zero.

    0 if it is there at the start, infinity if it stays beyond on one side.
    """
    if first < 0.0:
        first, last = -first, -last
    if first <= reach:
        return 0.0
    if last > reach:
        return np.inf
    return (first - reach) / (first - last)


@njit
def _exit(first: float, last: float, reach: float) -> float:
    """Return when s leaves ``reach`` for good: infinity if it is there at the end (see _entry)."""
    if last < 0.0:
        first, last = -first, -last
    if last <= reach:
        return np.inf
    if first > reach:
        return 0.0
    return (reach - first) / (last - first)


@njit
def _offset(centers: Floats, i: int, j: int) -> tuple[float, float, float]:
    return (
        centers[j, 0] - centers[i, 0],
        centers[j, 1] - centers[i, 1],
        centers[j, 2] - centers[i, 2],
    )


@njit
def _fill_spans(
    starts: Floats,
    ends: Floats,
    rotations: Floats,
    half_extents: Floats,
    i: int,
    j: int,
    spans: Floats,
) -> float:
    """Write s at 0, s at 1 and r (15, 3) of each axis; return the error bound of all of them.

    Negative if some axis certainly separates all along. Formulas and bound as in
    ``separation.classify_fast``, linear in the offset and so good at any time between.
    """
    p0, p1, p2 = _offset(starts, i, j)
    q0, q1, q2 = _offset(ends, i, j)
    a0, a1, a2 = _column(rotations, i, 0), _column(rotations, i, 1), _column(rotations, i, 2)
    b0, b1, b2 = _column(rotations, j, 0), _column(rotations, j, 1), _column(rotations, j, 2)
    h0, h1, h2 = half_extents[i, 0], half_extents[i, 1], half_extents[i, 2]
    f0, f1, f2 = half_extents[j, 0], half_extents[j, 1], half_extents[j, 2]
    bound = (abs(p0) + abs(p1) + abs(p2)) + (abs(q0) + abs(q1) + abs(q2))
    bound = FAST_BOUND * (bound + (h0 + h1 + h2) + (f0 + f1 + f2)) + UNDERFLOW

    r00, r01, r02 = _dot(a0, b0), _dot(a0, b1), _dot(a0, b2)
    r10, r11, r12 = _dot(a1, b0), _dot(a1, b1), _dot(a1, b2)
    r20, r21, r22 = _dot(a2, b0), _dot(a2, b1), _dot(a2, b2)
    q00, q01, q02 = abs(r00), abs(r01), abs(r02)
    q10, q11, q12 = abs(r10), abs(r11), abs(r12)
    q20, q21, q22 = abs(r20), abs(r21), abs(r22)
    p, q = (p0, p1, p2), (q0, q1, q2)
    s0, s1, s2 = _dot(a0, p), _dot(a1, p), _dot(a2, p)
    e0, e1, e2 = _dot(a0, q), _dot(a1, q), _dot(a2, q)
    gap = max(
        _span(spans, 0, s0, e0, h0 + (f0 * q00 + f1 * q01 + f2 * q02)),
        _span(spans, 1, s1, e1, h1 + (f0 * q10 + f1 * q11 + f2 * q12)),
        _span(spans, 2, s2, e2, h2 + (f0 * q20 + f1 * q21 + f2 * q22)),
    )
    if gap > bound:
        return -1.0
    gap = max(
        _span(spans, 3, _dot(b0, p), _dot(b0, q), f0 + (h0 * q00 + h1 * q10 + h2 * q20)),
        _span(spans, 4, _dot(b1, p), _dot(b1, q), f1 + (h0 * q01 + h1 * q11 + h2 * q21)),
        _span(spans, 5, _dot(b2, p), _dot(b2, q), f2 + (h0 * q02 + h1 * q12 + h2 * q22)),
    )
    if gap > bound:
        return -1.0
    # edge a_i against edge b_j
    r = h1 * q20 + h2 * q10 + f1 * q02 + f2 * q01
    gap = _span(spans, 6, s2 * r10 - s1 * r20, e2 * r10 - e1 * r20, r)
    r = h1 * q21 + h2 * q11 + f0 * q02 + f2 * q00
    gap = max(gap, _span(spans, 7, s2 * r11 - s1 * r21, e2 * r11 - e1 * r21, r))
    r = h1 * q22 + h2 * q12 + f0 * q01 + f1 * q00
    gap = max(gap, _span(spans, 8, s2 * r12 - s1 * r22, e2 * r12 - e1 * r22, r))
    r = h0 * q20 + h2 * q00 + f1 * q12 + f2 * q11
    gap = max(gap, _span(spans, 9, s0 * r20 - s2 * r00, e0 * r20 - e2 * r00, r))
    r = h0 * q21 + h2 * q01 + f0 * q12 + f2 * q10
    gap = max(gap, _span(spans, 10, s0 * r21 - s2 * r01, e0 * r21 - e2 * r01, r))
    r = h0 * q22 + h2 * q02 + f0 * q11 + f1 * q10
    gap = max(gap, _span(spans, 11, s0 * r22 - s2 * r02, e0 * r22 - e2 * r02, r))
    r = h0 * q10 + h1 * q00 + f1 * q22 + f2 * q21
    gap = max(gap, _span(spans, 12, s1 * r00 - s0 * r10, e1 * r00 - e0 * r10, r))
    r = h0 * q11 + h1 * q01 + f0 * q22 + f2 * q20
    gap = max(gap, _span(spans, 13, s1 * r01 - s0 * r11, e1 * r01 - e0 * r11, r))
    r = h0 * q12 + h1 * q02 + f0 * q21 + f1 * q20
    gap = max(gap, _span(spans, 14, s1 * r02 - s0 * r12, e1 * r02 - e0 * r12, r))
    return -1.0 if gap > bound else bound


@njit
def _span(spans: Floats, axis: int, first: float, last: float, reach: float) -> float:
    """Keep an axis, and return the least gap along it at any time."""
    spans[axis, 0] = first
    spans[axis, 1] = last
    spans[axis, 2] = reach
    return max(min(first, last), -max(first, last)) - reach


@njit
def _column(rotations: Floats, row: int, k: int) -> tuple[float, float, float]:
    return rotations[row, 0, k], rotations[row, 1, k], rotations[row, 2, k]


@njit
def _dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
