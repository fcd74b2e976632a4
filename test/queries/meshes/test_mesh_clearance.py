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

"""Distances of meshes, and which are inside of others: exact, in both orders, at any size."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from convex_bodies import pool_of
from each import each
from exact_vectors import exact, minus, taxicab
from hull_distances import placed, squared_distance
from mesh_zoo import (
    SHARE,
    TRIANGLE,
    TRIANGLES,
    ZOO,
    Maker,
    as_drawn,
    bodies_of,
    collisions,
    exact_corners,
    place,
    standing,
    surface_distance,
    trees_of,
    verdict_of,
    windings,
)
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support import by_threads, refused
from trimesh import Trimesh, creation

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.geometry.trees import Hulls
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
from obb_collision.queries.meshes import MeshClearances, PlacedHulls, hulls_may_collide
from obb_collision.shapes import Cone, Cylinder, Hull
from obb_collision.typing import Floats

#: What the bounds may differ by, relative to the size of a pair.
CLOSE = Fraction(1, 10**9)


def size_of(a: PlacedMeshes, b: PlacedMeshes, n: int) -> Fraction:
    offset = taxicab(minus(exact(a.centers[n]), exact(b.centers[n])))
    return Fraction(offset + sum(Fraction(x.trees.radii[x.meshes[n]]) for x in (a, b)))


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


@each("make", TRIANGLES)
def test_triangles_against_exact_arithmetic(make: Maker, pairs: int) -> None:
    rng = np.random.default_rng(11)
    count = max(pairs // SHARE, 4)
    half = np.arange(count) < count // 2  # as drawn: the others are moved apart or into each other
    bodies: list[PlacedMeshes] = []
    for side in as_drawn([make(rng) for _ in range(count)]):
        scale = np.abs(side.trees.triangles).max(axis=1, keepdims=True)
        centers = scale * rng.normal(size=(count, 3)) * rng.integers(0, 2, (count, 1))
        rotations = Rotation.random(count, random_state=rng).as_matrix()
        rotations[rng.random(count) < 0.5] = np.eye(3)
        for first in bodies:
            centers[half], rotations[half] = first.centers[half], first.rotations[half]
        bodies.append(PlacedMeshes(side.trees, side.meshes, centers, rotations))
    found = oc.clearances(bodies[0], bodies[1])
    verdicts = oc.verdicts(bodies[0], bodies[1])
    back = oc.clearances(bodies[1], bodies[0])
    for n in range(count):
        (p,), (q,) = exact_corners(bodies[0], n), exact_corners(bodies[1], n)
        square, size = squared_distance(p, q), size_of(bodies[0], bodies[1], n)
        if verdicts[n] == Verdict.SEPARATE:
            check(found, n, square, size)
            check(back, n, square, size)
            assert found.upper[n] > 0.0
        else:
            assert square <= (size / 10**20) ** 2
            assert found.distances[n] == found.upper[n] == 0.0


def test_bounds_are_close_where_simplices_are_flat() -> None:
    """One of a thousand seemed to hold the origin, most of parallel faces: the distance was 0."""
    parallel = next(make for make in TRIANGLES if make.__name__ == "_parallel")
    rng = np.random.default_rng(11)
    a, b = as_drawn([parallel(rng) for _ in range(1000)])
    found = oc.clearances(a, b)
    assert (found.distances > 0.0).any()
    assert (found.upper - found.distances <= 1e-9 * (a.trees.radii + b.trees.radii)).all()


def test_meshes_against_exact_arithmetic() -> None:
    names = "box0", "star0", "hull0", "cone1", "triangle", "open_sphere0", "hollow0", "crumbs0"
    trees = trees_of(*names)
    a, b = bodies_of(trees, 60, 0.9, 3)
    found, verdicts = oc.clearances(a, b), oc.verdicts(a, b)
    apart = np.flatnonzero(verdicts == Verdict.SEPARATE)
    assert 20 < len(apart) < 58
    np.testing.assert_array_equal(found.distances > 0.0, verdicts == Verdict.SEPARATE)
    np.testing.assert_array_equal(found.upper > 0.0, verdicts == Verdict.SEPARATE)
    for n in apart[:5]:
        square = surface_distance(exact_corners(a, n), exact_corners(b, n), found.upper[n])
        check(found, n, square, size_of(a, b, n))


def test_points_are_on_the_faces_named() -> None:
    a, b = bodies_of(trees_of("torus1"), 50, 2.0, 5)
    found = oc.clearances(a, b)
    vertices, faces = (np.asarray(x) for x in ZOO["torus1"])
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
    vertices = [np.asarray(ZOO[name][0]) for name in ("hull1", "hull2", "box1")]
    apart = np.flatnonzero(found.distances > 0.0)
    assert len(apart) > 100
    for n in apart:
        p = vertices[a.meshes[n]] @ a.rotations[n].T + a.centers[n]
        q = vertices[b.meshes[n]] @ b.rotations[n].T + b.centers[n]
        gap = (q @ found.normals[n]).min() - (p @ found.normals[n]).max()
        assert gap == pytest.approx(found.distances[n], abs=1e-9)


def test_one_inside_the_other() -> None:
    """The distance from a body inside is zero for a solid, but not for a surface or a cavity."""
    box, ball = MeshTrees.from_half_extents([2.0, 2.0, 2.0]), MeshTrees.build(*ZOO["sphere2"])
    inner = standing(ball)
    found = oc.clearances(standing(box), inner)
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
    vertices, faces = ZOO["bumpy1"]
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
    bodies = standing(MeshTrees.build(*ZOO["box0"]))
    for radius in (-1.0, math.nan, math.inf, [1.0, 2.0], "much"):
        refused("radii_b must be", oc.clearances, bodies, bodies, radii_b=radius)
    refused("max_distance must be", oc.clearances, bodies, bodies, max_distance=-1.0)


CRUMB = (0.05 * ZOO["hull1"][0], ZOO["hull1"][1])


def test_one_solid_inside_another_collides_and_a_cavity_does_not() -> None:
    hollow = ZOO["hollow3"]
    assert verdict_of(place(*ZOO["sphere3"]), place(*CRUMB)) == Verdict.OVERLAP
    assert verdict_of(place(*hollow), place(*CRUMB)) == Verdict.SEPARATE
    within_wall = hollow[0][hollow[1][0]].mean(axis=0) * 0.93
    tiny = place(0.01 * CRUMB[0], CRUMB[1], within_wall)
    assert verdict_of(place(*hollow), tiny) == Verdict.OVERLAP


def test_an_open_surface_has_no_inside_but_may_lie_inside() -> None:
    flake = place(0.05 * ZOO["sheet1"][0], ZOO["sheet1"][1])
    assert verdict_of(place(*ZOO["open_sphere3"]), place(*CRUMB)) == Verdict.SEPARATE
    assert verdict_of(place(*ZOO["sphere3"]), flake) == Verdict.OVERLAP


def test_one_of_several_pieces_inside_is_enough() -> None:
    vertices = np.concatenate([CRUMB[0] + [aside, 0.0, 0.0] for aside in (2.0, 0.0, -2.0)])
    faces = np.concatenate([CRUMB[1] + k * len(CRUMB[0]) for k in range(3)])
    assert verdict_of(place(*ZOO["sphere3"]), place(vertices, faces)) == Verdict.OVERLAP


def test_inside_is_told_however_rays_graze() -> None:
    """Points on the planes, edges and diagonals of a fine box: parity against arithmetic."""
    mesh = creation.box((1.0, 1.0, 1.0)).subdivide().subdivide()
    cube = MeshTrees.build(mesh.vertices, mesh.faces)
    grid = np.array(np.meshgrid(*[np.linspace(-0.625, 0.625, 11)] * 3)).reshape(3, -1).T
    assert (points_inside(cube, grid) == (np.abs(grid) <= 0.5).all(axis=1)).all()


def points_inside(trees: MeshTrees, points: Floats) -> NDArray[np.bool_]:
    speck = MeshTrees.build([[0.0, 0.0, 0.0]], [[0, 0, 0]])
    return collisions(standing(trees, *np.zeros_like(points)), standing(speck, *points))


def test_solids_are_watertight_as_trimesh_says_and_inside_agrees_with_solid_angles() -> None:
    """Solids that overlap (the crumbs) and cavities included."""
    rng = np.random.default_rng(8)
    inside = 0
    for name, (vertices, faces) in ZOO.items():
        trees = MeshTrees.build(vertices, faces)
        assert trees.solid[0] == Trimesh(vertices, faces).is_watertight, name
        if trees.solid[0]:
            assert trees.winding[0], name
            points = rng.uniform(-0.5, 0.5, (200, 3))
            expected = np.abs(windings(vertices[faces], points)) > 0.5
            assert (points_inside(trees, points) == expected).all(), name
            inside += int(expected.sum())
    assert inside > 500


def test_inside_whatever_way_the_faces_point() -> None:
    vertices, faces = ZOO["bumpy1"]
    rng = np.random.default_rng(9)
    points = rng.uniform(-0.5, 0.5, (300, 3))
    expected = np.abs(windings(vertices[faces], points)) > 0.5
    turned = np.where(rng.random((len(faces), 1)) < 0.5, faces, faces[:, ::-1])
    double_sided = np.concatenate([faces, faces[:, ::-1]])
    for variant in (turned, double_sided):
        trees = MeshTrees.build(vertices, variant)
        assert trees.solid[0]
        assert (points_inside(trees, points) == expected).all()


def test_solids_with_a_wall_in_common_are_solid() -> None:
    """Two boxes side by side, each with the wall between them."""
    cube, cube_faces = BOX_CORNERS * 0.5, BOX_FACES
    vertices = np.concatenate([cube, cube + np.array([[1.0, 0.0, 0.0]])])
    trees = MeshTrees.build(vertices, np.concatenate([cube_faces, cube_faces + 8]))
    assert trees.solid[0]
    points = np.array([[0.1, 0.2, 0.3], [1.1, 0.2, 0.3], [1.6, 0.2, 0.3], [-0.4, 0.1, 0.1]])
    assert points_inside(trees, points).tolist() == [True, True, False, True]


COUNT = 20_000


def random_bodies(count: int, kinds: int, spread: float, seed: int) -> tuple[Any, Any, Any]:
    rng = np.random.default_rng(seed)
    rotations = Rotation.random(count, rng).as_matrix()
    return rng.integers(0, kinds, count), rng.uniform(-spread, spread, (count, 3)), rotations


def test_hulls_meet_where_their_surfaces_do_or_one_holds_the_other() -> None:
    meshes = [hull_mesh(Hull(ZOO[name][0])) for name in ZOO]
    meshes += [(0.2 * corners, faces) for corners, faces in meshes]
    meshes += [hull_mesh(shape) for shape in (Cylinder(0.2, 0.8), Cone(0.3, 0.6))]
    hulls = pool_of([corners for corners, _ in meshes])
    trees = MeshTrees.join([MeshTrees.build(*mesh) for mesh in meshes])
    a, b = (random_bodies(COUNT, len(meshes), 0.6, seed) for seed in (1, 2))
    rows = np.arange(COUNT)
    met = hulls_may_collide(PlacedHulls(hulls, *a), PlacedHulls(hulls, *b), rows, rows)
    truth = collisions(PlacedMeshes(trees, *a), PlacedMeshes(trees, *b))
    assert 0.2 < truth.mean() < 0.8
    assert not (truth & ~met).any()
    doubtful = np.flatnonzero(met & ~truth)
    assert len(doubtful) <= 0.001 * COUNT
    back = hulls_may_collide(PlacedHulls(hulls, *b), PlacedHulls(hulls, *a), rows, rows)
    assert not (truth & ~back).any()


def test_separate_means_that_a_plane_exists() -> None:
    """Fractions decide a few hundred pairs of hulls that are near each other."""
    names = [name for name in ZOO if len(ZOO[name][0]) < 40]
    corners = [Hull(ZOO[name][0]).points for name in names]
    hulls = pool_of(corners)
    a, b = (random_bodies(300, len(names), 0.5, seed) for seed in (3, 4))
    rows = np.arange(300)
    met = hulls_may_collide(PlacedHulls(hulls, *a), PlacedHulls(hulls, *b), rows, rows)
    for n in rows:
        sides = [placed(corners[kind[n]], center[n], turn[n]) for kind, center, turn in (a, b)]
        assert met[n] == (squared_distance(*sides) == 0)


def met_by(hulls: Hulls, rows: Any, others: Any, here: Floats, there: Floats) -> list[bool]:
    """Return which hulls at places collide with others at other places, none of them turned."""
    count, still = len(there), np.tile(np.eye(3), (len(there), 1, 1))
    a, b = PlacedHulls(hulls, rows, here, still), PlacedHulls(hulls, others, there, still)
    return list(hulls_may_collide(a, b, np.arange(count), np.arange(count)).tolist())


@each("scale", [2.0**-500, 2.0**-60, 1.0, 2.0**60, 2.0**500])
@each("far", [0.0, 2.0**20])
def test_any_size_and_any_place(scale: float, far: float) -> None:
    past, rows = 2.0 + 2.0**-9, np.zeros(5, np.int64)
    offsets = np.array([[1.5, 0, 0], [2, 0, 0], [2 + 2.0**-12, 0, 0], [2, 2, 2], [past, past, 0]])
    here = np.full((5, 3), far * scale)
    met = met_by(pool_of([scale * BOX_CORNERS]), rows, rows, here, here + scale * offsets)
    assert met == [True, True, False, True, False]


def test_flat_and_single_points() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    hulls = pool_of([square, square[:2], square[:1]])
    rows, others = np.array([0, 0, 1, 1, 2, 2, 0, 1]), np.array([0, 0, 1, 0, 2, 2, 2, 2])
    offsets = np.array(
        [[0.5, 0, 0], [0, 0, 1e-6], [0, 1e-6, 0], [0, 0, 0], [0, 0, 0], [1e-6, 0, 0],
         [0.5, 0.5, 0], [0.5, 1e-6, 0]]
    )  # fmt: skip
    met = met_by(hulls, rows, others, np.zeros((8, 3)), offsets)
    assert met == [True, False, False, True, True, False, True, False]


def test_any_number_of_threads_gives_the_same_bits() -> None:
    meshes = list(ZOO.values())[:12]
    trees = oc.MeshTrees.join([oc.MeshTrees.build(*mesh) for mesh in meshes])
    hulls = pool_of([hull_mesh(Hull(vertices))[0] for vertices, _ in meshes])
    places = random_bodies(6000, len(meshes), 0.6, 0)
    bodies, bulks = oc.PlacedMeshes(trees, *places), PlacedHulls(hulls, *places)
    pairs = np.arange(6000).reshape(2, -1).T

    def asked() -> list[bytes]:
        answers = (
            oc.verdicts(bodies, bodies, pairs),
            collisions(bodies, bodies, pairs),
            hulls_may_collide(bulks, bulks, *pairs.T),
        )
        assert all(0.1 < (answer != 0).mean() < 0.9 for answer in answers)
        return [answer.tobytes() for answer in answers]

    alone, *others = by_threads(asked, 1, 2, 5)
    assert others == [alone] * 2
