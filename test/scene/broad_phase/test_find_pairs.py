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

"""Every colliding pair is found, and no other, and what `nms` keeps: by brute force and exactly."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import oracle
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from processes import run_python
from scenes import counted
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from support import by_threads, refused, row_of, stored

import obb_collision as oc
from obb_collision.benchmarks.contestants import FORMS, make_frames
from obb_collision.scene.broad_phase import find_pairs
from tools.cases.placement import random_rotations

Rng = np.random.Generator
Maker = Callable[[Rng, int], oc.Boxes]
Change = Callable[[Rng, np.ndarray], np.ndarray]
SEPARATE = oc.Verdict.SEPARATE


def upright(centers: np.ndarray, half: np.ndarray) -> oc.Boxes:
    return oc.Boxes(centers, np.tile(np.eye(3), (len(centers), 1, 1)), half)


def uniform(rng: Rng, n: int) -> oc.Boxes:
    centers = rng.uniform(0.0, n ** (1 / 3) * 0.7, (n, 3))
    return oc.Boxes(centers, random_rotations(rng, n), rng.uniform(0.05, 0.5, (n, 3)))


def formed(form: str) -> Maker:
    """Return what makes boxes of a form of the benchmark."""

    def make(rng: Rng, n: int) -> oc.Boxes:
        half_extents, frames = make_frames(form, max(n, 8), 0.0, int(rng.integers(2**31)))
        return oc.Boxes.from_poses(frames[0].poses, half_extents)[:n]

    return make


def identical(rng: Rng, n: int) -> oc.Boxes:
    return uniform(rng, 1)[np.zeros(min(n, 120), dtype=np.int64)]


def diagonal(rng: Rng, n: int) -> oc.Boxes:
    centers = np.linspace(0.0, n / 4.0, n)[:, None] * np.ones(3)
    return oc.Boxes(centers, random_rotations(rng, n), rng.uniform(0.05, 0.4, (n, 3)))


def changed(centers: Change = lambda _, x: x, half: Change = lambda _, x: x) -> Maker:
    """Return what makes uniform boxes with other centres or half extents."""

    def make(rng: Rng, n: int) -> oc.Boxes:
        boxes = uniform(rng, n)
        moved, sized = centers(rng, boxes.centers), half(rng, boxes.half_extents.copy())
        return oc.Boxes(moved, boxes.rotations, sized)

    return make


def floor_plan(rng: Rng, n: int) -> oc.Boxes:
    """Lay all centres in one plane; many boxes touch exactly, and some are points."""
    centers = rng.integers(0, 2 * int(n**0.5), (n, 3)) / 2.0 * [1.0, 1.0, 0.0]
    return upright(centers, rng.integers(0, 3, (n, 3)) / 4.0)


def bricks(rng: Rng, n: int) -> oc.Boxes:
    """Lay bricks edge to edge: every neighbour touches exactly, corners included."""
    cells = np.array(list(np.ndindex(*[round(n ** (1 / 3))] * 3))).reshape(-1, 3)
    cells = rng.permutation(cells)
    return upright(cells * [1.0, 0.5, 0.25], np.tile([0.5, 0.25, 0.125], (len(cells), 1)))


FAMILIES: list[Maker] = [
    *(uniform, identical, diagonal, floor_plan, bricks, *map(formed, FORMS)),
    changed(half=lambda rng, half: np.where(np.arange(len(half))[:, None] == 1, 1e6, half)),
    changed(lambda rng, x: x + np.array([1e9, -1e8, 1e7])),
    changed(lambda rng, x: np.where(np.arange(len(x))[:, None] == 0, [1e299, -1e299, 1e9], x)),
    changed(lambda rng, x: x + np.where(rng.random((len(x), 1)) < 0.5, 1e299, -1e299)),
    changed(half=lambda rng, half: 2.0 * half * (rng.random(half.shape) < 0.5)),  # flat
    changed(lambda rng, x: 1e-160 * x, lambda rng, half: 1e-160 * half),
]


def brute_force(boxes: oc.Boxes, exact: bool = False) -> np.ndarray:
    """Return every pair that is not SEPARATE, by asking about every pair."""
    rows = np.stack(np.triu_indices(len(boxes), 1), axis=1)
    return rows[oc.verdicts(boxes, boxes, rows, exact=exact) != SEPARATE]


def table(pairs: np.ndarray, n: int) -> np.ndarray:
    """Return which of n boxes are pairs (n, n)."""
    found = np.zeros((n, n), np.bool_)
    found[tuple(pairs.T)] = True
    return found


def overlapping(boxes: oc.Boxes, slack: float) -> np.ndarray:
    """Return which world bounds, grown a little, meet (n, n), above the diagonal."""
    low, high = boxes.world_bounds()
    more = slack * (np.abs(low) + np.abs(high)).sum(axis=1, keepdims=True)
    low, high = low - more, high + more
    return np.triu(((low[:, None] <= high) & (low <= high[:, None])).all(axis=2), 1)


def near_balls(boxes: oc.Boxes, slack: float) -> np.ndarray:
    """Return whether balls about boxes, a little larger, have a common point, in the same way."""
    x, y, z = (boxes.centers[:, None] - boxes.centers).T
    a, b, c = boxes.half_extents.T
    radii = np.hypot(np.hypot(a, b), c)
    gaps = np.hypot(np.hypot(x, y), z) - (radii[:, None] + radii) * (1.0 + slack)
    return np.triu(gaps <= slack * np.hypot(np.hypot(x, y), z), 1)


def keys(pairs: np.ndarray) -> set[tuple[int, int]]:
    return set(map(tuple, pairs.tolist()))


@each("make", FAMILIES)
@each("n", [0, 1, 2, 3, 7, 8, 9, 64, 300, 1000])
def test_every_pair_is_found_whatever_the_number_of_threads(make: Maker, n: int) -> None:
    boxes = make(np.random.default_rng(n), n)

    def search() -> tuple[np.ndarray, np.ndarray]:
        return oc.find_pairs(boxes), oc.find_pairs(boxes, accuracy="aabb")

    ((pairs, near),) = by_threads(search, 1)
    assert pairs.dtype == np.int64
    np.testing.assert_array_equal(pairs, brute_force(boxes).reshape(-1, 2))
    if n == 1000:  # enough for several threads, too many for tables
        for again in by_threads(search, 2, 3, 5):
            assert [part.tobytes() for part in again] == [pairs.tobytes(), near.tobytes()]
        return
    balls = oc.find_pairs(boxes, accuracy="sphere")
    # each pair once, in order; all that certainly are near and none that certainly are not
    for found, least, most in (
        (near, overlapping(boxes, 0.0), overlapping(boxes, 1e-13)),
        (balls, table(pairs, len(boxes)) | near_balls(boxes, 0.0), near_balls(boxes, 1e-11)),
    ):
        there = table(found, len(boxes))
        np.testing.assert_array_equal(found, np.argwhere(there))
        assert not (least & ~there).any()
        assert not (there & ~most).any()


@each("make", FAMILIES)
def test_a_scene_in_which_few_boxes_move_finds_what_a_search_anew_does(make: Maker) -> None:
    boxes, rng = make(np.random.default_rng(2), 513), np.random.default_rng(1)
    scene, names = oc.Scene(accuracy="aabb"), [f"{k}" for k in range(len(boxes))]
    poses = np.column_stack([boxes.centers, boxes.quaternions])
    scene.add_boxes(names, 2.0 * boxes.half_extents, poses)
    for step in range(8):
        rows = np.sort(rng.choice(len(boxes), 5, replace=False))
        scene.move_indices(rows, poses[rng.integers(0, len(boxes), len(rows))])
        scene.set_enabled(names[rows[0]], bool(step % 3 == 2))
        report = scene.check()
        active = np.flatnonzero(report.cycle.active[: len(boxes)])
        found = oc.find_pairs(scene.boxes[active], accuracy="aabb")
        assert report.pairs.tolist() == active[found].tolist()


def test_very_many_cubes_are_found_by_several_threads() -> None:
    """More boxes and pairs than are sorted at once, by a tree of scipy."""
    centers = np.random.default_rng(7).uniform(0.0, 60.0, (140_000, 3))
    cubes = upright(centers, np.full((140_000, 3), 0.5))
    expected = cKDTree(centers).query_pairs(1.0, p=np.inf, output_type="ndarray")
    expected = expected[np.lexsort(expected.T[::-1])]
    assert len(expected) > 140_000
    for found in by_threads(lambda: oc.find_pairs(cubes), 1, 2):
        np.testing.assert_array_equal(found, expected)


def nearly_touching(rng: Rng, n: int, exponents: tuple[int, int]) -> oc.Boxes:
    """Lay boxes beside one another, some units in the last place apart, along the world's axes.

    Sizes are 10^exponents, up to the largest numbers accepted; half of the boxes are turned.
    """
    half = 10.0 ** rng.uniform(*exponents, (n, 1)) * rng.uniform(0.1, 1.0, (n, 3))
    half = np.minimum(half, 1e300)
    first = rng.uniform(-1.0, 1.0, (n, 3)) * np.minimum(half.max(axis=1, keepdims=True), 4e299)
    rotations = np.tile(np.eye(3), (n, 1, 1))
    turned = rng.random(n) < 0.5
    rotations[turned] = random_rotations(rng, int(turned.sum()))
    low, high = oc.Boxes(first, rotations, half).world_bounds()
    k, row = rng.integers(0, 3, n), np.arange(n)
    beside = first.copy()
    beside[row, k] += high[row, k] - low[row, k]
    beside[row, k] += rng.integers(-3, 40, n) * np.spacing(np.abs(beside).max(axis=1))
    parts = ((first, np.clip(beside, -1e300, 1e300)), (rotations, rotations), (half, half))
    return oc.Boxes(*(np.concatenate(part) for part in parts))


MAGNITUDES = [(-324, -300), (-170, -150), (-3, 3), (140, 170), (298, 300), (300, 300), (-324, 300)]
NEAR = [partial(nearly_touching, exponents=exponents) for exponents in MAGNITUDES]


@each("make", [*FAMILIES, *NEAR])
def test_every_pair_is_found_by_exact_truth(make: Maker) -> None:
    """Against the oracle, which shares nothing with the library; bounds hold every corner."""
    boxes = make(np.random.default_rng(99), 20 if make in NEAR else 45)
    rows, found = np.stack(np.triu_indices(len(boxes), 1), axis=1), oc.find_pairs(boxes)
    truth = rows[oracle.verdicts(*(stored(boxes[rows[:, k]]) for k in (0, 1))) != SEPARATE]
    np.testing.assert_array_equal(oc.find_pairs(boxes, exact=True), truth)
    np.testing.assert_array_equal(found, brute_force(boxes))
    for accuracy in ("sphere", "aabb"):
        assert keys(truth) <= keys(found) <= keys(oc.find_pairs(boxes, accuracy=accuracy))
    assert make not in NEAR or len(found) > len(truth) + 1, "apart, which doubles can't tell"
    minimum, maximum = boxes.world_bounds()
    for row in range(0, len(boxes), 2):
        for corner in oracle.corners(row_of(boxes, row)):
            assert all(minimum[row, k] <= corner[k] <= maximum[row, k] for k in range(3))


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(0, 12), st.integers(0, 300), st.booleans())
def test_pairs_between_sets_are_as_by_brute_force(seed: int, n: int, m: int, exact: bool) -> None:
    rng = np.random.default_rng(seed)
    both = uniform(rng, n + m)
    if seed % 3:
        both = nearly_touching(rng, 1 + (n + m) // 20, (-3, 3) if seed % 2 else (-324, 300))
    a, b = both[:n], both[n:]
    pairs = np.argwhere(np.ones((len(a), len(b))))
    expected = pairs[oc.verdicts(a, b, pairs, exact=exact) != SEPARATE]
    np.testing.assert_array_equal(oc.find_pairs(a, b, exact=exact), expected)
    assert oc.any_collision(a, b, exact=exact) == (len(expected) > 0)
    assert oc.any_collision(both, exact=exact) == (len(brute_force(both, exact)) > 0)
    swapped = oc.find_pairs(b, a, exact=exact)[:, ::-1]
    np.testing.assert_array_equal(swapped[np.lexsort(swapped.T[::-1])], expected)
    for accuracy in ("sphere", "aabb"):
        among = oc.find_pairs(both, accuracy=accuracy)
        across = among[(among[:, 0] < len(a)) & (among[:, 1] >= len(a))] - [0, len(a)]
        found = oc.find_pairs(a, b, accuracy=accuracy)
        np.testing.assert_array_equal(found, across)
        assert keys(expected) <= keys(found)


def test_the_order_of_the_boxes_does_not_matter_and_a_set_may_be_both_sides() -> None:
    rng = np.random.default_rng(4)
    boxes = uniform(rng, 400)
    order, expected = rng.permutation(len(boxes)), oc.find_pairs(boxes)
    there = np.sort(order[oc.find_pairs(boxes[order])], axis=1)
    np.testing.assert_array_equal(there[np.lexsort(there.T[::-1])], expected)
    twice = oc.find_pairs(boxes, boxes)
    np.testing.assert_array_equal(twice[twice[:, 0] < twice[:, 1]], expected)
    assert len(twice) == 2 * len(expected) + len(boxes)


def test_the_first_certain_collision_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    tested = counted(monkeypatch, find_pairs, "colliding_pairs", 1)

    def tests(a: oc.Boxes, b: oc.Boxes | None, exact: bool, expected: bool) -> int:
        tested.clear()
        assert oc.any_collision(a, b, exact=exact) == expected
        return sum(tested)

    rng = np.random.default_rng(10)
    places = 3.0 * np.array(list(np.ndindex(10, 10, 10)))
    apart = oc.Boxes(places, random_rotations(rng, 1000), np.full((1000, 3), 0.6))
    assert tests(apart, None, False, False) == len(oc.find_pairs(apart, accuracy="aabb"))
    crowd = identical(rng, 120)
    assert tests(crowd, None, False, True) == tests(crowd, crowd, True, True) == 16

    step = 2.0 + 2.0**-51
    boxes = upright(np.concatenate([[np.zeros(3)], step * np.eye(3), -step * np.eye(3)]),
                    np.ones((7, 3)))  # fmt: skip
    doubtful = len(brute_force(boxes))
    assert doubtful > 7
    assert oc.any_collision(boxes)
    assert tests(boxes, None, True, False) == doubtful
    assert tests(boxes[:1], boxes[1:], True, False) == 6


INTERPRETED = """
import numpy as np
import obb_collision as oc
for n in range(3):
    boxes = oc.Boxes(**np.load(f"boxes{n}.npz"))
    np.save(f"pairs{n}.npy", oc.find_pairs(boxes, accuracy="aabb"))
