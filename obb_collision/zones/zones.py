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


"""Zones: what they do to commands, their shapes, and how both are read from text.

The names of parameters and what they mean are those of nav2_collision_monitor.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from obb_collision.typing import Floats
from obb_collision.words import shown
from obb_collision.zones.outlines import Outline, Twist

ACTIONS = NOTHING, STOP, SLOWDOWN, APPROACH, LIMIT = (
    "none",
    "stop",
    "slowdown",
    "approach",
    "limit",
)
"""The actions, in the order of their numbers in nav2_msgs/CollisionMonitorState."""
FEWEST_CORNERS = 4
"""Of a polygon in text."""
FEWEST_RECEIVED = 3
"""Of a polygon by a topic."""
MOST_CORNERS = 1000
"""Of a polygon: each takes time with each point."""


class Part(NamedTuple):
    """A part of a velocity polygon: an outline for some commands, both ends included."""

    outline: Outline
    linear: tuple[float, float]
    theta: tuple[float, float]
    direction: tuple[float, float] | None = None
    """Of the command (rad), from one angle turning left to the other; None: not holonomic."""

    def covers(self, twist: Twist) -> bool:
        """Return whether the part is for a command."""
        x, y, turn = twist
        linear = x if self.direction is None else math.hypot(x, y)
        if not (self.linear[0] <= linear <= self.linear[1]):
            return False
        if not (self.theta[0] <= turn <= self.theta[1]):
            return False
        if self.direction is None:
            return True
        low, high = self.direction
        angle = math.atan2(y, x)
        return low <= angle <= high if low <= high else angle >= low or angle <= high


@dataclass
class Settings:
    """The parameters of a zone, of which some are live."""

    action: str
    enabled: bool = True
    min_points: int = 4
    slowdown_ratio: float = 0.5
    linear_limit: float = 0.5
    angular_limit: float = 0.5
    time_before_collision: float = 2.0
    sources: tuple[str, ...] = ()
    trigger: int = 1
    """Commands in a row with enough inside until the zone acts, and without until it ends."""
    release: int = 1
    min_height: float = -math.inf
    """Of objects and points that count (m, base frame)."""
    max_height: float = math.inf
    leaving: Outline | None = None
    """Of a stop zone: the footprint of commands that are allowed because they lead out."""


class Exclusion(NamedTuple):
    """A region whose points do not count: corners (n, 2) in a frame, and heights in it (m)."""

    frame: str
    corners: Floats
    min_height: float
    max_height: float


def nothing_to_place(now: int) -> None:
    """Place nothing: the shape is in the frame of the base."""


@dataclass
class Zone:
    """A zone: its parameters, its shape if that is known, and what happened in it before."""

    name: str
    settings: Settings
    outline: Outline | None = None
    parts: list[Part] = field(default_factory=list)
    is_active: bool = False
    in_a_row: int = 0
    place: Callable[[int], None] = nothing_to_place
    """Places the shape at a time (ns), where it is in another frame."""

    @property
    def is_missing(self) -> bool:
        """Whether the zone acts, and has no shape."""
        settings = self.settings
        return settings.enabled and settings.action != NOTHING and self.outline is None

    def shape(self, twist: Twist) -> None:
        """Take the part of a velocity polygon for a command; the last one where none is."""
        for part in self.parts:
            if part.covers(twist):
                self.outline = part.outline
                return

    def note(self, is_triggered: bool) -> bool:
        """Take note of whether enough is inside; return whether the zone acts."""
        if is_triggered == self.is_active:
            self.in_a_row = 0
            return self.is_active
        self.in_a_row += 1
        needed = self.settings.trigger if is_triggered else self.settings.release
        if self.in_a_row >= needed:
            self.is_active, self.in_a_row = is_triggered, 0
        return self.is_active


def polygon_from_text(text: str) -> Outline:
    """Read '[[x, y], ...]' (m), four corners or more; ValueError for anything else."""
    try:
        corners = np.array(ast.literal_eval(text.strip()), np.float64)
    except (ValueError, TypeError, OverflowError, SyntaxError):
        corners = np.empty(0)
    if corners.ndim != 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
        raise ValueError(f"{shown(text)} is not like '[[0.5, 0.25], [0.5, -0.25], ...]'")
    if not FEWEST_CORNERS <= len(corners) <= MOST_CORNERS:
        limits = f"{FEWEST_CORNERS} corners, and at most {MOST_CORNERS}"
        raise ValueError(f"a polygon needs {limits}, got {len(corners)}")
    return Outline(corners)


def circle(radius: float) -> Outline:
    """Return a circle about the base; ValueError for a radius that is not positive (m)."""
    if not 0.0 < radius < math.inf:
        raise ValueError(f"a radius must be positive, got {radius}")
    return Outline(np.empty((0, 2)), radius)


def polygon(corners: Floats) -> Outline:
    """Return a polygon of corners (n, 2) from a message; ValueError for too few or too many."""
    if not FEWEST_RECEIVED <= len(corners) <= MOST_CORNERS or not np.isfinite(corners).all():
        limits = f"{FEWEST_RECEIVED} to {MOST_CORNERS} finite corners"
        raise ValueError(f"a polygon needs {limits}, got {len(corners)}")
    return Outline(np.ascontiguousarray(corners, np.float64))
