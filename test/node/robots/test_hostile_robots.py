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

"""Hostile messages and descriptions of a robot: refused, and nothing else disturbed or held up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from each import each

pytest.importorskip("rclpy")
pytest.importorskip("lxml")
pytest.importorskip("trajectory_msgs")
from fake_frames import FakeFrames
from rig import cube, pose
from robot_rig import URDF, RobotRig, ValidityRig
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger
from test_trajectories import QUARTER, TrajectoryRig
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import obb_collision as oc
from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.node.messages.conversions import duration_to_ros
from obb_collision.node.robots.robot_input import DescriptionReader, RobotReading
from obb_collision.node.robots.validity import NOT_KNOWN, ROWS, VALID
from obb_collision.robots.description.urdf import MOST_GEOMETRIES
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
    rig.send_joints(None, lift=0.25, turn=0.0)
    rig.answer()
    assert rig.robot.fault == ""
    np.testing.assert_allclose(rig.pose_of(("arm/hand", 0)), pose(0.5, 0.0, 0.75), atol=1e-12)
    assert rig.node.guard.total == 0, rig.node.guard.last


@each("speed", [5e-324, 1e-310, 1e-20, 1e300, 1e9, NAN, np.inf, -1e308])
def test_any_velocity_leaves_the_links_where_the_positions_say(
    speed: float, arm: ValidityRig
) -> None:
    send(arm, ("lift", "turn"), (0.25, 0.0), speed, 0.0)
    np.testing.assert_allclose(arm.pose_of(("arm/hand", 0)), pose(0.5, 0.0, 0.75), atol=1e-12)
    assert arm.robot.fault == ""
    assert_well(arm)


def test_slow_joints_have_twists_in_proportion(arm: ValidityRig) -> None:
    for speed in (1e-9, 1e-6, 1e-3, 1.0):
        send(arm, ("lift", "turn"), (0.0, 0.0), speed, 0.0)
        slot = arm.node.objects.table.slots["arm/hand", 0]
        twist = arm.node.objects.table.twist[slot]
        np.testing.assert_allclose(twist, [0, 0, speed, 0, 0, 0], atol=1e-9 * speed + 1e-15)


def test_joints_that_cannot_be_used_are_refused_with_the_reason(arm: ValidityRig) -> None:
    for names, positions, reason in (
        (("lift", "turn"), (NAN, 0.0), "bad position"),
        (("lift", "turn"), (0.0, -np.inf), "bad position"),
        (("lift", "turn", "lift"), (0.0, 0.0, 1.0), "repeated joint"),
        (("lift", "lift"), (NAN, 0.0), "repeated joint"),
        (("lift", "turn"), (0.0,), "array lengths differ"),
    ):
        before = arm.refused("arm/joint_states").get(reason, 0)
        send(arm, names, positions)
        assert arm.robot.fault.startswith("joints whose state was refused: lift"[:30])
        assert arm.refused("arm/joint_states")[reason] > before
        assert_well(arm)
    send(arm, ["x" * 1_000_000, "", "turn\n"], (0.0, 0.0, 0.0))
    send(arm, [f"j{k}" for k in range(20_000)], np.zeros(20_000).tolist())
    assert arm.robot.fault == ""
    assert_well(arm)


def test_what_fails_unforeseen_leaves_the_robot_unknown_and_the_next_joints_place_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with RobotRig() as rig:
        rig.start_robot()
        with monkeypatch.context() as patch:
            patch.setattr(rig.robot.links, "place", lambda *_: 1 // 0)
            send(rig, ("lift", "turn"), (1.0, 0.0))
            rig.cycles(2)
            assert "links not placed: internal error" in rig.robot.fault
            assert rig.node.guard.total == 1
        rig.send_joints(None, lift=0.0, turn=0.0)
        rig.answer()
        assert rig.robot.fault == ""


BEFORE, BETWEEN, AFTER = URDF.split("<limit")
LOOP = f'{BEFORE}<mimic joint="turn"/><limit{BETWEEN}<mimic joint="lift"/><limit{AFTER}'


@each(
    "text, reason",
    [
        (LOOP, "mimic"),
        (URDF.replace("0.1 0.1 0.1", "0.1 -1 0.1"), "negative"),
        (URDF.replace("0.1 0.1 0.1", "0.1 nan 0.1"), "nan"),
        (URDF.replace('<limit lower="-3" upper="3"/>', "", 1), "limit"),
        (URDF.replace('<box size="0.1 0.1 0.1"/>', '<mesh filename="package://no/a"/>'), "mesh"),
        (
            '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;">]>'
            + URDF.replace('name="arm"', 'name="&b;"'),
            "document type",
        ),
        (URDF.replace('name="arm"', f'name="{"x" * 1_000_000}"'), "name"),
        (
            URDF.replace(
                "</link>",
                "<collision><geometry><sphere radius='1'/></geometry>"
                "</collision>" * MOST_GEOMETRIES + "</link>",
                1,
            ),
            f"{MOST_GEOMETRIES} is the limit",
        ),
    ],
)
def test_descriptions_that_cannot_be_used_leave_the_robot_unknown(text: str, reason: str) -> None:
    with ValidityRig() as rig:
        rig.start_robot()
        rig.describe(text)
        rig.until(lambda: "refused" in rig.robot.fault, "the refusal")
        assert reason in rig.robot.fault
        assert len(rig.robot.fault) < 1000
        assert rig.ask([[0.0, 0.0]])["reason"].tolist() == [NOT_KNOWN]
        rig.describe()
        rig.until(lambda: "refused" not in rig.robot.fault, "the robot")
        rig.until(lambda: rig.robot.fault[:5] in ("", "joint"), "the robot")
        assert_well(rig)


@each("shape", ['box size="0 0 0"', 'sphere radius="0"', 'box size="1 0 1"'])
def test_shapes_of_no_volume_collide_or_are_refused(shape: str) -> None:
    with RobotRig() as rig:
        rig.describe(URDF.replace('box size="0.1 0.1 0.1"', shape))
        rig.until(lambda: rig.robot.fault[:5] == "joint" or "refused" in rig.robot.fault, "robot")
        if "refused" not in rig.robot.fault:
            rig.send(cube(("crate", 1), (0.5, 0.0, 0.75), (0.5, 0.5, 0.2)))
            assert_well(rig)
            found = {frozenset(pair) for pair in rig.pairs()}
            assert frozenset(("arm/hand/0", "crate/1")) in found
        assert rig.node.guard.total == 0


def _cloud(rig: RobotRig, **fields: str) -> PointCloud2:
    return cloud_to_ros(np.zeros(3, list(fields.items())), rig.header())


def test_states_that_cannot_be_read_are_never_valid() -> None:
    with ValidityRig() as rig:
        rig.start_robot(lift=0.25)
        twice = _cloud(rig, lift="<f8", turn="<f8")
        twice.fields.append(twice.fields[0])
        short = _cloud(rig, lift="<f8", turn="<f8")
        short.data = short.data[:-1]
        nothing = PointCloud2(header=rig.header(), width=9_000_000, height=1)
        for message, reason, answered in (
            (twice, "field layout", True),
            (_cloud(rig, lift="<f4", turn="<f8"), "field layout", True),
            (_cloud(rig, lift="<i4", turn="<f8"), "field layout", True),
            (_cloud(rig, lift="<f8"), "missing joint", True),
            (_cloud(rig, lift="<f8", turn="<f8", nose="<f8"), "unknown joint", True),
            (short, "field layout", False),
            (nothing, "field layout", False),
        ):
            before = rig.refused("arm/states_to_check").get(reason, 0)
            rig.answers.clear()
            rig.questions.publish(message)
            while rig.refused("arm/states_to_check").get(reason, 0) == before:
                rig.cycles(1)
            if answered:
                rig.until(lambda: rig.answers, "the answer")
                answer = cloud_from_ros(rig.answers[0], ROWS.names or ())
                assert answer["reason"].tolist() == [NOT_KNOWN] * 3
                assert not answer["valid"].any()
            rows = rig.ask([[0.25, 0.0], [NAN, 0.0], [9.0, 0.0]])
            assert rows["valid"].tolist() == [1, 0, 0]
            assert rows["reason"][0] == VALID
            assert_well(rig)


def test_trajectories_with_too_many_points_are_refused_before_they_are_read() -> None:
    with TrajectoryRig() as rig:
        for count, names in ((5001, ("lift", "turn")), (100_000, ())):
            message = JointTrajectory(joint_names=list(names))
            point = JointTrajectoryPoint(positions=[0.0] * len(names))
            message.points = [point] * count
            rig.said.clear()
            rig.wanted.publish(message)
            rig.until(lambda: rig.said, "what is said of it")
            text = f"refused: too many pieces: {count} points, 5000 is the limit"
            assert rig.said[0].message == text
        assert rig.forwarded == []
        assert rig.go(QUARTER)[0].message == "forwarded"
        assert rig.node.guard.total == 0


@each("times", [(0.0, 2.0, 1.0), (0.0, 0.0), (-1.0, 1.0), (1.0, 1.0)])
def test_trajectories_with_unordered_times_are_refused_while_another_one_runs(
    times: tuple[float, ...],
) -> None:
    with TrajectoryRig() as rig:
        assert rig.go(QUARTER)[0].message == "forwarded"
        message = JointTrajectory(joint_names=["lift", "turn"])
        message.points = [
            JointTrajectoryPoint(positions=[0.0, 0.0], time_from_start=duration_to_ros(time))
            for time in times
        ]
        rig.said.clear()
        rig.forwarded.clear()
        rig.wanted.publish(message)
        rig.until(lambda: rig.said, "what is said of it")
        assert "bad point" in rig.said[0].message
        rig.cycles(2)
        assert rig.forwarded == []
        assert rig.node.robots is not None
        assert rig.node.robots._trajectories["arm/trajectory_in"]._running is not None


@each("bad", [[NAN] * 7, [1e308] * 7, [0.0] * 7, [0, 0, np.inf, 0, 0, 0, 1]])
def test_a_base_that_jumps_to_no_pose_leaves_the_robot_unknown(bad: list[float]) -> None:
    frames = FakeFrames()
    frames.known["stand"] = pose(0.0)
    given: dict[str, Any] = {"robot_bases": ["arm: stand"]}
    with ValidityRig(given, frames=frames, transform_timeout=0.0) as rig:
        rig.start_robot()
        assert rig.ask([[0.0, 0.0]])["reason"].tolist() == [VALID]
        frames.known["stand"] = bad
        assert rig.ask([[0.0, 0.0]])["reason"].tolist() == [NOT_KNOWN]
        rig.cycles(2)
        frames.known["stand"] = pose(0.0)
        assert_well(rig)
        assert rig.ask([[0.0, 0.0]])["reason"].tolist() == [VALID]


ROCK = '<robot name="{}"><link name="rock"/></robot>'
#: More than any test takes: what is not abandoned ends by this.
LONG = 60.0


class SlowReading(RobotReading):
    """Reads for ever what is called slow, unless it is abandoned."""

    def __init__(self) -> None:
        self.begun, self.abandoned = Event(), Event()

    def read(self, urdf: str, srdf: str | None) -> oc.Robot:
        self.begun.set()
        if "slow" in urdf and not self.abandoned.wait(LONG):
            raise AssertionError("not abandoned")
        return oc.Robot.from_urdf(urdf, srdf)

    def abandon(self) -> None:
        self.abandoned.set()


def test_a_newer_description_ends_the_reading_of_one_before() -> None:
    readings = [SlowReading() for _ in range(2)]
    begun = iter(readings)
    reader = DescriptionReader(lambda: next(begun))
    reader.request(ROCK.format("slow"), None)
    assert readings[0].begun.wait(LONG)
    reader.request(ROCK.format("quick"), None)
    assert readings[1].begun.wait(LONG)
    thread = reader._thread
    if thread is not None:
        thread.join(LONG)
    found = reader.take()
    assert isinstance(found, oc.Robot)
    assert found.name == "quick"
    assert not readings[1].abandoned.is_set()
    assert not reader.is_reading


def test_a_reading_that_does_not_begin_is_said_and_a_later_description_is_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    with RobotRig() as rig:
        starts = (URDF, Thread, "start"), (f"{URDF} ", rig.robot._reader, "_begin")
        for urdf, target, name in starts:
            with monkeypatch.context() as patch:
                patch.setattr(target, name, fails)
                rig.describe(urdf)
                rig.until(lambda: "can't start new thread" in rig.robot.fault, "the fault")
            assert rig.robot.fault.startswith("robot_description refused: internal error")
            rig.start_robot(urdf)  # the same description once more
            assert rig.robot.fault == ""
        assert rig.refused("arm/robot_description") == {"bad description": 2}


@each("speed", [1e300, math.inf, math.nan])
def test_neither_absurd_speeds_nor_clear_read_the_description_again(
    speed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    with RobotRig() as rig:
        rig.start_robot()
        robot = rig.robot.links.robot
        place = rig.pose_of(("arm/hand", 0))
        monkeypatch.setattr(rig.robot._reader, "request", None)
        rig.send_joints({"lift": speed}, lift=0.0, turn=0.0)
        rig.answer()
        assert rig.robot.fault == ""
        assert rig.call(Trigger, "obb_collision/clear", Trigger.Request()).success
        rig.cycles(1)
        assert rig.robot.fault.startswith("joints without a state")
        rig.send_joints(lift=0.0, turn=0.0)
        rig.answer()
        assert rig.robot.fault == ""
        assert rig.robot.links.robot is robot
        np.testing.assert_array_equal(rig.pose_of(("arm/hand", 0)), place)
        assert rig.node.guard.total == 0, rig.node.guard.last


def test_what_is_in_the_way_of_links_is_gone_after_clear() -> None:
    with RobotRig() as rig:
        rig.send(cube(("arm/hand", 1), (0, 0, 0)))
        rig.answer()
        rig.describe()
        rig.until(lambda: "refused" in rig.robot.fault, "the refusal")
        assert rig.call(Trigger, "obb_collision/clear", Trigger.Request()).success
        rig.send_joints(lift=0.0, turn=0.0)
        rig.answer()
        assert rig.robot.fault == ""


def test_closing_ends_what_is_being_read() -> None:
    reading = SlowReading()
    reader = DescriptionReader(lambda: reading)
    reader.request(ROCK.format("slow"), None)
    thread = reader._thread
    assert thread is not None
    assert reading.begun.wait(LONG)
    reader.close()
    assert not thread.is_alive()


def test_a_mesh_that_takes_for_ever_gives_way_to_a_newer_description(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    mesh = f'<mesh filename="file://{tmp_path}/part.obj"/>'
    with RobotRig({"mesh_folders": [str(tmp_path)]}) as rig:
        with monkeypatch.context() as patch:
            patch.setattr(process, "CODE", "import time; time.sleep(1e6)")
            rig.describe(URDF.replace('<box size="0.1 0.1 0.1"/>', mesh))
            rig.until(lambda: "being read" in rig.robot.fault, "the reading")
            reading: Any = rig.until(lambda: rig.robot._reader._reading, "its begin")
            rig.until(lambda: reading._meshes._process.number is not None, "its process")
            worker = reading._meshes._process._process
        rig.describe()
        rig.until(lambda: rig.robot.links is not None, "the robot")
        assert "refused" not in rig.robot.fault
        assert worker.poll() is not None