"""


def test_interpreted_kernels_find_the_same_pairs(tmp_path: Path) -> None:
    decades = formed("decades")
    families = [make(np.random.default_rng(1), 65) for make in (uniform, floor_plan, decades)]
    for n, boxes in enumerate(families):
        np.savez(tmp_path / f"boxes{n}", **boxes.arrays._asdict())
    package = str(Path(oc.__file__).parents[1])
    run_python("-c", INTERPRETED, cwd=tmp_path, NUMBA_DISABLE_JIT="1", PYTHONPATH=package)
    for n, boxes in enumerate(families):
        pairs = oc.find_pairs(boxes, accuracy="aabb")
        assert len(pairs) > 0
        np.testing.assert_array_equal(np.load(tmp_path / f"pairs{n}.npy"), pairs)


def greedy(boxes: oc.Boxes, scores: list[float], threshold: float) -> list[int]:
    """Return the rows that are kept, by the definition: each against all that are kept."""
    kept: list[int] = []
    for row in sorted(range(len(scores)), key=lambda row: (-scores[row], row)):
        against = oc.iou(boxes, boxes, [(row, other) for other in kept] or np.zeros((0, 2), int))
        if not (against > threshold).any():
            kept.append(row)
    return kept


@each("seed", range(10))
def test_what_is_kept_is_what_the_definition_keeps_and_nonsense_is_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 80))
    seen = rng.integers(0, max(count // 3, 1), count)  # each thing about three times, some the same
    shifts = rng.choice([0.0, 0.05, 0.3], (count, 3))
    turned = Rotation.random(count + 1, random_state=seed).as_matrix()[:count]  # one, at least
    rotations = turned if seed % 2 else np.eye(3)
    boxes = oc.Boxes(
        rng.uniform(0, 3, (count, 3))[seen] + shifts,
        np.broadcast_to(rotations, (count, 3, 3)),
        np.tile([0.5, 0.4, 0.3 * (seed % 5 > 0)], (count, 1)),  # one family is flat
    )
    scores = rng.integers(0, 5, count) / 4.0  # many ties
    for threshold in (0.0, 0.2, 0.7, 1.0):
        kept = oc.nms(boxes, scores, threshold)
        assert kept.tolist() == greedy(boxes, scores.tolist(), threshold)
        assert kept.dtype == np.int64
    labels = [["car", 2, None][k] for k in rng.integers(0, 3, count)]
    by_class = [[n for n in range(count) if labels[n] == label] for label in ("car", 2, None)]
    kept_rows = {rows[k] for rows in by_class for k in oc.nms(boxes[rows], scores[rows], 0.2)}
    found = oc.nms(boxes, scores, 0.2, classes=labels).tolist()
    assert found == sorted(kept_rows, key=lambda row: (-scores[row], row))
    refused("classes", oc.nms, boxes, scores, 0.2, [*labels, 1])
    refused("classes must be a number or a string", oc.nms, boxes, scores, 0.2, 3)
    for threshold in (-0.1, 1.1, np.nan):
        refused("threshold must be", oc.nms, boxes, scores, threshold)
    for wrong in ([*scores[1:], np.nan], np.zeros(count + 1)):
        refused("scores", oc.nms, boxes, wrong, 0.5)
