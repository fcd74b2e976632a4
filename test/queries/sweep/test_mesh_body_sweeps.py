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

"""Sweeps of meshes and round shapes: planes in extended precision, and meshes within the shapes."""

from __future__ import annotations

import convex_bodies
import numpy as np
import pytest
from convex_bodies import FAMILIES, HULLS, KINDS, hulls
from each import each
from mesh_zoo import zoo
from moving_bodies import moving
from placed_meshes import bodies_of
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from test_hull_sweeps import MOST_UNDECIDED, PLANE, TOO_FEW_DIGITS, gaps_at, near_of

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes
from obb_collision.queries.convex.mesh_distances import mesh_body_distances
from obb_collision.queries.convex.support import NO_HULLS, ConvexBodies
from obb_collision.queries.sweep.course import BodyMotion
from obb_collision.queries.sweep.meshes import swept_mesh_bodies
from obb_collision.queries.sweep.sweep import TOLERANCE, Sweeps
from obb_collision.queries.verdict.verdict import OVERLAP
from obb_collision.typing import Floats

ROUND_KINDS = ("ellipsoid", "cylinder", "cone")
SIZES = {
    "ellipsoid": [0.1, 0.3, 0.2, 0.1],
    "cylinder": [0.2, 0.2, 0.0, 0.3],
    "cone": [0.2, 0.3, 0.0, 0.3],
}


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
@each("way", ["straight", "turning", "fast"])
def test_a_plane_parts_triangles_and_bodies_until_then_and_they_are_near_at_last(
    name: str, kind: str, way: str, pairs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convex_bodies, "CORNERS_EACH", 3)
    bodies, motion, rows = moving(name, ("hull", kind), max(30, pairs // 10), 14, way)
    count = len(rows)
    corners = hulls(np.array(FAMILIES[name][0]))[1]
    trees = MeshTrees.join([MeshTrees.build(x, [[0, 1, 2]]) for x in corners])
    assert len(corners) == HULLS
    meshes = PlacedMeshes(
        trees, bodies.rows[:count], bodies.centers[:count], bodies.rotations[:count]
    )
    second = ConvexBodies(
        bodies.kinds[count:], bodies.sizes[count:], bodies.radii[count:], NO_HULLS,
        0 * bodies.rows[count:], bodies.centers[count:], bodies.rotations[count:],
    )  # fmt: skip
    found = swept_mesh_bodies(
        meshes, bodies.radii[:count], second, motion, np.zeros(count), TOLERANCE
    )
    near, until = near_of(motion, rows), np.minimum(found.free_until, 1.0)
    assert np.isnan(found.times[found.undecided]).all()
    for share in (0.1, 0.5, 0.9, 0.99, 0.9999, 1.0):
        gaps, upper, size = gaps_at(bodies, motion, rows, share * until)
        on = until > 0.0
        assert (gaps[on] >= -(PLANE * size)[on]).all()
    assert (upper[found.hits] <= (near + PLANE * size)[found.hits]).all()
    assert found.hits.any()
    assert name in TOO_FEW_DIGITS or found.undecided.mean() <= 0.02 + MOST_UNDECIDED[way]


def inner_mesh(kind: str, size: list[float]) -> MeshTrees:
    """Return a mesh whose corners are on a shape, so that all of it is within."""
    x, y, z, half = size
    t = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    ring = np.column_stack([x * np.cos(t), y * np.sin(t), np.full(40, half)])
    if kind == "ellipsoid":
        v = np.random.default_rng(1).normal(size=(200, 3))
        v /= np.linalg.norm(v, axis=1)[:, None]
        points = v * [x, y, z] + np.outer(np.copysign(half, v[:, 2]), [0, 0, 1])
    elif kind == "cylinder":
        points = np.concatenate([ring, ring * [1, 1, -1]])
    else:
        points = np.concatenate([ring * [1, 1, -1], [[0.0, 0.0, half]]])
    points = points * (1.0 - 1e-9)
    hull = ConvexHull(points)
    p, q, r = (points[hull.simplices[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(q - p, r - p), hull.equations[:, :3]) < 0.0
    return MeshTrees.build(
        points, np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices)
    )


def round_bodies(kind: str, at: PlacedMeshes, radius: float = 0.0) -> ConvexBodies:
    count = len(at)
    return ConvexBodies(
        np.full(count, KINDS[kind], np.int8), np.tile(SIZES[kind], (count, 1)),
        np.full(count, radius), NO_HULLS, np.zeros(count, np.int64), at.centers, at.rotations,
    )  # fmt: skip


def swept(a: PlacedMeshes, b: ConvexBodies, twists: list[Floats], radius: float = 0.0) -> Sweeps:
    """Sweep bodies with twists for a second, with a radius about the mesh."""
    centers = np.concatenate([a.centers, b.centers])
    ways = np.concatenate(twists)
    radii = np.ones(2 * len(a))
    motion = BodyMotion(
        centers, ways[:, :3].copy(), 1.0, np.concatenate([a.rotations, b.rotations]),
        ways[:, 3:].copy(), 0.0 * centers, radii, 3.0 * radii,
    )  # fmt: skip
    return swept_mesh_bodies(a, np.full(len(a), radius), b, motion, np.zeros(len(a)), TOLERANCE)


def later(bodies: PlacedMeshes, twists: Floats, times: Floats) -> PlacedMeshes:
    turns = Rotation.from_rotvec(twists[:, 3:] * times[:, None]).as_matrix()
    centers = bodies.centers + twists[:, :3] * times[:, None]
    return PlacedMeshes(bodies.trees, bodies.meshes, centers, turns @ bodies.rotations)


@each("spin", [0.0, 1.0, 12.0])
@each("kind", ROUND_KINDS)
def test_meshes_do_not_overlap_what_is_in_the_shape_until_then(
    kind: str, spin: float, pairs: int
) -> None:
    """And at last are near the shape itself; all kinds of meshes."""
    trees = MeshTrees.join([MeshTrees.build(*mesh) for mesh in zoo().values()])
    count = max(pairs // 20, 60)
    a, b = bodies_of(trees, count, 0.9, 5)
    within = PlacedMeshes(
        inner_mesh(kind, SIZES[kind]), np.zeros(count, np.int64), b.centers, b.rotations
    )
    rng = np.random.default_rng(6)
    twists = [rng.normal(size=(count, 6)) * rng.choice([0.0, 1.0], (count, 1)) for _ in range(2)]
    twists = [t * np.array([1, 1, 1, spin, spin, spin]) for t in twists]
    found = swept(a, round_bodies(kind, within), twists)
    until = np.minimum(found.free_until, 1.0)
    for share in (*np.linspace(0.05, 0.95, 12), 0.999, 1.0 - 1e-12):
        x, y = (later(s, t, share * until) for s, t in zip((a, within), twists, strict=True))
        assert (oc.verdicts(x, y)[until > 0.0] != OVERLAP).all()
    x, y = (later(s, t, until) for s, t in zip((a, within), twists, strict=True))
    rows = np.arange(count)
    gaps = mesh_body_distances(x, np.zeros(count), round_bodies(kind, y), rows, rows)[0].upper
    assert (gaps[found.hits] <= TOLERANCE * (1.0 + 1e-6)).all()
    assert found.hits.sum() > 10
    assert (~found.hits & ~found.undecided).sum() > 3
    assert found.undecided.mean() <= 0.02


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.123, 1.0])
def test_a_cylinder_meets_a_wall_at_its_very_radius(angle: float) -> None:
    """However it is turned about its axis, and with radii; a mesh around it would be early."""
    vertices, faces = zoo()["fine_box0"]
    face = float(np.abs(vertices[:, 0]).max())
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()[None]
    wall = PlacedMeshes(MeshTrees.build(vertices, faces), [0], np.zeros((1, 3)), np.eye(3)[None])
    there = PlacedMeshes(wall.trees, [0], [[2.0, 0.01, 0.02]], turn)
    for spin in (0.0, 5.0):
        twists = [np.zeros((1, 6)), np.array([[-2.0, 0, 0, 0, 0, spin]])]
        found = swept(wall, round_bodies("cylinder", there, 0.03), twists, 0.05)
        truth = (2.0 - face - 0.2 - 0.08) / 2.0
        assert truth - TOLERANCE <= found.times[0] <= truth
        np.testing.assert_allclose(found.normals[0], [1, 0, 0], atol=1e-6)
        assert found.positions[0, 0] == pytest.approx(face + 0.05, abs=2e-4)


def test_what_starts_inside_of_a_solid_is_hit_at_once() -> None:
    tree = MeshTrees.build(*zoo()["box0"])
    box = PlacedMeshes(tree, [0], np.zeros((1, 3)), np.eye(3)[None])
    body = round_bodies("cone", box)
    body.sizes[:] *= 0.01
    found = swept(box, body, [np.zeros((1, 6)), np.ones((1, 6))])
    assert (found.hits.tolist(), found.times.tolist()) == ([True], [0.0])
    assert not found.normals.any()
