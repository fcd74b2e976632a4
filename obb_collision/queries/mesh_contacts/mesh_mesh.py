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

"""Depth of the overlap of two meshes: a short push that certainly parts them.

The least translation that parts two meshes that are not convex is out of reach (it may take a
comparison of all their triangles with all others, three at a time). What is found is the shortest
push along some directions: the normal of their hulls; a translation that takes all triangles in
contact out of each other, each along the normal with the shorter way; the mean of these normals,
and some of them as different as possible; and then, as long as it gets better, the direction across
which the meshes touch at the end of the best push (Je, Tang, Lee, Lin, Kim 2012, PolyDepth). Each
push ends where they certainly are apart. So the depth is never too small to part them, at most that
of their hulls, and for convex meshes the least.

A push. ``way_out`` is how far a triangle must go until it no longer touches another. Seen along the
direction both are flat, with a height at each point. The way out is the largest difference of
heights where the two lie over each other, which is at a corner of the one over the other, or where
two edges cross (a linear function over a convex polygon). It is never more than the way past all
corners, which applies to triangles seen edge-on.

At a place where triangles touch, no place nearer than the farthest way out of any two of them is
free: each pair touches from the start of its way to its end, without a gap. So the push goes there
at once, looks again, and ends at the first place, in steps of ``PUSH_MARGIN``, where nothing
touches and the distance is certain. Bodies with a radius are pushed on until the distance is that
of the radii: the distance of two convex sets along a way is convex, so its slope leads past it, not
short of it. A body within the other is pushed by its distance from the surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.vec3 import (
    ZERO,
    careful_cross,
    combined,
    dot,
    max_abs,
    minus,
    negated,
    plus,
    scaled,
    vector_at,
    write_at,
)
from obb_collision.queries.convex.contacts import FlatFrame, frame_of
from obb_collision.queries.convex.distances import ConvexDistances, turned_back
from obb_collision.queries.meshes.mesh_mesh import (
    NO_VERDICT,
    UNLIMITED,
    MeshClearances,
    Radii,
    nesting,
)
from obb_collision.queries.meshes.placed import (
    MeshAt,
    MeshPair,
    PairPose,
    Place,
    body_at,
    relative_pose,
)
from obb_collision.queries.meshes.trees import (
    SAME_DISTANCE,
    ContactSearch,
    TreeRoom,
    find_contacts,
    nearest_triangles,
    points_of,
    scaled_triangles,
    tree_room,
)
from obb_collision.queries.meshes.triangles import Triangle
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.queries.verdict.verdict import SEPARATE, Separations
from obb_collision.typing import Floats, Integers, Vector

#: Maximum number of normals of single triangles that are tried.
TRIED_NORMALS = 6
#: Maximum number of triangles in contact whose normals are examined, spread over all.
SAMPLED_CONTACTS = 64
#: The direction is changed until the push is not shorter by this fraction, or so many times.
WORTHWHILE_GAIN = 1e-3
MOST_CHANGES = 6
#: Rounds over the triangles in contact that find a way out of all.
KACZMARZ_ROUNDS = 8
#: Normals whose cosine is above this count as equal.
SAME_NORMAL = 0.999
#: ... and directions of which it is above this have the same push.
SAME_DIRECTION = 1.0 - 1e-12
#: Squared area below which triangles, of size about one, have no normal.
SMALLEST_AREA = 1e-300


#: Depths (m,), normals and positions (m, 3).
DepthArrays = tuple[Floats, Floats, Floats]


class PushDirections(NamedTuple):
    """Directions to push b along, in the frame of a."""

    all: Floats  #: (SAMPLED_CONTACTS, 3) unit normals of triangles in contact; those of b reversed
    short: Floats  #: (SAMPLED_CONTACTS,) the ways out along these, scaled
    chosen: Floats  #: (TRIED_NORMALS + 6, 3)
    least: Floats  #: (TRIED_NORMALS + 6,) no push along it is shorter
    contacts: np.ndarray  #: (SAMPLED_CONTACTS, 4) some triangles that touch at first
    room: TreeRoom  #: work space


def replace_outer(
    outer: Separations,
    lower: Floats,
    near: ConvexDistances | MeshClearances,
    shorten: Callable[[Integers, DepthArrays], object],
) -> Separations:
    """Replace the separations (m,) of bodies that contain others by those of the others.

    lower (m,), near: bounds, points and normals of their distances. shorten: replaces depths,
    normals and positions of rows by shorter ones.
    """
    values, normals, positions = outer.separations, outer.normals, outer.positions
    apart = near.upper > 0.0
    farther = apart & ~(values > lower)
    values[farther], normals[farther] = lower[farther], near.normals[farther]
    positions[farther] = 0.5 * (near.positions_a + near.positions_b)[farther]
    deep = np.flatnonzero(~apart & (values <= 0.0))
    depths, n, middles = np.maximum(-values[deep], 0.0), normals[deep], positions[deep]
    shorten(deep, (depths, n, middles))
    values[deep], normals[deep], positions[deep] = -depths, n, middles
    return outer


@njit
def depth_kernel(pairs: RowPairs, radii: Radii, out: DepthArrays, start: int, stop: int) -> None:
    """Replace depths (m,), normals and positions (m, 3) of pairs that collide by shorter ones.

    On entry they are those of bodies that contain the meshes.
    """
    chosen, least = np.empty((TRIED_NORMALS + 6, 3)), np.empty(TRIED_NORMALS + 6)
    contacts = np.empty((SAMPLED_CONTACTS, 4), np.int64)
    all_n, short = np.empty((SAMPLED_CONTACTS, 3)), np.empty(SAMPLED_CONTACTS)
    ways = PushDirections(all_n, short, chosen, least, contacts, tree_room(CONTACT_ROOM))
    depths, normals, positions = out
    for row in range(start, stop):
        place = body_at(pairs.a, pairs.rows_a[row]).place
        radius, other = radii[0][pairs.rows_a[row]], radii[1][pairs.rows_b[row]]
        most = depths[row]
        bodies = seen_from_first(pairs, row, (radius, other, most))
        n = turned_back(place, vector_at(normals, row))
        most += 2.0 * PUSH_MARGIN * bodies.pose.size
        best, n = _shortest(bodies, radius + other, n, most, ways)
        if not best.length <= most:
            continue
        p = plus(best.p, scaled(best.across, radius))
        q = minus(best.q, scaled(best.across, other))
        middle = plus(combined(place.axes, scaled(plus(p, q), 0.5)), place.center)
        n = combined(place.axes, n)
        depths[row] = best.length
        write_at(normals, row, n)
        write_at(positions, row, middle)


@njit(merge=True)
def _shortest(
    bodies: MeshPair, needed: float, n: Vector, most: float, ways: PushDirections
) -> tuple[Push, Vector]:
    """Return the shortest push found, and its direction, unit, in the frame of a."""
    room = ways.room
    _, contacts = contacts_of(bodies, room)
    count = _write_directions(bodies, n, contacts, ways)
    first = min(contacts, SAMPLED_CONTACTS)
    for k in range(first):  # the room is for the places to come
        for c in range(4):
            ways.contacts[k, c] = room.contacts[k, c]
    for k in range(count):
        frame = frame_of(vector_at(ways.chosen, k))
        ways.least[k], _ = farthest_way_out(bodies, frame, ways.contacts, first)
    best, length = Push(np.inf, n, n, n), most
    for _ in range(count):
        next_one = 0
        for k in range(1, count):
            if ways.least[k] < ways.least[next_one]:
                next_one = k
        if not ways.least[next_one] < length:
            break
        ways.least[next_one] = np.inf
        way = vector_at(ways.chosen, next_one)
        push = push_out(bodies, needed, way, length, room)
        if push.length < length:
            best, n, length = push, way, push.length
    for _ in range(MOST_CHANGES):
        way = best.across
        if not best.length <= most or dot(way, n) > SAME_DIRECTION:
            break
        push = push_out(bodies, needed, way, length, room)
        if not push.length < length:
            break
        small = push.length > (1.0 - WORTHWHILE_GAIN) * length
        best, n, length = push, way, push.length
        if small:
            break
    return best, n


@njit(merge=True)
def _write_directions(bodies: MeshPair, n: Vector, contacts: int, ways: PushDirections) -> int:
    """Write directions to try, first n; return their number."""
    room = ways.room
    solid_a = bodies.trees_a.solid[bodies.a.mesh]
    solid_b = bodies.trees_b.solid[bodies.b.mesh]
    unit, _ = unit_scale(bodies.pose.size)
    write_at(ways.chosen, 0, n)
    if contacts == 0:
        near = nearest_triangles(bodies, unit, np.inf, room)
        write_at(ways.chosen, 1, near.direction)
        write_at(ways.chosen, 2, negated(near.direction))
        return 3
    count, mean = 0, ZERO
    step = max(1, contacts // SAMPLED_CONTACTS)
    for k in range(0, min(contacts, step * SAMPLED_CONTACTS), step):
        p, q = scaled_triangles(bodies, room.contacts[k, 1], room.contacts[k, 2], unit)
        ways.short[count] = np.inf
        for side in range(2):
            m, has_one = _normal(p if side == 0 else q)
            if not has_one:
                continue
            m = m if side == 0 else negated(m)
            solid = solid_a if side == 0 else solid_b
            for _ in range(1 if solid else 2):  # orientations of surfaces mean nothing
                way = way_out(p, q, frame_of(m), -np.inf)
                if way < ways.short[count]:
                    ways.short[count] = way
                    write_at(ways.all, count, m)
                m = negated(m)
        if ways.short[count] < np.inf:
            mean = plus(mean, vector_at(ways.all, count))
            count += 1
    chosen = _put_unit(ways.chosen, _put_unit(ways.chosen, 1, _out_of_all(ways, count)), mean)
    if not (solid_a and solid_b):  # back, too
        for k in range(chosen):
            write_at(ways.chosen, chosen + k, negated(vector_at(ways.chosen, k)))
        chosen *= 2
    return _spread(ways, count, chosen)


@njit
def _out_of_all(ways: PushDirections, count: int) -> Vector:
    """Return a short translation that moves each triangle its way out along its normal.

    One triangle after another, each by the rest of its way (Kaczmarz 1937), round after round.
    """
    sum_of = 0.0, 0.0, 0.0
    for _ in range(KACZMARZ_ROUNDS):
        for k in range(count):
            n = vector_at(ways.all, k)
            left = ways.short[k] - dot(n, sum_of)
            if left > 0.0:
                sum_of = plus(sum_of, scaled(n, left))
    return sum_of


@njit
def _put_unit(rows: Floats, row: int, v: Vector) -> int:
    """Write the unit vector along v, unless v is zero; return the number of rows."""
    largest = max_abs(v)
    if not largest > 0.0:
        return row
    v = scaled(v, 1.0 / largest)
    write_at(rows, row, scaled(v, 1.0 / math.sqrt(dot(v, v))))
    return row + 1


@njit
def _normal(t: Triangle) -> tuple[Vector, bool]:
    """Return the unit normal of a triangle, and whether it has one."""
    n = careful_cross(minus(t[1], t[0]), minus(t[2], t[0]))
    square = dot(n, n)
    if not square > SMALLEST_AREA:
        return n, False
    return scaled(n, 1.0 / math.sqrt(square)), True


@njit
def _spread(ways: PushDirections, count: int, chosen: int) -> int:
    """Choose normals as different as possible from those chosen (Gonzalez 1985)."""
    for _ in range(TRIED_NORMALS):
        best, least = -1, SAME_NORMAL
        for k in range(count):
            n, likeness = vector_at(ways.all, k), -1.0
            for other in range(chosen):
                likeness = max(likeness, dot(n, vector_at(ways.chosen, other)))
            if likeness < least:
                best, least = k, likeness
        if best < 0:
            break
        write_at(ways.chosen, chosen, vector_at(ways.all, best))
        chosen += 1
    return chosen


#: Places outside of an edge or a face by this or less, relative to it, are on it.
EDGE_SLACK = 1e-12


@njit
def way_out(p: Triangle, q: Triangle, frame: FlatFrame, enough: float) -> float:
    """Return how far q must go along the normal of a frame until it no longer touches p.

    Not too short, up to rounding; -inf for triangles beside each other, or if certainly not more
    than ``enough``.
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
    """Return a triangle in a frame."""
    return _along(t[0], frame), _along(t[1], frame), _along(t[2], frame)


