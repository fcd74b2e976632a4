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

"""The order of bounds along the curve, and the tree over them, by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from obb_collision.geometry.trees import bounds_tree
from obb_collision.typing import Floats, Rows

FORMS = ("spread", "line", "outlier", "clusters", "one centre")
COUNTS = (1, 8, 9, 65, 700)


def bounds_of(form: str, count: int) -> tuple[Floats, Floats]:
    """Return bounds of a form, some of them empty."""
    rng = np.random.default_rng(count)
    scales = {"line": [1.0, 0.0, 0.0], "one centre": [0.0], "clusters": [1e-9]}
    middles = np.array(scales.get(form, [1.0])) * rng.uniform(-5.0, 5.0, (count, 3))
    middles[0] = 1e250 if form == "outlier" else middles[0]
    middles += rng.choice([-1e9, 1e9], (count, 1)) if form == "clusters" else 0.0
    half = rng.uniform(0.0, 1.0, (count, 3))
    minimum, maximum = middles - half, middles + half
    minimum[5::17], maximum[5::17] = np.inf, -np.inf
    return minimum, maximum


def ordered(minimum: Floats, maximum: Floats) -> Rows:
    order, spare = np.empty((2, len(minimum)), np.int64)
    bounds_tree.morton_order_shared(minimum, maximum, order, spare)
    return order


@each("form", FORMS)
@each("count", COUNTS)
def test_the_order_has_each_row_once_and_empty_bounds_last_by_any_number_of_threads(
    form: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    minimum, maximum = bounds_of(form, count)
    order = ordered(minimum, maximum)
    assert sorted(order.tolist()) == list(range(count))
    empty = np.asarray((minimum > maximum).any(axis=1))[order]
    assert empty.tolist() == sorted(empty.tolist())
    full = np.flatnonzero((minimum <= maximum).all(axis=1))
    alone = ordered(minimum[full], maximum[full])
    monkeypatch.setattr(bounds_tree, "is_dealt", lambda count: count > 1)
    np.testing.assert_array_equal(ordered(minimum[full], maximum[full]), alone)


def test_bounds_on_a_line_are_in_the_order_of_the_line_but_for_those_of_one_cell() -> None:
    places = np.random.default_rng(0).permutation(300)
    for axis in range(3):
        minimum = 1000.0 * places[:, None] * np.eye(3)[axis]
        order = ordered(minimum, minimum + 1.0)
        assert np.abs(places[order] - np.arange(300)).max() < bounds_tree.CELL


@each("form", FORMS)
@each("count", COUNTS)
def test_a_tree_finds_what_brute_force_does_also_after_bounds_have_moved(
    form: str, count: int
) -> None:
    minimum, maximum = bounds_of(form, count)
    tree, room = bounds_tree.BoundsTree.build(minimum, maximum), np.empty(count, np.int64)
    places = np.empty(count, np.int64)
    places[tree.order] = np.arange(count)
    for shift in (0.0, 3.0, -1.0):
        moved = np.arange(0, count, 3)
        minimum[moved], maximum[moved] = minimum[moved] + shift, maximum[moved] + shift
        bounds_tree.move_kernel(tree, places[moved])
        for row in range(0, count, 11):
            low, high = minimum[row], maximum[row]
            meet = ((minimum <= high) & (low <= maximum)).all(axis=1)
            for least in (0, count // 2):
                found = bounds_tree.overlapping(tree, tuple(low), tuple(high), least, room)
                expected = np.flatnonzero(meet & (np.arange(count) >= least))
                np.testing.assert_array_equal(np.sort(room[:found]), expected)
            assert bounds_tree.overlapping(tree, tuple(low), tuple(high), 0, room[:1]) == min(
                meet.sum(), 1
            )
