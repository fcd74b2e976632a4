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

"""Segments against boxes and segments: the scalar geometry of capsules and spheres.

Vectors are tuples of three numbers. All lengths are scaled by a power of two (``unit_scale``), so
that the largest is about 1 and squares neither overflow nor vanish.

Two kinds of evidence, neither of which depends on how well the nearest points were found:
two points, one of each body, prove that the distance is at most theirs; a direction along which
the projections are apart proves that it is at least their gap.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import (
    ZERO,
    careful_cross,
    clamp,
    dot,
    minus,
    pick_axis,
    plus,
    scaled,
)
from obb_collision.typing import Axes, Vector

#: Exponents of scales: 2^1000 and its reciprocal are still ordinary doubles.
LARGEST_EXPONENT = 1000


@njit
def unit_scale(size: float) -> tuple[float, float]:
    """Return a power of two that scales ``size`` to 0.5 .. 1, and its reciprocal."""
    _, exponent = math.frexp(size)
    exponent = min(max(exponent, -LARGEST_EXPONENT), LARGEST_EXPONENT)
    return math.ldexp(1.0, -exponent), math.ldexp(1.0, exponent)


@njit
def _slope(s: float, y: Vector, v: Vector, h: Vector, on_face: int) -> float:
    """Return half the slope at s of the squared distance of y + s v from the box.

    on_face: the axis of the face that contains the point; rounding along it must not matter.
    """
    total = 0.0
    for i in range(3):
        if i != on_face:
            x = y[i] + s * v[i]
            total += (x - clamp(x, h[i])) * v[i]
    return total


@njit
def nearest_to_box(y: Vector, v: Vector, h: Vector) -> float:
    """Return s in 0 .. 1 where y + s v is nearest to the box -h .. h; of many the middle.

    The squared distance is convex and quadratic between the crossings of the six face planes, so
    its slope grows and is linear there.
    """
    low, high = 0.0, 1.0
    slope_low, slope_high = _slope(low, y, v, h, -1), _slope(high, y, v, h, -1)
    if slope_low > 0.0:
        return low
    if slope_high < 0.0:
        return high
    first, last = np.inf, -np.inf  # where the slope is zero: from first to last
    if slope_low == 0.0:
        first = last = low
    if slope_high == 0.0:
        first, last = min(first, high), high
    for i in range(3):
        if v[i] == 0.0:
            continue
        for side in (-1.0, 1.0):
            s = (side * h[i] - y[i]) / v[i]
            if not low < s < high:
                continue
            slope = _slope(s, y, v, h, i)
            if slope < 0.0:
                low, slope_low = s, slope
            elif slope > 0.0:
                high, slope_high = s, slope
            else:
                first, last = min(first, s), max(last, s)
    if first <= last:
        return 0.5 * (first + last)
    return min(max(low - slope_low * ((high - low) / (slope_high - slope_low)), low), high)


@njit
def segment_box_gap(
    n: Vector, d0: Vector, d1: Vector, axes: Axes, h: Vector
) -> tuple[float, float]:
    """Return the gap of segment d0 d1 and a box (centre at 0) along the unit of n, and a side.

    Side +1: the segment lies beyond the box along n, -1: before it. A null direction has the gap
    -inf.
    """
    norm = math.sqrt(dot(n, n))
    if norm == 0.0:
        return -np.inf, 1.0
    reach = 0.0
    for i in range(3):
        reach += h[i] * abs(dot(n, pick_axis(axes, i)))
    x0, x1 = dot(n, d0), dot(n, d1)
    beyond, before = min(x0, x1), -max(x0, x1)
    if beyond >= before:
        return (beyond - reach) / norm, 1.0
    return (before - reach) / norm, -1.0


@njit
def across(n: Vector, v: Vector) -> Vector:
    """Return the part of n that is orthogonal to v."""
    square = dot(v, v)
    return minus(n, scaled(v, dot(n, v) / square)) if square > 0.0 else n


@njit
def widest_gap(d0: Vector, d1: Vector, v: Vector, axes: Axes, h: Vector) -> tuple[float, Vector]:
    """Return the largest gap of segment and box over faces and edges, and its unit direction.

    If negative, it is minus the least depth: these six directions (three face normals, three edges
    crossed with the segment) are all that a segment against a box needs (Ericson 2005, 5.2.1). The
    direction is from the segment to the box.
    """
    best = -np.inf
    towards = ZERO
    for k in range(6):
        i = k % 3
        n = pick_axis(axes, i)
        if k >= 3:
            n = careful_cross(n, v)
        gap, side = segment_box_gap(n, d0, d1, axes, h)
        if gap > best:
            best = gap
            towards = plus(ZERO, scaled(n, -side / math.sqrt(dot(n, n))))
    return best, towards


@njit
def _clamped_ratio(a: float, b: float) -> float:
    """Return a / b in 0 .. 1, and 0.5 for b = 0: a segment without length."""
    return min(max(a / b, 0.0), 1.0) if b > 0.0 else 0.5


@njit
def nearest_of_segments(u: Vector, d: Vector, v: Vector) -> tuple[float, float]:
    """Return s and t in 0 .. 1 where s u and d + t v are nearest.

    The nearest of: the four ends with their feet on the other segment, and the feet of the common
    normal. Nearly exact cross products serve nearly parallel segments too.
    """
    uu, vv = dot(u, u), dot(v, v)
    ud, vd, uv = dot(u, d), dot(v, d), dot(u, v)
    best, best_s, best_t = np.inf, 0.0, 0.0
    n = careful_cross(u, v)
    nn = dot(n, n)
    for k in range(5):
        if k == 0:
            s, t = 0.0, _clamped_ratio(-vd, vv)
        elif k == 1:
            s, t = 1.0, _clamped_ratio(uv - vd, vv)
        elif k == 2:
            s, t = _clamped_ratio(ud, uu), 0.0
        elif k == 3:
            s, t = _clamped_ratio(ud + uv, uu), 1.0
        elif nn > 0.0:
            s = _clamped_ratio(dot(careful_cross(d, v), n), nn)
            t = _clamped_ratio(dot(careful_cross(d, u), n), nn)
        else:
            break
        gap = plus(plus(d, scaled(v, t)), scaled(u, -s))
        square = dot(gap, gap)
        if square < best:
            best, best_s, best_t = square, s, t
    return best_s, best_t


@njit
def segment_gap(n: Vector, u: Vector, d: Vector, v: Vector) -> tuple[float, float]:
    """Return the gap along the unit of n of segments 0 to u and d to d + v, and a side.

    Side +1: the second lies beyond the first along n, -1: before it. A null direction has the gap
    -inf.
    """
    norm = math.sqrt(dot(n, n))
    if norm == 0.0:
        return -np.inf, 1.0
    x, du, dv = dot(n, d), dot(n, u), dot(n, v)
    beyond = x + min(dv, 0.0) - max(du, 0.0)
    before = -x - max(dv, 0.0) + min(du, 0.0)
    return (beyond / norm, 1.0) if beyond >= before else (before / norm, -1.0)
