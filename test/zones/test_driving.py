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


"""Simulated bases behind the gate: random commands at random obstacles, and they never touch.

The base obeys late, and brakes no faster than it can. Its scans are rays from its middle.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest
from each import each

from obb_collision.typing import Floats
from obb_collision.zones import Outline, Settings, Surroundings, Twist, Zone, decide

STEP, CYCLE = 0.01, 5
"""Seconds of a step of the simulation, and steps from command to command."""
RAYS = 720
PADDING = 0.03
"""Metres by which the footprint of the zone is larger: as for a costmap, by rays and braking."""
RECTANGLE = np.array([[0.4, 0.25], [-0.4, 0.25], [-0.4, -0.25], [0.4, -0.25]])
SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
LEFT = np.array([[0.0, 1.0], [-1.0, 0.0]])


class Base(NamedTuple):
    """A base: corners of its footprint (n, 2), and how it moves."""

    corners: Floats
    holonomic: bool
    latency: int
    """Cycles until a command is obeyed."""
    braking: float
    """Metres per second squared, and three times as much for turns (rad/s^2)."""
    time: float
    """Seconds that the zone keeps to collisions: at least three times those to brake."""

    @property
    def zone(self) -> Zone:
        """The zone about it."""
        settings = Settings("approach", min_points=1, time_before_collision=self.time)
        return Zone("footprint", settings, Outline(self.corners).grown(PADDING))


def turned(angle: float) -> Floats:
    """Return the matrix of a rotation."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


def are_apart(a: Floats, b: Floats) -> bool:
    """Return whether an edge of two convex polygons separates them."""
    for one, other in ((a, b), (b, a)):
        for normal in (np.roll(one, -1, axis=0) - one) @ LEFT:
            own, others = one @ normal, other @ normal
            if own.max() < others.min() or others.max() < own.min():
                return True
    return False


def scan(at: Floats, heading: float, obstacles: list[Floats]) -> Floats:
    """Return where rays from a point end on obstacles, in the frame of the base (k, 3)."""
    starts = np.concatenate(obstacles)
    sides = np.concatenate([np.roll(corners, -1, axis=0) - corners for corners in obstacles])
    angles = heading + np.arange(RAYS) * (2.0 * np.pi / RAYS)
    rays = np.column_stack([np.cos(angles), np.sin(angles)])[:, None]
    offset = starts - at
    with np.errstate(divide="ignore", invalid="ignore"):
        across = rays[..., 0] * sides[:, 1] - rays[..., 1] * sides[:, 0]
        along = (offset[:, 0] * sides[:, 1] - offset[:, 1] * sides[:, 0]) / across
        share = (offset[:, 0] * rays[..., 1] - offset[:, 1] * rays[..., 0]) / across
    along[~((along > 0.0) & (share >= 0.0) & (share <= 1.0))] = np.inf
    nearest = along.min(axis=1)
    hit = np.isfinite(nearest)
    local = angles[hit] - heading
    ends = nearest[hit, None] * np.column_stack([np.cos(local), np.sin(local)])
    return np.column_stack([ends, np.zeros(len(ends))])


def as_boxes(obstacles: list[Floats], at: Floats, heading: float) -> Floats:
    """Return the corners (n, 8, 3) of obstacles in the frame of the base, one metre high."""
    local = np.array([(corners - at) @ turned(heading) for corners in obstacles])
    flat = local[:, [2, 3, 1, 0, 2, 3, 1, 0]] if len(local) else local.reshape(0, 8, 2)
    heights = np.tile([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0], (len(flat), 1))
    return np.concatenate([flat, heights[..., None]], axis=2)


