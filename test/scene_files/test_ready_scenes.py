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

"""The scenes that come with the package and the page about scene files: both say what is so."""

from __future__ import annotations

import fnmatch
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from pages import ROOT, table_rows
from scipy.spatial.transform import Rotation
from support import refused

import obb_collision as oc
from obb_collision import scene_files as files
from obb_collision.geometry.poses import Pose
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene_files import moveit, native, objects
from obb_collision.scene_files.description import NODE_EFFECTS, NOISE
from obb_collision.scene_files.objects import KINDS

PAGE = ROOT / "docs" / "scene_files.md"
DOCS = PAGE.read_text()
#: Seconds between two poses of which the difference is compared with the twist.
STEP = 1e-6
TIMES = np.arange(0.013, 20.0, 0.37)


@pytest.fixture(params=files.READY)
def ready(request: pytest.FixtureRequest) -> files.SceneDescription:
    """Return one of the scenes of the package."""
    return files.load_scene(request.param)


def test_ready_scenes_are_those_of_the_folder_and_of_the_page() -> None:
    found = (ROOT / "config").glob("*.yaml")
    assert {path.stem for path in found} == {*files.READY, "obb_collision"}
    rows = re.findall(r"^\| `(\w+)\.yaml` \|", DOCS, re.MULTILINE)
    assert tuple(rows) == files.READY


def test_ready_scenes_build_and_collide_only_later(ready: files.SceneDescription) -> None:
    scene = ready.build()
    assert scene.names == ready.names
    assert scene.check().names() == []
    seen: set[tuple[str, str]] = set()
    for time in TIMES:
        scene.move(ready.names, ready.states(float(time))[0])
        seen.update(scene.check().names())
    assert seen or ready.lidar is not None or ready.robots


def test_the_stop_zone_is_free_at_first_and_then_is_not() -> None:
    description = files.load_scene("lidar_zone")
    assert description.lidar is not None
    scene = description.build()
    counts = []
    for time in (0.0, 10.0):
        scene.move(description.names, description.states(time)[0])
        points = description.lidar.scan(scene, time)
        counts.append(np.count_nonzero(scene.obb("zone/0").contains(points.astype(float))))
    assert counts[0] == 0
    assert counts[1] > 20


def test_their_patterns_are_about_something(ready: files.SceneDescription) -> None:
    rules = [pattern for rule in ready.allowed for pattern in (rule.first, rule.second)]
    effects = [pattern for choice in ready.effects.values() for pattern in choice.objects or ()]
    links = [f"{r.name}/{link}/0" for r in ready.robots for link in r.robot.link_names]
    groups = [pattern for patterns in ready.groups.values() for pattern in patterns]
    for pattern in (*rules, *effects, *groups, *(pattern for pattern, _ in ready.accuracies)):
        assert fnmatch.filter([*ready.names, *links], pattern), pattern


def test_scenes_are_found_in_a_pip_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(files.SceneFileError, match="scenes of the package are tabletop, warehou"):
        files.load_scene("kitchen")
    assert files.find_scene("kitchen.yaml") == Path("kitchen.yaml")
    config = tmp_path / "share" / "obb_collision" / "config"
    config.mkdir(parents=True)
    (config / "tabletop.yaml").write_text("objects: [{name: a, shape: sphere, radius: 1}]")
    module = tmp_path / "obb_collision" / "scene_files" / "load.py"
    monkeypatch.setattr("obb_collision.scene_files.load.__file__", str(module))
    assert files.load_scene("tabletop").names == ["a"]


def test_twists_are_how_poses_change(ready: files.SceneDescription) -> None:
    for time in TIMES.tolist():
        (before, twists), (after, _) = ready.states(time), ready.states(time + STEP)
        moved = (after[:, :3] - before[:, :3]) / STEP
        turns = Rotation.from_quat(after[:, 3:]) * Rotation.from_quat(before[:, 3:]).inv()
        np.testing.assert_allclose(moved, twists[:, :3], atol=1e-5)
        np.testing.assert_allclose(turns.as_rotvec() / STEP, twists[:, 3:], atol=1e-5)


def test_what_rests_has_its_pose_bit_for_bit_and_no_twist(ready: files.SceneDescription) -> None:
    poses, twists = ready.states(7.0)
    for row, thing in enumerate(ready.objects):
        if thing.motion is None:
            assert (*poses[row].tolist(),) == thing.pose
            assert not twists[row].any()
    begins = [thing.pose for thing in ready.objects]
    np.testing.assert_allclose(ready.states(0.0)[0], begins, atol=1e-12)


