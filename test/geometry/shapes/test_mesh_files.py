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

"""Meshes in files: what is read, what is refused, and the folders that may be read."""

from __future__ import annotations

import base64
import builtins
import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
import trimesh
from convex_bodies import CORNER_SIGNS
from each import each
from support import refused
from trimesh.visual.material import SimpleMaterial

from obb_collision.geometry.formats.parts import Parts, TooManyError
from obb_collision.geometry.shapes import files as mesh_files
from obb_collision.geometry.shapes.files import allowed_path, resolve_path, source_folder
from obb_collision.shapes import Mesh

OBJ = "mtllib {mtl}\no part\nv 0 0 0\nv 1 0 0\nv 0 2 0\nvt 0 0\nusemtl skin\nf 1/1 2/1 3/1\n"


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[Path]:
    """Yield a named pipe; whoever opened it is let go at the end, so that a failure ends, too."""
    path = tmp_path / "pipe.stl"
    os.mkfifo(path)
    yield path
    descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    os.close(descriptor)


def soup(vertices: Any, faces: Any) -> np.ndarray:
    """Triangles as rows, sorted: the same for the same surface."""
    triangles = np.asarray(vertices)[np.asarray(faces)].reshape(-1, 9)
    return triangles[np.lexsort(triangles.T)]


def loads_in_time(path: Path | str) -> Mesh | Exception:
    """Load in a thread of its own, so that a load that blocks is a failure and not a hang."""
    results: list[Mesh | Exception] = []

    def load() -> None:
        try:
            results.append(Mesh.from_file(path))
        except Exception as error:
            results.append(error)

    thread = threading.Thread(target=load, daemon=True)
    thread.start()
    thread.join(20.0)
    assert results, "the load blocks"
    return results[0]


def refused_in_time(path: Path | str, reason: str) -> None:
    error = loads_in_time(path)
    assert isinstance(error, ValueError)
    assert reason in str(error)


def textured_scene() -> trimesh.Scene:
    image = SimpleMaterial(diffuse=(200, 10, 10, 255))
    scene = trimesh.Scene()
    for number in range(3):
        part = trimesh.creation.icosphere(1, radius=1.0 + number)
        uv = part.vertices[:, :2] * 0.5 + 0.5
        part.visual = trimesh.visual.TextureVisuals(uv=uv, material=image)
        move = trimesh.transformations.rotation_matrix(0.3 * number, (0, 1, 1), (1, 2, 3))
        move[:3, 3] += 5.0 * number
        scene.add_geometry(part, transform=move)
    return scene


@each("suffix", ["obj", "stl", "ply", "dae", "glb", "off"])
def test_the_geometry_is_that_of_a_load_with_materials(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"two words.{suffix}"
    scene = textured_scene()
    whole = suffix in ("stl", "ply", "off", "dae")
    (trimesh.util.concatenate(scene.dump()) if whole else scene).export(file)
    expected: Any = trimesh.load(file, force="scene", process=False)
    mesh = Mesh.from_file(file)
    kind = np.float32 if suffix == "dae" else np.float64  # pycollada's numbers
    parts = [soup(np.asarray(part.vertices, kind), part.faces) for part in expected.dump()]
    wanted = np.concatenate(parts)
    found = soup(mesh.vertices.astype(kind), mesh.faces)
    np.testing.assert_array_equal(found, wanted[np.lexsort(wanted.T)])
    assert len(mesh.faces) == 3 * 80
    scaled = Mesh.from_file(file.as_uri(), scale=(2.0, 1.0, 1.0))
    assert scaled == Mesh(mesh.vertices, mesh.faces, (2.0, 1.0, 1.0))


@each("what", ["mtl", "texture"])
def test_materials_and_textures_of_an_obj_are_not_opened(
    tmp_path: Path, pipe: Path, what: str
) -> None:
    (tmp_path / "skin.mtl").write_text(f"newmtl skin\nmap_Kd {pipe.name}\n")
    file = tmp_path / "part.obj"
    file.write_text(OBJ.format(mtl=pipe.name if what == "mtl" else "skin.mtl"))
    mesh = loads_in_time(file)
    assert isinstance(mesh, Mesh)
    assert mesh.vertices[mesh.faces].tolist() == [[[0, 0, 0], [1, 0, 0], [0, 2, 0]]]


def gltf(buffer_uri: str) -> str:
    """Return one triangle, its buffer anywhere."""
    return json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": buffer_uri, "byteLength": 36}],
    })  # fmt: skip


