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

"""Meshes: the order of the levels, agreement with python-fcl and coal, solids, and bad input."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mesh_zoo import zoo
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from trimesh import Trimesh, creation

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES, MeshTrees
from obb_collision.queries.meshes.meshes import (
    PlacedMeshes,
    mesh_collisions,
    mesh_contacts,
    mesh_verdicts,
)
from obb_collision.queries.meshes.triangle_exact import exact_triangle_verdict
from obb_collision.queries.meshes.triangles import triangle_verdicts
from obb_collision.queries.verdict.verdict import Verdict, verdicts
from obb_collision.typing import Floats

Faces = NDArray[np.int64]

ZOO = zoo()
NAMES = list(ZOO)
#: Pairs of bodies in the tests over all meshes.
PAIRS = 40_000


@pytest.fixture(scope="module")
def trees() -> MeshTrees:
    return MeshTrees.join([MeshTrees.build(*ZOO[name]) for name in NAMES])


def _bodies(
    trees: MeshTrees, count: int, spread: float, seed: int
) -> tuple[PlacedMeshes, PlacedMeshes]:
    """Random meshes at random poses."""
    rng = np.random.default_rng(seed)
    sides = []
    for _ in range(2):
        meshes = rng.integers(0, len(trees), count)
        rotations = Rotation.random(count, random_state=rng).as_matrix()
        sides.append(
            PlacedMeshes(trees, meshes, rng.uniform(-spread, spread, (count, 3)), rotations)
        )
    return sides[0], sides[1]


def _place(vertices: ArrayLike, faces: ArrayLike, offset: ArrayLike = (0, 0, 0)) -> PlacedMeshes:
    trees = MeshTrees.build(vertices, faces)
    return PlacedMeshes(trees, [0], np.asarray(offset)[None], np.eye(3)[None])


def _verdict(a: PlacedMeshes, b: PlacedMeshes, exact: bool = False) -> Verdict:
    forward, backward = mesh_verdicts(a, b, exact=exact)[0], mesh_verdicts(b, a, exact=exact)[0]
    assert forward == backward
    return Verdict(forward)


@pytest.mark.parametrize(("spread", "seed"), [(0.25, 1), (0.5, 2), (0.9, 3)])
def test_a_cheaper_level_never_misses_what_an_exacter_one_reports(
    trees: MeshTrees, spread: float, seed: int
) -> None:
    """Containment included: small meshes come to lie within solids. 120,000 pairs in all."""
    assert len(NAMES) >= 60
    small = MeshTrees.join([trees, MeshTrees.join(_shrunk(0.15))])
    a, b = _bodies(small, PAIRS, spread, seed)
    mesh = mesh_collisions(a, b)
    assert 0.02 < mesh.mean() < 0.98
    assert (mesh == (mesh_verdicts(a, b) != Verdict.SEPARATE)).all()
    within = np.flatnonzero(mesh)
    touched = np.unique(mesh_contacts(a, b, np.stack([within, within], axis=1))[0][:, 0])
    assert len(within) - len(touched) > 100  # one inside the other
    finer = mesh
    for depth in (6, 3, 1, 0):
        coarser = mesh_collisions(a, b, depth=depth)
        assert (coarser >= finer).all(), f"depth {depth} misses pairs"
        finer = coarser
    reported = verdicts(_root_boxes(a), _root_boxes(b)) != Verdict.SEPARATE
    assert (reported >= finer).all()


def _shrunk(scale: float) -> list[MeshTrees]:
    return [MeshTrees.build(ZOO[name][0] * scale, ZOO[name][1]) for name in NAMES]


def _root_boxes(bodies: PlacedMeshes) -> Boxes:
    rows = bodies.trees.nodes[bodies.trees.roots[bodies.meshes]]
    centers = bodies.centers + np.einsum("nij,nj->ni", bodies.rotations, rows[:, :3])
    rotations = bodies.rotations @ rows[:, 3:12].reshape(-1, 3, 3)
    return Boxes(centers, rotations, rows[:, 12:15] * (1.0 + 1e-12))


@pytest.mark.parametrize("peer", ["fcl", "coal"])
def test_surfaces_agree_with_peers(trees: MeshTrees, peer: str) -> None:
    """On every pair but those where a nudge of 1e-9 m changes our own verdict."""
    module = pytest.importorskip(peer)
    surfaces = MeshTrees.join([MeshTrees.build(*ZOO[name], solid=False) for name in NAMES])
    a, b = _bodies(surfaces, PAIRS, 0.5, 4)
    ours = mesh_collisions(a, b)
    theirs = (_fcl_hits if peer == "fcl" else _coal_hits)(module, a, b)
    for row in np.flatnonzero(ours != theirs).tolist():
        assert _near_touching(a, b, row, 1e-9), f"pair {row}: ours {ours[row]}"
    assert 0.1 < ours.mean() < 0.9


def _fcl_hits(fcl: Any, a: PlacedMeshes, b: PlacedMeshes) -> NDArray[np.bool_]:
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


def _coal_hits(coal: Any, a: PlacedMeshes, b: PlacedMeshes) -> NDArray[np.bool_]:
    models = []
    for name in NAMES:
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(ZOO[name][1]), len(ZOO[name][0]))
        model.addVertices(ZOO[name][0])
        model.addTriangles(ZOO[name][1])
        model.endModel()
        models.append(model)
    hits = np.empty(len(a), np.bool_)
    for n in range(len(a)):
        sides = [
            part
            for side in (a, b)
            for part in (
                models[side.meshes[n]], coal.Transform3s(side.rotations[n], side.centers[n])
            )
        ]  # fmt: skip
        hits[n] = coal.collide(*sides, coal.CollisionRequest(), coal.CollisionResult()) > 0
    return hits


def _near_touching(a: PlacedMeshes, b: PlacedMeshes, n: int, distance: float) -> bool:
    nudges = distance * np.concatenate([np.eye(3), -np.eye(3), BOX_CORNERS])
    rows = np.full(len(nudges), n)
    moved = PlacedMeshes(b.trees, b.meshes[rows], b.centers[rows] + nudges, b.rotations[rows])
    return (
        len(
            set(
                mesh_collisions(a, moved, np.stack([rows, np.arange(len(nudges))], axis=1)).tolist()
            )
        )
        == 2
    )


def test_trees_lose_no_pair_of_triangles() -> None:
    """All contacts against every triangle with every other, placed in fractions of nothing."""
    rng = np.random.default_rng(5)
    for name, other in [("torus1", "bumpy1"), ("star2", "sheet2"), ("crumbs0", "annulus1")]:
        a = _place(*ZOO[name])
        b = _place(*ZOO[other], offset=rng.integers(-20, 21, 3) / 64.0)
        contacts, count = mesh_contacts(a, b)
        corners = [v[f] + p.centers[0] for (v, f), p in ((ZOO[name], a), (ZOO[other], b))]
        i, j = (k.ravel() for k in np.indices((len(corners[0]), len(corners[1]))))
        brute = triangle_verdicts(corners[0][i], corners[1][j]) == Verdict.OVERLAP
        expected = set(zip(i[brute].tolist(), j[brute].tolist(), strict=True))
        found = contacts[contacts[:, 3] == Verdict.OVERLAP]
        assert {(s, t) for _, s, t, _ in found.tolist()} == expected
        assert count == len(contacts)
        few, true_count = mesh_contacts(a, b, capacity=2)
        assert true_count == count
        assert len(few) == min(2, count)


def test_one_solid_inside_another_collides_and_a_cavity_does_not() -> None:
    ball = ZOO["sphere3"]
    crumb = (0.05 * ZOO["hull1"][0], ZOO["hull1"][1])
    hollow = ZOO["hollow3"]
    assert _verdict(_place(*ball), _place(*crumb)) == Verdict.OVERLAP
    assert _verdict(_place(*hollow), _place(*crumb)) == Verdict.SEPARATE
    within_wall = (hollow[0][hollow[1][0]].mean(axis=0) * 0.93).tolist()
    tiny = (0.01 * crumb[0], crumb[1])
    assert _verdict(_place(*hollow), _place(*tiny, offset=within_wall)) == Verdict.OVERLAP


def test_an_open_surface_has_no_inside_but_may_lie_inside() -> None:
    ball, bowl = ZOO["sphere3"], ZOO["open_sphere3"]
    crumb = (0.05 * ZOO["hull1"][0], ZOO["hull1"][1])
    flake = (0.05 * ZOO["sheet1"][0], ZOO["sheet1"][1])
    assert _verdict(_place(*bowl), _place(*crumb)) == Verdict.SEPARATE
    assert _verdict(_place(*ball), _place(*flake)) == Verdict.OVERLAP


def test_one_of_several_pieces_inside_is_enough() -> None:
    crumb = 0.05 * ZOO["hull1"][0]
    count = len(crumb)
    aside = np.array([[2.0, 0.0, 0.0]])
    vertices = np.concatenate([crumb + aside, crumb, crumb - aside])
    faces = np.concatenate([ZOO["hull1"][1] + k * count for k in range(3)])
    assert _verdict(_place(*ZOO["sphere3"]), _place(vertices, faces)) == Verdict.OVERLAP


def test_inside_is_told_however_rays_graze() -> None:
    """Points on the planes, edges and diagonals of a fine box: parity against arithmetic."""
    mesh = creation.box((1.0, 1.0, 1.0)).subdivide().subdivide()
    cube = MeshTrees.build(mesh.vertices, mesh.faces)
    grid = np.array(np.meshgrid(*[np.linspace(-0.625, 0.625, 11)] * 3)).reshape(3, -1).T
    speck = MeshTrees.build([[0.0, 0.0, 0.0]], [[0, 0, 0]])
    a = PlacedMeshes(
        cube, np.zeros(len(grid), int), np.zeros_like(grid), np.tile(np.eye(3), (len(grid), 1, 1))
    )
    b = PlacedMeshes(speck, np.zeros(len(grid), int), grid, np.tile(np.eye(3), (len(grid), 1, 1)))
    expected = (np.abs(grid) <= 0.5).all(axis=1)
    assert (mesh_collisions(a, b) == expected).all()


@pytest.mark.parametrize("exact", [False, True])
def test_resting_contact(exact: bool) -> None:
    trees = MeshTrees.from_half_extents([[0.5, 0.5, 0.5]])
    offsets: list[list[float]] = [
        [1.0, 0, 0],
        [1.0 + 2.0**-52, 0, 0],
        [1.0 - 2.0**-53, 0.25, 0.25],
        [1, 1, 1],
        [0, 0, 0],
    ]
    a = PlacedMeshes(trees, [0] * 5, np.zeros((5, 3)), np.tile(np.eye(3), (5, 1, 1)))
    b = PlacedMeshes(trees, [0] * 5, offsets, np.tile(np.eye(3), (5, 1, 1)))
    result = mesh_verdicts(a, b, exact=exact)
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
    assert (mesh_verdicts(sides[0], sides[1]) == truth).all()


def test_far_from_the_origin_and_of_any_size() -> None:
    a, b = ZOO["torus1"], ZOO["bumpy1"]
    rng = np.random.default_rng(7)
    offsets = rng.integers(-40, 41, (300, 3)) / 64.0
    rotations = np.tile(np.eye(3), (300, 1, 1))
    zero = np.zeros(300, int)

    def result(scale: float, far: float) -> list[int]:
        first, second = (MeshTrees.build(np.round(v * 2**20) / 2**20 * scale, f) for v, f in (a, b))
        here = np.full((300, 3), far)
        return mesh_verdicts(
            PlacedMeshes(first, zero, here, rotations),
            PlacedMeshes(second, zero, here + offsets * scale, rotations),
        ).tolist()

    expected = result(1.0, 0.0)
    assert len(set(expected)) > 1
    assert result(1.0, 2.0**40) == expected
    assert result(2.0**-500, 0.0) == expected
    assert result(2.0**500, 0.0) == expected


def test_bad_meshes_are_refused_or_right() -> None:
    vertices, faces = ZOO["box0"]
    broken = vertices.copy()
    broken[3, 1] = np.nan
    with pytest.raises(ValueError, match="row 3"):
        MeshTrees.build(broken, faces)
    with pytest.raises(ValueError, match="faces must not be empty"):
        MeshTrees.build(vertices, np.empty((0, 3), int))
    with pytest.raises(ValueError, match="faces must name vertices"):
        MeshTrees.build(vertices, [[0, 1, 99]])
    with pytest.raises(ValueError, match="watertight"):
        MeshTrees.build(*ZOO["sheet0"], solid=True)
    crumb = _place(0.01 * ZOO["hull1"][0], ZOO["hull1"][1])
    twice = np.concatenate([faces, faces[::-1, [1, 2, 0]], [[0, 0, 1]]])
    assert _verdict(_place(vertices, twice), crumb) == Verdict.OVERLAP
    soup = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    assert _verdict(_place(*soup), crumb) == Verdict.OVERLAP
    fin = np.concatenate([faces, [[0, 1, 7]]])  # non-manifold: an edge with three faces
    assert not MeshTrees.build(vertices, fin).solid[0]
    point = _place([[0.0, 0.0, 0.0]], [[0, 0, 0]])
    assert _verdict(_place(vertices, faces), point) == Verdict.OVERLAP
    assert _verdict(point, point) == Verdict.TOUCHING


def test_solid_means_watertight_as_trimesh_says() -> None:
    for name, (vertices, faces) in ZOO.items():
        tree = MeshTrees.build(vertices, faces)
        assert tree.solid[0] == Trimesh(vertices, faces).is_watertight, name


def test_many_faces_in_one_place_end() -> None:
    """Nothing to split by: 20,000 copies of a triangle, against as many."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    heap = _place(np.tile(vertices, (20_000, 1)), np.arange(60_000).reshape(-1, 3))
    above = _place(vertices + np.array([[0.0, 0.0, 0.5]]), np.array([[0, 1, 2]]))
    across = _place(vertices[:, [2, 1, 0]] + np.array([[0.25, 0.0, -0.5]]), np.array([[0, 1, 2]]))
    assert _verdict(heap, above) == Verdict.SEPARATE
    assert _verdict(heap, across) == Verdict.OVERLAP


