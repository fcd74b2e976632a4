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

"""Every colliding pair is found: the broad phase against brute force, in many distributions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import oracle
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from support import row_of, stored

import obb_collision as oc
from obb_collision import verdicts
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.verdict import Verdict, pair_verdicts
from obb_collision.scene.broad_phase.any_collision import any_collision, find_first
from obb_collision.scene.broad_phase.broad_phase import find_candidates
from obb_collision.scene.broad_phase.find_pairs import find_pairs
from tools.cases.placement import random_rotations

Rng = np.random.Generator


def uniform(rng: Rng, n: int) -> Boxes:
    side = n ** (1 / 3) * 0.7
    return Boxes(
        rng.uniform(0.0, side, (n, 3)), random_rotations(rng, n), rng.uniform(0.05, 0.5, (n, 3))
    )


def clustered(rng: Rng, n: int) -> Boxes:
    middles = rng.uniform(-1000.0, 1000.0, (8, 3))
    centers = middles[rng.integers(0, 8, n)] + rng.normal(size=(n, 3))
    return Boxes(centers, random_rotations(rng, n), rng.uniform(0.01, 0.3, (n, 3)))


def identical(rng: Rng, n: int) -> Boxes:
    box = uniform(rng, 1)
    return box[np.zeros(min(n, 120), dtype=np.int64)]


def collinear(rng: Rng, n: int) -> Boxes:
    along = np.sort(rng.uniform(0.0, n / 3.0, n))[:, None]
    return Boxes(along * [1.0, 0.0, 0.0], random_rotations(rng, n), rng.uniform(0.1, 0.4, (n, 3)))


def diagonal(rng: Rng, n: int) -> Boxes:
    return Boxes(
        np.linspace(0.0, n / 4.0, n)[:, None] * np.ones(3),
        random_rotations(rng, n),
        rng.uniform(0.05, 0.4, (n, 3)),
    )


def mixed_sizes(rng: Rng, n: int) -> Boxes:
    """Sizes 1 : 1e6."""
    scale = 10.0 ** rng.uniform(-3.0, 3.0, (n, 1))
    half = rng.uniform(0.1, 1.0, (n, 3)) * scale
    return Boxes(rng.uniform(-1000.0, 1000.0, (n, 3)), random_rotations(rng, n), half)


def one_giant(rng: Rng, n: int) -> Boxes:
    boxes = uniform(rng, n)
    half = boxes.half_extents.copy()
    half[n // 2] = 1e6
    return Boxes(boxes.centers, boxes.rotations, half)


def far_away(rng: Rng, n: int) -> Boxes:
    boxes = uniform(rng, n)
    return Boxes(boxes.centers + np.array([1e9, -1e8, 1e7]), boxes.rotations, boxes.half_extents)


def far_apart(rng: Rng, n: int) -> Boxes:
    boxes = uniform(rng, n)
    centers = boxes.centers + np.where(rng.random((n, 1)) < 0.5, 1e299, -1e299)
    return Boxes(centers, boxes.rotations, boxes.half_extents)


def flat(rng: Rng, n: int) -> Boxes:
    boxes = uniform(rng, n)
    half = boxes.half_extents * (rng.random((n, 3)) < 0.5) * 2.0
    return Boxes(boxes.centers, boxes.rotations, half)


def coplanar(rng: Rng, n: int) -> Boxes:
    """Lay out a floor plan: all centres in one plane, many touching exactly."""
    centers = rng.integers(0, 2 * int(n**0.5), (n, 3)) / 2.0 * [1.0, 1.0, 0.0]
    half = rng.integers(0, 3, (n, 3)) / 4.0
    return Boxes(centers, np.tile(np.eye(3), (n, 1, 1)), half)


def grid_stack(rng: Rng, n: int) -> Boxes:
    """Lay bricks edge to edge: every neighbour touches exactly, corners included."""
    side = round(n ** (1 / 3))
    cells = np.stack(np.meshgrid(*3 * [np.arange(side)], indexing="ij"), axis=-1).reshape(-1, 3)
    order = rng.permutation(len(cells))
    return Boxes(
        cells[order] * [1.0, 0.5, 0.25],
        np.tile(np.eye(3), (len(cells), 1, 1)),
        np.tile([0.5, 0.25, 0.125], (len(cells), 1)),
    )


def tiny(rng: Rng, n: int) -> Boxes:
    boxes = uniform(rng, n)
    return Boxes(boxes.centers * 1e-160, boxes.rotations, boxes.half_extents * 1e-160)


DISTRIBUTIONS: list[Callable[[Rng, int], Boxes]] = [
    *(uniform, clustered, identical, collinear, diagonal, mixed_sizes, one_giant),
    *(far_away, far_apart, flat, coplanar, grid_stack, tiny),
]


def all_pairs(n: int) -> np.ndarray:
    return np.stack(np.triu_indices(n, 1), axis=1)


def brute_force(boxes: Boxes, exact: bool = False) -> np.ndarray:
    """Every pair that is not SEPARATE, by asking about every pair."""
    rows = all_pairs(len(boxes))
    found = pair_verdicts(boxes, rows[:, 0].copy(), boxes, rows[:, 1].copy(), exact)
    return rows[found != Verdict.SEPARATE]


@each("n", [2, 3, 5, 33, 300, 1000])
@each("make", DISTRIBUTIONS)
def test_every_pair_is_found(make: Callable[[Rng, int], Boxes], n: int) -> None:
    boxes = make(np.random.default_rng(n), n)
    pairs = find_pairs(boxes)
    assert pairs.dtype == np.int64
    np.testing.assert_array_equal(pairs, brute_force(boxes))


@each("make", DISTRIBUTIONS)
def test_every_pair_is_found_by_exact_truth(make: Callable[[Rng, int], Boxes]) -> None:
    """The same against the oracle, which shares nothing with the library."""
    boxes = make(np.random.default_rng(99), 60)
    rows = all_pairs(len(boxes))
    sides = [stored(boxes[rows[:, k]]) for k in range(2)]
    truth = rows[oracle.verdicts(*sides) != oracle.SEPARATE]
    np.testing.assert_array_equal(find_pairs(boxes, exact=True), truth)
    default = {tuple(pair) for pair in find_pairs(boxes).tolist()}
    assert {tuple(pair) for pair in truth.tolist()} <= default


@each("make", DISTRIBUTIONS)
def test_bounds_contain_every_corner(make: Callable[[Rng, int], Boxes]) -> None:
    """No pair gets lost on the way to world bounds: they contain the exact corners."""
    boxes = make(np.random.default_rng(3), 40)
    minimum, maximum = boxes.world_bounds()
    for row in range(len(boxes)):
        for corner in oracle.corners(row_of(boxes, row)):
            for k in range(3):
                assert minimum[row, k] <= corner[k] <= maximum[row, k]


def test_candidates_are_each_pair_of_overlapping_bounds_once() -> None:
    rng = np.random.default_rng(8)
    for n in (2, 17, 64, 65, 257, 900):
        low = rng.integers(0, 20, (n, 3)).astype(float)
        high = low + rng.integers(0, 4, (n, 3)).astype(float)
        rows = all_pairs(n)
        i, j = rows.T
        expected = rows[((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)]
        found = find_candidates(low, high)
        np.testing.assert_array_equal(found[np.lexsort(found.T[::-1])], expected)


def nearly_touching(rng: Rng, n: int, exponents: tuple[int, int]) -> Boxes:
    """Lay boxes beside one another, some units in the last place apart, along the world's axes.

    Sizes are 10^exponents, up to the largest numbers accepted; half of the boxes are turned.
    """
    half = 10.0 ** rng.uniform(*exponents, (n, 1)) * rng.uniform(0.1, 1.0, (n, 3))
    half = np.minimum(half, 1e300)
    first = rng.uniform(-1.0, 1.0, (n, 3)) * np.minimum(half.max(axis=1, keepdims=True), 4e299)
    rotations = np.tile(np.eye(3), (n, 1, 1))
    turned = rng.random(n) < 0.5
    rotations[turned] = random_rotations(rng, int(turned.sum()))
    boxes = Boxes(first, rotations, half)
    low, high = boxes.world_bounds()
    k, row = rng.integers(0, 3, n), np.arange(n)
    beside = first.copy()
    beside[row, k] += high[row, k] - low[row, k]
    beside[row, k] += rng.integers(-3, 40, n) * np.spacing(np.abs(beside).max(axis=1))
    beside = np.clip(beside, -1e300, 1e300)
    parts = ((first, beside), (rotations, rotations), (half, half))
    return Boxes(*(np.concatenate(part) for part in parts))


@each("accuracy", [None, "sphere", "aabb"])
@each(
    "exponents",
    [(-324, -300), (-170, -150), (-3, 3), (140, 170), (298, 300), (300, 300), (-324, 300)],
)
def test_what_is_not_separate_is_found_at_every_magnitude(
    exponents: tuple[int, int], accuracy: str | None
) -> None:
    touching = 0
    for seed in range(8):
        boxes = nearly_touching(np.random.default_rng(seed), 15, exponents)
        if accuracy is None:
            for exact in (False, True):
                expected = brute_force(boxes, exact)
                np.testing.assert_array_equal(find_pairs(boxes, exact=exact), expected)
            rows = all_pairs(len(boxes))
            truth = oracle.verdicts(*(stored(boxes[rows[:, k]]) for k in range(2)))
            np.testing.assert_array_equal(expected, rows[truth != oracle.SEPARATE])
            touching += len(find_pairs(boxes)) - len(expected)
        else:
            found = set(map(tuple, find_pairs(boxes, accuracy=accuracy).tolist()))
            assert found >= set(map(tuple, brute_force(boxes).tolist()))
    assert accuracy is not None or touching > 8  # pairs apart that doubles can't tell apart


def test_order_of_the_boxes_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    boxes = uniform(rng, 400)
    order = rng.permutation(len(boxes))
    there = np.sort(order[find_pairs(boxes[order])], axis=1)
    np.testing.assert_array_equal(there[np.lexsort(there.T[::-1])], find_pairs(boxes))


@each("n", [0, 1])
def test_no_pairs_without_two_boxes(n: int) -> None:
    boxes = Boxes(np.zeros((n, 3)), np.zeros((n, 3, 3)) + np.eye(3), np.ones((n, 3)))
    assert find_pairs(boxes).shape == (0, 2)
    assert verdicts(boxes, boxes).shape == (n,)


def brute_force_between(a: Boxes, b: Boxes, exact: bool = False) -> np.ndarray:
    rows = np.stack(np.meshgrid(np.arange(len(a)), np.arange(len(b)), indexing="ij"), axis=-1)
    pairs = rows.reshape(-1, 2)
    return pairs[verdicts(a, b, pairs, exact=exact) != Verdict.SEPARATE]


@each("exact", [False, True])
@each("n, m", [(0, 3), (3, 0), (1, 1), (1, 300), (300, 1), (150, 200)])
def test_pairs_between_two_sets_are_those_of_brute_force(n: int, m: int, exact: bool) -> None:
    rng = np.random.default_rng(n + m)
    both = uniform(rng, n + m)
    a, b = both[:n], both[n:]
    expected = brute_force_between(a, b, exact)
    np.testing.assert_array_equal(find_pairs(a, b, exact=exact), expected)
    assert any_collision(a, b, exact=exact) == (len(expected) > 0)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12))
def test_pairs_between_two_sets_at_every_magnitude(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    both = nearly_touching(rng, n + m, (-3, 3) if seed % 2 else (-324, 300))
    a, b = both[:n], both[n:]
    for exact in (False, True):
        expected = brute_force_between(a, b, exact)
        np.testing.assert_array_equal(find_pairs(a, b, exact=exact), expected)
        assert any_collision(a, b, exact=exact) == (len(expected) > 0)
        assert any_collision(both, exact=exact) == (len(brute_force(both, exact)) > 0)
    swapped = find_pairs(b, a)[:, ::-1]
    np.testing.assert_array_equal(
        swapped[np.lexsort((swapped[:, 1], swapped[:, 0]))], find_pairs(a, b)
    )


@each("accuracy", ["sphere", "aabb"])
def test_coarse_pairs_between_two_sets_are_those_of_one_set(accuracy: str) -> None:
    boxes = uniform(np.random.default_rng(8), 300)
    among = find_pairs(boxes, accuracy=accuracy)
    between = among[(among[:, 0] < 100) & (among[:, 1] >= 100)] - [0, 100]
    found = find_pairs(boxes[:100], boxes[100:], accuracy=accuracy)
    np.testing.assert_array_equal(found, between)
    assert len(found) > len(find_pairs(boxes[:100], boxes[100:])) > 0


def test_a_set_against_itself_is_two_sets() -> None:
    boxes = uniform(np.random.default_rng(9), 50)
    pairs = find_pairs(boxes, boxes)
    assert all([k, k] in pairs.tolist() for k in range(50))
    among = pairs[pairs[:, 0] < pairs[:, 1]]
    np.testing.assert_array_equal(among, find_pairs(boxes))


def test_the_first_collision_ends_the_search() -> None:
    rng = np.random.default_rng(10)
    apart = Boxes(
        3.0 * np.stack(np.meshgrid(*[np.arange(10.0)] * 3), axis=-1).reshape(-1, 3),
        random_rotations(rng, 1000),
        np.full((1000, 3), 0.6),
    )
    found, tests = find_first(apart, None, False)
    assert not found
    assert tests == len(find_candidates(*apart.world_bounds()))
    crowd = identical(rng, 120)
    assert find_first(crowd, None, False) == (True, 1)
    assert find_first(crowd, crowd, True) == (True, 1)
    both = Boxes(
        *(np.concatenate(sides) for sides in zip(stored(apart), stored(crowd), strict=True))
    )
    assert find_first(both, None, False) == (True, tests + 1)


def test_boxes_that_only_seem_to_touch_do_not_end_an_exact_search() -> None:
    step = 2.0 + 2.0**-51
    centers = np.concatenate([[np.zeros(3)], step * np.eye(3), -step * np.eye(3)])
    boxes = Boxes(centers, [np.eye(3)] * 7, np.ones((7, 3)))
    doubtful = len(brute_force(boxes))
    assert doubtful > 7
    assert any_collision(boxes)
    assert not any_collision(boxes, exact=True)
    assert find_first(boxes, None, True) == (False, doubtful)
    assert find_first(boxes[:1], boxes[1:], True) == (False, 6)


def test_pairs_and_their_order_are_the_same_for_any_number_of_threads() -> None:
    boxes = uniform(np.random.default_rng(8), 6000)
    found = []
    for threads in (1, 2, 3, 5):
        oc.set_threads(threads)
        found.append(find_pairs(boxes))
    oc.set_threads(None)
    assert len(found[0]) > 1000
    assert (np.lexsort((found[0][:, 1], found[0][:, 0])) == np.arange(len(found[0]))).all()
    assert all((pairs == found[0]).all() for pairs in found)
