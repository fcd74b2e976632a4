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

"""Contacts of convex bodies: their supporting features, clipped on each other.

The feature of a body along the normal: its corners that reach farther than the other body's
nearest plane, in the plane across the normal the polygon about them, or a segment or a point. Of
ends of cylinders and cones RIM_POINTS points of the rim stand for it. The overlay of both polygons
(Sutherland and Hodgman; Ericson 2005, 5.5) has the contacts. Its points in the one body's plane lie
in that body, in the other's plane in the other one; a contact is halfway between.

Of a tip of angle t, what is clipped at both sides may be e / t beyond it, for e the rounding of a
distance from a line. So where there are tips each corner p of the overlay, which is in the polygon
that was clipped, is put on the nearest point q of the one that clips. If q is on a side or a
corner of 90 degrees or more, p is within 2 e of it. Else let x be a point of both: not beyond the
two sides of the tip, and p by e at most. Where the way from x to p passes the tip, it is at most
2 sqrt(2) e beside it: and so q is that near to the polygon that was clipped. There is such an x if
a p is not beyond a tip, or if two are beyond different ones; else the features do not lie over each
other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.numerics.intrinsics import LANES
from obb_collision.numerics.vec3 import (
    ZERO,
    components,
    cross,
    dot,
    fast_norm,
    plus,
    scaled,
    vector_at,
    write_at,
)
from obb_collision.queries.contacts.contacts import NO_AXIS, ContactArrays, Contacts
from obb_collision.queries.convex.distance import unit_of
from obb_collision.queries.convex.distances import ConvexDistances, in_world, turned_back
from obb_collision.queries.convex.support import (
    BOX_CORE,
    CONE_CORE,
    CYLINDER_CORE,
    HULL_CORE,
    ConvexBodies,
    Core,
    body_place,
    core_at,
    support,
)
from obb_collision.queries.meshes.placed import PairPose, moved, relative_pose
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.typing import Floats, Integers, Vector

#: Points that stand for the rim of an end of a cylinder, or of the base of a cone.
RIM_POINTS = 16
#: Maximum number of points of a feature. If there are more, the polygon is made early, and later
#: points join its corners, or every second corner if they are more than half as many.
MOST_POINTS = 128
#: Gaps of Shell sort (Ciura 2001).
SORT_GAPS = (57, 23, 10, 4, 1)
#: Corners at most this far below the foremost one belong to the feature, relative to S: as in
#: contacts of boxes.
FEATURE_DEPTH = 2.0**-31
#: Rounding of distances from lines, relative to S: 2048 unit roundoffs, where 20 are needed. Sides
#: that are not longer are ignored.
LINE_SLACK = 2.0**-42
#: Maximum distance of the overlay from the clipping polygon, and minimum distance of two tips.
CLIP_DISTANCE = 2.0**-36
#: Cosine between two sides that make a tip, of 2^-12 rad: others lose less than 1e-11 of S.
TIP_COSINE = -1.0 + 2.0**-25
#: Components of flat points: along both axes across the normal, and how far below the foremost.
FLAT_COLUMNS = 3


class Flat(NamedTuple):
    """Polygons across the normal: rows (x, y, how far below the foremost corner)."""

    a: Floats  #: (2 MOST_POINTS, 3)
    b: Floats
    spare: Floats


class FlatFrame(NamedTuple):
    """Axes across a normal, and the normal, in the frame of a."""

    x: Vector
    y: Vector
    n: Vector


@njit
def frame_of(n: Vector) -> FlatFrame:
    """Return axes across a unit vector."""
    other = (1.0, 0.0, 0.0) if abs(n[0]) < 0.5 else (0.0, 1.0, 0.0)
    x = unit_of(cross(n, other))[0]
    return FlatFrame(x, cross(n, x), n)


@njit(merge=True)
def overlay(a: Core, b: Core, pose: PairPose, frame: FlatFrame, depth: float, flat: Flat) -> int:
    """Write the overlay of the features of two cores to ``flat.a``; return its corners.

    Zero corners for two segments or points, and where features do not lie over each other. depth:
    of the cores along the normal of the frame.
    """
    below = max(depth, 0.0) + FEATURE_DEPTH * pose.size
    still = PairPose(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), ZERO, 0.0, 0.0, 0.0)
    first = _feature(a, still, frame, below, 1.0, flat.a, flat.spare)
    second = _feature(b, pose, frame, below, -1.0, flat.b, flat.spare)
    if second < 3 <= first:
        for k in range(max(first, second)):
            here, there = vector_at(flat.a, k), vector_at(flat.b, k)
            write_at(flat.a, k, there)
            write_at(flat.b, k, here)
        first, second = second, first
    if second < 3:  # two segments, or points: their nearest points are the contact
        return 0
    slack, sharp, far = LINE_SLACK * pose.size, False, np.inf
    before = opening = 0.0, 0.0, 0.0
    for k in range(second):
        start, end = vector_at(flat.b, k), vector_at(flat.b, (k + 1) % second)
        way = _way(start, end)
        length = fast_norm(way)
        if length > slack:
            way = scaled(way, 1.0 / length)
            sharp |= dot(before, way) < TIP_COSINE
            opening = way if opening[0] == 0.0 == opening[1] else opening
            before = way
            first = _clipped(flat, first, start, end)
    if not (sharp or dot(before, opening) < TIP_COSINE):
        return first
    apart = 0.0
    for k in range(first):
        far = min(far, _bring_in(flat.a, k, flat.b, second, slack))
        apart = max(apart, fast_norm(_way(vector_at(flat.a, 0), vector_at(flat.a, k))))
    return first if far <= CLIP_DISTANCE * pose.size or apart > CLIP_DISTANCE * pose.size else 0


@njit
def _bring_in(points: Floats, row: int, polygon: Floats, count: int, slack: float) -> float:
    """Move a point that may be outside of a polygon to its outline; return how far it moved.

    Of a point inside, the nearest point of the outline is on a side, not at its end. Sides shorter
    than ``slack`` have no direction.
    """
    p, q = vector_at(points, row), vector_at(polygon, 0)
    least, within = fast_norm(_way(p, q)), False
    for k in range(count):
        a, b = vector_at(polygon, k), vector_at(polygon, (k + 1) % count)
        side, length = _way(a, b), fast_norm(_way(a, b))
        if not length > slack:
            continue
        t = min(max(dot(scaled(side, 1.0 / length), _way(a, p)) / length, 0.0), 1.0)
        foot = a[0] + t * side[0], a[1] + t * side[1], p[2]
        away = fast_norm(_way(p, foot))
        if away < least:
            q, least, within = foot, away, _side(a, b, p) >= 0.5 * length * away
    if within:
        return 0.0
    points[row, 0], points[row, 1] = q[0], q[1]
    return least


@njit
def _way(a: Vector, b: Vector) -> Vector:
    """Return the way from a to b across the normal."""
    return b[0] - a[0], b[1] - a[1], 0.0


@njit
def _feature(
    core: Core,
    pose: PairPose,
    frame: FlatFrame,
    low: float,
    way: float,
    out: Floats,
    room: Floats,
) -> int:
    """Write the polygon about the points of a core near its end along the normal, times ``way``.

    Returns its corners. pose: of the core in the frame of a.
    """
    n = scaled(frame.n, way)
    turned = components(pose.axes, n)
    foremost = moved(pose, support(core, turned))
    top, count = dot(n, foremost), 0
    for k in range(_candidates(core)):
        p = moved(pose, _candidate(core, turned, k))
        drop = top - dot(n, p)
        if drop > low:
            continue
        if count == MOST_POINTS:
            count = _polygon(out, count, room)
            if count > MOST_POINTS // 2:  # keep every second corner
                count //= 2
                for m in range(count):
                    write_at(out, m, vector_at(out, 2 * m))
        out[count, 0], out[count, 1] = dot(frame.x, p), dot(frame.y, p)
        out[count, 2] = max(drop, 0.0)
        count += 1
    if count == 0:
        out[0, 0], out[0, 1], out[0, 2] = dot(frame.x, foremost), dot(frame.y, foremost), 0.0
        count = 1
    return _polygon(out, count, room)


@njit
def _candidates(core: Core) -> int:
    """Return the number of points that may be in a feature of a core."""
    if core.kind == HULL_CORE:
        return (core.last - core.first) * LANES
    if core.kind == BOX_CORE:
        return 8
    if core.kind == CYLINDER_CORE:
        return 2 * RIM_POINTS + 2
    if core.kind == CONE_CORE:
        return RIM_POINTS + 2
    return 2


@njit
def _candidate(core: Core, n: Vector, k: int) -> Vector:
    """Return the point with number k; n: the normal in the frame of the core."""
    if core.kind == HULL_CORE:
        blocks, block, lane = core.blocks, core.first + k // LANES, k % LANES
        return blocks[block, 0, lane], blocks[block, 1, lane], blocks[block, 2, lane]
    (x, y, z), half = core.size, core.half
    if core.kind == BOX_CORE:
        return (x if k & 1 else -x), (y if k & 2 else -y), (z if k & 4 else -z)
    if core.kind == CONE_CORE and k == RIM_POINTS + 1:
        return 0.0, 0.0, half
    if core.kind == CYLINDER_CORE or core.kind == CONE_CORE:
        last = 2 * RIM_POINTS if core.kind == CYLINDER_CORE else RIM_POINTS
        if k < last:
            angle = 2.0 * math.pi * (k % RIM_POINTS) / RIM_POINTS
            height = -half if k < RIM_POINTS else half
            return x * math.cos(angle), y * math.sin(angle), height
        rim = support(core, (n[0], n[1], 0.0))
        return rim[0], rim[1], -half if k == last else half
    point = support(core, n)  # of a core swept along a segment, at either end
    back = math.copysign(2.0 * half, n[2]) if k else 0.0  # as the support: -0.0 is below
    return point[0], point[1], point[2] - back


@njit
def _polygon(points: Floats, count: int, spare: Floats) -> int:
    """Replace points (count, 3) by their convex hull, counterclockwise (Andrew 1979)."""
    for gap in SORT_GAPS:
        for i in range(gap, count):
            k = i
            while k >= gap and (
                points[k, 0] < points[k - gap, 0]
                or (points[k, 0] == points[k - gap, 0] and points[k, 1] < points[k - gap, 1])
            ):
                for c in range(FLAT_COLUMNS):
                    points[k, c], points[k - gap, c] = points[k - gap, c], points[k, c]
                k -= gap
    size = 0
    for turn in range(2):
        start = size
        for step in range(count):
            i = step if turn == 0 else count - 1 - step
            p = vector_at(points, i)
            while size >= start + 2:
                if not _side(vector_at(spare, size - 2), vector_at(spare, size - 1), p) <= 0.0:
                    break
                size -= 1
            write_at(spare, size, p)
            size += 1
        size -= 1  # the last one begins the other half
    size = max(size, 1)
    for k in range(size):  # one by one: slices take long to compile
        write_at(points, k, vector_at(spare, k))
    if size == 2 and points[0, 0] == points[1, 0] and points[0, 1] == points[1, 1]:
        return 1
    return size


@njit
def _side(a: Vector, b: Vector, p: Vector) -> float:
    """Return a positive number where p is to the left of the line from a to b."""
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


@njit
def _clipped(flat: Flat, count: int, start: Vector, end: Vector) -> int:
    """Clip the polygon in ``flat.a`` to the left of a line; return its corners."""
    size = 0
    for k in range(count):
        here, there = vector_at(flat.a, k), vector_at(flat.a, (k + 1) % count)
        side, next_side = _side(start, end, here), _side(start, end, there)
        if side >= 0.0:
            write_at(flat.spare, size, here)
            size += 1
        if (side > 0.0 > next_side) or (side < 0.0 < next_side):
            t = side / (side - next_side)
            for c in range(FLAT_COLUMNS):
                flat.spare[size, c] = here[c] + t * (there[c] - here[c])
            size += 1
    size = min(size, 2 * MOST_POINTS - 2)
    for k in range(size):
        write_at(flat.a, k, vector_at(flat.spare, k))
    return size


@njit
def spread(points: Floats, count: int, limit: int) -> int:
    """Move at most ``limit`` of count points to the front; return their number.

    First the deepest, then repeatedly the point farthest from those before (Gonzalez 1985).
    """
    limit = min(limit, count)
    for taken in range(limit):
        best, far = taken, -1.0
        for k in range(taken, count):
            reach = -points[k, 2] if taken == 0 else np.inf
            for other in range(taken):
                x, y = points[k, 0] - points[other, 0], points[k, 1] - points[other, 1]
                reach = min(reach, x * x + y * y)
            if k == taken or reach > far:
                best, far = k, reach
        if taken > 0 and not far > 0.0:
            return taken
        for c in range(FLAT_COLUMNS):
            points[taken, c], points[best, c] = points[best, c], points[taken, c]
    return limit


#: Pairs below which a second thread does not pay: 0.1 ms.
FEWEST_CONVEX_CONTACTS = 32


def convex_contacts(
    a: ConvexBodies,
    b: ConvexBodies,
    pairs: Integers,
    i: Integers,
    j: Integers,
    max_points: int,
    distances: ConvexDistances,
) -> Contacts:
    """Return the contacts of bodies ``i[n]`` of a and ``j[n]`` of b.

    pairs (m, 2): copied to the result. distances: of these pairs, without a limit.
    """
    contacts = Contacts.blank(pairs, max_points)
    contacts.axes[:] = NO_AXIS
    contacts.normals[:] = distances.normals
    nearest = distances.lower, distances.positions_a, distances.positions_b
    both = RowPairs(a.arrays, i, b.arrays, j)
    run(_contact_kernel, len(i), FEWEST_CONVEX_CONTACTS, both, nearest, contacts.arrays)
    return contacts


@njit
def _contact_kernel(
    pairs: RowPairs, nearest: ContactArrays, out: ContactArrays, start: int, stop: int
) -> None:
    a, rows_a, b, rows_b = pairs
    lower, nearest_a, nearest_b = nearest
    normals, depths, counts, positions, position_depths, _ = out
    shape = (2 * MOST_POINTS, FLAT_COLUMNS)
    flat = Flat(np.empty(shape), np.empty(shape), np.empty(shape))  # for one pair after another
    for row in range(start, stop):
        positions[row], position_depths[row] = np.nan, np.nan
        counts[row] = 0
        depths[row] = max(-lower[row], 0.0)
        if lower[row] > 0.0:
            continue
        middle = scaled(plus(vector_at(nearest_a, row), vector_at(nearest_b, row)), 0.5)
        i, j, depth = rows_a[row], rows_b[row], depths[row]
        core_a, core_b, place = core_at(a, i), core_at(b, j), body_place(a, i)
        pose = relative_pose(place, body_place(b, j), core_a.reach + core_b.reach)
        frame = frame_of(turned_back(place, vector_at(normals, row)))
        inner = depth - core_a.radius - core_b.radius
        count = overlay(core_a, core_b, pose, frame, inner, flat)
        count = spread(flat.a, count, positions.shape[1])
        counts[row] = max(count, 1)
        if count == 0:
            for k in range(3):
                positions[row, 0, k] = middle[k]
            position_depths[row, 0] = depth
            continue
        # halfway between both foremost planes; points of flat bodies may be deepest, not foremost
        height = dot(frame.n, support(core_a, frame.n)) + core_a.radius - 0.5 * depth
        for n in range(count):
            x, y, low = vector_at(flat.a, n)
            p = plus(plus(scaled(frame.x, x), scaled(frame.y, y)), scaled(frame.n, height))
            point = in_world(place, p)
            for k in range(3):
                positions[row, n, k] = point[k]
            position_depths[row, n] = min(max(depth - low, 0.0), depth)
