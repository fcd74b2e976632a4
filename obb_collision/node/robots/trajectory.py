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

"""A trajectory of joints: as a message, as points of all joints, and as it runs."""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct
from typing import NamedTuple

import numpy as np
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from obb_collision.node.messages.cdr import Header, Reader
from obb_collision.node.messages.conversions import LARGEST_COORDINATE, NANOSECONDS
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.robots.joints import Joints
from obb_collision.robots.kinematics.splines import Pieces, Point, distances_from
from obb_collision.typing import Floats

DURATION = Struct("<iI")
SMALLEST_POINT = 24
"""Bytes of a point, at least."""
BAD_POINT, TOO_LONG, ELSEWHERE = "bad point", "too many pieces", "not at its start"
MAX_PIECES = 5000
"""Most pieces of a trajectory: what is checked at a time must not block the cycles."""


class Trajectory(NamedTuple):
    """A trajectory_msgs/JointTrajectory; the points have joints in the order of the names."""

    header: Header
    names: list[str]
    points: list[Point]


def trajectory_from_bytes(data: bytes) -> Trajectory:
    """Return a serialised JointTrajectory.

    Raises RefusedError: "malformed message", "too many pieces" for more points than pieces are
    checked, and "bad point" for one that makes no sense.
    """
    reader = Reader(data, JointTrajectory)
    header, names = reader.header(), reader.texts()
    count = reader.count(SMALLEST_POINT)
    if count > MAX_PIECES:  # at least one per point: reading them all would block the node
        raise RefusedError(TOO_LONG, f"{count} points, {MAX_PIECES} is the limit")
    points = [_point(reader) for _ in range(count)]
    reader.end()
    for number, point in enumerate(points):
        _check(point, len(names), f"point {number}")
        if number and point.time <= points[number - 1].time:
            raise RefusedError(BAD_POINT, f"point {number}: its time does not rise")
    return Trajectory(header, names, points)


def _point(reader: Reader) -> Point:
    fields = [reader.doubles(reader.count(8), 1)[:, 0] for _ in range(4)]
    seconds, rest = reader.numbers(DURATION)
    positions, velocities, accelerations, _ = (each if len(each) else None for each in fields)
    time = (seconds * NANOSECONDS + rest) / NANOSECONDS
    return Point(time, fields[0] if positions is None else positions, velocities, accelerations)


def _check(point: Point, count: int, which: str) -> None:
    """Raise RefusedError for a point without a good value of each joint."""
    values: list[tuple[str, Floats | None]] = [
        ("positions", point.positions),
        ("velocities", point.velocities),
        ("accelerations", point.accelerations),
    ]
    if point.time < 0.0:
        raise RefusedError(BAD_POINT, f"{which}: its time is negative")
    if point.accelerations is not None and point.velocities is None:
        raise RefusedError(BAD_POINT, f"{which}: accelerations without velocities")
    for what, given in values:
        if given is None:
            continue
        if len(given) != count:
            raise RefusedError(BAD_POINT, f"{which}: {len(given)} {what} of {count} joints")
        if not (np.abs(given) <= LARGEST_COORDINATE).all():
            raise RefusedError(BAD_POINT, f"{which}: {what} are not finite")


@dataclass
class Running:
    """A trajectory that was forwarded: its pieces, and when it began (ns)."""

    pieces: Pieces
    begin: int
    joints: Joints
    columns: list[int]
    """The joints that it moves, in the order of the names."""
    present: Floats
    """All joints when it was planned: the others are to stay there."""
    robot: object
    world: tuple[object, ...]
    """What it was certified for, and in."""
    passed: float = -np.inf
    """The time of the trajectory at which the robot was, at least."""

    def find_moved(self, tolerance: float) -> str:
        """Return the name of a joint that was to stay and has not, "" for none."""
        off = np.abs(self.joints.positions - self.present)
        off[self.columns] = 0.0
        return self.joints.names[int(np.argmax(off))] if off.max(initial=0.0) > tolerance else ""

    def advance(self, elapsed: float, tolerance: float) -> None:
        """Note how far the robot is, by the joints: controllers can be slower than planned.

        It is at the first piece from the last one on that the joints are near to.
        """
        pieces, here = self.pieces, self.joints.positions
        ahead = np.flatnonzero((pieces.finishes > self.passed) & (pieces.begins <= elapsed))
        near = ahead[distances_from(pieces.take(ahead), here) <= tolerance]
        if len(near):
            self.passed = float(pieces.begins[near[0]])
        last = pieces.finishes.max()
        there = np.abs(pieces.ends[np.argmax(pieces.finishes)] - here).max(initial=0.0)
        if elapsed >= last and there <= tolerance:
            self.passed = float(last)

    @property
    def names(self) -> list[str]:
        """The joints that it moves."""
        return [self.joints.names[column] for column in self.columns]

    def hold(self) -> JointTrajectory:
        """Return a trajectory that stays where the joints are."""
        positions = self.joints.positions[self.columns].tolist()
        return JointTrajectory(
            joint_names=self.names, points=[JointTrajectoryPoint(positions=positions)]
        )


def whole_point(point: Point, columns: list[int], joints: Joints) -> Point:
    """Return a point with all joints: others stay where they are."""

    def spread(given: Floats | None) -> Floats | None:
        if given is None:
            return None
        values = np.zeros(len(joints.names))
        values[columns] = given
        return values

    positions = joints.positions.copy()
    positions[columns] = point.positions
    return Point(point.time, positions, spread(point.velocities), spread(point.accelerations))


def from_here(points: list[Point], joints: Joints, since: float) -> list[Point]:
    """Return the points with the present state before them, from which controllers begin.

    since: the time of the trajectory that it is now (s). Where that of the first point has come,
    the way to it is straight and sudden.
    """
    first, here = points[0], joints.positions.copy()
    if first.time > since:
        if first.accelerations is not None:  # those of now are not known
            raise RefusedError(BAD_POINT, "the first one has accelerations, and is not at time 0")
        if first.velocities is not None and joints.unclear.any():
            name = joints.names[int(np.argmax(joints.unclear))]
            raise RefusedError(ELSEWHERE, f"the velocity of joint {name} is not known")
        return [Point(since, here, joints.velocities.copy(), None), *points]
    step = 1e-9  # what may be between two points of time
    return [Point(first.time - step, here, None, None), *points]