@njit
def _along(v: Vector, frame: FlatFrame) -> Vector:
    return dot(frame.x, v), dot(frame.y, v), dot(frame.n, v)


@njit
def _turned(t: Triangle) -> Triangle:
    """Return a triangle with its heights reversed, so that its highest point is the lowest."""
    (a, b, c), (d, e, f), (g, h, i) = t
    return (a, b, -c), (d, e, -f), (g, h, -i)


@njit
def _area(a: Vector, b: Vector, c: Vector) -> float:
    """Return twice the area of a flat triangle, positive if counterclockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@njit
def _height(t: Triangle, v: Vector) -> float:
    """Return the height of a triangle over a point, minus infinity beside it."""
    a, b, c = t
    area = _area(a, b, c)
    if area == 0.0:
        return -np.inf
    y, z = _area(a, v, c) / area, _area(a, b, v) / area
    if min(y, z, 1.0 - y - z) < -EDGE_SLACK:
        return -np.inf
    y, z = min(max(y, 0.0), 1.0), min(max(z, 0.0), 1.0)
    x = max(1.0 - y - z, 0.0)
    return x * a[2] + y * b[2] + z * c[2]


@njit
def _edges_apart(a: Vector, b: Vector, c: Vector, d: Vector) -> float:
    """Return how far the edge from a to b is above the edge from c to d where they cross."""
    ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    turn = ux * vy - uy * vx
    if turn == 0.0:
        return -np.inf
    wx, wy = c[0] - a[0], c[1] - a[1]
    s, t = (wx * vy - wy * vx) / turn, (wx * uy - wy * ux) / turn
    if min(s, t) < -EDGE_SLACK or max(s, t) > 1.0 + EDGE_SLACK:
        return -np.inf
    s, t = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)
    return a[2] + s * (b[2] - a[2]) - c[2] - t * (d[2] - c[2])


#: Push beyond the last contact, relative to S: an eighth of the promised accuracy.
PUSH_MARGIN = 2.0**-33
#: A gap there of at least this, relative to S, proves a gap at the place itself.
CERTAIN_GAP = 0.25 * PUSH_MARGIN
#: Maximum number of places tried; most pushes end at the second.
MOST_PLACES = 48
#: A distance that grows by less than this per length of a push is not worth it.
LEAST_SLOPE = 0.05
#: Maximum number of pairs of triangles examined at a place; the next place shows the others.
CONTACT_ROOM = 512


class Push(NamedTuple):
    """A push of b, metres; infinite if b is not certainly free."""

    length: float
    p: Vector  #: the point of a that is nearest then, in its frame
    q: Vector  #: the same of b, before the push
    across: Vector  #: unit, from a to b: along it they are apart then


@njit(merge=True)
def seen_from_first(pairs: RowPairs, n: int, more: Vector) -> MeshPair:
    """Return a pair in a frame at the centre of its first body; more: both radii, and a push."""
    trees_a, trees_b = pairs.a.trees, pairs.b.trees
    a, b = body_at(pairs.a, pairs.rows_a[n]), body_at(pairs.b, pairs.rows_b[n])
    reach = trees_a.radii[a.mesh] + trees_b.radii[b.mesh] + more[0] + more[1] + more[2]
    offset = minus(b.place.center, a.place.center)
    first, second = Place(ZERO, a.place.axes), Place(offset, b.place.axes)
    pose = relative_pose(first, second, reach)
    return MeshPair(trees_a, MeshAt(a.mesh, first), trees_b, MeshAt(b.mesh, second), pose)


@njit(refcount=False)
def moved_by(pose: PairPose, n: Vector, length: float) -> PairPose:
    """Return a pose with b pushed along n, unit, in the frame of a."""
    offset = plus(pose.offset, scaled(n, length))
    return PairPose(pose.axes, offset, pose.size, pose.gap_bound, pose.point_bound)


@njit(merge=True)
def pushed(bodies: MeshPair, n: Vector, length: float) -> MeshPair:
    """Return the pair with b pushed along n, unit, in the frame of a."""
    trees_a, a, trees_b, b, pose = bodies
    way = combined(a.place.axes, scaled(n, length))
    place = Place(plus(b.place.center, way), b.place.axes)
    return MeshPair(trees_a, a, trees_b, MeshAt(b.mesh, place), moved_by(pose, n, length))


@njit(refcount=False)
def contacts_of(bodies: MeshPair, room: TreeRoom) -> tuple[int, int]:
    """Write the triangles that touch, as far as there is room; return verdict and number."""
    search = ContactSearch(NO_VERDICT, UNLIMITED, room.contacts, room.waiting)
    verdict, count = find_contacts(bodies, search, 0, 0)
    return verdict, min(count, len(room.contacts))


@njit(refcount=False)
def farthest_way_out(
    bodies: MeshPair, frame: FlatFrame, contacts: np.ndarray, count: int
) -> tuple[float, int]:
    """Return the longest way out of the first contacts, metres, and its row."""
    unit, back = unit_scale(bodies.pose.size)
    best, row = -np.inf, 0
    for k in range(count):
        p, q = scaled_triangles(bodies, contacts[k, 1], contacts[k, 2], unit)
        way = way_out(p, q, frame, best)
        if way > best:
            best, row = way, k
    return best * back, row


@njit(refcount=False)
def push_out(bodies: MeshPair, needed: float, n: Vector, most: float, room: TreeRoom) -> Push:
    """Return the shortest push of b along n, unit, after which it is certainly free.

    needed: the distance then, for their radii. Ends past ``most``. Not the shortest for bodies
    within each other, or with a radius.
    """
    size = bodies.pose.size
    unit, back = unit_scale(size)
    frame, zero = frame_of(n), ZERO
    margin = PUSH_MARGIN * size + MESH_UNDERFLOW
    limit = (needed + 0.5 * margin) * unit + 2.0 * SAME_DISTANCE
    length, s, t, across = 0.0, -1, -1, n
    for _ in range(MOST_PLACES):
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
        if near.lower * back > needed + CERTAIN_GAP * size:
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