def test_buffers_of_a_gltf_are_read_only_where_they_are_inside(tmp_path: Path, pipe: Path) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], "<f4").tobytes()
    file = tmp_path / "part.gltf"
    inside = base64.b64encode(points).decode()
    file.write_text(gltf(f"data:application/octet-stream;base64,{inside}"))
    assert len(Mesh.from_file(file).vertices) == 3
    file.write_text(gltf(pipe.name))
    refused_in_time(file, "other files are not read")


def test_a_document_type_that_names_a_file_is_refused(tmp_path: Path, pipe: Path) -> None:
    text = f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY x SYSTEM "{pipe.name}">]><COLLADA>&x;'
    for encoding in ("utf-8", "utf-16"):
        file = tmp_path / "part.dae"
        file.write_bytes(text.encode(encoding))
        refused_in_time(file, "DOCTYPE")


def test_pipes_devices_and_folders_are_no_mesh_files(tmp_path: Path, pipe: Path) -> None:
    (tmp_path / "folder.stl").mkdir()
    (tmp_path / "zero.stl").symlink_to("/dev/zero")
    for name in (pipe.name, "folder.stl", "zero.stl"):
        refused_in_time(tmp_path / name, "it is not a regular file")


def test_a_file_that_becomes_a_pipe_as_it_is_opened_does_not_block(
    tmp_path: Path, pipe: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mesh_files, "file_version", lambda path: (0, 0))  # it was one by then
    refused_in_time(pipe, "it is not a regular file")


#: A zero byte, 300 characters in a name or suffix, 5,000 in all, half a character, and nothing.
NO_PATHS = [
    "part\0.stl", "a" * 300 + ".stl", "part." + "a" * 300, "a/" * 2500 + "part.stl",
    "\ud800.stl", "",
]  # fmt: skip
NO_URIS = [
    *("file://[/part.stl", "file://part.stl", "package://\0/part.stl", "package:///part.stl"),
    *("file://" + quote(f"/{path}", errors="surrogatepass") for path in NO_PATHS),
]


@each("name", [*NO_PATHS, *NO_URIS])
def test_paths_and_uris_that_no_file_can_have_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=r"^mesh file ") as caught:
        Mesh.from_file(name if "://" in name else tmp_path / name)
    assert len(str(caught.value)) < 1000


def test_files_beyond_the_limit_are_not_read(tmp_path: Path) -> None:
    file = tmp_path / "part.stl"
    with file.open("wb") as sparse:
        sparse.truncate(mesh_files.LARGEST_FILE + 1)
    refused(f"{mesh_files.LARGEST_FILE} is the limit", Mesh.from_file, file)
    file.write_bytes(b"0123456789")
    assert mesh_files.read_file(file, 10)[0] == b"0123456789"
    refused("10 bytes, 9 is the limit", mesh_files.read_file, file, 9)


def test_too_little_memory_is_an_error_that_names_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "part.stl"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(file)

    def fails(*_: object) -> None:
        raise MemoryError

    for owner, name in ((Parts, "joined"), (Mesh, "__init__")):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, fails)
            refused(r"part\.stl: there is not enough memory", Mesh.from_file, file)


@each("kind", ["zip", "tar.gz", "bz2", "zae", "3mf", "xaml", "step", "stl.gz"])
def test_archives_and_other_types_are_not_read(kind: str) -> None:
    refused(r"its type '\w+' is none of stl", mesh_files.read_mesh, b"PK\3\4", f"part.{kind}")


DAE = '<?xml version="1.0" encoding="{}"?>{}<COLLADA version="1.4.1"/>'
BOMB = '<!DOCTYPE a [<!ENTITY b "bbbbbbbb"><!ENTITY c "&b;&b;&b;&b;">]>'


@each(
    "encoding, codec, reason",
    [
        ("utf-8", "utf-8", "DOCTYPE"),
        ("ascii", "utf-8-sig", "DOCTYPE"),
        ("utf-16", "utf-16", "DOCTYPE"),
        ("UTF-16", "utf-16-le", "DOCTYPE"),
        ("utf-16", "utf-16-be", "DOCTYPE"),
        ("utf-7", "utf-8", "'utf-7', none of"),
        ("IBM037", "cp037", "not valid XML"),
        ("utf-32", "utf-32", "UTF-32"),
        ("utf-32", "utf-32-be", "UTF-32"),
    ],
)
def test_a_document_type_is_seen_in_every_encoding(encoding: str, codec: str, reason: str) -> None:
    refused(reason, mesh_files.read_mesh, DAE.format(encoding, BOMB).encode(codec), "part.dae")


