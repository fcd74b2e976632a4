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

"""Verdicts of triangles and meshes: exact, ordered by level, as peers see them, of bad input."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from each import each
from exact_vectors import cross, dot, exact, minus
from hull_distances import squared_distance, whole_numbers
from mesh_zoo import (
    NAMES,
    TRIANGLES,
    ZOO,
    Maker,
    Pair,
    bodies_of,
    collisions,
    coplanar,
    extreme_sizes,
    place,
    standing,
    trees_of,
    triangles,
    verdict_of,
)
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from support import refused

import obb_collision as oc
from obb_collision import Boxes, MeshTrees, PlacedMeshes, Verdict, verdicts
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS
from obb_collision.queries.meshes.triangles import exact_triangle_verdict
from obb_collision.typing import Floats

#: Pairs of bodies in the tests over all meshes.
PAIRS = 20_000


@each("spread, seed", [(0.25, 1), (0.9, 3)])
def test_a_cheaper_level_never_misses_what_an_exacter_one_reports(spread: float, seed: int) -> None:
    """Containment included: small meshes come to lie within solids."""
    assert len(NAMES) >= 60
    small = [MeshTrees.build(0.15 * ZOO[name][0], ZOO[name][1]) for name in NAMES]
    a, b = bodies_of(MeshTrees.join([trees_of(), *small]), PAIRS, spread, seed)
    mesh = collisions(a, b)
    assert 0.02 < mesh.mean() < 0.98
    assert (mesh == (oc.verdicts(a, b) != Verdict.SEPARATE)).all()
    within = np.flatnonzero(mesh)
    touched = np.unique(oc.triangle_pairs(a, b, np.stack([within, within], axis=1)).pairs)
    assert len(within) - len(touched) > 100  # one inside the other
    reported = verdicts(root_boxes(a), root_boxes(b)) != Verdict.SEPARATE
    assert (reported >= mesh).all()


def root_boxes(bodies: PlacedMeshes) -> Boxes:
    rows = bodies.trees.nodes[bodies.trees.roots[bodies.meshes]]
    centers = bodies.centers + np.einsum("nij,nj->ni", bodies.rotations, rows[:, :3])
    rotations = bodies.rotations @ rows[:, 3:12].reshape(-1, 3, 3)
    return Boxes(centers, rotations, rows[:, 12:15] * (1.0 + 1e-12))


def test_trees_lose_no_pair_of_triangles() -> None:
    """All contacts against every triangle with every other, placed in fractions of nothing."""
    rng = np.random.default_rng(5)
    for name, other in [("star2", "sheet2"), ("crumbs0", "annulus1")]:
        a = place(*ZOO[name])
        b = place(*ZOO[other], offset=rng.integers(-20, 21, 3) / 64.0)
        met = oc.triangle_pairs(a, b)
        corners = [v[f] + p.centers[0] for (v, f), p in ((ZOO[name], a), (ZOO[other], b))]
        i, j = (k.ravel() for k in np.indices((len(corners[0]), len(corners[1]))))
        met_alone = oc.verdicts(triangles(corners[0], i), triangles(corners[1], j))
        brute = met_alone == Verdict.OVERLAP
        expected = set(zip(i[brute].tolist(), j[brute].tolist(), strict=True))
        found = met.faces[met.verdicts == Verdict.OVERLAP]
        assert {(s, t) for s, t in found.tolist()} == expected
        assert met.count == len(met)
        few = oc.triangle_pairs(a, b, capacity=2)
        assert few.count == met.count
        assert len(few) == min(2, met.count)


@each("exact", [False, True])
def test_resting_contact(exact: bool) -> None:
    trees, least = MeshTrees.from_half_extents([[0.5, 0.5, 0.5]]), 2.0**-52
    past, short = [1 + least, 0.0, 0.0], [1 - least / 2, 0.25, 0.25]
    b = standing(trees, [1, 0, 0], past, short, [1, 1, 1], [0, 0, 0])
    a = standing(trees, *np.zeros((5, 3)))
    result = oc.verdicts(a, b, exact=exact)
    assert (result != Verdict.SEPARATE).tolist() == [True, False, True, True, True]


def test_a_box_is_the_mesh_of_its_corners() -> None:
    """Against the certified test of boxes; where both are certain they agree."""
    rng = np.random.default_rng(6)
    count = 4000
    half_extents = rng.uniform(0.05, 0.6, (2, 40, 3))
    rows = rng.integers(0, 40, (2, count))
    sides, boxes = [], []
    for k in range(2):
        centers = rng.uniform(-0.6, 0.6, (count, 3))
        rotations = Rotation.random(count, random_state=rng).as_matrix()
        trees = MeshTrees.from_half_extents(half_extents[k])
        sides.append(PlacedMeshes(trees, rows[k], centers, rotations))
        boxes.append(Boxes(centers, sides[k].rotations, half_extents[k][rows[k]]))
    truth = verdicts(boxes[0], boxes[1], exact=True)
    assert (oc.verdicts(sides[0], sides[1]) == truth).all()


def test_far_from_the_origin_and_of_any_size() -> None:
    a, b = ZOO["torus1"], ZOO["bumpy1"]
    rng = np.random.default_rng(7)
    offsets = rng.integers(-40, 41, (300, 3)) / 64.0

    def result(scale: float, far: float) -> list[int]:
        first, second = (MeshTrees.build(np.round(v * 2**20) / 2**20 * scale, f) for v, f in (a, b))
        here = np.full((300, 3), far)
        there = standing(second, *(here + offsets * scale))
        return list(oc.verdicts(standing(first, *here), there).tolist())

    expected = result(1.0, 0.0)
    assert len(set(expected)) > 1
    assert result(1.0, 2.0**40) == expected
    assert result(2.0**-500, 0.0) == expected
    assert result(2.0**500, 0.0) == expected


def test_bad_meshes_are_refused_or_right() -> None:
    vertices, faces = ZOO["box0"]
    broken = vertices.copy()
    broken[3, 1] = np.nan
    refused("row 3", MeshTrees.build, broken, faces)
    refused("faces must not be empty", MeshTrees.build, vertices, np.empty((0, 3), int))
    refused("faces must index vertices", MeshTrees.build, vertices, [[0, 1, 99]])
    refused("watertight", MeshTrees.build, *ZOO["sheet0"], solid=True)
    crumb = place(0.01 * ZOO["hull1"][0], ZOO["hull1"][1])
    twice = np.concatenate([faces, faces[::-1, [1, 2, 0]], [[0, 0, 1]]])
    assert verdict_of(place(vertices, twice), crumb) == Verdict.OVERLAP
    soup = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    assert verdict_of(place(*soup), crumb) == Verdict.OVERLAP
    fin = np.concatenate([faces, [[0, 1, 7]]])  # non-manifold: an edge with three faces
    assert not MeshTrees.build(vertices, fin).solid[0]
    point = place([[0.0, 0.0, 0.0]], [[0, 0, 0]])
    assert verdict_of(place(vertices, faces), point) == Verdict.OVERLAP
    assert verdict_of(point, point) == Verdict.TOUCHING


def test_many_faces_in_one_place_end() -> None:
    """Nothing to split by: 20,000 copies of a triangle, against as many."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    heap = place(np.tile(vertices, (20_000, 1)), np.arange(60_000).reshape(-1, 3))
    above = place(vertices + np.array([[0.0, 0.0, 0.5]]), [[0, 1, 2]])
    across = place(vertices[:, [2, 1, 0]] + np.array([[0.25, 0.0, -0.5]]), [[0, 1, 2]])
    assert verdict_of(heap, above) == Verdict.SEPARATE
    assert verdict_of(heap, across) == Verdict.OVERLAP


