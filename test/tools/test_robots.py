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

"""``python -m tools.robots``: what it measures and writes; peers where they are there."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import obb_collision as oc
from obb_collision.scene_files import find_scene
from tools import robots
from tools.peers.robots import PEERS, Case

CONFIG = find_scene("tabletop").parent
SMALL = ["--boxes", "5", "--states", "50", "--compared", "100", "--motions", "5"]
ARM = ["--robot", str(CONFIG / "arm.urdf"), "--srdf", str(CONFIG / "arm.srdf")]


def test_it_writes_what_it_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "robots.json"
    page = tmp_path / "page.md"
    options = ["--packages", str(CONFIG), "--json", str(file), "--markdown", str(page)]
    oc.set_threads(3)
    try:
        assert robots.main([*SMALL, *ARM, *options]) == 0
        assert oc.threads() == 3
    finally:
        oc.set_threads(None)
    printed = capsys.readouterr().out
    assert "| us per state | 5 boxes | missed | false alarms |\n" in printed
    report = json.loads(file.read_text())
    rows = {row["checker"]: row for row in report["states"]}
    assert rows["this library"]["states_per_second"] > 0
    assert 0 <= rows["this library"]["colliding"] <= 1
    assert report["motions"][0]["missed"] == 0
    kinematics = {row["checker"]: row["states_per_second"] for row in report["kinematics"]}
    assert kinematics["this library"] > 0
    assert ("pinocchio" in kinematics) == (find_spec("pinocchio") is not None)
    assert all(line in page.read_text() for line in printed.splitlines())


def test_what_cannot_be_read_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        robots.main([*SMALL, "--robot", "no_such.urdf"])
    assert "no_such.urdf" in capsys.readouterr().err


@pytest.mark.parametrize("name", PEERS)
def test_peers_agree_where_they_are_there(name: str) -> None:
    pytest.importorskip({"pin": "pinocchio"}.get(PEERS[name][1], PEERS[name][1]))
    robot = oc.Robot.from_urdf(CONFIG / "arm.urdf", CONFIG / "arm.srdf", [CONFIG])
    rng = np.random.default_rng(3)
    objects = robots.random_boxes(8, rng)
    scene = oc.Scene()
    for one in objects:
        scene.add(one.name, one.shape, one.pose)
    checker = oc.RobotScene([robot], scene)
    case: Case = robots.case_of(robot, str(CONFIG / "arm.urdf"), objects, checker)
    states = robots.random_states(robot, 300, rng)
    ours, theirs = checker.check(states).colliding, PEERS[name][0](case)(states)
    assert not (theirs & ~ours).any()
    assert (ours != theirs).mean() < 0.02  # cylinders are prisms of many sides here
    assert 0.02 < ours.mean() < 0.98


@pytest.mark.slow  # test_state_service.py shows that a node answers, this that it is measured
def test_a_node_answers_chunks_of_states(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy")
    file = tmp_path / "latency.json"
    options = ["--packages", str(CONFIG), "--latency", "10", "--json", str(file)]
    assert robots.main([*ARM, *options]) == 0
    row = json.loads(file.read_text())["latency"][0]
    assert (row["world"], row["states"], row["chunks"]) == ("30 boxes", 50, 10)
    assert 0.0 < row["median"] <= row["p99"] <= row["longest"]
    assert 0.0 < row["valid"] < 1.0
    assert "| 30 boxes | 50 | 10 |" in capsys.readouterr().out
