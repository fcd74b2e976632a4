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

"""Messages on the topics of a robot, good and bad, and states whose answers are verified."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.node.messages.conversions import duration_to_ros, stamp_to_ros
from obb_collision.node.robots.validity import NOT_KNOWN
from obb_collision.robots.robot import Robot
from obb_collision.robots.robot_scene import RobotScene
from obb_collision.shapes import Box
from obb_collision.typing import Floats, Mask
from tools.fuzz.client import Client, FoundError
from tools.fuzz.files import MESH, OBJ, SRDF, mutated, urdf
from tools.fuzz.messages import OBSTACLE, Messages, box_marker
from tools.fuzz.process import Child

ROBOT = "bot"
ARGUMENTS = ("-p", f"robots:=['{ROBOT}']", "-p", f"robot_bases:=['{ROBOT}: 0 0 0 0 0 0 1']")
"""Arguments of a node that has the robot."""
LATCHED = (f"{ROBOT}/robot_description", f"{ROBOT}/robot_description_semantic")
SMALLER = (
    *(
        ('size="1 1 1"', 'size="0.05 0.05 0.05"'),
        ('radius="1" length="2"', 'radius="0.03" length="0.05"'),
    ),
    *(('radius="1"', 'radius="0.03"'), ('scale="1 1 -1"', 'scale="0.02 0.02 -0.02"')),
    ('robot_part.obj"/>', 'robot_part.obj" scale="0.02 0.02 0.02"/>'),
)
"""What is made smaller, so that some states collide and others do not."""
MESH_SHAPE = re.compile(r"<mesh [^>]*/>")
MESHES = 0.05
"""Share of the descriptions with meshes: the node starts a process to read them, for a second."""
BOX, LINK, PLACE = ("attached", 1), 3, (0.1, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0)
"""A good box that is attached: its key, to which link, and where."""
EDGE = 0.3
"""Its edges (m)."""
GOOD = 0.5
"""Share of the descriptions that are as they should be."""
STATES = 20
"""States of a question whose answer is verified."""


def states_to_ros(robot: Robot, states: Floats, header: Header) -> PointCloud2:
    """Return a cloud of states (n, joints)."""
    rows = np.zeros(len(states), [(name, "<f8") for name in robot.joint_names])
    for column, name in enumerate(robot.joint_names):
        rows[name] = states[:, column]
    return cloud_to_ros(rows, header)


class Question(NamedTuple):
    """Messages that describe the robot, attach a box to it and ask for states (n, joints).

    possible, alone: (n,) which states are valid, and which would be valid without the box.
    """

    messages: list[tuple[str, Any]]
    possible: Mask
    alone: Mask


class RobotMessages:
    """Makes messages for one robot with the random numbers of ``messages``.

    makers: type and maker per topic.
    """

    def __init__(self, messages: Messages, folder: Path) -> None:
        self._messages = messages
        mesh = folder / "robot_part.obj"
        mesh.write_bytes(OBJ)
        self._mesh = f'"{mesh.as_uri()}"'
        text = self._with_mesh(urdf()).replace("package://bot/part.obj", mesh.as_uri())
        for large, small in SMALLER:
            text = text.replace(large, small)
        self._with_meshes = text
        self._urdf = MESH_SHAPE.sub('<box size="0.04 0.03 0.02"/>', text)
        self._robot = Robot.from_urdf(self._urdf, SRDF)
        self._alone, self._holding = RobotScene(self._robot), RobotScene(self._robot)
        links = self._robot.link_names
        self._holding.attach("box", Box([EDGE] * 3), links[LINK], PLACE)
        messages.links = (f"{ROBOT}/{links[LINK]}", links[-1], f"{ROBOT}/none", ROBOT)
        makers: dict[str, tuple[type, Callable[[], Any]]] = {
            "robot_description": (String, lambda: self._description(0)),
            "robot_description_semantic": (String, lambda: self._description(1)),
            "joint_states": (JointState, self._joints),
            "states_to_check": (PointCloud2, self._states),
            "path_to_check": (PointCloud2, self._states),
            "trajectory_in": (JointTrajectory, self._trajectory),
            "jog_in": (JointTrajectory, self._trajectory),
        }
        self.makers = {f"{ROBOT}/{topic}": maker for topic, maker in makers.items()}

    def _with_mesh(self, text: str) -> str:
        return text.replace(f'"{MESH}"', self._mesh)

    @property
    def _random(self) -> Random:
        return self._messages.random

    def _description(self, which: int) -> String:
        urdf = self._with_meshes if self._random.random() < MESHES else self._urdf
        text = (urdf, SRDF)[which]
        if self._random.random() < GOOD:
            return String(data=text)
        spoiled = mutated(text, self._random).decode("utf-8", "replace").replace("\0", " ")
        return String(data=self._with_mesh(spoiled))

    def _values(self, count: int) -> Floats:
        """Return states (count, joints), some beyond the limits."""
        random = np.random.default_rng(self._random.randrange(2**31))
        return random.uniform(-1.2, 1.2, (count, len(self._robot.joint_names)))

    def _joints(self) -> JointState:
        names = list(self._robot.joint_names)
        self._random.shuffle(names)
        names = names[: self._random.choice((len(names), len(names), 1, 3))]
        message = JointState(header=self._messages.header(), name=names)
        message.position = self._values(1)[0, : len(names)].tolist()
        if self._random.random() < 0.5:
            message.velocity = self._values(1)[0, : len(names)].tolist()
        return message

    def _states(self, states: Floats | None = None, header: Header | None = None) -> PointCloud2:
        values = self._values(self._random.choice((0, 1, 50))) if states is None else states
        return states_to_ros(self._robot, values, header or self._messages.header())

    def _trajectory(self) -> JointTrajectory:
        message = JointTrajectory(joint_names=list(self._robot.joint_names))
        count = self._random.choice((0, 1, 2, 10))
        for number, state in enumerate(self._values(count).tolist()):
            point = JointTrajectoryPoint(positions=state, time_from_start=duration_to_ros(number))
            if self._random.random() < 0.5:
                point.velocities = [0.0] * len(state)
            message.points.append(point)
        return message

    def question(self, number: int, header: Header) -> Question:
        """Return the good messages of a number; the last message asks for states."""
        self._messages.random = Random(number)
        states = self._values(STATES)
        joints = JointState(header=header, name=list(self._robot.joint_names))
        joints.position = self._values(1)[0].tolist()
        link = Header(frame_id=f"{ROBOT}/{self._robot.link_names[LINK]}")
        box = box_marker(BOX, PLACE, [EDGE] * 3, link)
        box.frame_locked = True
        messages = [
            ("objects", MarkerArray(markers=[box])),
            (LATCHED[0], String(data=self._urdf)),
            (LATCHED[1], String(data=SRDF)),
            (f"{ROBOT}/joint_states", joints),
            (OBSTACLE, cloud_to_ros(np.zeros(0, [(axis, "<f4") for axis in "xyz"]), header)),
            (f"{ROBOT}/states_to_check", self._states(states, header)),
        ]
        possible, alone = (scene.check(states).valid for scene in (self._holding, self._alone))
        return Question(messages, possible, alone)


KNOWN = 20.0
"""Seconds in which the node must know the robot: it may be reading the meshes of another one."""
CLEARING = 2.0
"""Seconds after which objects are removed again; each time the robot is read anew."""


def ask_robot(robot: RobotMessages, random: Random, client: Client, child: Child) -> None:
    """Remove all objects, send good messages and ask for states, until all free states are valid.

    They may be invalid for a time. Hostile objects from a queue can arrive after the removal, and
    are removed again; attached objects come by another topic. FoundError if colliding states are
    valid, or if free states stay invalid.
    """
    number, start, before, next_time = random.getrandbits(31), time.monotonic(), child.delays(), 0.0
    rows: object = None
    while time.monotonic() < start + KNOWN + child.waited(before):
        if time.monotonic() > next_time:
            client.call(child, Trigger, "clear", Trigger.Request())
            next_time = time.monotonic() + CLEARING
        header = Header(stamp=stamp_to_ros(time.time_ns()), frame_id="map")
        question = robot.question(number, header)
        rows = _ask(question, header, client, child)
        if rows is None:
            return
    raise FoundError(f"after {KNOWN:g} s states of the robot are {rows}; {client.status()}")


def _ask(question: Question, header: Header, client: Client, child: Child) -> object:
    """Send messages and wait for the answer; return None if it is final, else its rows."""
    for topic, message in question.messages:
        client.publishers[topic].publish(message)
    reached = partial(client.answer_at, header.stamp)
    answer = client.until(child, reached, "answer about states of the robot")
    rows = cloud_from_ros(answer, ("valid", "reason"))
    valid = rows["valid"].astype(bool)
    known = len(rows) == len(question.possible) and bool((rows["reason"] != NOT_KNOWN).all())
    may_be = question.alone if known else np.zeros(len(rows), bool)
    if len(rows) != len(may_be) or (valid & ~may_be).any():
        raise FoundError(f"of states of the robot valid are {rows}, possible are {may_be}")
    return None if known and np.array_equal(valid, question.possible) else rows
