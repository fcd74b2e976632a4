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

"""Shapes and their local boxes: tight, containing, fitted once; bad ones refused by name."""

import builtins
import importlib.util
import sys
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import trimesh
from each import each
from exact_bodies import assert_proper, outside
from exact_vectors import exact, moved
from hypothesis import given
from hypothesis import strategies as st
from support import refused

from obb_collision import shapes
from obb_collision.geometry.shapes import meshes
from obb_collision.typing import Floats

SIZE = st.floats(1e-3, 1e3)
SCALE = st.tuples(SIZE, SIZE, SIZE)
CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def assert_contains(shape: shapes.Hull | shapes.Mesh, points: Floats) -> None:
    assert_proper(shape.local_box)
    scaled = moved(map(exact, points), np.zeros(3), np.diag(shape.scale))
    assert all(gap <= 0 for gap in outside(shape.local_box, scaled))


@each(
    "shape, expected",
    [
        (shapes.Box((1.0, 2.0, 3.0)), (0.5, 1.0, 1.5)),
        (shapes.Box((1.0, 0.0, 3.0)), (0.5, 0.0, 1.5)),
        (shapes.Box((1.0, 2.0, 3.0), scale=(2.0, 3.0, 4.0)), (1.0, 3.0, 6.0)),
        (shapes.Sphere(0.5), (0.5, 0.5, 0.5)),
        (shapes.Sphere(0.5, scale=(1.0, 2.0, 4.0)), (0.5, 1.0, 2.0)),
        (shapes.Cylinder(0.5, 3.0), (0.5, 0.5, 1.5)),
        (shapes.Cylinder(0.5, 3.0, scale=(2.0, 1.0, 2.0)), (1.0, 0.5, 3.0)),
        (shapes.Capsule(0.5, 3.0), (0.5, 0.5, 2.0)),
        (shapes.Capsule(0.5, 3.0, scale=(1.0, 1.0, 2.0)), (0.5, 0.5, 4.0)),
        (shapes.Cone(0.5, 3.0), (0.5, 0.5, 1.5)),
        (shapes.Ellipsoid((1.0, 2.0, 3.0), scale=(1.0, 1.0, 0.5)), (1.0, 2.0, 1.5)),
    ],
)
def test_primitives_have_the_box_of_their_formula(
    shape: shapes.Shape, expected: tuple[float, ...]
) -> None:
    center, rotation, half = shape.local_box
    assert center.tolist() == [0.0, 0.0, 0.0]
    assert (rotation == np.eye(3)).all()
    assert half.tolist() == list(expected)


@given(SIZE, SIZE, SCALE)
def test_half_extents_round_up_by_less_than_one_double(
    radius: float, length: float, scale: tuple[float, float, float]
) -> None:
    r, h = Fraction(radius), Fraction(length) / 2
    sx, sy, sz = exact(scale)
    for shape, wanted in (
        (shapes.Capsule(radius, length, scale), (r * sx, r * sy, (h + r) * sz)),
        (shapes.Cone(radius, length, scale), (r * sx, r * sy, h * sz)),
        (shapes.Box((radius, radius, length), scale), (r / 2 * sx, r / 2 * sy, h * sz)),
        (shapes.Ellipsoid((radius, radius, length), scale), (r * sx, r * sy, 2 * h * sz)),
    ):
        for half, needed in zip(shape.local_box[2].tolist(), wanted, strict=True):
            assert Fraction(np.nextafter(half, 0.0)) < needed <= Fraction(half)


SHAPES: list[tuple[Any, ...]] = [
    (shapes.Box, (1, 1, 1)), (shapes.Sphere, 1), (shapes.Cylinder, 1, 1), (shapes.Capsule, 1, 1),
    (shapes.Cone, 1, 1), (shapes.Ellipsoid, (1, 1, 1)), (shapes.Hull, CUBE),
    (shapes.Mesh, CUBE, []),
]  # fmt: skip


@each("shape", SHAPES)
def test_bad_scales_are_refused(shape: tuple[Any, ...]) -> None:
    for bad in ((0.0, 1.0, 1.0), (1.0, -1.0, 1.0)):
        refused("scale must be positive", *shape, scale=bad)
    refused(r"scale must have shape \(3,\)", *shape, scale=(1.0, 1.0))


