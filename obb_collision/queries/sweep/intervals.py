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

"""During which times does each axis not separate two boxes that move without turning? Roughly.

The coarse stage of ``linear``: 15 intervals of time with certain bounds of both ends, and
an end as soon as they have no time in common. Most pairs that miss do so by the spheres round
them or by the faces of the first box; the nine edge axes are for pairs that nearly hit.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit, njit_each_number
from obb_collision.numerics.constants import FAST_BOUND, SMALL_SQUARE, TIME_ROUNDING, UNDERFLOW
from obb_collision.numerics.vec3 import (
    components,
    cross,
    dot,
    dot_abs,
    minus,
    plus,
    scaled,
    sum_abs,
)
from obb_collision.queries.verdict.pair_frame import Box, in_frame
from obb_collision.queries.verdict.sat import all_edge_axes, reach_of, rows_of
from obb_collision.typing import Floats, Vector

#: Motions shorter than this have no reciprocal; widened by it, no interval depends on them.
SHORTEST_WAY = 2.0**-1000

#: First and last time, and the number of the axis entered at the first (-1: time 0).
Span = tuple[float, float, int]
NEVER = (math.inf, -1)


@njit
def spheres_pass(p: Vector, q: Vector, reach: float) -> bool:
    """Return whether two spheres, together of radius ``reach``, are certainly apart all along.

    p, q: offset of their centres at the start and at the end. A plane shows it: its normal v is
    where the offset comes nearest to zero, and any v will do that both ends of the way are
    beyond: so nothing hangs on the rounding of v. That of the rest is far less than the bound
    (1024 unit roundoffs).
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
def meeting_intervals(a: Box, b: Box, end: Vector, times: Floats) -> tuple[float, int]:
    """Return the least time of first contact of two boxes, infinity for a certain miss.

    And the axis that is entered then, -1 if all were before the start. The centre of b is its
    offset from a at time 0, ``end`` that at time 1.

    Written to ``times`` (2, 15), unless it is a miss: when each axis has certainly been entered,
    and when it has certainly not been left (NaN: not known). All but for TIME_ROUNDING.

    Formulas and bound as in ``verdict.fast_verdict``, linear in the offset and so good at any
    time between.
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
        return NEVER
    reach = plus(f, (dot_abs(h, x), dot_abs(h, y), dot_abs(h, z)))
    first, last = components(b.axes, start), components(b.axes, end)
    span = _meet_three(times, 3, first, last, reach, bound, span)
    if _over(span):
        return NEVER
    p, q, r = all_edge_axes(pair)
    firsts = rows_of((p.offset, q.offset, r.offset))
    lasts = rows_of((cross(x, e), cross(y, e), cross(z, e)))
    reaches = rows_of((reach_of(p), reach_of(q), reach_of(r)))
    span = _meet_three(times, 6, firsts[0], lasts[0], reaches[0], bound, span)
    span = _meet_three(times, 9, firsts[1], lasts[1], reaches[1], bound, span)
    span = _meet_three(times, 12, firsts[2], lasts[2], reaches[2], bound, span)
    if _over(span):
        return NEVER
    return span[0] * (1.0 - TIME_ROUNDING), span[2]


@njit_each_number
def _meet_three(
    times: Floats, axis: int, first: Vector, last: Vector, reach: Vector, bound: float, span: Span
) -> Span:
    """Take three axes in turn, from a number on (see ``_meet``)."""
    span = _meet(times, axis, first[0], last[0], reach[0], bound, span)
    span = _meet(times, axis + 1, first[1], last[1], reach[1], bound, span)
    return _meet(times, axis + 2, first[2], last[2], reach[2], bound, span)


@njit
def _over(span: Span) -> bool:
    """Return whether a span has certainly no time left."""
    return span[0] * (1.0 - TIME_ROUNDING) > span[1] * (1.0 + TIME_ROUNDING)


@njit_each_number
def _meet(
    times: Floats,
    axis: int,
    first: float,
    last: float,
    reach: float,
    bound: float,
    span: Span,
) -> Span:
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
    return (
        enter if later else span[0],
        leave if sooner else span[1],
        axis if later else span[2],
    )
