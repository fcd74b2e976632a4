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

from functools import partial
from itertools import permutations
from pathlib import Path
from threading import Event
from threading import enumerate as enumerate_threads
from typing import Any
from unittest.mock import patch

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("lxml")
import trimesh
from gate import Gate
from rig import STATUS, cube
from robot_rig import HAND, SRDF, URDF, RobotRig
from std_msgs.msg import String

from obb_collision import Accuracy, Robot
from obb_collision.node.diagnostics.answer import COLLIDING
from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.node.runtime import warm_up

PAST = 60 * NANOSECONDS


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
    is_ready = warm_up.WarmUp.is_ready
    with RobotRig({"mesh_folders": [str(tmp_path)]}) as rig:
        rig.set(accuracy="obb")
        rig.send(CORNER)
        rig.start_robot(ball(tmp_path))
        rig.until(lambda: len(rig.pairs()), "boxes that meet")

        def lacks_hull(warm: warm_up.WarmUp, level: Accuracy) -> bool:
            return level != Accuracy.HULL and is_ready(warm, level)

        with patch.object(warm_up.WarmUp, "is_ready", lacks_hull):
            rig.set(accuracy="hull")
            rig.known("starting")
            levels = statuses(rig)
            rig.cycles(3)
        rig.known()
        assert COLLIDING not in levels


def has_text(rig: RobotRig, text: str) -> bool:
    """Return whether a text is the latest of its kind that the node has taken."""
    return text in rig.robot._texts.values()


def test_a_text_that_is_refused_counts_until_the_next_one_of_its_kind() -> None:
    with RobotRig() as rig:
        rig.start_robot()
        rig.known()
        texts = {rig.descriptions: URDF, rig.semantics: SRDF}
        for refused, other in permutations(texts):
            refused.publish(String(data="none"))
            rig.known("robot_unknown")
            other.publish(String(data=texts[other]))
            rig.until(partial(has_text, rig, texts[other]), "the other text")
            rig.cycles(3)
            rig.known("robot_unknown")
            refused.publish(String(data=texts[refused]))
            rig.until(lambda: rig.robot.fault[:5] in ("", "joint"), "the robot")
            rig.send_joints(lift=0.0, turn=0.0)
            rig.known()


def test_of_a_flood_of_descriptions_one_is_read_at_a_time_and_the_last_one_counts() -> None:
    from_urdf, may_go = Robot.from_urdf, Event()
    read: list[str] = []

    def slow(urdf: str, *args: Any, **options: Any) -> Robot:
        read.append(urdf)
        assert may_go.wait(60.0)
        return from_urdf(urdf, *args, **options)

    with RobotRig() as rig, patch.object(Robot, "from_urdf", slow):
        texts = [URDF.replace('name="arm"', f'name="arm{n}"', 1) for n in range(9)]
        for text in texts:
            rig.describe(text)
            rig.until(partial(has_text, rig, text), "a text")
        assert [thread.name for thread in enumerate_threads()].count("robot_description") == 1
        may_go.set()
        rig.known("joint_unknown")
        assert read == [texts[0], texts[-1]]