def test_posed_triangles_that_nearly_touch_are_never_judged_wrongly() -> None:
    """A corner or edge within 1e-12 to 1e-17 of a face or edge, under poses: against integers."""
    rng = np.random.default_rng(10)
    count = 100
    wrong = decided = 0
    rotations = Rotation.random(2 * count, random_state=rng).as_matrix()
    for n in range(count):
        ra, rb = rotations[2 * n], rotations[2 * n + 1]
        a, b = rng.normal(size=(2, 3, 3))
        target = rng.dirichlet([1, 1, 1]) @ a if n % 2 else rng.random() * (a[1] - a[0]) + a[0]
        source = b[0] if n % 4 < 2 else 0.5 * (b[0] + b[1])
        gap = 10.0 ** rng.uniform(-17, -12) * rng.normal(size=3)
        offset = ra @ target - rb @ source + gap
        first = PlacedMeshes(MeshTrees.build(a, [[0, 1, 2]]), [0], np.zeros((1, 3)), ra[None])
        second = PlacedMeshes(MeshTrees.build(b, [[0, 1, 2]]), [0], offset[None], rb[None])
        verdict = oc.verdicts(first, second)[0]
        truth = exact_triangle_verdict(a.ravel(), first.place(0), b.ravel(), second.place(0))
        decided += verdict != Verdict.TOUCHING
        wrong += verdict not in (Verdict.TOUCHING, truth)
        assert oc.verdicts(first, second, exact=True)[0] == truth
    assert wrong == 0
    assert decided > 0.95 * count


SEVERAL = 16


def triangle_verdicts(a: ArrayLike, b: ArrayLike, exact: bool = False) -> NDArray[np.int8]:
    """Return the verdict of each triangle of a (n, 3, 3) with that of b."""
    return oc.verdicts(triangles(a), triangles(b), exact=exact)


def _pairs(maker: Maker, count: int) -> Pair:
    rng = np.random.default_rng(TRIANGLES.index(maker))
    made = [maker(rng) for _ in range(count)]
    return np.array([a for a, _ in made]), np.array([b for _, b in made])


