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
push along some directions: the normal of their hulls; the way that takes all triangles in contact
out of each other, each along the normal of the one or the other that is the shorter way; the mean
of these normals, and some of them as different as possible; and then, as long as it gets better,
the direction across which the meshes touch at the end of the best push (Je, Tang, Lee, Lin, Kim
2012, PolyDepth). Each push ends where they certainly are apart. So the depth is never too small to
part them, at most that of their hulls, and for convex meshes the least.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import (
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
from obb_collision.queries.convex.contacts import frame_of
from obb_collision.queries.convex.distances import turned_back
from obb_collision.queries.mesh_contacts.push import (
    CONTACTS,
    MARGIN,
    Push,
    contacts_of,
    farthest_way_out,
    push_out,
    seen_from_first,
    way_out,
)
from obb_collision.queries.meshes.mesh_clearance import Radii
from obb_collision.queries.meshes.placed import MeshPair, body_at
from obb_collision.queries.meshes.triangles import Triangle
from obb_collision.queries.meshes.two_trees import (
    TreeRoom,
    nearest_triangles,
    tree_room,
    triangles_of,
)
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.typing import Floats, Vector

#: Normals of single triangles that are tried.
NORMALS = 6
#: Triangles in contact whose normals are looked at, spread over all.
LOOKED_AT = 64
#: The direction is changed until the push is not shorter by this fraction, or so many times.
BETTER = 1e-3
CHANGES = 6
#: Turns of all triangles in contact, to find a way out for all.
TURNS = 8
#: Normals of which the cosine is above this are one.
ALIKE = 0.999
#: ... and directions of which it is above this have the same push.
SAME = 1.0 - 1e-12
#: Squared area below which triangles, of size about one, have no normal.
SMALLEST_AREA = 1e-300


#: Depths (m,), normals and positions (m, 3).
DepthArrays = tuple[Floats, Floats, Floats]


class PushDirections(NamedTuple):
    """PushDirections to push b along, in the frame of a."""

    all: Floats  #: (LOOKED_AT, 3) unit normals of triangles in contact; those of b reversed
    short: Floats  #: (LOOKED_AT,) the ways out along these, scaled
    chosen: Floats  #: (NORMALS + 6, 3)
    least: Floats  #: (NORMALS + 6,) no push along it is shorter
    contacts: np.ndarray  #: (LOOKED_AT, 4) some triangles that touch at first
    room: TreeRoom  #: work space


@njit
def depth_kernel(pairs: RowPairs, radii: Radii, found: DepthArrays, start: int, stop: int) -> None:
    """Replace depths (m,), normals and positions (m, 3) of pairs that collide by shorter ones.

    As given they are those of anything that contains the bodies.
    """
    chosen, least = np.empty((NORMALS + 6, 3)), np.empty(NORMALS + 6)
    contacts = np.empty((LOOKED_AT, 4), np.int64)
    all_n, short = np.empty((LOOKED_AT, 3)), np.empty(LOOKED_AT)
    ways = PushDirections(all_n, short, chosen, least, contacts, tree_room(CONTACTS))
    depths, normals, positions = found
    for row in range(start, stop):
        place = body_at(pairs.a, pairs.rows_a[row]).place
        radius, other = radii[0][pairs.rows_a[row]], radii[1][pairs.rows_b[row]]
        most = depths[row]
        bodies = seen_from_first(pairs, row, (radius, other, most))
        n = turned_back(place, vector_at(normals, row))
        most += 2.0 * MARGIN * bodies.pose.size
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
    first = min(contacts, LOOKED_AT)
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
    for _ in range(CHANGES):
        way = best.across
        if not best.length <= most or dot(way, n) > SAME:
            break
        push = push_out(bodies, needed, way, length, room)
        if not push.length < length:
            break
        small = push.length > (1.0 - BETTER) * length
        best, n, length = push, way, push.length
        if small:
            break
    return best, n


@njit(merge=True)
def _write_directions(bodies: MeshPair, n: Vector, contacts: int, ways: PushDirections) -> int:
    """Write directions to try, the given one first; return their number."""
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
    found, mean = 0, (0.0, 0.0, 0.0)
    step = max(1, contacts // LOOKED_AT)
    for k in range(0, min(contacts, step * LOOKED_AT), step):
        p, q = triangles_of(bodies, room.contacts[k, 1], room.contacts[k, 2], unit)
        ways.short[found] = np.inf
        for side in range(2):
            m, has_one = _normal(p if side == 0 else q)
            if not has_one:
                continue
            m = m if side == 0 else negated(m)
            solid = solid_a if side == 0 else solid_b
            for _ in range(1 if solid else 2):  # orientations of surfaces mean nothing
                way = way_out(p, q, frame_of(m), -np.inf)
                if way < ways.short[found]:
                    ways.short[found] = way
                    write_at(ways.all, found, m)
                m = negated(m)
        if ways.short[found] < np.inf:
            mean = plus(mean, vector_at(ways.all, found))
            found += 1
    chosen = _put_unit(ways.chosen, _put_unit(ways.chosen, 1, _out_of_all(ways, found)), mean)
    if not (solid_a and solid_b):  # back, too
        for k in range(chosen):
            write_at(ways.chosen, chosen + k, negated(vector_at(ways.chosen, k)))
        chosen *= 2
    return _spread(ways, found, chosen)


@njit
def _out_of_all(ways: PushDirections, found: int) -> Vector:
    """Return a short translation that takes each of the triangles its way out along its normal.

    By turns, each as far as the others have left it (Kaczmarz 1937).
    """
    sum_of = 0.0, 0.0, 0.0
    for _ in range(TURNS):
        for k in range(found):
            n = vector_at(ways.all, k)
            left = ways.short[k] - dot(n, sum_of)
            if left > 0.0:
                sum_of = plus(sum_of, scaled(n, left))
    return sum_of


@njit
def _put_unit(rows: Floats, row: int, v: Vector) -> int:
    """Write the unit vector along v, if it has one; return the number of rows."""
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
def _spread(ways: PushDirections, found: int, chosen: int) -> int:
    """Choose normals as different as possible from those chosen (Gonzalez 1985)."""
    for _ in range(NORMALS):
        best, least = -1, ALIKE
        for k in range(found):
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
