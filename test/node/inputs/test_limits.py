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
from rig import Rig, cube, pose, sync
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
    assert rig.node.parameters.mesh_folders != ["/"]


@pytest.mark.parametrize("folder", ["meshes", "./meshes", "~", "file:///tmp"])
def test_a_folder_is_an_absolute_path(folder: str) -> None:
    with pytest.raises(ValueError, match="is no absolute path"), Rig(mesh_folders=[folder]):
        pass
