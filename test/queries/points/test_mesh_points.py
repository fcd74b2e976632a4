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

"""Points in meshes and in shapes with a formula, against fractions and planes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from convex_bodies import KINDS, around, bodies, corners_of, moved, some
from each import each
from exact_bodies import beyond
from exact_vectors import exact, taxicab
from hull_distances import squared_distance
from mesh_zoo import (
    bodies_of,
    exact_corners,
    place,
    placed_corners,
    standing,
    trees_of,
    windings,
    zoo,
)
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from triangle_pairs import FAMILIES, SHARE, Maker

from obb_collision import Boxes, MeshTrees, PlacedMeshes, points_inside
from obb_collision.queries.convex.support import CORNERS, SEGMENT, ConvexBodies
from obb_collision.queries.points import points_in_bodies
from obb_collision.typing import Floats, Mask

SOLIDS = ["star1", "bumpy1", "torus2", "hollow1", "crumbs2", "hull1", "annulus0"]
#: How near to the surface a point outside may count as inside, of size and offset,
DOUBT = Fraction(1, 2**41)
#: also where a face is as narrow as this, so that every ray may pass too near to an edge.
NARROW, NARROW_DOUBT = 1e-6, Fraction(1, 10**9)


def test_what_is_inside_of_solids() -> None:
    trees = trees_of(*SOLIDS)
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
    trees = trees_of(*SOLIDS, "sheet1", "open_sphere2", "triangle")
    rng = np.random.default_rng(43)
    for body in range(len(trees)):
        turn = Rotation.random(random_state=rng).as_matrix()[None]
        bodies = PlacedMeshes(trees, [body], rng.normal(size=(1, 3)), turn)
        corners = placed_corners(bodies, 0)
        weights = rng.dirichlet([1.0, 1.0, 1.0], len(corners))
        points = np.concatenate([np.einsum("nk,nkc->nc", weights, corners), corners[:, 0]])
        assert points_inside(bodies, points).counts[0] == len(points), body


def test_a_surface_holds_only_what_is_on_it() -> None:
    body = standing(MeshTrees.build(*zoo()["sphere3"], solid=False))
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


@each("name", ["sheet0", "box0", "triangle"])
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
        square = min(squared_distance([exact(point)], t) for t in triangles)
        if square <= Fraction(margin) ** 2:
            assert held, n
        elif held:
            size = Fraction(tree.radii[0]) + 1
            assert square <= (Fraction(margin) + DOUBT * size) ** 2
        else:
            decided += 1
    assert 0 < decided < 40


def least_height(triangles: Floats) -> float:
    """Return how narrow the narrowest of triangles is, of their size; (k, 3, 3)."""
    edges = (triangles - np.roll(triangles, 1, axis=1)) / np.abs(triangles).max()
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    return float((areas / np.maximum(longest, 1e-300)).min())


@each("make", FAMILIES)
def test_tetrahedra_of_all_kinds_against_fractions(make: Maker, pairs: int) -> None:
    """Points on corners, edges and faces, inside, outside, and a rounding off all these."""
    rng = np.random.default_rng(47)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    weights = np.array(
        [[1, 0, 0, 0], [0.5, 0.5, 0, 0], [0.25, 0.5, 0.25, 0], [0.25] * 4, [0.5, 0.5, -0.25, 0.25]]
    )
    held_ones = 0
    for n in range(max(pairs // SHARE // len(weights), 4)):
        first, second = make(rng)
        corners = np.concatenate([first, second[:1]])[rng.permutation(4)]
        doubt = NARROW_DOUBT if least_height(corners[faces]) < NARROW else DOUBT
        turn = Rotation.random(random_state=rng).as_matrix() if n % 2 else np.eye(3)
        center = rng.normal(size=3) * np.abs(corners).max() if n % 4 > 1 else np.zeros(3)
        margin = rng.choice([0.0, 0.01]) * np.abs(corners).max()
        body = PlacedMeshes(MeshTrees.build(corners, faces), [0], center[None], turn[None])
        points = weights @ corners @ turn.T + center
        points *= 1.0 + rng.choice([0.0, 1e-16, 1e-13, 1e-9]) * rng.normal(size=points.shape)
        whole = [corner for triangle in exact_corners(body, 0) for corner in triangle]
        held = [points_inside(body, p[None], margin).counts[0] == 1 for p in points]
        size = Fraction(body.trees.radii[0]) + Fraction(np.abs(center).max())
        for point, inside in zip(map(exact, points), held, strict=True):
            square = squared_distance([point], whole)
            if square <= Fraction(margin) ** 2:
                assert inside
            elif inside:
                assert square <= (Fraction(margin) + doubt * (size + taxicab(point))) ** 2
        held_ones += sum(held)
    assert held_ones > 5


@each("power", [-500, -300, 300, 500])
def test_solids_of_any_size_hold_the_same_points(power: int) -> None:
    """Products of three coordinates overflow from 1e103 on, and underflow below 1e-108."""
    rng = np.random.default_rng(3)
    vertices, faces = zoo()["hollow1"]
    points = rng.uniform(-0.8, 0.8, (300, 3)) * np.abs(vertices).max()
    ones = points_inside(place(vertices, faces), points, 0.0).counts
    assert 10 < ones[0] < 290
    unit = 2.0**power
    assert (points_inside(place(vertices * unit, faces), points * unit, 0.0).counts == ones).all()


#: Sizes along the axes, and how thin what is thin may be.
SCALES = {
    "random": [1.0, 1.0, 1.0], "plates": [1.0, 1.0, 1e-8], "needles": [1e-8, 1e-8, 1.0],
    "tiny": [1e-150] * 3, "huge": [1e150] * 3,
}  # fmt: skip
#: What is promised of points beside hulls, and of radii and margins, relative to the size.
CLOSE = 1e-9


def held(body: ConvexBodies, points: Floats, margin: float = 0.0) -> Mask:
    """Return (n,) which points are in one body."""
    found = points_in_bodies(around(body, margin), body, points, margin, each_point=True)
    assert found.boxes is not None
    return np.asarray(found.boxes == 0)


def points_about(body: ConvexBodies, count: int, rng: np.random.Generator) -> Floats:
    """Return points in and about a body, some within 1e-17 to 1e-3 of its size of the surface."""
    size = np.abs(body.sizes[0]).sum() + body.radii[0]
    local = rng.normal(size=(count, 3)) * np.maximum(body.sizes[0, :3], 1e-3 * size)
    local[:, 2] += rng.uniform(-1, 1, count) * body.sizes[0, 3]
    inside, outside = 0.0 * local, local
    for _ in range(60):  # halved until the surface is between neighbours
        middle = 0.5 * (inside + outside)
        world = middle @ body.rotations[0].T + body.centers[0]
        is_in = beyond(some(body, np.zeros(count, np.int64)), world) <= 0.0
        inside = np.where(is_in[:, None], middle, inside)
        outside = np.where(is_in[:, None], outside, middle)
    near = inside * (
        1.0 + rng.choice([-1, 1], (count, 1)) * 10.0 ** rng.uniform(-17, -3, (count, 1))
    )
    local = np.where(rng.random((count, 1)) < 0.7, near, local)
    return np.asarray(local @ body.rotations[0].T + body.centers[0])


@each("name", SCALES)
@each("kind", [kind for kind in KINDS if kind != "hull"])
def test_points_are_in_shapes_by_their_formulas(kind: str, name: str, pairs: int) -> None:
    rng = np.random.default_rng(3)
    several = bodies(KINDS[kind], 4, rng, np.array(SCALES[name]), 0.5 * min(SCALES[name]))
    several = moved(several, centers=several.centers * rng.choice([1.0, 1e3], (4, 1)))
    decided = 0
    for i in range(4):
        body = some(several, [i])
        points = points_about(body, max(200, pairs // 40), rng)
        far = beyond(some(body, np.zeros(len(points), np.int64)), points)
        size = np.abs(points - body.centers).sum(axis=1) + np.abs(body.sizes).sum() + body.radii[0]
        rounding = 1e-13 * (size + np.abs(body.centers).max())
        close = CLOSE * size if body.kinds[0] == SEGMENT else 0.0
        found = held(body, points)
        assert found[far <= 0.0].all()
        assert not found[far > rounding + close].any()
        decided += int((far > rounding + close).sum()) + int((far < -rounding).sum())
    assert decided > 150


def test_points_are_in_hulls_by_their_planes(pairs: int) -> None:
    rng = np.random.default_rng(4)
    several = bodies(CORNERS, 8, rng, np.ones(3), 0.0)
    for i in range(8):
        body, corners = some(several, [i]), corners_of(several, i)
        weights = rng.dirichlet(np.full(len(corners), 0.2), max(200, pairs // 40))
        local = (weights @ corners) * (1.0 + 10.0 ** rng.uniform(-12, 0, (len(weights), 1)))
        planes = ConvexHull(corners).equations
        far = (local @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        found = held(body, local @ body.rotations[0].T + body.centers[0])
        assert found[far <= -1e-14].all()
        assert not found[far > CLOSE * 8.0].any()
        assert 20 < found.sum() < len(found)


@each("kind", KINDS)
def test_a_margin_and_a_radius_are_a_ball_about_the_shape(kind: str) -> None:
    rng = np.random.default_rng(5)
    several = bodies(KINDS[kind], 6, rng, np.ones(3), 0.5)
    for i in range(6):
        body = some(several, [i])
        points = rng.uniform(-2, 2, (600, 3)) + body.centers
        narrow, wide = held(body, points), held(body, points, 0.4)
        padded = held(moved(body, radii=body.radii + 0.4), points)
        assert (wide == padded).all()
        assert (wide >= narrow).all()
        assert narrow.sum() < wide.sum()
        inner = points[narrow]
        if len(inner):  # from each of these, a step of the margin stays within it
            steps = rng.normal(size=inner.shape)
            steps *= 0.4 * (1.0 - 1e-12) / np.linalg.norm(steps, axis=1)[:, None]
            assert held(body, inner + steps, 0.4).all()
        assert not wide[np.linalg.norm(points - body.centers, axis=1) > 3.6].any()
