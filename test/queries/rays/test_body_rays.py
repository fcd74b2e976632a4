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

"""Rays at boxes, meshes, padded or not, and bodies: never late, none missed, near the hit."""

from __future__ import annotations

import math
import sys
from fractions import Fraction

import numpy as np
import pytest
from convex_bodies import KINDS, around, moved, some
from convex_bodies import bodies as random_bodies
from each import each
from exact_bodies import beyond, first_hit, outside
from exact_vectors import Box, along, corners, determinant, dot, exact, minus
from hull_distances import squared_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_zoo import (
    SHARE,
    TRIANGLE,
    TRIANGLES,
    Maker,
    bodies_of,
    exact_corners,
    placed_corners,
    standing,
    thrown,
    trees_of,
    windings,
    zoo,
)
from scipy.spatial.transform import Rotation
from support import family, refused, row_of
from trimesh.triangles import closest_point

from obb_collision import Boxes, MeshTrees, PlacedMeshes, cast_rays, cast_segments
from obb_collision.queries.convex.support import HULL_CORE, ConvexBodies
from obb_collision.queries.meshes.placed import root_boxes
from obb_collision.queries.points import points_in_bodies
from obb_collision.queries.rays.hidden import add_hidden
from obb_collision.queries.rays.rays import RayHits, as_rays, cast_at_bodies, cast_at_padded
from obb_collision.typing import Floats
from tools.cases.families import FAMILIES
from tools.cases.placement import random_rotations

#: By how much a ray may pass what it is said to hit, relative to the size of ray and mesh.
DOUBT = Fraction(1, 10**12)


def check(bodies: PlacedMeshes, origin: Floats, way: Floats, found: RayHits, n: int) -> None:
    """Assert that a hit is not missed and not late, and that one that is none is a near miss."""
    o, d = exact(origin), exact(way)
    square = dot(d, d)
    triangles = [t for row in range(len(bodies)) for t in exact_corners(bodies, row)]
    times = [first_hit(o, d, t) for t in triangles]
    first = min((t for t in times if t is not None), default=None)
    if first is not None:
        assert found.boxes[n] >= 0
        assert Fraction(found.distances[n]) ** 2 <= first**2 * square
    elif found.boxes[n] >= 0:
        corners = bodies.trees.triangles.reshape(-1, 3)
        size = Fraction(np.abs(corners).max()) + sum(abs(x) for x in o)
        size += Fraction(np.abs(bodies.centers).max())
        reach = 4 * size / max(map(abs, d))
        near = min(squared_distance([o, along(o, reach, d)], t) for t in triangles)
        assert near <= (DOUBT * size) ** 2


