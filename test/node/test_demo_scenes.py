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

"""The demo with scene files: their objects, rules and effects over real topics, and the picture."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import obb_collision as oc
from obb_collision.node.demo import picture
from obb_collision.node.demo.bodies import bodies_of, triangles_of
from obb_collision.node.demo.camera import SIZE, WAREHOUSE, camera_of
from obb_collision.node.demo.command import main, make_parser
from obb_collision.scene.files import READY, find_scene, load_scene

rclpy_context = pytest.importorskip("rclpy.context")

from obb_collision.node import NamedClearance, NamedPoints, NamedPrediction  # noqa: E402
from obb_collision.node.demo.file_scene import FileScene  # noqa: E402
from obb_collision.node.demo.followers import Clearances, Insides, Predictions  # noqa: E402
from obb_collision.node.demo.run import Demo  # noqa: E402

#: Domain of these tests, apart from those a robot or the other tests use.
DOMAIN = 100 + os.getpid() % 40
MOVEIT = Path(__file__).parents[1] / "data" / "moveit"
POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3], [0.5, 0.5, 0.5]])


def ready(name: str) -> FileScene:
    file = find_scene(name)
    return FileScene(load_scene(file), file)


@pytest.mark.parametrize("name", READY)
def test_ready_scenes_keep_names_poses_and_twists(name: str) -> None:
    scene = ready(name)
    assert scene.names == scene.description.names
    poses, twists = scene.description.states(4.2)
    np.testing.assert_array_equal(scene.poses(4.2), poses)
    np.testing.assert_array_equal(scene.twists(4.2), twists)
    assert scene.channel("object_states") == scene.description.moving()
    assert [item.motion(4.2) for item in scene.items] == [tuple(pose) for pose in poses.tolist()]
    cloud = scene.points(4.2)
    assert (cloud is None) == (name != "lidar_zone")


@pytest.mark.parametrize(
    "shape",
    [
        oc.Cone(0.5, 2.0, (1, 2, 1)),
        oc.Capsule(0.25, 1.0),
        oc.Hull(POINTS, (1, 1, 2)),
        oc.Hull(POINTS[:3]),
        oc.Hull(POINTS[:1]),
    ],
    ids=["cone", "capsule", "hull", "flat hull", "point"],
)
def test_bodies_are_in_their_boxes(shape: oc.Shape) -> None:
    vertices, faces = triangles_of(shape)
    center, rotation, half_extents = shape.local_box
    local = (vertices[np.unique(faces)] - center) @ rotation
    assert (np.abs(local) <= half_extents + 1e-9).all()


@pytest.mark.parametrize("scale", [0.01, 1.0, 300.0])
def test_all_of_a_scene_is_in_the_picture(scale: float) -> None:
    random = np.random.default_rng(2)
    poses = np.tile([0.0, 0, 0, 0, 0, 0, 1], (30, 1))
    poses[:, :3] = random.uniform(-scale, scale, (30, 3))
    poses[:, 2] -= 5.0 * scale
    boxes = oc.Boxes.from_poses(poses, random.uniform(0.05, 0.2, (30, 3)) * scale)
    camera = camera_of(None, boxes)
    corners = np.concatenate([oc.OBB(*boxes.row(row)).corners() for row in range(30)])
    pixels = camera.pixels(corners)
    assert ((pixels > 0) & (pixels < SIZE)).all()
    assert np.ptp(pixels[:, 1]) > 0.3 * SIZE[1]
    assert camera.place(corners)[:, 2].min() > -1e-6  # the floor is below all of it


def test_a_view_is_the_one_of_the_file() -> None:
    scene = ready("tabletop")
    view = scene.description.view
    assert view is not None
    camera = camera_of(view, scene.boxes(0.0, np.arange(len(scene.items))))
    np.testing.assert_allclose(camera.pixels(np.array([view.target])), [[800, 450]], atol=1e-6)
    distance = np.linalg.norm(camera.eye - camera.target)
    assert distance == pytest.approx(np.linalg.norm(WAREHOUSE.eye - WAREHOUSE.target))


def test_zones_are_only_their_boxes() -> None:
    scene = ready("lidar_zone")
    bodies = bodies_of(scene, 0.0)
    zones = [row for row, body in enumerate(bodies) if body.opacity < 1.0]
    boxes = scene.boxes(0.0, np.arange(len(bodies)))
    camera = camera_of(scene.description.view, boxes)
    states = np.full(len(bodies), picture.FREE)
    with_zones = picture.render(bodies, boxes, states, picture.Marks(), camera)
    others = np.setdiff1d(np.arange(len(bodies)), zones)
    solid = [bodies[row] for row in others]
    without = picture.render(
        solid, boxes.take(others), states[: len(solid)], picture.Marks(), camera
    )
    changed = (np.abs(with_zones.astype(int) - without) > 8).any(axis=2).mean()
    assert 0.05 < changed < 0.6  # tinted where the zones are
    assert len(zones) == 3


def test_what_comes_and_goes_is_told_once() -> None:
    origin = (0.0, 0.0, 0.0)

    def row(time: float) -> NamedPrediction:
        return NamedPrediction("a/0", "b/0", time, origin, origin)

    follower = Predictions()
    lines = [list(follower.take([row(1.5 - t)], t)) for t in (0.0, 0.1, 0.2)]
    assert [len(found) for found in lines] == [1, 0, 0]
    assert lines[0][0].startswith("coming  a/0")
    assert len(list(follower.take([row(1.0)], 2.0))) == 1  # anew, after it was gone
    assert "passed" in next(follower.take([row(-0.02)], 2.1))
    unknown = NamedPrediction("a/0", "b/0", 0.5, (np.nan,) * 3, (np.nan,) * 3)
    assert "may collide from 0.50 s on" in next(follower.take([unknown], 2.2))
    assert follower.rows == []
    assert "2 collisions foreseen, 1 found between two states" in next(follower.ends())

    inside = Insides()
    entered = list(inside.take([NamedPoints("zone/0", 7, 0, 0, 0.1)], 0.0))
    left = list(inside.take([], 1.0))
    assert (entered, left) == (["entered zone/0  7 points inside"], ["left    zone/0"])

    near = Clearances()
    rows = [NamedClearance("a/0", "b/0", gap, origin, origin) for gap in (0.25, -0.5)]
    assert list(near.take(rows, 3.0)) == []
    assert "least 250.0 mm, a/0 – b/0, at 3.0 s" in next(near.ends())  # noqa: RUF001


ALL = """\
name: all
groups: {zones: ["zone/*"]}
allowed: [[zones, "*"], [box/0, box/1]]
effects:
  contacts: {objects: "box/*", max_points: 8}
  clearance: {objects: "box/*", limit: 1.5}
  sweep: {objects: "fast/*", horizon: 1.0}
  points: {objects: zones}
