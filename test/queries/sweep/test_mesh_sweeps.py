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

"""Sweeps of meshes: never late, none missed, and no earlier than the tolerance."""

from __future__ import annotations

import math
from fractions import Fraction

import hull_distances
import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from mesh_zoo import zoo
from placed_meshes import TRIANGLE, as_drawn, bodies_of, exact_corners, moved_on, place, trees_of
from scipy.spatial.transform import Rotation
from support import refused
from triangle_pairs import FAMILIES, SHARE, Maker

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.queries.sweep import TOLERANCE

#: Families whose sizes differ so much from each other or their offset that doubles have too few
#: digits for the tolerance.
TOO_FEW_DIGITS = ("far", "different_sizes", "degenerate")


def near_of(a: PlacedMeshes, b: PlacedMeshes, n: int) -> float:
    radii = [
        math.hypot(*x.trees.nodes[x.trees.roots[x.meshes[n]], 12:15]) * (1.0 + 1e-9) for x in (a, b)
    ]
    return float(max(TOLERANCE * min(radii), 2e-6 * max(radii)))


@each("make", FAMILIES)
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
        way = [Fraction(x) * time for x in twists[n, :3].tolist()]
        first, start = ([(v[0], v[1], v[2]) for v in t] for t in (p, q))
        then = [(x + way[0], y + way[1], z + way[2]) for x, y, z in start]
        if time > 0:
            assert hull_distances.squared_distance(first, start + then) > 0
        if found.hits[n]:
            near = Fraction(near_of(a, b, n))
            assert hull_distances.squared_distance(first, then) <= near * near
    if make.__name__.strip("_") not in TOO_FEW_DIGITS:
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
        assert gaps[n] <= near_of(a, b, n) * (1.0 + 1e-6)
    assert found.hits.sum() > 10
    assert (~found.hits & ~found.undecided).sum() > 3
    assert found.undecided.mean() <= 0.02


def test_what_starts_inside_a_solid_or_touching_is_hit_at_once() -> None:
    vertices, faces = zoo()["box0"]
    box = place(vertices, faces)
    crumb = place(vertices * 0.1, faces)
    found = oc.sweeps(box, crumb, duration=1.0, twists_b=[0, 0, 9.0, 0, 0, 0])
    assert (found.hits.tolist(), found.times.tolist()) == ([True], [0.0])
    found = oc.sweeps(box, box, duration=1.0)
    assert found.times.tolist() == [0.0]


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


def test_boxes_as_meshes_meet_when_boxes_do() -> None:
    rng = np.random.default_rng(3)
    count, (vertices, faces) = 100, zoo()["box2"]
    half = np.abs(vertices).max(axis=0)
    turns = Rotation.random(2 * count, random_state=rng).as_matrix()
    centers = rng.uniform(-1.0, 1.0, (2 * count, 3))
    twists = rng.normal(size=(2 * count, 6))
    boxes = oc.Boxes(centers, turns, np.tile(half, (2 * count, 1)))
    moving = oc.MovingBoxes.from_twists(boxes, twists, 1.0)
    pairs = np.arange(2 * count).reshape(-1, 2)
    truth = oc.sweeps(moving, moving, pairs)
    bodies = PlacedMeshes(MeshTrees.build(vertices, faces), [0] * (2 * count), centers, turns)
    found = oc.sweeps(bodies, bodies, pairs, duration=1.0, twists_a=twists, twists_b=twists)
    both = truth.hits & found.hits
    assert both.sum() > 10
    assert (truth.hits == found.hits).mean() > 0.95  # the others pass within the tolerance
    assert np.abs(truth.times[both] - found.times[both]).max() < 0.01


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
