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

"""The demo with scene files, by independent checks, and ``obb_collision status`` beside a node."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from each import each
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rig import DOMAIN, NAMESPACE, Rig, cube, own_context, sync

import obb_collision as oc
from obb_collision import commands
from obb_collision.demo import command, with_ros
from obb_collision.demo import status as module
from obb_collision.demo.command import main, make_parser
from obb_collision.demo.listener import (
    ClearancesNarrator,
    Listener,
    PointsInsideNarrator,
    Predictions,
)
from obb_collision.demo.motion import read_motions
from obb_collision.demo.run import Demo
from obb_collision.demo.scene import DemoScene
from obb_collision.demo.snapshot import OVERLAPPING, ROBOT
from obb_collision.node import NamedClearance, NamedPoints, NamedPrediction
from obb_collision.node.runtime import environment
from obb_collision.scene_files import READY, find_scene, load_scene

APART = 100 + os.getpid() % 40
MOVEIT = Path(__file__).parents[1] / "data" / "moveit"


def scene_of(file: Path) -> DemoScene:
    return DemoScene(read_motions(load_scene(file), file), file)


@each("name", READY)
def test_ready_scenes_keep_their_names(name: str) -> None:
    scene = scene_of(find_scene(name))
    assert scene.names == scene.description.names
    assert len(scene.zones) == {"lidar_zone": 3, "camera": 1}.get(name, 0)


def test_what_begins_and_ends_is_printed_once() -> None:
    origin = (0.0, 0.0, 0.0)

    def row(time: float) -> NamedPrediction:
        return NamedPrediction("a/0", "b/0", time, origin, origin)

    narrator = Predictions()
    lines = [list(narrator.update([row(1.5 - t)], t)) for t in (0.0, 0.1, 0.2)]
    assert [len(found) for found in lines] == [1, 0, 0]
    assert lines[0][0].startswith("predicted a/0")
    assert len(list(narrator.update([row(1.0)], 2.0))) == 1  # anew, after it was gone
    assert "passed" in next(narrator.update([row(-0.02)], 2.1))
    unknown = NamedPrediction("a/0", "b/0", 0.5, (np.nan,) * 3, (np.nan,) * 3)
    assert "may collide from 0.50 s on" in next(narrator.update([unknown], 2.2))
    assert narrator.rows == []
    assert "2 collisions predicted, 1 between two states" in next(narrator.summary())

    inside = PointsInsideNarrator()
    entered = list(inside.update([NamedPoints("zone/0", 7, 0, 0, 0.1)], 0.0))
    left = list(inside.update([], 1.0))
    assert (entered, left) == (["entered zone/0  7 points inside"], ["left    zone/0"])

    near = ClearancesNarrator()
    rows = [NamedClearance("a/0", "b/0", gap, origin, origin) for gap in (0.25, -0.5)]
    assert list(near.update(rows, 3.0)) == []
    assert "minimum 250.0 mm, a/0 – b/0, at 3.0 s" in next(near.summary())  # noqa: RUF001


ALL = """\
name: all
groups: {zones: ["zone/*"]}
allowed: [[zones, "*"], [box/0, box/1]]
effects:
  contacts: {objects: "box/*", max_points: 8}
  clearance: {objects: "box/*", max_distance: 1.5}
  sweep: {objects: "fast/*", horizon: 1.0}
  points: {objects: zones}
objects:
  - {name: box/0, shape: box, size: [1, 1, 1], position: [0, 0, 0.5]}
  - {name: box/1, shape: box, size: [1, 1, 1], position: [0.5, 0, 0.5]}
  - {name: box/2, shape: box, size: [1, 1, 1], position: [-0.75, 0, 0.5]}
  - {name: box/3, shape: box, size: [1, 1, 1], position: [0, 2, 0.5]}
  - {name: zone/0, shape: box, size: [3, 3, 3], position: [0, 0, 1.75], color: [1, 0, 0, 0.2]}
  - {name: wall/0, shape: box, size: [0.01, 2, 2], position: [5, -3, 1]}
  - {name: fast/0, shape: capsule, radius: 0.125, length: 0.25, position: [3, -3, 1]}
"""
MOTION = """\
objects: {fast/0: {period: 2.0, waypoints: [[1.0, 8, -3, 1]]}}
sensors:
  eye: {type: camera, width: 50, height: 40, angle: 1, range: 10, rate: 10, position: [0, -4, 2],
        target: [0, 0, 1]}
