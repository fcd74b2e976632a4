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
nearly parallel edges, triangles that nearly touch), ``careful_gap`` tries every direction that can
be the one between the closest features, with twice the digits, and ``closest_points`` all features.

Corners are scaled so that the largest is about one; a projection on a unit direction is then off by
less than 8 unit roundoffs.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics import error_free as dd
from obb_collision.numerics.simplex import NO_CORNER, no_simplex, with_corner
from obb_collision.numerics.vec3 import careful_cross, dot, max_abs, minus, plus, scaled
from obb_collision.queries.meshes.triangles import Triangle
from obb_collision.queries.primitives.segments import nearest_of_segments
from obb_collision.typing import Vector

#: The search ends when both bounds agree to this, 7e-15 of coordinates about one,
AGREED = 2.0**-47
#: or after this many steps: most pairs take four.
STEPS = 24
#: Two points of triangles, and the square of their distance.
Points = tuple[float, Vector, Vector]


@njit
def triangle_bounds(
    p: Triangle, q: Triangle, n: Vector, enough: float
) -> tuple[float, float, Vector]:
    """Return a lower and an upper bound of the distance, and the unit direction of the lower.

    n: a direction from q to p to begin with. The search ends once the lower bound is ``enough``;
    then the upper one may be infinite, and where rounding puts the origin in the simplex or on it:
    flat ones seem to hold it while triangles are apart.
    """
    lower, upper, best = 0.0, np.inf, n
    simplex = no_simplex(NO_CORNER)
    for _ in range(STEPS):
        square = dot(n, n)
        if not square > 0.0:
            break
        n = scaled(n, 1.0 / math.sqrt(square))
        first, low = _lowest(p, n)
        second, high = _highest(q, n)
        gap = low - high
        if gap > lower:
            lower, best = gap, n
        if lower >= enough or upper - lower <= AGREED:
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
def gap_along(p: Triangle, q: Triangle, n: Vector) -> tuple[float, Vector]:
    """Return the gap of triangles along a direction or its reverse, and the unit from q to p."""
    largest = max_abs(n)
    if not largest > 0.0:
        return -np.inf, n
    n = scaled(n, 1.0 / largest)
    n = scaled(n, 1.0 / math.sqrt(dot(n, n)))
    forward = _lowest(p, n)[1] - _highest(q, n)[1]
    backward = _lowest(q, n)[1] - _highest(p, n)[1]
    return (forward, n) if forward >= backward else (backward, scaled(n, -1.0))


@njit
def careful_gap(p: Triangle, q: Triangle) -> tuple[float, Vector]:
    """Return the largest gap over all directions between closest features, and its direction.

    Normals of the faces, normals common to two edges, from a corner straight to an edge, and from
    corner to corner. Products are taken with twice the digits, so that a direction is right to a
    roundoff however close the features are.
    """
    best = (-np.inf, (1.0, 0.0, 0.0))
    for _ in range(3):
        for _ in range(3):
            u, v, w = _difference(p[1], p[0]), _difference(q[1], q[0]), _difference(q[0], p[0])
            best = _wider(best, p, q, dd.cross(u, v))
            best = _wider(best, p, q, dd.cross(dd.cross(u, w), u))
            best = _wider(best, p, q, dd.cross(dd.cross(v, w), v))
            best = _wider(best, p, q, dd.cross(u, _difference(p[2], p[0])))
            best = _wider(best, p, q, dd.cross(v, _difference(q[2], q[0])))
            best = _wider(best, p, q, w)
            q = q[1], q[2], q[0]
        p = p[1], p[2], p[0]
    return best


@njit
def _difference(u: Vector, v: Vector) -> dd.Vector:
    return dd.subtract_vectors(dd.as_pairs(u), dd.as_pairs(v))


@njit
def _wider(
    best: tuple[float, Vector], p: Triangle, q: Triangle, n: dd.Vector
) -> tuple[float, Vector]:
    gap, unit = gap_along(p, q, (n[0][0], n[1][0], n[2][0]))
    return (gap, unit) if gap > best[0] else best


@njit
def closest_points(p: Triangle, q: Triangle) -> Points:
    """Return the squared distance and the closest points of two triangles, or a common point.

    Of all features: edges with edges, corners and where an edge runs through the plane of the
    other triangle with its face.
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
def _nearer(best: Points, x: Vector, y: Vector) -> Points:
    d = minus(y, x)
    square = dot(d, d)
    return (square, x, y) if square < best[0] else best


@njit
def crossing(start: Vector, end: Vector, t: Triangle) -> Vector:
    """Return where an edge runs through the plane of a triangle, its start if it does not."""
    n = careful_cross(minus(t[1], t[0]), minus(t[2], t[0]))
    x, y = dot(n, minus(start, t[0])), dot(n, minus(end, t[0]))
    if not x * y < 0.0:
        return start
    return plus(start, scaled(minus(end, start), x / (x - y)))


@njit
def foot(y: Vector, t: Triangle) -> Vector:
    """Return the foot of a point on the plane of a triangle; a corner if it is not in the face."""
    u, v, w = minus(t[1], t[0]), minus(t[2], t[0]), minus(y, t[0])
    n = careful_cross(u, v)
    square = dot(n, n)
    if not square > 0.0:
        return t[0]
    r = s = 0.0
    rest = w
    for _ in range(2):  # what the first leaves in the plane, as rounding in a sliver, goes as well
        r += dot(careful_cross(rest, v), n) / square
        s += dot(careful_cross(u, rest), n) / square
        rest = minus(minus(w, scaled(u, r)), scaled(v, s))
    if r < 0.0 or s < 0.0 or r + s > 1.0:
        return t[0]
    return plus(plus(t[0], scaled(u, r)), scaled(v, s))
