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

"""Meshes of hulls and shapes, their trees, and trees over bounds: containment, size, limits."""

from __future__ import annotations

import math
import time
from itertools import product

import numpy as np
import pytest
from convex_bodies import round_bodies, some
from each import each
from exact_bodies import exact_reach, holds, least_depth
from exact_vectors import exact
from hull_distances import squared_distance
from mesh_zoo import TRIANGLE, ZOO, standing
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from support import refused
from sweep_motions import directions
from trimesh import Trimesh, creation

from obb_collision import MeshTrees
from obb_collision.geometry.trees import (
    HullPool,
    Hulls,
    TreePool,
    bounds_tree,
    box_tree,
    hull_tree,
    mesh_tree,
)
from obb_collision.geometry.trees.convex_proxy import (
    HULL_MARGIN,
    MAX_HULL_CORNERS,
    box_corners,
    hull_mesh,
)
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES, LEAF
from obb_collision.shapes import Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere
from obb_collision.typing import Floats, Rows


@each(
    "kind, sizes, shape, volume",
    [
        ("ellipsoid", [0.5, 0.5, 0.5, 0.0], Sphere(0.5), np.pi / 6.0),
        ("ellipsoid", [0.5, 1.0, 1.5, 0.0], Sphere(0.5, scale=[1.0, 2.0, 3.0]), np.pi),
        ("ellipsoid", [0.01, 0.5, 30.0, 0.0], Ellipsoid([0.01, 0.5, 30.0]), np.pi * 0.2),
        ("cylinder", [0.3, 0.3, 0.0, 1.0], Cylinder(0.3, 2.0), np.pi * 0.18),
        ("cone", [0.3, 0.3, 0.0, 1.0], Cone(0.3, 1.0, scale=[1.0, 1.0, 2.0]), np.pi * 0.06),
        ("capsule", [0.0, 0.0, 0.0, 0.5], Capsule(0.2, 1.0), np.pi * (0.04 + 0.032 / 3.0)),
    ],
)
def test_round_shapes_are_held_closely(
    kind: str, sizes: list[float], shape: Shape, volume: float
) -> None:
    """No body reaches any plane of its hull."""
    mesh = Trimesh(*hull_mesh(shape), process=False)
    normals = mesh.face_normals
    body = round_bodies(kind, standing(hull_tree(shape)), 0.2 * (kind == "capsule"), sizes)
    rows = np.zeros(len(normals), np.int64)
    reaches = exact_reach(some(body, rows), normals.astype(np.longdouble))
    assert (reaches < np.einsum("ij,ij->i", normals, mesh.triangles[:, 0])).all()
    assert mesh.is_watertight
    assert volume < mesh.volume < 1.08 * volume


def many_points() -> dict[str, tuple[Floats, float]]:
    """Return points whose hull has many corners or takes long, and how much larger ours may be."""
    rng = np.random.default_rng(3)
    ball = np.array(creation.icosphere(subdivisions=4).vertices)
    turn = Rotation.random(None, rng).as_matrix()
    angles = np.linspace(0.0, 2.0 * np.pi, 700)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cylinder = np.concatenate([np.c_[ring, np.full(700, z)] for z in (-1.0, 1.0)])
    box = rng.uniform(-1.0, 1.0, (5000, 3))
    box[np.arange(5000), rng.integers(0, 3, 5000)] = rng.choice([-1.0, 1.0], 5000)
    return {
        "ball": (ball, 1.01),
        "long ball": (ball * [1.0, 1.0, 40.0], 1.015),
        "many on a ball": (directions(rng, 3000), 1.01),
        "cylinder": (cylinder @ turn, 1.0002),
        "box": (box @ turn, 1.0001),
        "gauss": (rng.normal(size=(5000, 3)), 1.0 + 1e-8),
    }


def test_hulls_of_up_to_a_thousand_corners_are_exact() -> None:
    # However many other points there are.
    rng = np.random.default_rng(8)
    corners = directions(rng, 900) * [0.5, 0.3, 0.01]
    shares = rng.dirichlet(np.ones(3), 30_000)
    inside = 0.999 * np.einsum("ij,ijk->ik", shares, corners[rng.integers(0, 900, (30_000, 3))])
    ours, faces = hull_mesh(Hull(np.concatenate([inside, corners])))
    assert len(ours) == 900
    assert least_depth(ours[faces], corners) > 0.0
    assert np.abs(corners[np.lexsort(corners.T)] - ours[np.lexsort(ours.T)]).max() < 1e-8


