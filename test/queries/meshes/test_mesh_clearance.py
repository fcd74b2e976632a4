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

"""Distances of meshes: bounds that hold in exact arithmetic and are close, attained by points."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from placed_meshes import TRIANGLE, as_drawn, bodies_of, exact_corners, standing, trees_of
from scipy.spatial.transform import Rotation
from support import refused
from triangle_distances import squared_distance
from triangle_pairs import FAMILIES, SHARE, Floats, Maker

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
from obb_collision.queries.meshes import MeshClearances

#: What the bounds may differ by, relative to the size of a pair.
CLOSE = Fraction(1, 10**9)


def exact_square(a: PlacedMeshes, i: int, b: PlacedMeshes, j: int, near: float) -> Fraction:
    """Return the squared distance of two surfaces that is certainly at most ``near``."""
    first, second = exact_corners(a, i), exact_corners(b, j)
    corners = [
        np.array([[[float(x) for x in v] for v in t] for t in side]) for side in (first, second)
    ]
    middles = [c.mean(axis=1) for c in corners]
    radii = [
        np.linalg.norm(c - m[:, None], axis=2).max(axis=1)
        for c, m in zip(corners, middles, strict=True)
    ]
    gaps = np.linalg.norm(middles[0][:, None] - middles[1], axis=2)
    gaps -= radii[0][:, None] + radii[1]
    (low, high), (start, end) = ((c.min(axis=1), c.max(axis=1)) for c in corners)
    apart = np.maximum(low[:, None] - end, start - high[:, None])
    gaps = np.maximum(gaps, np.linalg.norm(np.maximum(apart, 0.0), axis=2))
    rows = np.argwhere(gaps <= near * (1.0 + 1e-9) + 1e-9 * (radii[0].max() + radii[1].max()))
    return min(squared_distance(first[s], second[t]) for s, t in rows)


def size_of(a: PlacedMeshes, i: int, b: PlacedMeshes, j: int) -> Fraction:
    offset = sum(
        abs(Fraction(x) - Fraction(y)) for x, y in zip(a.centers[i], b.centers[j], strict=True)
    )
    return offset + Fraction(a.trees.radii[a.meshes[i]]) + Fraction(b.trees.radii[b.meshes[j]])


def check(found: MeshClearances, row: int, square: Fraction, size: Fraction) -> None:
    """Assert what is promised of a pair, exactly."""
    lower, upper = Fraction(found.distances[row]), Fraction(found.upper[row])
    assert 0 <= lower <= upper
    assert lower**2 <= square <= upper**2
    assert upper - lower <= CLOSE * size
    between = found.positions_b[row] - found.positions_a[row]
    rounding = 1e-15 * (np.abs(found.positions_a[row]).max() + np.abs(found.positions_b[row]).max())
    assert math.hypot(*between) <= found.upper[row] + 8.0 * rounding
    if lower > 0:
        assert abs(np.linalg.norm(found.normals[row]) - 1.0) < 1e-12


def single(triangles: list[Floats], rng: np.random.Generator) -> PlacedMeshes:
    trees = MeshTrees.join([MeshTrees.build(t, TRIANGLE) for t in triangles])
    count = len(triangles)
    size = np.array([[np.abs(t).max()] for t in triangles])
    centers = np.where(rng.random((count, 1)) < 0.5, 0.0, size * rng.normal(size=(count, 3)))
    still = rng.random(count) < 0.5
    rotations = Rotation.random(count, random_state=rng).as_matrix()
    rotations[still] = np.eye(3)
    return PlacedMeshes(trees, np.arange(count), centers, rotations)


@each("make", FAMILIES)
def test_triangles_against_exact_arithmetic(make: Maker, pairs: int) -> None:
    rng = np.random.default_rng(11)
    count = max(pairs // SHARE, 4)
    drawn = [make(rng) for _ in range(count)]
    a, b = single([p for p, _ in drawn], rng), single([q for _, q in drawn], rng)
    half = np.arange(count) < count // 2  # as drawn: the others are moved apart or into each other
    bodies = [
        PlacedMeshes(x.trees, x.meshes, np.where(half[:, None], a.centers, x.centers),
                     np.where(half[:, None, None], a.rotations, x.rotations))
        for x in (a, b)
    ]  # fmt: skip
    found = oc.clearances(bodies[0], bodies[1])
    verdicts = oc.verdicts(bodies[0], bodies[1])
    back = oc.clearances(bodies[1], bodies[0])
    for n in range(count):
        (p,), (q,) = exact_corners(bodies[0], n), exact_corners(bodies[1], n)
        square, size = squared_distance(p, q), size_of(bodies[0], n, bodies[1], n)
        if verdicts[n] == Verdict.SEPARATE:
            check(found, n, square, size)
            check(back, n, square, size)
            assert found.upper[n] > 0.0
        else:
            assert square <= (size / 10**20) ** 2
            assert found.distances[n] == found.upper[n] == 0.0


def test_bounds_are_close_where_simplices_are_flat() -> None:
    """One of a thousand seemed to hold the origin, most of parallel faces: the distance was 0."""
    parallel = next(make for make in FAMILIES if make.__name__ == "_parallel")
    rng = np.random.default_rng(11)
    drawn = [parallel(rng) for _ in range(1000)]
    a, b = as_drawn(drawn)
    found = oc.clearances(a, b)
    assert (found.distances > 0.0).any()
    assert (found.upper - found.distances <= 1e-9 * (a.trees.radii + b.trees.radii)).all()


def test_meshes_against_exact_arithmetic() -> None:
    trees = trees_of(
        "box0", "star0", "hull0", "cone1", "triangle", "open_sphere0", "hollow0", "crumbs0"
    )
    a, b = bodies_of(trees, 60, 0.9, 3)
    found, verdicts = oc.clearances(a, b), oc.verdicts(a, b)
    apart = np.flatnonzero(verdicts == Verdict.SEPARATE)
    assert 20 < len(apart) < 58
    np.testing.assert_array_equal(found.distances > 0.0, verdicts == Verdict.SEPARATE)
    np.testing.assert_array_equal(found.upper > 0.0, verdicts == Verdict.SEPARATE)
    for n in apart[:5]:
        square = exact_square(a, n, b, n, found.upper[n])
        check(found, n, square, size_of(a, n, b, n))


def test_points_are_on_the_faces_named() -> None:
    trees = MeshTrees.build(*zoo()["torus1"])
    a, b = bodies_of(trees, 50, 2.0, 5)
    found = oc.clearances(a, b)
    vertices, faces = (np.asarray(x) for x in zoo()["torus1"])
    for bodies, points, side in ((a, found.positions_a, 0), (b, found.positions_b, 1)):
        local = np.einsum("nji,nj->ni", bodies.rotations, points - bodies.centers)
        corners = vertices[faces[found.faces[:, side]]]
        weights = [np.linalg.lstsq(np.vstack([c.T, np.ones(3)]), np.r_[x, 1.0], rcond=None)[0]
                   for c, x in zip(corners, local, strict=True)]  # fmt: skip
        assert np.min(weights) > -1e-9
        assert np.abs(np.einsum("nk,nkc->nc", weights, corners) - local).max() < 1e-12


def test_normals_prove_the_distance() -> None:
    """All corners of the one are beyond those of the other where meshes are convex."""
    trees = trees_of("hull1", "hull2", "box1")
    a, b = bodies_of(trees, 300, 1.5, 6)
    found = oc.clearances(a, b)
    vertices = [np.asarray(zoo()[name][0]) for name in ("hull1", "hull2", "box1")]
    apart = np.flatnonzero(found.distances > 0.0)
    assert len(apart) > 100
    for n in apart:
        p = vertices[a.meshes[n]] @ a.rotations[n].T + a.centers[n]
        q = vertices[b.meshes[n]] @ b.rotations[n].T + b.centers[n]
        gap = (q @ found.normals[n]).min() - (p @ found.normals[n]).max()
        assert gap == pytest.approx(found.distances[n], abs=1e-9)


def test_one_inside_the_other() -> None:
    """Solids have no distance from what is in them, surfaces and cavities do."""
    box, ball = MeshTrees.from_half_extents([2.0, 2.0, 2.0]), MeshTrees.build(*zoo()["sphere2"])
    inner, outer = standing(ball), standing(box)
    found = oc.clearances(outer, inner)
    assert found.distances[0] == found.upper[0] == 0.0
    assert found.faces.tolist() == [[-1, -1]]
    np.testing.assert_allclose(found.positions_a, found.positions_b)
    assert np.linalg.norm(found.positions_b) == pytest.approx(0.45)
    crate = MeshTrees.build(2.0 * BOX_CORNERS, BOX_FACES, solid=False)
    hollow = oc.clearances(standing(crate), inner)
    assert 1.55 <= hollow.upper[0] <= 1.56
    assert hollow.upper[0] - hollow.distances[0] < 1e-9


def test_radii_are_exact() -> None:
    """A capsule and a ball, as a segment and a point with a radius."""
    point = MeshTrees.build(np.zeros((3, 3)), TRIANGLE)
    segment = MeshTrees.build([[0, 0, -1], [0, 0, 1], [0, 0, 1]], TRIANGLE)
    ball, capsule = standing(point, [3.0, 4.0, 0.5]), standing(segment)
    found = oc.clearances(ball, capsule, radii_a=1.0, radii_b=[2.0])
    assert found.distances[0] == pytest.approx(2.0, abs=1e-11)
    np.testing.assert_allclose(found.positions_a, [[2.4, 3.2, 0.5]], atol=1e-12)
    np.testing.assert_allclose(found.positions_b, [[1.2, 1.6, 0.5]], atol=1e-12)
    deep = oc.clearances(ball, capsule, radii_a=3.0, radii_b=3.0)
    assert deep.distances[0] == deep.upper[0] == 0.0
    np.testing.assert_allclose(deep.positions_a, deep.positions_b, atol=1e-12)


def test_a_limit_leaves_out_what_is_farther() -> None:
    trees = trees_of("star1", "torus2")
    a, b = bodies_of(trees, 60, 2.0, 8)
    pairs = np.stack([np.arange(60), np.arange(60)[::-1]], axis=1)
    every = oc.clearances(a, b, pairs)
    some = oc.clearances(a, b, pairs, max_distance=0.5)
    near = every.distances <= 0.5
    assert 3 < near.sum() < 57
    np.testing.assert_array_equal(some.pairs, every.pairs[near])
    np.testing.assert_allclose(some.distances, every.distances[near], atol=1e-9)


def test_sizes_by_powers_of_two_change_nothing() -> None:
    vertices, faces = zoo()["bumpy1"]
    a, b = bodies_of(MeshTrees.build(vertices, faces), 12, 1.5, 9)
    found = oc.clearances(a, b)
    for power in (-600, -40, 30, 600):
        trees = MeshTrees.build(np.ldexp(vertices, power), faces)
        sides = [
            PlacedMeshes(trees, x.meshes, np.ldexp(x.centers, power), x.rotations) for x in (a, b)
        ]
        scaled = oc.clearances(sides[0], sides[1])
        np.testing.assert_array_equal(np.ldexp(scaled.distances, -power), found.distances)
        np.testing.assert_array_equal(scaled.normals, found.normals)


def test_wrong_arguments() -> None:
    bodies = standing(MeshTrees.build(*zoo()["box0"]))
    for radius in (-1.0, math.nan, math.inf, [1.0, 2.0], "much"):
        refused("radii_b must be", oc.clearances, bodies, bodies, radii_b=radius)
    refused("max_distance must be", oc.clearances, bodies, bodies, max_distance=-1.0)
