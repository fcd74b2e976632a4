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

"""Time at which two boxes that move without turning first touch: the swept separating axis test.

Along each of the 15 axes of ``sat`` the centre offset is linear in time, s(t), and the sum
of the projected radii r is constant: the axis separates while abs(s(t)) > r. Turning neither box
keeps the axes, so the boxes touch exactly during the common part of 15 intervals of time
(Eberly, "Dynamic Collision Detection using Oriented Bounding Boxes"; Ericson 2005, 5.5).

Certified like the verdicts, and in two stages like them: a coarse pass that settles most misses,
by the spheres or the faces of the first box (``meeting_intervals``), then the axes that may decide
the entry, or the exit, taken carefully. Every r is widened by the error bound of its stage, so
intervals only grow: no hit is missed and no time is late. What this may cost: a miss by less than
the bound, 4e-15 of T, counts as a hit, and at its time the boxes are apart by less than that
(T: the offsets of the centres at the start and at the end, their components summed, plus all half
extents). A time is early by at most that over the speed along the axis entered last: 1e-12 of it
where the way along that axis is a hundredth of T or more.

Offsets are differences of stored centres, or of velocities (``offset_and_way``): a motion that two
boxes share costs no accuracy. Of the latter the offset at the end is off by up to 4 unit roundoffs
where the former are off by 1, which the bounds have room for (see below: 16 where 14 are needed).
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.numerics.constants import (
    CAREFUL_BOUND,
    FAST_BOUND,
    PARALLEL,
    SMALL_SQUARE,
    TIME_ROUNDING,
    UNDERFLOW,
)
from obb_collision.numerics.vec3 import (
    ZERO,
    careful_cross,
    components,
    cross,
    dot,
    dot_abs,
    minus,
    norm,
    plus,
    scaled,
    sum_abs,
)
from obb_collision.queries.verdict.sat import (
    AXIS_COUNT,
    BoxAt,
    all_edge_axes,
    factors,
    in_frame,
    projected_radius,
    reach_of,
    rows_of,
)
from obb_collision.typing import Floats, Vector

#: Motions shorter than this have no reciprocal; widened by it, no interval depends on them.
SHORTEST_WAY = 2.0**-1000

#: First and last time, and the number of the axis entered at the first (-1: time 0).
TimeSpan = tuple[float, float, int]
NO_HIT = (math.inf, -1)


@njit
def spheres_pass(p: Vector, q: Vector, reach: float) -> bool:
    """Return whether two spheres, together of radius ``reach``, are certainly apart all along.

    p, q: offset of their centres at the start and at the end. A plane proves it: its normal v is
    the offset where it is shortest. Both ends of the way must be beyond it, so the rounding of v
    does not matter; other rounding is far below the bound (1024 unit roundoffs).
    """
    way = minus(q, p)
    when = -dot(p, way) / dot(way, way)
    when = when if when > 0.0 else 0.0  # NaN too, where nothing moves
    when = when if when < 1.0 else 1.0
    v = plus(p, scaled(way, when))
    square = dot(v, v)
    size = sum_abs(p) + sum_abs(q) + reach
    first, last = dot(v, p), dot(v, q)
    least = first if first < last else last
    beyond = math.sqrt(square) * (reach + FAST_BOUND * size)
    return (square > SMALL_SQUARE) & (least > beyond) & (least < math.inf)


@njit
def meeting_intervals(a: BoxAt, b: BoxAt, end: Vector, times: Floats) -> tuple[float, int]:
    """Return the least time of first contact of two boxes, infinity for a certain miss.

    And the axis that is entered then, -1 if all were entered before the start. The centre of b is
    its offset from a at time 0, ``end`` that at time 1.

    Writes to ``times`` (2, 15), unless it is a miss: when each axis has certainly been entered, and
    when it has certainly not been left (NaN if unknown). All up to TIME_ROUNDING.

    Formulas and bound as in ``verdict.fast_verdict``, linear in the offset and so valid at any time
    between.
    """
    start, h, f = b.center, a.half_extents, b.half_extents
    pair = in_frame(start, a.axes, h, b.axes, f)
    d, (x, y, z), e = pair.d, pair.r, components(a.axes, end)
    bound = sum_abs(start) + sum_abs(end)
    bound = FAST_BOUND * (bound + (h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2])) + UNDERFLOW
    bound += SHORTEST_WAY
    span = 0.0, 1.0, -1
    u, v, w = rows_of(pair.r)
    reach = plus(h, (dot_abs(f, u), dot_abs(f, v), dot_abs(f, w)))
    span = _meet_three(times, 0, d, e, reach, bound, span)
    if _over(span):
        return NO_HIT
    reach = plus(f, (dot_abs(h, x), dot_abs(h, y), dot_abs(h, z)))
    first, last = components(b.axes, start), components(b.axes, end)
    span = _meet_three(times, 3, first, last, reach, bound, span)
    if _over(span):
        return NO_HIT
    p, q, r = all_edge_axes(pair)
    firsts = rows_of((p.offset, q.offset, r.offset))
    lasts = rows_of((cross(x, e), cross(y, e), cross(z, e)))
    reaches = rows_of((reach_of(p), reach_of(q), reach_of(r)))
    span = _meet_three(times, 6, firsts[0], lasts[0], reaches[0], bound, span)
    span = _meet_three(times, 9, firsts[1], lasts[1], reaches[1], bound, span)
    span = _meet_three(times, 12, firsts[2], lasts[2], reaches[2], bound, span)
    if _over(span):
        return NO_HIT
    return span[0] * (1.0 - TIME_ROUNDING), span[2]


@njit(inline=True)
def _meet_three(
    times: Floats,
    n: int,
    at_0: Vector,
    at_1: Vector,
    reach: Vector,
    bound: float,
    span: TimeSpan,
) -> TimeSpan:
    """Return the part of a span in which three axes from ``n`` on meet (see ``_meet``)."""
    span = _meet(times, n, at_0[0], at_1[0], reach[0], bound, span)
    span = _meet(times, n + 1, at_0[1], at_1[1], reach[1], bound, span)
    return _meet(times, n + 2, at_0[2], at_1[2], reach[2], bound, span)


@njit
def _over(span: TimeSpan) -> bool:
    """Return whether a span has certainly no time left."""
    return span[0] * (1.0 - TIME_ROUNDING) > span[1] * (1.0 + TIME_ROUNDING)


@njit(inline=True)
def _meet(
    times: Floats, axis: int, first: float, last: float, reach: float, bound: float, span: TimeSpan
) -> TimeSpan:
    """Return the part of a span during which abs(s) <= reach, s from ``first`` to ``last``.

    The span is that of the largest possible ``reach``; ``times`` gets that of the smallest. Where
    nothing moves, all times are infinite, or NaN on the very limit, which changes no span.
    """
    inverse = 1.0 / (last - first)
    side = math.copysign(1.0, inverse)
    most, least = side * (reach + bound), side * (reach - bound)
    times[0, axis] = (-least - first) * inverse
    times[1, axis] = (least - first) * inverse
    enter = (-most - first) * inverse
    leave = (most - first) * inverse
    later, sooner = enter > span[0], leave < span[1]
    return enter if later else span[0], leave if sooner else span[1], axis if later else span[2]


NO_NORMAL: Vector = (math.nan, math.nan, math.nan)

#: Time, unit normal, and the number of its axis, or -1.
SweepHit = tuple[float, Vector, int]
MISS: SweepHit = (math.inf, NO_NORMAL, -1)


@njit
def sweep_linear(a: BoxAt, b: BoxAt, end: Vector, times: Floats) -> SweepHit:
    """Return time in [0, 1], unit normal and axis of the first contact of two boxes, or MISS.

    The centre of b is its offset from a at time 0, ``end`` that at time 1; ``times`` (2, 15) is
    work space. The normal at time 0 is NaN.
    """
    least, number = meeting_intervals(a, b, end, times)
    if least == math.inf:
        return MISS
    time, normal = 0.0, NO_NORMAL
    if number >= 0:
        span = _careful_span(a, b, end, number)
        times[0, number] = 0.0
        time, normal = _entry(span[0], span[1], span[2]), span[3]
    earlier, later = time * (1.0 - 4.0 * TIME_ROUNDING), time * (1.0 + 4.0 * TIME_ROUNDING)
    settled = True  # one loop without branches: most often no other axis matters
    for axis in range(AXIS_COUNT):
        settled &= (times[0, axis] <= earlier) & (times[1, axis] > later)
    hit = time * (1.0 - TIME_ROUNDING), normal, number if time > 0.0 else -1
    if not settled:
        hit = _settle(a, b, end, times, hit)
    return hit if hit[0] <= 1.0 else MISS


@njit
def _settle(a: BoxAt, b: BoxAt, end: Vector, times: Floats, hit: SweepHit) -> SweepHit:
    """Return the hit, or a later one of another axis, or MISS if an axis is left before it."""
    time, normal, number = hit
    for axis in range(AXIS_COUNT):
        if times[0, axis] <= time * (1.0 - 2.0 * TIME_ROUNDING):  # NaN is not skipped
            continue
        span = _careful_span(a, b, end, axis)
        when = _entry(span[0], span[1], span[2]) * (1.0 - TIME_ROUNDING)
        if when > time:
            time, normal, number = when, span[3], axis
    for axis in range(AXIS_COUNT):
        if times[1, axis] > time * (1.0 + 4.0 * TIME_ROUNDING):
            continue
        span = _careful_span(a, b, end, axis)
        if time > _exit(span[0], span[1], span[2]) * (1.0 + TIME_ROUNDING):
            return MISS
    return time, normal, number


@njit
def _careful_span(a: BoxAt, b: BoxAt, end: Vector, axis: int) -> tuple[float, float, float, Vector]:
    """Return s at 0, s at 1, r with its error bound, and the unit axis, s at 0 not negative.

    Zeros for parallel edges, which have no axis: such a span is never left. Axes and bound as in
    ``careful_gap``; face normals by plain products, off by 2.5 unit roundoffs instead of 2, for
    which the bound has room (16, where 10 are needed).
    """
    start, h, f = b.center, a.half_extents, b.half_extents
    u, v = factors(a.axes, b.axes, axis)
    n = cross(u, v) if axis < 6 else careful_cross(u, v)  # faces: orthogonal, nothing cancels
    square = dot(n, n)
    length = math.sqrt(square) if square > SMALL_SQUARE else norm(n)
    if length < PARALLEL:
        return 0.0, 0.0, 0.0, ZERO
    first = dot(n, start)
    length = length if first >= 0.0 else -length
    n = n[0] / length, n[1] / length, n[2] / length
    reach = projected_radius(n, a.axes, h) + projected_radius(n, b.axes, f)
    size = sum_abs(start) + sum_abs(end)
    size += (h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2])
    return first / length, dot(n, end), reach + (CAREFUL_BOUND * size + UNDERFLOW), n


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
        return math.inf
    return (first - reach) / (first - last)


@njit
def _exit(first: float, last: float, reach: float) -> float:
    """Return when s leaves ``reach`` for good, infinity if it is there at the end.

    Minus infinity if it stays beyond on one side: it was never there.
    """
    if last < 0.0:
        first, last = -first, -last
    if last <= reach:
        return math.inf
    if first > reach:
        return -math.inf
    return (reach - first) / (last - first)
