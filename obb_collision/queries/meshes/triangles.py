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

"""Certified test of two triangles: in doubles, with twice the digits, and in integers.

Closed triangles in space, verdicts as for boxes: SEPARATE, no common point; OVERLAP, no small
move parts them: one pierces the other; TOUCHING, undecided. Triangles in one plane
that share points are TOUCHING, like flat boxes: an arbitrarily small move along the normal parts
them. A triangle may be a segment or a point.

Fast, in doubles: on which sides of each other's planes they lie.

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

``classify_by_axes`` takes twice the digits for pairs that doubles leave open.

The corners are placed in the world relative to the first body, in double-double arithmetic, and
the orientations are asked again; where one stays uncertain (coplanar
triangles, an edge that touches an edge, no area), separating axes are tried: any axis with a gap
above its error proves SEPARATE. What is left is TOUCHING: as near as 1e-26 of the size
of the pair, or in a common plane, or degenerate.

Error analysis: all is scaled by a power of two so that coordinates stay below 8. Rotating, adding
the offset and subtracting the first corner leave each component off by less than 2^-98; WIDTH
holds that and the rounding of all that follows (below 200 u^2 of coordinates below 8).

Triangle against triangle in exact integers, for the pairs that certified kernels leave open.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from obb_collision._jit import njit
from obb_collision.numerics.constants import PRODUCT_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.exact import (
    Exact,
    Wide,
    WideVector,
    add,
    as_wide,
    exact_axes,
    exact_cross,
    exact_dot,
    exact_integers,
    largest,
    subtract,
    subtract_vectors,
    wide_cross,
    wide_difference,
    wide_dot,
)
from obb_collision.numerics.vec3 import cross, dot, max_abs, minus, scaled
from obb_collision.queries.meshes.placed import Place
from obb_collision.queries.verdict.sat import rows_of
from obb_collision.queries.verdict.verdict import OVERLAP, SEPARATE, TOUCHING, UNDECIDED
from obb_collision.typing import Axes, Floats, Vector

#: The corners of a triangle.
Triangle = tuple[Vector, Vector, Vector]

#: Rounding of a determinant relative to ABC: 64 unit roundoffs (derivation above).
DETERMINANT_ROUNDING = 64 * ROUNDOFF


@njit
def classify_by_signs(p: Triangle, q: Triangle, error: float) -> int:
    """Return SEPARATE or OVERLAP of two triangles where certain, else UNDECIDED.

    error: of each component of a corner of q.
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
    """Return the error bound of a determinant of vectors up to a, b, c; components off by w."""
    products = a * b + b * c + c * a
    spread = w * products + w * w * (a + b + c) + w * w * w
    return (
        6.0 * spread * (1.0 + DETERMINANT_ROUNDING)
        + DETERMINANT_ROUNDING * (a * b * c)
        + PRODUCT_UNDERFLOW
    )


@njit
def sign(a: Vector, b: Vector, c: Vector, w: float) -> int:
    """Return the sign of a.(b x c) where certain, else 0; components are off by at most w."""
    value = dot(a, cross(b, c))
    bound = determinant_bound(max_abs(a), max_abs(b), max_abs(c), w)
    return 1 if value > bound else (-1 if value < -bound else 0)


