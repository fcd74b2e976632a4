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

import numpy as np
import pytest
from pages import ROOT, table_rows

import obb_collision as oc
from obb_collision import scene_files as files
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene_files import moveit, native, objects
from obb_collision.scene_files.description import NODE_EFFECTS, NOISE

PAGE = ROOT / "docs" / "scene_files.md"
DOCS = PAGE.read_text()


@pytest.fixture(params=files.READY)
def ready(request: pytest.FixtureRequest) -> files.SceneDescription:
    """Return one of the scenes of the package."""
    return files.load_scene(request.param)


def test_ready_scenes_are_those_of_the_folder_and_of_the_page() -> None:
    found = (ROOT / "config").glob("*.yaml")
    motions = {f"{name}.motion" for name in files.READY}
    assert {path.stem for path in found} == {*files.READY, *motions, "obb_collision"}
    rows = re.findall(r"^\| `(\w+)\.yaml` \|", DOCS, re.MULTILINE)
    assert tuple(rows) == files.READY


def test_ready_scenes_build_and_are_free(ready: files.SceneDescription) -> None:
    scene = ready.build()
    assert scene.names == ready.names
    assert scene.check().names() == []


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


def words(heading: str) -> set[str]:
    """Return the words in code font in the first cells of a section's table."""
    return {word for row in table_rows(PAGE, heading) for word in re.findall(r"`(\w+)", row[0])}


def test_keys_are_those_of_the_code() -> None:
    assert words("## Keys of a file") == set(native.KEYS)
    sizes = {key for _, keys in objects.SHAPES.values() for key in keys}
    assert words("## Keys of an object") == {*objects.KEYS, *sizes}
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