def test_triangles_are_limited_as_often_as_the_scene_places_them() -> None:
    part = trimesh.creation.box()
    scene = trimesh.Scene()
    for number in range(5):
        matrix = np.eye(4)
        matrix[0, 3] = number
        scene.add_geometry(part, geom_name="part", transform=matrix)
    data = scene.export(file_type="glb")
    assert isinstance(data, bytes)
    assert len(mesh_files.read_mesh(data, "part.glb", 60)[1]) == 60
    with pytest.raises(TooManyError, match="it has 60 triangles, 59 is the limit"):
        mesh_files.read_mesh(data, "part.glb", 59)
    unused = trimesh.Trimesh(np.ones((10, 3)), [[0, 1, 2]], process=False).export(file_type="ply")
    assert isinstance(unused, bytes)
    assert len(mesh_files.read_mesh(unused, "part.ply", 4)[0]) == 10
    with pytest.raises(TooManyError, match="it has 10 vertices, 9 is the limit"):
        mesh_files.read_mesh(unused, "part.ply", 3)


REFUSED = "is not in a folder from which meshes are read"


def package(prefix: Path, name: str) -> Path:
    """Register an installed package; returns its share folder."""
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True, exist_ok=True)
    (index / name).touch()
    share = prefix / "share" / name
    (share / "meshes").mkdir(parents=True)
    return share


