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

"""Convex hulls: told apart only where they are, and reported only where they nearly meet."""

from __future__ import annotations

from typing import Any

import numpy as np
from each import each
from mesh_zoo import zoo
from placed_meshes import collisions
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from obb_collision import MeshTrees, PlacedMeshes
from obb_collision.geometry.shapes.meshes import Hull
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.pool import HullPool, Hulls
from obb_collision.queries.meshes.convex import PlacedHulls, hulls_may_collide
from obb_collision.shapes import Cone, Cylinder
from obb_collision.typing import Floats

ZOO = zoo()
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
