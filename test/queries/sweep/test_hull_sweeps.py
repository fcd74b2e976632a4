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

"""Sweeps of convex bodies, and of meshes with them and with each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from convex_bodies import (
    FAMILIES,
    KIND_PAIRS,
    POLYTOPES,
    ROUND_KINDS,
    as_meshes,
    corners_of,
    distances_of,
    moved,
    round_bodies,
    some,
)
from each import each
from exact_bodies import exact_gap
from exact_vectors import Vector, along, exact, minus
from hull_distances import placed, squared_distance
from hypothesis import given
from hypothesis import strategies as st
from mesh_zoo import (
    SHARE,
    TRIANGLE,
    TRIANGLES,
    Maker,
    as_drawn,
    bodies_of,
    exact_corners,
    moved_on,
    place,
    standing,
    trees_of,
    zoo,
)
from scipy.spatial.transform import Rotation
from support import refused
from sweep_motions import moving, places_at

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.queries.convex.support import BOX_CORE, NO_HULLS, ConvexBodies
from obb_collision.queries.sweep import (
    MAX_STEPS,
    TOLERANCE,
    BodyMotion,
    Sweeps,
    convex_sweeps,
    swept_meshes,
)
from obb_collision.typing import Floats, Integers

#: Families whose sizes differ so much from their offsets that doubles have too few digits.
TOO_FEW_DIGITS = ("tiny", "far apart")
#: The share of pairs that may be undecided: a point beside the face of a disk that spins is.
MOST_UNDECIDED = {"straight": 0.0, "turning": 0.01, "fast": 0.2}
#: What a plane found in doubles may fall short of the best, relative to size and offset.
PLANE = 1e-9


def found_of(bodies: ConvexBodies, motion: BodyMotion, pairs: Integers) -> Sweeps:
    return convex_sweeps(bodies, motion, pairs, np.zeros(len(pairs)), TOLERANCE)


def near_of(motion: BodyMotion, pairs: Integers) -> Floats:
    radii = motion.radii[pairs]
    return np.maximum(TOLERANCE * radii.min(axis=1), 2e-6 * radii.max(axis=1))


def shifted(points: Sequence[Vector], way: Vector, time: Fraction) -> list[Vector]:
    return [along(p, time, way) for p in points]


@each("name", FAMILIES)
@each("kinds", POLYTOPES)
def test_polytopes_that_do_not_turn_are_apart_until_then_in_fractions(
    name: str, kinds: tuple[str, str], pairs: int
) -> None:
    """What the one sweeps, seen from the other, is the hull of its corners at both ends."""
    bodies, motion, rows = moving(name, kinds, max(8, pairs // 1000), 3, "straight")
    found = found_of(bodies, motion, rows)
    # 1e-8 of both radii and 1e-9 of S, which is at most 6 times both here
    near = np.minimum(near_of(motion, rows), 1.6e-8 * motion.radii[rows].sum(axis=1))
    for n, (i, j) in enumerate(rows.tolist()):
        a, b = (
            placed(corners_of(bodies, k), motion.starts[k], bodies.rotations[k]) for k in (i, j)
        )
        way = minus(exact(motion.ends[j]), exact(motion.ends[i]))
        time = Fraction(min(found.free_until[n], 1.0))
        then, radius = shifted(b, way, time), Fraction(bodies.radii[i]) + Fraction(bodies.radii[j])
        if time > 0:
            assert squared_distance(a, [*b, *then]) > radius * radius
        if found.hits[n]:
            assert squared_distance(a, then) <= (radius + Fraction(near[n])) ** 2


@each("kinds", KIND_PAIRS)
@each("way", ["straight", "turning", "fast"])
def test_a_plane_parts_the_bodies_until_then_and_they_are_near_at_last(
    kinds: tuple[str, str], way: str, pairs: int
) -> None:
    for name in FAMILIES:
        bodies, motion, rows = moving(name, kinds, max(10, pairs // 40), 4, way)
        found = found_of(bodies, motion, rows)
        check_parted_and_near(bodies, motion, rows, found)
        if motion.radii.any():  # not of points
            assert found.hits.any()
            assert name in TOO_FEW_DIGITS or found.undecided.mean() <= MOST_UNDECIDED[way]


def check_parted_and_near(
    bodies: ConvexBodies, motion: BodyMotion, rows: Integers, found: Sweeps
) -> None:
    """Check that no plane is late, and that the bodies are near where the sweep hits."""
    near, until = near_of(motion, rows), np.minimum(found.free_until, 1.0)
    assert np.isnan(found.times[found.undecided]).all()
    shares = np.array([0.1, 0.5, 0.9, 0.99, 0.9999, 1.0])[:, None]
    every = np.tile(rows, (len(shares), 1))
    gaps, upper, size = (
        x.reshape(len(shares), -1) for x in gaps_at(bodies, motion, every, (shares * until).ravel())
    )
    assert (gaps >= -PLANE * size)[:, until > 0.0].all()
    assert (upper[-1] <= near + PLANE * size[-1])[found.hits].all()


def gaps_at(
    bodies: ConvexBodies, motion: BodyMotion, rows: Integers, times: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return gaps along planes that part bodies at times (m,), distances of points, and sizes."""
    (p, r), (q, s) = (places_at(motion, column, times) for column in rows.T)
    here = []
    for column, centers, rotations in ((rows[:, 0], 0 * p, r), (rows[:, 1], q - p, s)):
        here.append(moved(some(bodies, column), centers=centers, rotations=rotations))
    doubles = [
        moved(x, centers=x.centers.astype(float), rotations=x.rotations.astype(float)) for x in here
    ]
    planes = distances_of(doubles[0], doubles[1])
    size = motion.reaches[rows].sum(axis=1) + np.abs(doubles[1].centers).sum(axis=1)
    return exact_gap((here[0], here[1]), planes.normals).astype(float), planes.upper, size


