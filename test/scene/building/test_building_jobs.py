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

"""Shapes built in another process: what comes back, and what is refused with which reason."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from builders import build
from each import each

from obb_collision.geometry.shapes.files import MeshFolders
from obb_collision.scene.building.builder import Builder
from obb_collision.scene.building.errors import BuildError
from obb_collision.scene.building.jobs import (
    BAD_POINTS,
    TOO_MANY_TRIANGLES,
    UNREADABLE,
    Bodies,
    Job,
    MeshFile,
    Triangles,
    body_corners,
)
from obb_collision.shapes import Hull, Mesh

ONE = np.ones(3)


@pytest.fixture(scope="module")
def builder() -> Iterator[Builder]:
    made = Builder()
    yield made
    made.close()


def test_what_is_built_is_what_would_be_built_here(builder: Builder, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(300, 3))
    scale = np.array((1.0, 2.0, 0.5))
    part = trimesh.creation.icosphere(2)
    file = tmp_path / "part.ply"
    part.export(file)
    faces = np.arange(300).reshape(-1, 3)
    cases: list[tuple[Job, Mesh | Hull]] = [
        (Triangles(points, scale), Mesh(points, faces, scale)),
        (Bodies(points, scale), Hull(body_corners(points, scale))),
        (MeshFile(str(file), scale), Mesh.from_file(file, scale)),
        (MeshFile("x.ply", scale, file.read_bytes()), Mesh.from_file(file, scale)),
    ]
    for job, expected in cases:
        built = build(builder, job)
        shape = built[0] if isinstance(built, tuple) else built
        assert type(shape) is type(expected)
        for got, wanted in zip(shape.local_box, expected.local_box, strict=True):
            np.testing.assert_array_equal(got, wanted)
        np.testing.assert_array_equal(
            shape._points() * np.array(shape.scale), expected._points() * np.array(expected.scale)
        )


def test_a_view_on_a_message_that_is_not_aligned_is_taken(builder: Builder) -> None:
    points = np.random.default_rng(1).normal(size=(9, 3))
    view = np.frombuffer(b"1234" + points.tobytes(), "<f8", 27, 4).reshape(-1, 3)
    assert not view.flags.aligned
    mesh = build(builder, Triangles(view, ONE))
    assert mesh.vertices.flags.aligned
    np.testing.assert_array_equal(mesh.vertices, points)


@each(
    "job, reason",
    [
        (Triangles(np.full((3, 3), np.nan), ONE), BAD_POINTS),
        (Bodies(np.full((3, 3), np.inf), ONE), BAD_POINTS),
        (Triangles(np.full((3, 3), 1e300), 10.0 * ONE), "bad shape"),
        (MeshFile("/no/such.stl", ONE), UNREADABLE),
        (MeshFile("file:///a%00b.stl", ONE), UNREADABLE),
        (MeshFile("x.stl", ONE, b"no mesh"), UNREADABLE),
        (MeshFile("x." + "a" * 300, ONE, b"no mesh"), UNREADABLE),
        (MeshFile("x.stl", ONE, b""), UNREADABLE),
    ],
)
def test_refusals_have_reasons(builder: Builder, job: Job, reason: str) -> None:
    with pytest.raises(BuildError) as caught:
        build(builder, job)
    assert caught.value.reason == reason
    assert len(str(caught.value)) < 1000


def test_a_file_that_has_not_changed_is_not_built_again(builder: Builder, tmp_path: Path) -> None:
    file = tmp_path / "part.stl"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(file)
    _, version = build(builder, MeshFile(str(file), ONE))
    assert build(builder, MeshFile(str(file), ONE, known=version)) is None
    trimesh.creation.box((3.0, 3.0, 3.0)).export(file)
    os.utime(file, ns=(0, version[0] + 1))
    changed, newer = build(builder, MeshFile(str(file), ONE, known=version))
    assert changed.local_box[2] == pytest.approx([1.5, 1.5, 1.5])
    assert newer != version
    with pytest.raises(BuildError, match="10 is the limit"):
        build(builder, MeshFile(str(file), ONE, largest=10))


def test_files_outside_the_allowed_folders_are_refused(builder: Builder, tmp_path: Path) -> None:
    for folder in ("allowed", "other"):
        (tmp_path / folder).mkdir()
        trimesh.creation.box().export(tmp_path / folder / "part.stl")
    folders = MeshFolders((str(tmp_path / "allowed"),))
    uri = (tmp_path / "allowed" / "part.stl").as_uri()
    mesh, _ = build(builder, MeshFile(uri, ONE, folders=folders))
    assert len(mesh.faces) == 12
    for name in ("file:///etc/passwd", uri.replace("allowed", "allowed/%2e%2e/other")):
        with pytest.raises(BuildError, match="is in no folder") as caught:
            build(builder, MeshFile(name, ONE, folders=folders))
        assert caught.value.reason == UNREADABLE
    with pytest.raises(BuildError, match="12 triangles, 11 is the limit") as caught:
        build(builder, MeshFile(uri, ONE, triangles=11, folders=folders))
    assert caught.value.reason == TOO_MANY_TRIANGLES
