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

"""Distances of meshes and bodies with a formula; the closest points of cores."""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import convex_bodies
import numpy as np
import pytest
from beyond_bodies import beyond
from convex_bodies import (
    CLOSE,
    FAMILIES,
    ROUND_KINDS,
    as_meshes,
    family,
    hulls,
    outward_faces,
    round_bodies,
    size_with,
    world_rounding,
)
from convex_planes import exact_gap
from each import each
from mesh_zoo import zoo
from placed_meshes import bodies_of, exact_corners, trees_of
from triangle_distances import squared_distance_of_point

from obb_collision import MeshTrees, PlacedMeshes
from obb_collision.queries.convex import convex_distances, mesh_body_distances


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
def test_bounds_of_triangles_are_proved_by_the_normal_and_attained_by_the_points(
    name: str, kind: str, pairs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convex_bodies, "CORNERS_EACH", 3)
    pair = family(name, ("hull", kind), max(50, pairs // len(FAMILIES)), 5)
    meshes = as_meshes(pair[0], name)
    rows = np.arange(len(meshes))
    found, near = mesh_body_distances(meshes, np.zeros(len(rows)), pair[1], rows, rows)
    assert near.all()
    apart = found.lower > 0.0
    normals = np.where(apart[:, None], found.normals, [1.0, 0.0, 0.0])
    assert (found.lower <= exact_gap(pair, normals))[apart].all()
    size = size_with(meshes, pair[1])
    assert (found.upper - found.lower <= CLOSE * size).all()
    if name == "random":
        assert apart.any()
        assert not apart.all()
    slack = 1e-13 * size + world_rounding(pair)
    assert (beyond(pair[1], found.positions_b)[apart] <= slack[apart]).all()
    for n in np.flatnonzero(apart)[:20].tolist():
        point = [Fraction(x) for x in found.positions_a[n].tolist()]
        (triangle,) = exact_corners(meshes, n)
        assert squared_distance_of_point(point, triangle) <= Fraction(slack[n]) ** 2


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
def test_convex_meshes_are_as_far_as_their_hulls(name: str, kind: str, pairs: int) -> None:
    """Those within each other among them: solids have no distance from what is in them."""
    pair = family(name, ("hull", kind), max(50, pairs // 100), 6)
    faces = [outward_faces(corners) for corners in hulls(np.ones(3))[1]]
    meshes, rows = as_meshes(pair[0], name, faces), np.arange(len(pair[0]))
    found = mesh_body_distances(meshes, np.zeros(len(rows)), pair[1], rows, rows)[0]
    truth, room = convex_distances(*pair, rows, rows)[0], CLOSE * size_with(meshes, pair[1])
    assert (found.lower <= truth.upper + room + world_rounding(pair)).all()
    assert (found.upper >= truth.lower - world_rounding(pair)).all()
    assert (found.upper - found.lower <= room).all()
    assert (found.lower == 0.0)[truth.lower < -room].all()


@cache
def meshes_and_their_triangles() -> tuple[MeshTrees, list[MeshTrees]]:
    trees = trees_of("star0", "torus0", "open_sphere1", "crumbs0", solid=False)
    parts = (trees.triangles[slice(*trees.starts[root])] for root in trees.roots)
    return trees, [
        MeshTrees.join([MeshTrees.build(t, [[0, 1, 2]]) for t in part.reshape(-1, 3, 3)])
        for part in parts
    ]


@each("kind", ROUND_KINDS)
def test_meshes_are_as_near_as_the_nearest_of_their_triangles(kind: str) -> None:
    trees, parts_of = meshes_and_their_triangles()
    a, b = bodies_of(trees, 40, 1.0, 7)
    bodies, rows = round_bodies(kind, b, 0.02), np.arange(40)
    found = mesh_body_distances(a, np.full(40, 0.01), bodies, rows, rows)[0]
    for n in rows[::3].tolist():
        triangles = parts_of[a.meshes[n]]
        count = len(triangles)
        alone = PlacedMeshes(
            triangles, range(count), np.tile(a.centers[n], (count, 1)),
            np.tile(a.rotations[n], (count, 1, 1)),
        )  # fmt: skip
        all_n = np.full(count, n)
        parts = mesh_body_distances(alone, np.full(count, 0.01), bodies, np.arange(count), all_n)[0]
        assert found.lower[n] <= parts.upper.min()
        assert found.lower[n] == pytest.approx(parts.lower.min(), abs=CLOSE)
    apart = np.linalg.norm(found.positions_b - found.positions_a, axis=1)
    assert (apart <= found.upper + 1e-14)[found.lower > 0.0].all()
    assert (found.lower > 0.0).sum() > 10
    assert (found.lower == 0.0).sum() > 3


def test_inside_of_a_solid_there_is_no_distance() -> None:
    tree = MeshTrees.join([MeshTrees.build(*zoo()["box0"], solid=s) for s in (True, False)])
    a = PlacedMeshes(tree, [0, 1], np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)))
    bodies, rows = round_bodies("cone", a, 0.02, [0.01, 0.01, 0.0, 0.01]), np.arange(2)
    found, near = mesh_body_distances(a, np.zeros(2), bodies, rows, rows)
    assert near.all()
    assert found.lower[0] == found.upper[0] == 0.0
    assert found.lower[1] > 0.05
    assert not mesh_body_distances(a, np.zeros(2), bodies, rows, rows, 0.01)[1][1]
