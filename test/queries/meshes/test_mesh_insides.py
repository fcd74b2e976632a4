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

"""Which meshes are solid, and what is inside them."""

from __future__ import annotations

import numpy as np
from mesh_zoo import zoo
from numpy.typing import NDArray
from placed_meshes import Faces, collisions, place, verdict_of
from trimesh import Trimesh, creation

from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
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
    speck = MeshTrees.build([[0.0, 0.0, 0.0]], [[0, 0, 0]])
    a = PlacedMeshes(
        cube, np.zeros(len(grid), int), np.zeros_like(grid), np.tile(np.eye(3), (len(grid), 1, 1))
    )
    b = PlacedMeshes(speck, np.zeros(len(grid), int), grid, np.tile(np.eye(3), (len(grid), 1, 1)))
    expected = (np.abs(grid) <= 0.5).all(axis=1)
    assert (collisions(a, b) == expected).all()


def test_solid_means_watertight_as_trimesh_says() -> None:
    for name, (vertices, faces) in ZOO.items():
        tree = MeshTrees.build(vertices, faces)
        assert tree.solid[0] == Trimesh(vertices, faces).is_watertight, name


def winds_about(vertices: Floats, faces: Faces, points: Floats) -> NDArray[np.bool_]:
    """Whether the solid angles of all triangles sum to something (Van Oosterom, Strackee 1983)."""
    a, b, c = (vertices[faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    top = np.einsum("nij,nij->ni", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("nij,nij->ni", u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2.0 * np.arctan2(top, la * lb * lc + ab * lc + bc * la + ca * lb)
    return np.abs(angle.sum(axis=1)) > 2.0 * np.pi


def points_inside(trees: MeshTrees, points: Floats) -> NDArray[np.bool_]:
    count = len(points)
    still, zero = np.tile(np.eye(3), (count, 1, 1)), np.zeros(count, np.int64)
    speck = MeshTrees.build([[0.0, 0.0, 0.0]], [[0, 0, 0]])
    body = PlacedMeshes(trees, zero, np.zeros((count, 3)), still)
    return collisions(body, PlacedMeshes(speck, zero, points, still))


def test_inside_agrees_with_solid_angles() -> None:
    """Solids that overlap (the crumbs) and cavities included."""
    rng = np.random.default_rng(8)
    inside = 0
    for name, (vertices, faces) in ZOO.items():
        trees = MeshTrees.build(vertices, faces)
        if trees.solid[0]:
            assert trees.winding[0], name
            points = rng.uniform(-0.5, 0.5, (200, 3))
            expected = winds_about(vertices, faces, points)
            assert (points_inside(trees, points) == expected).all(), name
            inside += int(expected.sum())
    assert inside > 500


def test_inside_whatever_way_the_faces_point() -> None:
    vertices, faces = ZOO["bumpy1"]
    rng = np.random.default_rng(9)
    points = rng.uniform(-0.5, 0.5, (300, 3))
    expected = winds_about(vertices, faces, points)
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
