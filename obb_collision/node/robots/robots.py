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

"""The robots of a node: their topics, their links among the objects, and what is not known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from copy import copy
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64, String
from trajectory_msgs.msg import JointTrajectory

from obb_collision.node.diagnostics.monitors import InputMonitor, overridable
from obb_collision.node.inputs.inputs import Inputs
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.objects import Objects
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.robots.checked_robot import CheckedRobot, LinkFrames, find_attached
from obb_collision.node.robots.links import NOTHING
from obb_collision.node.robots.robot_input import (
    BASE,
    DESCRIPTION,
    JOINT_STATES,
    SEMANTIC,
    RobotInput,
    RobotReading,
)
from obb_collision.node.robots.trajectories import Trajectories
from obb_collision.node.robots.validity import (
    SERVICE,
    ServiceType,
    SpeedScale,
    StateService,
    ValidityTopics,
)
from obb_collision.node.topics.cloud import LATCHED, RELIABLE
from obb_collision.scene.store.allowed import Rule
from obb_collision.scene_files.mesh_files import MeshReading
from obb_collision.typing import Rows

STATES_TO_CHECK, STATE_VALIDITY = "states_to_check", "state_validity"
SPEED_SCALE = "speed_scale"
TRAJECTORY_IN, TRAJECTORY_OUT = "trajectory_in", "trajectory_out"
TRAJECTORY_STATUS = "trajectory_status"
KINDS = {
    DESCRIPTION: Input(String, 1, durability=LATCHED.durability),
    SEMANTIC: Input(String, 1, durability=LATCHED.durability),
    # As robot_state_publisher: a reliable subscription would receive nothing from best effort.
    JOINT_STATES: Input(JointState, 10, ReliabilityPolicy.BEST_EFFORT),
    STATES_TO_CHECK: Input(PointCloud2, 10, is_query=True),
    TRAJECTORY_IN: Input(JointTrajectory, 10, is_query=True),
}
"""The input topics of each robot, after its name and a slash."""
OUTPUTS: dict[str, tuple[type, QoSProfile]] = {
    STATE_VALIDITY: (PointCloud2, RELIABLE),
    SPEED_SCALE: (Float64, RELIABLE),
    TRAJECTORY_OUT: (JointTrajectory, RELIABLE),
    TRAJECTORY_STATUS: (DiagnosticStatus, LATCHED),
}
"""Its output topics."""


def robot_inputs(parameters: Parameters) -> dict[str, Input]:
    """Return the input topics of all robots."""
    return {f"{name}/{kind}": given for name in parameters.robots for kind, given in KINDS.items()}


class Robots:
    """The robots that the parameters name.

    not_known: why it is not known what is where, "" if it is; meshes: how mesh files are read.
    """

    def __init__(
        self,
        node: Node,
        parameters: Parameters,
        objects: Objects,
        frames: LinkFrames,
        monitors: Mapping[str, InputMonitor],
        clock: Callable[[], int],
        not_known: Callable[[], str],
        meshes: Callable[[], MeshReading],
    ) -> None:
        self._node, self._parameters, self._clock = node, parameters, clock
        self._publishers: dict[str, Publisher] = {}
        self._services: list[Any] = []
        self._validity: dict[str, ValidityTopics] = {}
        self._speeds: list[SpeedScale] = []
        self._touch_links: list[tuple[str, str]] = []
        self._trajectories: dict[str, Trajectories] = {}
        self._objects, self._frames = objects, frames
        self.robots: list[RobotInput] = []
        frames.robots = self.robots
        for base in parameters.bases.values():
            robot = RobotInput(base, objects, monitors, clock, lambda: RobotReading(meshes()))
            self.robots.append(robot)
            self._answer(
                CheckedRobot(robot, objects, frames, not_known, clock, parameters), monitors
            )

    def _answer(self, checked: CheckedRobot, monitors: Mapping[str, InputMonitor]) -> None:
        """Create what answers for a robot."""
        name = checked.given.name
        ends = {kind: self._publisher(f"{name}/{kind}", *of) for kind, of in OUTPUTS.items()}
        topic = f"{name}/{STATES_TO_CHECK}"
        self._validity[topic] = ValidityTopics(checked, ends[STATE_VALIDITY], monitors[topic])
        if ServiceType is not None:
            answer = StateService(checked, monitors[topic]).answer
            service = self._node.create_service(ServiceType, f"{name}/{SERVICE}", answer)
            self._services.append(service)
        topic = f"{name}/{TRAJECTORY_IN}"
        out, status = ends[TRAJECTORY_OUT], ends[TRAJECTORY_STATUS]
        self._trajectories[topic] = Trajectories(checked, out, status, monitors[topic])
        self._speeds.append(SpeedScale(checked, ends[SPEED_SCALE]))

    def _publisher(self, topic: str, kind: type, qos: QoSProfile) -> Publisher:
        callbacks = PublisherEventCallbacks(use_default_callbacks=False)
        options: dict[str, Any] = {"qos_overriding_options": overridable()}
        made = self._node.create_publisher(
            kind, topic, copy(qos), event_callbacks=callbacks, **options
        )
        self._publishers[topic] = made
        return made

    def callbacks(self, inputs: Inputs) -> dict[str, Callable[[bytes], None]]:
        """Return the callback per topic, those that fail being counted; bases come by another."""
        for robot in self.robots:
            inputs.bases[robot.name] = robot.take_base
        takes = {topic: take for robot in self.robots for topic, take in robot.callbacks().items()}
        moved = set(takes)  # all others only ask
        takes |= {topic: validity.take for topic, validity in self._validity.items()}
        takes |= {topic: each.take for topic, each in self._trajectories.items()}
        return {
            topic: inputs.guarded(topic, take, changes=topic in moved)
            for topic, take in takes.items()
        }

    def apply(self) -> bool:
        """Bring the objects in line with what came; returns whether there are other ones."""
        now, timeout = self._clock(), self._parameters.joint_timeout
        changed = [robot.apply(now, timeout) for robot in self.robots]  # all of them
        attached = find_attached(self._objects, self._frames)
        changed += [robot.set_attached(attached.get(robot.name, NOTHING)) for robot in self.robots]
        touch_links = self._parameters.touch_links
        changed.append(touch_links != self._touch_links)
        self._touch_links = touch_links
        return any(changed)

    def publish(self) -> None:
        """Publish what each cycle publishes; trajectories first, for they may have to stop."""
        try:
            for each in self._trajectories.values():
                each.look()
        finally:
            for speed in self._speeds:
                speed.publish()

    def rules(self) -> list[Rule]:
        """Return which links may touch."""
        touch_links = self._parameters.touch_links
        described = [(robot.links, robot.attached) for robot in self.robots]
        return [
            rule
            for links, attached in described
            if links is not None
            for rule in links.rules(attached, touch_links)
        ]

    def faults(self) -> Iterator[tuple[str, str, Rows]]:
        """Yield what is not known of robots, as a code of ``evidence``, of which and why.

        And the slots (n,) of the links that are not known therefore.
        """
        now, timeout = self._clock(), self._parameters.joint_timeout
        for robot in self.robots:
            robot.look(now, timeout)
            faults = dict(robot.faults)
            try:
                if robot.where is not None:
                    self._frames.base(robot)
            except RefusedError as error:
                faults.setdefault(BASE, error.detail)
            slots = NOTHING.slots if robot.links is None else robot.links.slots
            for code, fault in faults.items():
                yield code, f"{robot.name} ({fault})", slots

    def notes(self) -> tuple[str, ...]:
        """Return what else is to be said in the status: why robots were stopped, or are to be."""
        robots = zip(self.robots, self._trajectories.values(), strict=True)
        return tuple(
            f"robot {robot.name}: {text}"
            for robot, each in robots
            for text in (each.stopped, robot.halt and f"speed_scale is 0: {robot.halt}")
            if text
        )

    def hold(self, why: str) -> None:
        """Stop what runs or is being decided where the joints are now."""
        for each in self._trajectories.values():
            each.interrupt(why)

    def cleared(self) -> None:
        """Make anew what ``~/clear`` has removed."""
        now = self._clock()
        for robot in self.robots:
            robot.cleared(now)

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        for robot in self.robots:
            robot.clock_jumped(shift)
        for each in self._trajectories.values():
            each.clock_jumped(shift)

    def stop(self) -> None:
        """Stop what runs, and forward no more; also from another thread, and again."""
        for each in self._trajectories.values():
            each.close()

    def close(self) -> None:
        """End what is being read, and publish no more."""
        for robot in self.robots:
            robot.close()
        self.stop()
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
        self._publishers.clear()
        for service in self._services:
            self._node.destroy_service(service)
        self._services.clear()
