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


"""The safe command: what zones make of a command, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from obb_collision.typing import Floats, Mask, Rows
from obb_collision.zones.bodies import MOST_CORNERS, box_outlines, distances_at, meeting_times
from obb_collision.zones.outlines import (
    Outline,
    Twist,
    convex_outline,
    count_inside,
    distances,
    time_of_many,
)
from obb_collision.zones.zones import APPROACH, LIMIT, NOTHING, STOP, Settings, Zone

ZERO = 0.0, 0.0, 0.0
LEAVING_STEPS = 20
"""Moments of a motion at which the distances of what is in a zone are compared with those now."""
LEAVING_TIME = 0.5
"""Seconds ahead for which a command must not lead nearer to what is in a zone."""
NEARER = 1e-6
"""Metres by which a distance may decrease: rounding, of a round base that turns."""


class Cloud(NamedTuple):
    """Points (n, 3) in the frame of the base, each with a ball of a radius (m) about it."""

    points: Floats
    radius: float = 0.0


class Surroundings:
    """What is about a base, in its frame: points by source, clouds and bodies by name.

    points: by source, each (n, 3), counted; clouds and bodies are objects, of which one is enough.
    corners (n, 8, 3): of the boxes with the first names; hulls: points (k, 3) of the hulls of the
    others, which count as a whole if a part is between the heights of a zone.
    """

    def __init__(
        self,
        points: Mapping[str, Floats],
        clouds: Mapping[str, Cloud] | None = None,
        names: Sequence[str] = (),
        corners: Floats | None = None,
        hulls: Sequence[Floats] = (),
    ) -> None:
        self.points, self.clouds = points, clouds or {}
        self.names, self.hulls = names, hulls
        self.corners = np.empty((0, 8, 3)) if corners is None else corners
        self._outlines: dict[tuple[float, float], tuple[Floats, Rows]] = {}

    def outlines(self, low: float, high: float) -> tuple[Floats, Rows]:
        """Return the outlines of the boxes between two heights (see ``box_outlines``)."""
        key = low, high
        if key not in self._outlines:
            count = len(self.corners)
            out, ends = np.empty((count * MOST_CORNERS, 2)), np.empty(count + 1, np.int64)
            box_outlines(self.corners, low, high, out, ends)
            parts, lengths = [out[: ends[-1]]], list[int]()
            for hull in self.hulls:
                heights, outline = hull[:, 2], np.empty((len(hull), 2))
                meets = heights.max() >= low and heights.min() <= high
                parts.append(outline[: convex_outline(hull, outline) if meets else 0])
                lengths.append(len(parts[-1]))
            ends = np.append(ends, ends[-1] + np.cumsum(np.array(lengths, np.int64)))
            self._outlines[key] = np.concatenate(parts), ends
        return self._outlines[key]

    def body(self, row: int) -> Floats:
        """Return the points (k, 3) of a body."""
        count = len(self.corners)
        return self.corners[row] if row < count else self.hulls[row - count]


@dataclass
class Finding:
    """What a zone found: when (s) enough is inside, who, and the points (k, 3) by source."""

    time: float = math.inf
    who: list[str] = field(default_factory=list)
    points: dict[str, Floats] = field(default_factory=dict)

    def add(self, name: str, time: float, points: Floats) -> None:
        """Add who is inside at a time; the first ones count."""
        if time < self.time:
            self.time, self.who, self.points = time, [], {}
        if time == self.time < math.inf:
            self.who.append(name)
            self.points[name] = points


class Decision(NamedTuple):
    """The safe command, and why: the action of a zone, and what it found."""

    twist: Twist
    action: str = NOTHING
    zone: str = ""
    finding: Finding = Finding()
    factor: float = 1.0


def decide(twist: Twist, zones: Sequence[Zone], around: Surroundings) -> Decision:
    """Return what zones make of a command; of equally slow ones the first counts."""
    chosen = Decision(twist)
    for zone in zones:
        settings = zone.settings
        zone.shape(twist)
        if not settings.enabled or settings.action == NOTHING or zone.outline is None:
            continue
        if settings.action == APPROACH:
            found = look(zone, zone.outline, around, twist, settings.time_before_collision)
            if found.time == math.inf:
                continue
            factor = found.time / settings.time_before_collision
        else:
            found = look(zone, zone.outline, around)
            if not zone.note(found.time == 0.0):
                continue
            if settings.action == STOP:
                if leads_out(zone, around, twist):
                    continue
                return Decision(ZERO, STOP, zone.name, found, 0.0)
            factor = settings.slowdown_ratio
            if settings.action == LIMIT:
                factor = limit(twist, settings.linear_limit, settings.angular_limit)
        slower = scaled(twist, factor)
        if square(slower) < square(chosen.twist):
            chosen = Decision(slower, settings.action, zone.name, found, factor)
    return chosen


def limit(twist: Twist, linear: float, angular: float) -> float:
    """Return the factor by which neither limit is exceeded."""
    speed, turn = math.hypot(*twist[:2]), abs(twist[2])
    factors = (most / value for most, value in ((linear, speed), (angular, turn)) if value > 0.0)
    return max(0.0, min((1.0, *factors)))


def scaled(twist: Twist, factor: float) -> Twist:
    """Return a command times a factor."""
    x, y, turn = twist
    return x * factor, y * factor, turn * factor


def square(twist: Twist) -> float:
    """Return by what commands are compared."""
    return sum(value * value for value in twist)


def look(
    zone: Zone, outline: Outline, around: Surroundings, twist: Twist = ZERO, end: float = 0.0
) -> Finding:
    """Return when enough is in an outline of a zone, up to a time (s) of a command."""
    found, settings = Finding(), zone.settings
    low, high = settings.min_height, settings.max_height
    chosen = [name for name in settings.sources or around.points if name in around.points]
    layers = [between(around.points[name], low, high) for name in chosen]
    points = np.concatenate([np.empty((0, 3)), *layers])
    time, rows = time_of_many(points, outline, twist, end, settings.min_points)
    owners = np.repeat(np.arange(len(layers)), [len(layer) for layer in layers])[rows]
    for row in np.unique(owners).tolist():
        found.add(chosen[row], time, points[rows[owners == row]])
    for name, (own, radius) in around.clouds.items():
        own = between(own, low - radius, high + radius)
        time, rows = time_of_many(own, outline.grown(radius), twist, end, 1)
        found.add(name, time, own[rows])
    bodies, ends = around.outlines(low, high)
    times = np.empty(len(around.names))
    meeting_times(bodies, ends, *outline, twist, end, times)
    for row in np.flatnonzero(np.isfinite(times)).tolist():
        found.add(around.names[row], float(times[row]), around.body(row))
    return found


def between(points: Floats, low: float, high: float) -> Floats:
    """Return the points (k, 3) between two heights, both included."""
    if low == -math.inf and high == math.inf:
        return points
    return points[(points[:, 2] >= low) & (points[:, 2] <= high)]


def leads_out(zone: Zone, around: Surroundings, twist: Twist) -> bool:
    """Return whether a command leads the footprint of a stop zone nearer to nothing in it.

    Fewer points than the zone counts do not matter, an object does.
    """
    footprint, settings = zone.settings.leaving, zone.settings
    if footprint is None or zone.outline is None or twist == ZERO:
        return False
    times = np.linspace(0.0, LEAVING_TIME, LEAVING_STEPS + 1)
    low, high = settings.min_height, settings.max_height
    found = look(zone, zone.outline, around)
    counted = [found.points[name] for name in found.who if name in around.points]
    if _nearer(np.concatenate([np.empty((0, 3)), *counted]), footprint, twist, times).sum() >= (
        settings.min_points
    ):
        return False
    for name, (own, radius) in around.clouds.items():
        inside = found.points.get(name, own[:0])
        if _nearer(inside, footprint.grown(radius), twist, times).any():
            return False
    bodies, ends = around.outlines(low, high)
    within = np.isin(around.names, found.who)
    now, later = np.empty((2, len(around.names)))
    distances_at(bodies, ends, *footprint, twist, 0.0, now)
    for time in times[1:].tolist():
        distances_at(bodies, ends, *footprint, twist, time, later)
        if (within & ((later < now - NEARER) | (now == 0.0))).any():
            return False
    return True


def _nearer(points: Floats, footprint: Outline, twist: Twist, times: Floats) -> Mask:
    """Return which points (n, 3) come nearer to a footprint, or are in it."""
    least, now = np.empty((2, len(points)))
    distances(points, *footprint, twist, times, now, least)
    return (least < now - NEARER) | (now == 0.0)


def compile_kernels() -> None:
    """Compile what decisions need: each kind of outline, points, clouds and boxes."""
    square = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
    points = np.array([[0.9, 0.0, 0.0], [1.5, 0.0, 0.0]])
    corners = np.array([[[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0.9, 2)]], np.float64)
    bodies = ["box", "hull"], corners, [corners[0]]
    around = Surroundings({"points": points}, {"cloud": Cloud(points, 0.1)}, *bodies)
    for outline in (Outline(square), Outline(square[:0], 1.0)):
        for action in (STOP, APPROACH):
            settings = Settings(action, leaving=outline, min_points=1)
            decide((0.5, 0.0, 0.1), [Zone(action, settings, outline)], around)
        for what in (around, Surroundings({}, None, ["box"], corners)):  # nothing is in its way
            leads_out(Zone(STOP, Settings(STOP, leaving=outline), outline), what, (-0.5, 0.0, 0.1))
    count_inside(points, square, 0.0, np.empty(len(points), np.bool_))
