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

"""How the objects and robots of a scene file move in the demo: ``NAME.motion.yaml`` beside it.

It also has the simulated sensors, and strangers: objects that only these see.

``docs/install.md`` describes the file.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import fmod, inf
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from obb_collision.demo.sensors import Sensor, read_sensor
from obb_collision.geometry.poses import (
    compose_poses,
    inverse_poses,
    quaternion_from_rpy,
    rotate_vectors,
    unit_quaternions,
)
from obb_collision.scene_files.description import SceneDescription, SceneRobot
from obb_collision.scene_files.load import parse, read_text
from obb_collision.scene_files.mesh_files import MeshFiles, MeshReading
from obb_collision.scene_files.native import read_state
from obb_collision.scene_files.objects import check_angles, read_objects
from obb_collision.scene_files.yaml_values import SceneFileError, Value, items_of
from obb_collision.typing import Floats

#: Fastest motion of an object, m/s and rad/s, and shortest round, s: far from where sums overflow.
MAX_SPEED, MIN_PERIOD = 1e9, 1e-3


@dataclass(frozen=True)
class Track:
    """A round through waypoints (n, k), with constant velocities (n, m) from each to the next.

    times (n,): when each is passed, s, ascending from 0; period: of the round, s. leader: the
    object in whose frame the waypoints are, None for those in the frame of the scene.
    """

    waypoints: Floats
    velocities: Floats
    times: Sequence[float]
    period: float
    leader: str | None = None

    def leg(self, time: float) -> tuple[Floats, Floats, float]:
        """Return the waypoint before a time (s), the velocity there, and the seconds since."""
        passed = fmod(time, self.period)
        row = bisect_right(self.times, passed) - 1
        return self.waypoints[row], self.velocities[row], passed - self.times[row]


def object_track(
    poses: Floats, times: Sequence[float], period: float = inf, leader: str | None = None
) -> Track:
    """Return the track through poses (n, 7), the first one at time 0."""
    return _track(poses, times, period, _displacements, leader)


def _track(
    waypoints: Floats,
    times: Sequence[float],
    period: float,
    displacements: Callable[[Floats, Floats], Floats],
    leader: str | None = None,
) -> Track:
    """Return a track; one whose last waypoint has the time of the period jumps to its start."""
    seconds = np.diff([*times, period])
    legs = seconds > 0.0
    ways = displacements(waypoints, np.roll(waypoints, -1, axis=0))
    with np.errstate(over="ignore"):  # what is too fast is refused
        velocities = ways[legs] / seconds[legs, None]
    return Track(waypoints[legs], velocities, list(times)[: len(velocities)], period, leader)


def _displacements(begins: Floats, ends: Floats) -> Floats:
    """Return the way (n, 3) between poses (n, 7), and the shorter rotation as a vector (n, 3)."""
    turns = Rotation.from_quat(ends[:, 3:]) * Rotation.from_quat(begins[:, 3:]).inv()
    return np.concatenate([ends[:, :3] - begins[:, :3], turns.as_rotvec()], axis=1)


class Motions:
    """The objects and robots of a description in motion, by their tracks.

    objects, robots: tracks by name, those of leaders first; the others are at rest. moving: rows of
    the objects with tracks. strangers: objects that no input names. delays: by robot, the time (s)
    that it has stood still.
    """

    def __init__(
        self,
        description: SceneDescription,
        objects: Mapping[str, Track] | None = None,
        robots: Mapping[str, Track] | None = None,
        strangers: Motions | None = None,
        sensors: Sequence[Sensor] = (),
    ) -> None:
        self.description, self.robots = description, robots or {}
        self.strangers, self.sensors = strangers, sensors
        self.delays = dict.fromkeys(self.robots, 0.0)
        self._starts = np.array([obj.pose for obj in description.objects]).reshape(-1, 7)
        rows = {name: row for row, name in enumerate(description.names)}
        self._tracks = list((objects or {}).values())
        self.moving = [rows[name] for name in objects or {}]
        leaders = [track.leader for track in self._tracks]
        self._followers = [
            (row, rows[leader])
            for row, leader in zip(self.moving, leaders, strict=True)
            if leader is not None
        ]

    def states(self, time: float) -> tuple[Floats, Floats]:
        """Return poses (n, 7) and twists (n, 6) of the objects' origins at a time (s)."""
        poses, twists = self._starts.copy(), np.zeros((len(self._starts), 6))
        if not self.moving:
            return poses, twists
        legs = zip(*(track.leg(time) for track in self._tracks), strict=True)
        places, velocities, passed = (np.array(part) for part in legs)
        ways = velocities * passed[:, None]
        turning = ways[:, 3:].any(axis=1)  # quaternions of others stay bit for bit
        places[:, :3] += ways[:, :3]
        if turning.any():  # scipy 1.11 takes no empty arrays
            turns = Rotation.from_rotvec(ways[turning, 3:])
            places[turning, 3:] = (turns * Rotation.from_quat(places[turning, 3:])).as_quat()
        poses[self.moving], twists[self.moving] = places, velocities
        for row, leader in self._followers:
            poses[row] = compose_poses(poses[leader], poses[row])
            arm, spin = poses[row, :3] - poses[leader, :3], twists[leader, 3:]
            turn = unit_quaternions(poses[leader, 3:])
            twists[row] = twists[leader] + rotate_vectors(turn, twists[row].reshape(2, 3)).ravel()
            twists[row, :3] += np.cross(spin, arm)
        return poses, twists

    def joints(self, robot: SceneRobot, time: float) -> tuple[Floats, Floats]:
        """Return values and velocities of the joints of a robot at a time (s)."""
        if robot.name not in self.robots:
            return np.array(robot.state), np.zeros(len(robot.state))
        time = max(0.0, time - self.delays[robot.name])
        state, velocities, passed = self.robots[robot.name].leg(time)
        return state + passed * velocities, velocities


