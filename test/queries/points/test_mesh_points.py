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

"""Clouds in meshes: what is inside, on the surface, within a margin; against other arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from mesh_zoo import zoo
from placed_meshes import bodies_of, exact_corners
from scipy.spatial.transform import Rotation
from triangle_distances import squared_distance

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.queries.meshes.meshes import PlacedMeshes
from obb_collision.queries.points.points import points_inside
from obb_collision.typing import Floats

SOLIDS = ["star1", "bumpy1", "torus2", "hollow1", "crumbs2", "hull1", "annulus0"]
DOUBT = Fraction(1, 2**42)


def placed_corners(bodies: PlacedMeshes, row: int) -> Floats:
    """Return the corners (m, 3, 3) of a body in the world, rounded."""
    trees, mesh = bodies.trees, bodies.meshes[row]
    first, last = trees.starts[trees.roots[mesh]]
    corners = trees.triangles[first:last].reshape(-1, 3, 3)
    placed: Floats = corners @ bodies.rotations[row].T + bodies.centers[row]
    return placed


def windings(triangles: Floats, points: Floats) -> Floats:
    """Return how often a surface winds about points: by solid angles (Van Oosterom, Strackee)."""
    a, b, c = (triangles[None, :, k] - points[:, None] for k in range(3))
    x, y, z = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    top = np.einsum("npk,npk->np", a, np.cross(b, c))
    low = x * y * z
    for u, v, w in ((a, b, z), (b, c, x), (c, a, y)):
        low += np.einsum("npk,npk->np", u, v) * w
    total: Floats = np.arctan2(top, low).sum(axis=1) / (2.0 * np.pi)
    return total


def test_what_is_inside_of_solids() -> None:
    trees = MeshTrees.join([MeshTrees.build(*zoo()[name]) for name in SOLIDS])
    assert trees.solid.all()
    bodies = bodies_of(trees, 12, 0.6, 41)[0]
    points = np.random.default_rng(42).uniform(-1.2, 1.2, (600, 3))
    found = points_inside(bodies, points, each_point=True)
    lowest = np.full(len(points), -1)
    for row in range(len(bodies)):
        inside = np.abs(windings(placed_corners(bodies, row), points)) > 0.5
        rows = np.flatnonzero(inside)
        lowest[inside & (lowest < 0)] = row
        assert found.counts[row] == len(rows)
        assert found.first[row] == (rows[0] if len(rows) else -1)
    assert (found.counts > 0).sum() > 6
    np.testing.assert_array_equal(found.boxes, lowest)


def test_the_surface_is_inside() -> None:
    names = [*SOLIDS, "sheet1", "open_sphere2", "triangle"]
    trees = MeshTrees.join([MeshTrees.build(*zoo()[name]) for name in names])
    rng = np.random.default_rng(43)
    for row, body in enumerate(np.arange(len(names))):
        turn = Rotation.random(random_state=rng).as_matrix()[None]
        bodies = PlacedMeshes(trees, [body], rng.normal(size=(1, 3)), turn)
        corners = placed_corners(bodies, 0)
        weights = rng.dirichlet([1.0, 1.0, 1.0], len(corners))
        points = np.concatenate([np.einsum("nk,nkc->nc", weights, corners), corners[:, 0]])
        assert points_inside(bodies, points).counts[0] == len(points), names[row]


def test_a_surface_holds_only_what_is_on_it() -> None:
    body = PlacedMeshes(
        MeshTrees.build(*zoo()["sphere3"], solid=False), [0], np.zeros((1, 3)), np.eye(3)[None]
    )
    points = np.random.default_rng(44).uniform(-0.4, 0.4, (500, 3))
    assert points_inside(body, points).counts[0] == 0


def test_boxes_and_their_meshes_hold_the_same() -> None:
    rng = np.random.default_rng(45)
    half_extents, centers = rng.uniform(0.1, 1.0, (20, 3)), rng.uniform(-2.0, 2.0, (20, 3))
    turns = Rotation.random(20, random_state=rng).as_matrix()
    meshes = PlacedMeshes(MeshTrees.from_half_extents(half_extents), range(20), centers, turns)
    points = rng.uniform(-3.0, 3.0, (4000, 3)).astype(np.float32)
    points[7] = np.nan
    for margin in (0.0, 0.1):
        one = points_inside(Boxes(centers, turns, half_extents), points, margin, each_point=True)
        other = points_inside(meshes, points, margin, each_point=True)
        np.testing.assert_array_equal(one.boxes, other.boxes)
        for name in ("counts", "first", "nearest", "ignored"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("name", ["sheet0", "box0", "triangle"])
def test_margins_against_fractions(name: str) -> None:
    """Points moved from the surface by the margin, a little more and a little less."""
    rng = np.random.default_rng(46)
    tree = MeshTrees.build(*zoo()[name], solid=False)
    turn = Rotation.random(random_state=rng).as_matrix()[None]
    body = PlacedMeshes(tree, [0], rng.normal(size=(1, 3)), turn)
    triangles, corners = exact_corners(body, 0), placed_corners(body, 0)
    margin, decided = 0.125, 0
    for n in range(40):
        face = corners[rng.integers(len(corners))]
        normal = np.cross(face[1] - face[0], face[2] - face[0])
        excess = rng.choice([0.0, 1e-15, -1e-15, 1e-12, -1e-12, 1e-6, -1e-6])
        away = (margin + excess) * normal / np.linalg.norm(normal)
        point = rng.dirichlet([1.0, 1.0, 1.0]) @ face + away
        held = points_inside(body, point[None], margin).counts[0] == 1
        p = [Fraction(x) for x in point.tolist()]
        square = min(squared_distance([p, p, p], t) for t in triangles)
        if square <= Fraction(margin) ** 2:
            assert held, n
        elif held:
            size = Fraction(tree.radii[0]) + 1
            assert square <= (Fraction(margin) + DOUBT * size) ** 2
        else:
            decided += 1
    assert 0 < decided < 40
