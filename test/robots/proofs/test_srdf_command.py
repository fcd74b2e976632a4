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

"""The command that proves pairs of links: what it writes, and what it cannot read."""

from __future__ import annotations

from pathlib import Path

import pytest

import obb_collision as oc
from obb_collision.robots.srdf_command import main

CONFIG = Path(__file__).parents[3] / "config"


def test_it_writes_the_srdf_and_the_report(tmp_path: Path) -> None:
    out, report = tmp_path / "arm.srdf", tmp_path / "report.txt"
    urdf, given = CONFIG / "arm.urdf", CONFIG / "arm.srdf"
    assert main([str(urdf), "-o", str(out), "--srdf", str(given), "--report", str(report)]) == 0
    robot, before = (oc.Robot.from_urdf(urdf, srdf) for srdf in (out, given))
    assert robot.disabled_pairs == before.disabled_pairs
    assert robot.groups == before.groups
    lines = report.read_text().splitlines()
    assert "base - upper_arm: never" in lines[1]
    assert "base - forearm: can collide, as at turn" in lines[2]
    assert lines[-1] == "36 pairs: 8 adjacent, 16 never, 12 can collide"


def test_it_prints_the_srdf_by_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(CONFIG / "arm.urdf")]) == 0
    printed, told = capsys.readouterr()
    robot = oc.Robot.from_urdf(CONFIG / "arm.urdf", printed)
    assert len(robot.disabled_pairs) == 24
    assert told.endswith("36 pairs: 8 adjacent, 16 never, 12 can collide\n")


def test_what_cannot_be_read_is_said_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.urdf"
    bad.write_text('<robot name="r">\n<link/></robot>')
    for arguments, reason in (
        ([str(bad)], "bad.urdf:2: link of robot 'r': its name is missing"),
        ([str(tmp_path / "none")], "no such file"),
        ([str(CONFIG / "arm.urdf"), "--srdf", str(tmp_path)], "no regular file"),
    ):
        assert main(arguments) == 1
        printed, told = capsys.readouterr()
        assert printed == ""
        assert told.startswith("obb_collision srdf: ")
        assert reason in told
        assert told.count("\n") == 1
