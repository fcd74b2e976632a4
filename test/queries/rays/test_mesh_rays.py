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

"""Rays against meshes: no hit is missed or late, by fractions; hits are what they seem to be."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from placed_meshes import TRIANGLE, bodies_of, exact_corners, standing, trees_of
from ray_hits import first_hit
from scipy.spatial.transform import Rotation
from triangle_distances import squared_distance
from triangle_pairs import FAMILIES, SHARE, Maker

from obb_collision import Boxes, MeshTrees, PlacedMeshes, cast_rays, cast_segments
from obb_collision.queries.rays.rays import RayHits
from obb_collision.typing import Floats

#: By how much a ray may pass what it is said to hit, relative to the size of ray and mesh.
DOUBT = Fraction(1, 10**12)


def fractions(v: Floats) -> list[Fraction]:
    return [Fraction(x) for x in v.tolist()]


def check(bodies: PlacedMeshes, origin: Floats, way: Floats, found: RayHits, n: int) -> None:
    """Assert that a hit is not missed and not late, and that one that is none is a near miss."""
    o, d = fractions(origin), fractions(way)
    square = sum(x * x for x in d)
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
        end = [x + reach * y for x, y in zip(o, d, strict=True)]
        near = min(squared_distance([o, end, end], t) for t in triangles)
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


@each("make", FAMILIES)
def test_triangles_against_fractions(make: Maker, pairs: int) -> None:
    rng = np.random.default_rng(21)
    hits = 0
    for n in range(max(pairs // SHARE, 60)):
        corners = make(rng)[0]
        tree = MeshTrees.build(corners, TRIANGLE)
        turn = Rotation.random(random_state=rng).as_matrix() if n % 2 else np.eye(3)
        center = rng.normal(size=3) * np.abs(corners).max() if n % 4 > 1 else np.zeros(3)
        bodies = PlacedMeshes(tree, [0], center[None], turn[None])
        origin, way = aimed(corners @ bodies.rotations[0].T + center, rng)
        found = cast_rays(bodies, origin[None], way[None])
        check(bodies, origin, way, found, 0)
        hits += int(found.hits[0])
    assert hits > 5


def test_meshes_against_fractions() -> None:
    trees = trees_of("box0", "star0", "hull0", "cone1", "open_sphere0", "crumbs0", solid=False)
    bodies = bodies_of(trees, 12, 1.2, 31)[0]
    rng = np.random.default_rng(32)
    origins = rng.uniform(-3.0, 3.0, (40, 3))
    ways = rng.uniform(-1.0, 1.0, (40, 3)) - origins
    found = cast_rays(bodies, origins, ways)
    assert 10 < found.hits.sum() < 40
    for n in range(0, 40, 2):
        o, d = fractions(origins[n]), fractions(ways[n])
        length = np.linalg.norm(ways[n])
        times = {}
        for row in range(len(bodies)):
            for face, triangle in zip(
                faces_of(bodies, row), exact_corners(bodies, row), strict=True
            ):
                time = first_hit(o, d, triangle)
                if time is not None:
                    times[float(time) * length] = row, face
        if not times:
            assert found.boxes[n] == -1
            assert found.faces is not None
            assert found.faces[n] == -1
            assert np.isnan(found.positions[n]).all()
            continue
        first = min(times)
        assert found.distances[n] == pytest.approx(first, abs=1e-11)
        assert found.faces is not None
        assert (found.boxes[n], found.faces[n]) == times[first]
        assert found.normals[n] @ ways[n] < 0.0
        np.testing.assert_allclose(
            found.positions[n], origins[n] + ways[n] / length * first, atol=1e-11
        )


def faces_of(bodies: PlacedMeshes, row: int) -> list[int]:
    trees, mesh = bodies.trees, bodies.meshes[row]
    first, last = trees.starts[trees.roots[mesh]]
    return [int(face) for face in trees.faces[first:last]]


def test_a_box_and_its_mesh_are_hit_alike() -> None:
    rng = np.random.default_rng(33)
    half_extents = rng.uniform(0.1, 1.0, (20, 3))
    centers, turns = (
        rng.uniform(-4.0, 4.0, (20, 3)),
        Rotation.random(20, random_state=rng).as_matrix(),
    )
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
    still = np.zeros((1, 3)), np.eye(3)[None]
    ways = np.random.default_rng(34).normal(size=(50, 3))
    for solid in (True, False):
        body = PlacedMeshes(MeshTrees.build(vertices, faces, solid=solid), [0], *still)
        found = cast_rays(body, np.zeros((50, 3)), ways)
        if solid:
            assert (found.distances == 0.0).all()
            assert not found.normals.any()
        else:
            assert (np.abs(found.distances - 0.45) < 0.02).all()


def test_far_origins_cost_few_digits() -> None:
    """A ray from 1e6 m between two triangles 20 nanometres apart."""
    corners = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    gap = np.array([0.0, 1e-8, 0.0])
    pair = np.concatenate([corners + gap, -corners - gap])
    body = standing(MeshTrees.build(pair, [[0, 1, 2], [3, 4, 5]]))
    origins = np.array([[1e6, 0.0, 0.25], [1e6, 2e-8, 0.25], [-1e6, -2e-8, -0.25]])
    ways = np.array([[-1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0]])
    assert cast_rays(body, origins, ways).boxes.tolist() == [-1, 0, 0]


def test_nothing_to_hit() -> None:
    tree = MeshTrees.build(*zoo()["box0"])
    none = PlacedMeshes(tree, np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3, 3)))
    found = cast_rays(none, [[0, 0, 0]], [[1, 0, 0]])
    assert found.boxes.tolist() == [-1]
    one = standing(tree)
    assert len(cast_rays(one, np.empty((0, 3)), np.empty((0, 3))).boxes) == 0


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
