"""The closest points of two boxes apart: few candidates, and a certificate that they are.

All in the frame of box a, scaled so that squares neither over- nor underflow (``Pair``).

For any unit vector n the gap of the boxes along n is at most their distance, and the distance of
any two points is at least that. Where both agree, the points are the closest ones: duality of
convex sets (Boyd, Vandenberghe 2004, 8.2), a proof that asks nothing of how they were found.
Candidates come in stages, each only for what the ones before could not prove:

1. the face axis of the largest gap, its face against the foremost vertex of the other box;
2. the edge axis of the largest gap, its foremost edges. Wherever two features are closest that
   fix the normal (face and anything, edge crossing edge), their axis has the largest gap of all;
3. each vertex against the other box, for what is left: vertex and edge, vertex and vertex;
4. all 144 pairs of edges. The closest points of disjoint boxes lie on a vertex and a box or on
   two edges, so nothing else can be closer: where rounding hides the certificate (parallel faces
   that overlap crosswise, boxes nearly touching), the answer rests on having tried everything.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.geometry.validation import Floats
from obb_collision.queries.closest_features import (
    Pair,
    all_edge_points,
    edge_points,
    face_points,
    squared_distance,
    vertex_points,
)

#: Two points are proven closest when their distance exceeds a gap by no more than this, relative
#: to the size: 512 unit roundoffs. Both are computed to fewer, axes orthonormal to 64.
PROVEN = 2.0**-44
#: With a gap above this, relative to the size, boxes are certainly apart: 2^13 unit roundoffs,
#: far beyond every error bound of ``separation``.
NEAR = 2.0**-40
#: Squared length below which a cross product of edges is left to stage 4.
SHORT_SQUARE = 2.0**-40


@njit
def best_face(pair: Pair) -> tuple[float, int]:
    """Write the face normal (3,) of the largest gap, from a to b; return gap and number."""
    d, r, h, f, n = pair.d, pair.r, pair.h, pair.f, pair.n
    best = -math.inf
    number = 0
    for i in range(3):
        gap = abs(d[i]) - h[i] - (f[0] * abs(r[i, 0]) + f[1] * abs(r[i, 1]) + f[2] * abs(r[i, 2]))
        if gap > best:
            best, number = gap, i
    for j in range(3):
        gap = abs(d[0] * r[0, j] + d[1] * r[1, j] + d[2] * r[2, j]) - f[j]
        gap -= h[0] * abs(r[0, j]) + h[1] * abs(r[1, j]) + h[2] * abs(r[2, j])
        if gap > best:
            best, number = gap, 3 + j
    for i in range(3):
        n[i] = r[i, number - 3] if number >= 3 else 1.0 if i == number else 0.0
    _face_b(d, n)
    return best, number


@njit
def best_edge(pair: Pair, least: float) -> tuple[float, int]:
    """Write the unit edge axis (3,) of the largest gap, from a to b; return gap and number.

    Number -1, and n left as it is, where no gap exceeds ``least`` and 0. The largest by a quick
    calculation: not certain among equals and among nearly parallel edges.
    """
    d, r, h, f, n = pair.d, pair.r, pair.h, pair.f, pair.n
    best, number, length = least, -1, 1.0
    for i, k, m in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for j, p, q in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            square = r[k, j] * r[k, j] + r[m, j] * r[m, j]
            gap = abs(d[m] * r[k, j] - d[k] * r[m, j])
            gap -= h[k] * abs(r[m, j]) + h[m] * abs(r[k, j])
            gap -= f[p] * abs(r[i, q]) + f[q] * abs(r[i, p])
            if gap > 0.0 and square > SHORT_SQUARE:
                norm = math.sqrt(square)
                if gap > best * norm:
                    best, number, length = gap / norm, 6 + 3 * i + j, norm
    if number < 0:
        return least, number
    i, j = (number - 6) // 3, (number - 6) % 3
    n[i] = 0.0
    n[(i + 1) % 3] = -r[(i + 2) % 3, j] / length
    n[(i + 2) % 3] = r[(i + 1) % 3, j] / length
    _face_b(d, n)
    return gap_along(pair), number


@njit
def _face_b(d: Floats, n: Floats) -> None:
    """Turn n from a to b."""
    if n[0] * d[0] + n[1] * d[1] + n[2] * d[2] < 0.0:
        n[0], n[1], n[2] = -n[0], -n[1], -n[2]


@njit
def gap_along(pair: Pair) -> float:
    """Return the gap along a unit vector from a to b: at most the distance."""
    d, r, h, f, n = pair.d, pair.r, pair.h, pair.f, pair.n
    gap = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
    gap -= h[0] * abs(n[0]) + h[1] * abs(n[1]) + h[2] * abs(n[2])
    for j in range(3):
        gap -= f[j] * abs(n[0] * r[0, j] + n[1] * r[1, j] + n[2] * r[2, j])
    return gap


@njit
def points_apart(pair: Pair, size: float, gap: float, number: int) -> bool:
    """Write the closest points and their normal; False if the boxes are not certainly apart.

    gap, number: of ``best_face``.
    """
    near = NEAR * size
    if gap > near and _proven(points_on_axis(pair, number), gap, size):
        return True
    edge_gap, edge = best_edge(pair, gap)
    if max(edge_gap, gap) <= near:
        return False
    if edge >= 0:
        number = edge
    best = points_on_axis(pair, number)
    if not _proven(best, edge_gap, size):
        points_anywhere(pair, size, best)
    return True


@njit
def points_on_axis(pair: Pair, number: int) -> float:
    """Write the closest points if n, the axis of that number, is their normal; their square."""
    if number < 6:
        return face_points(pair, number)
    return edge_points(pair, (number - 6) // 3, (number - 6) % 3)


@njit
def points_near(pair: Pair, size: float, gap: float, number: int) -> None:
    """Write the closest points of boxes that (nearly) touch; gap, number: of the axis n."""
    best = points_on_axis(pair, number)
    if not _proven(best, max(gap, 0.0), size):
        points_anywhere(pair, size, best)


@njit
def points_anywhere(pair: Pair, size: float, best: float) -> None:
    """Stages 3 and 4: write the closest points and their direction n, from those of ``best``."""
    best = vertex_points(pair, best)
    _direct(pair)
    if _proven(best, max(gap_along(pair), 0.0), size):
        return
    all_edge_points(pair, best)
    _direct(pair)


@njit
def _proven(square: float, gap: float, size: float) -> bool:
    """Tell whether points are closest, by the square of their distance and a gap."""
    limit = gap + PROVEN * size
    return square <= limit * limit


@njit
def _direct(pair: Pair) -> None:
    """Turn n from s to t; it stays as it is where they agree."""
    d, r, s, t, n = pair.d, pair.r, pair.s, pair.t, pair.n
    norm = math.sqrt(squared_distance(pair))
    if norm > 0.0:
        for i in range(3):
            x = d[i] + ((r[i, 0] * t[0] + r[i, 1] * t[1]) + r[i, 2] * t[2]) - s[i]
            n[i] = x / norm