def test_waypoints_without_times_are_even(write: Any) -> None:
    motion = "{period: 3, waypoints: [[0, 0, 0], [3, 0, 0, 0], [3, 3, 0]]}"
    path = write(f"objects: [{{name: a, shape: sphere, radius: 1, motion: {motion}}}]")
    scene = files.load_scene(path)
    places = [scene.states(time)[0][0, :2].tolist() for time in (0.5, 1.5, 2.5)]
    np.testing.assert_allclose(places, [[1.5, 0], [3, 1.5], [1.5, 1.5]], atol=1e-12)


def test_a_lidar_sees_cylinders_as_they_are() -> None:
    lidar = files.Lidar(20000, 8.0, (0.0, 0.0, 1.5))
    scene, pose = oc.Scene(), np.array([3, 0, 1, 0, 0.1, 0, 1.0])
    scene.add("cylinder", oc.shapes.Cylinder(0.5, 1.5), pose)
    scene.add("not seen", oc.shapes.Box([0.1, 9.0, 9.0]), [1, 0, 0, 0, 0, 0, 1])
    box = oc.Boxes.from_poses([pose], [[0.5, 0.5, 0.75]])
    lidar = replace(lidar, sees=("cyl*",), seed=3)
    seen = lidar.scan(scene, 0.5)
    assert seen.dtype == np.float32
    assert np.array_equal(seen, lidar.scan(scene, 0.5))
    assert not np.array_equal(seen, lidar.scan(scene, 0.6))
    assert np.linalg.norm(seen - [0, 0, 1.5], axis=1).max() < 8.0 + 6 * NOISE
    assert (seen[:, 2] > -6 * NOISE).all()
    points = seen.astype(float)
    local = (points[points[:, 2] > 0.1] - box.centers[0]) @ box.rotations[0]
    radii, heights = np.hypot(local[:, 0], local[:, 1]), np.abs(local[:, 2])
    assert len(local) > 100
    assert ((radii < 0.5 + 6 * NOISE) & (heights < 0.75 + 6 * NOISE)).all()
    assert ((radii > 0.5 - 6 * NOISE) | (heights > 0.75 - 6 * NOISE)).all()


def test_a_lidar_in_a_box_or_straight_above_a_face_gives_no_nonsense() -> None:
    lidar = files.Lidar(1000, 8.0, (0.0, 0.0, 1.0))
    around = oc.Scene()
    around.add("around", oc.shapes.Box([2, 2, 2]), [0, 0, 1, 0, 0, 0, 1])
    around.add("too", oc.shapes.Sphere(1.5), [0, 0, 1, 0, 0, 0, 1])
    points = lidar.scan(around, 0.0)
    assert np.isfinite(points).all()
    assert (np.abs(points[:, 2]) < 6 * NOISE).all()  # the floor
    assert len(points) > 100
    assert len(files.Lidar(1, 8.0).scan(around, 0.0)) <= 1


RNG = np.random.default_rng(8)


def random_pose() -> Pose:
    x, y, z = RNG.uniform(-3.0, 3.0, 3).tolist()
    qx, qy, qz, qw = Rotation.random(random_state=RNG.integers(2**31)).as_quat().tolist()
    return x, y, z, qx, qy, qz, qw


def random_loop() -> files.Loop:
    return files.Loop((random_pose(), random_pose(), random_pose()), (0.0, 0.5, 2.0), 3.0)


MOTIONS: dict[str, files.Motion | None] = {
    "post": None,
    "car": files.Steady((1.0, 2.0, 0.0, 0.1, 0.2, 0.7), period=4.0),
    "train": random_loop(),
    "load": files.Follow("train"),
    "fly": files.Follow("load", random_loop()),
    "shadow": files.Follow("fly"),
    "sign": files.Follow("post"),
    "slide": files.Steady((1.0, 0.0, 0.5, 0.0, 0.0, 0.0)),
}
STARTS = {name: random_pose() for name in MOTIONS}

State = tuple[np.ndarray, Rotation, np.ndarray, np.ndarray]


def along(begin: Pose, velocity: np.ndarray, turn: np.ndarray, seconds: float) -> State:
    """Return position, rotation, velocity and angular velocity after a steady twist."""
    rotation = Rotation.from_rotvec(turn * seconds) * Rotation.from_quat(begin[3:])
    return np.array(begin[:3]) + velocity * seconds, rotation, velocity, turn


