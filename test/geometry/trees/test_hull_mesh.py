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

"""Convex meshes about shapes: they hold them, closely, and stay small whatever the shape."""

from __future__ import annotations

import numpy as np
import pytest
from mesh_zoo import zoo
from numpy.typing import NDArray
from plane_depths import least_depth
from scipy.spatial.transform import Rotation
from support import row_of
from trimesh import Trimesh, creation

from obb_collision.geometry.fitting.convex_hull import hull_volume
from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.trees.circumscribed import geodesic_sphere, outer_points
from obb_collision.geometry.trees.convex_proxy import MAX_HULL_CORNERS, hull_mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.trees.pool import HullPool, Hulls, TreePool
from obb_collision.geometry.trees.shape_trees import hull_tree, mesh_tree
from obb_collision.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Shape,
    Sphere,
)
from obb_collision.typing import Floats

ZOO = zoo()


def surface(shape: Shape, count: int) -> Floats:
    """Return points on a shape with round faces, before scaling."""
    rng = np.random.default_rng(count)
    units = rng.normal(size=(count, 3))
    units /= np.linalg.norm(units, axis=1)[:, None]
    if isinstance(shape, Sphere):
        return shape.radius * units
    if isinstance(shape, Ellipsoid):
        return np.array(shape.radii) * units
    assert isinstance(shape, (Capsule, Cylinder, Cone))
    half = 0.5 * shape.length
    if isinstance(shape, Capsule):
        heights = np.where(rng.random(count) < 0.5, half, -half)
        return shape.radius * units + np.array([0.0, 0.0, 1.0]) * heights[:, None]
    angles, heights = rng.uniform(0.0, 2.0 * np.pi, count), rng.choice([-half, half, 0.1], count)
    radii = np.full(count, shape.radius)
    if isinstance(shape, Cone):
        radii *= (half - heights) / shape.length
    return np.stack([radii * np.cos(angles), radii * np.sin(angles), heights], axis=1)


def excess(points: Floats, corners: Floats, faces: NDArray[np.int64]) -> float:
    """Return how far points stick out of a convex mesh with outward faces; negative: within."""
    return -least_depth(corners[faces], points)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Sphere(0.5), np.pi / 6.0),
        (Sphere(0.5, scale=[1.0, 2.0, 3.0]), np.pi),
        (Ellipsoid([0.01, 0.5, 30.0]), np.pi * 4.0 / 3.0 * 0.15),
        (Cylinder(0.3, 2.0), np.pi * 0.18),
        (Cone(0.3, 1.0, scale=[1.0, 1.0, 2.0]), np.pi * 0.06),
        (Capsule(0.2, 1.0), np.pi * (0.04 + 0.032 / 3.0)),
    ],
)
def test_round_shapes_are_held_closely(shape: Shape, volume: float) -> None:
    corners, faces = hull_mesh(shape)
    points = surface(shape, 5000) * np.array(shape.scale)
    assert excess(points, corners, faces) < 0.0
    mesh = Trimesh(corners, faces, process=False)
    assert mesh.is_watertight
    assert volume < mesh.volume < 1.08 * volume


def test_only_round_shapes_have_points_about_them() -> None:
    assert [len(geodesic_sphere(rounds)) for rounds in range(4)] == [12, 42, 162, 642]
    with pytest.raises(ValueError, match="Box"):
        outer_points(Box([1.0, 1.0, 1.0]))


def many_points() -> dict[str, tuple[Floats, float]]:
    """Return points whose hull has many corners or takes long, and how much larger ours may be."""
    rng = np.random.default_rng(3)
    ball = np.array(creation.icosphere(subdivisions=5).vertices)
    turn = Rotation.random(None, rng).as_matrix()
    angles = np.linspace(0.0, 2.0 * np.pi, 700)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cylinder = np.concatenate([np.c_[ring, np.full(700, z)] for z in (-1.0, 1.0)])
    box = rng.uniform(-1.0, 1.0, (30_000, 3))
    box[np.arange(30_000), rng.integers(0, 3, 30_000)] = rng.choice([-1.0, 1.0], 30_000)
    return {
        "ball": (ball, 1.03),
        "long ball": (ball * [1.0, 1.0, 40.0], 1.03),
        "cylinder": (cylinder @ turn, 1.03),
        "box": (box @ turn, 1.03),
        "gauss": (rng.normal(size=(30_000, 3)), 1.25),
    }


@pytest.mark.parametrize("name", many_points())
def test_hulls_of_many_points_are_simple_and_hold_them(name: str) -> None:
    points, loose = many_points()[name]
    corners, faces = hull_mesh(Hull(points))
    assert len(corners) <= MAX_HULL_CORNERS
    assert excess(points, corners, faces) < 0.0
    volume = float(Trimesh(corners, faces, process=False).volume)
    assert hull_volume(points) < volume < loose * hull_volume(points)


def test_pools_hold_what_joining_gives() -> None:
    names = ["torus1", "crumbs0", "sheet0", "box1", "moebius"]
    trees = [MeshTrees.build(*ZOO[name]) for name in names]
    pool, hulls = TreePool(), HullPool()
    lent = []
    for row, tree in enumerate(trees):
        assert pool.append(tree) == row
        lent.append(pool.all)
        corners = hull_mesh(Mesh(*ZOO[names[row]]))[0]
        assert hulls.append(Hulls.of(corners)) == row
    for count, part in enumerate(lent, start=1):
        joined = MeshTrees.join(trees[:count])
        for ours, theirs in zip(part.arrays, joined.arrays, strict=True):
            assert ours.dtype == theirs.dtype
            assert (ours == theirs).all()
    for row, name in enumerate(names):
        first, last = hulls.all.starts[row : row + 2]
        corners = hull_mesh(Mesh(*ZOO[name]))[0]
        stored = hulls.all.blocks[first:last].transpose(0, 2, 1).reshape(-1, 3)
        assert (stored[: len(corners)] == corners).all()
        assert (stored[len(corners) :] == corners[-1]).all()
    assert hulls.size == len(hulls.all.blocks)


def test_the_first_node_of_a_tree_is_the_box_of_the_mesh() -> None:
    for name in ("torus1", "star2", "triangle"):
        mesh = Mesh(*ZOO[name], scale=[1.0, 0.5, 2.0])
        box = mesh_tree(mesh).boxes(0, 0)
        for ours, theirs in zip(row_of(box, 0), mesh.local_box, strict=True):
            assert (ours == theirs).all()
    assert hull_tree(Sphere(1.0)).solid[0]
