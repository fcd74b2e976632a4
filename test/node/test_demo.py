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

"""The demo: its scene, its run over real topics against brute force, its picture, its words."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pytest

import obb_collision as oc
from obb_collision.geometry.poses import as_poses
from obb_collision.node.demo import picture
from obb_collision.node.demo.bodies import bodies_of, triangles_of
from obb_collision.node.demo.command import main, make_parser
from obb_collision.node.demo.layout import DEFAULT_OBJECTS, MIN_OBJECTS
from obb_collision.node.demo.scene import DemoScene

rclpy_context = pytest.importorskip("rclpy.context")

from std_msgs.msg import Header  # noqa: E402 - needs ROS

from obb_collision.node import namespace_number  # noqa: E402
from obb_collision.node.clouds import cloud_to_ros  # noqa: E402
from obb_collision.node.conversions import namespaces_to_ros, stamp_to_ros  # noqa: E402
from obb_collision.node.demo.listener import CollisionListener  # noqa: E402
from obb_collision.node.demo.run import Demo  # noqa: E402
from obb_collision.node.layouts import COLLISION_DTYPE  # noqa: E402
from obb_collision.node.marker_shapes import shape_from_ros, shape_to_ros  # noqa: E402

#: Domains of these tests, apart from those a robot or the other tests use.
DOMAIN = 60 + os.getpid() % 40
#: Most seconds a started demo may take; it compiles first.
PATIENCE = 120.0


def test_the_scene_follows_from_objects_seed_and_time() -> None:
    one, two, other = DemoScene(80, seed=3), DemoScene(80, seed=3), DemoScene(80, seed=4)
    one.poses(7.0)  # asking in another order changes nothing
    for time in (0.0, 1.25, 30.0):
        assert one.poses(time).tobytes() == two.poses(time).tobytes()
        assert not np.array_equal(one.poses(time), other.poses(time))
    assert one.names == other.names


def test_fewer_objects_are_the_first_of_more() -> None:
    few, many = DemoScene(30, seed=1), DemoScene(200, seed=1)
    assert few.names == many.names[:30]
    assert np.array_equal(few.poses(2.0), many.poses(2.0)[:30])
    assert len(set(many.names)) == 200


@pytest.mark.parametrize("objects", [MIN_OBJECTS, DEFAULT_OBJECTS])
def test_all_shapes_are_there_and_some_move(objects: int) -> None:
    scene = DemoScene(objects)
    kinds = {type(item.shape) for item in scene.items}
    assert kinds == {oc.Box, oc.Sphere, oc.Cylinder, oc.Ellipsoid, oc.Mesh}
    moving = [bool(item.channel) for item in scene.items]
    assert any(moving)
    same = (scene.poses(0.0) == scene.poses(3.3)).all(axis=1)
    assert same[~np.array(moving)].all()


def test_the_whole_scene_uses_every_channel() -> None:
    scene = DemoScene()
    for channel in ("objects", "object_states", "object_transform", "object_poses"):
        assert scene.channel(channel)


def test_bodies_are_inside_their_boxes() -> None:
    for item in DemoScene().items:
        vertices, faces = triangles_of(item.shape)
        center, rotation, half_extents = item.shape.local_box
        local = (vertices[np.unique(faces)] - center) @ rotation
        assert (np.abs(local) <= half_extents + 1e-12).all(), item.name


def test_too_few_objects_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 12"):
        DemoScene(MIN_OBJECTS - 1)


def brute_force(scene: Any, time: float) -> set[tuple[str, str]]:
    """All pairs of the scene as published, each judged for itself, names sorted in a pair."""
    positions, rotations = as_poses(scene.poses(time))
    shapes = [shape_from_ros(shape_to_ros(shape)) for shape in scene.shapes(time)]
    centers, axes, half_extents = (
        np.array(part) for part in zip(*(s.local_box for s in shapes), strict=True)
    )
    boxes = oc.Boxes(
        positions + np.einsum("nij,nj->ni", rotations, centers), rotations @ axes, half_extents
    )
    i, j = np.array(list(combinations(range(len(shapes)), 2))).T
    colliding = oc.verdicts(boxes.take(i), boxes.take(j)) != oc.Verdict.SEPARATE
    names = scene.names
    return {
        tuple(sorted((names[a], names[b]))) for a, b in zip(i[colliding], j[colliding], strict=True)
    }


@pytest.fixture
def lines() -> list[str]:
    return []


@pytest.fixture
def demo(lines: list[str]) -> Iterator[Demo]:
    context = rclpy_context.Context()
    context.init(domain_id=DOMAIN)
    running = Demo(context, DemoScene(DEFAULT_OBJECTS, 7), 20.0, 2.0, lines.append)
    yield running
    running.close()
    context.try_shutdown()


def test_pairs_heard_are_those_of_brute_force(demo: Demo) -> None:
    demo.begin()
    for time in np.arange(0.0, 12.0, 0.75):
        demo.settle(float(time))
        heard = {tuple(sorted(pair)) for pair in demo.listener.pairs}
        assert heard == brute_force(demo.scene, float(time)), f"at {time} s"


def test_a_short_run_tells_pairs_and_ends_with_summary_and_picture(
    demo: Demo, lines: list[str], tmp_path: Path
) -> None:
    demo.run()
    assert demo.time == 2.0
    heard = {tuple(sorted(pair)) for pair in demo.listener.pairs}
    assert heard == brute_force(demo.scene, 2.0)
    assert lines[0].startswith("topics to watch: /obb_collision_demo/objects ")
    begun = [line for line in lines if " begins " in line]
    ended = [line for line in lines if " ends " in line]
    assert len(begun) - len(ended) == len(heard)
    assert any("agv/0" in line and "load/0" in line and "touching" in line for line in begun)
    ends = demo.summary()
    assert ends[0].startswith(f"2.0 s, {DEFAULT_OBJECTS} objects, 18 moving, ")
    assert "median" in ends[1]
    assert f"{len(demo.listener.seen)} pairs seen" in ends[2]
    pytest.importorskip("matplotlib")
    file = tmp_path / "scene.png"
    demo.save_picture(file)
    assert file.read_bytes().startswith(b"\x89PNG")
    assert 50_000 < file.stat().st_size < 600_000


def test_the_picture_shows_states_by_colour() -> None:
    scene = DemoScene()
    bodies = bodies_of(scene, 0.0)
    checked = oc.Scene()
    for item, pose in zip(scene.items, scene.poses(0.0), strict=True):
        checked.add(item.name, item.shape, pose)
    red = []
    for state in (picture.FREE, picture.COLLIDING):
        states = np.full(len(bodies), state)
        marks = picture.Marks(contacts=np.array([[0.0, 0.0, 1.0]]))
        image = picture.render(bodies, checked.boxes, states, marks)
        assert image.shape == (900, 1600, 3)
        pixels = image.reshape(-1, 3).astype(int)
        red.append(int((pixels[:, 0] > pixels[:, 1] + 60).sum()))
    assert red[1] > 50_000 > 5_000 > red[0]


def test_labels_do_not_cover_each_other() -> None:
    pytest.importorskip("matplotlib")
    from obb_collision.node.demo.caption import LABEL_HEIGHT, spread

    placed = spread([(100.0, 50.0, "a"), (120.0, 52.0, "b"), (90.0, 50.0, "c"), (900.0, 51.0, "d")])
    assert {text: (x, y) for x, y, text in placed}["d"] == (900.0, 51.0)
    heights = sorted(y for x, y, _ in placed if x < 500.0)
    assert (np.diff(heights) >= LABEL_HEIGHT).all()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--seconds", "0"], "must be between 0.1 and"),
        (["--seconds", "nan"], "must be between 0.1 and"),
        (["--objects", "many"], "'many' is not a whole number"),
        (["--objects", "3"], "must be between 12 and"),
        (["--seed", "-1"], "must be between 0 and"),
        (["--rate", "1e9"], "must be between 1 and 200"),
    ],
)
def test_bad_options_are_refused_with_a_reason(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        make_parser().parse_args(arguments)
    assert stop.value.code == 2
    assert reason in capsys.readouterr().err


def test_without_rclpy_it_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("obb_collision.node.environment.find_spec", lambda name: None)
    assert main([]) == 1
    assert capsys.readouterr().err.splitlines() == [
        "obb_collision_demo needs rclpy and common_interfaces: source a ROS 2 installation, "
        "or install 'obb_collision[ros]' by pip"
    ]


def test_ctrl_c_ends_it_with_its_summary() -> None:
    code = "from obb_collision.node.demo import main; raise SystemExit(main())"
    demo = subprocess.Popen(
        [sys.executable, "-c", code, "--seconds", "3600", "--no-picture", "--objects", "20"],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(DOMAIN + 1)},
    )
    assert demo.stdout is not None
    limit = perf_counter() + PATIENCE
    heard: list[str] = []
    for line in demo.stdout:
        heard.append(line)
        if " begins " in line:
            break
        assert perf_counter() < limit
    demo.send_signal(signal.SIGINT)
    rest, _ = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 0
    assert heard[0].startswith("topics to watch: ")
    assert " pairs seen, " in rest


def test_the_listener_waits_for_namespaces_that_it_does_not_know_yet() -> None:
    context = rclpy_context.Context()
    context.init(domain_id=DOMAIN)
    lines: list[str] = []
    listener = CollisionListener(lines.append, context=context)
    try:
        rows = np.zeros(1, COLLISION_DTYPE)
        rows["ns_a"] = rows["ns_b"] = namespace_number("late")
        rows["id_b"], rows["depth"] = 1, 0.5
        message = cloud_to_ros(rows, Header(stamp=stamp_to_ros(5)))
        listener._take_names(namespaces_to_ros(["early"]))
        listener._take(message)
        assert (listener.cycles, listener.pairs, lines) == (0, {}, [])
        listener._take_names(namespaces_to_ros(["early", "late"]))
        listener._take(message)
        assert (listener.cycles, listener.pairs) == (1, {("late/0", "late/1"): 0.5})
        assert len(lines) == 1
    finally:
        listener.destroy_node()
        context.try_shutdown()
