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

"""A description is read once, and holds up nothing where another replaces it meanwhile."""

from __future__ import annotations

import math
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from each import each

pytest.importorskip("rclpy")
pytest.importorskip("lxml")
from rig import cube
from robot_rig import URDF, RobotRig
from std_srvs.srv import Trigger

import obb_collision as oc
from obb_collision.node.robots.robot_input import DescriptionReader, RobotReading
from obb_collision.scene.building import process

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
