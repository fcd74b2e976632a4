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


"""Objects in the plane of a base: outlines of boxes between two heights, and when they meet."""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.typing import Floats, Rows
from obb_collision.zones.outlines import (
    SLACK,
    Twist,
    convex_outline,
    distance_to_edge,
    first_visit,
    is_inside,
    seen_at,
)

MOST_CORNERS = 32
"""Of the part of a box between two heights: 8 corners, and 12 edges through each of two planes."""


@njit
def box_outlines(corners: Floats, low: float, high: float, out: Floats, ends: Rows) -> None:
    """Write the convex outlines of boxes between two heights, one behind the other.

    corners (n, 8, 3): of which the bits of the row choose the sides; out (n MOST_CORNERS, 2); ends
    (n + 1,): where each outline ends, an empty one where it begins.
    """
    points = np.empty((MOST_CORNERS, 2))
    ends[0] = 0
    for n in range(len(corners)):
        box, count = corners[n], 0
        for i in range(8):
            if low <= box[i, 2] <= high:
                points[count, 0], points[count, 1] = box[i, 0], box[i, 1]
                count += 1
            for bit in (1, 2, 4):
                j = i | bit
                for level in (low, high):
                    below, above = box[i, 2] - level, box[j, 2] - level
                    if j != i and below * above < 0.0 and abs(level) < np.inf:
                        share = below / (below - above)
                        points[count, 0] = box[i, 0] + share * (box[j, 0] - box[i, 0])
                        points[count, 1] = box[i, 1] + share * (box[j, 1] - box[i, 1])
                        count += 1
        ends[n + 1] = ends[n] + convex_outline(points[:count], out[ends[n] :])


@njit
def outlines_meet(a: Floats, b: Floats, radius: float) -> bool:
    """Return whether a convex outline (n, 2) meets a polygon (m, 2), or a disc without corners."""
    if len(a) == 0:
        return False
    if len(b) == 0:
        return is_inside(a, 0.0, 0.0, 0.0) or distance_between(a, np.zeros((1, 2))) < radius
    if is_inside(b, 0.0, a[0, 0], a[0, 1]) or is_inside(a, 0.0, b[0, 0], b[0, 1]):
        return True
    for n in range(len(a)):
        px, py, qx, qy = a[n - 1, 0], a[n - 1, 1], a[n, 0], a[n, 1]
        for m in range(len(b)):
            rx, ry, sx, sy = b[m - 1, 0], b[m - 1, 1], b[m, 0], b[m, 1]
            first = (qx - px) * (ry - py) - (qy - py) * (rx - px)
            second = (qx - px) * (sy - py) - (qy - py) * (sx - px)
            third = (sx - rx) * (py - ry) - (sy - ry) * (px - rx)
            fourth = (sx - rx) * (qy - ry) - (sy - ry) * (qx - rx)
            if first * second < 0.0 and third * fourth < 0.0:
                return True
    return distance_between(a, b) <= SLACK


@njit
def distance_between(a: Floats, b: Floats) -> float:
    """Return the distance of two polygons (n, 2) and (m, 2) that are apart."""
    least = np.inf
    for first, second in ((a, b), (b, a)):
        for n in range(len(first)):
            for m in range(len(second)):
                edge = second[m - 1, 0], second[m - 1, 1], second[m, 0], second[m, 1]
                least = min(least, distance_to_edge(*edge, first[n, 0], first[n, 1]))
    return least


@njit
def meeting_time(a: Floats, b: Floats, radius: float, twist: Twist, end: float) -> float:
    """Return when a convex outline (n, 2) that stands still first meets the outline of the base.

    A corner of one of them is on an edge of the other then. b (m, 2): or a disc without corners.
    """
    if outlines_meet(a, b, radius):
        return 0.0
    if len(a) == 0:
        return np.inf
    back = -twist[0], -twist[1], -twist[2]  # how the base sees it, the object sees the base
    first = first_visit(a, b, radius, twist, end)
    if len(b) > 0:
        return min(first, first_visit(b, a, 0.0, back, end))
    center, strip = np.zeros((1, 2)), np.empty((4, 2))
    for n in range(len(a)):  # the centre comes as near as the radius to an edge
        sx, sy = a[n, 0] - a[n - 1, 0], a[n, 1] - a[n - 1, 1]
        length = math.hypot(sx, sy)
        if length > 0.0:
            ox, oy = radius * sy / length, -radius * sx / length
            strip[0, 0], strip[0, 1] = a[n - 1, 0] - ox, a[n - 1, 1] - oy
            strip[1, 0], strip[1, 1] = a[n - 1, 0] + ox, a[n - 1, 1] + oy
            strip[2, 0], strip[2, 1] = a[n, 0] + ox, a[n, 1] + oy
            strip[3, 0], strip[3, 1] = a[n, 0] - ox, a[n, 1] - oy
            first = min(first, first_visit(center, strip, 0.0, back, end))
    return first


@njit
def meeting_times(
    bodies: Floats,
    ends: Rows,
    corners: Floats,
    radius: float,
    twist: Twist,
    end: float,
    out: Floats,
) -> None:
    """Write when each of several outlines (``box_outlines``) meets that of the base."""
    for n in range(len(out)):
        body = bodies[ends[n] : ends[n + 1]]
        out[n] = meeting_time(body, corners, radius, twist, end)


@njit
def distances_at(
    bodies: Floats,
    ends: Rows,
    corners: Floats,
    radius: float,
    twist: Twist,
    time: float,
    out: Floats,
) -> None:
    """Write the distances of several outlines from that of the base at a time, 0 if they meet."""
    moved, origin = np.empty((len(bodies), 2)), np.zeros((1, 2))
    for n in range(len(out)):
        count = ends[n + 1] - ends[n]
        for k in range(count):
            x, y = seen_at(bodies[ends[n] + k, 0], bodies[ends[n] + k, 1], twist, time)
            moved[k, 0], moved[k, 1] = x, y
        body = moved[:count]
        out[n] = np.inf
        if outlines_meet(body, corners, radius):
            out[n] = 0.0
        elif len(corners) > 0:
            out[n] = distance_between(body, corners)
        elif count > 0:
            out[n] = distance_between(body, origin) - radius
