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

"""The robots of a scene file: their descriptions, where they stand, and how their joints move."""

from __future__ import annotations

import re

import numpy as np

from obb_collision.robots.description.robot import Robot
from obb_collision.scene_files.description import SceneRobot
from obb_collision.scene_files.errors import Problems
from obb_collision.scene_files.mesh_files import MeshFiles
from obb_collision.scene_files.motions import read_period, read_times
from obb_collision.scene_files.places import quaternion_of
from obb_collision.scene_files.simulate.joints import JointLoop
from obb_collision.scene_files.yaml_values import Value

KEYS = ("name", "urdf", "srdf", "position", "rpy", "quaternion", "joints", "motion")
MOTION_KEYS = ("waypoints", "period")
#: What a robot may be called: a part of names of topics.
ROBOT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def read_robots(
    values: list[Value], files: MeshFiles, problems: Problems
) -> tuple[SceneRobot, ...]:
    """Return the robots; those that cannot be used are problems."""
    robots: dict[str, SceneRobot] = {}
    for value in values:
        with problems.kept():
            robot = _read_robot(value, files)
            if robot.name in robots:
                value.refuse(f"the name {robot.name} stands twice")
            robots[robot.name] = robot
    return tuple(robots.values())


def _read_robot(value: Value, files: MeshFiles) -> SceneRobot:
    fields = value.fields(KEYS, ("name", "urdf"))
    name = fields["name"].text("a name")
    if not ROBOT_NAME.fullmatch(name):
        fields["name"].expected("letters, digits and _, the first a letter")
    urdf = files.path(fields["urdf"], "URDF")
    srdf = files.path(fields["srdf"], "SRDF") if "srdf" in fields else None
    x, y, z = fields["position"].numbers(3) if "position" in fields else (0.0, 0.0, 0.0)
    with fields["urdf"].reasons():
        robot = Robot.from_urdf(urdf, srdf, files.folders, read_mesh=files.read)
    for doubt in robot.doubts:
        value.doubt(doubt)
    start = _start_of(robot)
    if "joints" in fields:
        start = _read_state(fields["joints"], robot, start)
    motion = _read_motion(fields["motion"], robot, start) if "motion" in fields else None
    pose = (x, y, z, *quaternion_of(fields))
    state = start if motion is None else motion.states[0]
    return SceneRobot(name, urdf, srdf, robot, pose, state, motion)


def _start_of(robot: Robot) -> tuple[float, ...]:
    """Return the state of zeros, or the nearest within the limits."""
    zeros = np.array([float(name.endswith("/rot_w")) for name in robot.joint_names])
    return tuple(np.clip(zeros, robot.lower, robot.upper).tolist())


def _read_state(value: Value, robot: Robot, before: tuple[float, ...]) -> tuple[float, ...]:
    """Return a state; joints that are not in it stay as before."""
    state = dict(zip(robot.joint_names, before, strict=True))
    limits = dict(zip(robot.joint_names, zip(robot.lower, robot.upper, strict=True), strict=True))
    for joint, entry in value.entries().items():
        if joint not in state:
            entry.refuse(f"no joint of the robot moves so{value.guess(joint, robot.joint_names)}")
        low, high = limits[joint]
        state[joint] = entry.number(
            f"a number within the joint's limits, {low:g} to {high:g}",
            lambda number, low=low, high=high: low <= number <= high,  # type: ignore[misc]
        )
    return tuple(state.values())


def _read_motion(value: Value, robot: Robot, start: tuple[float, ...]) -> JointLoop:
    fields = value.fields(MOTION_KEYS, MOTION_KEYS)
    period = read_period(fields["period"])
    points = fields["waypoints"].items()
    if len(points) < 2:
        fields["waypoints"].expected("at least 2 waypoints")
    states, given = [], []
    for point in points:
        parts = point.fields(("joints", "time"), ("joints",))
        start = _read_state(parts["joints"], robot, start)
        states.append(start)
        given.append(parts["time"].not_negative() if "time" in parts else None)
    return JointLoop(tuple(states), read_times(fields["waypoints"], given, period), period)