def _winds_about(vertices: Floats, faces: Faces, points: Floats) -> NDArray[np.bool_]:
    """Whether the solid angles of all triangles sum to something (Van Oosterom, Strackee 1983)."""
    a, b, c = (vertices[faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    top = np.einsum("nij,nij->ni", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("nij,nij->ni", u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2.0 * np.arctan2(top, la * lb * lc + ab * lc + bc * la + ca * lb)
    return np.abs(angle.sum(axis=1)) > 2.0 * np.pi


def _points_inside(trees: MeshTrees, points: Floats) -> NDArray[np.bool_]:
    count = len(points)
    still, zero = np.tile(np.eye(3), (count, 1, 1)), np.zeros(count, np.int64)
    speck = MeshTrees.build([[0.0, 0.0, 0.0]], [[0, 0, 0]])
    body = PlacedMeshes(trees, zero, np.zeros((count, 3)), still)
    return mesh_collisions(body, PlacedMeshes(speck, zero, points, still))


def test_inside_agrees_with_solid_angles() -> None:
    """Solids that overlap (the crumbs) and cavities included."""
    rng = np.random.default_rng(8)
    inside = 0
    for name, (vertices, faces) in ZOO.items():
        trees = MeshTrees.build(vertices, faces)
        if trees.solid[0]:
            assert trees.winding[0], name
            points = rng.uniform(-0.5, 0.5, (200, 3))
            expected = _winds_about(vertices, faces, points)
            assert (_points_inside(trees, points) == expected).all(), name
            inside += int(expected.sum())
    assert inside > 500


def test_inside_whatever_way_the_faces_point() -> None:
    vertices, faces = ZOO["bumpy1"]
    rng = np.random.default_rng(9)
    points = rng.uniform(-0.5, 0.5, (300, 3))
    expected = _winds_about(vertices, faces, points)
    turned = np.where(rng.random((len(faces), 1)) < 0.5, faces, faces[:, ::-1])
    double_sided = np.concatenate([faces, faces[:, ::-1]])
    for variant in (turned, double_sided):
        trees = MeshTrees.build(vertices, variant)
        assert trees.solid[0]
        assert (_points_inside(trees, points) == expected).all()


def test_solids_with_a_wall_in_common_are_solid() -> None:
    """Two boxes side by side, each with the wall between them."""
    cube, cube_faces = BOX_CORNERS * 0.5, BOX_FACES
    vertices = np.concatenate([cube, cube + np.array([[1.0, 0.0, 0.0]])])
    trees = MeshTrees.build(vertices, np.concatenate([cube_faces, cube_faces + 8]))
    assert trees.solid[0]
    points = np.array([[0.1, 0.2, 0.3], [1.1, 0.2, 0.3], [1.6, 0.2, 0.3], [-0.4, 0.1, 0.1]])
    assert _points_inside(trees, points).tolist() == [True, True, False, True]


def test_posed_triangles_that_nearly_touch_are_never_judged_wrongly() -> None:
    """A corner or edge within 1e-12 to 1e-17 of a face or edge, under poses: against integers."""
    rng = np.random.default_rng(10)
    count = 400
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
        verdict = mesh_verdicts(first, second)[0]
        truth = exact_triangle_verdict(a.ravel(), first.place(0), b.ravel(), second.place(0))
        decided += verdict != Verdict.TOUCHING
        wrong += verdict not in (Verdict.TOUCHING, truth)
        assert mesh_verdicts(first, second, exact=True)[0] == truth
    assert wrong == 0
    assert decided > 0.95 * count
