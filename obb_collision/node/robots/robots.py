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

"""The robots of a node: their topics, their links among the objects, and their faults."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64, String
from trajectory_msgs.msg import JointTrajectory

from obb_collision.node.diagnostics.monitors import make_publisher
from obb_collision.node.inputs.inputs import Inputs
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.objects import Objects
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.robots.checked_robot import CheckedRobot, LinkFrames, find_attached
from obb_collision.node.robots.links import NONE_ATTACHED
from obb_collision.node.robots.robot_input import (
    BASE,
    DESCRIPTION,
    JOINT_STATES,
    SEMANTIC,
    RobotInput,
)
from obb_collision.node.robots.speed import SPEED_SCALING_FACTOR, SpeedScale, SpeedScalingFactor
from obb_collision.node.robots.trajectories import Trajectories
from obb_collision.node.robots.validity import (
    SERVICE,
    ServiceType,
    StateService,
    ValidityTopics,
)
from obb_collision.node.topics.cloud import LATCHED, RELIABLE, Topic
from obb_collision.scene.store.allowed import AllowedMatrix
from obb_collision.scene_files.mesh_files import MeshReading
from obb_collision.typing import Rows

STATES_TO_CHECK, STATE_VALIDITY = "states_to_check", "state_validity"
PATH_TO_CHECK, PATH_VALIDITY = "path_to_check", "path_validity"
SPEED_SCALE = "speed_scale"
TRAJECTORY_IN, TRAJECTORY_OUT = "trajectory_in", "trajectory_out"
TRAJECTORY_STATUS = "trajectory_status"
JOG_IN = "jog_in"
KINDS = {
    DESCRIPTION: Input(String, 1, durability=LATCHED.durability, meaning="The URDF."),
    SEMANTIC: Input(String, 1, durability=LATCHED.durability, meaning="The SRDF, if there is one."),
    # As robot_state_publisher: a reliable subscription would receive nothing from best effort.
    JOINT_STATES: Input(
        JointState,
        10,
        ReliabilityPolicy.BEST_EFFORT,
        meaning="Positions of joints; a message may have any part of them.",
    ),
    STATES_TO_CHECK: Input(
        PointCloud2,
        10,
        is_query=True,
        meaning="States to check: a row per state, a float64 field per joint, named like the "
        "joint.",
    ),
    PATH_TO_CHECK: Input(
        PointCloud2,
        10,
        is_query=True,
        meaning="A path to check: states as in states_to_check, straight motions between.",
    ),
    TRAJECTORY_IN: Input(
        JointTrajectory, 10, is_query=True, meaning="A trajectory to forward if it is free."
    ),
    JOG_IN: Input(
        JointTrajectory,
        1,
        is_query=True,
        meaning="The jog that speed_scale scales: velocities of the first point, before scaling.",
    ),
}
"""The input topics of each robot, after its name and a slash."""
ROBOT_NOT_KNOWN = "robot not known"
"""Reason: points of a robot cannot be left out while its state is not known."""
OUTPUTS = (
    Topic(
        name=STATE_VALIDITY,
        message=PointCloud2,
        description="A row per state to check: valid, or the reason why not.",
    ),
    Topic(
        name=PATH_VALIDITY,
        message=PointCloud2,
        description="One row per path to check: valid all the way, or where it is not, and why.",
    ),
    Topic(
        name=SPEED_SCALE,
        message=Float64,
        description="Every cycle: 1 far from objects, 0 near objects or while collisions are "
        "unknown.",
    ),
    Topic(
        name=TRAJECTORY_OUT,
        message=JointTrajectory,
        description="Free trajectories, unchanged, and stops.",
    ),
    Topic(
        name=TRAJECTORY_STATUS,
        message=DiagnosticStatus,
        qos=LATCHED,
        description="Forwarded, refused or stopped, with the reason.",
    ),
)
"""Its output topics, after its name and a slash."""


def robot_inputs(names: Iterable[str]) -> dict[str, Input]:
    """Return the input topics of robots."""
    return {
        f"{name}/{kind}": kind_of_input for name in names for kind, kind_of_input in KINDS.items()
    }


class RobotAnswers:
    """Answers questions about one robot: by topics and, where moveit_msgs is installed, a service.

    undo: ends them.
    """

    def __init__(self, node: Node, undo: ExitStack, checked: CheckedRobot) -> None:
        self.checked, name = checked, checked.input.name
        self._log, self._told = node.get_logger().info, object()
        self.publishers = {
            topic.name: make_publisher(node, topic.message, f"{name}/{topic.name}", topic.qos)
            for topic in OUTPUTS
        }
        for publisher in self.publishers.values():
            undo.callback(node.destroy_publisher, publisher)
        asked, wanted = (
            checked.objects.monitors[f"{name}/{kind}"] for kind in (STATES_TO_CHECK, TRAJECTORY_IN)
        )
        rows = (self.publishers[topic] for topic in (STATE_VALIDITY, PATH_VALIDITY))
        self.validity = ValidityTopics(checked, *rows)
        ends = self.publishers[TRAJECTORY_OUT], self.publishers[TRAJECTORY_STATUS]
        self.trajectories = Trajectories(checked, *ends, wanted)
        factor = None
        if SpeedScalingFactor is not None:
            topic = f"{name}/{SPEED_SCALING_FACTOR}"
            factor = make_publisher(node, SpeedScalingFactor, topic, RELIABLE)
            undo.callback(node.destroy_publisher, factor)
        self.speed = SpeedScale(checked, self.publishers[SPEED_SCALE], factor)
        if ServiceType is not None:
            answer = StateService(checked, asked).answer
            service = node.create_service(ServiceType, f"{name}/{SERVICE}", answer)
            undo.callback(node.destroy_service, service)

    def tell_stopping(self) -> None:
        """Log how the robot is slowed and stopped, at the start and after changes."""
        if self.checked.input.joints is None or self.checked.stopping is self._told:
            return
        self._told = stopping = self.checked.stopping
        how = f"within {stopping.time(stopping.speeds):.3g} s: speed_scale goes by direction, and "
        how += "stops of trajectories brake along them"
        if stopping.lacking:
            how = "in an unknown time: speed_scale goes by distance, and stops of trajectories "
            how += f"hold the latest position ({stopping.lacking})"
        self._log(f"robot {self.checked.input.name} stops {how}")


class Robots:
    """The robots that the parameters of a node name.

    frames: those of their links, and others; meshes: reads mesh files; now: time of the node's
    clock (ns); not_known: returns why collisions are not known, "" if they are.
    """

    def __init__(
        self,
        node: Node,
        undo: ExitStack,
        parameters: Parameters,
        objects: Objects,
        frames: LinkFrames,
        meshes: Callable[[], MeshReading],
        now: Callable[[], int],
        not_known: Callable[[], str],
    ) -> None:
        self._parameters, self._clock, self._objects = parameters, now, objects
        self._touch_links: list[tuple[str, str]] = []
        self._frames, self._not_known = frames, not_known
        self.robots = [RobotInput(base, objects, meshes) for base in parameters.bases.values()]
        frames.robots = self.robots
        self.answers = [
            RobotAnswers(
                node, undo, CheckedRobot(robot, objects, frames, parameters, now, self._why_unknown)
            )
            for robot in self.robots
        ]

    def _why_unknown(self) -> str:
        """Return why states cannot be checked now, "" if they can, with what is attached."""
        unknown = self._not_known()
        if not unknown:
            self.attach()
        return unknown

    def callbacks(self, inputs: Inputs) -> dict[str, Callable[[bytes], None]]:
        """Return the callback per topic; failures are counted. Bases come by another callback."""
        callbacks = {}
        for robot, answers in zip(self.robots, self.answers, strict=True):
            inputs.bases[robot.name] = robot.store_base
            takes: dict[str, Callable[[bytes, int], None]] = {
                DESCRIPTION: partial(robot.receive_text, DESCRIPTION),
                SEMANTIC: partial(robot.receive_text, SEMANTIC),
                JOINT_STATES: robot.store_joints,
                STATES_TO_CHECK: answers.validity.answer,
                PATH_TO_CHECK: answers.validity.answer_path,
                TRAJECTORY_IN: answers.trajectories.receive,
                JOG_IN: answers.speed.jog.receive,
            }
            for kind, take in takes.items():
                topic, changes = f"{robot.name}/{kind}", not KINDS[kind].is_query
                callbacks[topic] = inputs.guarded(topic, take, changes=changes)
        return callbacks

    def apply(self) -> None:
        """Update the objects of robots, and which of them may touch."""
        if not self.robots:  # as in most nodes: it costs nothing
            return
        now, timeout = self._clock(), self._parameters.joint_timeout
        changed = [robot.apply(now, timeout) for robot in self.robots]  # all of them
        touch_links = self._parameters.touch_links
        changed.append(touch_links != self._touch_links)
        self._touch_links = touch_links
        self.attach(any(changed))

    def attach(self, renews: bool = False) -> None:
        """Find the attached objects, and update the rules where they have changed.

        Also between two cycles: a pose that comes applies the markers before it. renews: whether
        the rules are others anyway.
        """
        attached = find_attached(self._objects, self._frames)
        changed = [
            robot.set_attached(attached.get(robot.name, NONE_ATTACHED)) for robot in self.robots
        ]
        if renews or any(changed):
            self._objects.scene.rules.matrix = self._matrix()

    def publish(self) -> None:
        """Publish what each cycle publishes; trajectories first, for they may have to stop."""
        try:
            for answers in self.answers:
                answers.trajectories.check_more()
        finally:
            for answers in self.answers:
                answers.speed.publish()
                answers.tell_stopping()

    def _matrix(self) -> AllowedMatrix:
        """Return which links and attached objects may touch."""
        parts = [
            robot.links.matrix(robot.attached, self._parameters.touch_links)
            for robot in self.robots
            if robot.links is not None
        ]
        return parts[0] if len(parts) == 1 else AllowedMatrix.joined(parts)

    def faults(self) -> Iterator[tuple[str, str, Rows]]:
        """Yield faults of robots: code of ``evidence``, name and reason, slots (n,) of links."""
        for robot in self.robots:
            robot.update_faults(self._clock(), self._parameters.joint_timeout)
            faults = dict(robot.faults)
            try:
                if robot.where is not None:
                    old = robot.transform_fault(self._frames.base(robot)[1], self._clock())
                    if old:
                        faults.setdefault(BASE, old)
            except RefusedError as error:
                faults.setdefault(BASE, error.detail)
            slots = NONE_ATTACHED.slots if robot.links is None else robot.links.slots
            for code, fault in faults.items():
                yield code, f"{robot.name} ({fault})", slots

    def notes(self) -> Iterator[str]:
        """Yield notes for the status: why robots were stopped, or are to stop."""
        for robot, answers in zip(self.robots, self.answers, strict=True):
            halt = robot.halt and f"speed_scale is 0: {robot.halt}"
            texts = filter(None, (answers.trajectories.stopped, halt))
            yield from (f"robot {robot.name}: {text}" for text in texts)

    def hold(self, why: str) -> None:
        """Stop and refuse all trajectories: the joints stay where they are."""
        for answers in self.answers:
            answers.trajectories.interrupt(why)

    def cleared(self) -> None:
        """Add again the links that ``~/clear`` has removed."""
        for robot in self.robots:
            robot.cleared()

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        for robot in self.robots:
            robot.clock_jumped(shift)
        for answers in self.answers:
            answers.trajectories.clock_jumped(shift)

    def parts(self, name: str) -> tuple[Rows, int]:
        """Return the slots of a robot's links and attached objects, and up to when they are known.

        In ns, as ``RobotInput.known_until``. RefusedError while the robot is unknown.
        """
        (robot,) = (robot for robot in self.robots if robot.name == name)
        if robot.faults or robot.links is None or robot.joints is None:
            raise RefusedError(ROBOT_NOT_KNOWN, f"{name}: {robot.fault}")
        slots = np.concatenate([robot.links.slots, robot.attached.slots])
        return slots, robot.known_until(self._parameters.joint_timeout)

    def stop(self) -> None:
        """Stop what runs, and forward no more; also from another thread, and again."""
        for answers in self.answers:
            answers.trajectories.close()

    def close(self) -> None:
        """Stop reading, and stop trajectories."""
        for robot in self.robots:
            robot.close()
        self.stop()