def looped(loop: files.Loop, time: float) -> State:
    passed = time % loop.period
    leg = int(np.searchsorted(loop.times, passed, side="right")) - 1
    begin, end = loop.poses[leg], loop.poses[(leg + 1) % len(loop.poses)]
    lasts = (*loop.times, loop.period)[leg + 1] - loop.times[leg]
    turn = (Rotation.from_quat(end[3:]) * Rotation.from_quat(begin[3:]).inv()).as_rotvec()
    velocity = np.array(end[:3]) - np.array(begin[:3])
    return along(begin, velocity / lasts, turn / lasts, passed - loop.times[leg])


def expected(name: str, time: float) -> State:
    motion, start, still = MOTIONS[name], STARTS[name], np.zeros(3)
    if motion is None:
        return along(start, still, still, 0.0)
    if isinstance(motion, files.Steady):
        twist = np.array(motion.twist)
        return along(start, twist[:3], twist[3:], time % (motion.period or np.inf))
    if isinstance(motion, files.Loop):
        return looped(motion, time)
    place, rotation, velocity, turn = expected(motion.name, time)
    if motion.loop is None:
        begun, facing, _, _ = expected(motion.name, 0.0)
        inner = facing.inv().apply(np.array(start[:3]) - begun)
        state = inner, facing.inv() * Rotation.from_quat(start[3:]), still, still
    else:
        state = looped(motion.loop, time)
    arm = rotation.apply(state[0])
    moving = velocity + np.cross(turn, arm) + rotation.apply(state[2])
    return place + arm, rotation * state[1], moving, turn + rotation.apply(state[3])


@each("time", [0.0, 0.3, 0.5, 1.7, 2.9, 100.3])
def test_states_agree_with_one_object_at_a_time(time: float) -> None:
    rows = {name: row for row, name in enumerate(MOTIONS)}
    starts = np.array(list(STARTS.values()))
    poses, twists = files.states_at(starts, list(MOTIONS.values()), rows, time)
    for row, name in enumerate(MOTIONS):
        place, rotation, velocity, turn = expected(name, time)
        np.testing.assert_allclose(poses[row, :3], place, atol=1e-12)
        matrix = Rotation.from_quat(poses[row, 3:]).as_matrix()
        np.testing.assert_allclose(matrix, rotation.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(twists[row], np.r_[velocity, turn], atol=1e-12)
    assert poses[rows["post"]].tolist() == list(STARTS["post"])
    assert poses[rows["slide"], 3:].tolist() == pytest.approx(STARTS["slide"][3:], abs=1e-15)
    circle: list[files.Motion | None] = [files.Follow("b"), files.Follow("a")]
    reason = "follow each other in a loop"
    refused(reason, files.states_at, np.zeros((2, 7)), circle, {"a": 0, "b": 1}, time)


def words(heading: str) -> set[str]:
    """Return the words in code font in the first cells of a section's table."""
    return {word for row in table_rows(PAGE, heading) for word in re.findall(r"`(\w+)", row[0])}


def test_keys_are_those_of_the_code() -> None:
    assert words("## Keys of a file") == set(native.KEYS)
    kinds = {key for keys in KINDS.values() for key in keys}
    sizes = {key for _, keys in objects.SHAPES.values() for key in keys}
    assert words("## Keys of an object") | words("## Zones and motion") == {
        *objects.KEYS, *sizes, *kinds
    }  # fmt: skip
    assert words("## Robots") == set(native.ROBOT_KEYS)
    assert words("## Effects") == {*EFFECTS, *NODE_EFFECTS}
    parts = words("## MoveIt planning scenes")
    assert {part for part in parts if part != "is_diff"} <= set(moveit.KEYS)
    rows = {row[0]: row[1] for row in table_rows(PAGE, "## Effects")}
    for effect, values in EFFECTS.items():
        named = set(re.findall(r"`(\w+)`", rows[f"`{effect}`"]))
        assert named == {"mode", "objects", *values.options}


def test_the_errors_are_as_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (shown,) = re.findall(r"```text\n(.*?)```", DOCS, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    text = [
        "groups: {gripper: [g/*]}", *["# words"] * 9, "objects:",
        "- {name: a, shape: box, size: [1, 1, 1]}", "- {name: b, shape: box, size: [1, 1, 1]}",
        "- {name: c, shape: box, size: [1, -1]}", *["# words"] * 4, "effects:",
        "  contact: on", "allowed: [[a, b],", "  [griper, a]]",
    ]  # fmt: skip
    Path("cell.yaml").write_text("\n".join(text))
    with pytest.raises(files.SceneFileError) as error:
        files.load_scene("cell.yaml")
    assert str(error.value).splitlines() == shown.splitlines()