def test_bad_sizes_are_refused_by_name() -> None:
    for bad, why in ((0.0, "positive"), (-1.0, "positive"), (np.inf, "finite")):
        for name, make, *sizes in (
            ("radius", shapes.Sphere, bad), ("radius", shapes.Cylinder, bad, 1.0),
            ("length", shapes.Cylinder, 1.0, bad), ("length", shapes.Capsule, 1.0, bad),
            ("radius", shapes.Cone, bad, 1.0), ("radii", shapes.Ellipsoid, (bad, 1.0, 1.0)),
        ):  # fmt: skip
            refused(f"{name} must be {why}", make, *sizes)
    for bad, why in ((-1.0, "not be negative"), (np.inf, "be finite")):
        refused(f"size must {why}", shapes.Box, (1.0, bad, 1.0))
    with pytest.raises(ValueError, match="must not exceed"):
        _ = shapes.Sphere(1e200, (1e200, 1.0, 1.0)).local_box


def test_shapes_are_values() -> None:
    assert shapes.Cylinder(1.0, 2.0) == shapes.Cylinder(1, 2, np.ones(3))
    cone: shapes.Shape = shapes.Cone(1.0, 2.0)
    assert cone != shapes.Cylinder(1.0, 2.0)
    assert len({shapes.Sphere(1.0), shapes.Sphere(1.0), shapes.Sphere(2.0)}) == 2
    with pytest.raises(AttributeError):
        shapes.Sphere(1.0).radius = 2.0  # type: ignore[misc]


def test_hulls_and_meshes_are_values() -> None:
    points, faces = np.eye(3), [[0, 1, 2]]
    equal = [shapes.Mesh(points, faces), shapes.Mesh(points * -0.0 + points, np.array(faces))]
    other = [
        shapes.Mesh(points, [[0, 2, 1]]), shapes.Mesh(points, faces, scale=(1, 2, 1)),
        shapes.Mesh(points, faces, fit="aabb"), shapes.Mesh(2 * points, faces),
        shapes.Hull(points), shapes.Hull(np.eye(3)[:2]), shapes.Hull(points, fit="aabb"),
    ]  # fmt: skip
    assert equal[0] == equal[1]
    assert hash(equal[0]) == hash(equal[1])
    assert shapes.Hull(points) == shapes.Hull(points.tolist())
    assert len({*equal, *other}) == 1 + len(other)
    assert shapes.Hull(points) != points.tolist()


def test_the_local_box_is_fitted_once_and_read_only(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def counted(points: Floats, fit: str) -> tuple[Floats, Floats, Floats]:
        calls.append(fit)
        return np.zeros(3), np.eye(3), np.ones(3)

    monkeypatch.setattr(meshes, "fit_points", counted)
    hull = shapes.Hull(CUBE, fit="covariance")
    assert not calls
    assert hull.local_box is hull.local_box
    assert calls == ["covariance"]
    with pytest.raises(ValueError, match="read-only"):
        hull.local_box[0][0] = 1.0


@given(st.integers(0, 2**32 - 1), SCALE, st.sampled_from(["aabb", "covariance", "best"]))
def test_scaled_hulls_contain_the_exactly_scaled_points(
    seed: int, scale: tuple[float, float, float], fit: str
) -> None:
    points = np.random.default_rng(seed).normal(size=(6, 3))
    assert_contains(shapes.Hull(points, scale, fit), points)


def test_tiny_scaled_hulls_contain_what_underflow_loses() -> None:
    points = np.array([[1e-160, 3e-170, 0.0], [0.0, 1e-165, 5e-163]])
    assert_contains(shapes.Hull(points, (1e-155, 1e-155, 3e-162)), points)


def test_flat_hulls_stay_flat_where_scaling_is_exact() -> None:
    square = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]])
    center, _, half = shapes.Hull(square, (3.0, 0.75, 7.0)).local_box
    assert half.tolist() == [1.5, 0.375, 0.0]
    assert center.tolist() == [1.5, 0.375, 7.0]


def test_a_mesh_is_boxed_by_its_triangles() -> None:
    vertices = np.vstack([CUBE, [[100.0, 0.0, 0.0]]])
    faces = trimesh.convex.convex_hull(CUBE).faces
    assert shapes.Mesh(CUBE, faces).local_box[2] == pytest.approx([1.0, 1.0, 1.0])
    assert shapes.Mesh(vertices, [[0, 1, 2], [5, 6, 7]]).local_box[0] == pytest.approx(np.zeros(3))
    assert shapes.Mesh(vertices, []).local_box[2][0] > 50.0


