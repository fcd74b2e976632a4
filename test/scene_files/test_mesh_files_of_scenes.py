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

"""Mesh files of a scene file: where they may be, and that reading them can be given up."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import trimesh

from obb_collision.geometry.shapes.files import NO_FOLDERS
from obb_collision.scene.building.process import Limits
from obb_collision.scene_files import SceneFileError, describe_scene, load_scene
from obb_collision.scene_files.mesh_files import MeshReading
from obb_collision.shapes import Mesh

OUTSIDE = "is in no folder from which meshes are read"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return a scene file in the folder config of a package, without content."""
    for name in ("arm/config", "arm/meshes", "other"):
        (tmp_path / name).mkdir(parents=True)
    for folder in ("arm/config", "arm/meshes", "other"):
        trimesh.creation.box().export(tmp_path / folder / "part.stl")
    return tmp_path / "arm" / "config" / "scene.yaml"


def naming(scene: Path, file: str) -> Path:
    """Write a scene with one mesh."""
    scene.write_text(f"objects: [{{name: a, shape: mesh, file: '{file}'}}]")
    return scene


def faces(mesh: object) -> int:
    assert isinstance(mesh, Mesh)
    return len(mesh.faces)


def test_a_mesh_may_be_beside_the_scene_file(scene: Path) -> None:
    for file in ("part.stl", (scene.parent / "part.stl").as_uri()):
        assert faces(load_scene(naming(scene, file)).objects[0].shape) == 12


def test_a_mesh_may_be_in_the_package_of_the_scene_file(scene: Path) -> None:
    naming(scene, "../meshes/part.stl")
    with pytest.raises(SceneFileError, match=OUTSIDE):
        load_scene(scene)
    (scene.parents[1] / "package.xml").write_text("<package><name>arm</name></package>")
    assert faces(load_scene(scene).objects[0].shape) == 12
    assert faces(load_scene(naming(scene, "package://arm/meshes/part.stl")).objects[0].shape) == 12
    with pytest.raises(SceneFileError, match=OUTSIDE):
        load_scene(naming(scene, "package://arm/../other/part.stl"))


def test_a_mesh_elsewhere_needs_its_folder_to_be_allowed(scene: Path, tmp_path: Path) -> None:
    (scene.parent / "link.stl").symlink_to(tmp_path / "other" / "part.stl")
    for file in ("../../other/part.stl", (tmp_path / "other/part.stl").as_uri(), "link.stl"):
        naming(scene, file)
        with pytest.raises(SceneFileError, match=rf"objects\[0\].file: mesh file .*{OUTSIDE}"):
            load_scene(scene)
        loaded = load_scene(scene, mesh_folders=[tmp_path / "other"])
        assert faces(loaded.objects[0].shape) == 12


@pytest.mark.parametrize("folders", ["/tmp", [1], None, {"/tmp"}])
def test_folders_are_a_sequence_of_paths(scene: Path, folders: object) -> None:
    with pytest.raises(TypeError, match="mesh_folders must be"):
        load_scene(naming(scene, "part.stl"), mesh_folders=folders)  # type: ignore[arg-type]


@pytest.fixture
def reading(request: pytest.FixtureRequest) -> Iterator[MeshReading]:
    made = MeshReading(NO_FOLDERS, *request.param)
    yield made
    made.close()


@pytest.mark.parametrize("reading", [(Limits(),)], indirect=True)
def test_a_mesh_read_in_another_process_is_the_same(scene: Path, reading: MeshReading) -> None:
    naming(scene, "part.stl")
    there, here = describe_scene(scene, reading), load_scene(scene)
    assert there.objects[0].shape == here.objects[0].shape


@pytest.mark.parametrize(
    ("reading", "reason"),
    [
        ((Limits(seconds=0.0),), "building took too long: 0 s is the limit"),
        ((Limits(), 100), "it has 684 bytes, 100 is the limit"),
        ((Limits(), 1000, 11), "it has 12 triangles, 11 is the limit"),
    ],
    indirect=["reading"],
)
def test_reading_in_another_process_has_limits(
    scene: Path, reading: MeshReading, reason: str
) -> None:
    with pytest.raises(SceneFileError, match=reason):
        describe_scene(naming(scene, "part.stl"), reading)