def ball_and_plate(**changes: Any) -> tuple[ConvexBodies, BodyMotion]:
    """Return a plate at 1, and a ball at the origin that moves by 2 along x."""
    kinds, sizes = np.array([2, BOX_CORE], np.int8), np.array([[0, 0, 0, 0], [0.1, 1.0, 1.0, 0.0]])
    bodies, _, _ = moving("random", ("hull", "hull"), 1, 0, "straight")
    starts, radii = np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.array([0.25, 0.0])
    bodies = moved(bodies, kinds=kinds, sizes=sizes * 1.0, radii=radii, centers=starts)
    rotations = np.tile(np.eye(3), (2, 1, 1))
    ends = np.array([[2.0, 0, 0], [0, 0, 0]])
    motion = BodyMotion(
        *(starts, ends, 1.0, rotations, np.zeros((2, 3)), np.zeros((2, 3))),
        *(np.array([0.25, 1.5]), np.array([0.25, 1.5])),
    )
    return bodies, motion._replace(**changes)


PAIR = np.array([[0, 1]])


def test_what_is_hit_when_and_where_also_without_motion_and_from_an_overlap() -> None:
    found = found_of(*ball_and_plate(), PAIR)
    assert found.times[0] == pytest.approx(0.325, abs=1e-7)
    assert found.times[0] <= 0.325
    assert found.positions[0] == pytest.approx([0.9, 0, 0], abs=1e-6)
    assert found.normals[0] == pytest.approx([1, 0, 0], abs=1e-9)
    bodies, motion = ball_and_plate(ends=np.zeros((2, 3)))
    assert found_of(bodies, motion, PAIR).free_until.tolist() == [np.inf]
    starts = np.array([[0.9, 0, 0], [1.0, 0, 0]])
    found = found_of(bodies, motion._replace(starts=starts), PAIR)
    assert (found.hits.tolist(), found.times.tolist()) == ([True], [0.0])


