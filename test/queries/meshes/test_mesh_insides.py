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

"""Hulls and meshes: separation by corners, what is inside of solids, and threads."""

from __future__ import annotations

from typing import Any

import numpy as np
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray
from placed_meshes import collisions, place, standing, verdict_of, windings
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation
from support import by_threads
from trimesh import Trimesh, creation

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.geometry.trees import HullPool, Hulls
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
from obb_collision.queries.meshes import PlacedHulls, hulls_may_collide
from obb_collision.shapes import Cone, Cylinder, Hull
from obb_collision.typing import Floats

ZOO = zoo()


def test_one_solid_inside_another_collides_and_a_cavity_does_not() -> None:
    ball = ZOO["sphere3"]
    crumb = (0.05 * ZOO["hull1"][0], ZOO["hull1"][1])
    hollow = ZOO["hollow3"]
    assert verdict_of(place(*ball), place(*crumb)) == Verdict.OVERLAP
    assert verdict_of(place(*hollow), place(*crumb)) == Verdict.SEPARATE
    within_wall = (hollow[0][hollow[1][0]].mean(axis=0) * 0.93).tolist()
    tiny = (0.01 * crumb[0], crumb[1])
    assert verdict_of(place(*hollow), place(*tiny, offset=within_wall)) == Verdict.OVERLAP


def test_an_open_surface_has_no_inside_but_may_lie_inside() -> None:
    ball, bowl = ZOO["sphere3"], ZOO["open_sphere3"]
    crumb = (0.05 * ZOO["hull1"][0], ZOO["hull1"][1])
    flake = (0.05 * ZOO["sheet1"][0], ZOO["sheet1"][1])
    assert verdict_of(place(*bowl), place(*crumb)) == Verdict.SEPARATE
    assert verdict_of(place(*ball), place(*flake)) == Verdict.OVERLAP


def test_one_of_several_pieces_inside_is_enough() -> None:
    crumb = 0.05 * ZOO["hull1"][0]
    count = len(crumb)
    aside = np.array([[2.0, 0.0, 0.0]])
    vertices = np.concatenate([crumb + aside, crumb, crumb - aside])
    faces = np.concatenate([ZOO["hull1"][1] + k * count for k in range(3)])
    assert verdict_of(place(*ZOO["sphere3"]), place(vertices, faces)) == Verdict.OVERLAP


def test_inside_is_told_however_rays_graze() -> None:
    """Points on the planes, edges and diagonals of a fine box: parity against arithmetic."""
    mesh = creation.box((1.0, 1.0, 1.0)).subdivide().subdivide()
    cube = MeshTrees.build(mesh.vertices, mesh.faces)
    grid = np.array(np.meshgrid(*[np.linspace(-0.625, 0.625, 11)] * 3)).reshape(3, -1).T
    assert (points_inside(cube, grid) == (np.abs(grid) <= 0.5).all(axis=1)).all()


def test_solid_means_watertight_as_trimesh_says() -> None:
    for name, (vertices, faces) in ZOO.items():
        tree = MeshTrees.build(vertices, faces)
        assert tree.solid[0] == Trimesh(vertices, faces).is_watertight, name


def points_inside(trees: MeshTrees, points: Floats) -> NDArray[np.bool_]:
    speck = MeshTrees.build([[0.0, 0.0, 0.0]], [[0, 0, 0]])
    return collisions(standing(trees, *np.zeros_like(points)), standing(speck, *points))


def test_inside_agrees_with_solid_angles() -> None:
    """Solids that overlap (the crumbs) and cavities included."""
    rng = np.random.default_rng(8)
    inside = 0
    for name, (vertices, faces) in ZOO.items():
        trees = MeshTrees.build(vertices, faces)
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


def pool(corners: list[Floats]) -> Hulls:
    hulls = HullPool()
    for part in corners:
        hulls.append(Hulls.of(part))
    return hulls.all


def random_bodies(count: int, kinds: int, spread: float, seed: int) -> tuple[Any, Any, Any]:
    rng = np.random.default_rng(seed)
    rotations = Rotation.random(count, rng).as_matrix()
    return rng.integers(0, kinds, count), rng.uniform(-spread, spread, (count, 3)), rotations


