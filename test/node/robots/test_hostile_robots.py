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


"""Hostile messages on the topics of a robot: refused with the reason, nothing else disturbed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from threading import Thread
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from each import each
from rig import FakeFrames, cube, pose
from robot_rig import BOTH, HAND, NOT_KNOWN, ROW, URDF, VALID, AskingRig, RobotRig
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger

from obb_collision.node.diagnostics.answer import COLLIDING
from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.robots.description import MOST_GEOMETRIES
from obb_collision.scene.building import process

NAN = float("nan")


def send(
    rig: RobotRig, names: Sequence[str], positions: Sequence[float], *velocities: float
) -> None:
    """Send joint states as they are, and wait for what comes of them."""
    message = JointState(header=rig.header(), name=list(names))
    message.position, message.velocity = [float(x) for x in positions], list(velocities)
    before = rig.monitor("arm/joint_states").messages
    rig.joint_states.publish(message)
    rig.until(lambda: rig.monitor("arm/joint_states").messages > before, "the joints")
    rig.cycles(1)


def assert_well(rig: RobotRig) -> None:
    """Good joints are answered as if nothing had been, and nothing failed inside."""
    rig.move(lift=0.25)
    assert rig.robot.fault == ""
    np.testing.assert_allclose(rig.pose_of(("arm/hand", 0)), pose(0.5, 0.0, 0.75), atol=1e-12)
    assert rig.node.guard.total == 0, rig.node.guard.last


@each("speed", [5e-324, 1e-310, 1e-20, 1e300, 1e9, NAN, np.inf, -1e308])
def test_any_velocity_leaves_the_links_where_the_positions_say_and_the_description_read(
    arm: AskingRig, monkeypatch: pytest.MonkeyPatch, speed: float
) -> None:
    robot = arm.robot.links.robot
    monkeypatch.setattr(arm.robot, "read", None)
    send(arm, BOTH, (0.25, 0.0), speed, 0.0)
    np.testing.assert_allclose(arm.pose_of(HAND), pose(1.0, 0.0, 0.75), atol=1e-12)
    assert arm.robot.fault == ""
    assert arm.call(Trigger, "obb_collision/clear", Trigger.Request()).success
    arm.cycles(1)
    assert arm.robot.fault.startswith("joints without a state")
    assert_well(arm)
    assert arm.robot.links.robot is robot


@each("speed", [1e-9, 1e-6, 1e-3, 1.0])
def test_slow_joints_have_twists_in_proportion(arm: AskingRig, speed: float) -> None:
    send(arm, BOTH, (0.0, 0.0), speed, 0.0)
    table = arm.node.objects.table
    twist = table.twist[table.slots["arm/hand", 0]]
    np.testing.assert_allclose(twist, [0, 0, speed, 0, 0, 0], atol=1e-9 * speed + 1e-15)


@each(
    "names, positions, reason",
    [
        (BOTH, (NAN, 0.0), "bad position"),
        (BOTH, (0.0, -np.inf), "bad position"),
        ((*BOTH, "lift"), (0.0, 0.0, 1.0), "repeated joint"),
        (("lift", "lift"), (NAN, 0.0), "repeated joint"),
        (BOTH, (0.0,), "array lengths differ"),
        (["x" * 1_000_000, "", "turn\n"], (0.0, 0.0, 0.0), ""),
        ([f"j{k}" for k in range(20_000)], np.zeros(20_000).tolist(), ""),
    ],
)
def test_joints_that_cannot_be_used_are_refused_with_the_reason(
    arm: AskingRig, names: Sequence[str], positions: Sequence[float], reason: str
) -> None:
    before = arm.refused("arm/joint_states").get(reason, 0)
    send(arm, names, positions)
    fault = "joints whose state was refused" if reason else ""
    assert arm.robot.fault.partition(":")[0] == fault
    assert not reason or arm.refused("arm/joint_states")[reason] > before
    assert_well(arm)


def test_what_fails_unforeseen_leaves_the_robot_unknown_and_the_next_joints_place_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with AskingRig() as arm:
        arm.start_robot()
        with monkeypatch.context() as patch:
            patch.setattr(arm.robot.links, "place", lambda *_: 1 // 0)
            send(arm, BOTH, (1.0, 0.0))
            arm.cycles(2)
            assert "links not placed: internal error" in arm.robot.fault
            assert arm.node.guard.total == 1
        arm.move()
        assert arm.robot.fault == ""


BEFORE, BETWEEN, AFTER = URDF.split("<limit")
SMALL = '<box size="0.1 0.1 0.1"/>'
SPHERE = "<collision><geometry><sphere radius='1'/></geometry></collision>"
ENTITIES = '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;">]>'
BAD_DESCRIPTIONS = [
    (f'{BEFORE}<mimic joint="turn"/><limit{BETWEEN}<mimic joint="lift"/><limit{AFTER}', "mimic"),
    (URDF.replace("0.1 0.1 0.1", "0.1 -1 0.1"), "negative"),
    (URDF.replace(SMALL, '<mesh filename="package://no/a"/>'), "mesh"),
    (URDF.replace(SMALL, '<mesh filename="/etc/passwd"/>'), "mesh"),
    (ENTITIES + URDF.replace('name="arm"', 'name="&b;"'), "document type"),
    (URDF.replace('name="arm"', f'name="{"x" * 1_000_000}"'), "name"),
    (URDF.replace("</link>", SPHERE * MOST_GEOMETRIES + "</link>", 1), f"{MOST_GEOMETRIES} is the"),
    ("/etc/hostname", "no XML"),
    ("<robot", "urdf:1"),
]


def test_descriptions_that_cannot_be_used_leave_the_robot_unknown_and_the_pairs(
    arm: AskingRig,
) -> None:
    arm.move(lift=0.25)
    arm.put((1.0, 0.0, 0.75))

    @each("text, reason", BAD_DESCRIPTIONS)
    def check(text: str, reason: str) -> None:
        before = arm.refused("arm/robot_description").get("bad description", 0)
        arm.describe(text)
        arm.until(lambda: "refused" in arm.robot.fault, "the refusal")
        assert reason in arm.robot.fault
        assert len(arm.robot.fault) < 1000
        assert arm.reasons([[0.0, 0.0]]) == [NOT_KNOWN]
        arm.put((9.0, 0.0, 0.75))
        assert arm.pairs() == set()
        arm.known("robot_unknown", reason)
        arm.put((1.0, 0.0, 0.75))
        assert {frozenset(pair) for pair in arm.pairs()} == {frozenset(("arm/hand/1", "crate/1"))}
        assert reason in arm.says(COLLIDING, "arm (robot_description refused")["message"]
        assert arm.refused("arm/robot_description") == {"bad description": before + 1}
        arm.read()
        assert_well(arm)

    check()


def _cloud(rig: RobotRig, **fields: str) -> PointCloud2:
    return cloud_to_ros(np.zeros(3, list(fields.items())), rig.header())


def test_states_that_cannot_be_read_are_never_valid(arm: AskingRig) -> None:
    twice, short = (_cloud(arm, lift="<f8", turn="<f8") for _ in range(2))
    twice.fields.append(twice.fields[0])
    short.data = short.data[:-1]
    nothing = PointCloud2(header=arm.header(), width=9_000_000, height=1)
    for message, reason, answered in (
        (twice, "field layout", True),
        (_cloud(arm, lift="<f4", turn="<f8"), "field layout", True),
        (_cloud(arm, lift="<i4", turn="<f8"), "field layout", True),
        (_cloud(arm, lift="<f8"), "missing joint", True),
        (_cloud(arm, lift="<f8", turn="<f8", nose="<f8"), "unknown joint", True),
        (short, "field layout", False),
        (nothing, "field layout", False),
    ):
        before = arm.refused("arm/states_to_check").get(reason, 0)
        arm.answers.clear()
        arm.questions.publish(message)
        while arm.refused("arm/states_to_check").get(reason, 0) == before:
            arm.cycles(1)
        if answered:
            arm.until(lambda: arm.answers, "the answer")
            answer = cloud_from_ros(arm.answers[0], ROW)
            assert answer["reason"].tolist() == [NOT_KNOWN] * 3
            assert not answer["valid"].any()
        rows = arm.ask([[0.25, 0.0], [NAN, 0.0], [9.0, 0.0]])
        assert rows["valid"].tolist() == [1, 0, 0]
        assert rows["reason"][0] == VALID
        assert_well(arm)


def test_a_base_that_jumps_to_no_pose_leaves_the_robot_unknown() -> None:
    frames = FakeFrames()
    frames.known["stand"] = pose(0.0)
    given: dict[str, Any] = {"robot_bases": ["arm: stand"]}
    with AskingRig(given, frames=frames, transform_timeout=0.0) as rig:
        rig.start_robot()
        assert rig.reasons([[0.0, 0.0]]) == [VALID]
        for bad in ([NAN] * 7, [1e308] * 7, [0.0] * 7, [0, 0, np.inf, 0, 0, 0, 1]):
            frames.known["stand"] = bad
            assert rig.reasons([[0.0, 0.0]]) == [NOT_KNOWN]
            rig.cycles(2)
            frames.known["stand"] = pose(0.0)
            assert_well(rig)
            assert rig.reasons([[0.0, 0.0]]) == [VALID]


def test_a_reading_that_does_not_begin_is_said_and_a_later_description_is_read(
    arm: AskingRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    fails = Mock(side_effect=RuntimeError("can't start new thread"))
    starts = (f"{URDF} ", Thread, "start"), (f"{URDF}  ", arm.robot, "_meshes")
    for urdf, target, name in starts:
        with monkeypatch.context() as patch:
            patch.setattr(target, name, fails)
            arm.describe(urdf)
            arm.until(lambda: "can't start new thread" in arm.robot.fault, "the fault")
        assert arm.robot.fault.startswith("robot_description refused: internal error")
        arm.start_robot(urdf)  # the same description once more
        assert arm.robot.fault == ""
    assert arm.refused("arm/robot_description") == {"bad description": 2}


def test_what_is_in_the_way_of_links_is_gone_after_clear() -> None:
    with RobotRig() as rig:
        rig.send(cube(HAND)).answer()
        rig.describe()
        rig.until(lambda: "refused" in rig.robot.fault, "the refusal")
        assert rig.call(Trigger, "obb_collision/clear", Trigger.Request()).success
        rig.move()
        assert rig.robot.fault == ""


def test_a_mesh_that_takes_for_ever_gives_way_to_a_newer_description_and_to_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    mesh = f'<mesh filename="file://{tmp_path}/part.obj"/>'
    number = tmp_path / "number"
    code = f"import os, time; os.symlink(str(os.getpid()), {str(number)!r}); time.sleep(1e6)"
    slow = URDF.replace('<box size="0.1 0.1 0.1"/>', mesh)

    def read_for_ever(rig: RobotRig) -> int:
        with monkeypatch.context() as patch:
            patch.setattr(process, "CODE", code)
            rig.describe(slow)
            rig.until(number.is_symlink, "its process")
            assert "being read" in rig.robot.fault
        found = int(os.readlink(number))
        number.unlink()
        return found

    with RobotRig({"mesh_folders": [str(tmp_path)]}, own_builder=True) as rig:
        readers = [read_for_ever(rig)]
        rig.describe()
        rig.until(lambda: rig.robot.links is not None, "the robot")
        assert "refused" not in rig.robot.fault
        readers.append(read_for_ever(rig))
    for reader in readers:  # the second one gives way to the end of the node
        with pytest.raises(ProcessLookupError):
            os.kill(reader, 0)