@given(st.floats(0.25, 0.4), st.floats(-200.0, 200.0))
def test_a_plate_that_spins_about_the_way_of_a_ball_meets_it_at_the_same_time(
    size: float, angle: float
) -> None:
    turns = np.array([[0.0, 0, 0], [angle, 0, 0]])
    bodies, motion = ball_and_plate(turns=turns)
    bodies.radii[0] = size
    found = found_of(bodies, motion, PAIR)
    truth = 0.45 - 0.5 * size
    assert found.hits[0]
    assert truth - TOLERANCE <= found.times[0] <= truth


@given(st.floats(0.0, 1.0), st.floats(0.001, 0.2))
def test_a_ball_that_passes_a_spinning_rod_out_of_its_reach_is_decided(
    begin: float, room: float
) -> None:
    """The boxes of a wheel would touch all along: by its own shape it does not."""
    bodies, motion = ball_and_plate(turns=np.array([[0.0, 0, 0], [0, 300.0, 0]]))
    sizes = np.array([[0.0, 0, 0, 0], [1.0, 1.0, 0, 0.1]])
    bodies = moved(bodies, kinds=np.array([2, 4], np.int8), sizes=sizes)
    starts = np.array([[-1.0, 1.25 + room, 0], [0.0, 0, 0]])
    motion = motion._replace(starts=starts, turns=np.array([[0.0, 0, 0], [0, 0, 30.0]]))
    found = convex_sweeps(bodies, motion, PAIR, np.array([begin]), TOLERANCE)
    assert found.free_until.tolist() == [np.inf]
    assert MAX_STEPS == 1000  # docs/effects.md


def test_one_thread_or_many_alone_or_in_a_batch_is_the_same() -> None:
    bodies, motion, rows = moving("random", ("hull", "cylinder"), 200, 6, "turning")
    whole = found_of(bodies, motion, rows)
    for n in range(0, 200, 37):
        alone = found_of(bodies, motion, rows[n : n + 1])
        assert np.array_equal(alone.times, whole.times[n : n + 1], equal_nan=True)
        assert np.array_equal(alone.positions, whole.positions[n : n + 1], equal_nan=True)


