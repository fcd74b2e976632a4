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

"""Length of a push along a direction until a mesh certainly no longer collides.

``way_out`` is how far a triangle must go until it no longer touches another.

Seen along the direction both are flat, with a height at each point. The way out is the largest
difference of heights where the two lie over each other, which is at a corner of the one over the
other, or where two edges cross (a linear function over a convex polygon). It is never more than the
way past all corners, which is what is left where triangles are seen edge-on.

At a place where triangles touch, no place nearer than the farthest way out of any two of them is
free: each pair touches from the start of its way to its end, without a gap. So the push goes there
at once, looks again, and ends at the first place, in steps of ``MARGIN``, where nothing touches and
the distance is certain. Bodies with a radius are pushed on until the distance is that of the radii:
the distance of two convex things along a way is convex, so its slope leads past it, not short of
it. A body within the other is pushed by its distance from the surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.vec3 import combined, dot, minus, plus, scaled
from obb_collision.queries.convex.contacts import FlatFrame, frame_of
from obb_collision.queries.meshes.meshes import nesting
from obb_collision.queries.meshes.placed import (
    MeshAt,
    MeshPair,
    Place,
    Pose,
    body_at,
    relative_pose,
)
from obb_collision.queries.meshes.triangles import OVERLAP, SEPARATE, Triangle
from obb_collision.queries.meshes.two_trees import (
    SLACK,
    Contacting,
    TreeRoom,
    descend,
    nearest_triangles,
    points_of,
    triangles_of,
)
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.typing import Vector

#: Places this little outside of an edge or a face, relative to it, are on it.
OUTSIDE = 1e-12


@njit
def way_out(p: Triangle, q: Triangle, frame: FlatFrame, enough: float) -> float:
    """Return how far q must go along the normal of a frame until it no longer touches p.

    Not too little but for rounding; minus infinity where they do not lie over each other, or where
    it certainly is not more than enough.
    """
    p, q = _seen(p, frame), _seen(q, frame)
    most = max(p[0][2], p[1][2], p[2][2]) - min(q[0][2], q[1][2], q[2][2])
    best = -np.inf
    if not most > enough:
        return best
    for _ in range(3):
        for _ in range(3):
            best = max(best, _edges_apart(p[0], p[1], q[0], q[1]))
            q = q[1], q[2], q[0]
        best = max(best, _height(p, q[0]) - q[0][2], p[0][2] + _height(_turned(q), p[0]))
        q = q[1], q[2], q[0]
        p = p[1], p[2], p[0]
    return min(best, most)


@njit
def _seen(t: Triangle, frame: FlatFrame) -> Triangle:
    """Return the corners along the axes of a frame."""
    return _along(t[0], frame), _along(t[1], frame), _along(t[2], frame)


@njit
def _along(v: Vector, frame: FlatFrame) -> Vector:
    return dot(frame.x, v), dot(frame.y, v), dot(frame.n, v)


@njit
def _turned(t: Triangle) -> Triangle:
    """Return a triangle with its heights reversed: the highest is then minus the lowest."""
    (a, b, c), (d, e, f), (g, h, i) = t
    return (a, b, -c), (d, e, -f), (g, h, -i)


@njit
def _area(a: Vector, b: Vector, c: Vector) -> float:
    """Return twice the area of a flat triangle, positive counterclockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@njit
def _height(t: Triangle, v: Vector) -> float:
    """Return the height of a triangle over a point, minus infinity beside it."""
    a, b, c = t
    area = _area(a, b, c)
    if area == 0.0:
        return -np.inf
    y, z = _area(a, v, c) / area, _area(a, b, v) / area
    if min(y, z, 1.0 - y - z) < -OUTSIDE:
        return -np.inf
    y, z = min(max(y, 0.0), 1.0), min(max(z, 0.0), 1.0)
    x = max(1.0 - y - z, 0.0)
    return x * a[2] + y * b[2] + z * c[2]


@njit
def _edges_apart(a: Vector, b: Vector, c: Vector, d: Vector) -> float:
    """Return how far the edge from a to b is above that from c to d where they cross."""
    ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    turn = ux * vy - uy * vx
    if turn == 0.0:
        return -np.inf
    wx, wy = c[0] - a[0], c[1] - a[1]
    s, t = (wx * vy - wy * vx) / turn, (wx * uy - wy * ux) / turn
    if min(s, t) < -OUTSIDE or max(s, t) > 1.0 + OUTSIDE:
        return -np.inf
    s, t = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)
    return a[2] + s * (b[2] - a[2]) - c[2] - t * (d[2] - c[2])


#: By how much a push goes on after the last contact, relative to S: an eighth of what is promised.
MARGIN = 2.0**-33
#: What is this far apart then, relative to S, certainly is so at the place asked about, too.
CERTAIN = 0.25 * MARGIN
#: Places that are looked at: most pushes end at the second one.
PLACES = 48
#: A distance that grows by less than this per length of a push is not worth it.
LEAST_SLOPE = 0.05
#: Triangles in contact that are looked at in one place; the next one shows what is left.
CONTACTS = 512
#: No verdict is as high: all contacts are asked for.
ALL = OVERLAP + 1
#: More pairs of nodes than any two meshes have.
UNLIMITED = 2**62


