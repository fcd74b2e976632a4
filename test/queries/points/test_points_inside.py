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

"""Points in boxes, meshes and shapes with a formula, by exact arithmetic, and each by itself."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from convex_bodies import KINDS, around, bodies, corners_of, moved, some
from each import each
from exact_bodies import beyond, inside
from exact_vectors import corners, exact, taxicab
from hull_distances import squared_distance
from hypothesis import given
from hypothesis import strategies as st
from mesh_zoo import (
    SHARE,
    TRIANGLES,
    Maker,
    bodies_of,
    exact_corners,
    place,
    placed_corners,
    standing,
    thrown,
    trees_of,
    windings,
    zoo,
)
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from support import by_threads, family, refused, row_of

from obb_collision import OBB, Boxes, MeshTrees, PlacedMeshes, points_inside
from obb_collision.queries.convex.support import HULL_CORE, SEGMENT_CORE, ConvexBodies
from obb_collision.queries.points import CHUNK, PointsInside, contains, points_in_bodies
from obb_collision.typing import Floats, Mask
from tools.cases.families import FAMILIES

#: A point this near to the surface, relative to the size, may count as inside by default.
SURFACE_DOUBT = 1e-14


def near(boxes: Boxes, rng: np.random.Generator, each: int) -> np.ndarray:
    """Points in, on and just off the surface of each box, shuffled."""
    n = len(boxes)
    places = rng.uniform(-1.2, 1.2, (n, each, 3))
    faces = rng.random((n, each, 3)) < 0.4
    off = rng.choice([-1.0, 0.0, 1.0], faces.sum()) * 10.0 ** rng.uniform(-16.0, -1.0, faces.sum())
    places[faces] = rng.choice([-1.0, 1.0], faces.sum()) * (1.0 + off)
    offsets = np.einsum("nij,nkj->nki", boxes.rotations, places * boxes.half_extents[:, None])
    points = (boxes.centers[:, None] + offsets).reshape(-1, 3)
    return np.asarray(rng.permutation(points))


@each("name", FAMILIES)
def test_points_near_the_surface(name: str) -> None:
    rng = np.random.default_rng(5)
    a, _ = family(name, 10)
    for row in range(len(a)):
        obb = OBB(*row_of(a, row))
        points = near(a[row : row + 1], rng, 40)
        truth = inside(row_of(a, row), points)
        np.testing.assert_array_equal(obb.contains(points, exact=True), truth)
        default = np.asarray(obb.contains(points))
        assert default[truth].all(), "a point of the box may never be called outside"
        half = obb.half_extents + SURFACE_DOUBT * obb.half_extents.sum()
        assert inside((obb.center, obb.rotation, half), points[default]).all()


@given(st.sampled_from(sorted(FAMILIES)), st.integers(0, 49), st.integers(0, 2**32 - 1))
def test_one_point_is_answered_as_in_a_cloud(name: str, row: int, seed: int) -> None:
    a, _ = family(name, 50)
    obb = OBB(*row_of(a, row))
    points = near(a[row : row + 1], np.random.default_rng(seed), 8)
    for exactly in (False, True):
        cloud = np.asarray(obb.contains(points, exact=exactly))
        for k, point in enumerate(points):
            single = obb.contains(point, exact=exactly)
            assert isinstance(single, bool)
            assert single == cloud[k]


def test_nan_is_no_point() -> None:
    for bad in (np.nan, np.inf):
        refused(r"points.*row 1", OBB().contains, [[0.0, 0.0, 0.0], [bad, 0.0, 0.0]])
        refused("points", OBB().contains, [bad, 0.0, 0.0])


#: By how much more than the margin a point may be away and still count, relative to its size.
DOUBT = 2.0**-44


def checked_with_each_box_by_itself(boxes: Boxes, points: np.ndarray) -> PointsInside:
    """Return what is found, after comparing it."""
    found = points_inside(boxes, points, each_point=True)
    finite = np.isfinite(points).all(axis=1)
    assert found.ignored == (~finite).sum()
    assert found.boxes is not None
    lowest = np.full(len(points), -1)
    for b in range(len(boxes)):
        inside = np.zeros(len(points), np.bool_)
        inside[finite] = contains(*row_of(boxes, b), points[finite].astype(np.float64))
        lowest[inside & (lowest < 0)] = b
        rows = np.flatnonzero(inside)
        assert found.counts[b] == len(rows)
        if len(rows) == 0:
            assert found.first[b] == found.nearest[b] == -1
            assert found.distances[b] == np.inf
            continue
        assert found.first[b] == rows[0]
        away = points[rows].astype(np.float64) - boxes.centers[b]
        scale = max(float(np.abs(away).max()), 1e-300)
        lengths = np.linalg.norm(away / scale, axis=1) * scale
        nearest = np.flatnonzero(rows == found.nearest[b])
        assert lengths[nearest] <= lengths.min() * (1.0 + 1e-14)
        assert found.distances[b] == pytest.approx(lengths.min(), rel=1e-14)
    np.testing.assert_array_equal(found.boxes, lowest)
    return found


@each("name", FAMILIES)
def test_families(name: str) -> None:
    boxes, _ = family(name, 60)
    checked_with_each_box_by_itself(boxes, near(boxes, np.random.default_rng(1), 15))


def crowded(kind: str, n: int, rng: np.random.Generator) -> Boxes:
    """Boxes spread as grids like it least."""
    centers = rng.uniform(-2.0, 2.0, (n, 3))
    half = rng.uniform(0.05, 0.5, (n, 3))
    if kind == "all overlap":
        centers, half = 0.05 * centers, half + 1.0
    elif kind == "one huge":
        half[0] = 50.0
    elif kind == "crowd in a hall":
        centers, half = 1e-3 * centers, 1e-3 * half
        half[0] = 5.0
    elif kind == "rods":
        half = np.tile([0.01, 0.01, 5.0], (n, 1))
    elif kind == "far":
        centers = centers + 1e8
    elif kind == "points and plates":
        half *= rng.choice([0.0, 1.0], (n, 3))
    elif kind == "one place":
        centers[:], half[:] = centers[0], half[0]
    elif kind == "in a plane":
        centers[:, 2] = 0.0
        half[:, 2] = 0.0
    rotations = Rotation.random(n, random_state=rng).as_matrix()
    rotations[: n // 2] = np.eye(3)
    return Boxes(centers, rotations, half)


CROWDS = [
    "plain", "all overlap", "one huge", "crowd in a hall", "rods", "far", "points and plates",
    "one place", "in a plane",
]  # fmt: skip


@each("kind", CROWDS)
@each("dtype", [np.float32, np.float64])
def test_crowds(kind: str, dtype: type) -> None:
    rng = np.random.default_rng(2)
    boxes = crowded(kind, 80, rng)
    low, high = boxes.world_bounds()
    cloud = [near(boxes, rng, 60), rng.uniform(low.min(), high.max(), (3000, 3)), low, high]
    points: np.ndarray = np.concatenate(cloud).astype(dtype)
    points[::97, rng.integers(0, 3)] = rng.choice([np.nan, np.inf, -np.inf])
    found = checked_with_each_box_by_itself(boxes, points)
    assert found.counts.sum() > 0 or kind == "far"


@given(st.sampled_from(CROWDS), st.integers(0, 9), st.integers(0, 400), st.integers(0, 2**32 - 1))
def test_few(kind: str, n: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = crowded(kind, n, rng) if n else family("ordinary scene", 0)[0]
    points: np.ndarray = rng.uniform(-1.0, 1.0, (count, 3)) * 10.0 ** rng.uniform(-3, 9)
    if n:
        points[: count // 2] = near(boxes, rng, count)[: count // 2]
    checked_with_each_box_by_itself(boxes, points)


@each("scale", [1.0, 1e-200, 1e250])
def test_margins(scale: float) -> None:
    rng = np.random.default_rng(3)
    boxes = crowded("points and plates", 12, rng)
    boxes = Boxes(scale * boxes.centers, boxes.rotations, scale * boxes.half_extents)
    margin = 0.25 * scale
    local = rng.uniform(-1.0, 1.0, (12, 2, 3)) * (boxes.half_extents + 1.2 * margin)[:, None]
    on_face = local[:, ::2]  # at the margin from a face, as well as doubles can say
    on_face[..., 0] = boxes.half_extents[:, None, 0] + margin
    points = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, local)
    points = points.reshape(-1, 3)
    found = points_inside(boxes, points, margin)
    margins = set()
    for b in range(len(boxes)):
        held = 0
        for point in points:
            square = squared_distance([exact(point)], corners(row_of(boxes, b)))
            alone = points_inside(boxes[b : b + 1], point[None], margin).counts[0]
            held += alone
            size = np.abs(point - boxes.centers[b]).sum() + boxes.half_extents[b].sum() + margin
            truth = square <= Fraction(margin) ** 2
            assert alone or not truth, "a point within the margin may never be left out"
            assert not alone or square <= Fraction(margin + DOUBT * size) ** 2
            margins.add((bool(alone), truth))
        assert found.counts[b] == held
    assert {(True, True), (False, False)} <= margins


def same(a: PointsInside, b: PointsInside) -> bool:
    return a.ignored == b.ignored and all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("counts", "first", "nearest", "distances", "boxes")
    )


def test_any_number_of_threads_gives_the_same_bits() -> None:
    rng = np.random.default_rng(4)
    boxes = crowded("plain", 100, rng)
    points = rng.uniform(-2.5, 2.5, (5 * CHUNK + 123, 3))
    points[3 * CHUNK + 7 :] = points[: 2 * CHUNK + 116]  # equally near ones in several parts
    counts = 1, 2, 3, None
    alone, *others = by_threads(lambda: points_inside(boxes, points, each_point=True), *counts)
    assert all(same(other, alone) for other in others)
    for b in np.flatnonzero(alone.counts):
        twice = np.flatnonzero((points == points[alone.nearest[b]]).all(axis=1))
        assert alone.nearest[b] == twice[0]


def test_clouds_are_taken_as_they_come() -> None:
    rng = np.random.default_rng(5)
    boxes = crowded("plain", 30, rng)
    points = rng.uniform(-2.5, 2.5, (2000, 3)).astype(np.float32)
    want = checked_with_each_box_by_itself(boxes, points.astype(np.float64))
    padded = np.zeros(2000, np.dtype({"names": ["xyz"], "formats": ["3f4"], "itemsize": 32}))
    padded["xyz"] = points
    packed = np.zeros(2000, np.dtype([("flag", "u1"), ("xyz", "f4", 3)]))
    packed["xyz"] = points
    read_only = points.copy()
    read_only.setflags(write=False)
    clouds = [
        points, padded["xyz"], packed["xyz"], read_only, np.asfortranarray(points),
        points.astype(">f4"), points.tolist(),
    ]  # fmt: skip
    for cloud in clouds:
        assert same(points_inside(boxes, cloud, each_point=True), want)
    whole = points_inside(boxes, np.array([[0, 0, 0], [1, 1, 1]]))
    assert same(whole, points_inside(boxes, np.array([[0.0, 0, 0], [1, 1, 1]])))


def test_nothing_to_look_at() -> None:
    none, one = family("ordinary scene", 0)[0], family("ordinary scene", 1)[0]
    found = points_inside(none, np.array([[0.0, 0, 0], [np.nan, 0, 0]]), each_point=True)
    assert found.counts.shape == found.distances.shape == (0,)
    assert found.ignored == 1
    assert found.boxes is not None
    assert found.boxes.tolist() == [-1, -1]
    for boxes in (none, one):
        empty = points_inside(boxes, np.empty((0, 3)), each_point=True)
        assert (empty.counts == 0).all()
        assert (empty.first == -1).all()
        assert empty.ignored == 0


def test_bad_input() -> None:
    boxes = family("ordinary scene", 1)[0]
    for points in (np.zeros(3), np.zeros((2, 4)), np.zeros((1, 2, 3))):
        refused("points must have shape", points_inside, boxes, points)
    refused("points must be numbers", points_inside, boxes, [["a", "b", "c"]])
    refused("margin must not be negative", points_inside, boxes, np.zeros((1, 3)), -1.0)
    refused("margin must be finite", points_inside, boxes, np.zeros((1, 3)), np.nan)


SOLIDS = ["star1", "bumpy1", "torus2", "hollow1", "crumbs2", "hull1", "annulus0"]
#: How near to the surface a point outside may count as inside, of size and offset,
MESH_DOUBT = Fraction(1, 2**41)
#: also where a face is as narrow as this, so that every ray may pass too near to an edge.
NARROW, NARROW_DOUBT = 1e-6, Fraction(1, 10**9)


def test_what_is_inside_of_solids() -> None:
    trees = trees_of(*SOLIDS)
    assert trees.solid.all()
    bodies = bodies_of(trees, 12, 0.6, 41)[0]
    points = np.random.default_rng(42).uniform(-1.2, 1.2, (600, 3))
    found = points_inside(bodies, points, each_point=True)
    lowest = np.full(len(points), -1)
    for row in range(len(bodies)):
        inside = np.abs(windings(placed_corners(bodies, row), points)) > 0.5
        rows = np.flatnonzero(inside)
        lowest[inside & (lowest < 0)] = row
        assert found.counts[row] == len(rows)
        assert found.first[row] == (rows[0] if len(rows) else -1)
    assert (found.counts > 0).sum() > 6
    np.testing.assert_array_equal(found.boxes, lowest)


def test_the_surface_is_inside() -> None:
    trees = trees_of(*SOLIDS, "sheet1", "open_sphere2", "triangle")
    rng = np.random.default_rng(43)
    for body in range(len(trees)):
        turn = Rotation.random(random_state=rng).as_matrix()[None]
        bodies = PlacedMeshes(trees, [body], rng.normal(size=(1, 3)), turn)
        corners = placed_corners(bodies, 0)
        weights = rng.dirichlet([1.0, 1.0, 1.0], len(corners))
        points = np.concatenate([np.einsum("nk,nkc->nc", weights, corners), corners[:, 0]])
        assert points_inside(bodies, points).counts[0] == len(points), body


def test_a_surface_holds_only_what_is_on_it() -> None:
    body = standing(MeshTrees.build(*zoo()["sphere3"], solid=False))
    points = np.random.default_rng(44).uniform(-0.4, 0.4, (500, 3))
    assert points_inside(body, points).counts[0] == 0


def test_boxes_and_their_meshes_hold_the_same() -> None:
    rng = np.random.default_rng(45)
    half_extents, centers = rng.uniform(0.1, 1.0, (20, 3)), rng.uniform(-2.0, 2.0, (20, 3))
    turns = Rotation.random(20, random_state=rng).as_matrix()
    meshes = PlacedMeshes(MeshTrees.from_half_extents(half_extents), range(20), centers, turns)
    points = rng.uniform(-3.0, 3.0, (4000, 3)).astype(np.float32)
    points[7] = np.nan
    for margin in (0.0, 0.1):
        one = points_inside(Boxes(centers, turns, half_extents), points, margin, each_point=True)
        other = points_inside(meshes, points, margin, each_point=True)
        np.testing.assert_array_equal(one.boxes, other.boxes)
        for name in ("counts", "first", "nearest", "ignored"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@each("name", ["sheet0", "box0", "triangle"])
def test_margins_against_fractions(name: str) -> None:
    """Points moved from the surface by the margin, a little more and a little less."""
    rng = np.random.default_rng(46)
    tree = MeshTrees.build(*zoo()[name], solid=False)
    turn = Rotation.random(random_state=rng).as_matrix()[None]
    body = PlacedMeshes(tree, [0], rng.normal(size=(1, 3)), turn)
    triangles, corners = exact_corners(body, 0), placed_corners(body, 0)
    margin, decided = 0.125, 0
    for n in range(40):
        face = corners[rng.integers(len(corners))]
        normal = np.cross(face[1] - face[0], face[2] - face[0])
        excess = rng.choice([0.0, 1e-15, -1e-15, 1e-12, -1e-12, 1e-6, -1e-6])
        away = (margin + excess) * normal / np.linalg.norm(normal)
        point = rng.dirichlet([1.0, 1.0, 1.0]) @ face + away
        held = points_inside(body, point[None], margin).counts[0] == 1
        square = min(squared_distance([exact(point)], t) for t in triangles)
        if square <= Fraction(margin) ** 2:
            assert held, n
        elif held:
            size = Fraction(tree.radii[0]) + 1
            assert square <= (Fraction(margin) + MESH_DOUBT * size) ** 2
        else:
            decided += 1
    assert 0 < decided < 40


def least_height(triangles: Floats) -> float:
    """Return how narrow the narrowest of triangles is, of their size; (k, 3, 3)."""
    edges = (triangles - np.roll(triangles, 1, axis=1)) / np.abs(triangles).max()
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    return float((areas / np.maximum(longest, 1e-300)).min())


@each("make", TRIANGLES)
def test_tetrahedra_of_all_kinds_against_fractions(make: Maker, pairs: int) -> None:
    """Points on corners, edges and faces, inside, outside, and a rounding off all these."""
    rng = np.random.default_rng(47)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    weights = np.array(
        [[1, 0, 0, 0], [0.5, 0.5, 0, 0], [0.25, 0.5, 0.25, 0], [0.25] * 4, [0.5, 0.5, -0.25, 0.25]]
    )
    held_ones = 0
    for n in range(max(pairs // SHARE // len(weights), 4)):
        first, second = make(rng)
        corners = np.concatenate([first, second[:1]])[rng.permutation(4)]
        doubt = NARROW_DOUBT if least_height(corners[faces]) < NARROW else MESH_DOUBT
        body = thrown(corners, faces, n, rng)
        margin, center = rng.choice([0.0, 0.01]) * np.abs(corners).max(), body.centers[0]
        points = weights @ corners @ body.rotations[0].T + center
        points *= 1.0 + rng.choice([0.0, 1e-16, 1e-13, 1e-9]) * rng.normal(size=points.shape)
        whole = [corner for triangle in exact_corners(body, 0) for corner in triangle]
        held = [points_inside(body, p[None], margin).counts[0] == 1 for p in points]
        size = Fraction(body.trees.radii[0]) + Fraction(np.abs(center).max())
        for point, is_in in zip(map(exact, points), held, strict=True):
            square = squared_distance([point], whole)
            if square <= Fraction(margin) ** 2:
                assert is_in
            elif is_in:
                assert square <= (Fraction(margin) + doubt * (size + taxicab(point))) ** 2
        held_ones += sum(held)
    assert held_ones > 5


@each("power", [-500, -300, 300, 500])
def test_solids_of_any_size_hold_the_same_points(power: int) -> None:
    """Products of three coordinates overflow from 1e103 on, and underflow below 1e-108."""
    rng = np.random.default_rng(3)
    vertices, faces = zoo()["hollow1"]
    points = rng.uniform(-0.8, 0.8, (300, 3)) * np.abs(vertices).max()
    ones = points_inside(place(vertices, faces), points, 0.0).counts
    assert 10 < ones[0] < 290
    unit = 2.0**power
    assert (points_inside(place(vertices * unit, faces), points * unit, 0.0).counts == ones).all()


#: Sizes along the axes, and how thin what is thin may be.
SCALES = {
    "random": [1.0, 1.0, 1.0], "plates": [1.0, 1.0, 1e-8], "needles": [1e-8, 1e-8, 1.0],
    "tiny": [1e-150] * 3, "huge": [1e150] * 3,
}  # fmt: skip
#: What is promised of points beside hulls, and of radii and margins, relative to the size.
CLOSE = 1e-9


def held(body: ConvexBodies, points: Floats, margin: float = 0.0) -> Mask:
    """Return (n,) which points are in one body."""
    found = points_in_bodies(around(body, margin), body, points, margin, each_point=True)
    assert found.boxes is not None
    return np.asarray(found.boxes == 0)


def points_about(body: ConvexBodies, count: int, rng: np.random.Generator) -> Floats:
    """Return points in and about a body, some within 1e-17 to 1e-3 of its size of the surface."""
    size = np.abs(body.sizes[0]).sum() + body.radii[0]
    local = rng.normal(size=(count, 3)) * np.maximum(body.sizes[0, :3], 1e-3 * size)
    local[:, 2] += rng.uniform(-1, 1, count) * body.sizes[0, 3]
    inside, outside = 0.0 * local, local
    for _ in range(60):  # halved until the surface is between neighbours
        middle = 0.5 * (inside + outside)
        world = middle @ body.rotations[0].T + body.centers[0]
        is_in = beyond(some(body, np.zeros(count, np.int64)), world) <= 0.0
        inside = np.where(is_in[:, None], middle, inside)
        outside = np.where(is_in[:, None], outside, middle)
    near = inside * (
        1.0 + rng.choice([-1, 1], (count, 1)) * 10.0 ** rng.uniform(-17, -3, (count, 1))
    )
    local = np.where(rng.random((count, 1)) < 0.7, near, local)
    return np.asarray(local @ body.rotations[0].T + body.centers[0])


@each("name", SCALES)
@each("kind", [kind for kind in KINDS if kind != "hull"])
def test_points_are_in_shapes_by_their_formulas(kind: str, name: str, pairs: int) -> None:
    rng = np.random.default_rng(3)
    several = bodies(KINDS[kind], 4, rng, np.array(SCALES[name]), 0.5 * min(SCALES[name]))
    several = moved(several, centers=several.centers * rng.choice([1.0, 1e3], (4, 1)))
    decided = 0
    for i in range(4):
        body = some(several, [i])
        points = points_about(body, max(200, pairs // 40), rng)
        far = beyond(some(body, np.zeros(len(points), np.int64)), points)
        size = np.abs(points - body.centers).sum(axis=1) + np.abs(body.sizes).sum() + body.radii[0]
        rounding = 1e-13 * (size + np.abs(body.centers).max())
        close = CLOSE * size if body.kinds[0] == SEGMENT_CORE else 0.0
        found = held(body, points)
        assert found[far <= 0.0].all()
        assert not found[far > rounding + close].any()
        decided += int((far > rounding + close).sum()) + int((far < -rounding).sum())
    assert decided > 150


def test_points_are_in_hulls_by_their_planes(pairs: int) -> None:
    rng = np.random.default_rng(4)
    several = bodies(HULL_CORE, 8, rng, np.ones(3), 0.0)
    for i in range(8):
        body, corners = some(several, [i]), corners_of(several, i)
        weights = rng.dirichlet(np.full(len(corners), 0.2), max(200, pairs // 40))
        local = (weights @ corners) * (1.0 + 10.0 ** rng.uniform(-12, 0, (len(weights), 1)))
        planes = ConvexHull(corners).equations
        far = (local @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        found = held(body, local @ body.rotations[0].T + body.centers[0])
        assert found[far <= -1e-14].all()
        assert not found[far > CLOSE * 8.0].any()
        assert 20 < found.sum() < len(found)


@each("kind", KINDS)
def test_a_margin_and_a_radius_are_a_ball_about_the_shape(kind: str) -> None:
    rng = np.random.default_rng(5)
    several = bodies(KINDS[kind], 6, rng, np.ones(3), 0.5)
    for i in range(6):
        body = some(several, [i])
        points = rng.uniform(-2, 2, (600, 3)) + body.centers
        narrow, wide = held(body, points), held(body, points, 0.4)
        padded = held(moved(body, radii=body.radii + 0.4), points)
        assert (wide == padded).all()
        assert (wide >= narrow).all()
        assert narrow.sum() < wide.sum()
        inner = points[narrow]
        if len(inner):  # from each of these, a step of the margin stays within it
            steps = rng.normal(size=inner.shape)
            steps *= 0.4 * (1.0 - 1e-12) / np.linalg.norm(steps, axis=1)[:, None]
            assert held(body, inner + steps, 0.4).all()
        assert not wide[np.linalg.norm(points - body.centers, axis=1) > 3.6].any()
