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

"""Fast certified triangle test in doubles: on which sides of each other's planes they lie.

Guigue, Devillers 2003, "Fast and robust triangle-triangle overlap test using orientation
predicates": two triangles that lie across each other's planes meet that common line in one
interval each, and two more orientations decide whether the intervals overlap. Every orientation
comes with a bound on its error; where a sign is not certain, the pair stays undecided. When all
are certain and none is zero, the triangles are apart, or pierce each other so that no small
move parts them.

Error analysis: let A, B, C bound the components of three difference vectors, each component off by
at most w. Their determinant of six products is then off by at most 6 ((A+w)(B+w)(C+w) - ABC),
and by 20 u ABC of rounding (5 operations a product, 6 products): below 64 u ABC. The rounding of
the differences themselves, u A and so on, is 18 u ABC: within the same bound.
"""

from __future__ import annotations

from obb_collision._jit import njit
from obb_collision.numerics.constants import PRODUCT_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.vec3 import cross, dot, max_abs, minus
from obb_collision.typing import Floats, Vector

SEPARATE, TOUCHING, OVERLAP, UNDECIDED = 0, 1, 2, -1

#: The corners of a triangle.
Triangle = tuple[Vector, Vector, Vector]

#: Rounding of a determinant relative to ABC: 64 unit roundoffs (derivation above).
DETERMINANT_ROUNDING = 64 * ROUNDOFF


@njit
def classify_by_signs(p: Triangle, q: Triangle, error: float) -> int:
    """Return SEPARATE or OVERLAP of two triangles where certain, else UNDECIDED.

    error: by how much a component of a corner of q may be off.
    """
    (p0, p1, p2), (q0, q1, q2) = p, q
    w = 2.0 * error
    side, alone_q, positive_q = _sides(p, q, w)
    if side == SEPARATE:
        return SEPARATE
    other_side, alone_p, positive_p = _sides(q, p, w)
    if other_side == SEPARATE:
        return SEPARATE
    if side == UNDECIDED or other_side == UNDECIDED:
        return UNDECIDED
    p0, p1, p2 = _turned(p, alone_p)
    q0, q1, q2 = _turned(q, alone_q)
    if not positive_p:  # p0 to the positive side of the plane of q
        q1, q2 = q2, q1
    if not positive_q:
        p1, p2 = p2, p1
    first = sign(minus(q1, p1), minus(q0, p1), minus(p0, p1), w)
    if first > 0:
        return SEPARATE
    second = sign(minus(q2, p0), minus(q0, p0), minus(p2, p0), w)
    if second > 0:
        return SEPARATE
    return OVERLAP if first < 0 and second < 0 else UNDECIDED


@njit
def corner(triangles: Floats, n: int, k: int) -> Vector:
    """Return the corner at column k of row n of (m, 9)."""
    return triangles[n, k], triangles[n, k + 1], triangles[n, k + 2]


@njit
def triangle_at(triangles: Floats, n: int) -> Triangle:
    """Return row n of (m, 9)."""
    return corner(triangles, n, 0), corner(triangles, n, 3), corner(triangles, n, 6)


@njit
def determinant_bound(a: float, b: float, c: float, w: float) -> float:
    """Return the error of a determinant of vectors up to a, b, c, each component off by w."""
    products = a * b + b * c + c * a
    spread = w * products + w * w * (a + b + c) + w * w * w
    return (
        6.0 * spread * (1.0 + DETERMINANT_ROUNDING)
        + DETERMINANT_ROUNDING * (a * b * c)
        + PRODUCT_UNDERFLOW
    )


@njit
def sign(a: Vector, b: Vector, c: Vector, w: float) -> int:
    """Return the sign of a.(b x c) where certain, components off by w each; else 0."""
    value = dot(a, cross(b, c))
    bound = determinant_bound(max_abs(a), max_abs(b), max_abs(c), w)
    return 1 if value > bound else (-1 if value < -bound else 0)


@njit
def _sides(p: Triangle, q: Triangle, w: float) -> tuple[int, int, bool]:
    """Return on which side of the plane of p the corners of q are.

    SEPARATE if all on one; UNDECIDED; or OVERLAP with the number of the one that is alone on its
    side, and whether that is the positive side.
    """
    (p0, p1, p2), (q0, q1, q2) = p, q
    u, v = minus(p1, p0), minus(p2, p0)
    n = cross(u, v)
    r0, r1, r2 = minus(q0, p0), minus(q1, p0), minus(q2, p0)
    d0 = dot(n, r0)
    d1 = dot(n, r1)
    d2 = dot(n, r2)
    reach = max(max_abs(r0), max_abs(r1), max_abs(r2))
    bound = determinant_bound(max_abs(u), max_abs(v), reach, w)
    if min(d0, d1, d2) > bound or max(d0, d1, d2) < -bound:
        return SEPARATE, 0, False
    if not min(abs(d0), abs(d1), abs(d2)) > bound:  # also for what is not a number
        return UNDECIDED, 0, False
    s0, s1, s2 = d0 > 0.0, d1 > 0.0, d2 > 0.0
    if s1 == s2:
        return OVERLAP, 0, s0
    if s0 == s2:
        return OVERLAP, 1, s1
    return OVERLAP, 2, s2


@njit
def _turned(triangle: Triangle, first: int) -> Triangle:
    """Return the corners in the same cyclic order, beginning with the given one."""
    a, b, c = triangle
    if first == 0:
        return a, b, c
    return (b, c, a) if first == 1 else (c, a, b)
