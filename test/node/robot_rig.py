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

from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rig import LATCHED, NAMESPACE, RELIABILITY, Rig
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from obb_collision.node.diagnostics.answer import FREE, UNKNOWN

STATUS = "collision_status"


def box(edge: float, place: str = "0 0 0") -> str:
    """Return a collision geometry."""
    size = f"{edge} {edge} {edge}"
    return (
        f'<collision><origin xyz="{place}"/><geometry><box size="{size}"/></geometry></collision>'
    )


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
            "cycle_timeout": 30.0,
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
        """Send a URDF."""
        self.descriptions.publish(String(data=urdf))

    def send_joints(
        self, velocities: Mapping[str, float] | None = None, /, **values: float
    ) -> None:
        """Send values of joints, with the next stamp."""
        message = JointState(header=self.header(), name=list(values))
        message.position = [float(value) for value in values.values()]
        message.velocity = [float((velocities or {}).get(name, 0.0)) for name in values]
        self.joint_states.publish(message)

    def start_robot(self, urdf: str = URDF, **values: float) -> None:
        """Send a URDF, wait for the robot, and for the answer to its joints."""
        self.describe(urdf)
        self.until(lambda: self.robot.fault[:5] in ("", "joint"), "the robot")
        self.send_joints(None, **({"lift": 0.0, "turn": 0.0} | values))
        self.answer()

    def known(self, reason: str = "", who: str = "") -> DiagnosticStatus:
        """Wait until the status has a reason, "" for free, and who; return it."""
        if STATUS not in self.subscriptions:
            self.listen(STATUS)

        def reached() -> Any:
            status = self.last[STATUS].status[0] if STATUS in self.last else DiagnosticStatus()
            values = {pair.key: pair.value for pair in status.values}
            level = UNKNOWN if reason else FREE
            found = status.level == level and values.get("reason") == reason
            return found and who in values["who"] and status

        found: DiagnosticStatus = self.until(reached, f"{reason or 'free'} {who}")
        return found

    @property
    def robot(self) -> Any:
        """The robot of the node."""
        assert self.node.robots is not None
        return self.node.robots.robots[0]