"""
PARAMETERS = "/**: {ros__parameters: {sources: [eye], eye: {use: watch}}}"

Start = Callable[[Path], Demo]
LINES: list[str] = []
"""What demos say."""


@pytest.fixture
def start() -> Iterator[Start]:
    """Yield a function that starts the demo with a scene file, in place of the one before."""
    started: list[Demo] = []

    def end() -> None:
        while started:
            started.pop().close()

    with own_context(APART) as context:

        def start(path: Path) -> Demo:
            end()
            started.append(Demo(context, scene_of(path), 20.0, 1.5, LINES.append))
            return started[0]

        yield start
        end()


def test_a_file_gets_the_effects_it_calls_for(start: Start, tmp_path: Path) -> None:
    LINES.clear()
    path = tmp_path / "all.yaml"
    path.write_text(ALL)
    (tmp_path / "all.motion.yaml").write_text(MOTION)
    (tmp_path / "all.params.yaml").write_text(PARAMETERS)
    demo = start(path)
    demo.run()
    # box/0 and box/1 may touch
    assert {row[:2] for row in demo.listener.pairs.rows} == {("box/0", "box/2")}
    text = "\n".join(LINES)
    assert "predicted fast/0" in text or "predicted wall/0" in text
    assert "entered zone/0" in text
    ends = "\n".join(demo.summary())
    for part in ("4 points at the end", "clearance: minimum", "sweep: ", "points in zone/0: "):
        assert part in ends
    pytest.importorskip("matplotlib")
    file = tmp_path / "all.png"
    demo.save_picture(file)
    assert file.read_bytes().startswith(b"\x89PNG")


@each("name", ["shelf", "message"])
def test_moveit_scenes_run(start: Start, name: str) -> None:
    demo = start(MOVEIT / f"{name}.yaml")
    demo.begin()
    demo.settle(0.0)
    scene, said = demo.scene, demo.scene.description
    expected = {frozenset(pair) for pair in said.build().check().names()}
    of = dict(zip(scene.names, said.names, strict=True))
    assert {frozenset((of[row.a], of[row.b])) for row in demo.listener.pairs.rows} == expected
    assert len(set(scene.names)) == len(scene.names)


@each("scene, reason", [
    ("objects: [{name: a, shape: box, size: [1, -1, 1]}]", "scene.yaml:1: objects[0].size: "),
    ("objects: []", "it has no objects"),
    ("kitchen", "tabletop, warehouse, lidar_zone, arm_cell, camera"),
])  # fmt: skip
def test_scenes_of_the_package_are_found_by_name_and_bad_files_refused_with_line_and_key(
    scene: str, reason: str, write: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert make_parser().parse_args(["--scene", "tabletop"]).scene[1].stem == "tabletop"
    assert all(name in make_parser().format_help() for name in READY)
    with pytest.raises(SystemExit, match="2"):
        main(["--scene", str(write(scene)) if ":" in scene else scene])
    assert reason in capsys.readouterr().err


@pytest.fixture(scope="module")
def demo() -> Iterator[Demo]:
    """Yield the demo of the cell, started."""
    file = find_scene("arm_cell")
    with own_context(APART) as context:
        demo = Demo(context, scene_of(file), 30.0, 1.0, lambda _: None)
        try:
            demo.begin()
            yield demo
        finally:
            demo.close()


def test_links_collide_by_name_when_the_robot_scene_says_so(demo: Demo) -> None:
    (arm,) = demo.scene.robots
    checker = oc.RobotScene({"arm": arm.robot}, demo.scene.description.build(), bases=[arm.pose])
    seen = set()
    for time in (0.5, 5.0, 9.6, 10.0, 12.0):
        demo.settle(time)
        rows = demo.listener.pairs.rows
        found = {frozenset((_link(row.a), _link(row.b))) for row in rows}
        report = checker.check(demo.scene.motions.joints(arm, time)[0], all_pairs=True)
        wanted = set() if report.valid[0] else {frozenset(pair) for pair in report.pairs_of(0)}
        assert found == wanted
        seen |= found
    assert seen >= {frozenset((name, "shelf/3")) for name in ("arm/hand", "arm/right_finger")}


def _link(name: str) -> str:
    """Return the link of an object of the arm, and any other name as it is."""
    return name.rpartition("/")[0] if name.startswith("arm/") else name


def test_colliding_links_are_red_and_near_ones_have_lines(demo: Demo) -> None:
    demo.settle(10.0)
    snapshot = demo.snapshot()
    states = dict(zip(snapshot.names, snapshot.states.tolist(), strict=True))
    red = {name for name, state in states.items() if state == OVERLAPPING}
    assert red == {"arm/hand/1", "arm/right_finger/0", "shelf/3"}
    assert states["arm/forearm/1"] == ROBOT
    rows: list[NamedClearance] = list(demo.listener.effects["clearance"].rows)
    assert len(snapshot.near) == len(rows) > 0
    near = {row.b if row.b.startswith("arm/") else row.a for row in rows}
    assert near <= {"arm/hand/0", "arm/hand/1", "arm/left_finger/0", "arm/right_finger/0"}


def test_bodies_of_links_are_drawn_where_the_robot_has_them(demo: Demo) -> None:
    demo.settle(5.0)
    (arm,) = demo.scene.robots
    bodies = {body.name: body for body in demo.snapshot().bodies()}
    poses = arm.robot.link_poses(demo.scene.motions.joints(arm, 5.0)[0])
    row = arm.robot.link_names.index("right_finger")
    wanted = poses[row, :3] + np.array(arm.pose[:3])  # the base is not turned
    np.testing.assert_allclose(bodies["arm/right_finger/0"].position, wanted, atol=1e-6)


NODE = f"{NAMESPACE}/obb_collision"


@pytest.fixture(autouse=True)
def _same_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))


@contextmanager
def spinning(rig: Rig) -> Iterator[None]:
    """Spin a rig in a thread: what spins is not destroyed meanwhile."""
    done = Event()

    def run() -> None:
        while not done.is_set():
            rig.executor.spin_once(timeout_sec=0.05)

    thread = Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def test_levels_are_exit_codes_with_reasons(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    with spinning(rig):
        assert commands.status(["--node", NODE[1:], "--timeout", "60"]) == 3
    assert capsys.readouterr().out.startswith(f"{NODE}: STALE, no_objects\n")
    sync(rig)
    with spinning(rig):
        code = commands.status(["--json", "--timeout", "60"])
    nodes = json.loads(capsys.readouterr().out)
    found = nodes[NODE]  # without its name
    assert code == 0 or len(nodes) > 1  # others may test on this machine
    assert (found["level"], found["values"]["reason"]) == ("OK", "")
    assert found["parts"]["objects"]["count"] == "1"
    assert "cycle mean (ms)" in found["parts"]["cycle"]
    rig.send(cube(("box", 1)), cube(("box", 2), (0.5, 0.0, 0.0)))
    assert sync(rig)
    with spinning(rig):
        assert commands.status(["--node", NODE, "--timeout", "60"]) == 1
    text = capsys.readouterr().out
    assert text.startswith(f"{NODE}: ERROR\n  1 pair collides")
    for word in ("objects 3", "  objects: 3 objects; count 3; colliding 2", "  cycle: ", "input "):
        assert word in text


def test_a_node_whose_name_comes_later_is_listed_once(
    rig: Rig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = Node.get_publishers_info_by_topic, count()

    def without_names(*args: Any) -> Any:
        ends = real(*args)
        for end in ends if next(calls) < 3 else ():
            end.node_name, end.node_namespace = "_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_"
        return ends

    monkeypatch.setattr(Node, "get_publishers_info_by_topic", without_names)
    with spinning(rig):
        assert commands.status(["--json", "--timeout", "60"])
    nodes = json.loads(capsys.readouterr().out)
    assert NODE in nodes
    assert not [name for name in nodes if "UNKNOWN" in name]


def test_the_view_names_the_nodes_that_it_could_show(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser")
    lines, listeners, calls = list[str](), list[Listener](), count()

    class EndedByItsLine(with_ros.Interrupts):
        asked = property(lambda self: "nothing received" in lines[-1], lambda self, value: None)

    class Noted(Listener):
        """One that this test can see."""

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            listeners.append(self)

    def time() -> float:  # its patience ends when it has discovered the node
        later = next(calls) > 0  # the first call begins its patience
        return 1e9 if later and NODE in module.publishers_of_status(listeners[0]) else 0.0

    monkeypatch.setattr(with_ros, "Interrupts", EndedByItsLine)
    monkeypatch.setattr("obb_collision.demo.listener.Listener", Noted)
    monkeypatch.setattr(command, "monotonic", time)
    monkeypatch.setattr(command, "say", lambda line, *_: lines.append(line))
    with spinning(rig):
        assert commands.view(["/nobody", "--port", "0"]) == 0
    assert lines[-1].startswith("nothing received on /nobody/markers yet; running nodes: /")
    assert NODE in lines[-1]


def test_nobody_heard_is_four(capsys: pytest.CaptureFixture[str]) -> None:
    assert commands.status(["--node", "/nobody", "--timeout", "0.2"]) == 4
    assert "/nobody was not heard within 0.2 s" in capsys.readouterr().err


def test_a_ros_that_is_not_sourced_is_used_and_without_one_it_is_said_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "INSTALLED", tmp_path)
    for target in (module, environment):
        monkeypatch.setattr(target, "find_spec", lambda name: None)
    assert commands.status([]) == 4
    assert "needs rclpy and common_interfaces: source a ROS 2" in capfd.readouterr().err
    setup = tmp_path / "jazzy" / "setup.bash"
    setup.parent.mkdir()
    setup.write_text("echo sourced")
    assert commands.status(["--node", "/nobody", "--timeout", "0.2"]) == 4
    output, errors = capfd.readouterr()
    assert output == "sourced\n"
    assert f"{setup.parent}, which is not sourced" in errors
    assert "/nobody was not heard within 0.2 s" in errors


@each("count", [0, 2])
def test_strangers_are_unreadable(rig: Rig, capsys: pytest.CaptureFixture[str], count: int) -> None:
    stranger = Node("stranger", context=rig.context)
    try:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = stranger.create_publisher(DiagnosticArray, "/alien/collision_status", latched)
        publisher.publish(DiagnosticArray(status=[DiagnosticStatus(level=b"\0")] * count))
        assert commands.status(["--node", "/stranger", "--timeout", "60"]) == 3
    finally:
        stranger.destroy_node()
    assert capsys.readouterr().out.startswith("/stranger: STALE, unreadable\n")