@pytest.fixture
def share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the share folder of the only installed package, ``arm``."""
    pytest.importorskip("ament_index_python")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    return package(tmp_path / "install", "arm")


@pytest.fixture
def chosen(tmp_path: Path) -> Path:
    folder = tmp_path / "chosen"
    folder.mkdir()
    return folder


def test_files_in_chosen_folders_are_allowed_wherever_the_path_comes_from(
    chosen: Path, tmp_path: Path
) -> None:
    file = chosen / "sub" / "a b.stl"
    for uri in (file.as_uri(), f"file://localhost{file.as_uri()[7:]}", str(file)):
        assert allowed_path(resolve_path(uri), [chosen]) == file
    assert allowed_path(chosen / "x" / ".." / "a.stl", [str(chosen)]) == chosen / "a.stl"
    link = tmp_path / "link"
    link.symlink_to(chosen)
    assert allowed_path(link / "a.stl", [link]) == chosen / "a.stl"


def test_files_outside_are_refused_however_they_are_named(chosen: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.stl"
    outside.touch()
    (chosen / "link.stl").symlink_to(outside)
    (chosen / "up").symlink_to("..")
    (chosen / "loop").symlink_to("loop")
    hostile = [
        outside, chosen / ".." / "outside.stl", chosen / "link.stl", chosen / "up" / "outside.stl",
        resolve_path(f"file://{chosen}/%2e%2e/outside.stl"), Path("/etc/passwd"),
        resolve_path(f"file://{chosen}/..%2Foutside.stl"), Path(f"{chosen}2/a.stl"),
        Path("outside.stl"),
    ]  # fmt: skip
    for path in hostile:
        refused(REFUSED, allowed_path, path, [chosen])
    refused(f"it leads to {outside}, which is not in", allowed_path, chosen / "link.stl", [chosen])
    refused("null", allowed_path, Path("/a\0b"), [chosen])
    for name in ("loop", "a" * 300):
        file = chosen / name
        assert allowed_path(file, [chosen]) == file, "no file: it is refused when it is read"


@each("path", ["/proc/self/mem", "/dev/zero", "/sys/kernel", "/dev/../proc/1"])
def test_files_of_the_kernel_are_never_read(path: str, chosen: Path) -> None:
    (chosen / "link").unlink(missing_ok=True)
    (chosen / "link").symlink_to(path)
    for name in (Path(path), chosen / "link"):
        refused(REFUSED, allowed_path, name, ["/"])


def test_shares_of_installed_packages_are_allowed(share: Path) -> None:
    file = share / "meshes" / "hand.stl"
    assert allowed_path(resolve_path("package://arm/meshes/hand.stl"), []) == file
    assert allowed_path(file, []) == file
    for path in (share.parent / "other" / "a.stl", share / ".." / "other" / "a.stl"):
        refused(REFUSED, allowed_path, path, [])
    refused(REFUSED, allowed_path, resolve_path("package://arm/../../../outside.stl"), [])
    refused(REFUSED, allowed_path, resolve_path("package://arm/%2e%2e/%2e%2e/outside.stl"), [])


def test_links_of_a_share_lead_to_the_sources_of_the_same_package_only(
    share: Path, tmp_path: Path
) -> None:
    source = tmp_path / "src" / "robot"
    (source / "meshes").mkdir(parents=True)
    (source / "meshes" / "hand.stl").touch()
    link = share / "meshes" / "hand.stl"
    link.symlink_to(source / "meshes" / "hand.stl")
    refused(REFUSED, allowed_path, link, [])
    for name, allowed in (("legs", False), ("arm", True)):
        (source / "package.xml").write_text(f"<package>\n  <name> {name} </name></package>")
        assert source_folder(source / "meshes" / "hand.stl") == source
        if allowed:
            assert allowed_path(link, []) == source / "meshes" / "hand.stl"
        else:
            refused(REFUSED, allowed_path, link, [])
    for path in (source / "meshes" / "hand.stl", share / "meshes" / ".." / "meshes" / "hand.stl"):
        refused(REFUSED, allowed_path, path, [])
    (source / "package.xml").unlink()
    os.mkfifo(source / "package.xml")
    refused(REFUSED, allowed_path, link, [])


def test_without_ros_only_chosen_folders_are_allowed(
    chosen: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    assert allowed_path(chosen / "a.stl", [chosen]) == chosen / "a.stl"
    refused(REFUSED, allowed_path, Path("/usr/share/a.stl"), [chosen])


def test_a_file_of_points_only_is_a_mesh_without_faces(tmp_path: Path) -> None:
    file = tmp_path / "points.ply"
    trimesh.PointCloud(CORNER_SIGNS).export(file)
    mesh = Mesh.from_file(str(file))
    assert mesh.faces.shape == (0, 3)
    assert mesh.local_box[2] == pytest.approx([1.0, 1.0, 1.0])


def test_the_unit_of_a_dae_file_counts(tmp_path: Path) -> None:
    file = tmp_path / "box.dae"
    trimesh.creation.box((1.0, 2.0, 3.0)).export(file)
    text = file.read_text()
    assert "<unit" not in text
    file.write_text(text.replace("</created>", '</created><unit name="cm" meter="0.01"/>'))
    mesh = Mesh.from_file(file)
    assert np.sort(mesh.local_box[2]) == pytest.approx([0.005, 0.01, 0.015])


def test_files_that_cannot_be_read_are_refused_by_name(tmp_path: Path) -> None:
    refused(r"nowhere\.stl: the file does not exist", Mesh.from_file, tmp_path / "nowhere.stl")
    for name, content in (("bad.obj", b""), ("bad.stl", b"not a mesh"), ("bad.glb", b"glTF")):
        (tmp_path / name).write_bytes(content)
        refused(rf"mesh file .*{name}: ", Mesh.from_file, tmp_path / name)
    (tmp_path / "mesh.xyzzy").write_bytes(b"0 0 0")
    refused("it can't be read", Mesh.from_file, tmp_path / "mesh.xyzzy")
    (tmp_path / "nan.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    refused(r"nan\.obj: vertices must be finite", Mesh.from_file, tmp_path / "nan.obj")
    refused("only paths, file:// and package://", Mesh.from_file, "http://localhost/mesh.stl")


def test_package_uris_are_looked_up(share: Path) -> None:
    trimesh.creation.box((1.0, 1.0, 1.0)).export(share / "meshes" / "a box.stl")
    mesh = Mesh.from_file("package://arm/meshes/a%20box.stl")
    assert mesh.local_box[2] == pytest.approx([0.5, 0.5, 0.5])
    refused("package 'other' not found", Mesh.from_file, "package://other/meshes/box.stl")


def test_package_uris_without_ros_say_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without_ros(name: str, *args: object, **kwargs: object) -> object:
        if name.startswith("ament_index_python"):
            raise ImportError(name)
        return real(name, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without_ros)
    refused("needs ament_index_python", Mesh.from_file, "package://my_robot/meshes/box.stl")