lidar: {count: 2000, range: 10, position: [0, -4, 1.5], sees: "box/*"}
objects:
  - {name: box/0, shape: box, size: [1, 1, 1], position: [0, 0, 0.5]}
  - {name: box/1, shape: box, size: [1, 1, 1], position: [0.5, 0, 0.5]}
  - {name: box/2, shape: box, size: [1, 1, 1], position: [-0.75, 0, 0.5]}
  - {name: box/3, shape: box, size: [1, 1, 1], position: [0, 2, 0.5]}
  - {name: zone/0, shape: box, size: [3, 3, 3], position: [0, 0, 1.75], color: [1, 0, 0, 0.2]}
  - {name: wall/0, shape: box, size: [0.01, 2, 2], position: [5, -3, 1]}
  - name: fast/0
    shape: capsule
    radius: 0.125
    length: 0.25
    motion: {period: 2.0, waypoints: [[3, -3, 1], [8, -3, 1]]}
"""

Start = Callable[[Path], Demo]


@pytest.fixture
def lines() -> list[str]:
    return []


@pytest.fixture
def start(lines: list[str]) -> Iterator[Start]:
    """Yield a function that starts the demo with a scene file."""
    context = rclpy_context.Context()
    context.init(domain_id=DOMAIN)
    started: list[Demo] = []

    def start(path: Path) -> Demo:
        started.append(Demo(context, FileScene(load_scene(path), path), 20.0, 1.5, lines.append))
        return started[0]

    yield start
    for demo in started:
        demo.close()
    context.try_shutdown()


def test_a_file_gets_the_effects_it_calls_for(
    start: Start, lines: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "all.yaml"
    path.write_text(ALL)
    demo = start(path)
    demo.run()
    assert set(demo.listener.pairs) == {("box/0", "box/2")}  # box/0 and box/1 may touch
    text = "\n".join(lines)
    assert "coming  fast/0" in text or "coming  wall/0" in text
    assert "entered zone/0" in text
    ends = "\n".join(demo.summary())
    for part in ("4 points at the end", "clearance: least", "sweep: ", "points in zone/0: "):
        assert part in ends
    pytest.importorskip("matplotlib")
    file = tmp_path / "all.png"
    demo.save_picture(file)
    assert file.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["shelf", "message"])
def test_moveit_scenes_run(start: Start, name: str) -> None:
    demo = start(MOVEIT / f"{name}.yaml")
    demo.begin()
    demo.settle(0.0)
    scene = demo.scene
    assert isinstance(scene, FileScene)
    said = scene.description
    expected = {frozenset(pair) for pair in said.build().check().names()}
    of = dict(zip(scene.names, said.names, strict=True))
    assert {frozenset(of[n] for n in pair) for pair in demo.listener.pairs} == expected
    assert all(a != b for a, b in combinations(scene.names, 2))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("objects: [{name: a, shape: box, size: [1, -1, 1]}]", "scene.yaml:1: objects[0].size: "),
        ("objects: []", "there are no objects in it"),
    ],
)
def test_bad_scene_files_are_refused_with_line_and_key(
    text: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(SystemExit) as stop:
        main(["--scene", str(path)])
    assert stop.value.code == 2
    assert reason in capsys.readouterr().err


def test_scenes_of_the_package_are_found_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert make_parser().parse_args(["--scene", "tabletop"]).scene[0].name == "tabletop"
    with pytest.raises(SystemExit):
        make_parser().parse_args(["--scene", "kitchen"])
    assert "tabletop, warehouse, lidar_zone" in capsys.readouterr().err
