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

"""A robot for tests of the node, a column that lifts and turns a hand, and its topics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rig import HEARD, LATCHED, NAMESPACE, RELIABILITY, Client, Rig, cube
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.node.messages.conversions import duration_to_ros, stamp_from_ros
from obb_collision.node.parameters.parameters import SPECS
from obb_collision.node.robots import validity

validity.LONGEST_CHECK = 30.0  # slow enough for a loaded machine

CRATE, HAND = ("crate", 1), ("arm/hand", 1)
EDGES = (0.1, 0.1, 0.1)
Velocities: TypeAlias = "Mapping[str, float] | None"
BOTH = ("lift", "turn")
REASONS = "valid", "collides", "out of limits", "bad state", "unknown"
"""Those of ``state_validity``, by their documented numbers."""
ROW = ("distance", "index", "ns_a", "id_a", "ns_b", "id_b", "valid", "reason")


def box(edge: float, place: str = "0 0 0") -> str:
    geometry = f'<geometry><box size="{edge} {edge} {edge}"/></geometry>'
    return f'<collision><origin xyz="{place}"/>{geometry}</collision>'


def joint(name: str, kind: str, parent: str, child: str, place: str) -> str:
    """Return a joint along, or about, z."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="0 0 1"/><limit lower="-3" upper="3"/></joint>'
    )


URDF = (
    '<robot name="arm">'
    f'<link name="base">{box(0.2)}</link>'
    f'<link name="column">{box(0.1)}</link>'
    f'<link name="hand">{box(0.1, "0.5 0 0")}{box(0.2, "1 0 0")}</link>'
    f"{joint('lift', 'prismatic', 'base', 'column', '0 0 0.5')}"
    f"{joint('turn', 'revolute', 'column', 'hand', '0 0 0')}"
    "</robot>"
)
"""The hand is 1 m from the axis; with ``lift`` at -0.5 it is at the height of the base."""
SRDF = '<robot name="arm"><disable_collisions link1="base" link2="hand" reason="Never"/></robot>'
HERE = "arm: 0 0 0 0 0 0 1"


class RobotRig(Rig):
    """A node with the robot ``arm`` at the origin, whose joint states are never stale."""

    def __init__(self, given: Mapping[str, Any] | None = None, **options: Any) -> None:
        defaults: dict[str, Any] = {
            "robots": ["arm"],
            "robot_bases": [HERE],
            "joint_timeout": 0.0,
            "expect_empty": True,
            # as surely as all else, so that a test need not send them twice
            f"qos_overrides.{NAMESPACE}/arm/joint_states.{RELIABILITY}": "reliable",
        }
        super().__init__(given=defaults | dict(given or {}), **options)
        create = self.client.create_publisher
        self.descriptions = create(String, "arm/robot_description", LATCHED)
        self.semantics = create(String, "arm/robot_description_semantic", LATCHED)
        self.joint_states = create(JointState, "arm/joint_states", 10)
        self.pubs |= {"descriptions": self.descriptions, "joint_states": self.joint_states}
        self.wait_inputs()

    def describe(self, urdf: str = URDF) -> None:
        self.descriptions.publish(String(data=urdf))

    def send_joints(self, velocities: Velocities = None, /, **values: float) -> Client:
        message = JointState(header=self.header(), name=list(values))
        message.position = [float(value) for value in values.values()]
        message.velocity = [float((velocities or {}).get(name, 0.0)) for name in values]
        self.joint_states.publish(message)
        return self

    def read(self, urdf: str = URDF) -> None:
        """Send a URDF, and wait until the robot is that."""
        self.describe(urdf)
        robot = self.robot

        def is_read() -> bool:
            is_taken = urdf in robot._texts.values() and robot.reading is None
            return is_taken and robot.fault[:5] in ("", "joint")

        self.until(is_read, "the robot")

    def start_robot(self, urdf: str = URDF, **values: float) -> None:
        """Send a URDF, wait for the robot, and for the answer to its joints."""
        self.read(urdf)
        self.send_joints(None, **({"lift": 0.0, "turn": 0.0} | values)).answer()

    @property
    def robot(self) -> Any:
        return self.node.robots.robots[0]

    @property
    def ends(self) -> Any:
        """What answers for the robot."""
        return self.node.robots.answers[0]

    def put(self, place: Sequence[float], size: Sequence[float] = EDGES) -> None:
        self.send(cube(CRATE, place, size)).answer()

    def move(self, velocities: Velocities = None, /, **values: float) -> None:
        """Send values of joints, and wait for the answer to them; others are zero."""
        self.send_joints(velocities, **({"lift": 0.0, "turn": 0.0} | values)).answer()


