"""The closest points of two boxes apart: few candidates, and a certificate that they are.

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

from obb_collision._jit import njit
from obb_collision.queries.box_frame import (
    Pair,
    Vector,
    closest_on_a,
    closest_on_b,
    dot,
    dot_abs,
    gap_along,
    minus,
    point_of_b,
    replaced,
)
from obb_collision.queries.closest_features import (
    Points,
    all_edge_points,
    edge_points,
    face_points,
    points_at,
    vertex_points,
)

#: Two points are proven closest when their distance exceeds a gap by no more than this, relative
#: to the size: 128 unit roundoffs, above what both are off by with axes orthonormal to rounding.
#: Axes farther off only fail to prove some pairs: they go on to stage 6.
PROVEN = 2.0**-46
#: With a gap above this, relative to the size, boxes are certainly apart: 2^13 unit roundoffs,
#: far beyond every error bound of ``separation``.
NEAR = 2.0**-40
#: Squared length below which a cross product of edges is left to stage 6.
SHORT_SQUARE = 2.0**-40

Axis = tuple[float, int]


@njit
def best_face(pair: Pair) -> Axis:
    """Return the largest gap along a face normal, and its number: 0 to 2 of a, 3 to 5 of b."""
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    best = -math.inf, 0
    best = _larger(best, abs(d[0]) - h[0] - dot_abs(f, (x[0], y[0], z[0])), 0)
    best = _larger(best, abs(d[1]) - h[1] - dot_abs(f, (x[1], y[1], z[1])), 1)
    best = _larger(best, abs(d[2]) - h[2] - dot_abs(f, (x[2], y[2], z[2])), 2)
    best = _larger(best, abs(dot(d, x)) - f[0] - dot_abs(h, x), 3)
    best = _larger(best, abs(dot(d, y)) - f[1] - dot_abs(h, y), 4)
    return _larger(best, abs(dot(d, z)) - f[2] - dot_abs(h, z), 5)


@njit
def best_edge(pair: Pair, best: Axis) -> Axis:
    """Return the largest gap along a unit edge axis i, j, number 6 + 3 i + j; else ``best``.

    Only positive gaps count. The largest by a quick calculation: not certain among equals and
    among nearly parallel edges.
    """
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    for j in range(3):
        best = _larger(
            best, _edge_gap(d[1], d[2], x[1], x[2], h[1], h[2], f[1], f[2], y[0], z[0]), 6 + j
        )
        best = _larger(
            best, _edge_gap(d[2], d[0], x[2], x[0], h[2], h[0], f[1], f[2], y[1], z[1]), 9 + j
        )
        best = _larger(
            best, _edge_gap(d[0], d[1], x[0], x[1], h[0], h[1], f[1], f[2], y[2], z[2]), 12 + j
        )
        x, y, z = y, z, x
        f = f[1], f[2], f[0]
    return best


@njit
def _edge_gap(
    dk: float, dm: float, uk: float, um: float, hk: float, hm: float,
    fp: float, fq: float, p: float, q: float,
) -> float:  # fmt: skip
    """Return the gap along edge i of a crossed with edge u of b; minus infinity if not positive.

    k, m: components after i; p, q: component i of the axes of b after u.
    """
    gap = abs(dm * uk - dk * um) - (hk * abs(um) + hm * abs(uk)) - (fp * abs(q) + fq * abs(p))
    square = uk * uk + um * um
    if gap > 0.0 and square > SHORT_SQUARE:
        return gap / math.sqrt(square)
    return -math.inf


@njit
def _larger(best: Axis, gap: float, number: int) -> Axis:
    return (gap, number) if gap > best[0] else best


@njit
def unit_axis(pair: Pair, number: int) -> Vector:
    """Return the unit vector of an axis, from a to b."""
    if number < 3:
        n = replaced((0.0, 0.0, 0.0), number, 1.0)
    elif number < 6:
        n = _axis_of_b(pair, number - 3)
    else:
        i = (number - 6) // 3
        u = _axis_of_b(pair, (number - 6) % 3)
        if i == 0:
            n = 0.0, -u[2], u[1]
        elif i == 1:
            n = u[2], 0.0, -u[0]
        else:
            n = -u[1], u[0], 0.0
        norm = math.sqrt(dot(n, n))
        n = n[0] / norm, n[1] / norm, n[2] / norm
    if dot(n, pair.d) < 0.0:
        return -n[0], -n[1], -n[2]
    return n


@njit
def _axis_of_b(pair: Pair, j: int) -> Vector:
    return pair.r[0] if j == 0 else pair.r[1] if j == 1 else pair.r[2]


@njit
def points_apart(pair: Pair, size: float, face: Axis) -> tuple[bool, Points, Vector]:
    """Return whether boxes are certainly apart, and then their closest points and the normal.

    face: of ``best_face``.
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
    return edge_points(pair, (number - 6) // 3, (number - 6) % 3, n)


@njit
def points_anywhere(pair: Pair, size: float, points: Points, n: Vector) -> tuple[Points, Vector]:
    """Stages 4 to 6, from ``points``: return the closest points and their direction, n where they agree."""
    points, n = _slide(pair, points, n)
    if _proven(points, gap_along(pair, n), size):
        return points, n
    points = vertex_points(pair, points)
    n = _direction(pair, points, n)
    if _proven(points, gap_along(pair, n), size):
        return points, n
    points = all_edge_points(pair, points)
    return points, _direction(pair, points, n)


@njit
def _slide(pair: Pair, points: Points, n: Vector) -> tuple[Points, Vector]:
    """Return the point of b closest to s, the point of a closest to that, and their direction."""
    t = closest_on_b(pair, points.s)
    closer = points_at(pair, closest_on_a(pair, t), t)
    return closer, _direction(pair, closer, n)


@njit
def _proven(points: Points, gap: float, size: float) -> bool:
    """Tell whether points are closest: no farther apart than a gap, or not at all."""
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
