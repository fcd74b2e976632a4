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

import convex_bodies
import numpy as np
import pytest
from beyond_bodies import beyond
from convex_bodies import FAMILIES, HULLS, KINDS, Pair, family, hulls
from convex_planes import exact_gap
from each import each
from mesh_zoo import zoo
from placed_meshes import bodies_of, exact_corners
from scipy.spatial import ConvexHull
from triangle_distances import squared_distance_of_point

from obb_collision import MeshTrees, PlacedMeshes
from obb_collision.queries.convex.directions import across, feet
from obb_collision.queries.convex.distance import search
from obb_collision.queries.convex.distances import convex_distances, mesh_body_distances
from obb_collision.queries.convex.support import (
    BOX,
    CONE,
    CYLINDER,
    NO_HULLS,
    SEGMENT,
    ConvexBodies,
    Core,
    support,
)
from obb_collision.queries.meshes.placed import Pose
from obb_collision.typing import Floats, Integers, Vector

ROUND_KINDS = ("ellipsoid", "cylinder", "cone")
#: Promised: how close the bounds are, relative to the size or the distance of a pair.
CLOSE = 1e-9


def as_meshes(body: ConvexBodies, scale: list[float], faces: list[Integers]) -> PlacedMeshes:
    """Return hulls as meshes of faces (n, 3) of their corners, one for each hull."""
    _, corners = hulls(np.array(scale))
    trees = [MeshTrees.build(x, f, solid=len(f) > 1) for x, f in zip(corners, faces, strict=True)]
    return PlacedMeshes(MeshTrees.join(trees), body.rows, body.centers, body.rotations)


def world_rounding(pair: Pair) -> Floats:
    a, b = pair
    return 1e-15 * (np.abs(a.centers).sum(axis=1) + np.abs(b.centers).sum(axis=1))


