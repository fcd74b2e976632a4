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

"""Every level on every mesh: none misses what a more exact one reports; odd and huge ones."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh import creation

import obb_collision as oc
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import place_boxes
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.pool import HullPool, Hulls, mesh_tree
from obb_collision.queries.meshes.convex import PlacedHulls, hulls_may_collide
from obb_collision.queries.verdict.coarse import bounds_may_collide, spheres_may_collide
from obb_collision.queries.verdict.verdict import SEPARATE
from obb_collision.shapes import Mesh

ZOO = zoo()
LEVELS = ("sphere", "aabb", "obb", "hull", "mesh")
#: Pairs of meshes for each pair of boxes of ``--pairs``: 30,000 by default.
TIMES = 20
DEPTHS = (0, 1, 2, 3, 5, 8, 12)


@pytest.fixture(scope="module")
def meshes() -> list[Mesh]:
    """All meshes, and small copies of them, which come to lie within others."""
    whole = [Mesh(*mesh) for mesh in ZOO.values()]
    return whole + [Mesh(*mesh, scale=[0.15] * 3) for mesh in ZOO.values()]


@pytest.fixture(scope="module")
def stored(meshes: list[Mesh]) -> tuple[oc.MeshTrees, Hulls]:
    hulls = HullPool()
    for mesh in meshes:
        hulls.append(Hulls.of(hull_mesh(mesh)[0]))
    return oc.MeshTrees.join([mesh_tree(mesh) for mesh in meshes]), hulls.all


def world_boxes(meshes: list[Mesh], placed: oc.PlacedMeshes) -> Boxes:
    count = len(placed)
    local = [np.array([mesh.local_box[k] for mesh in meshes])[placed.meshes] for k in range(3)]
    boxes = Boxes.trusted(np.empty((count, 3)), np.empty((count, 3, 3)), local[2])
    place_boxes(
        placed.centers, placed.rotations, local[0], local[1], np.arange(count),
        boxes.centers, boxes.rotations,
    )  # fmt: skip
    return boxes


@each("spread, seed", [(0.3, 1), (0.6, 2), (1.0, 3)])
def test_no_level_misses_what_a_more_exact_one_reports(
    meshes: list[Mesh],
    stored: tuple[oc.MeshTrees, Hulls],
    spread: float,
    seed: int,
    pairs: int,
) -> None:
    """On 66 meshes, solids within solids included; each level by itself, nothing decided before."""
    assert len(ZOO) >= 60
    count = TIMES * pairs
    rng = np.random.default_rng(seed)
    kinds = rng.integers(0, len(meshes), 2 * count)
    quaternions = Rotation.random(2 * count, rng).as_quat()
    poses = np.concatenate([rng.uniform(-spread, spread, (2 * count, 3)), quaternions], axis=1)
    trees, hulls = stored
    placed = oc.PlacedMeshes.from_poses(trees, kinds, poses)
    convex = PlacedHulls(hulls, kinds, placed.centers, placed.rotations)
    boxes = world_boxes(meshes, placed)
    i, j = np.arange(count), np.arange(count, 2 * count)

    rows = np.stack([i, j], axis=1)
    mesh = oc.verdicts(placed, placed, rows, effort=0) != SEPARATE
    hull = hulls_may_collide(convex, convex, i, j)
    obb = oc.verdicts(boxes[i], boxes[j]) != SEPARATE
    assert 0.01 < mesh.mean() < hull.mean() < obb.mean() < 0.99
    assert not (mesh & ~hull).any()
    assert not (mesh & ~obb).any()
    finer = mesh
    for depth in reversed(DEPTHS):
        tree = oc.verdicts(placed, placed, rows, depth=depth) != SEPARATE
        assert not (finer & ~tree).any(), depth
        finer = tree
    assert (finer == obb).mean() > 0.9999  # the first node of a tree is the mesh's box
    for coarse in (spheres_may_collide, bounds_may_collide):
        assert not (obb & ~coarse(boxes, i, j)).any()


def odd_meshes() -> dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Return what files hold, all of it within a metre of the origin."""
    corners, faces = np.array(creation.box().vertices), np.array(creation.box().faces)
    line = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 0, 0]])
    rng = np.random.default_rng(2)
    return {
        "one triangle": (corners, faces[:1]),
        "a point thrice": (np.zeros((3, 3)), np.array([[0, 1, 2]])),
        "one vertex": (np.zeros((1, 3)), np.array([[0, 0, 0]])),
        "no area": (line, np.array([[0, 1, 2]] * 5)),
        "every face twice": (corners, np.concatenate([faces, faces])),
        "double-sided": (corners, np.concatenate([faces, faces[:, ::-1]])),
        "a fin": (corners, np.concatenate([faces, [[0, 1, 7]]])),
        "a hole": (corners, faces[1:]),
        "soup": (corners[faces].reshape(-1, 3), np.arange(36).reshape(-1, 3)),
        "flat and not": (corners, np.concatenate([faces, [[0, 0, 1], [2, 2, 2]]])),
        "slivers": (corners + 1e-12 * rng.normal(size=(8, 3)), np.repeat(faces, 20, axis=0)),
        "unused vertices": (np.concatenate([corners, 1e6 + corners]), faces),
        "thin": (corners * [1.0, 1.0, 1e-14], faces),
        "inside out": (corners, faces[:, ::-1]),
    }


