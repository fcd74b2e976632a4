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

"""Euclidean distance of two boxes and their closest points.

Verdict and distance go together: the distance is positive exactly for pairs that
``verdict.verdicts`` calls SEPARATE, 0 for TOUCHING, and negative for OVERLAP: minus the depth,
the least translation along any of the 15 axes that parts them (``witness``).

Accuracy: distances of separate pairs are within 1e-12 of the size of the pair, the sum of its six
half extents or the distance itself, whichever is larger. So is the distance between the points,
up to the rounding of world coordinates. Where many points are equally close (parallel faces),
one pair of them is returned; nearly parallel faces count as parallel up to that accuracy.

The answer for b and a is that for a and b, bit for bit, points exchanged and normal reversed
(boxes identical in every bit have no order: theirs is the same both ways). Only the offset of the
centres counts, not where they are.

The search runs in the frame of box a, scaled so that squares neither over- nor underflow
(``BoxPair``). For any unit vector n the gap of the boxes along n is at most their distance, and the
distance of any two points is at least that. Where both agree, the points are the closest ones:
duality of convex sets (Boyd, Vandenberghe 2004, 8.2), a proof that does not depend on how they were
found. Rounding may choose points that are less close, never wrong ones. Each stage handles the
pairs that those before it could not prove:

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
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.numerics.constants import MAX_MAGNITUDE, ROUNDOFF
from obb_collision.numerics.vec3 import (
    ZERO,
    clamp,
    components,
    dot,
    minus,
    negated,
    pick,
    pick_axis,
    replaced,
    scaled,
)
from obb_collision.queries.verdict.pair_rows import as_pairs, one_set
from obb_collision.queries.verdict.sat import (
    AXIS_COUNT,
    AxisGap,
    BoxAt,
    BoxPair,
    along_b,
    best_edge,
    best_face,
    box_at,
    closest_on_a,
    closest_on_b,
    edge_numbers,
    enter_frame,
    gap_along,
    leave_frame,
    point_of_b,
    unit_axis,
)
from obb_collision.queries.verdict.verdict import SEPARATE, TOUCHING, box_verdict
from obb_collision.queries.verdict.witness import box_witness
from obb_collision.typing import Floats, Integers, Mask, Vector
from obb_collision.words import shown

#: Pairs below which a second thread does not pay: 30 us.
FEWEST_CLEARANCES = 64
#: Of m pairs: whether they are near (m,), distances (m,), points and normals (3, m, 3).
ClearanceRows = tuple[np.ndarray, Floats, Floats]
#: Kinds of real numbers.
REAL_NUMBERS = (int, float, np.integer, np.floating)


@dataclass(frozen=True, eq=False)
class Clearances:
    """Distance and closest points of m pairs of boxes a, b; metres, world frame."""

    pairs: Integers
    """(m, 2) rows of a and b; in a report, indices of objects."""
    distances: Floats
    """(m,) positive apart, minus the depth where they overlap, 0 where they touch."""
    positions_a: Floats
    """(m, 3) the point of a closest to b; overlapping, the deepest in b along the normal."""
    positions_b: Floats
    """(m, 3) the same of b."""
    normals: Floats
    """(m, 3) unit vector from a to b along which the distance is; within 1e-12 of touching, and
    where boxes overlap, the axis of the largest gap."""

    def __len__(self) -> int:
        return len(self.distances)


def box_clearances(
    a: Boxes, b: Boxes, pairs: ArrayLike | None = None, *, max_distance: float = np.inf
) -> Clearances:
    """Return the clearances of boxes that are within a distance, in metres."""
    rows = as_pairs(a, b, pairs)
    boxes, checked = one_set(a, b, rows)
    clearances, near = near_pairs(boxes, checked, as_limit(max_distance))
    return replace(clearances, pairs=rows[near])


def as_limit(max_distance: float) -> float:
    """Return a maximum distance, metres; large ones become infinite."""
    if not (isinstance(max_distance, REAL_NUMBERS) and max_distance >= 0.0):  # NaN too
        raise ValueError(f"max_distance must be a number, at least 0, got {shown(max_distance)}")
    return float(max_distance) if max_distance <= MAX_MAGNITUDE else np.inf


def near_pairs(boxes: Boxes, pairs: Integers, limit: float) -> tuple[Clearances, Mask]:
    """Return the clearances of pairs (m, 2) within a limit, and which pairs these are (m,)."""
    near = np.empty(len(pairs), np.bool_)
    distances, vectors = np.empty(len(pairs)), np.empty((3, len(pairs), 3))
    out = near, distances, vectors
    run(clearance_kernel, len(pairs), FEWEST_CLEARANCES, boxes.arrays, pairs, limit, out)
    return Clearances(pairs[near], distances[near], *vectors[:, near]), near


@njit
def clearance_kernel(
    boxes: BoxArrays, pairs: np.ndarray, limit: float, out: ClearanceRows, start: int, stop: int
) -> None:
    """Write which pairs of (m, 2) are within the limit, and distance, points and normal."""
    near, distances, vectors = out
    for row in range(start, stop):
        near[row] = False
        a, b = box_at(boxes, pairs[row, 0]), box_at(boxes, pairs[row, 1])
        swapped = _comes_before(b, a)
        if swapped:
            a, b = b, a
        pair, size, scale = enter_frame(a, b)
        face = best_face(pair)
        if (face[0] - CERTAINLY_APART * size) / scale > limit:
            continue
        apart, points, n = points_apart(pair, size, face)
        verdict, gap = SEPARATE, 0.0
        if not apart:
            verdict, gap, points, n = _near_points(a, b, pair, size, scale)
        distance, p, q, n = leave_frame(a, b, points.s, points.t, n, scale)
        if swapped:
            p, q, n = q, p, negated(n)
        if verdict == TOUCHING:
            gap = 0.0
        distance = max(distance, gap) if verdict == SEPARATE else gap
        if distance <= limit:
            near[row], distances[row] = True, distance
            for k in range(3):
                vectors[0, row, k], vectors[1, row, k], vectors[2, row, k] = p[k], q[k], n[k]


@njit
def _comes_before(a: BoxAt, b: BoxAt) -> bool:
    """Return whether a comes before b, in an order that does not depend on the arguments."""
    for k in range(3):
        if a.center[k] != b.center[k]:
            return a.center[k] < b.center[k]
    for k in range(3):
        if a.half_extents[k] != b.half_extents[k]:
            return a.half_extents[k] < b.half_extents[k]
    for k in range(3):
        for m in range(3):
            if a.axes[m][k] != b.axes[m][k]:
                return a.axes[m][k] < b.axes[m][k]
    return False


@njit
def _near_points(
    a: BoxAt, b: BoxAt, pair: BoxPair, size: float, scale: float
) -> tuple[int, float, PointPair, Vector]:
    """Return verdict, gap (metres), points and axis of boxes that overlap or nearly touch.

    The points of boxes that overlap are those that touch once b is moved by the depth.
    """
    verdict = box_verdict(a, b)
    (gap, axis, number), _ = box_witness(a, b)
    n = components(a.axes, axis)
    back = 0.0 if verdict == SEPARATE else gap * scale
    touching = BoxPair(minus(pair.d, scaled(n, back)), pair.r, pair.h, pair.f)
    return verdict, gap, points_near(touching, size, gap * scale - back, number, n), n


#: An extent counts as level with a face if it rises by no more than this on its way: 32 unit
#: roundoffs. Either of its ends is then as close, up to a quarter of ``PROVEN``.
LEVEL_RISE = 32 * ROUNDOFF


class PointPair(NamedTuple):
    """A point of each box, and the square of their distance."""

    s: Vector
    t: Vector
    square: float


@njit
def points_at(pair: BoxPair, s: Vector, t: Vector) -> PointPair:
    """Return points with their squared distance."""
    v = minus(point_of_b(pair, t), s)
    return PointPair(s, t, dot(v, v))


@njit
def foremost(n: Vector, extents: Vector, level: Vector) -> Vector:
    """Return the corner of a centred box farthest along n; ``level`` where an extent is level."""
    return (
        math.copysign(extents[0], n[0]) if abs(n[0]) > LEVEL_RISE else level[0],
        math.copysign(extents[1], n[1]) if abs(n[1]) > LEVEL_RISE else level[1],
        math.copysign(extents[2], n[2]) if abs(n[2]) > LEVEL_RISE else level[2],
    )


@njit
def face_points(pair: BoxPair, n: Vector, of_a: bool) -> PointPair:
    """Return the points of the face with normal n and the foremost vertex of the other box.

    n: from a to b. If an extent is level with the face, the point is near the middle of what faces.
    """
    if of_a:
        t = closest_on_b(pair, closest_on_a(pair, ZERO))
        t = foremost(along_b(pair, (-n[0], -n[1], -n[2])), pair.f, t)
        return points_at(pair, closest_on_a(pair, t), t)
    s = closest_on_a(pair, closest_on_b(pair, ZERO))
    s = foremost(n, pair.h, s)
    return points_at(pair, s, closest_on_b(pair, s))


@njit
def edge_points(pair: BoxPair, i: int, j: int, n: Vector) -> PointPair:
    """Return the points of edges i of a and j of b, foremost along n, unit and normal to both."""
    m = along_b(pair, n)
    h, f = pair.h, pair.f
    s = math.copysign(h[0], n[0]), math.copysign(h[1], n[1]), math.copysign(h[2], n[2])
    t = math.copysign(f[0], -m[0]), math.copysign(f[1], -m[1]), math.copysign(f[2], -m[2])
    return _cross_edges(pair, i, j, s, t)


@njit
def _cross_edges(pair: BoxPair, i: int, j: int, s: Vector, t: Vector) -> PointPair:
    """Return the points of edge i of a through s and edge j of b through t, where closest.

    Seen along edge i (only the components of u across it count) t[j] is a projection on a line: no
    determinant is near zero, however parallel the edges. Where the lines are closest beyond an end,
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
def vertex_points(pair: BoxPair, best: PointPair) -> PointPair:
    """Return the closest pair of a vertex and a point of the other box, or ``best`` if closer."""
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
def all_edge_points(pair: BoxPair, best: PointPair) -> PointPair:
    """Return the closest points of the 144 pairs of edges, or ``best`` if that is closer."""
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
    """Return a corner of a centred box: bit k of the code means the positive end of axis k."""
    return (
        extents[0] if code & 1 else -extents[0],
        extents[1] if code & 2 else -extents[1],
        extents[2] if code & 4 else -extents[2],
    )


