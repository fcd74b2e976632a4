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

"""Contacts of meshes: points on both surfaces; ways of triangles out of each other."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from each import each
from mesh_zoo import TRIANGLE, bodies_of, exact_corners, trees_of
from triangle_distances import squared_distance, squared_distance_of_point
from triangle_pairs import FAMILIES, SHARE, Maker

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
from obb_collision.queries.convex import FlatFrame, frame_of
from obb_collision.queries.mesh_contacts import way_out
from obb_collision.queries.meshes.triangles import Triangle
from obb_collision.typing import Floats

TREES = trees_of()
#: How far a point may be from either surface, relative to the size of a pair.
ON_SURFACE = Fraction(1, 10**12)


def distance_square(point: Floats, triangles: list[list[list[Fraction]]]) -> Fraction:
    """Return the squared distance of a point from the nearest of triangles that are near it."""
    p, reach = [Fraction(x) for x in point.tolist()], Fraction(1, 10**6)
    boxes = [([min(c) for c in zip(*t, strict=True)], [max(c) for c in zip(*t, strict=True)])
             for t in triangles]  # fmt: skip
    near = [
        t
        for t, (low, high) in zip(triangles, boxes, strict=True)
        if all(x - reach <= y <= z + reach for x, y, z in zip(low, p, high, strict=True))
    ]
    return min((squared_distance_of_point(p, t) for t in near), default=Fraction(10**9))


@each("make", FAMILIES)
def test_points_of_triangles_are_on_both_exactly(make: Maker, pairs: int) -> None:
    rng = np.random.default_rng(21)
    drawn = [make(rng) for _ in range(max(pairs // SHARE, 8))]
    count, checked = len(drawn), 0
    sides = []
    for side in range(2):
        trees = MeshTrees.join([MeshTrees.build(pair[side], TRIANGLE) for pair in drawn])
        still = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        sides.append(PlacedMeshes(trees, np.arange(count), *still))
    a, b = sides
    found = oc.contacts(a, b, max_points=8)
    collide = oc.verdicts(a, b) != Verdict.SEPARATE
    assert (found.counts[collide] >= 1).all()
    for n in np.flatnonzero(collide).tolist():
        (p,), (q,) = exact_corners(a, n), exact_corners(b, n)
        size = Fraction(a.trees.radii[a.meshes[n]]) + Fraction(b.trees.radii[b.meshes[n]])
        for point in found.positions[n, : found.counts[n]]:
            x = [Fraction(c) for c in point.tolist()]
            for triangle in (p, q):
                assert squared_distance_of_point(x, triangle) <= (ON_SURFACE * size) ** 2
            checked += 1
    assert checked > 0 or not collide.any()


def test_points_of_meshes_are_on_both_exactly() -> None:
    trees = trees_of("box0", "star0", "cone1", "triangle", "open_sphere0")
    a, b = bodies_of(trees, 16, 0.3, 4)
    found, checked = oc.contacts(a, b), 0
    crossing = np.unique(oc.triangle_pairs(a, b).pairs)
    for n in crossing[:8].tolist():
        for bodies in (a, b):
            corners = exact_corners(bodies, n)
            for point in found.positions[n, : found.counts[n]]:
                assert distance_square(point, corners) <= (3 * ON_SURFACE) ** 2
                checked += 1
    assert checked > 30


@each("max_points", [4, 8])
def test_tables_are_as_promised(max_points: int) -> None:
    a, b = bodies_of(TREES, 80, 0.6, 14)
    found, apart = oc.contacts(a, b, max_points=max_points), oc.separations(a, b)
    assert found.depths.tolist() == np.maximum(-apart.separations, 0.0).tolist()
    assert found.normals.tolist() == apart.normals.tolist()
    assert ((found.counts > 0) == (apart.separations <= 0.0)).all()
    assert found.counts.max() == max_points
    assert (found.axes == -1).all()
    there = np.arange(max_points) < found.counts[:, None]
    assert np.isfinite(found.positions[there]).all()
    assert np.isnan(found.positions[~there]).all()
    assert np.isnan(found.position_depths[~there]).all()
    deepest = found.position_depths[:, :1]
    ordered = np.where(there, found.position_depths, -1.0)
    assert (ordered <= deepest + 1e-6)[found.counts > 0].all()
    assert (ordered <= found.depths[:, None]).all()
    assert (found.position_depths[there] >= 0.0).all()


def test_a_crate_on_a_shelf_has_its_four_corners() -> None:
    shelf, crate = (
        MeshTrees.build(4.0 * BOX_CORNERS, BOX_FACES),
        MeshTrees.build(BOX_CORNERS, BOX_FACES),
    )
    still = np.eye(3)[None]
    a = PlacedMeshes(shelf, [0], np.zeros((1, 3)), still)
    for height in (4.99, 5.0):  # sunk in, and resting: then edges lie in the plane
        b = PlacedMeshes(crate, [0], [[0.3, 0.2, height]], still)
        found = oc.contacts(a, b)
        assert found.counts[0] == 4
        flat = found.positions[0] - [0.3, 0.2, 4.0]
        np.testing.assert_allclose(np.abs(flat[:, 2]), 0.0, atol=1e-12)
        assert len(np.unique(np.sign(flat[:, :2]), axis=0)) == 4
        np.testing.assert_allclose(np.abs(flat[:, :2]), 1.0, atol=1e-12)
        assert found.depths[0] == pytest.approx(5.0 - height, abs=1e-8)


def test_one_point_where_no_surfaces_cross() -> None:
    tree = MeshTrees.join([MeshTrees.build(s * BOX_CORNERS, BOX_FACES) for s in (2.0, 0.25)])
    still = np.eye(3)[None]
    outer = PlacedMeshes(tree, [0], np.zeros((1, 3)), still)
    inner = PlacedMeshes(tree, [1], [[0.0, 0.0, 1.5]], still)
    found = oc.contacts(outer, inner)
    assert found.counts.tolist() == [1]
    assert 1.25 <= found.positions[0, 0, 2] <= 2.0  # between the lowest of the one and the wall
    beside = PlacedMeshes(tree, [1], [[0.0, 0.0, 2.5]], still)
    found = oc.contacts(outer, beside, radii_a=0.5)
    assert found.counts.tolist() == [1]
    assert found.depths[0] == pytest.approx(0.25, abs=1e-8)


#: Rounding of places, relative to the coordinates.
TOLERANCE = 1e-9


def corners(triangle: Floats) -> Triangle:
    (a, b, c), (d, e, f), (g, h, i) = triangle.tolist()
    return (a, b, c), (d, e, f), (g, h, i)


def any_frame(rng: np.random.Generator) -> FlatFrame:
    n = rng.normal(size=3)
    x, y, z = (n / np.linalg.norm(n)).tolist()
    return frame_of((x, y, z))


def exact_way(p: Floats, q: Floats, n: tuple[float, ...]) -> Fraction | None:
    """Return the largest t for which p and q + t n have a common point: of all features."""
    first, second = ([[Fraction(x) for x in v] for v in t.tolist()] for t in (p, q))
    way = [Fraction(x) for x in n]
    best: Fraction | None = None
    for ends, others in (((0, 1, 2), (0,)), ((0, 1), (0, 1)), ((0,), (0, 1, 2))):
        for s in range(3):
            for t in range(3):
                mine = [first[(s + k) % 3] for k in ends]
                theirs = [second[(t + k) % 3] for k in others]
                length = _solved(mine, theirs, way)
                if length is not None and (best is None or length > best):
                    best = length
    return best


def _solved(p: list[list[Fraction]], q: list[list[Fraction]], n: list[Fraction]) -> Fraction | None:
    """Return t where q + t n reaches p within both, None unless there is just one."""
    columns = [[x - y for x, y in zip(v, p[0], strict=True)] for v in p[1:]]
    columns += [[y - x for x, y in zip(v, q[0], strict=True)] for v in q[1:]]
    columns.append([-x for x in n])
    start = [y - x for x, y in zip(p[0], q[0], strict=True)]
    whole = _det(columns)
    if whole == 0:
        return None
    weights = [
        _det([start if k == i else c for k, c in enumerate(columns)]) / whole for i in (0, 1, 2)
    ]
    of_p, of_q = weights[: len(p) - 1], weights[len(p) - 1 : 2]
    inside = min(weights[:2]) >= 0 and sum(of_p) <= 1 and sum(of_q) <= 1
    return weights[2] if inside else None


def _det(m: list[list[Fraction]]) -> Fraction:
    (a, b, c), (d, e, f), (g, h, i) = m
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


@each("make", FAMILIES)
def test_never_too_short(make: Maker, pairs: int) -> None:
    """After the way out of all, the triangles are apart or touch, exactly."""
    rng = np.random.default_rng(5)
    seen = 0
    for _ in range(max(pairs // 200, 20)):
        p, q = make(rng)
        size = max(np.abs(p).max(), np.abs(q).max())
        if not 1e-3 < size < 1e9:  # kernels scale triangles to about one
            p, q = p / size, q / size
        size = max(np.abs(p).max(), np.abs(q).max())
        frame = any_frame(rng)
        found = way_out(corners(p), corners(q), frame, -np.inf)
        exact = exact_way(p, q, frame.n)
        if exact is None:
            continue
        seen += 1
        if found < float(exact) - TOLERANCE * size:  # only where what decides is a point wide
            way = [[Fraction(x) + exact * Fraction(y) for x, y in zip(v, frame.n, strict=True)]
                   for v in q.tolist()]  # fmt: skip
            still = [[Fraction(x) for x in v] for v in p.tolist()]
            assert squared_distance(still, way) == 0
            assert make.__name__.strip("_") in (
                "sliver",
                "degenerate",
                "small_grid",
                "different_sizes",
            )
    assert seen > 2 or make.__name__ == "extreme_sizes"


def test_ordinary_triangles_exactly() -> None:
    rng = np.random.default_rng(6)
    seen = 0
    for _ in range(100):
        p, q = rng.normal(size=(2, 3, 3))
        frame = any_frame(rng)
        found = way_out(corners(p), corners(q), frame, -np.inf)
        exact = exact_way(p, q, frame.n)
        if exact is None:
            assert found == -np.inf
        else:
            assert found == pytest.approx(float(exact), abs=1e-10)
            seen += 1
            assert way_out(corners(p), corners(q), frame, 99.0) == -np.inf
    assert seen > 15