class AskingRig(RobotRig):
    """A rig that asks which states are valid, and sends trajectories."""

    def __init__(self, given: Mapping[str, Any] | None = None, **options: Any) -> None:
        super().__init__(given, **options)
        create, listen = self.client.create_publisher, self.client.create_subscription
        self.questions = create(PointCloud2, "arm/states_to_check", 10)
        self.paths = create(PointCloud2, "arm/path_to_check", 10)
        self.wanted = create(JointTrajectory, "arm/trajectory_in", 10)
        self.pubs |= {"questions": self.questions, "paths": self.paths, "wanted": self.wanted}
        self.answers: list[PointCloud2] = []
        self.forwarded: list[Any] = []
        self.said: list[Any] = []
        for topic in ("state_validity", "path_validity"):
            listen(PointCloud2, f"arm/{topic}", self.answers.append, 10)
        listen(JointTrajectory, "arm/trajectory_out", self.forwarded.append, 10)
        listen(DiagnosticStatus, "arm/trajectory_status", self.said.append, 10)
        self.wait_inputs()
        for name in ("state_validity", "path_validity", "trajectory_out", "trajectory_status"):
            self.until(self.ends.publishers[name].get_subscription_count, name)
        names = [spec.name for spec in SPECS if not spec.fixed]
        self.initial = {name: self.node.get_parameter(name).value for name in names}

    def renew(self) -> None:
        """Take everything back: topics, parameters, objects, the robot, and what was refused."""
        trajectories, robot = self.ends.trajectories, self.robot
        was_running, was_deciding = trajectories.running is not None, trajectories.deciding
        self.ignore(*self.subscriptions.keys() - {*HEARD})
        self.said.clear()
        self.forwarded.clear()
        values = {name: self.node.get_parameter(name).value for name in self.initial}
        self.set(**{n: v for n, v in self.initial.items() if v != values[n]})
        self.call(Trigger, "obb_collision/clear", Trigger.Request())
        if robot._refused or robot._texts != {"robot_description": URDF}:
            robot._texts.clear()
            robot._refused.clear()
            self.read()
        self.stamp = max(self.stamp, self.now())
        self.move()
        if was_running and trajectories.stopped:
            self.stopped()  # or it would come amid what is sent next
        elif was_deciding:
            self.until(lambda: self.said, "its refusal")
        for monitor in self.node.monitors.values():
            monitor.refused.clear()
            monitor.doubted.clear()

    another_case = renew

    def ask(self, states: Any, names: Sequence[str] = BOTH, kind: str = "<f8") -> np.ndarray:
        """Return the rows of the answer to states (n, joints)."""
        return cloud_from_ros(self._asked(self.questions, states, names, kind), ROW)

    def ask_path(self, states: Any) -> np.void:
        """Return the row of the answer to a path (n, joints)."""
        answer = self._asked(self.paths, states, BOTH, "<f8")
        (row,) = cloud_from_ros(answer, ("fraction", *ROW[1:]))
        return row

    def _asked(self, question: Any, states: Any, names: Sequence[str], kind: str) -> PointCloud2:
        rows = np.zeros(len(states), [(name, kind) for name in names])
        for column, name in enumerate(names):
            rows[name] = np.asarray(states)[:, column]
        self.answers.clear()
        question.publish(cloud_to_ros(rows, self.header()))
        self.until(lambda: self.answers, "the answer")
        assert stamp_from_ros(self.answers[0].header.stamp) == self.stamp
        return self.answers[0]

    def reasons(self, states: Any, **options: Any) -> list[str]:
        """Return why states are not valid, in words; valid and reason must fit."""
        rows = self.ask(states, **options)
        assert rows["index"].tolist() == list(range(len(states)))
        np.testing.assert_array_equal(rows["valid"] == 1, rows["reason"] == 0)
        return [REASONS[reason] for reason in rows["reason"]]

    def publish(self, points: Any, names: Any = BOTH, stamp: Any = None) -> JointTrajectory:
        """Send points (time, positions, velocities, accelerations), and return the message."""
        self.said.clear()
        self.forwarded.clear()
        message = JointTrajectory(joint_names=list(names))
        if stamp is not None:
            message.header = stamp
        fields = ("positions", "velocities", "accelerations")
        for time, *values in points:
            given = {f: [*map(float, rows)] for f, rows in zip(fields, values, strict=False)}
            point = JointTrajectoryPoint(time_from_start=duration_to_ros(time), **given)
            message.points.append(point)
        self.wanted.publish(message)
        return message

    def go(self, *given: Any, **more: Any) -> tuple[Any, dict[str, str]]:
        """Send points as ``publish`` does; return what is said of them, and its values by key.

        What is forwarded is what was sent, and nothing else is.
        """
        message = self.publish(*given, **more)
        self.until(lambda: self.said, "what is said of it")
        status = self.said[0]
        is_forwarded = status.level == DiagnosticStatus.OK
        if is_forwarded:
            self.until(lambda: self.forwarded, "the trajectory")
        assert self.forwarded == ([message] if is_forwarded else [])
        return status, {pair.key: pair.value for pair in status.values}

    def refused_for(self, reason: str, *given: Any, **more: Any) -> dict[str, str]:
        """Send points that are refused for a reason; return the values of the status."""
        status, values = self.go(*given, **more)
        assert status.level == DiagnosticStatus.ERROR
        assert reason in status.message
        return values

    def begin(self, *given: Any, **more: Any) -> dict[str, str]:
        """Send points that are forwarded; return the values of the status."""
        status, values = self.go(*given, **more)
        assert status.message == "forwarded"
        self.said.clear()
        self.forwarded.clear()
        return values

    def run(self, turn: float = np.pi / 2) -> None:
        """Start a trajectory that takes a thousand seconds."""
        self.move()
        self.begin([(0.0, [0.0, 0.0]), (1000.0, [0.0, turn])])

    def rest(self) -> None:
        """End what runs, by an empty trajectory."""
        self.publish([])
        self.stopped()

    def forwards(self, *given: Any, **more: Any) -> dict[str, str]:
        """Send points that are forwarded, and end what runs; return the values of the status."""
        values = self.begin(*given, **more)
        self.rest()
        return values

    def stopped(self) -> str:
        """Wait for a stop, and return what is said of it."""
        self.until(lambda: self.said, "what is said of the stop")
        self.until(lambda: self.forwarded and not self.forwarded[-1].points, "the stop")
        return str(self.said[0].message)
