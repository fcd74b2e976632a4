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

"""For how long does an axis go on separating two boxes that turn? The step of ``sweep_rigid``.

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
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.error_free import length
from obb_collision.typing import Floats

AXES = 15
#: An axis this short is lost in rounding.
SHORTEST_AXIS = 2.0**-40
#: Rounds of closing in on a root: the bracket shrinks quadratically.
ROOT_ROUNDS = 4
#: A bracket this narrow, relative to the root, is good enough.
NARROW = 0.05


@njit
def best_step(
    d: Floats,
    velocity: Floats,
    far: float,
    speed: float,
    a: Floats,
    h: Floats,
    turn_a: Floats,
    reach_a: float,
    b: Floats,
    f: Floats,
    turn_b: Floats,
    reach_b: float,
    rounding: float,
    blur: float,
    horizon: float,
    work: Floats,
) -> tuple[float, float]:
    """Return the largest certain gap of the 15 axes, and for how long one surely separates.

    d: offset of the centres, ``velocity`` how it changes; far: the most that the offset of the
    origins gets to until the horizon, ``speed`` that of its ends; a, b: rotations, h, f: half
    extents, turn_a, turn_b: angular velocities, reach_a, reach_b: radii about the origins.
    Gaps may be off by ``rounding``, and by ``blur`` times the length of their axis. Both results
    are at least 0, a step that lasts to the ``horizon`` is infinite. ``work`` (12, 3): work space.
    """
    wa = length(turn_a[0], turn_a[1], turn_a[2])
    wb = length(turn_b[0], turn_b[1], turn_b[2])
    da, db, n, dn = work[0:3], work[3:6], work[6], work[7]
    values, slopes = work[8:10], work[10:12]
    _derivatives(a, turn_a, da)
    _derivatives(b, turn_b, db)
    both = wa + wb
    most, step = 0.0, 0.0
    for axis in range(AXES):
        _moving_axis(a, da, b, db, axis, n, dn)
        square = _dot(n, n)
        if square < SHORTEST_AXIS * SHORTEST_AXIS:
            continue
        along = _dot(n, d)
        gap = abs(along) - rounding
        for k in range(3):
            values[0, k] = h[k] * (n[0] * a[0, k] + n[1] * a[1, k] + n[2] * a[2, k])
            values[1, k] = f[k] * (n[0] * b[0, k] + n[1] * b[1, k] + n[2] * b[2, k])
            gap -= abs(values[0, k]) + abs(values[1, k])
        if gap <= 0.0:
            continue
        norm = math.sqrt(square)
        gap -= blur * norm
        if gap <= 0.0:
            continue
        most = max(most, gap / norm)
        for k in range(3):
            slopes[0, k] = h[k] * _product_slope(n, dn, a, da, k)
            slopes[1, k] = f[k] * _product_slope(n, dn, b, db, k)
        rate = _dot(dn, d) + _dot(n, velocity)
        rate = rate if along > 0.0 else -rate
        if axis < 3:
            bend = wa * (wa * far + 2.0 * speed) + both * both * reach_b
        elif axis < 6:
            bend = wb * (wb * far + 2.0 * speed) + both * both * reach_a
        else:
            bend = both * (both * (far + reach_a + reach_b) + 2.0 * speed)
            rate -= blur * both  # the axis grows no faster than its edges turn
        step = max(step, _first_root(gap, rate, bend, values, slopes, horizon))
        if step == np.inf:
            break
    return most, step


@njit
def _first_root(
    gap: float, rate: float, bend: float, values: Floats, slopes: Floats, horizon: float
) -> float:
    """Return a time before the lower bound of the gap first reaches zero; infinity if not at all.

    Each round takes the bound's parabola at the left end, which lies above it, for a new right
    end, and the chord for a new left end.
    """
    left, at_left = 0.0, gap
    right = horizon
    for _ in range(ROOT_ROUNDS):
        slope = rate - bend * left
        for m in range(2):
            for k in range(3):
                value = values[m, k] + slopes[m, k] * left
                grows = slopes[m, k] if value >= 0.0 else -slopes[m, k]
                slope -= grows if value != 0.0 else abs(grows)
        ahead = _parabola_root(at_left, slope, bend)
        right = min(right, left + ahead)
        at_right = _bound(gap, rate, bend, values, slopes, right)
        if at_right >= 0.0:
            return np.inf if right >= horizon else right
        left += (right - left) * (at_left / (at_left - at_right))
        at_left = _bound(gap, rate, bend, values, slopes, left)
        if at_left <= 0.0 or right - left <= NARROW * right:
            break
    return left


@njit
def _bound(
    gap: float, rate: float, bend: float, values: Floats, slopes: Floats, time: float
) -> float:
    """Return the lower bound of the gap at a time from now."""
    total = gap + (rate - 0.5 * bend * time) * time
    for m in range(2):
        for k in range(3):
            value = values[m, k]
            total -= abs(value + slopes[m, k] * time) - abs(value)
    return total


@njit
def _parabola_root(value: float, slope: float, bend: float) -> float:
    """Return the positive root of value + slope t - bend t^2 / 2; infinity if there is none."""
    root = math.sqrt(slope * slope + 2.0 * bend * value)
    if slope <= 0.0:
        return 2.0 * value / (root - slope) if root > slope else np.inf
    return (root + slope) / bend if bend > 0.0 else np.inf


@njit
def _moving_axis(
    a: Floats, da: Floats, b: Floats, db: Floats, axis: int, n: Floats, dn: Floats
) -> None:
    """Write the axis (3,), numbered as in ``separation``, and its derivative (3,)."""
    if axis < 3:
        for k in range(3):
            n[k] = a[k, axis]
            dn[k] = da[k, axis]
    elif axis < 6:
        for k in range(3):
            n[k] = b[k, axis - 3]
            dn[k] = db[k, axis - 3]
    else:
        i, j = (axis - 6) // 3, (axis - 6) % 3
        for k in range(3):
            p, q = (k + 1) % 3, (k + 2) % 3
            n[k] = a[p, i] * b[q, j] - a[q, i] * b[p, j]
            dn[k] = da[p, i] * b[q, j] - da[q, i] * b[p, j]
            dn[k] += a[p, i] * db[q, j] - a[q, i] * db[p, j]


@njit
def _derivatives(axes: Floats, turn: Floats, out: Floats) -> None:
    """Write the derivatives (3, 3) of the columns of ``axes``: turn x column."""
    for k in range(3):
        out[0, k] = turn[1] * axes[2, k] - turn[2] * axes[1, k]
        out[1, k] = turn[2] * axes[0, k] - turn[0] * axes[2, k]
        out[2, k] = turn[0] * axes[1, k] - turn[1] * axes[0, k]


@njit
def _product_slope(n: Floats, dn: Floats, axes: Floats, derivatives: Floats, k: int) -> float:
    """Return the derivative of n . column k."""
    total = 0.0
    for m in range(3):
        total += dn[m] * axes[m, k] + n[m] * derivatives[m, k]
    return total


@njit
def _dot(a: Floats, b: Floats) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