@each("maker", TRIANGLES)
def test_against_exact_arithmetic(maker: Maker) -> None:
    """In either order, whichever corner is the first, and of a quarter of the size."""
    a, b = _pairs(maker, SEVERAL)
    truth = np.array([triangle_verdict(x, y) for x, y in zip(a, b, strict=True)])
    one, other = triangles(a), triangles(b)
    certified = oc.verdicts(one, other)
    decided = certified != Verdict.TOUCHING
    assert (certified[decided] == truth[decided]).all()
    assert (oc.verdicts(one, other, exact=True) == truth).all()
    assert (oc.verdicts(other, one, exact=True) == truth).all()
    few, scale = slice(0, SEVERAL, 4), 1.0 if maker is extreme_sizes else 0.25
    turned = a[few][:, [2, 0, 1]] * scale, b[few][:, [1, 0, 2]] * scale
    assert (triangle_verdicts(*turned, exact=True) == truth[few]).all()


def test_ordinary_pairs_are_all_decided() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 300, 3, 3))
    assert (triangle_verdicts(a, b) != Verdict.TOUCHING).all()


def test_apart_in_one_plane_is_separate_without_integers() -> None:
    one, other = (triangles(side) for side in _pairs(coplanar, 150))
    certified, truth = oc.verdicts(one, other), oc.verdicts(one, other, exact=True)
    assert (certified == truth).all()
    assert set(truth.tolist()) == {Verdict.SEPARATE, Verdict.TOUCHING}


def test_a_gap_below_rounding_is_seen() -> None:
    """Twice the digits: 1e-25 between parallel faces, edges and corners is SEPARATE."""
    face = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    above = face + np.array([0.0, 0.0, 1e-25])
    beside = np.array([[1.0, 1e-25, 0.0], [2.0, 0.0, 1.0], [2.0, 1.0, -1.0]])
    assert (triangle_verdicts([face, face], [above, beside]) == Verdict.SEPARATE).all()


def test_surfaces_agree_with_fcl() -> None:
    """On every pair but those where a nudge of 1e-9 m changes our own verdict."""
    fcl = pytest.importorskip("fcl")
    surfaces = trees_of(solid=False)
    a, b = bodies_of(surfaces, PAIRS, 0.5, 4)
    ours = collisions(a, b)
    theirs = fcl_hits(fcl, a, b)
    for row in np.flatnonzero(ours != theirs).tolist():
        assert near_touching(a, b, row, 1e-9), f"pair {row}: ours {ours[row]}"
    assert 0.1 < ours.mean() < 0.9


def fcl_hits(fcl: Any, a: PlacedMeshes, b: PlacedMeshes) -> NDArray[np.bool_]:
    models = []
    for name in NAMES:
        model = fcl.BVHModel()
        model.beginModel(len(ZOO[name][0]), len(ZOO[name][1]))
        model.addSubModel(*ZOO[name])
        model.endModel()
        models.append(model)
    hits = np.empty(len(a), np.bool_)
    for n in range(len(a)):
        objects = [
            fcl.CollisionObject(
                models[side.meshes[n]], fcl.Transform(side.rotations[n], side.centers[n])
            )
            for side in (a, b)
        ]
        hits[n] = fcl.collide(*objects, fcl.CollisionRequest(), fcl.CollisionResult()) > 0
    return hits


def near_touching(a: PlacedMeshes, b: PlacedMeshes, n: int, distance: float) -> bool:
    nudges = distance * np.concatenate([np.eye(3), -np.eye(3), BOX_CORNERS])
    rows = np.full(len(nudges), n)
    moved = PlacedMeshes(b.trees, b.meshes[rows], b.centers[rows] + nudges, b.rotations[rows])
    found = collisions(a, moved, np.stack([rows, np.arange(len(nudges))], axis=1))
    return bool(found.any() and not found.all())


def triangle_verdict(a: Floats, b: Floats) -> Verdict:
    """Return the verdict of corners (3, 3) and (3, 3), exactly, by their differences.

    OVERLAP: each small move leaves a common point, so the origin is amid the hull of differences.
    Else a plane through it has all of them on one side, and, where they span space, one that goes
    through two of them has, too.
    """
    first, second = ([exact(corner) for corner in side] for side in (a, b))
    if squared_distance(first, second) > 0:
        return Verdict.SEPARATE
    p, q, _ = whole_numbers(first, second)
    differences = [minus(x, y) for x in p for y in q]
    normals = [cross(u, v) for u, v in combinations(differences, 2)]
    heights = [[dot(normal, x) for x in differences] for normal in normals if any(normal)]
    spanned = any(any(row) for row in heights)
    amid = all(min(row) < 0 < max(row) for row in heights)
    return Verdict.OVERLAP if spanned and amid else Verdict.TOUCHING
