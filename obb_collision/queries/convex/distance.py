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

"""The distance of two convex bodies: a plane between them below, two of their points above.

The search is that of Gilbert, Johnson and Keerthi 1988, in the frame of a. However it went, the
gap along any direction, the reach of the one body less that of the other, is at most the signed
distance; that of two points of the bodies is at least that. So the answer rests on both being
close, and says how close they are. For boxes, cylinders, cones and segments it first tries the
foot of the other's foremost point; for curved bodies it then climbs (``directions``). Where plain
doubles leave both farther apart than ``CLOSE`` (bodies nearly in touch, needles), the search goes
on with twice the digits (``simplex.careful_nearest``).

Error analysis, with u and S as in ``queries.meshes.placed``: both reaches along a unit vector
are off by at most 200 u S (``queries.meshes.hull_hull``), points of curved cores by 16 u S more.
CONVEX_ROUNDING is 512 u.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.simplex import Simplex, no_simplex, on_corner, with_corner
from obb_collision.numerics.vec3 import (
    LEAST_SQUARE,
    clamp,
    components,
    cross,
    dot,
    fast_norm,
    max_abs,
    minus,
    negated,
    norm,
    plus,
    scaled,
)
from obb_collision.queries.convex.directions import (
    feet,
    has_feet,
    is_curved,
    no_feet,
    opposite_end,
    steeper,
    turned_to,
)
from obb_collision.queries.convex.simplex import (
    NO_CORNER,
    Corner,
    are_same,
    careful_nearest,
    is_zero,
)
from obb_collision.queries.convex.support import SEGMENT_CORE, Core, support
from obb_collision.queries.meshes.placed import PairPose, moved
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.typing import Vector

Weights = tuple[float, float, float, float]
"""Weights of four corners: not negative, with the sum 1."""
#: Bound on the error of a gap, relative to S (derivation above).
CONVEX_ROUNDING = 512 * ROUNDOFF
#: The search ends when the points are farther apart than the plane shows by less than this,
#: relative to S: a tenth of the promised accuracy.
CLOSE = 1e-10
#: Directions tried in plain doubles: hulls take 3 to 10, others 2 to 4, some cylinders 30.
MOST_DIRECTIONS = 60
#: The climb by curvature ends when that many directions showed no larger gap.
MOST_LAPSES = 3
#: ... and with twice the digits.
MOST_CAREFUL_DIRECTIONS = 100
#: Directions along which feet are tried; only the first where no core is curved. The direction to
#: the foot of a corner is final, that to the foot of a rim may turn to another place.
MOST_FEET = 2
#: The search in plain doubles ends when a corner brings it nearer by less than this fraction.
STALLED_GAIN = 1e-13
#: Six times the volume that the origin makes with each face of a tetrahedron that it is certainly
#: in; sizes are near one, and volumes off by 1e-15.
CERTAIN_VOLUME = 1e-10


class PlaneGap(NamedTuple):
    """The gap of two cores along a direction, and their foremost points."""

    value: float  #: metres; negative where they overlap along it
    p: Vector  #: of a, in its frame
    q: Vector  #: of b, in its own


class GapSearch(NamedTuple):
    """The result of a search for the distance of two cores: metres, in the frame of a."""

    gap: float  #: the largest along any direction tried
    normal: Vector  #: that direction, unit, from a to b
    distance: float  #: of the two points; 0 where the cores overlap
    p: Vector  #: of a, in its frame
    q: Vector  #: of b, in its own
    simplex: Simplex  #: nearest to the origin, which is in or nearly on one of size 4


@njit(refcount=False)
def core_gap(a: Core, b: Core, pose: PairPose, n: Vector) -> PlaneGap:
    """Return the gap of two cores along n, unit, from a to b."""
    return _gap_here(a, b, pose, n)


@njit(inline=True, refcount=False)
def _gap_here(a: Core, b: Core, pose: PairPose, n: Vector) -> PlaneGap:
    """Inlined variant of ``core_gap``."""
    m = components(pose.axes, n)
    p, q = support(a, n), support(b, negated(m))
    return PlaneGap(dot(m, q) + dot(n, pose.offset) - dot(n, p), p, q)


@njit
def rounding(pose: PairPose) -> float:
    """Return a bound on the error of a gap."""
    return CONVEX_ROUNDING * pose.size + MESH_UNDERFLOW


@njit(refcount=False)
def search(a: Core, b: Core, pose: PairPose, start: Vector, stop: float) -> GapSearch:
    """Return the distance of two cores; the search ends at a gap larger than ``stop``.

    start: the direction to try first, from a to b, such as the normal of an earlier search; zero
    for that of the centres.
    """
    unit = unit_scale(pose.size)[0]
    n = pose.offset if is_zero(start) else start
    n = unit_of((1.0, 0.0, 0.0) if is_zero(n) else n)[0]
    best, normal, simplex, reached = -np.inf, n, no_simplex(NO_CORNER), np.inf
    if a.kind == SEGMENT_CORE and b.kind == SEGMENT_CORE:
        nearest = _of_segments(a, b, pose)
        if nearest.distance - nearest.gap <= CLOSE * pose.size:
            return nearest
    curved = is_curved(a) or is_curved(b)
    room, lapses = CLOSE * pose.size, 0 if curved else MOST_LAPSES
    looks = (MOST_FEET if curved else 1) if has_feet(a) or has_feet(b) else 0
    near, length = no_feet(n, n), np.inf
    for _ in range(MOST_DIRECTIONS):
        gap = _gap_here(a, b, pose, n)
        better, climbs = gap.value > best, gap.value > room and lapses < MOST_LAPSES
        if better:
            best, normal = gap.value, n
        elif climbs:
            lapses += 1
        if best > stop and simplex.size == 0:
            return GapSearch(best, normal, np.inf, gap.p, gap.q, simplex)
        if best > stop or reached - unit * best <= unit * room:
            break
        if looks > 0:
            looks -= 1
            other = feet(a, b, pose, gap.p, gap.q)
            if LEAST_SQUARE < other.square < near.square:
                near, length = other, math.sqrt(other.square)
        if length - best <= room:
            return GapSearch(best, normal, length, near.p, near.q, simplex)
        new = corner_of(gap, pose, unit)
        if simplex.size == 0 and length < np.inf:
            p = opposite_end(a.kind, a.size, a.half, gap.p, near.p)
            q = opposite_end(b.kind, b.size, b.half, gap.q, near.q)
            simplex = on_corner(new)
            if p != gap.p or q != gap.q:
                new = corner_of(PlaneGap(0.0, p, q), pose, unit)
                simplex = Simplex(2, simplex.a, new, new, new, simplex.weights, simplex.nearest)
            n = scaled(near.v, 1.0 / length)
            continue
        if climbs:
            simplex = turned_to(a, b, pose, n, unit, simplex, new)
        elif not unit * gap.value < (1.0 - STALLED_GAIN) * reached:
            break
        simplex = with_corner(simplex, new)
        if climbs and simplex.size == 4:  # flat: there is a gap, so that the origin is not inside
            simplex = on_corner(new)
        if simplex.size == 4 or is_zero(simplex.nearest):
            break
        towards, reached = unit_of(negated(simplex.nearest))
        if reached - unit * best <= unit * room:
            break
        if not climbs or simplex.size == 3:
            n = towards
        elif better or simplex.size == 2:
            n = steeper(a, b, pose, n, simplex, unit, gap.value)
        else:
            n = unit_of(plus(normal, n))[0]
    return _finished(a, b, pose, unit, stop, GapSearch(best, normal, 0.0, n, n, simplex))


@njit(inline=True, refcount=False)
def _of_segments(a: Core, b: Core, pose: PairPose) -> GapSearch:
    """Return the distance of two segments along their z axes (Ericson 2005, 5.1.9)."""
    axis, offset = pose.axes[2], pose.offset
    c, far = axis[2], dot(axis, offset)
    square = 1.0 - c * c
    s = clamp((offset[2] - c * far) / square, a.half) if square > 0.0 else 0.0
    t = clamp(s * c - far, b.half)
    p, q = (0.0, 0.0, clamp(offset[2] + t * c, a.half)), (0.0, 0.0, t)
    v = minus(moved(pose, q), p)
    if is_zero(v):
        return GapSearch(-np.inf, v, np.inf, p, q, no_simplex(NO_CORNER))
    n, length = unit_of(v)
    return GapSearch(core_gap(a, b, pose, n).value, n, length, p, q, no_simplex(NO_CORNER))


@njit(refcount=False)
def cores_overlap(
    a: Core, b: Core, pose: PairPose, start: Vector, needed: float, near: float
) -> int:
    """Return 1 for two cores nearer than ``near``, 0 for a gap above ``needed``, else -1.

    Tries the directions of ``search``, without its last steps: -1 leaves the pair to it.
    """
    unit = unit_scale(pose.size)[0]
    n = pose.offset if is_zero(start) else start
    n = unit_of((1.0, 0.0, 0.0) if is_zero(n) else n)[0]
    best, simplex, reached = -np.inf, no_simplex(NO_CORNER), np.inf
    for _ in range(MOST_DIRECTIONS):
        gap = core_gap(a, b, pose, n)
        if gap.value > needed:
            return 0
        best = max(best, gap.value)
        if reached - unit * best <= CLOSE * unit * pose.size:
            return -1
        if simplex.size > 0 and not reached - unit * gap.value > STALLED_GAIN * reached:
            return -1
        simplex = with_corner(simplex, corner_of(gap, pose, unit))
        if simplex.size == 4:
            return 1 if _weights_inside(simplex)[3] > 0.0 else -1
        if is_zero(simplex.nearest):
            return -1
        n, reached = unit_of(negated(simplex.nearest))
        if reached < unit * near:
            return 1
    return -1


@njit(inline=True)
def unit_of(v: Vector) -> tuple[Vector, float]:
    """Return the unit vector along v, which is not zero, and its length."""
    square = dot(v, v)
    if LEAST_SQUARE < square < np.inf:
        length = math.sqrt(square)
        return scaled(v, 1.0 / length), length
    largest = max_abs(v)
    v = scaled(v, 1.0 / largest)
    length = math.sqrt(dot(v, v))
    return scaled(v, 1.0 / length), largest * length


@njit(inline=True)
def corner_of(gap: PlaneGap, pose: PairPose, unit: float) -> Corner:
    """Return the foremost point of the difference along a direction, scaled."""
    return Corner(scaled(minus(gap.p, moved(pose, gap.q)), unit), gap.p, gap.q)


@njit(refcount=False)
def _finished(
    a: Core, b: Core, pose: PairPose, unit: float, stop: float, last: GapSearch
) -> GapSearch:
    """Add the points to a search; continue with twice the digits where it is not close enough."""
    simplex = last.simplex
    reached, room = fast_norm(simplex.nearest), CLOSE * unit * pose.size
    if simplex.size < 4 and (reached - unit * last.gap <= room or last.gap > stop):
        x, y, z = simplex.weights
        weights, (s, t, u) = (x, y, z, 0.0), (simplex.a, simplex.b, simplex.c)
        point = _weighted(s.w, t.w, u.w, u.w, weights)
        if fast_norm(minus(point, simplex.nearest)) <= room:  # not so for needles
            p, q = _weighted(s.p, t.p, u.p, u.p, weights), _weighted(s.q, t.q, u.q, u.q, weights)
            return GapSearch(last.gap, last.normal, reached / unit, p, q, simplex)
    if simplex.size == 4:
        weights = _weights_inside(simplex)
        if weights[3] > 0.0:
            s, t, u, v = simplex.a, simplex.b, simplex.c, simplex.d
            p, q = _weighted(s.p, t.p, u.p, v.p, weights), _weighted(s.q, t.q, u.q, v.q, weights)
            return GapSearch(last.gap, last.normal, 0.0, p, q, simplex)
    return _careful_search(a, b, pose, unit, stop, last)


@njit
def _weights_inside(simplex: Simplex) -> Weights:
    """Return weights of the origin where it is certainly in the tetrahedron, else zero."""
    a, b, c, d = simplex.a.w, simplex.b.w, simplex.c.w, simplex.d.w
    across, other = cross(c, d), cross(a, b)
    x, y = dot(b, across), -dot(a, across)
    z, w = dot(d, other), -dot(c, other)
    total = x + y + z + w
    if total < 0.0:
        x, y, z, w, total = -x, -y, -z, -w, -total
    if min(min(x, y), min(z, w)) > CERTAIN_VOLUME:
        return x / total, y / total, z / total, w / total
    return 0.0, 0.0, 0.0, 0.0


@njit(merge=True)
def _careful_search(
    a: Core, b: Core, pose: PairPose, unit: float, stop: float, last: GapSearch
) -> GapSearch:
    """Continue a search with twice the digits."""
    best, normal, count = last.gap, last.normal, last.simplex.size
    s, t, u, v = last.simplex.a, last.simplex.b, last.simplex.c, last.simplex.d
    near = careful_nearest(s, t, u, v, count, pose, unit)
    weights = near.weights
    for _ in range(MOST_CAREFUL_DIRECTIONS):
        if near.inside or is_zero(near.point):
            break
        count, s, t, u, weights = _needed(s, t, u, v, weights)
        n, reached = unit_of(negated(near.point))
        gap = core_gap(a, b, pose, n)
        if gap.value >= best:
            best, normal = gap.value, n
        new = corner_of(gap, pose, unit)
        repeated = are_same(new, s) or are_same(new, t) or are_same(new, u)
        if repeated or best > stop or reached - unit * best <= CLOSE * unit * pose.size:
            break
        t, u, v = new if count == 1 else t, new if count == 2 else u, new
        count += 1
        near = careful_nearest(s, t, u, v, count, pose, unit)
        weights = near.weights
    p, q = _weighted(s.p, t.p, u.p, v.p, weights), _weighted(s.q, t.q, u.q, v.q, weights)
    reached = 0.0 if near.inside else norm(near.point) / unit
    size = 4 if near.inside else count
    return GapSearch(best, normal, reached, p, q, Simplex(size, s, t, u, v, near.point, near.point))


@njit
def _needed(
    s: Corner, t: Corner, u: Corner, v: Corner, weights: Weights
) -> tuple[int, Corner, Corner, Corner, Weights]:
    """Return the number of corners with weights, at most three, these corners, and the weights."""
    count, x, y, z = 0, 0.0, 0.0, 0.0
    first = second = third = s
    for k in range(4):
        weight = weights[k]
        if weight > 0.0:
            corner = s if k == 0 else t if k == 1 else u if k == 2 else v
            if count == 0:
                first, x = corner, weight
            elif count == 1:
                second, y = corner, weight
            else:
                third, z = corner, weight
            count += 1
    second = second if count > 1 else first
    return count, first, second, third if count > 2 else second, (x, y, z, 0.0)


@njit
def _weighted(a: Vector, b: Vector, c: Vector, d: Vector, weights: Weights) -> Vector:
    x, y, z, w = weights
    return plus(plus(scaled(a, x), scaled(b, y)), plus(scaled(c, z), scaled(d, w)))
