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

"""Distance of two triangles: bounds of it, and the closest points.

Two kinds of evidence, neither of which depends on how it was found: along any direction the gap of
the projections is at most the distance, and the distance of any two points is at least that.

The search is that of Gilbert, Johnson and Keerthi 1988 on the differences of the corners, which
meets the distance from both sides in some four steps. Where rounding leaves it open (slivers,
nearly parallel edges, triangles that nearly touch), ``careful_triangle_gap`` tries, with twice the
digits, every direction between two features, and ``closest_points`` tries all features.

Corners are scaled so that the largest is about one; a projection on a unit direction is then off by
less than 8 unit roundoffs.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.exact import WideVector, wide_cross, wide_difference
from obb_collision.numerics.simplex import BARE_CORNER, no_simplex, with_corner
from obb_collision.numerics.vec3 import careful_cross, dot, max_abs, minus, plus, scaled
from obb_collision.queries.meshes.triangles import Triangle
from obb_collision.queries.primitives.segments import nearest_of_segments
from obb_collision.typing import Vector

#: The search ends when both bounds agree to this, 7e-15 of coordinates near 1,
BOUNDS_AGREE = 2.0**-47
#: or after this many steps: most pairs take four.
MOST_STEPS = 24
#: Two points of triangles, and the square of their distance.
TrianglePoints = tuple[float, Vector, Vector]


@njit
def triangle_bounds(
    p: Triangle, q: Triangle, n: Vector, enough: float
) -> tuple[float, float, Vector]:
    """Return a lower and an upper bound of the distance, and the unit direction of the lower.

    n: the direction to begin with, from q to p. The upper bound may be infinite if the lower one
    reached ``enough``, or if rounding puts the origin in a flat simplex.
    """
    lower, upper, best = 0.0, np.inf, n
    simplex = no_simplex(BARE_CORNER)
    for _ in range(MOST_STEPS):
        square = dot(n, n)
        if not square > 0.0:
            break
        n = scaled(n, 1.0 / math.sqrt(square))
        first, low = _lowest(p, n)
        second, high = _highest(q, n)
        gap = low - high
        if gap > lower:
            lower, best = gap, n
        if lower >= enough or upper - lower <= BOUNDS_AGREE:
            break
        simplex = with_corner(simplex, (minus(first, second),))
        n = simplex.nearest
        reached = math.sqrt(dot(n, n))
        if simplex.size == 4 or not 0.0 < reached < upper:
            break
        upper = reached
    return lower, upper, best


@njit
def _lowest(t: Triangle, n: Vector) -> tuple[Vector, float]:
    x, y, z = dot(n, t[0]), dot(n, t[1]), dot(n, t[2])
    if x <= y:
        return (t[0], x) if x <= z else (t[2], z)
    return (t[1], y) if y <= z else (t[2], z)


@njit
def _highest(t: Triangle, n: Vector) -> tuple[Vector, float]:
    x, y, z = dot(n, t[0]), dot(n, t[1]), dot(n, t[2])
    if x >= y:
        return (t[0], x) if x >= z else (t[2], z)
    return (t[1], y) if y >= z else (t[2], z)


@njit
def triangle_gap(p: Triangle, q: Triangle, n: Vector) -> tuple[float, Vector]:
    """Return the larger gap of triangles along n and -n, and that direction, unit, from q to p."""
    largest = max_abs(n)
    if not largest > 0.0:
        return -np.inf, n
    n = scaled(n, 1.0 / largest)
    n = scaled(n, 1.0 / math.sqrt(dot(n, n)))
    forward = _lowest(p, n)[1] - _highest(q, n)[1]
    backward = _lowest(q, n)[1] - _highest(p, n)[1]
    return (forward, n) if forward >= backward else (backward, scaled(n, -1.0))


@njit
def careful_triangle_gap(p: Triangle, q: Triangle) -> tuple[float, Vector]:
    """Return the largest gap over all directions between two features, and its direction.

    Normals of the faces, normals common to two edges, from a corner straight to an edge, and from
    corner to corner. Products are taken with twice the digits, so that a direction is right to a
    roundoff however close the features are.
    """
    best = (-np.inf, (1.0, 0.0, 0.0))
    for _ in range(3):
        for _ in range(3):
            u, v, w = (
                wide_difference(p[1], p[0]),
                wide_difference(q[1], q[0]),
                wide_difference(q[0], p[0]),
            )
            best = _wider(best, p, q, wide_cross(u, v))
            best = _wider(best, p, q, wide_cross(wide_cross(u, w), u))
            best = _wider(best, p, q, wide_cross(wide_cross(v, w), v))
            best = _wider(best, p, q, wide_cross(u, wide_difference(p[2], p[0])))
            best = _wider(best, p, q, wide_cross(v, wide_difference(q[2], q[0])))
            best = _wider(best, p, q, w)
            q = q[1], q[2], q[0]
        p = p[1], p[2], p[0]
    return best


@njit
def _wider(
    best: tuple[float, Vector], p: Triangle, q: Triangle, n: WideVector
) -> tuple[float, Vector]:
    gap, unit = triangle_gap(p, q, (n[0][0], n[1][0], n[2][0]))
    return (gap, unit) if gap > best[0] else best


@njit
def closest_points(p: Triangle, q: Triangle) -> TrianglePoints:
    """Return the squared distance and the closest points of two triangles, or a common point.

    Tries edges with edges, and the face of each with corners and crossing edges of the other.
    """
    best = (np.inf, p[0], q[0])
    for _ in range(3):
        for _ in range(3):
            u, v, d = minus(p[1], p[0]), minus(q[1], q[0]), minus(q[0], p[0])
            s, t = nearest_of_segments(u, d, v)
            best = _nearer(best, plus(p[0], scaled(u, s)), plus(q[0], scaled(v, t)))
            q = q[1], q[2], q[0]
        p = p[1], p[2], p[0]
    for _ in range(3):
        for y in (q[0], crossing(q[0], q[1], p)):
            best = _nearer(best, foot(y, p), y)
        for x in (p[0], crossing(p[0], p[1], q)):
            best = _nearer(best, x, foot(x, q))
        p, q = (p[1], p[2], p[0]), (q[1], q[2], q[0])
    return best


@njit
def _nearer(best: TrianglePoints, x: Vector, y: Vector) -> TrianglePoints:
    d = minus(y, x)
    square = dot(d, d)
    return (square, x, y) if square < best[0] else best


@njit
def crossing(start: Vector, end: Vector, t: Triangle) -> Vector:
    """Return where an edge crosses the plane of a triangle, or its start if it does not."""
    n = careful_cross(minus(t[1], t[0]), minus(t[2], t[0]))
    x, y = dot(n, minus(start, t[0])), dot(n, minus(end, t[0]))
    if not x * y < 0.0:
        return start
    return plus(start, scaled(minus(end, start), x / (x - y)))


@njit
def foot(y: Vector, t: Triangle) -> Vector:
    """Return the foot of a point on the face of a triangle, or a corner if it is beside it."""
    u, v, w = minus(t[1], t[0]), minus(t[2], t[0]), minus(y, t[0])
    n = careful_cross(u, v)
    square = dot(n, n)
    if not square > 0.0:
        return t[0]
    r = s = 0.0
    rest = w
    for _ in range(2):  # the second round removes rounding in slivers
        r += dot(careful_cross(rest, v), n) / square
        s += dot(careful_cross(u, rest), n) / square
        rest = minus(minus(w, scaled(u, r)), scaled(v, s))
    if r < 0.0 or s < 0.0 or r + s > 1.0:
        return t[0]
    return plus(plus(t[0], scaled(u, r)), scaled(v, s))