#: Two points are proven closest when their distance exceeds a gap by no more than this, relative
#: to the size: 128 unit roundoffs, above the errors of both with axes orthonormal to rounding. With
#: less orthonormal axes some pairs are not proven: they go on to stage 6.
PROVEN = 128 * ROUNDOFF
#: With a gap above this, relative to the size, boxes are certainly apart: 2^13 unit roundoffs,
#: far beyond every error bound of ``verdict``.
CERTAINLY_APART = 8192 * ROUNDOFF


@njit(merge=True)
def points_apart(pair: BoxPair, size: float, face: AxisGap) -> tuple[bool, PointPair, Vector]:
    """Return whether boxes are certainly apart, and then their closest points and the normal.

    face: the result of ``sat.best_face``.
    """
    gap, number = face
    n = unit_axis(pair, number)
    points = points_on_axis(pair, number, n)
    if gap > CERTAINLY_APART * size:
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
    if gap <= CERTAINLY_APART * size:
        return False, points, n
    if not _proven(points, gap, size):
        points, n = points_anywhere(pair, size, points, n)
    return True, points, n


@njit
def points_near(pair: BoxPair, size: float, gap: float, number: int, n: Vector) -> PointPair:
    """Return the closest points of boxes that nearly touch; gap, number: of the axis n."""
    points = points_on_axis(pair, number, n)
    if _proven(points, gap, size):
        return points
    return points_anywhere(pair, size, points, n)[0]


