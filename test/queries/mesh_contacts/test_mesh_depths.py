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

"""Depths of meshes and bodies: pushes that part them, and short ones; contacts on both surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import pytest
from convex_bodies import (
    CLOSE,
    FAMILIES,
    ROUND_KINDS,
    as_meshes,
    distances_of,
    family,
    round_bodies,
    size_with,
    world_rounding,
)
from convex_bodies import moved as with_columns
from each import each
from exact_bodies import exact_gap
from exact_vectors import along, exact
from hull_distances import squared_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_zoo import (
    SHARE,
    TRIANGLES,
    Maker,
    as_drawn,
    bodies_of,
    exact_corners,
    place,
    standing,
    surface_distance,
    trees_of,
    zoo,
)
from sweep_motions import directions

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
from obb_collision.queries.convex import ConvexDistances, FlatFrame, frame_of, mesh_body_distances
from obb_collision.queries.mesh_contacts import hulls_of, way_out, within_bodies
from obb_collision.queries.meshes.triangles import triangle_at
from obb_collision.queries.verdict import Separations
from obb_collision.typing import Floats

TREES = trees_of()
CONVEX = trees_of(*(f"{name}{n}" for name in ("hull", "box", "sphere") for n in range(3)))


def sizes_of(a: PlacedMeshes, b: PlacedMeshes) -> Floats:
    reach = a.trees.radii[a.meshes] + b.trees.radii[b.meshes]
    return np.abs(a.centers - b.centers).sum(axis=1) + reach


def depths_of_hulls(a: PlacedMeshes, b: PlacedMeshes) -> ConvexDistances:
    rows, zeros = np.arange(len(a)), np.zeros(len(a))
    return distances_of(hulls_of(a, rows, zeros), hulls_of(b, rows, zeros))


def parted(b: PlacedMeshes, found: Separations, share: Floats | float = 1.0) -> PlacedMeshes:
    """Return b moved along the normals by a share of the depths."""
    ways = (share * np.maximum(-found.separations, 0.0))[:, None] * found.normals
    return PlacedMeshes(b.trees, b.meshes, b.centers + ways, b.rotations)


def check(a: PlacedMeshes, b: PlacedMeshes) -> Separations:
    """Assert what is promised of all pairs."""
    found = check_depths(a, b)
    assert (oc.verdicts(a, parted(b, found), exact=True) == Verdict.SEPARATE).all()
    return found


def check_depths(a: PlacedMeshes, b: PlacedMeshes) -> Separations:
    """Assert signs, and that no depth is more than that of the hulls."""
    found, outer, size = oc.separations(a, b), depths_of_hulls(a, b), sizes_of(a, b)
    collide = oc.verdicts(a, b) != Verdict.SEPARATE
    assert (found.separations <= 0.0)[collide].all()
    assert (found.separations >= 0.0)[~collide].all()
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-12)
    assert (-found.separations <= np.maximum(-outer.lower, 0.0) + CLOSE * size)[collide].all()
    return found


@each("spread", [0.2, 0.5, 1.0])
def test_depths_part_meshes_of_all_kinds(spread: float) -> None:
    a, b = bodies_of(TREES, 110, spread, 7)
    found = check(a, b)
    outer = depths_of_hulls(a, b)
    assert (found.separations > outer.lower + 0.01).sum() > 10  # better than hulls


def test_none_is_shorter_along_the_same_normal() -> None:
    """But for bodies within each other, which are pushed by their distance."""
    a, b = bodies_of(TREES, 150, 0.4, 8)
    found, size = oc.separations(a, b), sizes_of(a, b)
    faces = oc.clearances(a, b).faces[:, 0]
    deep = (found.separations < -1e-3 * size) & (faces >= 0)
    assert deep.sum() > 60
    for share in np.linspace(0.0, 1.0 - 1e-4, 12):
        collide = oc.verdicts(a, parted(b, found, share)) != Verdict.SEPARATE
        # a body may be within a solid on the way, as where the push passes a cavity
        assert collide[deep].all()


def test_convex_meshes_have_the_least_depth() -> None:
    a, b = bodies_of(CONVEX, 200, 0.3, 9)
    found, outer, size = check(a, b), depths_of_hulls(a, b), sizes_of(a, b)
    deep = outer.lower < 0.0
    assert deep.sum() > 50
    np.testing.assert_array_less(
        np.abs(found.separations - outer.lower)[deep], (CLOSE * size)[deep]
    )


def test_apart_it_is_the_distance() -> None:
    a, b = bodies_of(TREES, 60, 2.0, 10)
    found, near = oc.separations(a, b), oc.clearances(a, b)
    apart = near.distances > 0.0
    assert apart.sum() > 40
    np.testing.assert_allclose(found.separations[apart], near.distances[apart], atol=1e-9)
    middles = 0.5 * (near.positions_a + near.positions_b)
    assert np.abs(found.positions - middles)[apart].max() < 10.0


def test_exact_arithmetic_finds_nothing_that_touches() -> None:
    """All triangles of the one against all of the other, after the push by exact numbers."""
    trees = trees_of("box0", "star0", "cone1", "triangle", "crumbs0")
    a, b = bodies_of(trees, 12, 0.3, 4)
    found = oc.separations(a, b)
    deep = np.flatnonzero(found.separations < 0.0)
    assert len(deep) >= 6
    for n in deep[:6].tolist():
        depth, normal = Fraction(-found.separations[n]), exact(found.normals[n])
        second = [[along(v, depth, normal) for v in t] for t in exact_corners(b, n)]
        assert surface_distance(exact_corners(a, n), second, 1e-6) > 0


#: How far a point may be from either surface, relative to the size of a pair.
ON_SURFACE = Fraction(1, 10**12)


@each("make", TRIANGLES)
def test_hostile_triangles_are_parted_and_have_points_on_both(make: Maker, pairs: int) -> None:
    rng = np.random.default_rng(12)
    a, b = as_drawn([make(rng) for _ in range(max(pairs // SHARE, 8))])
    found, outer = check_depths(a, b), depths_of_hulls(a, b)
    touch = oc.contacts(a, b, max_points=8)
    collide = oc.verdicts(a, b) != Verdict.SEPARATE
    assert (touch.counts[collide] >= 1).all()
    for n in np.flatnonzero(collide).tolist():
        depth, normal = Fraction(-found.separations[n]), exact(found.normals[n])
        (p,), (q,) = exact_corners(a, n), exact_corners(b, n)
        moved = [along(v, depth, normal) for v in q]
        assert squared_distance(p, moved) > 0 or found.separations[n] == outer.lower[n]
        size = Fraction(a.trees.radii[a.meshes[n]]) + Fraction(b.trees.radii[b.meshes[n]])
        for point in touch.positions[n, : touch.counts[n]]:
            for triangle in (p, q):
                assert squared_distance([exact(point)], triangle) <= (ON_SURFACE * size) ** 2


@given(seed=st.integers(0, 2**32), power=st.sampled_from([-300, -100, 0, 100, 300]))
@settings(max_examples=30, deadline=None)
def test_scaled_by_a_power_of_two_it_is_the_same(seed: int, power: int) -> None:
    rng = np.random.default_rng(seed)
    p, q = rng.normal(size=(2, 8, 3))
    scale = 2.0**power
    found = []
    for factor in (1.0, scale):
        trees = MeshTrees.join([MeshTrees.build(factor * x, BOX_FACES) for x in (p, q)])
        found.append(oc.separations(standing(trees), standing(trees, mesh=1)))
    one, other = found
    assert other.separations[0] == pytest.approx(scale * one.separations[0], rel=1e-6)
    np.testing.assert_allclose(other.normals, one.normals, atol=1e-6)


def boxes_at(*offsets: list[float]) -> tuple[PlacedMeshes, PlacedMeshes]:
    """Return cubes from -1 to 1 in one place, and others at offsets."""
    tree = MeshTrees.build(BOX_CORNERS, BOX_FACES)
    return standing(tree, *np.zeros((len(offsets), 3))), standing(tree, *offsets)


def test_cubes_that_rest_on_each_other_or_are_one() -> None:
    a, b = boxes_at([0, 0, 2], [0, 0, 1.75], [0.5, 0, -1.9], [0, 0, 0], [2, 2, 2])
    found = oc.separations(a, b)
    np.testing.assert_allclose(found.separations, [0, -0.25, -0.1, -2, 0], atol=1e-8)
    np.testing.assert_allclose(found.normals[:3], [[0, 0, 1], [0, 0, 1], [0, 0, -1]], atol=1e-9)
    assert (oc.verdicts(a, parted(b, found), exact=True) == Verdict.SEPARATE).all()


def test_open_cubes_part_as_soon_as_their_surfaces_do() -> None:
    ball = MeshTrees.build(*zoo()["sphere1"])
    tree = MeshTrees.build(2.0 * BOX_CORNERS, BOX_FACES, solid=False)
    hollow = standing(tree)
    inner = standing(ball, [1.6, 0, 0])  # 0.05 past the inside of a wall
    found = oc.separations(hollow, inner)
    assert -0.06 < found.separations[0] < -0.01
    assert found.normals[0, 0] < -0.9  # back inside, as that is nearer


def test_one_inside_the_other_has_one_point_as_no_surfaces_cross() -> None:
    tree = MeshTrees.join([MeshTrees.build(size * BOX_CORNERS, BOX_FACES) for size in (2.0, 0.25)])
    outer, inner = standing(tree), standing(tree, [0.0, 0.0, 1.25], mesh=1)
    for a, b, sign in ((outer, inner, 1.0), (inner, outer, -1.0)):
        found = check(a, b)
        assert found.separations[0] == pytest.approx(-1.0, abs=1e-8)
        np.testing.assert_allclose(found.normals, [[0, 0, sign]], atol=1e-9)
    within = oc.contacts(outer, standing(tree, [0.0, 0.0, 1.5], mesh=1))
    beside = oc.contacts(outer, standing(tree, [0.0, 0.0, 2.5], mesh=1), radii_a=0.5)
    assert within.counts.tolist() == beside.counts.tolist() == [1]
    assert 1.25 <= within.positions[0, 0, 2] <= 2.0  # between the lowest of the one and the wall
    assert beside.depths[0] == pytest.approx(0.25, abs=1e-8)


def test_a_box_in_a_corner_of_a_room_leaves_by_the_nearest_way() -> None:
    """The hull of the room holds the box; triangles overlap it by a centimetre or two."""
    floor, wall = BOX_CORNERS * [4, 4, 0.5] - [0, 0, 0.5], BOX_CORNERS * [0.5, 4, 4] + [-4.5, 0, 4]
    a = place(np.concatenate([floor, wall]), np.concatenate([BOX_FACES, BOX_FACES + 8]))
    for position, depth in (([0, 0, 0.99], 0.01), ([-3.02, 0, 2.0], 0.02)):
        b = place(BOX_CORNERS, BOX_FACES, position)
        assert -oc.separations(a, b).separations[0] == pytest.approx(depth, abs=1e-8)
        assert -depths_of_hulls(a, b).lower[0] > 0.5
    b = place(BOX_CORNERS, BOX_FACES, [-3.02, 0, 0.98])  # in both
    assert 0.02 <= -oc.separations(a, b).separations[0] < 0.04


def test_radii_are_added() -> None:
    """Rounded cubes: as far apart as their radii leave, and pushed on by them."""
    a, b = boxes_at([0, 0, 3], [0, 0, 2.25], [0, 0, 1.75], [2.2, 2.2, 0.3])
    found = oc.separations(a, b, radii_a=0.25, radii_b=0.25)
    corner = 0.5 - 0.2 * np.sqrt(2.0)
    np.testing.assert_allclose(found.separations, [0.5, -0.25, -0.75, -corner], atol=1e-8)
    away = parted(b, found)
    np.testing.assert_array_less(0.5, oc.clearances(a, away).upper + 1e-12)


def outer_of(normals: Floats, depths: Floats) -> Separations:
    each = np.repeat(np.arange(len(depths)), 2).reshape(-1, 2)
    return Separations(each, -depths, normals.copy(), np.zeros_like(normals))


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
def test_a_depth_parts_triangles_and_bodies_and_nothing_shorter_does(
    name: str, kind: str, pairs: int
) -> None:
    pair = family(name, ("triangle", kind), max(50, pairs // len(FAMILIES)), 15)
    meshes = as_meshes(pair[0], name)
    size = size_with(meshes, pair[1])
    far = 3.0 * size  # no pair of these needs more
    outer = outer_of(directions(np.random.default_rng(3), len(meshes)), far)
    found = within_bodies(outer, meshes, np.zeros(len(meshes)), pair[1])
    deep = found.separations < 0.0
    world = world_rounding(pair)
    room = CLOSE * size + world
    lower = distances_of(*pair).lower
    assert (found.separations <= lower + room)[deep].all()  # no push parts them that is shorter
    given_up = deep & (found.separations <= -far)  # what was given stays
    assert given_up.sum() <= 1 + 0.02 * deep.sum()
    for share, sign in ((1.0, 1.0), (0.99, -1.0)):
        way = share * np.where(deep, -found.separations, 0.0) - (share < 1.0) * 4.0 * room
        then = with_columns(pair[1], centers=pair[1].centers + way[:, None] * found.normals)
        apart = distances_of(pair[0], then)
        gaps = exact_gap((pair[0], then), apart.normals).astype(float)
        touching = deep & ~given_up & (way > 0.0)
        tight = 8.0 * world + (CLOSE * size if sign < 0.0 else 0.0)
        assert (sign * gaps >= -tight)[touching].all()
    if name == "random":
        assert deep.any()
        assert not deep.all()


@each("radius", [0.0, 0.03])
@each("kind", ROUND_KINDS)
def test_a_depth_parts_meshes_and_bodies_and_is_the_shortest_along_its_normal(
    kind: str, radius: float, pairs: int
) -> None:
    """All kinds of meshes; where they are apart, it is their distance."""
    count = max(pairs // 10, 60)
    a, b = bodies_of(TREES, count, 0.5, 7)
    radii, rows = np.full(count, radius), np.arange(count)
    body = round_bodies(kind, b, radius)
    outer = outer_of(directions(np.random.default_rng(5), count), np.full(count, 4.0))
    found = within_bodies(outer, a, radii, body)
    near = mesh_body_distances(a, radii, body, rows, rows)[0]
    apart = near.upper > 0.0
    np.testing.assert_array_equal(found.separations[apart], near.lower[apart])
    deep = ~apart
    assert deep.sum() > count // 4
    assert (found.separations[deep] > -4.0).all()
    there = [parted(b, found, share).centers for share in (1.0, 1.0 - 1e-6)]
    pushed = [with_columns(body, centers=centers) for centers in there]
    far, short = (mesh_body_distances(a, radii, one, rows, rows)[0] for one in pushed)
    assert (far.lower[deep] > 0.0).all()
    assert (short.upper[deep] > 0.0).sum() <= 0.1 * deep.sum()  # within solids
    assert np.isfinite(found.positions).all()


def test_points_of_meshes_are_on_both_exactly() -> None:
    trees = trees_of("box0", "star0", "cone1", "triangle", "open_sphere0")
    a, b = bodies_of(trees, 16, 0.3, 4)
    found, checked = oc.contacts(a, b), 0
    crossing = np.unique(oc.triangle_pairs(a, b).pairs)
    for n in crossing[:8].tolist():
        for bodies in (a, b):
            corners = exact_corners(bodies, n)
            for point in found.positions[n, : found.counts[n]]:
                assert surface_distance([[exact(point)]], corners, 1e-6) <= (3 * ON_SURFACE) ** 2
                checked += 1
    assert checked > 30


@each("max_points", [4, 8])
def test_tables_are_as_promised(max_points: int) -> None:
    a, b = bodies_of(TREES, 80, 0.6, 14)
    found, apart = oc.contacts(a, b, max_points=max_points), oc.separations(a, b)
    assert found.depths.tolist() == np.maximum(-apart.separations, 0.0).tolist()
    assert found.normals.tolist() == apart.normals.tolist()
    assert ((found.counts > 0) == (apart.separations <= 0.0)).all()
    assert found.counts.max() == max_points
    assert (found.axes == -1).all()
    there = np.arange(max_points) < found.counts[:, None]
    assert np.isfinite(found.positions[there]).all()
    assert np.isnan(found.positions[~there]).all()
    assert np.isnan(found.position_depths[~there]).all()
    deepest = found.position_depths[:, :1]
    ordered = np.where(there, found.position_depths, -1.0)
    assert (ordered <= deepest + 1e-6)[found.counts > 0].all()
    assert (ordered <= found.depths[:, None]).all()
    assert (found.position_depths[there] >= 0.0).all()


def test_a_crate_on_a_shelf_has_its_four_corners() -> None:
    a = place(4.0 * BOX_CORNERS, BOX_FACES)
    for height in (4.99, 5.0):  # sunk in, and resting: then edges lie in the plane
        b = place(BOX_CORNERS, BOX_FACES, [0.3, 0.2, height])
        found = oc.contacts(a, b)
        assert found.counts[0] == 4
        flat = found.positions[0] - [0.3, 0.2, 4.0]
        np.testing.assert_allclose(np.abs(flat[:, 2]), 0.0, atol=1e-12)
        assert len(np.unique(np.sign(flat[:, :2]), axis=0)) == 4
        np.testing.assert_allclose(np.abs(flat[:, :2]), 1.0, atol=1e-12)
        assert found.depths[0] == pytest.approx(5.0 - height, abs=1e-8)


#: Rounding of places, relative to the coordinates.
TOLERANCE = 1e-9


#: Where what decides may be a point wide.
HARD_TO_PART = ("sliver", "degenerate", "small_grid", "different_sizes")


def out_of(p: Floats, q: Floats, frame: FlatFrame, least: float) -> float:
    first, second = (triangle_at(x.reshape(1, 9), 0) for x in (p, q))
    return way_out(first, second, frame, least)


def any_frame(rng: np.random.Generator) -> FlatFrame:
    n = rng.normal(size=3)
    x, y, z = (n / np.linalg.norm(n)).tolist()
    return frame_of((x, y, z))


def are_apart(p: Floats, q: Floats, n: Sequence[float], times: Sequence[float]) -> bool:
    """Return whether a triangle p and q + t n have no common point for t between two times."""
    ways = [along(exact(corner), Fraction(t), exact(n)) for t in times for corner in q]
    return squared_distance([exact(corner) for corner in p], ways) > 0


@each("make", TRIANGLES)
def test_never_too_short(make: Maker, pairs: int) -> None:
    """After the way out of all, the triangles are apart, exactly, however far they are moved on."""
    rng = np.random.default_rng(5)
    seen = 0
    for _ in range(max(pairs // 200, 20)):
        p, q = make(rng)
        size = max(np.abs(p).max(), np.abs(q).max())
        if not 1e-3 < size < 1e9:  # kernels scale triangles to about one
            p, q = p / size, q / size
        size, frame = max(np.abs(p).max(), np.abs(q).max()), any_frame(rng)
        found, far = out_of(p, q, frame, -np.inf), 9.0 * size
        if not are_apart(p, q, frame.n, (max(found, -far) + TOLERANCE * size, far)):
            assert make.__name__.strip("_") in HARD_TO_PART
        seen += not are_apart(p, q, frame.n, (-far, far))
    assert seen > 2 or make.__name__ == "extreme_sizes"


def test_ordinary_triangles_exactly() -> None:
    rng = np.random.default_rng(6)
    seen = 0
    for _ in range(100):
        p, q = rng.normal(size=(2, 3, 3))
        frame = any_frame(rng)
        found = out_of(p, q, frame, -np.inf)
        if are_apart(p, q, frame.n, (-99.0, 99.0)):
            assert found == -np.inf
        else:
            assert are_apart(p, q, frame.n, (found + 1e-10, 99.0))
            assert not are_apart(p, q, frame.n, (found - 1e-10, found))
            seen += 1
            assert out_of(p, q, frame, 99.0) == -np.inf
    assert seen > 15
