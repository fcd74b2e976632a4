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

"""Contacts: the least penetration, points in both boxes, simple places, and noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import oracle
import pytest
from each import each
from exact_bodies import outside
from exact_vectors import exact
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from support import contacts, family, joined, refused, row_of, sizes, stored

import obb_collision as oc
from obb_collision import Boxes, Verdict, verdicts
from obb_collision.queries.contacts import FEATURE_TIE, Contacts
from obb_collision.typing import Floats
from tools.cases.families import FAMILIES
from tools.cases.placement import random_rotations, turns

#: Promised accuracy of depth and normal, and of points, relative to the sum of half extents.
DEPTH_ACCURACY = 1e-12
POINT_ACCURACY = 1e-9


def colliding(name: str, n: int) -> tuple[Boxes, Boxes]:
    """Return the pairs of a family that are not separate."""
    a, b = family(name, n)
    rows = np.flatnonzero(verdicts(a, b) != Verdict.SEPARATE)
    return a[rows], b[rows]


def one(a: Any, b: Any, limit: int = 4) -> tuple[Floats, Floats, float]:
    """Return points, normal and depth of one pair of (centre, rotation, half extents)."""
    boxes = Boxes(*([x, y] for x, y in zip(a, b, strict=True)))
    found = contacts(boxes, [[0, 1]], limit)
    return found.positions[0, : found.counts[0]], found.normals[0], float(found.depths[0])


def assert_same_places(found: Floats, wanted: Any, tolerance: float = 1e-12) -> None:
    """Assert that two sets of points (n, 3) are the same in any order."""
    wanted = np.asarray(wanted, float)
    assert found.shape == wanted.shape
    distances = np.linalg.norm(found[:, None] - wanted[None], axis=2)
    assert distances.min(axis=1).max() <= tolerance
    assert distances.min(axis=0).max() <= tolerance


def turned(axis: list[float], degrees: float) -> Floats:
    return turns(np.array([axis]), np.radians([degrees]))[0]


CUBE = ([0.0, 0.0, 0.0], np.eye(3), [1.0, 1.0, 1.0])


def test_depth_and_normal_are_the_exact_least_penetration(pairs: int) -> None:
    """Exactly projected, the boxes overlap along the normal by the least depth of 15 axes."""
    a, b = colliding("ordinary scene", pairs)
    found = oc.contacts(a, b)
    truth = -oracle.separations(stored(a), stored(b))
    size = sizes(a, b)
    assert (np.abs(found.depths - truth) <= DEPTH_ACCURACY * size).all()
    for row, normal in enumerate(found.normals):
        along = -float(oracle.gap_along(row_of(a, row), row_of(b, row), normal))
        assert abs(along - truth[row]) <= DEPTH_ACCURACY * size[row]
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=0, atol=1e-15)


@each("axis", range(15))
def test_each_of_the_15_axes_in_both_orders(axis: int) -> None:
    a, b = family("each of the 15 axes alone", 15 * 20)
    rows = np.arange(axis + 15, len(a), 30)  # odd laps overlap
    a, b = a[rows], b[rows]
    found, swapped = oc.contacts(a, b), oc.contacts(b, a)
    truth = -oracle.separations(stored(a), stored(b))
    mirrored = (axis + 3) % 6 if axis < 6 else 6 + 3 * ((axis - 6) % 3) + (axis - 6) // 3
    size = sizes(a, b)[:, None]
    assert (found.axes == axis).all()
    assert (swapped.axes == mirrored).all()
    assert (found.counts == 1).all()
    assert (swapped.counts == 1).all()
    assert (np.abs(found.depths - truth) <= DEPTH_ACCURACY * size[:, 0]).all()
    np.testing.assert_array_equal(found.normals, -swapped.normals)
    assert (np.abs(found.positions[:, 0] - swapped.positions[:, 0]) <= 1e-12 * size).all()
    # halfway between the surfaces: half the depth along the normal ends in each of them
    for box, side in ((a, 0.5), (b, -0.5)):
        surface = found.positions[:, 0] + side * found.depths[:, None] * found.normals
        local = np.einsum("nk,nki->ni", surface - box.centers, box.rotations)
        assert (np.abs((np.abs(local) - box.half_extents).max(axis=1)) <= 1e-12 * size[:, 0]).all()


@each("limit", [4, 8])
@each("name", FAMILIES)
def test_points_lie_in_both_boxes(name: str, limit: int, pairs: int) -> None:
    a, b = colliding(name, pairs // 15)
    found = oc.contacts(a, b, max_points=limit)
    for row, count in enumerate(found.counts):
        # what doubles can't express at these coordinates is not asked for
        grain = 4.0 * np.spacing(np.abs(found.positions[row, :count]).max())
        allowed = POINT_ACCURACY * float(sizes(a, b)[row]) + grain
        points = list(map(exact, found.positions[row, :count]))
        for box in (row_of(a, row), row_of(b, row)):
            assert max(outside(box, points)) <= allowed


@each("limit", [4, 8])
@each("name", FAMILIES)
def test_every_colliding_pair_has_points_and_no_other(name: str, limit: int) -> None:
    a, b = family(name, 1000)
    found = oc.contacts(a, b, max_points=limit)
    hit = verdicts(a, b) != Verdict.SEPARATE
    assert ((found.counts >= 1) == hit).all()
    assert found.counts.max() <= limit
    used = np.arange(limit) < found.counts[:, None]
    for column in (found.position_depths, found.positions[:, :, 0], found.positions[:, :, 2]):
        np.testing.assert_array_equal(np.isfinite(column), used)
    assert np.isfinite(found.normals).all()
    assert (found.depths >= 0.0).all()
    # the first point has the depth of the pair, none has more
    depths, size = found.position_depths[hit], sizes(a, b)[hit]
    assert (np.abs(depths[:, 0] - found.depths[hit]) <= 2.0 * FEATURE_TIE * size).all()
    assert (np.nanmax(depths, axis=1) <= found.depths[hit] + DEPTH_ACCURACY * size).all()
    assert (depths[used[hit]] >= 0.0).all()
    assert (depths[:, 0] >= np.nanmax(depths, axis=1) - 1.001 * FEATURE_TIE * size).all()
    # none occurs twice
    apart = np.linalg.norm(found.positions[:, :, None] - found.positions[:, None], axis=3)
    apart[:, np.arange(limit), np.arange(limit)] = np.inf
    grain = 4.0 * np.spacing(np.nanmax(np.abs(found.positions[hit]), axis=(1, 2)))
    assert (np.nanmin(apart[hit], axis=(1, 2)) >= 0.5 * FEATURE_TIE * size - grain).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-9, 1e-3, 1.0]))
def test_deep_flat_and_needle_boxes_have_points_too(seed: int, thin: float) -> None:
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.1, 1.0, (2, 20, 3)) * rng.choice([1.0, thin], (2, 20, 3))
    centers = rng.uniform(-0.1, 0.1, (2, 20, 3)) * rng.choice([0.0, 1.0, 10.0], (2, 20, 1))
    a, b = (Boxes(centers[k], random_rotations(rng, 20), half[k]) for k in range(2))
    found = oc.contacts(a, b, max_points=8)
    assert ((found.counts > 0) == (verdicts(a, b) != Verdict.SEPARATE)).all()
    for box in (a, b):
        local = np.einsum("nlk,nki->nli", found.positions - box.centers[:, None], box.rotations)
        beyond = (np.abs(local) - box.half_extents[:, None]).max(axis=2)
        allowed = POINT_ACCURACY * np.maximum(sizes(a, b), 1e-6)[:, None]
        assert not (beyond > allowed).any()  # NaN past the count


def test_bad_input_is_refused_by_name() -> None:
    boxes = Boxes(np.zeros((2, 3)), [np.eye(3)] * 2, np.ones((2, 3)))
    refused("max_points must be 4 or 8, got 5", contacts, boxes, [[0, 1]], 5)


def test_a_box_on_a_table_stands_on_its_four_corners() -> None:
    points, normal, depth = one(CUBE, ([0.5, 0.0, 1.4], turned([0, 0, 1], 90), [0.2, 0.4, 0.5]))
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-15)
    assert depth == pytest.approx(0.1, abs=1e-15)
    assert_same_places(points, [[x, y, 0.95] for x in (0.1, 0.9) for y in (-0.2, 0.2)])


def test_a_turned_cube_on_a_cube_has_eight_points_or_every_other() -> None:
    above = ([0.0, 0.0, 1.99], turned([0, 0, 1], 45), [1.0, 1.0, 1.0])
    reach = np.sqrt(2.0) - 1.0
    octagon = [[s, t * reach] for s in (-1, 1) for t in (-1, 1)]
    octagon += [[t * reach, s] for s in (-1, 1) for t in (-1, 1)]
    wanted = np.array([[x, y, 0.995] for x, y in octagon])
    assert_same_places(one(CUBE, above, 8)[0], wanted)
    four, _, _ = one(CUBE, above, 4)
    assert len(four) == 4
    distances = np.linalg.norm(four[:, None] - wanted[None], axis=2).min(axis=1)
    assert (distances < 1e-12).all()
    sides = np.linalg.norm(four - np.roll(four, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, sides[0])  # a square, not four in a corner


def test_an_edge_on_a_face_has_two_points_and_a_vertex_one() -> None:
    diagonal = np.sqrt(0.5)
    points, normal, _ = one(CUBE, ([0, 0, 1 + diagonal - 0.01], turned([1, 0, 0], 45), [0.5] * 3))
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-15)
    assert_same_places(points, [[-0.5, 0, 0.995], [0.5, 0, 0.995]])
    standing = turns(np.array([[1.0, -1.0, 0.0]]), np.array([np.arctan(np.sqrt(2.0))]))[0]
    points, _, _ = one(CUBE, ([0, 0, 1 + np.sqrt(0.75) - 0.01], standing, [0.5] * 3))
    assert_same_places(points, [[0, 0, 0.995]])


def test_two_edges_that_cross_meet_halfway() -> None:
    half = [0.5] * 3
    a = ([0, 0, 0], turned([1, 0, 0], 45), half)
    b = ([0.1, 0.2, 2 * np.sqrt(0.5) - 0.02], turned([0, 1, 0], 45), half)
    points, normal, depth = one(a, b)
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-15)
    assert depth == pytest.approx(0.02, abs=1e-15)
    assert_same_places(points, [[0.1, 0, np.sqrt(0.5) - 0.01]])


def test_touching_at_a_face_an_edge_and_a_vertex() -> None:
    for offset, count in (([2, 0, 0], 4), ([2, 2, 0], 2), ([2, 2, 2], 1)):
        points, _, depth = one(CUBE, (offset, np.eye(3), [1.0] * 3))
        assert depth == 0.0
        assert len(points) == count
        assert (np.abs(points).max(axis=1) == 1.0).all()


def test_identical_and_nested_boxes() -> None:
    points, _, depth = one(CUBE, CUBE)
    assert depth == 2.0
    assert len(points) == 4
    points, _, depth = one(CUBE, ([0.1, 0, 0], np.eye(3), [0.1] * 3))
    assert depth == pytest.approx(1.0, abs=1e-15)
    assert len(points) >= 1


#: Noise on poses: metres and radians.
NOISE = 1e-9


def stack(yaw: float, depth: float, base: Floats) -> tuple[Floats, Floats, Floats]:
    """Ten cubes of 1 m on top of each other, each turned by ``yaw`` degrees more than the last."""
    heights = np.arange(10) * (1.0 - depth)
    rotations = turns(np.tile([0.0, 0.0, 1.0], (10, 1)), np.radians(yaw) * np.arange(10))
    centers = np.stack([0.0 * heights, 0.0 * heights, heights], axis=1)
    return centers @ base.T, base @ rotations, np.full((10, 3), 0.5)


BASES = {"upright": np.eye(3), "tilted": turned([1.0, 2.0, -0.5], 40.0)}
STACK_PAIRS = np.stack([np.arange(9), np.arange(1, 10)], axis=1)


def noisy(boxes: tuple[Floats, Floats, Floats], rng: np.random.Generator) -> Boxes:
    centers, rotations, half = boxes
    turn = rng.normal(size=centers.shape)
    small = turns(turn, rng.uniform(-NOISE, NOISE, len(centers)))
    return Boxes(centers + rng.uniform(-NOISE, NOISE, centers.shape), small @ rotations, half)


def under_noise(
    boxes: tuple[Floats, Floats, Floats], pairs: ArrayLike, limit: int = 4, times: int = 50
) -> tuple[Contacts, list[Contacts]]:
    """Return contacts at rest, and under noise, whose points keep their places to ten times it."""
    resting, rng = contacts(Boxes(*boxes), pairs, limit), np.random.default_rng(5)
    noised = [contacts(noisy(boxes, rng), pairs, limit) for _ in range(times)]
    for found in noised:
        moved = np.linalg.norm(found.positions - resting.positions, axis=2)
        assert np.nanmax(moved) <= 10.0 * NOISE
        np.testing.assert_array_equal(found.counts, resting.counts)
    return resting, noised


@each("limit", [4, 8])
@each("yaw", [0.0, 30.0, 45.0, 90.0, 17.0])
@each("depth", [1e-6, 1e-3, 0.05])
@each("base", BASES)
def test_a_resting_stack_stays_under_noise(base: str, depth: float, yaw: float, limit: int) -> None:
    """Points keep their order and their places, to ten times the noise."""
    resting, noised = under_noise(stack(yaw, depth, BASES[base]), STACK_PAIRS, limit, 30)
    assert (resting.counts == (limit if yaw % 90.0 else 4)).all()
    for found in noised:
        assert np.abs(found.depths - resting.depths).max() <= 10.0 * NOISE
        assert np.abs(found.normals - resting.normals).max() <= 10.0 * NOISE


@each("limit", [4, 8])
@each("angle", [1e-6, 1e-4, 1e-2])
def test_edges_that_cross_at_a_small_angle_give_no_loose_points(angle: float, limit: int) -> None:
    """Where they cross moves a hundred to a million times as far as they do: no place for one."""
    boxes = stack(np.degrees(angle), 1e-3, BASES["tilted"])
    assert (under_noise(boxes, STACK_PAIRS, limit)[0].counts == 4).all()


def test_faces_that_lean_alike_do_not_take_turns() -> None:
    """An edge sunk into a wall hardly wider: both faces beside it face the wall equally."""
    wall, cube = [0.03, 1.0, 1.0], [0.5] * 3
    centers = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0 + np.sqrt(0.5) - 0.05]])
    rotations = np.array([np.eye(3), turned([0, 1, 0], 45)])
    under_noise((centers, rotations, np.array([wall, cube])), [[0, 1]])


@each("limit", [4, 8])
@each("name", ["ordinary scene", "each of the 15 axes alone"])
def test_points_of_any_pair_stay_under_noise(name: str, limit: int) -> None:
    """However they overlap: each point has one of before nearby, moved with both its boxes."""
    a, b = colliding(name, 3000)
    boxes, rows = joined(a, b)
    before = contacts(boxes, rows, limit)
    after = contacts(noisy(stored(boxes), np.random.default_rng(7)), rows, limit)
    np.testing.assert_array_equal(after.counts, before.counts)
    apart = np.linalg.norm(after.positions[:, :, None] - before.positions[:, None], axis=3)
    nearest = np.where(np.isnan(apart), np.inf, apart).min(axis=2)
    used = np.arange(limit) < after.counts[:, None]
    moved = 2.0 * NOISE * (1.0 + sizes(a, b))  # two boxes shift, and turn about their centres
    assert (nearest <= 10.0 * moved[:, None])[used].all()


@each("yaw", [0.0, 30.0, 45.0])
def test_boxes_that_only_just_touch_lose_points_but_move_none(yaw: float) -> None:
    boxes = stack(yaw, 0.0, BASES["upright"])
    resting = contacts(Boxes(*boxes), STACK_PAIRS)
    rng = np.random.default_rng(6)
    for _ in range(200):
        found = contacts(noisy(boxes, rng), STACK_PAIRS)
        for row, count in enumerate(found.counts):
            apart = found.positions[row, :count, None] - resting.positions[row, None]
            nearest = np.linalg.norm(apart, axis=2).min(axis=1)
            assert (nearest <= 10.0 * NOISE).all()


LEAN = turned([1, 1, 0], 1)
#: Small boxes in motion on a large one: 0 to 1 is a movement of about a metre or a radian.
PATHS: dict[str, Callable[[float], tuple[list[float], Floats]]] = {
    "slides off": lambda t: ([0.5 + t, 0.1, 1.24], turned([0, 0, 1], 20)),
    "turns": lambda t: ([0.9, 0.1, 1.24], turned([0, 0, 1], 10 + 57 * t)),
    "leans": lambda t: ([0.5, 0.1, 1.24], turned([1, 0.4, 0], 1 + 10 * t) @ LEAN),
    "sinks": lambda t: ([0.8, 0.1, 1.24 - 0.2 * t], LEAN @ turned([0, 0, 1], 25)),
}


@each("name", PATHS)
def test_small_motion_moves_points_a_little(name: str) -> None:
    """Points that stay in contact move with the boxes; those that come or go have no depth.

    Of a patch with more corners than points, those least needed change places: with eight
    points nothing is left out.
    """
    steps = 2000
    places = [PATHS[name](t) for t in np.linspace(0.0, 1.0, steps)]
    boxes = Boxes(
        [CUBE[0], *(center for center, _ in places)],
        [CUBE[1], *(rotation for _, rotation in places)],
        [CUBE[2], *([[0.3, 0.2, 0.25]] * steps)],
    )
    found = contacts(boxes, np.stack([np.zeros(steps, int), 1 + np.arange(steps)], axis=1), 8)
    jumps = []
    for row in range(1, steps):
        if found.counts[row] == 0 or found.axes[row] != found.axes[row - 1]:
            continue
        now, before = (found.positions[k, : found.counts[k]] for k in (row, row - 1))
        apart = np.linalg.norm(now[:, None] - before[None], axis=2).min(axis=1)
        shallow = found.position_depths[row, : len(now)] <= 5.0 / steps
        jumps += [row] * int(((apart > 5.0 / steps) & ~shallow).sum())
    assert jumps == []
