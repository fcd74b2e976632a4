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

"""Careful certified triangle test with twice the digits, for what doubles leave open.

The corners are placed in the world relative to the first body, in double-double arithmetic, and
the orientations of ``triangle_signs`` are asked again; where one stays uncertain (coplanar
triangles, an edge that touches an edge, no area), separating axes are tried: any axis with a gap
above its error proves SEPARATE. What is left is TOUCHING: as near as 1e-26 of the size
of the pair, or in a common plane, or degenerate.

Error analysis: all is scaled by a power of two so that coordinates stay below 8. Rotating, adding
the offset and subtracting the first corner leave each component off by less than 2^-98; WIDTH
holds that and the rounding of all that follows (below 200 u^2 of coordinates below 8).
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.numerics.constants import PRODUCT_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.double_double import (
    Pair,
    Vector,
    add,
    as_pairs,
    cross,
    dot,
    largest,
    subtract,
    subtract_vectors,
)
from obb_collision.numerics.error_free import two_sum_error
from obb_collision.numerics.vec3 import max_abs, minus, scaled
from obb_collision.queries.meshes.tree_boxes import Place
from obb_collision.queries.meshes.triangle_signs import OVERLAP, SEPARATE, TOUCHING, Triangle
from obb_collision.queries.verdict.sat import rows_of
from obb_collision.typing import Axes
from obb_collision.typing import Vector as Triple

Six = tuple[Vector, Vector, Vector, Vector, Vector, Vector]

#: By how much a component of a difference may be off, coordinates being below 8.
WIDTH = 4096 * ROUNDOFF**2
#: Below this sine (squared) two edges don't span a plane worth asking.
THIN_SQUARE = 1e-20


@njit
def classify_by_axes(p: Triangle, a: Place, q: Triangle, b: Place) -> int:
    """Return SEPARATE or OVERLAP of two placed triangles where certain, else TOUCHING."""
    points = _placed(p, a, q, b)
    verdict = _by_signs(points)
    if verdict != TOUCHING:
        return verdict
    return SEPARATE if _separated(points) else TOUCHING


@njit
def _placed(p: Triangle, a: Place, q: Triangle, b: Place) -> Six:
    """Return the six corners relative to the first, in scaled double-doubles."""
    size = max_abs(minus(b.center, a.center))
    for k in range(3):
        size = max(size, max_abs(p[k]), max_abs(q[k]))
    scale = math.ldexp(1.0, -min(max(math.frexp(size)[1], -1000), 1000))
    zero = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    offset = _difference(scaled(b.center, scale), scaled(a.center, scale))
    p0 = _rotated(a.axes, scaled(p[0], scale), zero)
    return (
        zero,
        subtract_vectors(_rotated(a.axes, scaled(p[1], scale), zero), p0),
        subtract_vectors(_rotated(a.axes, scaled(p[2], scale), zero), p0),
        subtract_vectors(_rotated(b.axes, scaled(q[0], scale), offset), p0),
        subtract_vectors(_rotated(b.axes, scaled(q[1], scale), offset), p0),
        subtract_vectors(_rotated(b.axes, scaled(q[2], scale), offset), p0),
    )


@njit
def _difference(u: Triple, v: Triple) -> Vector:
    """Return u - v without error."""
    return (
        (u[0] - v[0], two_sum_error(u[0], -v[0])),
        (u[1] - v[1], two_sum_error(u[1], -v[1])),
        (u[2] - v[2], two_sum_error(u[2], -v[2])),
    )


@njit
def _rotated(axes: Axes, v: Triple, offset: Vector) -> Vector:
    """Return a vector along the axes, and the offset added."""
    x, y, z = rows_of(axes)
    exact = as_pairs(v)
    return (
        add(dot(as_pairs(x), exact), offset[0]),
        add(dot(as_pairs(y), exact), offset[1]),
        add(dot(as_pairs(z), exact), offset[2]),
    )


@njit
def _sign(o: Vector, a: Vector, b: Vector, c: Vector) -> int:
    """Return the sign of (a - o).((b - o) x (c - o)) where certain, else 0."""
    u, v, w = subtract_vectors(a, o), subtract_vectors(b, o), subtract_vectors(c, o)
    value = dot(u, cross(v, w))[0]
    x, y, z = largest(u), largest(v), largest(w)
    spread = x * y + y * z + z * x + WIDTH * (x + y + z + WIDTH)
    bound = 16.0 * WIDTH * spread + PRODUCT_UNDERFLOW
    return 1 if value > bound else (-1 if value < -bound else 0)


@njit
def _by_signs(points: Six) -> int:
    """Return the verdict of ``triangle_signs``, as piercing edges; TOUCHING where uncertain.

    Triangles in general position collide exactly if an edge of one pierces the other.
    """
    p = points
    q0, q1, q2 = _sign(p[0], p[1], p[2], p[3]), _sign(p[0], p[1], p[2], p[4]), 0
    q2 = _sign(p[0], p[1], p[2], p[5])
    p0, p1, p2 = _sign(p[3], p[4], p[5], p[0]), _sign(p[3], p[4], p[5], p[1]), 0
    p2 = _sign(p[3], p[4], p[5], p[2])
    if abs(q0 + q1 + q2) == 3 or abs(p0 + p1 + p2) == 3:
        return SEPARATE
    if q0 == 0 or q1 == 0 or q2 == 0 or p0 == 0 or p1 == 0 or p2 == 0:
        return TOUCHING
    certain = True
    for k in range(6):
        sides = (q0, q1, q2, p0, p1, p2)
        other = (q1, q2, q0, p1, p2, p0)
        if sides[k] == other[k]:
            continue
        hit = _pierces(points, k)
        if hit == OVERLAP:
            return OVERLAP
        certain = certain and hit == SEPARATE
    return SEPARATE if certain else TOUCHING


@njit
def _pierces(p: Six, k: int) -> int:
    """Return whether the line of edge k (0 to 2 of b, 3 to 5 of a) runs through the other."""
    if k < 3:
        a, b, c = p[0], p[1], p[2]
    else:
        a, b, c = p[3], p[4], p[5]
    start, end = p[(3, 4, 5, 0, 1, 2)[k]], p[(4, 5, 3, 1, 2, 0)[k]]
    x, y, z = _sign(start, end, a, b), _sign(start, end, b, c), _sign(start, end, c, a)
    if min(x, y, z) < 0 < max(x, y, z):
        return SEPARATE
    return OVERLAP if abs(x + y + z) == 3 else TOUCHING


@njit
def _gap(axis: Vector, p: Six) -> bool:
    """Return whether the axis certainly separates the two triangles."""
    a0, a1, a2 = dot(axis, p[0]), dot(axis, p[1]), dot(axis, p[2])
    b0, b1, b2 = dot(axis, p[3]), dot(axis, p[4]), dot(axis, p[5])
    forward = _least(b0, b1, b2)
    forward = subtract(forward, _most(a0, a1, a2))
    backward = subtract(_least(a0, a1, a2), _most(b0, b1, b2))
    bound = 16.0 * WIDTH * largest(axis) + PRODUCT_UNDERFLOW
    return max(forward[0], backward[0]) > bound


@njit
def _least(a: Pair, b: Pair, c: Pair) -> Pair:
    low = a if subtract(a, b)[0] <= 0.0 else b
    return low if subtract(low, c)[0] <= 0.0 else c


@njit
def _most(a: Pair, b: Pair, c: Pair) -> Pair:
    high = a if subtract(a, b)[0] >= 0.0 else b
    return high if subtract(high, c)[0] >= 0.0 else c


@njit
def _separated(p: Six) -> bool:
    """Return whether an axis certainly separates: faces, edge pairs, within planes and lines."""
    n = cross(p[1], p[2])
    m = cross(subtract_vectors(p[4], p[3]), subtract_vectors(p[5], p[3]))
    if _gap(n, p) or _gap(m, p):
        return True
    edges = (
        p[1], subtract_vectors(p[2], p[1]), p[2],
        subtract_vectors(p[4], p[3]), subtract_vectors(p[5], p[4]), subtract_vectors(p[3], p[5]),
    )  # fmt: skip
    for i in range(3):
        for j in range(3):
            if _gap(cross(edges[i], edges[3 + j]), p):
                return True
    for i in range(3):
        if _gap(cross(n, edges[i]), p) or _gap(cross(m, edges[3 + i]), p):
            return True
    if not (_is_thin(n, edges[0], edges[2]) or _is_thin(m, edges[3], edges[5])):
        return False
    for edge in edges:  # a segment or a point: along it, across it, and from corner to corner
        if _gap(edge, p) or _gap(cross(edge, cross(edge, p[3])), p):
            return True
    for i in range(3):
        for j in range(3):
            if _gap(subtract_vectors(p[3 + i], p[j]), p):
                return True
    return False


@njit
def _is_thin(n: Vector, u: Vector, v: Vector) -> bool:
    return dot(n, n)[0] <= THIN_SQUARE * dot(u, u)[0] * dot(v, v)[0]
