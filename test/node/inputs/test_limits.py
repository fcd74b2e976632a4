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

"""What exceeds a limit of the node is refused with the limit in its reason; the rest goes on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
import trimesh
from each import each
from rig import Rig, cube, pose, sync
from robot_rig import URDF, RobotRig
from shape_markers import BOX, mesh_marker, triangle

A, B = ("a", 1), ("b", 1)


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    (tmp_path / "allowed").mkdir()
    folders = [str(tmp_path / "allowed")]
    with Rig(mesh_folders=folders, max_triangles=11, max_cloud_points=2, max_name_length=5) as made:
        yield made


def test_shapes_beyond_the_limits_are_refused(
    rig: Rig, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for folder in ("allowed", "."):
        trimesh.creation.box().export(tmp_path / folder / "part.stl")
    rig.send(triangle(A), mesh_marker(tmp_path / "allowed" / "part.stl", B))
    rig.until(lambda: rig.refused("objects").get("too many points") == 1, "points")
    rig.until(lambda: rig.refused("objects").get("too many triangles") == 1, "triangles")
    assert "12 triangles, 11 is the limit" in capfd.readouterr().err
    many = triangle(A)
    many.points = many.points * 12
    rig.send(many)
    rig.until(lambda: rig.refused("objects")["too many triangles"] == 2, "triangles of a marker")
    rig.send(mesh_marker(tmp_path / "part.stl", B))
    rig.until(lambda: rig.refused("objects").get("unreadable mesh") == 1, "file elsewhere")
    assert "is in no folder from which meshes are read" in capfd.readouterr().err
    rig.send(cube(BOX), cube(A))
    assert rig.pairs() == {("a/1", "box/1")}


def test_clouds_beyond_the_limit_are_refused_whole(rig: Rig) -> None:
    rig.send(cube(A), cube(B))
    rig.pairs()
    rig.listen("points_inside")
    one = np.array([pose(9.0)])
    rig.send_points(np.zeros((3, 3)))
    rig.send_poses([1, 2, 3], np.repeat(one, 3, axis=0))
    rig.send_boxes([1, 2, 3], np.repeat(one, 3, axis=0))
    for topic in ("points", "object_poses", "object_boxes"):
        rig.until(lambda: rig.refused(topic) == {"too many points": 1}, topic)  # noqa: B023
    assert sync(rig) == {("a/1", "b/1")}
    rig.send_boxes([1, 2], np.array([pose(0.1), pose(9.0)]))
    rig.until(lambda: len(rig.node.objects.table) == 5, "a set within the limit")


def test_names_beyond_the_limit_are_refused(rig: Rig) -> None:
    rig.send(cube(A), cube(("123456", 1)), cube(("12345", 1)), cube(("\u00e9\u00e9\u00e9", 1)))
    assert rig.pairs() == {("12345/1", "a/1")}
    assert rig.refused("objects") == {"bad name": 2}


def test_the_folders_of_meshes_cannot_be_changed_while_it_runs(rig: Rig) -> None:
    (result,) = rig.set(mesh_folders=["/"])
    assert not result.successful
    assert "/" not in rig.node.parameters.folders.chosen


@each("folder", ["meshes", "./meshes", "~", "file:///tmp", "..: /a", "arm: b"])
def test_a_folder_is_an_absolute_path(folder: str) -> None:
    with pytest.raises(ValueError, match="is no absolute path"), Rig(mesh_folders=[folder]):
        pass


def test_a_package_has_one_folder() -> None:
    twice = ["arm: /a", "arm: /b"]
    with pytest.raises(ValueError, match="one entry for each package"), Rig(mesh_folders=twice):
        pass


def test_packages_that_are_not_installed_are_found_for_all_that_name_files(tmp_path: Path) -> None:
    """By a folder of their own, and in a folder of packages."""
    pytest.importorskip("lxml")
    uris = {}
    for package, folder in (("arm_description", "v2"), ("parts", "parts")):
        (tmp_path / folder).mkdir()
        trimesh.creation.box().export(tmp_path / folder / "a part.stl")
        uris[package] = f"package://{package}/a%20part.stl"
    scene, urdf = tmp_path / "scene.yaml", URDF
    rows = [f"{{name: {name}, shape: mesh, file: '{uri}'}}" for name, uri in uris.items()]
    scene.write_text(f"objects: [{', '.join(rows)}]")
    for uri in uris.values():
        urdf = urdf.replace('<box size="0.1 0.1 0.1"/>', f'<mesh filename="{uri}"/>', 1)
    folders = [f"arm_description: {tmp_path / 'v2'}", str(tmp_path)]
    with RobotRig({"mesh_folders": folders, "scene_file": str(scene)}) as rig:
        rig.start_robot(urdf)
        rig.send(*(mesh_marker(uri, key) for uri, key in zip(uris.values(), (A, B), strict=True)))
        rig.built(A, B)
        others = ("arm_description/0", "parts/0", "arm/column/0", "arm/hand/0", "b/1")
        assert {("a/1", other) for other in others} <= {tuple(sorted(pair)) for pair in sync(rig)}
        assert rig.refused("objects") == {}
