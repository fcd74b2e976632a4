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

"""Certain bounds of boxes that move: gaps along a moving axis, and slices of time.

For how long does an axis go on separating two boxes that turn? The step of ``rigid``.

An axis of the boxes moves with them: a face normal turns with its box, the cross product of two
edges with both. Along it, at time t from now, the gap (not normalised) is

    g(t) = abs(n.d) - sum_i h_i abs(n.a_i) - sum_j f_j abs(n.b_j)

Each of the seven products is smooth, so it is its tangent up to half its largest second
derivative times t^2. With K the sum of these, each bounded by the product rule,

    g(t) >= s (n.d + (n.d)' t) - sum_i h_i abs(n.a_i + (n.a_i)' t) - ... - K t^2 / 2

for s the sign of n.d. Boxes turn about their origins, whose offset p changes at speed v. What
turns with n adds nothing to K: to an axis of a, n.p adds w_a (w_a abs(p) + 2 v), and b is a body
of radius r about its origin that turns relative to n at w_a + w_b or slower: (w_a + w_b)^2 r.

The right side is concave, and its first root is never before where the chord of any two of its
values has one: regula falsi from the left never steps too far.

Slices of time in which two spinning boxes certainly stay apart.

A box that turns a long way is held by the body it sweeps in a whole turn about its origin: the
circles of its corners about the axis of the turn and what lies between them. That body only moves
along a line, however many turns the box makes. A box that turns less than ``TURNING_ALL_ROUND`` in
a slice is held by its place in the middle, grown by the way of its corners from there. A direction
along which one body stays beyond the other during the whole slice proves it free. The search is
that of ``meshes.hull_hull`` (Gilbert, Johnson, Keerthi 1988); its errors cost only proofs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.simplex import BARE_CORNER, no_simplex, with_corner
from obb_collision.numerics.vec3 import (
    components,
    cross,
    dot,
    minus,
    norm,
    pick_axis,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.verdict.sat import AXIS_COUNT, factors
from obb_collision.typing import Axes, Floats, Vector

#: An axis this short is lost in rounding.
SHORTEST_AXIS = 2.0**-40
#: Rounds of closing in on a root: the bracket shrinks quadratically.
ROOT_ROUNDS = 4
#: A bracket this narrow, relative to the root, is good enough.
NARROW_BRACKET = 0.05


class TurningBox(NamedTuple):
    """A box that turns about its origin."""

    axes: Axes
    rates: Axes  #: how the axes change
    half_extents: Vector
    speed: float  #: of the turn, rad/s
    reach: float  #: radius of the box about its origin


class Approach(NamedTuple):
    """How the second of two boxes moves, seen from the first."""

    offset: Vector  #: of the centres
    velocity: Vector  #: how the offset changes
    far: float  #: maximum length of the offset of the origins until the horizon
    speed: float  #: of the second origin seen from the first
    horizon: float  #: the longest step that is useful


class MovingAxis(NamedTuple):
    """The gap along an axis as a function of time: values and derivatives."""

    gap: float
    rate: float
    bend: float  #: bound of all second derivatives, summed
    values: tuple[Vector, Vector]  #: extents times products of the axis with those of a, of b
    slopes: tuple[Vector, Vector]


@njit
def turning(axes: Axes, half_extents: Vector, turn: Vector, reach: float) -> TurningBox:
    """Return a box that turns at an angular velocity."""
    rates = cross(turn, axes[0]), cross(turn, axes[1]), cross(turn, axes[2])
    return TurningBox(axes, rates, half_extents, norm(turn), reach)


@njit
def best_step(
    approach: Approach, a: TurningBox, b: TurningBox, rounding: float, blur: float
) -> tuple[float, float]:
    """Return the largest certain gap of the 15 axes, and for how long one surely separates.

    Gaps may be off by ``rounding``, and by ``blur`` times the length of their axis. Both results
    are at least 0; a step that lasts to the horizon is infinite.
    """
    most, step = 0.0, 0.0
    for number in range(AXIS_COUNT):
        n, dn = _moving_axis(a, b, number)
        square = dot(n, n)
        if square < SHORTEST_AXIS * SHORTEST_AXIS:
            continue
        along = dot(n, approach.offset)
        values = _products(n, a), _products(n, b)
        gap = abs(along) - rounding
        for k in range(3):
            gap -= abs(values[0][k]) + abs(values[1][k])
        if gap <= 0.0:
            continue
        length = math.sqrt(square)
        gap -= blur * length
        if gap <= 0.0:
            continue
        most = max(most, gap / length)
        rate = dot(dn, approach.offset) + dot(n, approach.velocity)
        rate = rate if along > 0.0 else -rate
        if number >= 6:
            rate -= blur * (a.speed + b.speed)  # the axis grows no faster than its edges turn
        slopes = _slopes(n, dn, a), _slopes(n, dn, b)
        axis = MovingAxis(gap, rate, _bend(approach, a, b, number), values, slopes)
        step = max(step, _first_root(axis, approach.horizon))
        if step == np.inf:
            break
    return most, step


@njit
def _moving_axis(a: TurningBox, b: TurningBox, number: int) -> tuple[Vector, Vector]:
    """Return an axis, numbered as in ``sat``, and its derivative; face normals as stored."""
    if number < 3:
        return pick_axis(a.axes, number), pick_axis(a.rates, number)
    if number < 6:
        return pick_axis(b.axes, number - 3), pick_axis(b.rates, number - 3)
    u, v = factors(a.axes, b.axes, number)
    du, dv = factors(a.rates, b.rates, number)
    return cross(u, v), plus(cross(du, v), cross(u, dv))


@njit
def _bend(approach: Approach, a: TurningBox, b: TurningBox, number: int) -> float:
    """Return K of an axis (see the module)."""
    far, speed, both = approach.far, approach.speed, a.speed + b.speed
    if number < 3:
        return a.speed * (a.speed * far + 2.0 * speed) + both * both * b.reach
    if number < 6:
        return b.speed * (b.speed * far + 2.0 * speed) + both * both * a.reach
    return both * (both * (far + a.reach + b.reach) + 2.0 * speed)


@njit
def _products(n: Vector, box: TurningBox) -> Vector:
    """Return the half extents times the products of n with the axes."""
    p, q, r = components(box.axes, n)
    h = box.half_extents
    return h[0] * p, h[1] * q, h[2] * r


@njit
def _slopes(n: Vector, dn: Vector, box: TurningBox) -> Vector:
    """Return the derivatives of ``_products``."""
    (x, y, z), (dx, dy, dz), h = box.axes, box.rates, box.half_extents
    return (
        h[0] * _product_slope(n, dn, x, dx),
        h[1] * _product_slope(n, dn, y, dy),
        h[2] * _product_slope(n, dn, z, dz),
    )


@njit
def _product_slope(n: Vector, dn: Vector, v: Vector, dv: Vector) -> float:
    """Return the derivative of n . v."""
    return (
        (dn[0] * v[0] + n[0] * dv[0])
        + (dn[1] * v[1] + n[1] * dv[1])
        + (dn[2] * v[2] + n[2] * dv[2])
    )


@njit
def _first_root(axis: MovingAxis, horizon: float) -> float:
    """Return a time before the lower bound of the gap first reaches zero; infinity if never.

    Each round takes the bound's parabola at the left end, which lies above it, for a new right end,
    and the chord for a new left end.
    """
    left, at_left = 0.0, axis.gap
    right = horizon
    for _ in range(ROOT_ROUNDS):
        slope = axis.rate - axis.bend * left
        for m in range(2):
            for k in range(3):
                slope -= _growth(axis.values[m][k], axis.slopes[m][k], left)
        ahead = parabola_root(at_left, slope, axis.bend)
        right = min(right, left + ahead)
        at_right = _bound(axis, right)
        if at_right >= 0.0:
            return np.inf if right >= horizon else right
        left += (right - left) * (at_left / (at_left - at_right))
        at_left = _bound(axis, left)
        if at_left <= 0.0 or right - left <= NARROW_BRACKET * right:
            break
    return left


@njit
def _growth(value: float, slope: float, time: float) -> float:
    """Return how fast abs(value + slope t) grows from a time on."""
    value += slope * time
    grows = slope if value >= 0.0 else -slope
    return grows if value != 0.0 else abs(grows)


@njit
def _bound(axis: MovingAxis, time: float) -> float:
    """Return the lower bound of the gap at a time from now."""
    total = axis.gap + (axis.rate - 0.5 * axis.bend * time) * time
    for m in range(2):
        for k in range(3):
            value = axis.values[m][k]
            total -= abs(value + axis.slopes[m][k] * time) - abs(value)
    return total


@njit
def parabola_root(value: float, slope: float, bend: float) -> float:
    """Return the positive root of value + slope t - bend t^2 / 2; infinity if there is none."""
    root = math.sqrt(slope * slope + 2.0 * bend * value)
    if slope <= 0.0:
        return 2.0 * value / (root - slope) if root > slope else np.inf
    return (root + slope) / bend if bend > 0.0 else np.inf


#: Radians in a slice from which on a box counts as turning all round.
TURNING_ALL_ROUND = 1.0
#: Directions tried: bodies a few hundredths of their size apart take 3 to 10.
SLICE_DIRECTIONS = 30
#: The search ends when the next point brings it nearer by less than this fraction.
SLICE_CONVERGED = 1e-6
#: Rounding of reaches and offsets, relative to these: 2048 unit roundoffs, where 64 are needed: 40
#: in a reach (``_farthest``), 8 in a corner, 6 in an offset, 10 in sums and the length of n.
SLICE_SLACK = 2048 * ROUNDOFF
#: Sine of the angle to the axis below which the direction across has lost half of its digits.
LEAST_TILT = 2.0**-26
#: Rows of the corners of a box (``fill_corners``): the axis of the turn, 8 corners, and in a row
#: how far the corners are at most from that axis.
CORNER_ROWS = 10


@njit
def fill_corners(axes: Axes, extents: Vector, arm: Vector, turn: Vector, out: Floats) -> None:
    """Write the unit axis of the turn and the corners from the origin (CORNER_ROWS, 3).

    Corners at the time of ``axes`` and ``arm``.
    """
    angle = norm(turn)
    axis = 0.0, 0.0, 1.0
    if angle > 0.0:
        axis = turn[0] / angle, turn[1] / angle, turn[2] / angle
    most = 0.0
    for n in range(8):
        corner = arm
        for k in range(3):
            side = extents[k] if n >> k & 1 else -extents[k]
            corner = plus(corner, scaled(axes[k], side))
        out[1 + n, 0], out[1 + n, 1], out[1 + n, 2] = corner
        around = minus(corner, scaled(axis, dot(corner, axis)))
        most = max(most, norm(around))
    out[0, 0], out[0, 1], out[0, 2] = axis
    out[9, 0] = most


@njit
def free_slice(
    first: Vector, last: Vector, a: Floats, angle_a: float, b: Floats, angle_b: float, blur: float
) -> bool:
    """Return whether two boxes are certainly apart during a slice of time.

    first, last: offset of the origins from a to b at its two ends; a, b: corners in its middle;
    angle_a, angle_b: how far each turns; ``blur``: error of positions.
    """
    size = norm(first) + norm(last)
    bound = blur + SLICE_SLACK * (size + _radius(a) + _radius(b)) + _grown_by(a, angle_a)
    bound += _grown_by(b, angle_b)
    n, simplex = scaled(plus(first, last), 0.5), no_simplex(BARE_CORNER)
    for _ in range(SLICE_DIRECTIONS):
        length = norm(n)
        if not 0.0 < length < np.inf:
            return False
        n = scaled(n, 1.0 / length)
        back = scaled(n, -1.0)
        offset = first if dot(n, first) < dot(n, last) else last
        reach_a, p = _farthest(a, angle_a, n)
        reach_b, q = _farthest(b, angle_b, back)
        gap = dot(n, offset) - reach_a - reach_b
        if gap > bound:
            return True
        if simplex.size > 0 and not length - gap > SLICE_CONVERGED * length:
            return False
        simplex = with_corner(simplex, (plus(offset, minus(q, p)),))
        n = simplex.nearest
        # the nearest point of the difference: no direction shows a larger gap
        if simplex.size == 4 or not norm(n) > bound:
            return False
    return False


@njit
def _grown_by(corners: Floats, angle: float) -> float:
    """Return how far a body is grown in a slice in which it does not turn all round.

    Half of the angle either way from the middle: a chord is shorter than its arc.
    """
    return 0.5 * angle * corners[9, 0] if angle < TURNING_ALL_ROUND else 0.0


@njit
def _radius(corners: Floats) -> float:
    """Return the distance from the origin to the farthest corner, rounded up by a few roundoffs."""
    along = 0.0
    for k in range(1, 9):
        along = max(along, abs(dot(vector_at(corners, k), vector_at(corners, 0))))
    return along + corners[9, 0]


@njit
def _farthest(corners: Floats, angle: float, n: Vector) -> tuple[float, Vector]:
    """Return how far a body, before it is grown, reaches along a unit vector, and a point there.

    A circle of a corner c reaches height * rise + radius * tilt: parts of c and of n along the axis
    and across. Each is a sum of terms no longer than c or n, so its error is absolute: 7 u of c or
    of n along, 17 u across (the stored axis is off by 4 u), and so 40 u of c in the reach, whatever
    the tilt. The point is as far as digits allow, and only leads the search: near the axis, where
    the direction across is rounding, it is the centre of the circle.
    """
    most, best, radius = -np.inf, vector_at(corners, 1), 0.0
    axis = vector_at(corners, 0)
    rise = dot(n, axis)
    out = minus(n, scaled(axis, rise))
    tilt = norm(out)
    for k in range(1, 9):
        corner, around = vector_at(corners, k), 0.0
        reach = dot(n, corner)
        if angle >= TURNING_ALL_ROUND:
            height = dot(corner, axis)
            across = minus(corner, scaled(axis, height))
            around = math.sqrt(dot(across, across))
            corner, reach = scaled(axis, height), height * rise + around * tilt
        if reach > most:
            most, best, radius = reach, corner, around
    return most, plus(best, scaled(out, radius / tilt)) if tilt > LEAST_TILT else best