ODD = {name: Mesh(*mesh) for name, mesh in odd_meshes().items()}
TORUS, BALL = Mesh(*ZOO["torus1"]), Mesh(*ZOO["sphere2"])


@each("name", ODD)
@each("level", LEVELS)
def test_odd_meshes_collide_where_they_are_and_not_where_they_are_not(
    name: str, level: str
) -> None:
    scene = oc.Scene(accuracy=level)
    scene.add("odd", ODD[name])
    scene.add("far", TORUS, [0, 0, 4.0, 0, 0, 0, 1])
    scene.add("ball", BALL, [5.0, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == []
    corner = ODD[name].vertices[ODD[name].faces[0]].mean(axis=0)
    scene.move("ball", [*(corner + 0.2), 0, 0, 0, 1])
    assert scene.check().names() == [("odd", "ball")]
    scene.move("odd", [3.0, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == []


def test_meshes_that_are_none_are_refused_before_anything_changes() -> None:
    scene = oc.Scene(accuracy="mesh")
    vertices, faces = ZOO["box0"]
    broken = vertices.copy()
    broken[5, 2] = np.nan
    with pytest.raises(ValueError, match="vertices must be finite in row 5"):
        scene.add("broken", Mesh(broken, faces))
    with pytest.raises(ValueError, match=r"faces must name vertices 0 to 7 in row 1"):
        Mesh(vertices, [[0, 1, 2], [0, 1, 8]])
    with pytest.raises(ValueError, match="must not be empty"):
        Mesh(np.empty((0, 3)), [])
    assert len(scene) == 0


@cache
def huge(subdivisions: int) -> Mesh:
    ball = creation.icosphere(subdivisions=subdivisions, radius=0.5)
    return Mesh(ball.vertices, ball.faces, fit="aabb")


@each("level", LEVELS)
def test_huge_meshes_are_decided_on_every_level(level: str, pairs: int) -> None:
    """20,480 triangles; with ``--pairs`` of 10,000 or more 1.3 million."""
    ball = huge(8 if pairs >= 10_000 else 5)
    scene = oc.Scene(accuracy=level)
    scene.add("a", ball)
    scene.add("b", ball, [0.8, 0.1, 0, 0, 0, 0, 1])
    scene.add("cup", Mesh(*ZOO["open_sphere1"]), [0, 0, 3.0, 0, 0, 0, 1])
    assert scene.check().names() == [("a", "b")]
    scene.move("b", [1.2, 0.9, 0.9, 0, 0, 0, 1])
    assert scene.check().names() == []
    scene.move("b", [0.75, 0.75, 0, 0, 0, 0, 1])  # their boxes meet
    apart = level in ("hull", "mesh")
    assert len(scene.check()) == (not apart)
