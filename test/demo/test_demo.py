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


"""The demo: its random scene, its run over real topics against brute force, its command line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from processes import limited, output_until

import obb_collision as oc
from obb_collision.demo.command import MIN_OBJECTS, main
from obb_collision.demo.scene import random_scene
from obb_collision.geometry.poses import as_poses

rclpy_context = pytest.importorskip("rclpy.context")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from rclpy.executors import ExternalShutdownException  # noqa: E402
from std_msgs.msg import Header  # noqa: E402 - needs ROS

from obb_collision.demo.listener import Listener  # noqa: E402
from obb_collision.demo.run import NAMESPACE, Demo  # noqa: E402
from obb_collision.demo.scene import DemoScene  # noqa: E402
from obb_collision.node import namespace_number  # noqa: E402
from obb_collision.node.messages.clouds import cloud_to_ros  # noqa: E402
from obb_collision.node.messages.conversions import namespaces_to_ros, stamp_to_ros  # noqa: E402
from obb_collision.node.messages.marker_shapes import shape_from_ros, shape_to_ros  # noqa: E402
from obb_collision.node.topics.topics import COLLISIONS  # noqa: E402

#: Domains of these tests, apart from those a robot or the other tests use.
DOMAIN = 60 + os.getpid() % 40
#: Most seconds a started demo may take; it compiles first.
PATIENCE = 120.0
OBJECTS = 50


def test_a_random_scene_follows_from_objects_and_seed() -> None:
    one, two, other = random_scene(80, 3), random_scene(80, 3), random_scene(80, 4)
    for time in (0.0, 1.25, 30.0):
        assert one.states(time)[0].tobytes() == two.states(time)[0].tobytes()
        assert not np.array_equal(one.states(time)[0], other.states(time)[0])
    assert len(set(one.names)) == 80


def test_a_random_scene_has_all_states() -> None:
    scene = random_scene(OBJECTS)
    moving = scene.moving()
    still = np.setdiff1d(np.arange(OBJECTS), moving)
    assert 0.2 * OBJECTS < len(moving) < 0.4 * OBJECTS
    assert np.array_equal(scene.states(3.3)[0][still], scene.states(0.0)[0][still])
    report = scene.build().check()
    depths = report.depths
    assert (depths < 1e-6).any()
    assert (depths > 0.01).any()
    assert len(report.names()) < OBJECTS  # most are free
    assert len(random_scene(MIN_OBJECTS).names) == MIN_OBJECTS


def brute_force(scene: DemoScene, time: float) -> set[tuple[str, ...]]:
    """All pairs of the scene as published, each judged for itself, names sorted in a pair."""
    positions, rotations = as_poses(scene.states(time)[0])
    shapes = [shape_from_ros(shape_to_ros(shape)) for shape in scene.shapes.values()]
    centers, axes, half_extents = (
        np.array(part) for part in zip(*(s.local_box for s in shapes), strict=True)
    )
    boxes = oc.Boxes(
        positions + np.einsum("nij,nj->ni", rotations, centers), rotations @ axes, half_extents
    )
    i, j = np.array(list(combinations(range(len(shapes)), 2))).T
    colliding = oc.verdicts(boxes[i], boxes[j]) != oc.Verdict.SEPARATE
    names = scene.names
    return {
        tuple(sorted((names[a], names[b]))) for a, b in zip(i[colliding], j[colliding], strict=True)
    }


def pairs_of(demo: Demo) -> set[tuple[str, ...]]:
    return {tuple(sorted((pair.a, pair.b))) for pair in demo.listener.pairs.rows}


@pytest.fixture
def lines() -> list[str]:
    return []


@pytest.fixture
def demo(lines: list[str]) -> Iterator[Demo]:
    context = rclpy_context.Context()
    context.init(domain_id=DOMAIN)
    running = Demo(context, DemoScene(random_scene(OBJECTS, 7)), 20.0, 2.0, lines.append)
    yield running
    running.close()
    context.try_shutdown()


def test_pairs_received_are_those_of_brute_force(demo: Demo) -> None:
    demo.begin()
    for time in np.arange(0.0, 12.0, 0.75):
        demo.settle(float(time))
        received = pairs_of(demo)
        assert received == brute_force(demo.scene, float(time)), f"at {time} s"


def test_a_short_run_tells_pairs_and_ends_with_summary_and_picture(
    demo: Demo, lines: list[str], tmp_path: Path
) -> None:
    demo.run()
    assert demo.time == 2.0
    received = pairs_of(demo)
    assert received == brute_force(demo.scene, 2.0)
    assert lines[0].startswith("topics to watch: /obb_collision_demo/objects ")
    begun = [line for line in lines if " begins " in line]
    ended = [line for line in lines if " ends " in line]
    assert len(begun) - len(ended) == len(received)
    assert any("touching" in line for line in begun)
    ends = demo.summary()
    assert ends[0].startswith(f"2.0 s, {OBJECTS} objects, {len(demo.scene.moving)} moving, ")
    assert "median" in ends[1]
    assert "pairs in all, at most " in ends[2]
    assert f"at the end {len(received)}: " in ends[2]
    pytest.importorskip("matplotlib")
    file = tmp_path / "scene.png"
    demo.save_picture(file)
    assert file.read_bytes().startswith(b"\x89PNG")
    assert 50_000 < file.stat().st_size < 600_000


def test_it_is_always_known_what_collides_while_it_runs(demo: Demo) -> None:
    answers: list[DiagnosticStatus] = []
    topic = f"{NAMESPACE}/collision_status"
    demo.begin()
    demo.settle(0.0)

    def take(message: DiagnosticArray) -> None:
        answers.append(message.status[0])

    demo.listener.create_subscription(DiagnosticArray, topic, take, 100)
    demo.run()
    assert len(answers) > 5
    assert {status.level for status in answers} <= {DiagnosticStatus.OK, DiagnosticStatus.ERROR}
    assert not {pair.value for s in answers for pair in s.values if pair.key == "reasons"} - {""}


def test_without_rclpy_it_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("obb_collision.node.runtime.environment.find_spec", lambda name: None)
    assert main([]) == 1
    assert capsys.readouterr().err.splitlines() == [
        "obb_collision_demo needs rclpy and common_interfaces: source a ROS 2 installation, "
        "or install 'obb_collision[ros]' by pip"
    ]


def test_ctrl_c_ends_it_with_its_summary() -> None:
    code = "from obb_collision.commands import demo_script as demo; raise SystemExit(demo())"
    demo = subprocess.Popen(
        [sys.executable, "-c", code, "--seconds", "3600", "--no-picture", "--objects", "20"],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(DOMAIN + 1)},
    )
    assert demo.stdout is not None
    limit = perf_counter() + PATIENCE
    received: list[str] = []
    for line in demo.stdout:
        received.append(line)
        if " begins " in line:
            break
        assert perf_counter() < limit
    demo.send_signal(signal.SIGINT)
    rest, _ = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 0
    assert received[0].startswith("scene random: 20 objects")
    assert received[1].startswith("topics to watch: ")
    assert " pairs in all, " in rest


def test_ctrl_c_ends_it_while_kernels_compile(tmp_path: Path) -> None:
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    code = "from obb_collision.commands import demo_script as demo; raise SystemExit(demo())"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "--no-picture"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(DOMAIN + 1)} | cache,
    )
    with limited(process):
        output_until(process, "steps done")
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert rest.splitlines()[-1] == "obb_collision_demo: interrupted"


def test_it_ends_while_it_waits_for_effects() -> None:
    context = rclpy_context.Context()
    context.init(domain_id=DOMAIN)
    asked: list[bool] = []
    scene = DemoScene(random_scene(OBJECTS, 7))
    running = Demo(context, scene, 20.0, 1.0, lambda line: None, stopped=lambda: bool(asked))
    asked.append(True)
    try:
        with pytest.raises(ExternalShutdownException):
            running.begin()
    finally:
        running.close()
        context.try_shutdown()


def test_the_listener_waits_for_namespaces_that_it_does_not_know_yet() -> None:
    context = rclpy_context.Context()
    context.init(domain_id=DOMAIN)
    lines: list[str] = []
    listener = Listener(lines.append, context=context)
    try:
        rows = np.zeros(1, COLLISIONS.dtype)
        rows["ns_a"] = rows["ns_b"] = namespace_number("late")
        rows["id_b"], rows["depth"] = 1, 0.5
        message = cloud_to_ros(rows, Header(stamp=stamp_to_ros(5)))
        take = {one.topic_name.split("/")[-1]: one.callback for one in listener.subscriptions}
        take["namespaces"](namespaces_to_ros(["early"]))
        take["collisions"](message)
        assert (listener.cycles, listener.pairs.rows, lines) == (0, [], [])
        take["namespaces"](namespaces_to_ros(["early", "late"]))
        take["collisions"](message)
        assert listener.cycles == 1
        assert [row[:3] for row in listener.pairs.rows] == [("late/0", "late/1", 0.5)]
        assert len(lines) == 1
    finally:
        listener.destroy_node()
        context.try_shutdown()
