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

"""The broad phase misses no overlapping bounds, and gives no others: every form, by brute force."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

import obb_collision as oc
from obb_collision._jit import njit
from obb_collision.numerics import sorting
from obb_collision.numerics.sorting import DIGIT_BITS, FEW, sort_numbers
from obb_collision.queries.verdict.coarse import meeting_bounds
from obb_collision.scene.broad_phase import morton
from obb_collision.scene.broad_phase.bounds_tree import BoundsTree, overlapping
from obb_collision.scene.broad_phase.broad_phase import (
    UNLIMITED,
    Pairs,
    find_candidates,
    find_candidates_between,
    find_candidates_of,
    find_some_candidates,
    find_some_candidates_of,
)
from obb_collision.scene.broad_phase.find_pairs import colliding_keys, pairs_of_keys
from obb_collision.scene.broad_phase.kept_tree import KeptTree
from obb_collision.scene.broad_phase.lanes import (
    LANES,
    _lowest_in_python,
    _overlaps_in_python,
    lowest,
    overlaps,
)
from obb_collision.scene.broad_phase.morton import morton_order, morton_order_shared
from obb_collision.typing import Floats

Bounds = tuple[Floats, Floats]
PACKAGE = Path(oc.__file__).parent.parent
#: Around the sizes of blocks, of levels and of ranges for threads.
COUNTS = (1, 2, 7, 8, 9, 64, 65, 513, 1500)
FORMS = (
    "uniform", "plane", "line", "diagonal", "walls", "clusters", "identical", "decades", "far",
    "outlier", "grid", "empty ones", "points",
)  # fmt: skip


@pytest.fixture(autouse=True)
def _restore() -> Iterator[None]:
    yield
    oc.set_threads(None)


def bounds_of(form: str, count: int) -> Bounds:
    """Return bounds (n, 3) and (n, 3) of a form."""
    rng = np.random.default_rng(count)
    side = (count / 0.8) ** (1 / 3)
    centers, reach = side * rng.random((count, 3)), rng.uniform(0.1, 0.6, (count, 3))
    if form == "plane":
        centers[:, 2] = 0.25
    elif form == "line":
        centers = rng.random((count, 3)) * (2.0 * count, 0.1, 0.1)
    elif form == "diagonal":
        centers = np.repeat(count * rng.random((count, 1)), 3, axis=1)
    elif form == "walls":
        for k in range(min(count, 12)):
            reach[k], reach[k, k % 3] = side, 0.01
    elif form == "clusters":
        centers = 1e3 * rng.random((9, 3))[rng.integers(0, 9, count)] + rng.normal(0, 1, (count, 3))
    elif form == "identical":
        count = min(count, 200)
        centers, reach = np.zeros((count, 3)), np.ones((count, 3))
    elif form == "decades":
        reach *= 10.0 ** rng.uniform(-5, 1, (count, 1))
    elif form == "far":
        centers += 1e7
    elif form == "outlier":
        centers[0] = 1e299, -1e299, 1e9
    elif form == "grid":  # faces exactly on each other: closed bounds overlap
        centers, reach = rng.integers(0, 9, (count, 3)) * 1.0, np.full((count, 3), 0.5)
    elif form == "points":
        centers, reach = rng.integers(0, 5, (count, 3)) * 1.0, np.zeros((count, 3))
    minimum, maximum = centers - reach, centers + reach
    if form == "empty ones":
        minimum[::3], maximum[::3] = np.inf, -np.inf
    return minimum, maximum


def all_pairs(minimum: Floats, maximum: Floats) -> Pairs:
    """Return all overlapping pairs by looking at all pairs, sorted."""
    found = (minimum[:, None] <= maximum[None]) & (minimum[None] <= maximum[:, None])
    return np.argwhere(np.triu(found.all(axis=2), 1))


def ordered(pairs: Pairs | None) -> list[list[int]]:
    assert pairs is not None
    return sorted(pairs.tolist())


@each("count", COUNTS)
@each("form", FORMS)
def test_candidates_are_all_overlapping_pairs(form: str, count: int) -> None:
    minimum, maximum = bounds_of(form, count)
    wanted = all_pairs(minimum, maximum).tolist()
    oc.set_threads(1)
    pairs = find_candidates(minimum, maximum)
    assert ordered(pairs) == wanted
    for threads in (2, 3, 5):
        oc.set_threads(threads)
        assert (find_candidates(minimum, maximum) == pairs).all()  # in the same order, too


@each("form", FORMS)
def test_pairs_between_two_sets_and_of_some_rows(form: str) -> None:
    minimum, maximum = bounds_of(form, 1500)
    wanted = all_pairs(minimum, maximum)
    rows = np.flatnonzero(np.arange(len(minimum)) % 5 == 2)
    some = wanted[np.isin(wanted, rows).any(axis=1)].tolist()
    tree = BoundsTree.build(minimum, maximum)
    between = np.argwhere(
        (
            (minimum[::2][:, None] <= maximum[1::2][None])
            & (minimum[1::2][None] <= maximum[::2][:, None])
        ).all(axis=2)
    ).tolist()
    sides = [np.ascontiguousarray(side[k::2]) for k in (0, 1) for side in (minimum, maximum)]
    for threads in (1, 3):
        oc.set_threads(threads)
        assert ordered(find_some_candidates_of(tree, rows, UNLIMITED)) == some
        assert ordered(find_candidates_between(*sides)) == between
    row = int(rows[1])
    assert ordered(find_candidates_of(minimum, maximum, row)) == [
        pair for pair in wanted.tolist() if row in pair
    ]


@each("threads", [1, 2])
@each("form", ["uniform", "identical", "walls"])
def test_more_pairs_than_the_most_are_none(form: str, threads: int) -> None:
    oc.set_threads(threads)
    minimum, maximum = bounds_of(form, 1500)
    tree, rows = BoundsTree.build(minimum, maximum), np.arange(len(minimum))
    count = len(all_pairs(minimum, maximum))
    assert count > 1000
    for most in (0, 1, count // 2, count - 1):
        assert find_some_candidates(tree, most) is None
        assert find_some_candidates_of(tree, rows, most) is None
    for most in (count, count + 1):
        assert ordered(find_some_candidates(tree, most)) == ordered(
            find_some_candidates_of(tree, rows, most)
        )


@each("form", FORMS)
def test_a_kept_tree_finds_what_a_new_one_does(form: str) -> None:
    minimum, maximum = bounds_of(form, 513)
    kept = KeptTree(minimum, maximum)
    rng = np.random.default_rng(1)
    for _ in range(15):
        rows = np.sort(rng.choice(len(minimum), 5, replace=False))
        others = rng.integers(0, len(minimum), len(rows))
        minimum[rows], maximum[rows] = minimum[others], maximum[others]
        minimum[rows[0]], maximum[rows[0]] = np.inf, -np.inf
        if not kept.update(rows):
            kept = KeptTree(minimum, maximum)
        wanted = all_pairs(minimum, maximum)
        wanted = wanted[np.isin(wanted, rows).any(axis=1)]
        assert ordered(kept.pairs_of(rows, UNLIMITED)) == wanted.tolist()


FEW_NUMBERS = st.sampled_from([0.0, 1.0, 2.0, 1.0 + 2.0**-52, -1e300, 1e300, 5e-324, 1e7])


@settings(max_examples=100)
@given(st.lists(st.lists(FEW_NUMBERS, min_size=6, max_size=6), min_size=2, max_size=40))
def test_bounds_are_compared_exactly(numbers: list[list[float]]) -> None:
    ends = np.array(numbers).reshape(-1, 2, 3)
    minimum, maximum = ends.min(axis=1), ends.max(axis=1)
    assert ordered(find_candidates(minimum, maximum)) == all_pairs(minimum, maximum).tolist()


@each("form", FORMS)
def test_the_order_has_each_row_once_and_empty_ones_last(form: str) -> None:
    minimum, maximum = bounds_of(form, 1500)
    order, spare = np.empty((2, len(minimum)), np.int64)
    morton_order(minimum, maximum, order, spare)
    assert sorted(order.tolist()) == list(range(len(minimum)))
    empty = minimum[order, 0] > maximum[order, 0]
    assert (empty[1:] >= empty[:-1]).all()


@each("form", [*FORMS, "not a number"])
def test_many_are_ordered_by_several_threads_as_few_are(
    form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    minimum, maximum = bounds_of(form if form in FORMS else "uniform", 3000)
    if form == "not a number":
        minimum[7, 1] = np.nan
    wanted, order, spare = np.empty((3, len(minimum)), np.int64)
    morton_order(minimum, maximum, wanted, spare)
    monkeypatch.setattr(sorting, "FEWEST_NUMBERS", 64)
    monkeypatch.setattr(morton, "FEWEST_NUMBERS", 64)
    for number in (1, 2, 5):
        oc.set_threads(number)
        morton_order_shared(minimum, maximum, order, spare)
        assert (order == wanted).all()


def test_many_pairs_are_sorted_by_several_threads_as_few_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    minimum, maximum = bounds_of("clusters", 1500)
    rotations = np.tile(np.eye(3), (1500, 1, 1))
    boxes = oc.Boxes(0.5 * (minimum + maximum), rotations, 0.5 * (maximum - minimum))
    keys = colliding_keys(boxes, find_candidates(*meeting_bounds(boxes)))
    wanted, verdicts = pairs_of_keys(boxes, keys.copy(), False)
    assert len(wanted) > 1500
    monkeypatch.setattr(sorting, "FEWEST_NUMBERS", 64)
    for number in (1, 2, 5):
        oc.set_threads(number)
        found = pairs_of_keys(boxes, keys.copy(), False)
        assert (found[0] == wanted).all()
        assert (found[1] == verdicts).all()


def test_a_far_outlier_takes_no_cells_from_the_others() -> None:
    minimum, maximum = bounds_of("uniform", 1500)
    before = BoundsTree.build(minimum, maximum).nodes
    minimum[7], maximum[7] = 1e299, 1e299
    after = BoundsTree.build(minimum, maximum).nodes
    sizes = [(nodes[:, 3:] - nodes[:, :3]).sum(axis=1) for nodes in (before, after)]
    leaves = [np.median(size[np.isfinite(size) & (size > 0)]) for size in sizes]
    assert leaves[1] < 1.5 * leaves[0]


def test_a_search_ends_where_there_is_no_more_room() -> None:
    tree = BoundsTree.build(*bounds_of("identical", 100))
    low, high = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    for room in (0, 1, 30, 100, 101):
        out = np.full(room, -1)
        assert overlapping(*tree, low, high, 0, out) == min(room, 100)
        assert len(set(out[:100].tolist())) == min(room, 100)


def test_lanes_are_what_they_are_in_python() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        nodes = rng.integers(0, 3, (3, 6, LANES)) * 1.0
        nodes[rng.random(nodes.shape) < 0.1] = np.inf
        given = nodes, int(rng.integers(3)), *(rng.integers(0, 3, 6) * 1.0).tolist()
        mask = overlaps_kernel(*given)
        assert mask == _overlaps_in_python(*given)
        if mask:
            assert lowest_kernel(mask) == _lowest_in_python(mask)


@njit
def overlaps_kernel(
    nodes: Floats, block: int, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float
) -> int:
    return int(overlaps(nodes, block, x0, y0, z0, x1, y1, z1))


@njit
def lowest_kernel(mask: int) -> int:
    return int(lowest(mask))


@each("count", [0, 1, FEW, FEW + 1, 3000])
@each("low", [0, 2, 20])
@each("bits", [1, DIGIT_BITS, DIGIT_BITS + 1, 40, 43])
def test_numbers_are_sorted_by_some_of_their_bits(count: int, bits: int, low: int) -> None:
    rng = np.random.default_rng(count)
    keys = rng.integers(0, 2**bits, count)
    keys[::3] = keys[:1]
    found = (keys << low) | rng.integers(0, 2**low, count)
    wanted = found[np.argsort(keys, kind="stable")]
    sort_numbers(found, np.empty_like(found), low, low + bits)
    assert (found == wanted).all()


INTERPRETED = """
import numpy as np
from obb_collision.scene.broad_phase.broad_phase import find_candidates

minimum, maximum = np.load("bounds.npy")
np.save("pairs.npy", find_candidates(minimum, maximum))
"""


def test_interpreted_kernels_find_the_same_pairs(tmp_path: Path) -> None:
    minimum, maximum = bounds_of("uniform", 65)
    np.save(tmp_path / "bounds.npy", np.stack([minimum, maximum]))
    subprocess.run(
        [sys.executable, "-c", INTERPRETED], cwd=tmp_path, check=True, timeout=300,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(PACKAGE)},
    )  # fmt: skip
    found = np.load(tmp_path / "pairs.npy")
    assert len(found) > 0
    assert (found == find_candidates(minimum, maximum)).all()
