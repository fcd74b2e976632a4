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

from fractions import Fraction
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
SCALE = st.tuples(*3 * [st.one_of(st.just(1.0), SIZE)])
CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def assert_contains(shape: shapes.Hull | shapes.Mesh, points: Floats) -> None:
    assert_proper(shape.local_box)
    scaled = moved(map(exact, points), np.zeros(3), np.diag(shape.scale))
    assert all(gap <= 0 for gap in outside(shape.local_box, scaled))


@given(SIZE, SIZE, SCALE)
def test_primitives_have_the_box_of_their_formula_rounded_up_by_less_than_one_double(
    radius: float, length: float, scale: tuple[float, float, float]
) -> None:
    r, h = Fraction(radius), Fraction(length) / 2
    sx, sy, sz = exact(scale)
    for shape, wanted in (
        (shapes.Box((radius, radius, length), scale), (r / 2 * sx, r / 2 * sy, h * sz)),
        (shapes.Sphere(radius, scale), (r * sx, r * sy, r * sz)),
        (shapes.Cylinder(radius, length, scale), (r * sx, r * sy, h * sz)),
        (shapes.Capsule(radius, length, scale), (r * sx, r * sy, (h + r) * sz)),
        (shapes.Cone(radius, length, scale), (r * sx, r * sy, h * sz)),
        (shapes.Ellipsoid((radius, radius, length), scale), (r * sx, r * sy, 2 * h * sz)),
    ):
        center, rotation, extents = shape.local_box
        assert center.tolist() == [0.0, 0.0, 0.0]
        assert (rotation == np.eye(3)).all()
        for half, needed in zip(extents.tolist(), wanted, strict=True):
            assert Fraction(np.nextafter(half, 0.0)) < needed <= Fraction(half)
    assert shapes.Box((length, 0.0, 2.0)).local_box[2].tolist() == [length / 2, 0.0, 1.0]


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


def test_a_box_takes_its_size_or_its_half_extents() -> None:
    assert shapes.Box(half_extents=(1, 0, 0.5), scale=(1, 2, 3)) == shapes.Box((2, 0, 1), (1, 2, 3))
    for options, got in (({}, "neither"), ({"size": (1, 1, 1), "half_extents": (1, 1, 1)}, "both")):
        with pytest.raises(TypeError, match=rf"size \(.*\) or half_extents, got {got}"):
            shapes.Box(**options)
    refused("half_extents must not be negative", shapes.Box, half_extents=(1, 1, -1))


@each("kind", [shapes.Cylinder, shapes.Cone, shapes.Capsule])
def test_an_unknown_argument_is_refused_in_the_name_of_the_shape(kind: Any) -> None:
    for options in ({"height": 1.0}, {}):
        with pytest.raises(TypeError, match=rf"^{kind.__name__}\.__init__\(\)"):
            kind(radius=1.0, **options)


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
    refused(
        "faces must index vertices 0 to 7 in row 1",
        shapes.Mesh,
        CUBE,
        [[0, 1, 2], [0, 1, 8]],
    )
    refused("faces must index vertices", shapes.Mesh, CUBE, [[0, 1, -1]])
    for bad in (np.array([[0.0, 1.0, 2.0]]), np.array([[0, 1]]), np.array([0, 1, 2])):
        refused("faces must be integers of shape", shapes.Mesh, CUBE, bad)
    refused("fit must be one of", shapes.Hull, CUBE, fit="tightest")
    with pytest.raises(ValueError, match="points times scale must not exceed"):
        _ = shapes.Hull(CUBE * 1e200, (1e105, 1.0, 1.0)).local_box
