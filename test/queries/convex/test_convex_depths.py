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

"""Distances and depths of convex bodies, and distances of meshes and bodies."""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from convex_bodies import (
    CLOSE,
    FAMILIES,
    KIND_PAIRS,
    POLYTOPES,
    ROUND_KINDS,
    Pair,
    as_meshes,
    corners_of,
    distances_of,
    family,
    hulls,
    moved,
    outward_faces,
    reach_of,
    round_bodies,
    size_with,
    some,
    world_rounding,
)
from each import each
from exact_bodies import beyond, exact_gap
from exact_vectors import exact, root
from hull_distances import placed, squared_distance
from mesh_zoo import bodies_of, exact_corners, trees_of, zoo
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes
from obb_collision.geometry.trees import HullPool, Hulls
from obb_collision.queries.contacts import Contacts
from obb_collision.queries.convex import convex_contacts, convex_may_collide, mesh_body_distances
from obb_collision.queries.convex.support import BOX_CORE, HULL_CORE, ConvexBodies
from obb_collision.typing import Floats

SOLIDS = [("hull", "hull"), ("hull", "box"), ("box", "box")]
THIN = ["flat", "plates", "needles", "flat and parallel"]
CURVED = [("cylinder", "cone"), ("ellipsoid", "hull"), ("capsule", "box"), ("capsule", "capsule")]


def contacts_of(a: ConvexBodies, b: ConvexBodies, most: int) -> Contacts:
    rows, distances = np.arange(len(a)), distances_of(a, b)
    return convex_contacts(a, b, np.stack([rows, rows], axis=1), rows, rows, most, distances)


def overlapping(kinds: tuple[str, str], count: int) -> tuple[Pair, Floats]:
    """Return pairs that overlap, and their depths as found."""
    a, b = family("random", kinds, 8 * count, 5)
    found = distances_of(a, b)
    deep = np.flatnonzero(found.lower < -1e-3)[:count]
    assert len(deep) > count // 4
    return (some(a, deep), some(b, deep)), -found.lower[deep]


def in_world(body: ConvexBodies, i: int) -> Floats:
    return corners_of(body, i) @ body.rotations[i].T + body.centers[i]


