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

"""What is missing to know where a robot is: named by a code, until the next accepted state."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from each import each

pytest.importorskip("rclpy")
pytest.importorskip("lxml")
import trimesh
from gate import Gate
from geometry_msgs.msg import TransformStamped
from rclpy.serialization import serialize_message
from rig import cube, pose
from robot_rig import HAND, STATUS, URDF, AskingRig, RobotRig
from sensor_msgs.msg import JointState

from obb_collision.accuracy import Accuracy
from obb_collision.node.diagnostics.answer import COLLIDING
from obb_collision.node.messages.conversions import NANOSECONDS, transform_to_ros
from obb_collision.node.runtime.warm_up import WarmUp

BY_TOPIC = {"robot_bases": ["arm: object_transform"]}
PAST = 60 * NANOSECONDS


def base(rig: RobotRig, x: float) -> TransformStamped:
    """Return a pose of the base, with the next stamp."""
    message = TransformStamped(header=rig.header(), child_frame_id="arm")
    message.transform = transform_to_ros(pose(x))
    return message


def start(rig: RobotRig) -> None:
    """Start a robot whose base comes by its topic."""
    rig.stamp += 2 * PAST
    rig.pubs["object_transform"].publish(base(rig, 1.0))
    rig.start_robot()
    rig.known()


@each(
    "field, value",
    [
        ("transform.translation.x", float("nan")),
        ("header.frame_id", "nowhere"),
        ("header.stamp.nanosec", 4_000_000_000),
    ],
)
def test_a_base_that_is_refused_is_unknown_until_the_next_accepted_pose(
    field: str, value: Any
) -> None:
    with RobotRig(BY_TOPIC) as rig:
        start(rig)
        message = base(rig, 2.0)
        part, _, name = field.rpartition(".")
        setattr(attrgetter(part)(message), name, value)
        rig.pubs["object_transform"].publish(message)
        rig.known("base_unknown", "arm (")
        rig.send_joints(lift=0.0, turn=0.0)
        rig.cycles(2)
        rig.known("base_unknown", "arm (")
        rig.pubs["object_transform"].publish(base(rig, 3.0))
        rig.known()
        np.testing.assert_allclose(rig.pose_of(HAND), pose(4.0, 0.0, 0.5), atol=1e-12)


def test_a_base_whose_sender_restarts_in_the_past_is_unknown_and_then_accepted() -> None:
    with RobotRig(BY_TOPIC) as rig:
        start(rig)
        rig.stamp -= PAST
        rig.pubs["object_transform"].publish(base(rig, 3.0))
        rig.known("base_unknown", "older stamps")

        def placed() -> bool:
            rig.pubs["object_transform"].publish(base(rig, 3.0))
            return bool(rig.pose_of(HAND)[0] == 4.0)

        rig.until(placed, "the new start")
        rig.known()


def test_a_base_that_is_silent_is_unknown() -> None:
    with RobotRig(BY_TOPIC | {"object_timeout_overrides": ["arm/*: 0"]}) as rig:
        start(rig)
        rig.set(object_timeout=0.1)
        rig.cycles(20)
        rig.known()
        rig.pubs["object_transform"].publish(base(rig, 3.0))  # sent again: the limit of all objects
        rig.known("base_unknown", "longer than 0.1 s")
        rig.set(object_timeout=0.0, object_timeout_overrides=["arm: 0.2"])
        for _ in range(2):
            rig.known("base_unknown", "longer than 0.2 s")
            rig.pubs["object_transform"].publish(base(rig, 3.0))
            rig.known()
        rig.set(object_timeout_overrides=[""])
        rig.known()


def joints(rig: RobotRig, **values: float) -> JointState:
    """Return joint states without velocities."""
    return JointState(header=rig.header(), name=list(values), position=list(values.values()))


@each("what", ["stamp", "cut short", "longer"])
def test_joints_whose_state_is_refused_are_unknown_until_one_is_accepted(
    what: str, arm: AskingRig
) -> None:
    arm.known()
    message = joints(arm, lift=0.0)
    if what == "stamp":
        message.header.stamp.nanosec = 4_000_000_000
    data = serialize_message(message)
    cut = {"stamp": data, "cut short": data[:-9], "longer": data + b"\0" * 8}
    arm.joint_states.publish(cut[what])
    assert "lift, turn" not in arm.known("joint_unknown", "lift").message
    arm.joint_states.publish(joints(arm, turn=0.0))
    arm.cycles(2)
    arm.known("joint_unknown", "lift")
    arm.joint_states.publish(joints(arm, lift=0.0))
    arm.known()


def test_joint_states_without_their_names_are_unreadable(arm: AskingRig) -> None:
    arm.known()
    arm.joint_states.publish(serialize_message(joints(arm, lift=0.0))[:30])
    arm.known("input_unreadable", "arm/joint_states")
    arm.joint_states.publish(joints(arm, turn=0.0))
    arm.known()
    arm.joint_states.publish(JointState(header=arm.header(), position=[1.0]))
    arm.known("input_unreadable", "arm/joint_states")


def test_joints_whose_sender_restarts_in_the_past_are_unknown_and_then_accepted() -> None:
    with RobotRig() as rig:
        rig.stamp += 2 * PAST
        rig.start_robot()
        rig.known()
        rig.stamp -= PAST
        rig.send_joints(lift=1.0)
        rig.known("joint_unknown", "lift")

        def placed() -> bool:
            rig.send_joints(lift=1.0)
            return bool(rig.pose_of(HAND)[2] == 1.5)

        rig.until(placed, "the new start")
        rig.known()


def statuses(rig: RobotRig) -> list[Any]:
    """Return the list that all levels of the status are added to from now on."""
    levels: list[Any] = []
    rig.listen(STATUS)
    rig.client.create_subscription(
        type(rig.until(lambda: rig.last.get(STATUS), STATUS)),
        STATUS,
        lambda message: levels.append(message.status[0].level),  # type: ignore[attr-defined]
        50,
    )
    return levels


CORNER = cube(("crate", 1), (1.27, 0.17, 0.58), (0.02, 0.02, 0.02))
"""In the box of the ball that is the hand, and not in the ball."""


def ball(folder: Path) -> str:
    """Return the robot with a flat ball of 1280 faces as its hand."""
    found = trimesh.creation.icosphere(3).apply_scale((0.3, 0.2, 0.1))
    found.export(folder / "ball.obj")
    before, end, after = URDF.rpartition('<box size="0.2 0.2 0.2"/>')
    assert end
    return f'{before}<mesh filename="file://{folder}/ball.obj"/>{after}'


def test_links_whose_hulls_are_being_built_are_unknown_and_collide_with_nothing(
    tmp_path: Path,
) -> None:
    with RobotRig({"mesh_folders": [str(tmp_path)]}) as rig:
        gate, levels = Gate(rig, trees=True), statuses(rig)
        rig.send(CORNER)
        rig.describe(ball(tmp_path))
        rig.known("joint_unknown")
        rig.send_joints(lift=0.0, turn=0.0)
        rig.known("shape_building", "arm/hand/1")
        rig.send(cube(("crate", 2), (9.0, 0.0, 0.0)), cube(("crate", 3), (9.0, 0.0, 0.0)))
        rig.until(lambda: COLLIDING in levels, "a pair of others")
        rig.send(cube(("crate", 2), (9.0, 9.0, 9.0)))
        rig.known("shape_building", "arm/hand/1")
        levels.clear()
        gate.open()
        rig.known()
        assert COLLIDING not in levels


def test_links_are_unknown_while_kernels_of_their_accuracy_are_loaded(tmp_path: Path) -> None:
    is_ready = WarmUp.is_ready
    with RobotRig({"mesh_folders": [str(tmp_path)]}) as rig:
        rig.set(accuracy="obb")
        rig.send(CORNER)
        rig.start_robot(ball(tmp_path))
        rig.until(lambda: len(rig.pairs()), "boxes that meet")

        def lacks_hull(warm: WarmUp, level: Accuracy) -> bool:
            return level != Accuracy.HULL and is_ready(warm, level)

        with patch.object(WarmUp, "is_ready", lacks_hull):
            rig.set(accuracy="hull")
            rig.known("starting")
            levels = statuses(rig)
            rig.cycles(3)
        rig.known()
        assert COLLIDING not in levels
