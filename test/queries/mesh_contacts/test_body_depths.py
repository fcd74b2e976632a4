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

"""Depths of round shapes in meshes: planes in extended precision, and pushes that are too short."""

from __future__ import annotations

import convex_bodies
import numpy as np
import pytest
from convex_bodies import FAMILIES, HULLS, KINDS, family, hulls
from convex_bodies import moved as with_columns
from convex_planes import exact_gap
from each import each
from mesh_zoo import zoo
from placed_meshes import bodies_of

from obb_collision import MeshTrees, PlacedMeshes
from obb_collision.queries.convex.distances import convex_distances
from obb_collision.queries.convex.mesh_distances import mesh_body_distances
from obb_collision.queries.convex.support import NO_HULLS, ConvexBodies
from obb_collision.queries.mesh_contacts.body_depths import within_bodies
from obb_collision.queries.verdict.separations import Separations
from obb_collision.typing import Floats, Integers

ROUND_KINDS = ("ellipsoid", "cylinder", "cone")
#: Promised: by how much a push may be too long, relative to the size of a pair.
CLOSE = 1e-9


def outer_of(normals: Floats, depths: Floats) -> Separations:
    each = np.repeat(np.arange(len(depths)), 2).reshape(-1, 2)
    return Separations(each, -depths, normals.copy(), np.zeros_like(normals))


def randoms(count: int, seed: int) -> Floats:
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])


def size_of(meshes: PlacedMeshes, body: ConvexBodies) -> Floats:
    size: Floats = meshes.trees.radii[meshes.meshes] + np.abs(body.sizes).sum(axis=1)
    return size + np.abs(meshes.centers - body.centers).sum(axis=1)


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
def test_a_depth_parts_triangles_and_bodies_and_nothing_shorter_does(
    name: str, kind: str, pairs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convex_bodies, "CORNERS_EACH", 3)
    pair = family(name, ("hull", kind), max(100, pairs // len(FAMILIES)), 15)
    corners = hulls(np.array(FAMILIES[name][0]))[1]
    trees = MeshTrees.join([MeshTrees.build(x, [[0, 1, 2]]) for x in corners])
    assert len(corners) == HULLS
    meshes = PlacedMeshes(trees, pair[0].rows, pair[0].centers, pair[0].rotations)
    rows, size = np.arange(len(meshes)), size_of(meshes, pair[1])
    far = 3.0 * size  # no pair of these needs more
    found = within_bodies(
        outer_of(randoms(len(rows), 3), far), meshes, np.zeros(len(rows)), pair[1]
    )
    deep = found.separations < 0.0
    world = 1e-15 * (np.abs(pair[0].centers).sum(axis=1) + np.abs(pair[1].centers).sum(axis=1))
    room = CLOSE * size + world
    lower = convex_distances(*pair, rows, rows)[0].lower
    assert (found.separations <= lower + room)[deep].all()  # no push parts them that is shorter
    given_up = deep & (found.separations <= -far)  # what was given stays
    assert given_up.sum() <= 1 + 0.02 * deep.sum()
    for share, sign in ((1.0, 1.0), (0.99, -1.0)):
        way = share * np.where(deep, -found.separations, 0.0) - (share < 1.0) * 4.0 * room
        then = with_columns(pair[1], centers=pair[1].centers + way[:, None] * found.normals)
        apart = convex_distances(pair[0], then, rows, rows)[0]
        gaps = exact_gap((pair[0], then), apart.normals).astype(float)
        touching = deep & ~given_up & (way > 0.0)
        tight = 8.0 * world + (CLOSE * size if sign < 0.0 else 0.0)
        assert (sign * gaps >= -tight)[touching].all()
    if name == "random":
        assert deep.any()
        assert not deep.all()


SIZES = {
    "ellipsoid": [0.1, 0.3, 0.2, 0.1],
    "cylinder": [0.2, 0.2, 0.0, 0.3],
    "cone": [0.2, 0.3, 0.0, 0.3],
}


def round_bodies(kind: str, centers: Floats, rotations: Floats, radius: float) -> ConvexBodies:
    count = len(centers)
    rows: Integers = np.zeros(count, np.int64)
    return ConvexBodies(
        np.full(count, KINDS[kind], np.int8), np.tile(SIZES[kind], (count, 1)),
        np.full(count, radius), NO_HULLS, rows, centers, rotations,
    )  # fmt: skip


@each("radius", [0.0, 0.03])
@each("kind", ROUND_KINDS)
def test_a_depth_parts_meshes_and_bodies_and_is_the_shortest_along_its_normal(
    kind: str, radius: float, pairs: int
) -> None:
    """All kinds of meshes; where they are apart, it is their distance."""
    trees = MeshTrees.join([MeshTrees.build(*mesh) for mesh in zoo().values()])
    count = max(pairs // 10, 60)
    a, b = bodies_of(trees, count, 0.5, 7)
    radii, rows = np.full(count, radius), np.arange(count)
    body = round_bodies(kind, b.centers, b.rotations, radius)
    found = within_bodies(outer_of(randoms(count, 5), np.full(count, 4.0)), a, radii, body)
    near = mesh_body_distances(a, radii, body, rows, rows)[0]
    apart = near.upper > 0.0
    np.testing.assert_array_equal(found.separations[apart], near.lower[apart])
    deep = ~apart
    assert deep.sum() > count // 4
    assert (found.separations[deep] > -4.0).all()
    short = 0
    for share in (1.0, 1.0 - 1e-6):
        centers = b.centers - share * np.minimum(found.separations, 0.0)[:, None] * found.normals
        then = mesh_body_distances(
            a, radii, round_bodies(kind, centers, b.rotations, radius), rows, rows
        )[0]
        if share == 1.0:
            assert (then.lower[deep] > 0.0).all()
        else:
            short = int((then.upper[deep] > 0.0).sum())
    assert short <= 0.1 * deep.sum()  # within solids
    assert np.isfinite(found.positions).all()
