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


"""Outlines in the plane of a base: what is inside, and when a steady command brings it inside.

Lengths are in metres, times in seconds. A base that keeps a twist (x and y in m/s, turn in rad/s)
in its turning frame moves along a circle, or a line. Seen from it a point p that stands still goes
along

    p(t) = R(-w t) p - V(t),  V(t) = (sin(w t) v + (1 - cos(w t)) v') / w,  v' = (v.y, -v.x)

so that with s = (2 / w) tan(w t / 2) the time at which it meets a line or a circle is the root of
a quadratic in s, whose coefficients have no division by w: it is exact for any turn rate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.typing import Floats, Mask, Rows

SLACK = 1e-6
"""Metres: nearer than this to a border is on it. Coordinates in messages are singles."""
NEAR = 1e-6
"""Metres by which edges are longer when crossings are looked for; more of them do no harm."""
BLUR = 1e-12
"""Relative rounding of times and of distances from the centre of rotation, and more."""

Twist = tuple[float, float, float]
"""x and y (m/s), and turn (rad/s)."""


class Outline(NamedTuple):
    """A closed polygon of corners (n, 2), or without corners an open disc about the origin."""

    corners: Floats
    radius: float = 0.0

    @property
    def reach(self) -> float:
        """Distance of the farthest point from the origin (m)."""
        return math.sqrt(float((self.corners**2).sum(axis=1).max(initial=self.radius**2)))

    def grown(self, margin: float) -> Outline:
        """Return an outline that contains all points within a margin (m) of this one.

        Of a polygon it is the convex hull, whose edges are moved outwards.
        """
        if len(self.corners) == 0:
            return self._replace(radius=self.radius + margin)
        if margin == 0.0:
            return self
        hull = np.empty_like(self.corners)
        hull = hull[: convex_outline(self.corners, hull)]
        sides = np.roll(hull, -1, axis=0) - hull
        outward = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.hypot(*sides.T)[:, None]
        before = np.roll(outward, 1, axis=0)
        shared = np.maximum(1.0 + (before * outward).sum(axis=1), FLAT)
        return Outline(hull + margin * (before + outward) / shared[:, None])


FLAT = 1e-6
"""1 + cosine between the normals of two edges: less is a polygon without an area."""


@njit
def convex_outline(points: Floats, out: Floats) -> int:
    """Write the corners of the convex hull of points (n, 2), and return how many (Jarvis 1973).

    They turn left.
    """
    count, first = len(points), 0
    for n in range(1, count):
        if (points[n, 0], points[n, 1]) < (points[first, 0], points[first, 1]):
            first = n
    kept, at = 0, first
    while kept < count:
        x, y = points[at, 0], points[at, 1]
        out[kept, 0], out[kept, 1] = x, y
        kept += 1
        after, far = first, 0.0
        for n in range(count):
            ax, ay = points[after, 0] - x, points[after, 1] - y
            bx, by = points[n, 0] - x, points[n, 1] - y
            side, length = ax * by - ay * bx, bx * bx + by * by
            if length > 0.0 and (far == 0.0 or side < 0.0 or (side == 0.0 and length > far)):
                after, far = n, length
        if far == 0.0 or after == first:
            break
        at = after
    return kept


@njit
def is_inside(corners: Floats, radius: float, x: float, y: float) -> bool:
    """Return whether a point is in a polygon or on its border; or nearer than a radius."""
    count = len(corners)
    if count == 0:
        return x * x + y * y < radius * radius
    inside = False
    ax, ay = corners[count - 1, 0], corners[count - 1, 1]
    for n in range(count):
        bx, by = corners[n, 0], corners[n, 1]
        if (ay > y) != (by > y) and x < ax + (y - ay) * (bx - ax) / (by - ay):
            inside = not inside
        if distance_to_edge(ax, ay, bx, by, x, y) <= SLACK:
            return True
        ax, ay = bx, by
    return inside


@njit
def distance_to_edge(ax: float, ay: float, bx: float, by: float, x: float, y: float) -> float:
    """Return the distance of a point from an edge from a to b."""
    sx, sy = bx - ax, by - ay
    square = sx * sx + sy * sy
    share = 0.0
    if square > 0.0:
        share = min(max(((x - ax) * sx + (y - ay) * sy) / square, 0.0), 1.0)
    return math.hypot(x - ax - share * sx, y - ay - share * sy)


@njit
def count_inside(points: Floats, corners: Floats, radius: float, inside: Mask) -> int:
    """Write which points (n, 2) are inside, and return how many."""
    count = 0
    for n in range(len(points)):
        inside[n] = is_inside(corners, radius, points[n, 0], points[n, 1])
        count += inside[n]
    return count


@njit
def seen_at(x: float, y: float, twist: Twist, time: float) -> tuple[float, float]:
    """Return where a point that stands still is, seen from the base at a time."""
    vx, vy, w = twist
    angle = w * time
    sine, cosine = math.sin(angle), math.cos(angle)
    along, across = time, 0.5 * angle * time  # sin / w, (1 - cos) / w
    if abs(angle) > NEARLY_STRAIGHT:
        half = math.sin(0.5 * angle)
        along, across = sine / w, 2.0 * half * half / w
    return (
        cosine * x + sine * y - along * vx - across * vy,
        cosine * y - sine * x - along * vy + across * vx,
    )


NEARLY_STRAIGHT = 1e-8
"""Radians up to which the sine of an angle is the angle."""


@njit
def add_times(a: float, b: float, c: float, w: float, end: float, out: Floats, count: int) -> int:
    """Append the times up to ``end`` at which a s^2 + b s + c is 0; return how many there are.

    Roots that rounding may hide are added, too.
    """
    size, square = abs(a) + abs(b) + abs(c), b * b - 4.0 * a * c
    if square < 0.0:
        if square < -BLUR * (b * b + abs(4.0 * a * c)):
            return count
        square = 0.0
    if size == 0.0:
        return count
    q = -0.5 * (b + math.copysign(math.sqrt(square), b))
    for k in range(2):
        top, bottom = (q, a) if k == 0 else (c, q)
        if top == 0.0 and bottom == 0.0:
            continue
        if w == 0.0:
            time = top / bottom if bottom != 0.0 else np.inf
        else:  # a root at infinity is half a turn
            angle = 2.0 * math.atan2(0.5 * abs(w) * top * math.copysign(1.0, bottom), abs(bottom))
            time = (angle if angle >= 0.0 else angle + 2.0 * math.pi) / abs(w)
        if 0.0 <= time <= end:
            out[count] = time
            count += 1
    return count


@njit
def crossings(
    x: float, y: float, corners: Floats, radius: float, twist: Twist, end: float, out: Floats
) -> int:
    """Write the times at which a point crosses a border, rising; return how many there are.

    out: room for two times per edge, or for two of a circle.
    """
    vx, vy, w = twist
    count = 0
    if len(corners) == 0:
        c = x * x + y * y - radius * radius
        a = vx * vx + vy * vy - w * (y * vx - x * vy) + 0.25 * w * w * c
        count = add_times(a, -2.0 * (x * vx + y * vy), c, w, end, out, 0)
    for n in range(len(corners)):
        ax, ay = corners[n - 1, 0], corners[n - 1, 1]
        bx, by = corners[n, 0], corners[n, 1]
        sx, sy = bx - ax, by - ay
        length = math.hypot(sx, sy)
        if length > 0.0:
            sx, sy = sx / length, sy / length
            nx, ny = sy, -sx
            c = nx * (x - ax) + ny * (y - ay)
            b = -(nx * vx + ny * vy) + w * (nx * y - ny * x)
            level = nx * (x + ax) + ny * (y + ay)
            a = 0.25 * w * (2.0 * (ny * vx - nx * vy) - w * level)
            first = count
            count = add_times(a, b, c, w, end, out, count)
            kept = first
            for k in range(first, count):
                px, py = seen_at(x, y, twist, out[k])
                along = (px - ax) * sx + (py - ay) * sy
                if -NEAR <= along <= length + NEAR:
                    out[kept] = out[k]
                    kept += 1
            count = kept
    out[:count].sort()
    return count


@njit
def may_enter(x: float, y: float, reach: float, twist: Twist, end: float, about: Floats) -> bool:
    """Return whether a point may come nearer to the origin than a reach.

    about (2,): nearest and farthest distance of the outline from the centre of rotation.
    """
    vx, vy, w = twist
    speed = math.hypot(vx - w * y, vy + w * x)
    if math.hypot(x, y) - reach > speed * end * (1.0 + BLUR) + NEAR:
        return False
    if w != 0.0:
        distance = speed / abs(w)
        slack = NEAR + BLUR * (distance + about[1])
        return about[0] - slack <= distance <= about[1] + slack
    return abs(vx * y - vy * x) <= math.hypot(vx, vy) * (reach + NEAR)


@njit
def ring_of(corners: Floats, radius: float, twist: Twist, out: Floats) -> float:
    """Write the nearest and farthest distance from the centre of rotation; return the reach."""
    vx, vy, w = twist
    reach, far = radius, 0.0
    for n in range(len(corners)):
        reach = max(reach, math.hypot(corners[n, 0], corners[n, 1]))
    out[0], out[1] = 0.0, np.inf
    if w == 0.0:
        return reach
    cx, cy = -vy / w, vx / w
    near = max(0.0, math.hypot(cx, cy) - reach)  # of the disc about the origin
    if len(corners) == 0:
        far = math.hypot(cx, cy) + radius
    elif not is_inside(corners, radius, cx, cy):
        edge = np.inf
        for n in range(len(corners)):
            ax, ay, bx, by = corners[n - 1, 0], corners[n - 1, 1], corners[n, 0], corners[n, 1]
            edge = min(edge, distance_to_edge(ax, ay, bx, by, cx, cy))
        near = max(near, edge)
    for n in range(len(corners)):
        far = max(far, math.hypot(corners[n, 0] - cx, corners[n, 1] - cy))
    out[0], out[1] = near, far
    return reach


@njit
def visits(
    points: Floats,
    corners: Floats,
    radius: float,
    twist: Twist,
    end: float,
    starts: Floats,
    ends: Floats,
    owners: Rows,
) -> int:
    """Write when points (n, 2) are inside up to a time, and whose times these are.

    Returns how many times there are; those beyond the room of the arrays are not written.
    """
    times = np.empty(2 * len(corners) + 3)
    about = np.empty(2)
    reach = ring_of(corners, radius, twist, about)
    if twist[2] != 0.0:
        end = min(end, 2.0 * math.pi / abs(twist[2]))  # then it begins anew
    total = 0
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        if not may_enter(x, y, reach, twist, end, about):
            continue
        count = crossings(x, y, corners, radius, twist, end, times[1:])
        times[0], times[count + 1] = 0.0, end
        begin = 0.0 if is_inside(corners, radius, x, y) else -1.0
        for k in range(count + 1):
            px, py = seen_at(x, y, twist, 0.5 * (times[k] + times[k + 1]))
            inside = times[k + 1] > times[k] and is_inside(corners, radius, px, py)
            if begin < 0.0 and (k > 0 or inside):
                begin = times[k]  # at a crossing it touches at least
            if begin >= 0.0 and (k == count or not inside):
                if total < len(starts):
                    starts[total], owners[total] = begin, n
                    ends[total] = times[k + 1] if inside else times[k]
                total += 1
                begin = -1.0
    return total


@njit
def first_visit(points: Floats, corners: Floats, radius: float, twist: Twist, end: float) -> float:
    """Return when the first of points (n, 2) is inside, infinity if none is up to a time."""
    times = np.empty(2 * len(corners) + 2)
    about = np.empty(2)
    reach, first = ring_of(corners, radius, twist, about), np.inf
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        if not may_enter(x, y, reach, twist, end, about):
            continue
        if is_inside(corners, radius, x, y):
            return 0.0
        if crossings(x, y, corners, radius, twist, end, times) > 0:
            first = end = times[0]
    return first


def time_of_many(
    points: Floats, outline: Outline, twist: Twist, end: float, least: int
) -> tuple[float, Rows]:
    """Return when at least so many points (n, 2 or more) are inside at once, and their rows.

    Infinity, and no rows, if that is not so up to a time.
    """
    room = 2 * len(points) + 16
    while True:
        starts, ends, owners = np.empty(room), np.empty(room), np.empty(room, np.int64)
        total = visits(points, *outline, twist, end, starts, ends, owners)
        if total <= room:
            break
        room = total
    starts, ends, owners = starts[:total], ends[:total], owners[:total]
    rising = np.sort(starts)
    count = np.arange(1, total + 1) - np.searchsorted(np.sort(ends), rising)
    enough = np.flatnonzero(count >= least)
    if len(enough) == 0:
        return np.inf, owners[:0]
    first = float(rising[enough[0]])
    return first, np.unique(owners[(starts <= first) & (ends >= first)])


@njit
def distances(
    points: Floats,
    corners: Floats,
    radius: float,
    twist: Twist,
    times: Floats,
    now: Floats,
    least: Floats,
) -> None:
    """Write the distances of points (n, 2 or more) from an outline, 0 inside: at the first time.

    And the least at any of the times.
    """
    for n in range(len(points)):
        least[n] = np.inf
        for k in range(len(times)):
            x, y = seen_at(points[n, 0], points[n, 1], twist, times[k])
            distance = max(0.0, math.hypot(x, y) - radius)
            if is_inside(corners, radius, x, y):
                distance = 0.0
            elif len(corners) > 0:
                distance = np.inf
                for m in range(len(corners)):
                    ax, ay, bx, by = (
                        corners[m - 1, 0],
                        corners[m - 1, 1],
                        corners[m, 0],
                        corners[m, 1],
                    )
                    distance = min(distance, distance_to_edge(ax, ay, bx, by, x, y))
            least[n] = min(least[n], distance)
            if k == 0:
                now[n] = distance