@each("kinds", SOLIDS)
def test_depths_of_polytopes_are_those_of_all_faces_of_their_difference(
    kinds: tuple[str, str], pairs: int
) -> None:
    (a, b), depths = overlapping(kinds, max(40, pairs // 30))
    for n, depth in enumerate(depths.tolist()):
        difference = in_world(a, n)[:, None] - in_world(b, n)[None]
        truth = -ConvexHull(difference.reshape(-1, 3)).equations[:, 3].max()
        assert depth == pytest.approx(truth, abs=1e-9)


@each("kinds", [*SOLIDS, *CURVED])
def test_a_translation_by_the_depth_parts_bodies_and_contacts_lie_within_half_of_it(
    kinds: tuple[str, str], pairs: int
) -> None:
    """A shorter translation does not."""
    (a, b), depths = overlapping(kinds, max(100, pairs // 10))
    rows = np.arange(len(a))
    normals = distances_of(a, b).normals
    for more, collide in ((1e-9, False), (-1e-8, True)):
        pushed = moved(b, centers=b.centers + (depths + more)[:, None] * normals)
        assert (convex_may_collide(a, pushed, rows, rows) == collide).all()
    found = contacts_of(a, b, 4)
    assert found.depths.tolist() == depths.tolist()
    assert (found.counts >= 1).all()
    assert (found.counts > 1).any() or "capsule" in kinds or "ellipsoid" in kinds
    for k in range(4):
        there = np.flatnonzero(found.counts > k)
        for body in (a, b):
            apart = distances_of(some(body, there), points_of(found.positions[there, k])).upper
            assert (apart <= 0.5 * depths[there] + 1e-9).all()


@each("kinds", [*SOLIDS, *CURVED, ("box", "cylinder"), ("cone", "ellipsoid")])
@each("name", ["nearly touching", "parallel", *THIN])
def test_contacts_of_bodies_that_hardly_overlap_lie_on_both(
    name: str, kinds: tuple[str, str], pairs: int
) -> None:
    a, b = family(name, kinds, max(300, pairs // 10), 5)
    found = contacts_of(a, b, 8)
    assert (found.counts > 0).sum() > len(a) // 10
    check_nearness(a, b, found)


@each("on", ["plate", "tip"])
@each("thin", [1e-3, 1e-7, 1e-9, 1e-11, 1e-13])
def test_contacts_of_tips_lie_on_both(on: str, thin: float, pairs: int) -> None:
    """Needles with tips of any angle, on a plate or on each other: two sides meet nowhere else."""
    count, rng, pool = max(300, pairs // 10), np.random.default_rng(3), HullPool()
    for ends in rng.normal(size=(2 * count, 2)) * thin:
        tip = np.array([[-0.5, 0.0, 0.0], [0.5, ends[0], 0.0], [0.5, ends[1], 0.0]])
        pool.append(Hulls.of(np.concatenate([tip, tip + 0.1 * np.eye(3)[2]])))
    turn, turned = Rotation.random(count, rng), rng.uniform(-3.0, 3.0, count)
    places = np.column_stack([rng.uniform(-0.3, 0.3, (count, 2)), np.full(count, -1e-4)])
    if on == "tip":
        turned = rng.choice([0.0, np.pi], count) + rng.normal(size=count) * thin
        places[:, 1] = rng.normal(size=count) * thin
    own = turn * Rotation.from_rotvec(turned[:, None] * [0.0, 0.0, 1.0])
    below = turn.apply([0.0, 0.0, -0.1 if on == "tip" else -0.5])
    rows, none = np.arange(count), np.zeros(count)
    corners, boxes = np.full(count, HULL_CORE, np.int8), np.full(count, BOX_CORE, np.int8)
    sizes = np.tile([0.6, 0.7, 0.5, 0.0], (count, 1)) * (on == "plate")
    a = ConvexBodies(corners, 0.0 * sizes, none, pool.all, rows, turn.apply(places),
                     own.as_matrix())  # fmt: skip
    b = ConvexBodies(corners if on == "tip" else boxes, sizes, none, pool.all, count + rows, below,
                     turn.as_matrix())  # fmt: skip
    for one, other in ((a, b), (b, a)):
        found = contacts_of(one, other, 8)
        ends = found.positions[found.counts > 1]
        assert len(ends) > count // 4
        check_nearness(one, other, found)
        if on == "plate":  # where they lie on it, at least 0.3 of their length
            assert (found.counts > 1).all()
            assert (np.nanmax(ends, axis=1) - np.nanmin(ends, axis=1)).max(axis=1).min() > 0.1


def check_nearness(a: ConvexBodies, b: ConvexBodies, found: Contacts) -> None:
    """Assert that contacts are within half the depth and 1e-9 of S of both bodies."""
    size = reach_of(a) + reach_of(b) + np.abs(a.centers - b.centers).sum(axis=1)
    for k in range(8):
        there = np.flatnonzero(found.counts > k)
        for body in (a, b):
            apart = distances_of(some(body, there), points_of(found.positions[there, k])).upper
            most = 0.5 * found.depths[there] + 1e-9 * size[there]
            assert (apart <= most + 1e-15).all()  # rounding of world coordinates


#: Two boxes: half extents, centre, and rotation row by row.
EDGES = """
0.39746654249226876 0.8067830888186329 0.42308853036021327 -1.2180093890693944 -1.31046648610414
1.3732194026899385 -0.5297297578830422 0.5360728951715992 0.6572763761733058 -0.7989397819628827
-0.5755408974464511 -0.17449326681461058 0.284748324683877 -0.6175585206511793
0.7331711022407061 0.9314529648428795 0.6754005313662517 0.35931563985887993 -0.9472081874986527
-0.3565425220106673 0.3272099179841583 -0.5505899883856743 -0.01399185298791167
-0.8346585485930328 -0.7244956089625285 -0.4886730128661592 0.48611192033350314
-0.4146767141804305 0.8723548100092506 0.25892143242737975
"""


def test_the_contact_of_two_edges_is_theirs_where_a_face_within_has_their_normal() -> None:
    """The polytope has the direction of least depth long before it has the face."""
    numbers = np.array(EDGES.split(), float).reshape(2, 15)
    a, b = (
        moved(x, sizes=np.append(n[None, :3], 0.0)[None], centers=n[None, 3:6],
              rotations=n[6:].reshape(1, 3, 3))
        for x, n in zip(family("random", ("box", "box"), 1, 0), numbers, strict=True)
    )  # fmt: skip
    distances = distances_of(a, b)
    apart = np.linalg.norm(distances.positions_b - distances.positions_a)
    assert apart == pytest.approx(-distances.lower[0], abs=1e-12)
    found = contacts_of(a, b, 4)
    assert found.counts.tolist() == [1]
    for body in (a, b):
        local = (found.positions[0, 0] - body.centers[0]) @ body.rotations[0]
        assert (np.abs(local) <= body.sizes[0, :3] + 0.5 * found.depths[0]).all()


def points_of(points: Floats) -> ConvexBodies:
    """Return capsules without length and radius."""
    (a, _) = family("random", ("capsule", "capsule"), len(points), 0)
    return moved(a, sizes=0.0 * a.sizes, radii=0.0 * a.radii, centers=points)


@each("thin", [1.0, 0.01])
def test_the_depth_of_a_ball_in_a_box_is_that_to_the_nearest_face(thin: float, pairs: int) -> None:
    """Corners of boxes are the farthest along many directions: two of them may seem to be all."""
    count = max(300, pairs // 3)
    rng = np.random.default_rng(9)
    box, ball = family("random", ("box", "capsule"), count, 9)
    half = box.sizes[:, :3] * [thin, 1.0, 1.0]
    at = rng.uniform(-1.0, 1.0, (count, 3)) * half
    centers = box.centers + np.einsum("nij,nj->ni", box.rotations, at)
    sizes = np.concatenate([half, np.zeros((count, 1))], axis=1)
    ball = moved(ball, sizes=0.0 * ball.sizes, centers=centers)
    found = distances_of(moved(box, sizes=sizes), ball)
    truth = (half - np.abs(at)).min(axis=1) + ball.radii
    assert (-found.lower >= truth - 1e-13).all()
    np.testing.assert_allclose(-found.lower, truth, atol=1e-9)


@each("corners", [300, 900, 3000])
def test_contacts_of_a_deep_ball_of_many_corners_lie_all_around(corners: int) -> None:
    """More corners belong to the feature than its polygon may have: all of them count."""
    steps = np.arange(corners) + 0.5
    height, turn = 1.0 - 2.0 * steps / corners, np.pi * (1.0 + 5.0**0.5) * steps
    flat = np.sqrt(1.0 - height**2)
    ball = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    scene = oc.Scene(accuracy="hull")
    scene.add("table", oc.shapes.Box([9.0, 9.0, 9.0]), [0.0, 0.0, -4.5, 0.0, 0.0, 0.0, 1.0])
    scene.add("ball", oc.shapes.Hull(ball), [0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0])
    found = scene.check(["contacts"]).contacts
    assert found.depths[0] == pytest.approx(0.7, abs=0.01)
    around = found.positions[0, : found.counts[0], :2]
    assert len(around) == 4
    # those taken are far from each other: the first, deepest one may be anywhere
    angles = np.sort(np.arctan2(around[:, 1], around[:, 0]))
    gaps = np.diff(np.concatenate([angles, angles[:1] + 2.0 * np.pi]))
    assert gaps.max() < np.pi
    assert np.linalg.norm(around, axis=1).max() > 0.9


@each("name", FAMILIES)
@each("kinds", POLYTOPES)
def test_distances_of_polytopes_are_those_of_fractions(
    name: str, kinds: tuple[str, str], pairs: int
) -> None:
    a, b = family(name, kinds, max(6, pairs // 1000), 1)
    found = distances_of(a, b)
    for n in range(len(a)):
        sides = [placed(corners_of(x, n), x.centers[n], x.rotations[n]) for x in (a, b)]
        square = squared_distance(*sides)
        radius = float(a.radii[n] + b.radii[n])
        truth = float(root(square))
        assert max(Fraction(found.lower[n]) + Fraction(radius), Fraction(0)) ** 2 <= square
        size = max(truth, float(reach_of(a)[n] + reach_of(b)[n]))
        if truth > radius:
            assert found.lower[n] >= truth - radius - CLOSE * size
            assert found.upper[n] <= truth - radius + CLOSE * size + world_rounding((a, b))[n]


@each("name", FAMILIES)
@each("kinds", KIND_PAIRS)
def test_bounds_are_proved_by_the_normal_and_attained_by_the_points(
    name: str, kinds: tuple[str, str], pairs: int
) -> None:
    pair = family(name, kinds, max(100, pairs // 10), 2)
    found = distances_of(*pair)
    assert (found.lower <= exact_gap(pair, found.normals)).all()
    size = np.maximum(reach_of(pair[0]) + reach_of(pair[1]), found.upper)
    apart = found.lower > 0.0
    width = np.maximum(found.upper, 0.0) - found.lower
    assert (width[apart] <= (CLOSE * size + world_rounding(pair))[apart]).all()
    assert (found.upper[~apart] <= (CLOSE * size + world_rounding(pair))[~apart]).all()
    if name == "random":
        assert apart.any()
        assert not apart.all()
    slack = 1e-13 * size + world_rounding(pair)
    for body, points in zip(pair, (found.positions_a, found.positions_b), strict=True):
        assert (beyond(body, points)[apart] <= slack[apart]).all()


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
def test_bounds_of_triangles_are_proved_by_the_normal_and_attained_by_the_points(
    name: str, kind: str, pairs: int
) -> None:
    pair = family(name, ("triangle", kind), max(50, pairs // len(FAMILIES)), 5)
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
        (triangle,) = exact_corners(meshes, n)
        point = exact(found.positions_a[n])
        assert squared_distance([point], triangle) <= Fraction(slack[n]) ** 2


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
def test_convex_meshes_are_as_far_as_their_hulls(name: str, kind: str, pairs: int) -> None:
    """Those within each other among them: solids have no distance from what is in them."""
    pair = family(name, ("hull", kind), max(50, pairs // 100), 6)
    faces = [outward_faces(corners) for corners in hulls((1.0, 1.0, 1.0))[1]]
    meshes, rows = as_meshes(pair[0], name, faces), np.arange(len(pair[0]))
    found = mesh_body_distances(meshes, np.zeros(len(rows)), pair[1], rows, rows)[0]
    truth, room = distances_of(*pair), CLOSE * size_with(meshes, pair[1])
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