def size_of(meshes: PlacedMeshes, body: ConvexBodies) -> Floats:
    size: Floats = meshes.trees.radii[meshes.meshes] + np.abs(body.sizes).sum(axis=1)
    return size + np.abs(meshes.centers - body.centers).sum(axis=1)


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
def test_bounds_of_triangles_are_proved_by_the_normal_and_attained_by_the_points(
    name: str, kind: str, pairs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convex_bodies, "CORNERS_EACH", 3)
    pair = family(name, ("hull", kind), max(100, pairs // len(FAMILIES)), 5)
    meshes = as_meshes(pair[0], FAMILIES[name][0], [np.array([[0, 1, 2]])] * HULLS)
    rows = np.arange(len(meshes))
    found, near = mesh_body_distances(meshes, np.zeros(len(rows)), pair[1], rows, rows)
    assert near.all()
    apart = found.lower > 0.0
    normals = np.where(apart[:, None], found.normals, [1.0, 0.0, 0.0])
    assert (found.lower <= exact_gap(pair, normals))[apart].all()
    size = size_of(meshes, pair[1])
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


def faces_of_hulls() -> list[Integers]:
    """Return the faces (n, 3) of hulls, outwards: of those that are scaled as well."""
    found = []
    for corners in hulls(np.ones(3))[1]:
        hull = ConvexHull(corners)
        p, q, r = (corners[hull.simplices[:, k]] for k in range(3))
        inwards = np.einsum("ij,ij->i", np.cross(q - p, r - p), hull.equations[:, :3]) < 0.0
        found.append(np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices))
    return found


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
def test_convex_meshes_are_as_far_as_their_hulls(name: str, kind: str, pairs: int) -> None:
    """Those within each other among them: solids have no distance from what is in them."""
    pair = family(name, ("hull", kind), max(100, pairs // 100), 6)
    meshes, rows = as_meshes(pair[0], FAMILIES[name][0], faces_of_hulls()), np.arange(len(pair[0]))
    found = mesh_body_distances(meshes, np.zeros(len(rows)), pair[1], rows, rows)[0]
    truth, room = convex_distances(*pair, rows, rows)[0], CLOSE * size_of(meshes, pair[1])
    assert (found.lower <= truth.upper + room + world_rounding(pair)).all()
    assert (found.upper >= truth.lower - world_rounding(pair)).all()
    assert (found.upper - found.lower <= room).all()
    assert (found.lower == 0.0)[truth.lower < -room].all()


def round_bodies(kind: str, like: PlacedMeshes, sizes: list[float]) -> ConvexBodies:
    count = len(like)
    return ConvexBodies(
        np.full(count, KINDS[kind], np.int8), np.tile(sizes, (count, 1)), np.full(count, 0.02),
        NO_HULLS, np.zeros(count, np.int64), like.centers, like.rotations,
    )  # fmt: skip


SIZES = {
    "ellipsoid": [0.1, 0.3, 0.2, 0.1],
    "cylinder": [0.2, 0.2, 0.0, 0.3],
    "cone": [0.2, 0.3, 0.0, 0.3],
}


@each("kind", ROUND_KINDS)
def test_meshes_are_as_near_as_the_nearest_of_their_triangles(kind: str) -> None:
    names = ["star0", "torus0", "open_sphere1", "crumbs0"]
    trees = MeshTrees.join([MeshTrees.build(*zoo()[name], solid=False) for name in names])
    a, b = bodies_of(trees, 40, 1.0, 7)
    bodies, rows = round_bodies(kind, b, SIZES[kind]), np.arange(40)
    found = mesh_body_distances(a, np.full(40, 0.01), bodies, rows, rows)[0]
    for n in rows[::3].tolist():
        first, last = trees.starts[trees.roots[a.meshes[n]]]
        corners = trees.triangles[first:last].reshape(-1, 3, 3)
        each = MeshTrees.join([MeshTrees.build(t, [[0, 1, 2]]) for t in corners])
        count = len(corners)
        alone = PlacedMeshes(
            each, range(count), np.tile(a.centers[n], (count, 1)),
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
    bodies, rows = round_bodies("cone", a, [0.01, 0.01, 0.0, 0.01]), np.arange(2)
    found, near = mesh_body_distances(a, np.zeros(2), bodies, rows, rows)
    assert near.all()
    assert found.lower[0] == found.upper[0] == 0.0
    assert found.lower[1] > 0.05
    assert not mesh_body_distances(a, np.zeros(2), bodies, rows, rows, 0.01)[1][1]


CORES = [BOX, SEGMENT, CYLINDER, CONE]
STRAIGHT = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def core(kind: int, sizes: Floats) -> Core:
    x, y, z, half = sizes.tolist()
    size = (0.0, 0.0, 0.0) if kind == SEGMENT else (x, y, z if kind == BOX else 0.0)
    code: int = np.int8(kind)  # type: ignore[assignment]
    return Core(code, size, 0.0 if kind == BOX else half, NO_HULLS.blocks, 0, 0, 2.0, 0.0)


def is_in(body: Core, point: Vector) -> bool:
    sizes = np.array([[*body.size, body.half]])
    bodies = ConvexBodies(
        *(np.array([body.kind]), sizes, np.zeros(1), NO_HULLS, np.zeros(1, np.int64)),
        *(np.zeros((1, 3)), np.eye(3)[None]),
    )
    return bool(beyond(bodies, np.array([point]))[0] <= 1e-14)


@each("round_ends", [True, False])
@each("kind", CORES)
def test_feet_are_the_nearest_points(kind: int, round_ends: bool) -> None:
    rng = np.random.default_rng(kind)
    nearest = np.zeros(2, int)
    for _ in range(500):
        sizes, offset = rng.uniform(0.2, 1.0, 4), rng.normal(size=3)
        sizes[1] = sizes[0] if round_ends or kind == BOX else sizes[1]
        body, point = core(kind, sizes), core(SEGMENT, np.zeros(4))
        away = tuple((-offset / np.linalg.norm(offset)).tolist())
        pose = Pose(STRAIGHT, tuple(offset.tolist()), 5.0, 0.0, 0.0)
        p, q = (0.0, 0.0, 0.0), support(body, away)
        found = feet(point, body, pose, p, q)
        assert is_in(body, found.q)
        assert np.allclose(np.add(found.v, found.p), np.add(found.q, offset), rtol=0.0, atol=1e-15)
        assert found.square == pytest.approx(np.dot(found.v, found.v), rel=1e-14)
        assert found.square <= np.sum((np.array(q) + offset) ** 2)  # no farther than the foremost
        assert is_in(body, across(body.kind, body.size, body.half, q, found.q))
        truth = search(point, body, pose, (0.0, 0.0, 0.0), np.inf)
        if truth.gap > 1e-9:
            is_nearest = abs(np.sqrt(found.square) - truth.gap) <= 1e-12
            nearest += is_nearest, 1
            assert is_nearest or not round_ends
            # a plane between both, whoever says so
            flat = support(body, tuple((np.array(found.v) * -1.0).tolist()))
            reach = np.dot(found.v, np.add(flat, offset))
            assert not is_nearest or reach >= found.square - 1e-12
    assert nearest[1] > 200
    if not round_ends and kind in (CYLINDER, CONE):
        assert nearest[0] < nearest[1]


def test_the_ends_of_a_side_are_on_both_sides_of_the_foot() -> None:
    cylinder, cone = core(CYLINDER, np.ones(4)), core(CONE, np.ones(4))
    for body, p, foot, other in (
        (cylinder, (1.0, 0.0, 1.0), (1.0, 0.0, 0.3), (1.0, 0.0, -1.0)),
        (cylinder, (1.0, 0.0, 1.0), (0.2, 0.1, 1.0), (1.0, 0.0, 1.0)),
        (cone, (1.0, 0.0, -1.0), (0.5, 0.0, 0.0), (0.0, 0.0, 1.0)),
        (cone, (0.0, 0.0, 1.0), (0.5, 0.0, 0.0), (1.0, 0.0, -1.0)),
        (core(BOX, np.ones(4)), (1.0, 1.0, 1.0), (1.0, 0.5, 1.0), (1.0, -1.0, 1.0)),
    ):
        assert across(body.kind, body.size, body.half, p, foot) == other
