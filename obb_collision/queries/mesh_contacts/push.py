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

"""How far a mesh must be pushed along a direction until it certainly no longer collides.

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
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.vec3 import combined, dot, minus, plus, scaled
from obb_collision.queries.convex.patch import Frame, frame_of
from obb_collision.queries.mesh_contacts.way_out import way_out
from obb_collision.queries.meshes.kernels import nesting
from obb_collision.queries.meshes.tree_boxes import Place, Pose, moved, relative_pose
from obb_collision.queries.meshes.tree_descent import Body, Search, descend
from obb_collision.queries.meshes.tree_distance import SLACK, Room, nearest_triangles, points_of
from obb_collision.queries.meshes.triangle_signs import OVERLAP, SEPARATE, Triangle, triangle_at
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.typing import Vector

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


class Sides(NamedTuple):
    """Two bodies of trees that come with them: where they are, the second seen from the first."""

    a: Body
    b: Body
    pose: Pose
    radius_a: float
    radius_b: float


class Push(NamedTuple):
    """How far b is pushed, metres, infinite where it is not certainly free."""

    length: float
    p: Vector  #: the point of a that is nearest then, in its frame
    q: Vector  #: the same of b, before the push
    across: Vector  #: unit, from a to b: along it they are apart then


@njit
def sides_at(
    trees_a: TreeArrays, a: Body, radius_a: float, trees_b: TreeArrays, b: Body, radius_b: float,
    way: float,
) -> Sides:  # fmt: skip
    """Return two bodies seen from the first one; way: how far one is pushed at most."""
    reach = trees_a.radii[a.mesh] + trees_b.radii[b.mesh] + radius_a + radius_b + way
    zero = 0.0, 0.0, 0.0
    first, second = Place(zero, a.place.axes), Place(_offset(a, b), b.place.axes)
    pose = relative_pose(first, second, reach)
    return Sides(Body(a.mesh, first), Body(b.mesh, second), pose, radius_a, radius_b)


@njit
def _offset(a: Body, b: Body) -> Vector:
    return minus(b.place.center, a.place.center)


@njit
def pushed(sides: Sides, n: Vector, length: float) -> Sides:
    """Return the sides with b pushed along n, unit, in the frame of a."""
    a, b, pose = sides.a, sides.b, sides.pose
    way = scaled(n, length)
    offset = plus(pose.offset, way)
    place = Place(plus(b.place.center, combined(a.place.axes, way)), b.place.axes)
    moved_pose = Pose(pose.axes, offset, pose.size, pose.gap_bound, pose.point_bound)
    return Sides(a, Body(b.mesh, place), moved_pose, sides.radius_a, sides.radius_b)


@njit
def contacts_of(
    trees_a: TreeArrays, trees_b: TreeArrays, sides: Sides, room: Room
) -> tuple[int, int]:
    """Write the triangles that touch, as many as there is room for; return verdict and number."""
    search = Search(ALL, UNLIMITED, room.contacts, room.stack)
    verdict, found = descend(trees_a, sides.a, trees_b, sides.b, sides.pose, search, 0, 0)
    return verdict, min(found, len(room.contacts))


@njit
def triangles_of(
    trees_a: TreeArrays, s: int, trees_b: TreeArrays, t: int, pose: Pose, unit: float
) -> tuple[Triangle, Triangle]:
    """Return triangles s and t in the frame of a, scaled."""
    p, q = triangle_at(trees_a.triangles, s), triangle_at(trees_b.triangles, t)
    return (
        (scaled(p[0], unit), scaled(p[1], unit), scaled(p[2], unit)),
        (
            scaled(moved(pose, q[0]), unit),
            scaled(moved(pose, q[1]), unit),
            scaled(moved(pose, q[2]), unit),
        ),
    )


@njit
def farthest_way_out(
    trees_a: TreeArrays, trees_b: TreeArrays, sides: Sides, frame: Frame, contacts: np.ndarray,
    count: int,
) -> tuple[float, int]:  # fmt: skip
    """Return the longest way out of the first contacts, metres, and the row that has it."""
    unit, back = unit_scale(sides.pose.size)
    best, row = -np.inf, 0
    for k in range(count):
        s, t = contacts[k, 1], contacts[k, 2]
        p, q = triangles_of(trees_a, s, trees_b, t, sides.pose, unit)
        way = way_out(p, q, frame, best)
        if way > best:
            best, row = way, k
    return best * back, row


@njit
def push_out(
    trees_a: TreeArrays, trees_b: TreeArrays, sides: Sides, n: Vector, most: float, room: Room
) -> Push:
    """Return the shortest push of b along n, unit, after which it is certainly free.

    Given up past ``most``. Not the shortest for bodies within each other, or with a radius.
    """
    unit, back = unit_scale(sides.pose.size)
    frame, zero = frame_of(n), (0.0, 0.0, 0.0)
    margin = MARGIN * sides.pose.size + MESH_UNDERFLOW
    needed = sides.radius_a + sides.radius_b
    limit = (needed + 0.5 * margin) * unit + 2.0 * SLACK
    length, s, t, across = 0.0, -1, -1, n
    for _ in range(PLACES):
        if not length <= most:
            break
        here = pushed(sides, n, length)
        verdict, count = contacts_of(trees_a, trees_b, here, room)
        if verdict != SEPARATE:
            way, row = farthest_way_out(trees_a, trees_b, here, frame, room.contacts, count)
            s, t = room.contacts[row, 1], room.contacts[row, 2]
            length += max(way, 0.0) + margin
            continue
        inside = nesting(trees_a, here.a, trees_b, here.b, here.pose, room.stack)[0] != SEPARATE
        bound = np.inf if inside else limit
        near = nearest_triangles(trees_a, here.a, trees_b, here.b, here.pose, unit, bound, room)
        if inside:
            length += 1.25 * max(near.lower * back, margin)
            continue
        if near.s >= 0:
            s, t, across = near.s, near.t, scaled(near.direction, -1.0)
        if near.lower * back > needed + CERTAIN * sides.pose.size:
            if s < 0:
                break
            _, x, y = points_of(trees_a, s, trees_b, t, here.pose, unit)
            y = minus(scaled(y, back), scaled(n, length))
            return Push(length, scaled(x, back), y, across)
        slope = dot(n, across)
        if near.s < 0 or slope < LEAST_SLOPE:
            break
        length += (needed + margin - near.lower * back) / slope
    return Push(np.inf, zero, zero, n)