def test_simpler_hulls_have_no_corner_far_from_the_points() -> None:
    # Needles and spikes among them, whose tips planes that are almost parallel would move far.
    rng = np.random.default_rng(9)
    ball, spikes = directions(rng, 2000), 1.2 * directions(rng, 8)
    spiked = np.concatenate([ball, spikes])
    for name, points, limit, size in (
        ("ball", ball, 0.0115, 1.0),
        ("needle", ball * [1.0, 0.01, 0.01], 0.001, 1.0),
        ("disc", ball * [1.0, 1.0, 0.004], 0.003, 1.0),
        *((f"spiked, {size} m", spiked, 0.0115, size) for size in (1e-150, 1.0, 1e150)),
        ("far away", ball + np.array([3e4, 0.0, 0.0]), 0.0115, 1.0),
    ):
        corners, faces = hull_mesh(Hull(points * size))
        assert 900 < len(corners) <= MAX_HULL_CORNERS, name
        assert least_depth(corners[faces] / size, points) > 0.0, name
        hull, some_corners = list(map(exact, points)), map(exact, corners[::250] / size)
        apart = max(squared_distance([corner], hull) for corner in some_corners)
        assert math.sqrt(apart) < limit, name


@each("fit", ["best", "aabb"])
@each("corners", [1, 2, 3, 12])
def test_flat_hulls_hold_their_points_by_fractions_and_little_more(corners: int, fit: str) -> None:
    # Polygons, lines and single points, turned: flat up to rounding.
    rng = np.random.default_rng(corners)
    angles = 2.0 * np.pi * np.arange(corners) / corners
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(corners)], axis=1)
    for size, offset, thickness in product((1e-100, 1e100), (0.0, 1e3), (0.0, 1e-13, 1e-9)):
        raised = ring + thickness * rng.uniform(-1.0, 1.0, ring.shape)
        turned = raised @ Rotation.random(None, rng).as_matrix()
        points = (turned + offset * rng.uniform(-1.0, 1.0, 3)) * size
        ours, faces = hull_mesh(Hull(points, fit=fit))
        assert Trimesh(ours / size, faces, process=False).is_watertight
        inner, outer = list(map(exact, points)), list(map(exact, ours))
        assert all(squared_distance([point], outer) == 0 for point in inner)
        if not offset:
            assert corners == 12 or len(faces) <= 12
            assert least_depth(ours[faces], points) > 0.99 * HULL_MARGIN * np.abs(points).max()
        apart = math.sqrt(max(squared_distance([corner], inner) for corner in outer[::5]))
        assert apart <= 8.0 * HULL_MARGIN * np.abs(points).max()


def test_hulls_of_many_points_are_simple_and_hold_them() -> None:
    for name, (points, loose) in many_points().items():
        corners, faces = hull_mesh(Hull(points))
        assert len(corners) <= MAX_HULL_CORNERS, name
        assert least_depth(corners[faces], points) > 0.0, name
        volume, least = Trimesh(corners, faces, process=False).volume, ConvexHull(points).volume
        assert least < volume < loose * least, name


def test_pools_hold_what_joining_gives() -> None:
    names = ["torus1", "crumbs0", "sheet0", "box1", "moebius"]
    trees = [MeshTrees.build(*ZOO[name]) for name in names]
    corners = [hull_mesh(Mesh(*ZOO[name]))[0] for name in names]
    pool, hulls = TreePool(), HullPool()
    lent = []
    for row, tree in enumerate(trees):
        assert pool.append(tree) == row
        lent.append(pool.all)
        assert hulls.append(Hulls.of(corners[row])) == row
    for count, part in enumerate(lent, start=1):
        joined = MeshTrees.join(trees[:count])
        for ours, theirs in zip(part.arrays, joined.arrays, strict=True):
            assert ours.dtype == theirs.dtype
            assert (ours == theirs).all()
    assert all(joined.boxes(row, 2) == tree.boxes(0, 2) for row, tree in enumerate(trees))
    for row, own in enumerate(corners):
        first, last = hulls.all.starts[row : row + 2]
        stored = hulls.all.blocks[first:last].transpose(0, 2, 1).reshape(-1, 3)
        assert (stored[: len(own)] == own).all()
        assert (stored[len(own) :] == own[-1]).all()
    assert hulls.size == len(hulls.all.blocks)


def test_trees_are_scaled_and_begin_with_the_box_of_the_mesh() -> None:
    for name in ("torus1", "star2", "triangle"):
        mesh = Mesh(*ZOO[name], scale=[1.0, 0.5, 2.0])
        box = mesh_tree(mesh).boxes(0, 0).arrays
        for ours, theirs in zip(box, mesh.local_box, strict=True):
            assert (ours[0] == theirs).all()
    assert hull_tree(Sphere(1.0)).solid[0]
    vertices, faces = ZOO["torus1"]
    tree = mesh_tree(Mesh(vertices, faces, scale=[1.0, 2.0, 3.0]))
    assert np.abs(tree.triangles).max() == np.abs(vertices * [1.0, 2.0, 3.0]).max()
    half_extents = np.array([1.0, 0.0, 2.0])
    assert np.abs(box_tree(half_extents).triangles).max() == 2.0
    assert np.abs(box_corners(half_extents)).max() - 2.0 == 2.0 * HULL_MARGIN
    refused("faces must not be empty", mesh_tree, Mesh(vertices, []))