def read_motions(description: SceneDescription, file: Path) -> Motions:
    """Return how a scene file moves. Raises SceneFileError with all problems of its motion file."""
    beside = file.with_suffix(".motion.yaml")
    if not beside.is_file():
        return Motions(description)
    top = parse(str(beside), read_text(beside))
    fields, problems = top.fields(("objects", "robots", "strangers", "sensors")), top.problems
    poses = {obj.name: np.array(obj.pose) for obj in description.objects}
    files = MeshFiles(beside, MeshReading())
    strangers, _ = read_objects(items_of(fields, "strangers"), files, problems)
    unknown = {obj.name: np.array(obj.pose) for obj in strangers}
    for name in poses.keys() & unknown.keys():
        with problems.kept():
            fields["strangers"].refuse(f"the scene file has an object {name}, too")
    described = {robot.name: robot for robot in description.robots}
    objects: dict[str, Track] = {}
    robots: dict[str, Track] = {}
    entries = fields["objects"].entries() if "objects" in fields else {}
    below = set(entries)
    for name, value in entries.items():
        there = unknown if name in unknown else poses
        with problems.kept():
            _check_name(value, name, there, "object")
            objects[name] = _read_object(value, name, there, below)
        below.discard(name)
    entries = fields["robots"].entries() if "robots" in fields else {}
    for name, value in entries.items():
        with problems.kept():
            _check_name(value, name, described, "robot")
            robots[name] = _read_robot(value, described[name])
    sensors = []
    for name, value in fields["sensors"].entries().items() if "sensors" in fields else ():
        with problems.kept():
            sensors.append(read_sensor(value, name, poses))
    if problems.found:
        raise SceneFileError(str(beside), problems.found)
    tracks = {name: objects.pop(name) for name in [*objects] if name in unknown}
    others = Motions(SceneDescription("strangers", tuple(strangers)), tracks)
    return Motions(description, objects, robots, others if strangers else None, sensors)


def _check_name(value: Value, name: str, names: Mapping[str, object], what: str) -> None:
    if name not in names:
        value.refuse(f"the scene file has no {what} of this name{value.guess(name, names)}")


def _read_object(
    value: Value, name: str, poses: Mapping[str, Floats], below: Collection[str]
) -> Track:
    """Return the track of an object from its pose in the scene file; below: those not read yet."""
    fields = value.fields(("follow", "period", "waypoints"))
    if ("period" in fields) != ("waypoints" in fields) or not fields:
        value.expected("follow: NAME, or period and waypoints, or all three")
    start, leader = poses[name], None
    if "follow" in fields:
        leader = fields["follow"].text("the name of an object")
        _check_name(fields["follow"], leader, poses, "object")
        if leader in below:
            fields["follow"].refuse(f"{leader} must stand above what follows it")
        start = compose_poses(inverse_poses(poses[leader]), start)
    if "waypoints" not in fields:
        return object_track(start[None], [0.0], leader=leader)
    times, places = [0.0], [start]
    for row in fields["waypoints"].items():
        count = len(row.items())
        if count not in (4, 7):
            row.expected("[time, x, y, z] or [time, x, y, z, roll, pitch, yaw]")
        time, x, y, z, *angles = row.numbers(count)
        roll, pitch, yaw = angles or (0.0, 0.0, 0.0)
        check_angles(row, roll, pitch, yaw)
        times.append(time)
        places.append(np.array([x, y, z, *quaternion_from_rpy(roll, pitch, yaw)]))
    track = object_track(np.array(places), times, _read_period(fields, times), leader)
    if not (np.abs(track.velocities) <= MAX_SPEED).all():
        fields["waypoints"].refuse(f"it moves at more than {MAX_SPEED:g} m/s or rad/s")
    return track


def _read_robot(value: Value, robot: SceneRobot) -> Track:
    """Return the track of a robot from its state in the scene file."""
    fields = value.fields(("period", "waypoints"), ("period", "waypoints"))
    times, states = [0.0], [robot.state]
    for point in fields["waypoints"].items():
        entries = point.fields(("time", "joints"), ("time", "joints"))
        states.append(read_state(entries["joints"], robot.robot, states[-1]))
        times.append(entries["time"].number())
    period = _read_period(fields, times)
    return _track(np.array(states), times, period, lambda begins, ends: ends - begins)


def _read_period(fields: Mapping[str, Value], times: Sequence[float]) -> float:
    """Return the period, up to which times must ascend."""
    what = f"seconds from {MIN_PERIOD:g} on"
    period = fields["period"].number(what, lambda seconds: seconds >= MIN_PERIOD)
    if not all(a < b for a, b in pairwise(times)) or times[-1] > period:
        reason = f"times must ascend from above 0 up to the period {period:g}, got {times[1:]}"
        fields["waypoints"].refuse(reason)
    return period