@njit
def points_on_axis(pair: BoxPair, number: int, n: Vector) -> PointPair:
    """Return the closest points if n, the axis of that number, is their normal."""
    if number < 6:
        return face_points(pair, n, number < 3)
    i, j = edge_numbers(number)
    return edge_points(pair, i, j, n)


@njit
def points_anywhere(
    pair: BoxPair, size: float, points: PointPair, n: Vector
) -> tuple[PointPair, Vector]:
    """Return the closest points of stages 4 to 6, and the normal: n or a better one."""
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
def _widest(pair: BoxPair, n: Vector, m: Vector) -> Vector:
    """Return the direction with the largest gap: n, m, or an edge axis.

    The direction between points that are close together is mostly rounding.
    """
    if gap_along(pair, m) > gap_along(pair, n):
        n = m
    for number in range(6, AXIS_COUNT):
        m = unit_axis(pair, number)
        if gap_along(pair, m) > gap_along(pair, n):  # not so for NaN, of parallel edges
            n = m
    return n


@njit
def _slide(pair: BoxPair, points: PointPair, n: Vector) -> tuple[PointPair, Vector]:
    """Return closer points, and the direction from a to b, which is n where the points agree.

    They are the point of b closest to ``points.s``, and the point of a closest to that.
    """
    t = closest_on_b(pair, points.s)
    closer = points_at(pair, closest_on_a(pair, t), t)
    return closer, _direction(pair, closer, n)


@njit
def _proven(points: PointPair, gap: float, size: float) -> bool:
    """Return whether the gap proves points closest, or they agree."""
    limit = max(gap, 0.0) + PROVEN * size
    return points.square <= limit * limit


@njit
def _direction(pair: BoxPair, points: PointPair, n: Vector) -> Vector:
    """Return the unit vector from s to t; n where they agree."""
    if points.square == 0.0:
        return n
    v = minus(point_of_b(pair, points.t), points.s)
    norm = math.sqrt(points.square)
    return v[0] / norm, v[1] / norm, v[2] / norm