@njit
def _sides(p: Triangle, q: Triangle, w: float) -> tuple[int, int, bool]:
    """Return on which side of the plane of p the corners of q are.

    SEPARATE: all on one side; UNDECIDED; OVERLAP: then the number of the corner that is alone on
    its side, and whether that is the positive side.
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
    if not min(abs(d0), abs(d1), abs(d2)) > bound:  # also for NaN
        return UNDECIDED, 0, False
    s0, s1, s2 = d0 > 0.0, d1 > 0.0, d2 > 0.0
    if s1 == s2:
        return OVERLAP, 0, s0
    if s0 == s2:
        return OVERLAP, 1, s1
    return OVERLAP, 2, s2


@njit
def _turned(triangle: Triangle, first: int) -> Triangle:
    """Return the corners in the same cyclic order, beginning with number ``first``."""
    a, b, c = triangle
    if first == 0:
        return a, b, c
    return (b, c, a) if first == 1 else (c, a, b)


SixCorners = tuple[WideVector, WideVector, WideVector, WideVector, WideVector, WideVector]

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
def _placed(p: Triangle, a: Place, q: Triangle, b: Place) -> SixCorners:
    """Return the six corners relative to the first, in scaled double-doubles."""
    size = max_abs(minus(b.center, a.center))
    for k in range(3):
        size = max(size, max_abs(p[k]), max_abs(q[k]))
    scale = math.ldexp(1.0, -min(max(math.frexp(size)[1], -1000), 1000))
    zero = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    offset = wide_difference(scaled(b.center, scale), scaled(a.center, scale))
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
def _rotated(axes: Axes, v: Vector, offset: WideVector) -> WideVector:
    """Return a vector along the axes, plus the offset."""
    x, y, z = rows_of(axes)
    exact = as_wide(v)
    return (
        add(wide_dot(as_wide(x), exact), offset[0]),
        add(wide_dot(as_wide(y), exact), offset[1]),
        add(wide_dot(as_wide(z), exact), offset[2]),
    )


@njit
def _sign(o: WideVector, a: WideVector, b: WideVector, c: WideVector) -> int:
    """Return the sign of (a - o).((b - o) x (c - o)) where certain, else 0."""
    u, v, w = subtract_vectors(a, o), subtract_vectors(b, o), subtract_vectors(c, o)
    value = wide_dot(u, wide_cross(v, w))[0]
    x, y, z = largest(u), largest(v), largest(w)
    spread = x * y + y * z + z * x + WIDTH * (x + y + z + WIDTH)
    bound = 16.0 * WIDTH * spread + PRODUCT_UNDERFLOW
    return 1 if value > bound else (-1 if value < -bound else 0)


@njit
def _by_signs(points: SixCorners) -> int:
    """Return the verdict by edges that pierce the other triangle; TOUCHING where uncertain.

    Triangles in general position collide exactly if an edge of one pierces the other.
    """
    p = points
    q0, q1 = _sign(p[0], p[1], p[2], p[3]), _sign(p[0], p[1], p[2], p[4])
    p0, p1 = _sign(p[3], p[4], p[5], p[0]), _sign(p[3], p[4], p[5], p[1])
    q2, p2 = _sign(p[0], p[1], p[2], p[5]), _sign(p[3], p[4], p[5], p[2])
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
def _pierces(p: SixCorners, k: int) -> int:
    """Return whether edge k (0 to 2 of b, 3 to 5 of a) pierces the other triangle, as a verdict."""
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
def _separates(axis: WideVector, p: SixCorners) -> bool:
    """Return whether the axis certainly separates the two triangles."""
    a0, a1, a2 = wide_dot(axis, p[0]), wide_dot(axis, p[1]), wide_dot(axis, p[2])
    b0, b1, b2 = wide_dot(axis, p[3]), wide_dot(axis, p[4]), wide_dot(axis, p[5])
    forward = subtract(_least(b0, b1, b2), _most(a0, a1, a2))
    backward = subtract(_least(a0, a1, a2), _most(b0, b1, b2))
    bound = 16.0 * WIDTH * largest(axis) + PRODUCT_UNDERFLOW
    return max(forward[0], backward[0]) > bound


@njit
def _least(a: Wide, b: Wide, c: Wide) -> Wide:
    low = a if subtract(a, b)[0] <= 0.0 else b
    return low if subtract(low, c)[0] <= 0.0 else c


@njit
def _most(a: Wide, b: Wide, c: Wide) -> Wide:
    high = a if subtract(a, b)[0] >= 0.0 else b
    return high if subtract(high, c)[0] >= 0.0 else c


@njit
def _separated(p: SixCorners) -> bool:
    """Return whether an axis certainly separates: faces, edge pairs, within planes and lines."""
    n = wide_cross(p[1], p[2])
    m = wide_cross(subtract_vectors(p[4], p[3]), subtract_vectors(p[5], p[3]))
    if _separates(n, p) or _separates(m, p):
        return True
    edges = (
        p[1],
        subtract_vectors(p[2], p[1]),
        p[2],
        subtract_vectors(p[4], p[3]),
        subtract_vectors(p[5], p[4]),
        subtract_vectors(p[3], p[5]),
    )
    for i in range(3):
        for j in range(3):
            if _separates(wide_cross(edges[i], edges[3 + j]), p):
                return True
    for i in range(3):
        if _separates(wide_cross(n, edges[i]), p) or _separates(wide_cross(m, edges[3 + i]), p):
            return True
    if not (_is_thin(n, edges[0], edges[2]) or _is_thin(m, edges[3], edges[5])):
        return False
    for edge in edges:  # a segment or a point: along it, across it, and from corner to corner
        if _separates(edge, p) or _separates(wide_cross(edge, wide_cross(edge, p[3])), p):
            return True
    for i in range(3):
        for j in range(3):
            if _separates(subtract_vectors(p[3 + i], p[j]), p):
                return True
    return False


@njit
def _is_thin(n: WideVector, u: WideVector, v: WideVector) -> bool:
    return wide_dot(n, n)[0] <= THIN_SQUARE * wide_dot(u, u)[0] * wide_dot(v, v)[0]


CenterAndRotation = tuple[Floats, Floats]
UNIT = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def exact_triangle_verdict(
    a: Floats, placement_a: CenterAndRotation, b: Floats, placement_b: CenterAndRotation
) -> int:
    """Return 0 separate, 1 touching or 2 overlap of two closed triangles, decided exactly.

    a, b: corners (9,) in their own frames; placements: centre (3,), rotation (3, 3).
    """
    corners = exact_corners((a, b), (placement_a, placement_b))
    first, second = corners[:3], corners[3:]
    touching = False
    for axis in _candidate_axes(first, second):
        p, q = [exact_dot(axis, v) for v in first], [exact_dot(axis, v) for v in second]
        gap = max(min(q) - max(p), min(p) - max(q))
        if gap > 0:
            return 0
        touching = touching or gap == 0
    return 1 if touching else 2


def exact_corners(rows: Sequence[Floats], placements: Sequence[CenterAndRotation]) -> list[Exact]:
    """Return all points of rows (3 k,), each placed, as integers in a common unit."""
    axes = [exact_axes(rotation) for _, rotation in placements]
    power = max(k for _, k in axes)
    lengths = [row.tolist() for row in rows] + [center.tolist() for center, _ in placements]
    numbers, _ = exact_integers([x for row in lengths for x in row])
    offsets = numbers[-3 * len(placements) :]
    result = []
    start = 0
    for n, row in enumerate(rows):
        columns, own = axes[n]
        for k in range(start, start + len(row), 3):
            x, y, z = (
                (sum(columns[i][c] * numbers[k + i] for i in range(3)) << (power - own))
                + (offsets[3 * n + c] << power)
                for c in range(3)
            )
            result.append((x, y, z))
        start += len(row)
    return result


def _minus(a: Exact, b: Exact) -> Exact:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _candidate_axes(p: list[Exact], q: list[Exact]) -> Iterator[Exact]:
    """Yield axes that are not null; if any axis separates, one of them does.

    The Minkowski difference is the hull of nine points, its faces are normal to products of two
    edges. If it is flat (coplanar triangles), a plane normal to it and an edge bounds it within its
    plane; if it is a segment or a point, axes along and across it do.
    """
    edges = [_minus(t[(i + 1) % 3], t[i]) for t in (p, q) for i in range(3)]
    edges = [edge for edge in edges if any(edge)]
    normals = [exact_cross(u, v) for i, u in enumerate(edges) for v in edges[i + 1 :]]
    normals = [normal for normal in normals if any(normal)]
    yield from normals
    if any(exact_dot(normals[0], edge) for edge in edges) if normals else False:
        return  # the difference is not flat
    if normals:
        yield from (exact_cross(normals[0], edge) for edge in edges)
    elif edges:
        yield edges[0]
        yield from (axis for axis in (exact_cross(edges[0], unit) for unit in UNIT) if any(axis))
    else:
        yield from UNIT