class Push(NamedTuple):
    """How far b is pushed, metres, infinite where it is not certainly free."""

    length: float
    p: Vector  #: the point of a that is nearest then, in its frame
    q: Vector  #: the same of b, before the push
    across: Vector  #: unit, from a to b: along it they are apart then


@njit(merge=True)
def seen_from_first(pairs: RowPairs, n: int, more: Vector) -> MeshPair:
    """Return a pair seen from the centre of its first body; more: radii of both, and a push."""
    trees_a, trees_b = pairs.a.trees, pairs.b.trees
    a, b = body_at(pairs.a, pairs.rows_a[n]), body_at(pairs.b, pairs.rows_b[n])
    reach = trees_a.radii[a.mesh] + trees_b.radii[b.mesh] + more[0] + more[1] + more[2]
    offset = minus(b.place.center, a.place.center)
    first, second = Place((0.0, 0.0, 0.0), a.place.axes), Place(offset, b.place.axes)
    pose = relative_pose(first, second, reach)
    return MeshPair(trees_a, MeshAt(a.mesh, first), trees_b, MeshAt(b.mesh, second), pose)


@njit(refcount=False)
def moved_by(pose: Pose, n: Vector, length: float) -> Pose:
    """Return a pose with b pushed along n, unit, in the frame of a."""
    offset = plus(pose.offset, scaled(n, length))
    return Pose(pose.axes, offset, pose.size, pose.gap_bound, pose.point_bound)


@njit(merge=True)
def pushed(bodies: MeshPair, n: Vector, length: float) -> MeshPair:
    """Return the bodies with b pushed along n, unit, in the frame of a."""
    trees_a, a, trees_b, b, pose = bodies
    way = combined(a.place.axes, scaled(n, length))
    place = Place(plus(b.place.center, way), b.place.axes)
    return MeshPair(trees_a, a, trees_b, MeshAt(b.mesh, place), moved_by(pose, n, length))


@njit(refcount=False)
def contacts_of(bodies: MeshPair, room: TreeRoom) -> tuple[int, int]:
    """Write the triangles that touch, as many as there is room for; return verdict and number."""
    search = Contacting(ALL, UNLIMITED, room.contacts, room.waiting)
    verdict, found = descend(bodies, search, 0, 0)
    return verdict, min(found, len(room.contacts))


@njit(refcount=False)
def farthest_way_out(
    bodies: MeshPair, frame: FlatFrame, contacts: np.ndarray, count: int
) -> tuple[float, int]:
    """Return the longest way out of the first contacts, metres, and the row that has it."""
    unit, back = unit_scale(bodies.pose.size)
    best, row = -np.inf, 0
    for k in range(count):
        p, q = triangles_of(bodies, contacts[k, 1], contacts[k, 2], unit)
        way = way_out(p, q, frame, best)
        if way > best:
            best, row = way, k
    return best * back, row


@njit(refcount=False)
def push_out(bodies: MeshPair, needed: float, n: Vector, most: float, room: TreeRoom) -> Push:
    """Return the shortest push of b along n, unit, after which it is certainly free.

    needed: how far apart they are then, for their radii. Given up past ``most``. Not the shortest
    for bodies within each other, or with a radius.
    """
    size = bodies.pose.size
    unit, back = unit_scale(size)
    frame, zero = frame_of(n), (0.0, 0.0, 0.0)
    margin = MARGIN * size + MESH_UNDERFLOW
    limit = (needed + 0.5 * margin) * unit + 2.0 * SLACK
    length, s, t, across = 0.0, -1, -1, n
    for _ in range(PLACES):
        if not length <= most:
            break
        here = pushed(bodies, n, length)
        verdict, count = contacts_of(here, room)
        if verdict != SEPARATE:
            way, row = farthest_way_out(here, frame, room.contacts, count)
            s, t = room.contacts[row, 1], room.contacts[row, 2]
            length += max(way, 0.0) + margin
            continue
        inside = nesting(here, room.waiting)[0] != SEPARATE
        bound = np.inf if inside else limit
        near = nearest_triangles(here, unit, bound, room)
        if inside:
            length += 1.25 * max(near.lower * back, margin)
            continue
        if near.s >= 0:
            s, t, across = near.s, near.t, scaled(near.direction, -1.0)
        if near.lower * back > needed + CERTAIN * size:
            if s < 0:
                break
            _, x, y = points_of(here, s, t, unit)
            y = minus(scaled(y, back), scaled(n, length))
            return Push(length, scaled(x, back), y, across)
        slope = dot(n, across)
        if near.s < 0 or slope < LEAST_SLOPE:
            break
        length += (needed + margin - near.lower * back) / slope
    return Push(np.inf, zero, zero, n)