def test_a_mesh_of_trimesh_is_a_mesh() -> None:
    given_mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    mesh = shapes.Mesh(given_mesh, scale=(2.0, 1.0, 1.0))
    assert (mesh.vertices == given_mesh.vertices).all()
    assert (mesh.faces == given_mesh.faces).all()
    assert sorted(mesh.local_box[2].tolist()) == [1.0, 1.0, 1.5]
    with pytest.raises(TypeError, match=r"^faces must be given"):
        shapes.Mesh(given_mesh.vertices)
    refused(r"^vertices must be", shapes.Mesh, given_mesh, given_mesh.faces)


def test_bad_meshes_and_hulls_are_refused_by_name() -> None:
    refused("vertices must not be empty", shapes.Mesh, np.empty((0, 3)), [])
    refused("points must not be empty", shapes.Hull, np.empty((0, 3)))
    refused("faces must name vertices 0 to 7 in row 1", shapes.Mesh, CUBE, [[0, 1, 2], [0, 1, 8]])
    refused("faces must name vertices", shapes.Mesh, CUBE, [[0, 1, -1]])
    for bad in (np.array([[0.0, 1.0, 2.0]]), np.array([[0, 1]]), np.array([0, 1, 2])):
        refused("faces must be integers of shape", shapes.Mesh, CUBE, bad)
    refused("fit must be one of", shapes.Hull, CUBE, fit="tightest")
    with pytest.raises(ValueError, match="points times scale must not exceed"):
        _ = shapes.Hull(CUBE * 1e200, (1e105, 1.0, 1.0)).local_box


def test_a_file_of_points_only_is_a_mesh_without_faces(tmp_path: Path) -> None:
    file = tmp_path / "points.ply"
    trimesh.PointCloud(CUBE).export(file)
    mesh = shapes.Mesh.from_file(str(file))
    assert mesh.faces.shape == (0, 3)
    assert mesh.local_box[2] == pytest.approx([1.0, 1.0, 1.0])


def test_the_unit_of_a_dae_file_counts(tmp_path: Path) -> None:
    file = tmp_path / "box.dae"
    trimesh.creation.box((1.0, 2.0, 3.0)).export(file)
    text = file.read_text()
    assert "<unit" not in text
    file.write_text(text.replace("</created>", '</created><unit name="cm" meter="0.01"/>'))
    mesh = shapes.Mesh.from_file(file)
    assert np.sort(mesh.local_box[2]) == pytest.approx([0.005, 0.01, 0.015])


def test_files_that_cannot_be_read_are_refused_by_name(tmp_path: Path) -> None:
    refused(r"nowhere\.stl: there is no such file", shapes.Mesh.from_file, tmp_path / "nowhere.stl")
    for name, content in (("bad.obj", b""), ("bad.stl", b"not a mesh"), ("bad.glb", b"glTF")):
        (tmp_path / name).write_bytes(content)
        refused(rf"mesh file .*{name}: ", shapes.Mesh.from_file, tmp_path / name)
    (tmp_path / "mesh.xyzzy").write_bytes(b"0 0 0")
    refused("it can't be read", shapes.Mesh.from_file, tmp_path / "mesh.xyzzy")
    (tmp_path / "nan.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    refused(r"nan\.obj: vertices must be finite", shapes.Mesh.from_file, tmp_path / "nan.obj")
    refused(
        "only paths, file:// and package://", shapes.Mesh.from_file, "http://localhost/mesh.stl"
    )


def test_dae_without_pycollada_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "box.dae"
    file.write_text("<COLLADA/>")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    refused("pycollada", shapes.Mesh.from_file, file)


def test_package_uris_are_looked_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def share(package: str) -> str:
        if package != "my_robot":
            raise LookupError(f"package '{package}' not found")
        return str(tmp_path)

    index = ModuleType("ament_index_python.packages")
    index.get_package_share_directory = share  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "ament_index_python", ModuleType("ament_index_python"))
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", index)
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((1.0, 1.0, 1.0)).export(tmp_path / "meshes" / "a box.stl")
    mesh = shapes.Mesh.from_file("package://my_robot/meshes/a%20box.stl")
    assert mesh.local_box[2] == pytest.approx([0.5, 0.5, 0.5])
    refused("package 'other' not found", shapes.Mesh.from_file, "package://other/meshes/box.stl")


def test_package_uris_without_ros_say_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without_ros(name: str, *args: object, **kwargs: object) -> object:
        if name.startswith("ament_index_python"):
            raise ImportError(name)
        return real(name, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without_ros)
    refused("needs ament_index_python", shapes.Mesh.from_file, "package://my_robot/meshes/box.stl")