@each("size", [1e-150, 1.0, 1e150])
def test_hulls_hold_their_meshes_with_a_margin_and_no_more(size: float) -> None:
    for name, (vertices, faces) in ZOO.items():
        mesh = Mesh(vertices * size, faces, scale=[0.5, 1.0, 2.0])
        points = mesh.vertices[np.unique(faces)] * [0.5, 1.0, 2.0]
        tree = hull_tree(mesh)
        assert tree.solid[0], name
        assert tree.winding[0], name
        reach, depth = np.abs(points).max(), least_depth(tree.triangles.reshape(-1, 3, 3), points)
        assert depth > 0.99 * HULL_MARGIN * reach, name
        loose = 1.03 if len(np.unique(points, axis=0)) > MAX_HULL_CORNERS else 1.0 + 1e-8
        assert np.abs(tree.triangles).max() < loose * reach, name


def test_repeated_corners_and_corners_amid_edges_still_get_a_hull() -> None:
    # As files of single triangles have them; flat faces with fine rims give Qhull's facets of
    # no area, above all where it joggles: from a thousand corners on.
    rng = np.random.default_rng(2)
    wedge = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.7], [1, 0, 0.7], [0, 1, 0.7]])
    edges = np.array([[0, 1], [1, 2], [2, 0], [3, 4], [4, 5], [5, 3], [0, 3], [1, 4], [2, 5]])
    shares = rng.random((9, 300, 1))
    rims = wedge[edges[:, :1]] * shares + wedge[edges[:, 1:]] * (1.0 - shares)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for points in (np.repeat(rims.reshape(-1, 3), 3, axis=0) @ turn, ZOO["bumpy2"][0].repeat(6, 0)):
        points = points.astype(np.float32).astype(np.float64)
        corners = hull_tree(Hull(points)).triangles.reshape(-1, 3, 3)
        assert least_depth(corners, points) > 0.99 * HULL_MARGIN * np.abs(points).max()
        volume = np.linalg.det(corners - corners.mean(axis=(0, 1))).sum() / 6.0
        assert volume == pytest.approx(ConvexHull(np.unique(points, axis=0)).volume, rel=1e-3)


@each(
    "name, place",
    [
        *product(["box1", "crumbs1", "hull2"], [(1.0, 0.0)]),
        *product(["torus0", "triangle"], [(1.0, 1e9), (1e-160, 0.0), (1e155, 3.0)]),
    ],
)
def test_every_box_contains_its_triangles_exactly(name: str, place: tuple[float, float]) -> None:
    (vertices, faces), (scale, offset) = ZOO[name], place
    tree = MeshTrees.build(vertices * scale + offset * scale, faces)
    for node, (first, last) in enumerate(tree.starts):
        row = tree.nodes[node]
        corners = tree.triangles[first:last].reshape(-1, 3)
        rotation = row[3:12].reshape(3, 3)
        assert holds((row[:3], rotation, row[12:15]), np.unique(corners, axis=0))
        assert np.abs(rotation.T @ rotation - np.eye(3)).max() < 2.0**-49


@each("name", list(ZOO))
def test_each_triangle_is_in_one_leaf(name: str) -> None:
    vertices, faces = ZOO[name]
    tree = MeshTrees.build(vertices, faces)
    assert sorted(tree.faces.tolist()) == list(range(len(faces)))
    assert (tree.triangles == vertices[faces[tree.faces]].reshape(-1, 9)).all()
    leaves = np.flatnonzero(tree.children < 0)
    runs = tree.starts[leaves]
    assert (runs[:, 1] - runs[:, 0] <= LEAF).all()
    assert sorted(np.concatenate([np.arange(*run) for run in runs])) == list(range(len(faces)))
    inner = np.flatnonzero(tree.children >= 0)
    left, right = tree.children[inner], tree.children[inner] + 1
    assert (tree.starts[left, 0] == tree.starts[inner, 0]).all()
    assert (tree.starts[left, 1] == tree.starts[right, 0]).all()
    assert (tree.starts[right, 1] == tree.starts[inner, 1]).all()


def test_a_depth_gives_at_most_two_to_its_power_boxes_that_get_tighter() -> None:
    tree = MeshTrees.build(*ZOO["torus1"])
    volumes = []
    for depth in range(8):
        boxes = tree.boxes(0, depth)
        assert len(boxes) <= 2**depth
        volumes.append(float(np.prod(2.0 * boxes.half_extents, axis=1).sum()))
    assert len(tree.boxes(0, 3)) == 8
    assert volumes[7] < 0.5 * volumes[0]