@each("name", FAMILIES)
@each("kind", ROUND_KINDS)
@each("way", ["straight", "turning", "fast"])
def test_a_plane_parts_a_body_beside_a_mesh_until_then_and_they_are_near_at_last(
    name: str, kind: str, way: str, pairs: int
) -> None:
    bodies, motion, rows = moving(name, ("triangle", kind), max(24, pairs // 10), 14, way)
    count = len(rows)
    first, second = some(bodies, np.arange(count)), some(bodies, np.arange(count, 2 * count))
    meshes, second = as_meshes(first, name), moved(second, hulls=NO_HULLS, rows=0 * second.rows)
    found = swept_meshes(meshes, first.radii, second, None, motion, np.zeros(count), TOLERANCE)
    check_parted_and_near(bodies, motion, rows, found)
    assert found.hits.any()
    assert name in TOO_FEW_DIGITS or found.undecided.mean() <= 0.02 + MOST_UNDECIDED[way]


def swept(a: PlacedMeshes, b: ConvexBodies, twists: list[Floats], radius: float = 0.0) -> Sweeps:
    """Sweep bodies with twists for a second, with a radius about the mesh."""
    centers = np.concatenate([a.centers, b.centers])
    ways = np.concatenate(twists)
    radii = np.ones(2 * len(a))
    motion = BodyMotion(
        centers, ways[:, :3].copy(), 1.0, np.concatenate([a.rotations, b.rotations]),
        ways[:, 3:].copy(), 0.0 * centers, radii, 3.0 * radii,
    )  # fmt: skip
    return swept_meshes(a, np.full(len(a), radius), b, None, motion, np.zeros(len(a)), TOLERANCE)


@each("angle", [0.0, 0.1, 0.123, 1.0])
def test_a_cylinder_meets_a_wall_at_its_very_radius(angle: float) -> None:
    """However it is turned about its axis, and with radii; a mesh around it would be early."""
    vertices, faces = zoo()["fine_box0"]
    face = float(np.abs(vertices[:, 0]).max())
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()[None]
    wall = standing(MeshTrees.build(vertices, faces))
    there = PlacedMeshes(wall.trees, [0], [[2.0, 0.01, 0.02]], turn)
    for spin in (0.0, 5.0):
        twists = [np.zeros((1, 6)), np.array([[-2.0, 0, 0, 0, 0, spin]])]
        found = swept(wall, round_bodies("cylinder", there, 0.03), twists, 0.05)
        truth = (2.0 - face - 0.2 - 0.08) / 2.0
        assert truth - TOLERANCE <= found.times[0] <= truth
        np.testing.assert_allclose(found.normals[0], [1, 0, 0], atol=1e-6)
        assert found.positions[0, 0] == pytest.approx(face + 0.05, abs=2e-4)


def test_what_starts_inside_of_a_solid_or_touching_is_hit_at_once() -> None:
    vertices, faces = zoo()["box0"]
    box, crumb = place(vertices, faces), place(vertices * 0.1, faces)
    body = round_bodies("cone", box)
    body.sizes[:] *= 0.01
    within = swept(box, body, [np.zeros((1, 6)), np.ones((1, 6))])
    assert not within.normals.any()
    for found in (within, oc.sweeps(box, crumb, duration=1.0, twists_b=[0, 0, 9.0, 0, 0, 0])):
        assert (found.hits.tolist(), found.times.tolist()) == ([True], [0.0])
    assert oc.sweeps(box, box, duration=1.0).times.tolist() == [0.0]


#: Families whose sizes differ so much from each other or their offset that doubles have too few
#: digits for the tolerance.
HARDLY_KNOWN = ("far", "different_sizes", "degenerate")


def near_meshes(a: PlacedMeshes, b: PlacedMeshes, n: int) -> float:
    radii = [
        math.hypot(*x.trees.nodes[x.trees.roots[x.meshes[n]], 12:15]) * (1.0 + 1e-9) for x in (a, b)
    ]
    return float(max(TOLERANCE * min(radii), 2e-6 * max(radii)))


@each("make", TRIANGLES)
def test_triangles_that_do_not_turn_are_apart_until_then_in_fractions(
    make: Maker, pairs: int
) -> None:
    """What the one sweeps, seen from the other, is the hull of its corners at both ends."""
    rng = np.random.default_rng(12)
    count = max(pairs // SHARE, 4)
    drawn = [make(rng) for _ in range(count)]
    size = np.array([np.ptp(np.concatenate(pair), axis=0).max() for pair in drawn])[:, None]
    size[size == 0.0] = 1.0
    back = size * rng.normal(size=(count, 3)) * rng.choice([0.0, 1.0, 3.0], (count, 1))
    a, b = as_drawn(drawn)
    b = PlacedMeshes(b.trees, b.meshes, -back, b.rotations)
    twists = np.zeros((count, 6))
    twists[:, :3] = back * rng.choice([0.5, 1.0, 2.0], (count, 1))
    twists[:, :3] += size * 0.1 * rng.normal(size=(count, 3)) * rng.choice([0, 1], (count, 1))
    found = oc.sweeps(a, b, duration=1.0, twists_b=twists)
    for n in range(count):
        (p,), (q,) = exact_corners(a, n), exact_corners(b, n)
        time = Fraction(min(found.free_until[n], 1.0))
        then = shifted(q, exact(twists[n, :3]), time)
        if time > 0:
            assert squared_distance(p, [*q, *then]) > 0
        if found.hits[n]:
            assert squared_distance(p, then) <= Fraction(near_meshes(a, b, n)) ** 2
    if make.__name__.strip("_") not in HARDLY_KNOWN:
        assert found.undecided.sum() <= 1 + count // 50
    assert found.hits.any() or count < 10, "some must hit, but a few pairs can be free by chance"


@each("spin", [0.0, 1.0, 12.0])
def test_meshes_do_not_overlap_until_then_and_are_near_at_last(spin: float, pairs: int) -> None:
    """All kinds: solids, surfaces, hollow ones, one inside the other, pieces, a Moebius strip."""
    trees = trees_of()
    count = max(pairs // 20, 60)
    a, b = bodies_of(trees, count, 1.2, 5)
    rng = np.random.default_rng(6)
    twists = [rng.normal(size=(count, 6)) * rng.choice([0.0, 1.0], (count, 1)) for _ in range(2)]
    twists = [t * np.array([1, 1, 1, spin, spin, spin]) for t in twists]
    found = oc.sweeps(a, b, duration=1.0, twists_a=twists[0], twists_b=twists[1])
    until = np.minimum(found.free_until, 1.0)
    for share in (*np.linspace(0.05, 0.95, 12), 0.999, 1.0 - 1e-12):
        x, y = (moved_on(s, t, share * until) for s, t in zip((a, b), twists, strict=True))
        verdicts = oc.verdicts(x, y)
        assert (verdicts[until > 0.0] != Verdict.OVERLAP).all()
    x, y = (moved_on(s, t, until) for s, t in zip((a, b), twists, strict=True))
    gaps = oc.clearances(x, y).upper
    for n in np.flatnonzero(found.hits).tolist():
        assert gaps[n] <= near_meshes(a, b, n) * (1.0 + 1e-6)
    assert found.hits.sum() > 10
    assert (~found.hits & ~found.undecided).sum() > 3
    assert found.undecided.mean() <= 0.02


def test_nothing_that_moves_never_meets() -> None:
    vertices, faces = zoo()["box0"]
    box, far = place(vertices, faces), place(vertices, faces, (2.0, 0.0, 0.0))
    assert oc.sweeps(box, far, duration=1.0).free_until.tolist() == [np.inf]
    together = [1e6, -1e6, 3e5, 0, 0, 0]
    found = oc.sweeps(box, far, duration=1.0, twists_a=together, twists_b=together)
    assert found.free_until.tolist() == [np.inf]


@given(st.floats(0.05, 0.4), st.floats(-50.0, 50.0), st.floats(0.5, 3.0))
def test_a_ball_against_a_box_that_spins_about_its_way(
    radius: float, spin: float, speed: float
) -> None:
    corners = np.array([[0.0, 0, 0]] * 3)
    ball = place(corners, TRIANGLE)
    vertices, faces = zoo()["box1"]
    box = place(vertices, faces, (4.0, 0.0, 0.0))
    found = oc.sweeps(
        *(ball, box), duration=9.0, radii_a=radius,
        twists_a=[speed, 0, 0, 0, 0, 0], twists_b=[0, 0, 0, spin, 0, 0],
    )  # fmt: skip
    truth = (4.0 + vertices[:, 0].min() - radius) / speed
    assert found.hits[0]
    assert truth - 2e-4 / speed <= found.times[0] <= truth * (1.0 + 1e-15)
    assert found.positions[0, 0] == pytest.approx(4.0 + vertices[:, 0].min(), abs=2e-4)


@each(
    "change, reason",
    [
        ({"duration": 0.0}, "duration must be positive"),
        ({"duration": math.nan}, "duration"),
        ({"twists_a": [1.0, 2.0]}, "twists_a must be"),
        ({"twists_b": np.full(6, np.inf)}, "twists_b"),
        ({"radii_a": -1.0}, "radii_a"),
        ({"tolerance": 1e-9}, "tolerance must be from"),
        ({"twists_a": np.full(6, 1e300), "duration": 1e9}, "twists times duration"),
    ],
)
def test_what_cannot_be_used_is_refused(change: dict[str, object], reason: str) -> None:
    box = place(*zoo()["box0"])
    refused(reason, oc.sweeps, box, box, **({"duration": 1.0} | change))