def aimed(corners: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return a ray (3,), (3,) at a corner, an edge, the face, past it or along it."""
    size = np.abs(corners).max() + np.ptp(corners, axis=0).max() + 1e-300
    weights = [[1, 0, 0], [0.5, 0.5, 0], [0.25, 0.25, 0.5], [1.0 + 1e-15, -1e-15, 0], [2, -1, 0]]
    target = np.array(weights[rng.integers(5)]) @ corners
    kind = rng.integers(4)
    way = rng.normal(size=3) * size
    if kind == 0:
        way = corners[1] - corners[0]
    elif kind == 1:
        way = np.array([0.0, 0.0, size])
    if not way.any():
        way = np.array([size, 0.0, 0.0])
    return target - way * rng.choice([0.0, 0.5, 3.0, 100.0]), way


@each("make", TRIANGLES)
def test_triangles_against_fractions(make: Maker, pairs: int) -> None:
    rng = np.random.default_rng(21)
    hits = 0
    for n in range(max(pairs // SHARE, 12)):
        bodies = thrown(make(rng)[0], TRIANGLE, n, rng)
        origin, way = aimed(placed_corners(bodies, 0)[0], rng)
        found = cast_rays(bodies, origin[None], way[None])
        check(bodies, origin, way, found, 0)
        hits += int(found.hits[0])
    assert hits > 2


def rays_among_meshes(spread: float) -> tuple[PlacedMeshes, Floats, Floats, Floats]:
    """Return 12 surfaces, origins and ways of 40 rays, and radii of the surfaces."""
    trees = trees_of("box0", "star0", "hull0", "cone1", "open_sphere0", "crumbs0", solid=False)
    rng = np.random.default_rng(32)
    radii, origins = rng.uniform(0.0, 0.1, 12), rng.uniform(-3.0, 3.0, (40, 3))
    ways = rng.uniform(-1.0, 1.0, (40, 3)) - origins
    return bodies_of(trees, 12, spread, 31)[0], origins, ways, radii


def test_meshes_against_fractions() -> None:
    bodies, origins, ways, _ = rays_among_meshes(1.2)
    found = cast_rays(bodies, origins, ways)
    assert 10 < found.hits.sum() < 40
    for n in range(0, 40, 8):
        check(bodies, origins[n], ways[n], found, n)
        assert found.faces is not None
        if not found.hits[n]:
            assert found.faces[n] == -1
            assert np.isnan(found.positions[n]).all()
            continue
        row = found.boxes[n]
        triangle = exact_corners(bodies, row)[faces_of(bodies, row).index(found.faces[n])]
        first = float(first_hit(exact(origins[n]), exact(ways[n]), triangle) or np.nan)
        assert found.distances[n] == pytest.approx(first * np.linalg.norm(ways[n]), abs=1e-11)
        assert found.normals[n] @ ways[n] < 0.0
        np.testing.assert_allclose(found.positions[n], origins[n] + ways[n] * first, atol=1e-11)


def faces_of(bodies: PlacedMeshes, row: int) -> list[int]:
    trees, mesh = bodies.trees, bodies.meshes[row]
    first, last = trees.starts[trees.roots[mesh]]
    return [int(face) for face in trees.faces[first:last]]


def test_a_box_and_its_mesh_are_hit_alike() -> None:
    rng = np.random.default_rng(33)
    half_extents = rng.uniform(0.1, 1.0, (20, 3))
    centers, turns = rng.uniform(-4.0, 4.0, (20, 3)), random_rotations(rng, 20)
    boxes = Boxes(centers, turns, half_extents)
    meshes = PlacedMeshes(MeshTrees.from_half_extents(half_extents), range(20), centers, turns)
    origins, ends = rng.uniform(-5.0, 5.0, (2, 600, 3))
    for one, other in (
        (cast_rays(boxes, origins, ends), cast_rays(meshes, origins, ends)),
        (cast_rays(boxes, origins, ends, 3.0), cast_rays(meshes, origins, ends, 3.0)),
        (cast_segments(boxes, origins, ends), cast_segments(meshes, origins, ends)),
    ):
        np.testing.assert_array_equal(one.boxes, other.boxes)
        np.testing.assert_allclose(one.distances, other.distances, atol=1e-11)
        np.testing.assert_allclose(one.normals, other.normals, atol=1e-11)
        assert (one.distances == 0.0).sum() > 5  # inside


def test_a_surface_is_hit_from_inside() -> None:
    vertices, faces = zoo()["sphere2"]
    ways = np.random.default_rng(34).normal(size=(50, 3))
    for solid in (True, False):
        body = standing(MeshTrees.build(vertices, faces, solid=solid))
        found = cast_rays(body, np.zeros((50, 3)), ways)
        if solid:
            assert (found.distances == 0.0).all()
            assert not found.normals.any()
        else:
            assert (np.abs(found.distances - 0.45) < 0.02).all()


@each("radius", [None, 4e-9])
def test_far_origins_cost_few_digits(radius: float | None) -> None:
    """A ray from 1e6 m between two triangles 20 nanometres apart, 8 of which may be padding."""
    corners = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    gap = np.array([0.0, 1e-8, 0.0])
    pair = np.concatenate([corners + gap, -corners - gap])
    body = standing(MeshTrees.build(pair, [[0, 1, 2], [3, 4, 5]]))
    aside = 7e-9 if radius else 2e-8
    origins = np.array([[1e6, 0.0, 0.25], [1e6, aside, 0.25], [-1e6, -2e-8, -0.25]])
    ways = np.array([[-1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0]])
    found = cast_rays(body, origins, ways)
    if radius:
        found = cast_at_padded(body, np.array([radius]), as_rays(origins, ways, np.inf))
    assert found.boxes.tolist() == [-1, 0, 0]


@each("end, beside", [([-2.0, 1.0, -1.0], [2.0, -1.0, 1.0]), ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0])])
@each("offset", [0.0, 1e6])
def test_a_triangle_without_area_is_not_hit_beside_its_ends(
    end: list[float], beside: list[float], offset: float
) -> None:
    """Its sides say how far its line is, not where it ends; boxes of distant ones are wide."""
    start = offset * np.array([-0.6, 0.8, -0.7])
    corners = start + np.array([[0.0, 0.0, 0.0], end, [0.0, 0.0, 0.0]])
    body = standing(MeshTrees.build(corners, TRIANGLE))
    origins = start + np.array([beside, [0.0, 0.0, 0.0]]) - [0.0, 0.0, 3.0 * offset + 3.0]
    found = cast_rays(body, origins, [[0.0, 0.0, 1.0]] * 2)
    assert found.hits.tolist() == [False, True]


#: By how much a ray may be early, relative to the size of the body and where it comes near.
EARLY = Fraction(1, 10**9)
#: Unit directions and lengths are rounded.
ROUNDED = Fraction(1, 2**50)


def check_padded(
    bodies: PlacedMeshes, radii: Floats, origin: Floats, way: Floats, found: RayHits, n: int
) -> None:
    """Assert that a hit is not missed, not late, and hardly early; in fractions."""
    o, d, length = exact(origin), exact(way), Fraction(math.hypot(*way))
    triangles = [
        (t, Fraction(radii[k])) for k in range(len(bodies)) for t in exact_corners(bodies, k)
    ]
    corners = np.abs(bodies.trees.triangles).max() + np.abs(bodies.centers).max() + radii.max()
    hit = found.boxes[n] >= 0
    reach = 8 * (Fraction(corners) + sum(map(abs, o)))
    time = (Fraction(found.distances[n]) if hit else reach) / length
    end = along(o, time * (1 - ROUNDED), d)
    if time > 0:
        for triangle, radius in triangles:  # up to there, it is in none
            assert squared_distance([o, end], triangle) >= radius**2
    if hit:
        near = min(
            squared_distance([end], triangle) / (radius + EARLY * reach) ** 2
            for triangle, radius in triangles
        )
        assert near <= 1


@each("make", TRIANGLES)
def test_rounded_triangles_against_fractions(make: Maker, pairs: int) -> None:
    rng = np.random.default_rng(41)
    hits = started = 0
    for n in range(max(pairs // SHARE, 12)):
        corners = make(rng)[0]
        size = np.abs(corners).max() + np.ptp(corners, axis=0).max() + 1e-300
        radius = np.array([size * rng.choice([1e-6, 0.05, 0.5, 3.0])])
        bodies = thrown(corners, TRIANGLE, n, rng)
        origin, way = aimed(placed_corners(bodies, 0)[0], rng)
        if n % 3 == 0:  # past the edge of what is round
            origin = origin + radius * np.cross(way / math.hypot(*way), rng.normal(size=3))
        found = cast_at_padded(bodies, radius, as_rays(origin[None], way[None], np.inf))
        check_padded(bodies, radius, origin, way, found, 0)
        hits += int(found.hits[0])
        started += int(found.distances[0] == 0.0)
    assert hits > started > 0


def test_rounded_meshes_against_fractions() -> None:
    bodies, origins, ways, radii = rays_among_meshes(1.6)
    found = cast_at_padded(bodies, radii, as_rays(origins, ways, np.inf))
    assert 10 < found.hits.sum() < 40
    for n in range(0, 40, 15):
        check_padded(bodies, radii, origins[n], ways[n], found, n)
    lone = cast_at_padded(bodies, radii, as_rays(origins[:1], ways[:1], np.inf))
    assert lone.distances[0] == found.distances[0]  # bit for bit


def test_normals_and_faces_are_those_of_the_place() -> None:
    """A cube with round edges of 0.1 m: a face, an edge and a corner."""
    tree = MeshTrees.from_half_extents([[0.4, 0.4, 0.4]])
    body = PlacedMeshes(tree, [0], [[2.0, 0.0, 0.0]], np.eye(3)[None])
    aside = 0.4 + 0.06
    origins = np.array([[0.0, 0.1, 0.0], [0.0, aside, 0.2], [0.0, aside, aside], [0.0, 0.5, 0.5]])
    found = cast_at_padded(body, np.array([0.1]), as_rays(origins, [[1.0, 0, 0]] * 4, np.inf))
    depth = math.sqrt(0.1**2 - 2 * 0.06**2)
    times = np.array([1.5, 1.6 - 0.08, 1.6 - depth])
    np.testing.assert_allclose(found.distances[:3], times, atol=1e-8)
    assert (found.distances[:3] <= times).all()
    truth = np.array([[-1.0, 0.0, 0.0], [-0.8, 0.6, 0.0], [-depth / 0.1, 0.6, 0.6]])
    np.testing.assert_allclose(found.normals[:3], truth, atol=1e-7)
    assert found.boxes.tolist() == [0, 0, 0, -1]
    assert found.faces is not None
    assert (found.faces[:3] >= 0).all()
    assert found.faces[3] == -1
    assert np.isnan(found.normals[3]).all()
    reaches = as_rays(origins, [[1.0, 0, 0]] * 4, found.distances * (1.0 - 1e-9))
    assert not cast_at_padded(body, np.array([0.1]), reaches).hits.any()


@each("solid", [True, False])
def test_an_origin_inside_is_a_hit_at_once_and_so_are_points(solid: bool) -> None:
    """By solid angles, and the nearest points of all triangles as trimesh has them."""
    rng = np.random.default_rng(42)
    for name in ("star1", "hollow1", "torus2", "bumpy1"):
        tree = MeshTrees.build(*zoo()[name], solid=solid)
        turn = Rotation.random(random_state=rng).as_matrix()[None]
        body, radius = PlacedMeshes(tree, [0], np.ones((1, 3)), turn), np.array([0.05])
        origins = 1.0 + rng.uniform(-0.6, 0.6, (120, 3))
        found = cast_at_padded(body, radius, as_rays(origins, rng.normal(size=(120, 3)), np.inf))
        corners = placed_corners(body, 0)
        inside = np.abs(windings(corners, origins)) > 0.5 if solid else np.zeros(120, np.bool_)
        for n in range(120):
            nearest = closest_point(corners, np.tile(origins[n], (len(corners), 1)))
            inside[n] |= np.linalg.norm(nearest - origins[n], axis=1).min() <= 0.05
        assert 5 < inside.sum() < 115
        np.testing.assert_array_equal(found.distances == 0.0, inside)
        assert not found.normals[inside].any()
        boxes = root_boxes(body)
        boxes.arrays.half_extents[:] += 0.05
        cloud = points_in_bodies(boxes, body, origins, 0.0, radius, each_point=True)
        assert cloud.boxes is not None
        np.testing.assert_array_equal(cloud.boxes == 0, inside)


COUNT, SAMPLES = 60, 400
SCALES = {"random": [1.0, 1.0, 1.0], "plates": [1.0, 1.0, 1e-6], "needles": [1e-6, 1e-6, 1.0]}


def rays_at(body: ConvexBodies, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return origins and directions towards bodies, many of which pass near their edge."""
    size = np.abs(body.sizes).sum(axis=1) + body.radii + (body.kinds == HULL_CORE)
    origins = body.centers + rng.normal(size=(COUNT, 3)) * 3.0 * size[:, None]
    aim = rng.normal(size=(COUNT, 3)) * 0.4 * np.maximum(body.sizes[:, :3], body.radii[:, None])
    aim[:, 2] += rng.uniform(-1, 1, COUNT) * body.sizes[:, 3]
    ways = np.einsum("nij,nj->ni", body.rotations, aim) + body.centers - origins
    return origins, ways / np.linalg.norm(ways, axis=1)[:, None]


@each("name", SCALES)
@each("kind", [kind for kind in KINDS if kind != "hull"])
def test_rays_hit_where_the_shape_begins(kind: str, name: str) -> None:
    rng = np.random.default_rng(6)
    body = random_bodies(KINDS[kind], COUNT, rng, np.array(SCALES[name]), 0.5 * min(SCALES[name]))
    origins, ways = rays_at(body, rng)
    size = np.linalg.norm(origins - body.centers, axis=1)
    size += np.abs(body.sizes).sum(axis=1) + body.radii
    rounding = 1e-12 * size + 1e-14 * (np.abs(body.centers) + np.abs(origins)).sum(axis=1)
    hits = 0
    for n in range(COUNT):  # one by one, so that nothing hides anything
        row = np.array([n])
        found = cast_at_bodies(
            some(body, row), around(some(body, row)), as_rays(origins[row], ways[row], np.inf)
        )
        end = found.distances[0] if found.hits[0] else 3.0 * size[n]
        times = np.linspace(0.0, max(end - rounding[n], 0.0), SAMPLES)
        before = origins[n] + times[:, None] * ways[n]
        many = some(body, np.full(SAMPLES, n))
        inside = beyond(many, before) < -rounding[n]
        assert not inside.any() or end == 0.0
        if found.hits[0]:
            hits += 1
            assert beyond(some(body, row), found.positions)[0] <= 1e-9 * size[n] + rounding[n]
            if end > 0.0:
                assert np.linalg.norm(found.normals[0]) == pytest.approx(1.0, abs=1e-12)
                assert found.normals[0] @ ways[n] < 1e-6
    assert hits > COUNT // 20


def test_rays_at_boxes_are_those_of_boxes() -> None:
    rng = np.random.default_rng(7)
    body = random_bodies(KINDS["box"], COUNT, rng, np.ones(3), 0.0)
    boxes = Boxes.trusted(body.centers, body.rotations, body.sizes[:, :3].copy())
    origins, ways = rays_at(body, rng)
    found = cast_at_bodies(body, around(body), as_rays(origins, ways, np.inf))
    truth = cast_rays(boxes, origins, ways)
    assert (found.hits >= truth.hits).all()
    both = truth.hits
    assert (found.distances[both] <= truth.distances[both] + 1e-12).all()
    steep = both & (np.einsum("ij,ij->i", truth.normals, ways) < -0.01)
    np.testing.assert_allclose(found.distances[steep], truth.distances[steep], atol=1e-7)
    assert steep.sum() > COUNT // 4


def test_a_radius_is_hit_first_and_reach_and_origin_count() -> None:
    rng = np.random.default_rng(8)
    body = random_bodies(KINDS["cylinder"], COUNT, rng, np.ones(3), 0.0)
    origins, ways = rays_at(body, rng)
    padded = moved(body, radii=body.radii + 0.1)
    thin = cast_at_bodies(body, around(body), as_rays(origins, ways, np.inf))
    thick = cast_at_bodies(padded, around(padded), as_rays(origins, ways, np.inf))
    assert (thick.distances <= thin.distances).all()
    hit = np.flatnonzero(np.isfinite(thin.distances) & (thin.distances > 0.0))
    short = thin.distances[hit]
    for factor, count in ((1.0 + 1e-9, len(hit)), (1.0 - 1e-6, 0)):
        again = cast_at_bodies(body, around(body), as_rays(origins[hit], ways[hit], short * factor))
        assert again.hits.sum() == count
    inside = cast_at_bodies(body, around(body), as_rays(body.centers, ways, np.inf))
    assert (inside.distances == 0.0).all()
    assert (inside.normals == 0.0).all()


@each("kind", KINDS)
@each("padding", [0.0, 0.05])
def test_points_are_hidden_whose_rays_hit_before_them(kind: str, padding: float) -> None:
    rng = np.random.default_rng(10)
    body = random_bodies(KINDS[kind], COUNT, rng, np.ones(3), 0.1)
    body = moved(body, centers=body.centers - body.centers.mean(axis=0))
    sensor = np.array([30.0, 0.0, 0.0])
    points = np.repeat(body.centers, 20, axis=0) + rng.normal(size=(20 * COUNT, 3))
    points = sensor + rng.uniform(0.8, 1.5, (len(points), 1)) * (points - sensor)
    points[::50, 1], points[1::50] = np.nan, sensor
    found, known = np.zeros((2, len(points)), np.bool_)
    known[: len(points) // 2] = True
    for out in (found, known):
        add_hidden(out, sensor, points.astype(np.float32), around(body), body, padding)
    np.testing.assert_array_equal(known[len(points) // 2 :], found[len(points) // 2 :])
    assert known[: len(points) // 2].all()
    assert not found[::50].any()
    assert not found[1::50].any()
    seen = np.flatnonzero(np.isfinite(points).all(axis=1) & (points != sensor).any(axis=1))
    ways = points[seen].astype(np.float32) - sensor
    rays = as_rays(np.tile(sensor, (len(seen), 1)), ways, np.linalg.norm(ways, axis=1))
    fewer, more = (
        cast_at_bodies(grown, around(grown), rays).hits
        for grown in (moved(body, radii=body.radii + padding + off) for off in (-1e-6, 1e-6))
    )
    assert (fewer <= found[seen]).all()
    assert (found[seen] <= more).all()
    assert 50 < found.sum() < len(points) - 50


@each("kind", KINDS)
def test_no_reference_to_an_array_is_kept_or_lost(kind: str) -> None:
    """Kernels that count no references borrow what is in bodies."""
    rng = np.random.default_rng(9)
    body = random_bodies(KINDS[kind], COUNT, rng, np.ones(3), 0.0)
    rays = as_rays(*rays_at(body, rng), np.inf)
    arrays = [*vars(body.hulls).values()] if hasattr(body.hulls, "__dict__") else [*body.hulls]
    before = [sys.getrefcount(array) for array in arrays]
    for _ in range(3):
        cast_at_bodies(body, around(body), rays)
        points_in_bodies(around(body), body, rays.origins, 0.1)
    assert [sys.getrefcount(array) for array in arrays] == before


#: Hits are right to this, relative to the size of box and ray.
HIT_DOUBT = 2.0**-40


def exact_entry(stored: Box, origin: np.ndarray, direction: np.ndarray) -> Fraction | None:
    """Return the least t >= 0 at which origin + t direction is in the box, exactly."""
    center, rotation, half = stored
    a, b, c = map(exact, rotation.T)
    volume = determinant(a, b, c)
    o, d = minus(exact(origin), exact(center)), exact(direction)
    enter, leave = Fraction(0), None
    at = (determinant(o, b, c), determinant(a, o, c), determinant(a, b, o))
    way = (determinant(d, b, c), determinant(a, d, c), determinant(a, b, d))
    for h, top, slope in zip(exact(half), at, way, strict=True):
        y, v = top / volume, slope / volume
        if v == 0:
            if abs(y) > h:
                return None
            continue
        near, far = sorted(((-h - y) / v, (h - y) / v))
        enter = max(enter, near)
        leave = far if leave is None else min(leave, far)
    return enter if leave is None or enter <= leave else None


def aimed_at(boxes: Boxes, rng: np.random.Generator, each: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays at corners, along edges and faces, from inside, from the surface, and past the box."""
    n = len(boxes)
    reach = boxes.half_extents.sum(axis=1)[:, None, None] + 1e-300
    shares = rng.choice([-1.0, 0.0, 1.0, 0.3, 1.0 + 1e-15, 1.1], (n, each, 3))
    target = shares * boxes.half_extents[:, None]
    way = rng.normal(size=(n, each, 3)) * rng.choice([0.0, 1.0], (n, each, 3), p=[0.3, 0.7])
    way[~way.any(axis=2)] = 1.0, 0.0, 0.0
    way *= reach
    start = target - way * rng.choice([0.0, 0.5, 3.0, 100.0], (n, each, 1))
    origins = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, start)
    directions = np.einsum("nij,nkj->nki", boxes.rotations, way)
    return origins.reshape(-1, 3), directions.reshape(-1, 3)


def check_boxes(boxes: Boxes, origins: np.ndarray, directions: np.ndarray, found: RayHits) -> None:
    for n in range(len(origins)):
        norm = math.hypot(*directions[n])
        entries = [
            exact_entry(row_of(boxes, b), origins[n], directions[n]) for b in range(len(boxes))
        ]
        true = [float(t) * norm for t in entries if t is not None]
        if found.boxes[n] < 0:
            assert not true, "no hit may be missed"
            assert found.distances[n] == np.inf
            assert np.isnan(found.positions[n]).all()
            continue
        b = int(found.boxes[n])
        size = np.abs(origins[n] - boxes.centers[b]).sum() + boxes.half_extents[b].sum()
        if true:
            assert found.distances[n] <= min(true) + HIT_DOUBT * size
        time = Fraction(found.distances[n]) / Fraction(norm)
        point = along(exact(origins[n]), time, exact(directions[n]))
        assert outside(row_of(boxes, b), [point])[0] <= HIT_DOUBT * size
        if found.normals[n].any():
            assert found.normals[n] @ directions[n] <= HIT_DOUBT * norm
            assert np.linalg.norm(found.normals[n]) == pytest.approx(1.0, abs=1e-14)


@each("name", FAMILIES)
def test_rays_aimed_at_one_box(name: str) -> None:
    boxes, _ = family(name, 8)
    rng = np.random.default_rng(1)
    for b in range(len(boxes)):
        one = boxes[b : b + 1]
        origins, directions = aimed_at(one, rng, 15)
        check_boxes(one, origins, directions, cast_rays(one, origins, directions))


@settings(max_examples=50)
@given(st.sampled_from(sorted(FAMILIES)), st.integers(0, 2**32 - 1), st.integers(2, 12))
def test_the_nearest_of_several_boxes(name: str, seed: int, n: int) -> None:
    boxes, _ = family(name, n)
    origins, directions = aimed_at(boxes, np.random.default_rng(seed), 1)
    check_boxes(boxes, origins, directions, cast_rays(boxes, origins, directions))


def test_a_tree_of_many_boxes_changes_nothing() -> None:
    rng = np.random.default_rng(2)
    boxes, _ = family("ordinary scene", 400)
    boxes = Boxes(rng.uniform(-8.0, 8.0, (400, 3)), boxes.rotations, boxes.half_extents)
    origins = rng.uniform(-12.0, 12.0, (500, 3))
    directions = rng.normal(size=(500, 3))
    directions[::5] = np.eye(3)[rng.integers(0, 3, 100)]
    found = cast_rays(boxes, origins, directions)
    assert 0.1 < (found.boxes >= 0).mean() < 0.98
    nearest, rows = np.full(500, np.inf), np.full(500, -1)
    for b in range(len(boxes)):
        alone = cast_rays(boxes[b : b + 1], origins, directions)
        nearer = alone.distances < nearest
        nearest[nearer], rows[nearer] = alone.distances[nearer], b
    np.testing.assert_array_equal(found.boxes, rows)
    np.testing.assert_array_equal(found.distances, nearest)


def test_faces_and_distances() -> None:
    boxes = Boxes([[0, 0, 0], [5, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1], [1, 1, 0]])
    origins = np.array([[-3, 0, 0], [0, 0.5, 9], [0.5, 0, 0], [-3, 2, 0], [9, 1, 0], [5, 0, 4.0]])
    ways = np.array([[2, 0, 0], [0, 0, -3], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, -1.0]])
    found = cast_rays(boxes, origins, ways)
    assert found.boxes.tolist() == [0, 0, 0, -1, 1, 1]
    assert found.distances.tolist() == [2, 8, 0, np.inf, 3, 4]
    normals = [[-1, 0, 0], [0, 0, 1], [0, 0, 0], [1, 0, 0], [0, 0, 1]]
    assert found.normals[found.boxes >= 0].tolist() == normals
    assert found.positions[0].tolist() == [-1, 0, 0]
    near = cast_rays(boxes, origins, ways, [2.0, 7.9, 0.0, 9.0, 2.5, 9.0])
    assert near.boxes.tolist() == [0, -1, 0, -1, -1, 1]


@each("name", ["ordinary scene", "zero extents", "exact resting contact"])
def test_segments(name: str) -> None:
    boxes, _ = family(name, 15)
    rng = np.random.default_rng(3)
    starts, ways = aimed_at(boxes, rng, 4)
    ends = starts + ways * rng.choice([0.0, 0.4, 0.5, 1.0, 3.0], (len(starts), 1))
    truth = np.zeros(len(starts), np.bool_)
    for n in range(len(starts)):
        one = boxes[np.array([n // 4])]
        square = squared_distance([exact(starts[n]), exact(ends[n])], corners(row_of(one, 0)))
        truth[n] = square == 0
        hit = cast_segments(one, starts[n : n + 1], ends[n : n + 1]).hits[0]
        size = np.abs(starts[n] - one.centers[0]).sum() + one.half_extents.sum()
        assert hit or not truth[n], "no hit may be missed"
        assert not hit or square <= Fraction(HIT_DOUBT * size) ** 2
    assert 0.1 < truth.mean() < 0.9
    found = cast_segments(boxes, starts, ends)
    hits = found.boxes >= 0
    np.testing.assert_array_equal(cast_segments(boxes, starts, ends).hits, hits)
    lengths = np.linalg.norm(ends - starts, axis=1)
    assert (found.distances[hits] <= lengths[hits] * (1 + 1e-15)).all()
    assert hits[truth].all()


def test_nothing_to_hit() -> None:
    none, one = family("ordinary scene", 0)[0], family("ordinary scene", 1)[0]
    found = cast_rays(none, [[0, 0, 0]], [[1, 0, 0]])
    assert found.boxes.tolist() == [-1]
    assert len(cast_rays(one, np.empty((0, 3)), np.empty((0, 3))).boxes) == 0


def test_bad_rays_are_refused() -> None:
    boxes = family("ordinary scene", 1)[0]
    zeros, ones = np.zeros((2, 3)), np.ones((2, 3))
    for reason, origins, directions, *most in (
        (r"directions must not be zero in row 1", zeros, [[1, 0, 0], [0, 0, 0]]),
        ("same length", zeros, ones[:1]),
        (r"origins must be finite in row 1", [[0, 0, 0], [np.nan, 0, 0]], ones),
        (r"max_distance must not be negative or NaN in row 1", zeros, ones, [1.0, np.nan]),
        ("max_distance must be a number, or a number per ray", zeros, ones, [1.0, 2.0, 3.0]),
    ):
        refused(reason, cast_rays, boxes, origins, directions, *most)
    refused("same length", cast_segments, boxes, zeros, ones[:1])