def test_box_trees_are_closed_boxes() -> None:
    trees = MeshTrees.from_half_extents([[0.5, 0.25, 0.125], [0.0, 1.0, 1.0]])
    assert len(trees) == 2
    assert trees.solid[0]
    p, q, r = BOX_CORNERS[BOX_FACES].transpose(1, 0, 2)
    assert (np.einsum("ij,ij->i", np.cross(q - p, r - p), p) > 0.0).all()


def test_a_hundred_thousand_triangles_take_seconds() -> None:
    """Measured 0.6 s; a quadratic build would take minutes."""
    mesh = creation.uv_sphere(count=[256, 256])
    faces = np.asarray(mesh.faces)[:100_000]
    assert len(faces) == 100_000
    MeshTrees.build(np.eye(3), TRIANGLE)
    start = time.process_time()
    tree = MeshTrees.build(mesh.vertices, faces)
    assert time.process_time() - start < 20.0
    assert tree.levels.max() < 40


FORMS = ("spread", "line", "outlier", "clusters", "one centre")
COUNTS = (1, 8, 9, 65, 700)


def bounds_of(form: str, count: int) -> tuple[Floats, Floats]:
    """Return bounds of a form, some of them empty."""
    rng = np.random.default_rng(count)
    scales = {"line": [1.0, 0.0, 0.0], "one centre": [0.0], "clusters": [1e-9]}
    middles = np.array(scales.get(form, [1.0])) * rng.uniform(-5.0, 5.0, (count, 3))
    middles[0] = 1e250 if form == "outlier" else middles[0]
    middles += rng.choice([-1e9, 1e9], (count, 1)) if form == "clusters" else 0.0
    half = rng.uniform(0.0, 1.0, (count, 3))
    minimum, maximum = middles - half, middles + half
    minimum[5::17], maximum[5::17] = np.inf, -np.inf
    return minimum, maximum


def ordered(minimum: Floats, maximum: Floats) -> Rows:
    order, spare = np.empty((2, len(minimum)), np.int64)
    bounds_tree.morton_order_shared(minimum, maximum, order, spare)
    return order


@each("form", FORMS)
@each("count", COUNTS)
def test_the_order_has_each_row_once_and_empty_bounds_last_by_any_number_of_threads(
    form: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    minimum, maximum = bounds_of(form, count)
    order = ordered(minimum, maximum)
    assert sorted(order.tolist()) == list(range(count))
    empty = np.asarray((minimum > maximum).any(axis=1))[order]
    assert empty.tolist() == sorted(empty.tolist())
    full = np.flatnonzero((minimum <= maximum).all(axis=1))
    alone = ordered(minimum[full], maximum[full])
    monkeypatch.setattr(bounds_tree, "is_dealt", lambda count: count > 1)
    np.testing.assert_array_equal(ordered(minimum[full], maximum[full]), alone)


def test_bounds_on_a_line_are_in_the_order_of_the_line_but_for_those_of_one_cell() -> None:
    places = np.random.default_rng(0).permutation(300)
    for axis in range(3):
        minimum = 1000.0 * places[:, None] * np.eye(3)[axis]
        order = ordered(minimum, minimum + 1.0)
        assert np.abs(places[order] - np.arange(300)).max() < bounds_tree.CELL


@each("form", FORMS)
@each("count", COUNTS)
def test_a_tree_finds_what_brute_force_does_also_after_bounds_have_moved(
    form: str, count: int
) -> None:
    minimum, maximum = bounds_of(form, count)
    tree, room = bounds_tree.BoundsTree.build(minimum, maximum), np.empty(count, np.int64)
    places = np.empty(count, np.int64)
    places[tree.order] = np.arange(count)
    for shift in (0.0, 3.0, -1.0):
        moved = np.arange(0, count, 3)
        minimum[moved], maximum[moved] = minimum[moved] + shift, maximum[moved] + shift
        bounds_tree.move_kernel(tree, places[moved])
        for row in range(0, count, 11):
            low, high = minimum[row], maximum[row]
            meet = ((minimum <= high) & (low <= maximum)).all(axis=1)
            for least in (0, count // 2):
                found = bounds_tree.overlapping(tree, tuple(low), tuple(high), least, room)
                expected = np.flatnonzero(meet & (np.arange(count) >= least))
                np.testing.assert_array_equal(np.sort(room[:found]), expected)
            assert bounds_tree.overlapping(tree, tuple(low), tuple(high), 0, room[:1]) == min(
                meet.sum(), 1
            )