def test_hulls_meet_where_their_surfaces_do_or_one_holds_the_other() -> None:
    meshes = [hull_mesh(Hull(ZOO[name][0])) for name in ZOO]
    meshes += [(0.2 * corners, faces) for corners, faces in meshes]
    meshes += [hull_mesh(shape) for shape in (Cylinder(0.2, 0.8), Cone(0.3, 0.6))]
    hulls = pool([corners for corners, _ in meshes])
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
    """Against linear programming, on a few hundred pairs that are near."""
    names = list(ZOO)[:20]
    corners = [Hull(ZOO[name][0]).points for name in names]
    hulls = pool(corners)
    a, b = (random_bodies(300, len(names), 0.5, seed) for seed in (3, 4))
    rows = np.arange(300)
    met = hulls_may_collide(PlacedHulls(hulls, *a), PlacedHulls(hulls, *b), rows, rows)
    for n in rows:
        p, q = (corners[side[0][n]] @ side[2][n].T + side[1][n] for side in (a, b))
        # w.p >= d + 1 and w.q <= d - 1 for some w, d
        table = np.block([[-p, np.ones((len(p), 1))], [q, -np.ones((len(q), 1))]])
        plane = linprog(np.zeros(4), table, -np.ones(len(table)), bounds=(None, None))
        assert met[n] == (not plane.success)


@each("scale", [2.0**-500, 2.0**-60, 1.0, 2.0**60, 2.0**500])
@each("far", [0.0, 2.0**20])
def test_any_size_and_any_place(scale: float, far: float) -> None:
    cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    hulls = pool([scale * cube])
    offsets = np.array(
        [
            [1.5, 0, 0],
            [2.0, 0, 0],
            [2.0 + 2.0**-12, 0, 0],
            [2, 2, 2],
            [2.0 + 2.0**-9, 2.0 + 2.0**-9, 0],
        ]
    )
    count = len(offsets)
    rows, still = np.zeros(count, np.int64), np.tile(np.eye(3), (count, 1, 1))
    here = np.full((count, 3), far * scale)
    a, b = (
        PlacedHulls(hulls, rows, here, still),
        PlacedHulls(hulls, rows, here + scale * offsets, still),
    )
    met = hulls_may_collide(a, b, np.arange(count), np.arange(count))
    assert met.tolist() == [True, True, False, True, False]


def test_flat_and_single_points() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    hulls = pool([square, square[:2], square[:1]])
    rows = np.array([0, 0, 1, 1, 2, 2, 0, 1])
    others = np.array([0, 0, 1, 0, 2, 2, 2, 2])
    offsets = np.array(
        [[0.5, 0, 0], [0, 0, 1e-6], [0, 1e-6, 0], [0, 0, 0], [0, 0, 0], [1e-6, 0, 0],
         [0.5, 0.5, 0], [0.5, 1e-6, 0]]
    )  # fmt: skip
    still = np.tile(np.eye(3), (8, 1, 1))
    a = PlacedHulls(hulls, rows, np.zeros((8, 3)), still)
    b = PlacedHulls(hulls, others, offsets, still)
    met = hulls_may_collide(a, b, np.arange(8), np.arange(8))
    assert met.tolist() == [True, False, False, True, True, False, True, False]


BODIES = 3000


def test_any_number_of_threads_gives_the_same_bits() -> None:
    meshes = list(zoo().values())[:12]
    trees = oc.MeshTrees.join([oc.MeshTrees.build(*mesh) for mesh in meshes])
    hulls = pool([hull_mesh(Hull(vertices))[0] for vertices, _ in meshes])
    places = random_bodies(2 * BODIES, len(meshes), 0.6, 0)
    bodies, bulks = oc.PlacedMeshes(trees, *places), PlacedHulls(hulls, *places)
    first, second = (np.arange(BODIES), np.arange(BODIES, 2 * BODIES))
    pairs = np.column_stack([first, second])

    def asked() -> list[bytes]:
        answers = (
            oc.verdicts(bodies, bodies, pairs),
            collisions(bodies, bodies, pairs),
            collisions(bodies, bodies, pairs, depth=3),
            hulls_may_collide(bulks, bulks, first, second),
        )
        assert all(0.1 < (answer != 0).mean() < 0.9 for answer in answers)
        return [answer.tobytes() for answer in answers]

    alone, *others = by_threads(asked, 1, 2, 5)
    assert others == [alone] * 2
