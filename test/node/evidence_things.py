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


"""What was said of an object, of a joint and of a robot, and what of that could be used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from math import inf, isnan, nan
from typing import Any, TypeAlias

import numpy as np

ORDER = (
    *("starting", "inactive", "disabled", "internal_error", "blocked", "overload"),
    *("clock_stopped", "two_publishers", "no_objects", "required_missing", "input_silent"),
    *("input_unreadable", "messages_lost", "unknown_objects", "shape_building"),
    *("unplaced", "refused", "late_frame", "stale", "robot_unknown", "joint_unknown"),
    "base_unknown",
)
ARM, LINKS, EDGE = "arm", ("arm/base/0", "arm/hand/0"), 0.23
"""The robot, its links, and the edge of the first one: the other is moved by joints along x. With
this edge nothing just touches."""
OLD, DEAD = "stale: old stamp", "stale: dead transform"
ONE, HALF = "input_unreadable: one of two", "collides, and not all is known"
TWIN, TURNS, TWO = "two_publishers: of status", "two_publishers: of sets", "free: two senders"
SEEN = "sensor: "
OF_SENSORS = (
    *("", "input_silent", "input_unreadable", "two_publishers", "unplaced", "refused"),
    *("late_frame", "stale", "collides", "left out"),
)
KINDS = OLD, DEAD, ONE, HALF, TWIN, TURNS, TWO, *(SEEN + code for code in OF_SENSORS)
"""What is known in ways that are worth counting."""
CHANGES = "objects", "object_transform"
TIMEOUT = "object_timeout"
Sender: TypeAlias = tuple[str, int]
"""A topic, and which of its publishers."""
NOBODY = "", 0
Rows = list[tuple[str, float, float, str]]
OFFSET, WAIT, LONGEST_WAIT = 0.7, 0.2, 10.0
"""Where odom is, and for how long (s) states wait for it."""
REORDERED, MEMORY, AHEAD = 1.0, 1.0, 0.5
"""Age (s) of a state up to which an older one is late, and of one that names an unknown object;
and how far ahead a stamp is believed."""
SPEED, REACH = 0.37, 1.0
REMEMBERED, PADDING = 2.0, 0.05
"""For how long (s) it is known where links were, and how far about them (m) points are theirs."""


@dataclass
class Thing:
    """An object: what was said of it, and what of that could be used.

    sender, maker: of its latest state and marker; awaited: the size that is being built; shaped:
    whether it has one; seen: by a cycle; serial: of the node's, when it was last looked at;
    carried: when the transform was true that placed it, if that was the latest; told: its last
    speed; speed: that when it became stale; locked: its x in odom, if it follows that; is_alone:
    that alone has an age; points: where balls of its size are, seen from x, or a cube at x.
    """

    size: float
    points: Sequence[float] = (0.0,)
    of_set: bool = False
    expiry: float = inf
    sender: Sender = NOBODY
    maker: Sender = NOBODY
    x: float | None = None
    at: float = 0.0
    stamp: float = 0.0
    carried: float = inf
    locked: float | None = None
    is_alone: bool = False
    told: float = 0.0
    speed: float = 0.0
    states: list[tuple[float, str, float, float, float]] = field(default_factory=list)
    received: float = 0.0
    order: float = 0.0
    repeated: bool = False
    bad_pose: bool = False
    bad_shape: bool = False
    overtaken: bool = False
    held_back: bool = False
    late: bool = False
    stale: bool = False
    awaited: float | None = None
    shaped: bool = True
    is_mesh: bool = False
    seen: bool = False
    serial: int = -1

    @property
    def is_building(self) -> bool:
        return self.awaited is not None or not self.shaped

    def since(self, by_stamp: bool) -> float:
        if self.is_alone:
            return self.carried
        return min(self.at, self.carried, self.stamp if by_stamp and self.stamp else inf)

    def jump(self, by: float, by_stamp: bool) -> None:
        if by_stamp and self.stamp:
            self.carried = min(self.carried, self.stamp)
        for name in ("at", "received", "expiry", "carried"):
            setattr(self, name, getattr(self, name) + by)
        self.stamp = self.order = 0.0
        self.states = [(x, frame, s, at + by, c + by) for x, frame, s, at, c in self.states]


@dataclass
class Joint:
    """A joint, or the base: what came last of it; NaN: nothing."""

    x: float = nan
    stamp: float = 0.0
    at: float = -inf
    since: float = -inf
    frame: str = "map"
    bad: bool = False
    repeated: bool = False
    overdue: float = inf
    sender: Sender = NOBODY

    def after(
        self,
        x: float,
        stamp: float,
        now: float,
        fault: str,
        by_stamp: bool,
        sender: Sender,
        frame: str = "map",
    ) -> Joint:
        late = 0 < stamp < self.stamp and now - self.at <= REORDERED
        if fault or (isnan(x) and not late):
            return replace(self, bad=True)
        if late:
            return replace(self, overdue=self.at + REORDERED / 2)
        believed = stamp if stamp <= now + AHEAD else 0.0
        since = min(now, believed) if by_stamp and believed else now
        return Joint(x, believed, now, since, frame, repeated=not isnan(self.x), sender=sender)

    def is_unknown(self, now: float, limit: float) -> bool:
        return isnan(self.x) or self.bad or self.overdue < now or 0.0 < limit < now - self.since

    def jump(self, by: float, _: bool) -> None:
        self.stamp, self.at, self.since, self.overdue = 0.0, self.at + by, self.since + by, inf


@dataclass
class Robot:
    """Two links, where the base is and beyond two joints. edge: of the second, 0: not described."""

    edge: float = 0.0
    refused: bool = False
    is_known: bool = False
    base_ages: bool = False
    base: Joint = field(default_factory=Joint)
    changed: bool = False

    def __post_init__(self) -> None:
        self.renew()

    def renew(self) -> None:
        """Make links whose joints are not known."""
        self.joints, self.changed = [Joint(), Joint()], True
        sizes = (EDGE, self.edge) if self.edge else ()
        self.links = {name: Thing(size) for name, size in zip(LINKS, sizes, strict=False)}
        self.trails: list[list[tuple[float, float]]] = [[] for _ in sizes]

    def record(self, by_stamp: bool) -> None:
        """Remember where the links are, and since when."""
        for link, trail in zip(self.links.values(), self.trails, strict=True):
            if link.x is None:
                continue
            since = min(link.at, link.stamp if by_stamp and link.stamp else inf)
            if trail and since <= trail[-1][0]:
                since = trail.pop()[0]
            trail.append((since, link.x))
            while trail[0][0] < since - REMEMBERED:
                del trail[0]

    def spans_at(self, stamp: float, ages: bool) -> list[tuple[float, float]] | None:
        """Return from where to where links were at a stamp, 0: now; None where it is not known.

        ages: whether joints do. Where neither they nor the base do, the nearest place is known.
        """
        aging = [*self.joints] * ages + [self.base] * self.base_ages
        until, ages = min((one.since for one in aging), default=inf), bool(aging)
        if not all(self.trails) or until < stamp:
            return None
        spans = []
        for link, trail in zip(self.links.values(), self.trails, strict=True):
            if stamp and ages and not trail[0][0] <= stamp <= trail[-1][0]:
                return None
            times, places = zip(*trail, strict=True)
            x = float(np.interp(stamp or times[-1], times, places))
            spans.append((x - 0.5 * link.size - PADDING, x + 0.5 * link.size + PADDING))
        return spans

    def faults(self, now: float, given: dict[str, Any]) -> set[str]:
        """Return what is not known when links are placed."""
        self.is_known = False
        if self.refused or not self.links:
            return {"robot_unknown"}
        limit = self.limit(given) if self.base.repeated else self.limit(given | {TIMEOUT: 0.0})
        self.base_ages = limit > 0.0
        found = {"base_unknown"} if self.base.is_unknown(now, limit) else set()
        if any(joint.is_unknown(now, given["joint_timeout"]) for joint in self.joints):
            found.add("joint_unknown")
        self.is_known = not found
        return found

    @staticmethod
    def limit(given: dict[str, Any]) -> float:
        own = last(given["object_timeout_overrides"], ARM)
        return float(given[TIMEOUT] if own is None else own)

    def codes(self, now: float, given: dict[str, Any], latest: Callable[[], float]) -> set[str]:
        found = self.faults(now, given)
        if self.links and not isnan(self.base.x):
            is_lost = self.base.frame == "lost"
            if self.base.frame == "odom":
                since = latest()  # in any case: it takes note of when it was seen
                is_lost = 0.0 < self.limit(given) < now - since
            found |= {"base_unknown"} if is_lost else set()
        return found


def last(entries: Sequence[str], name: str) -> str | None:
    values = [entry.split(": ")[1] for entry in entries if fnmatch(name, entry.split(": ")[0])]
    return values[-1] if values else None
