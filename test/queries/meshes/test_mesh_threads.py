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

"""Meshes and hulls are compared by several threads: the answers are those of one, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from placed_meshes import collisions
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.geometry.shapes.meshes import Hull
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.pool import HullPool, Hulls
from obb_collision.numerics.intrinsics import LANES, farthest, in_blocks
from obb_collision.queries.meshes.convex import PlacedHulls, hulls_may_collide

COUNT = 3000


@pytest.fixture(autouse=True)
def _restore() -> Iterator[None]:
    yield
    oc.set_threads(None)


@pytest.mark.parametrize("number", [2, 5])
def test_any_number_of_threads_gives_the_same(number: int) -> None:
    meshes = list(zoo().values())[:12]
    trees = oc.MeshTrees.join([oc.MeshTrees.build(*mesh) for mesh in meshes])
    hulls = HullPool()
    for vertices, _ in meshes:
        hulls.append(Hulls.of(hull_mesh(Hull(vertices))[0]))
    rng = np.random.default_rng(0)
    places = (
        rng.integers(0, len(meshes), 2 * COUNT),
        rng.uniform(-0.6, 0.6, (2 * COUNT, 3)),
        Rotation.random(2 * COUNT, rng).as_matrix(),
    )
    bodies, bulks = oc.PlacedMeshes(trees, *places), PlacedHulls(hulls.all, *places)
    first, second = np.arange(COUNT), np.arange(COUNT, 2 * COUNT)
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

    oc.set_threads(1)
    alone = asked()
    oc.set_threads(number)
    assert asked() == alone


@each("count", [1, 7, 8, 9, 40])
def test_the_farthest_point_is_the_first_of_the_farthest(count: int) -> None:
    rng = np.random.default_rng(count)
    points = rng.integers(-2, 3, (count, 3)).astype(float)  # many are equally far
    padding = np.full((1, 3, LANES), 9.0)  # blocks of others are not looked at
    blocks = np.concatenate([padding, in_blocks(points), padding])
    for direction in rng.integers(-2, 3, (100, 3)).astype(float):
        x, y, z = direction.tolist()
        expected = points[int((points @ direction).argmax())]
        assert farthest(blocks, 1, len(blocks) - 1, (x, y, z)) == tuple(expected)
