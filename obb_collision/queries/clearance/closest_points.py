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

"""Closest points of two boxes apart: few candidates, and a certificate that they are.

Every function returns a point of each box, s and t of ``Pair``, with the vector between them:
what rounding does to a choice can make points less close, never wrong.

All in the frame of box a, scaled so that squares neither over- nor underflow (``Pair``).

For any unit vector n the gap of the boxes along n is at most their distance, and the distance of
any two points is at least that. Where both agree, the points are the closest ones: duality of
convex sets (Boyd, Vandenberghe 2004, 8.2), a proof that asks nothing of how they were found.
Candidates come in stages, each only for what the ones before could not prove:

1. the face axis of the largest gap: its face against the foremost vertex of the other box;
2. from there the closest point of b, and of a to that. Reaches nearly all closest points with a
   vertex, for a vertex once found keeps being the closest;
3. the edge axis of the largest gap: its foremost edges. Wherever the closest features fix their
   normal (face against anything, edge crossing edge), that axis has the largest gap of all 15;
4. as 2, from there;
5. each vertex against the other box;
6. all 144 pairs of edges. The closest points of disjoint boxes lie on a vertex and a box or on
   two edges, so nothing else can be closer: where rounding hides the certificate (parallel faces
   that overlap crosswise, boxes nearly touching), the answer rests on having tried everything.

Of random pairs 13 % end in stage 1, 46 % in 2, the rest in 3 and 4; 5 and 6 are for boxes with
nearly parallel edges or faces.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import clamp, dot, minus, pick, pick_axis, replaced
from obb_collision.queries.verdict.sat import (
    AXES,
    Axis,
    Pair,
    along_b,
    best_edge,
    closest_on_a,
    closest_on_b,
    edge_numbers,
    gap_along,
    point_of_b,
    unit_axis,
)
from obb_collision.typing import Vector

#: An extent counts as level with a face if it rises by no more than this on its way: 32 unit
#: roundoffs. Either of its ends is then as close, up to a quarter of ``PROVEN``.
LEVEL = 32 * ROUNDOFF


class Points(NamedTuple):
    """A point of each box, and the square of their distance."""

    s: Vector
    t: Vector
    square: float


@njit
def points_at(pair: Pair, s: Vector, t: Vector) -> Points:
    """Return points with their squared distance."""
    v = minus(point_of_b(pair, t), s)
    return Points(s, t, dot(v, v))


@njit
def foremost(n: Vector, extents: Vector, level: Vector) -> Vector:
    """Return the corner of a centred box farthest along n; ``level`` where an extent is level."""
    return (
        math.copysign(extents[0], n[0]) if abs(n[0]) > LEVEL else level[0],
        math.copysign(extents[1], n[1]) if abs(n[1]) > LEVEL else level[1],
        math.copysign(extents[2], n[2]) if abs(n[2]) > LEVEL else level[2],
    )


@njit
def face_points(pair: Pair, n: Vector, of_a: bool) -> Points:
    """Face with normal n, from a to b, against the foremost vertex of the other box.

    Where an extent is level with the face, anywhere along it: about where the boxes face.
    """
    if of_a:
        t = closest_on_b(pair, closest_on_a(pair, (0.0, 0.0, 0.0)))
        t = foremost(along_b(pair, (-n[0], -n[1], -n[2])), pair.f, t)
        return points_at(pair, closest_on_a(pair, t), t)
    s = closest_on_a(pair, closest_on_b(pair, (0.0, 0.0, 0.0)))
    s = foremost(n, pair.h, s)
    return points_at(pair, s, closest_on_b(pair, s))


@njit
def edge_points(pair: Pair, i: int, j: int, n: Vector) -> Points:
    """Those edges i of a and j of b that are foremost along n, the unit vector normal to both."""
    m = along_b(pair, n)
    h, f = pair.h, pair.f
    s = math.copysign(h[0], n[0]), math.copysign(h[1], n[1]), math.copysign(h[2], n[2])
    t = math.copysign(f[0], -m[0]), math.copysign(f[1], -m[1]), math.copysign(f[2], -m[2])
    return _cross_edges(pair, i, j, s, t)


@njit
def _cross_edges(pair: Pair, i: int, j: int, s: Vector, t: Vector) -> Points:
    """Edge i of a through s and edge j of b through t, where the lines are closest.

    Seen along edge i (only the components of u across it count) t[j] is a projection on a line:
    no determinant near zero however parallel the edges. Where the lines are closest beyond an end,
    a vertex is closer (``vertex_points``).
    """
    s, t = replaced(s, i, 0.0), replaced(t, j, 0.0)
    u = pick_axis(pair.r, j)
    across = replaced(u, i, 0.0)
    v = minus(point_of_b(pair, t), s)
    square = dot(across, across)
    y = clamp(-dot(v, across) / square, pick(pair.f, j)) if square > 0.0 else 0.0
    x = clamp(pick(v, i) + y * pick(u, i), pick(pair.h, i))
    return points_at(pair, replaced(s, i, x), replaced(t, j, y))


@njit
def vertex_points(pair: Pair, best: Points) -> Points:
    """Each vertex against the other box; ``best`` where none is closer."""
    of_a, vertex, least = False, -1, best.square
    for code in range(8):
        square = _excess(point_of_b(pair, _corner(pair.f, code)), pair.h)
        if square < least:
            least, vertex = square, code
    for code in range(8):
        square = _excess(along_b(pair, minus(_corner(pair.h, code), pair.d)), pair.f)
        if square < least:
            least, vertex, of_a = square, code, True
    if vertex < 0:
        return best
    if of_a:
        s = _corner(pair.h, vertex)
        return points_at(pair, s, closest_on_b(pair, s))
    t = _corner(pair.f, vertex)
    return points_at(pair, closest_on_a(pair, t), t)


@njit
def _excess(v: Vector, extents: Vector) -> float:
    """Return the squared distance of v from a centred box."""
    x = max(abs(v[0]) - extents[0], 0.0)
    y = max(abs(v[1]) - extents[1], 0.0)
    z = max(abs(v[2]) - extents[2], 0.0)
    return x * x + y * y + z * z


@njit
def all_edge_points(pair: Pair, best: Points) -> Points:
    """Each of the 144 pairs of edges; ``best`` where none is closer."""
    for i in range(3):
        for j in range(3):
            for code in range(64):
                # Bits 0 to 2 a corner of a, 3 to 5 one of b: one corner is enough for an edge.
                if code >> i & 1 or code >> (3 + j) & 1:
                    continue
                s, t = _corner(pair.h, code), _corner(pair.f, code >> 3)
                points = _cross_edges(pair, i, j, s, t)
                if points.square < best.square:
                    best = points
    return best


@njit
def _corner(extents: Vector, code: int) -> Vector:
    """Return one of the eight corners: bit k of the code set means the positive end."""
    return (
        extents[0] if code & 1 else -extents[0],
        extents[1] if code & 2 else -extents[1],
        extents[2] if code & 4 else -extents[2],
    )


#: Two points are proven closest when their distance exceeds a gap by no more than this, relative
#: to the size: 128 unit roundoffs, above what both are off by with axes orthonormal to rounding.
#: Axes farther off only fail to prove some pairs: they go on to stage 6.
PROVEN = 128 * ROUNDOFF
#: With a gap above this, relative to the size, boxes are certainly apart: 2^13 unit roundoffs,
#: far beyond every error bound of ``verdict``.
NEAR = 8192 * ROUNDOFF


@njit(merge=True)
def points_apart(pair: Pair, size: float, face: Axis) -> tuple[bool, Points, Vector]:
    """Return whether boxes are certainly apart, and then their closest points and the normal.

    face: of ``sat.best_face``.
    """
    gap, number = face
    n = unit_axis(pair, number)
    points = points_on_axis(pair, number, n)
    if gap > NEAR * size:
        if _proven(points, gap, size):
            return True, points, n
        closer, m = _slide(pair, points, n)
        if _proven(closer, gap_along(pair, m), size):
            return True, closer, m
    gap, number = best_edge(pair, face)
    if number >= 6:
        n = unit_axis(pair, number)
        gap = max(gap_along(pair, n), face[0])
        points = points_on_axis(pair, number, n)
    if gap <= NEAR * size:
        return False, points, n
    if not _proven(points, gap, size):
        points, n = points_anywhere(pair, size, points, n)
    return True, points, n


@njit
def points_near(pair: Pair, size: float, gap: float, number: int, n: Vector) -> Points:
    """Return the closest points of boxes that (nearly) touch; gap, number: of the axis n."""
    points = points_on_axis(pair, number, n)
    if _proven(points, gap, size):
        return points
    return points_anywhere(pair, size, points, n)[0]


@njit
def points_on_axis(pair: Pair, number: int, n: Vector) -> Points:
    """Return the closest points if n, the axis of that number, is their normal."""
    if number < 6:
        return face_points(pair, n, number < 3)
    i, j = edge_numbers(number)
    return edge_points(pair, i, j, n)


@njit
def points_anywhere(pair: Pair, size: float, points: Points, n: Vector) -> tuple[Points, Vector]:
    """Stages 4 to 6: return the closest points and the normal, n or better."""
    points, m = _slide(pair, points, n)
    if _proven(points, gap_along(pair, m), size):
        return points, m
    points = vertex_points(pair, points)
    m = _direction(pair, points, n)
    if _proven(points, gap_along(pair, m), size):
        return points, m
    points = all_edge_points(pair, points)
    return points, _widest(pair, n, _direction(pair, points, n))


@njit
def _widest(pair: Pair, n: Vector, m: Vector) -> Vector:
    """Return n, m or the edge axis, also of nearly parallel edges, that shows the largest gap.

    The direction of points close together is that of their rounding errors.
    """
    if gap_along(pair, m) > gap_along(pair, n):
        n = m
    for number in range(6, AXES):
        m = unit_axis(pair, number)
        if gap_along(pair, m) > gap_along(pair, n):  # not so for NaN, of parallel edges
            n = m
    return n


@njit
def _slide(pair: Pair, points: Points, n: Vector) -> tuple[Points, Vector]:
    """Return the point of b closest to s, the point of a closest to that, and their direction."""
    t = closest_on_b(pair, points.s)
    closer = points_at(pair, closest_on_a(pair, t), t)
    return closer, _direction(pair, closer, n)


@njit
def _proven(points: Points, gap: float, size: float) -> bool:
    """Return whether points are closest: no farther apart than a gap, or not at all."""
    limit = max(gap, 0.0) + PROVEN * size
    return points.square <= limit * limit


@njit
def _direction(pair: Pair, points: Points, n: Vector) -> Vector:
    """Return the unit vector from s to t; n where they agree."""
    if points.square == 0.0:
        return n
    v = minus(point_of_b(pair, points.t), points.s)
    norm = math.sqrt(points.square)
    return v[0] / norm, v[1] / norm, v[2] / norm