class Drive:
    """A base on its way, and what is about it."""

    def __init__(self, base: Base, obstacles: list[Floats], kind: str) -> None:
        self.base, self.obstacles, self.kind = base, obstacles, kind
        self.at, self.heading, self.speed = np.zeros(2), 0.0, np.zeros(3)
        self._zones = [base.zone]
        self._orders = deque([np.zeros(3)] * (base.latency + 1), base.latency + 1)

    def around(self) -> Surroundings:
        """Return what the base knows."""
        place = self.at, self.heading
        seen = self.obstacles if self.kind == "scan" else self.obstacles[::2]
        known = {"scan": [], "objects": self.obstacles, "both": self.obstacles[1::2]}[self.kind]
        points = {} if self.kind == "objects" else {"front": scan(*place, seen)}
        names = [f"box/{number}" for number in range(len(known))]
        return Surroundings(points, names=names, corners=as_boxes(known, *place))

    def follow(self, command: Twist) -> Twist:
        """Drive for a cycle; return the command that was safe."""
        safe = decide(command, self._zones, self.around()).twist
        self._orders.append(np.array(safe))
        for _ in range(CYCLE):
            most = self.base.braking * STEP
            change = self._orders[0] - self.speed
            length = float(np.hypot(*change[:2]))
            change[:2] *= min(1.0, most / length) if length else 1.0
            change[2] = np.clip(change[2], -3.0 * most, 3.0 * most)
            self.speed = self.speed + change
            self.at = (
                self.at
                + STEP * turned(self.heading + 0.5 * STEP * self.speed[2]) @ (self.speed[:2])
            )
            self.heading += STEP * float(self.speed[2])
        return safe

    def touches(self) -> bool:
        """Return whether the base touches an obstacle."""
        corners = self.base.corners @ turned(self.heading).T + self.at
        return not all(are_apart(corners, obstacle) for obstacle in self.obstacles)


BASES = {
    "differential": Base(RECTANGLE, False, 1, 2.0, 2.0),
    "holonomic": Base(RECTANGLE, True, 2, 2.0, 2.0),
    "slow brakes": Base(RECTANGLE, False, 2, 1.0, 3.0),
}


def random_drive(seed: int) -> Drive:
    """Return a base among obstacles, none of which it touches."""
    rng = np.random.default_rng(seed)
    base, kind = [*BASES.values()][seed % 3], ("scan", "objects", "both")[seed // 3 % 3]
    own = base.zone.outline
    assert own is not None
    obstacles: list[Floats] = []
    while len(obstacles) < 10:
        halves = rng.uniform(0.05, 0.8, 2)
        corners = SIGNS * halves @ turned(rng.uniform(0.0, np.pi)).T + rng.uniform(-3.0, 3.0, 2)
        if are_apart(corners, own.corners):
            obstacles.append(corners)
    return Drive(base, obstacles, kind)


def drive_at_random(seed: int, seconds: float = 10.0) -> float:
    """Drive, and never touch; return the length of the way (m)."""
    drive, rng = random_drive(seed), np.random.default_rng(seed)
    way, command = 0.0, (0.0, 0.0, 0.0)
    for cycle in range(round(seconds / (STEP * CYCLE))):
        if cycle % 14 == 0:
            x, y, turn = rng.uniform(-1.0, 1.0, 3).tolist()
            command = (x, y * drive.base.holonomic, 1.5 * turn)
        before = drive.at
        drive.follow(command)
        way += float(np.hypot(*(drive.at - before)))
        assert not drive.touches(), f"seed {seed}, cycle {cycle}"
    return way


def test_random_commands_never_touch_anything() -> None:
    ways = [drive_at_random(seed) for seed in range(45)]
    assert np.median(ways) > 1.0, "and it drives"


@pytest.mark.slow
def test_a_thousand_random_starts_never_touch_anything() -> None:
    for seed in range(1000):
        drive_at_random(seed)


@each("name", BASES)
@each("kind", ["scan", "objects", "both"])
def test_it_passes_walls_at_five_centimetres_without_stopping(name: str, kind: str) -> None:
    walls = [
        SIGNS * (0.1, 0.1) + (2.0 + 0.2 * number, side * 0.4)
        for side in (-1, 1)
        for number in range(16)
    ]
    drive = Drive(BASES[name], walls, kind)
    rng = np.random.default_rng(3)
    drive.at, drive.heading = np.array([0.0, rng.uniform(-0.005, 0.005)]), 0.005
    while drive.at[0] < 6.5:
        steer = -2.0 * drive.heading - 2.0 * float(drive.at[1])
        safe = drive.follow((0.5, 0.0, steer))
        assert safe[0] > 0.05, "it goes on"
        assert not drive.touches()
