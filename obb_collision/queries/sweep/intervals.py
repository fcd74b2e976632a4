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

The coarse stage of ``sweep_linear``: 15 intervals of time with certain bounds of both ends, and
an end as soon as they have no time in common. Most pairs that miss do so by the spheres round
them or by the faces of the first box; the nine edge axes are for pairs that nearly hit.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.numerics.constants import FAST_BOUND, SMALL_SQUARE, TIME_ROUNDING, UNDERFLOW
from obb_collision.queries.verdict.sat import (
    Vector,
    column,
    dot,
    dot_abs,
    minus,
    plus,
    scaled,
    vector,
)
from obb_collision.typing import Floats

#: Motions shorter than this have no reciprocal; widened by it, no interval depends on them.
SHORTEST_WAY = 2.0**-1000

AXES = 15

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
    size = (abs(p[0]) + abs(p[1]) + abs(p[2])) + (abs(q[0]) + abs(q[1]) + abs(q[2])) + reach
    first, last = dot(v, p), dot(v, q)
    least = first if first < last else last
    beyond = math.sqrt(square) * (reach + FAST_BOUND * size)
    return (square > SMALL_SQUARE) & (least > beyond) & (least < math.inf)


@njit
def meeting_intervals(
    p: Vector,
    q: Vector,
    rotations: Floats,
    half_extents: Floats,
    i: int,
    j: int,
    times: Floats,
) -> tuple[float, int]:
    """Return the least time of first contact of boxes i and j, infinity for a certain miss.

    And the axis that is entered then, -1 if all were before the start. p, q: offset of the centres
    at times 0 and 1.

    Written to ``times`` (2, 15), unless it is a miss: when each axis has certainly been entered,
    and when it has certainly not been left (NaN: not known). All but for TIME_ROUNDING.

    Formulas and bound as in ``separation.classify_fast``, linear in the offset and so good at any
    time between.
    """
    h, f = vector(half_extents, i), vector(half_extents, j)
    bound = (abs(p[0]) + abs(p[1]) + abs(p[2])) + (abs(q[0]) + abs(q[1]) + abs(q[2]))
    bound = FAST_BOUND * (bound + (h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2])) + UNDERFLOW
    bound += SHORTEST_WAY
    a = column(rotations, i, 0), column(rotations, i, 1), column(rotations, i, 2)
    b = column(rotations, j, 0), column(rotations, j, 1), column(rotations, j, 2)
    x = dot(a[0], b[0]), dot(a[0], b[1]), dot(a[0], b[2])
    y = dot(a[1], b[0]), dot(a[1], b[1]), dot(a[1], b[2])
    z = dot(a[2], b[0]), dot(a[2], b[1]), dot(a[2], b[2])
    s = dot(a[0], p), dot(a[1], p), dot(a[2], p)
    e = dot(a[0], q), dot(a[1], q), dot(a[2], q)
    span = 0.0, 1.0, -1
    span = _meet(times, 0, s[0], e[0], h[0] + dot_abs(f, x), bound, span)
    span = _meet(times, 1, s[1], e[1], h[1] + dot_abs(f, y), bound, span)
    span = _meet(times, 2, s[2], e[2], h[2] + dot_abs(f, z), bound, span)
    if _over(span):
        return NEVER
    u, v, w = (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])
    span = _meet(times, 3, dot(b[0], p), dot(b[0], q), f[0] + dot_abs(h, u), bound, span)
    span = _meet(times, 4, dot(b[1], p), dot(b[1], q), f[1] + dot_abs(h, v), bound, span)
    span = _meet(times, 5, dot(b[2], p), dot(b[2], q), f[2] + dot_abs(h, w), bound, span)
    if _over(span):
        return NEVER
    span = _meet_edges(times, 6, s[1], s[2], e[1], e[2], h[1], h[2], f, y, z, x, bound, span)
    span = _meet_edges(times, 9, s[2], s[0], e[2], e[0], h[2], h[0], f, z, x, y, bound, span)
    span = _meet_edges(times, 12, s[0], s[1], e[0], e[1], h[0], h[1], f, x, y, z, bound, span)
    if _over(span):
        return NEVER
    return span[0] * (1.0 - TIME_ROUNDING), span[2]


@njit
def _over(span: Span) -> bool:
    """Return whether a span has certainly no time left."""
    return span[0] * (1.0 - TIME_ROUNDING) > span[1] * (1.0 + TIME_ROUNDING)


@njit
def _meet_edges(
    times: Floats, axis: int,
    sk: float, sm: float, ek: float, em: float, hk: float, hm: float, f: Vector,
    k: Vector, m: Vector, own: Vector, bound: float, span: Span,
) -> Span:  # fmt: skip
    """Take the axes of an edge of a, ``own`` along the axes of b, with the three edges of b.

    k, m: the axes of a after it along those of b; s, e, h: what belongs to them.
    """
    r = hk * abs(m[0]) + hm * abs(k[0]) + f[1] * abs(own[2]) + f[2] * abs(own[1])
    span = _meet(times, axis, sm * k[0] - sk * m[0], em * k[0] - ek * m[0], r, bound, span)
    r = hk * abs(m[1]) + hm * abs(k[1]) + f[0] * abs(own[2]) + f[2] * abs(own[0])
    span = _meet(times, axis + 1, sm * k[1] - sk * m[1], em * k[1] - ek * m[1], r, bound, span)
    r = hk * abs(m[2]) + hm * abs(k[2]) + f[0] * abs(own[1]) + f[1] * abs(own[0])
    return _meet(times, axis + 2, sm * k[2] - sk * m[2], em * k[2] - ek * m[2], r, bound, span)


@njit
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

    The span for ``reach`` at most; kept in ``times`` is that for ``reach`` at least. Where
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
