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

"""The witness of a verdict, checked without the library: exact projection, exact depth."""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from support import family, row_of, sizes, stored, witnesses

from obb_collision import OBB, Boxes, Verdict, verdicts
from obb_collision.queries.verdict.pair_frame import box_of, pair_of
from obb_collision.queries.verdict.sat import AXES
from obb_collision.queries.verdict.witness import _before, box_witness, careful_gap, gap_bounds
from tools.cases.families import FAMILIES
from tools.cases.placement import random_rotations

#: Promised accuracy of gap and depth, relative to the sum of all half extents.
DEPTH_ACCURACY = 1e-12
#: A unit vector of doubles is this close to length 1.
UNIT_ACCURACY = 1e-15


@pytest.mark.parametrize("name", FAMILIES)
def test_axis_of_separate_pairs_proves_it(name: str, pairs: int) -> None:
    """All of a lies on one side of a plane normal to the axis, all of b beyond: exactly."""
    a, b = family(name, max(pairs // 15, 50))
    _, axes = witnesses(a, b)
    for row in np.flatnonzero(verdicts(a, b) == Verdict.SEPARATE):
        assert oracle.gap_along(row_of(a, row), row_of(b, row), axes[row]) > 0


@pytest.mark.parametrize("name", FAMILIES)
def test_gap_is_the_largest_and_depth_the_least_over_15_axes(name: str, pairs: int) -> None:
    a, b = family(name, pairs)
    gaps, axes = witnesses(a, b)
    truth = oracle.separations(stored(a), stored(b))
    scale = np.maximum(sizes(a, b), np.abs(truth))
    assert (np.abs(gaps - truth) <= DEPTH_ACCURACY * scale).all()
    assert np.isfinite(axes).all()
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, rtol=0, atol=UNIT_ACCURACY)


@each("name", FAMILIES)
def test_sign_of_the_gap_agrees_with_the_verdict(name: str) -> None:
    a, b = family(name, 1000)
    gaps, _ = witnesses(a, b)
    verdict = verdicts(a, b)
    assert (gaps[verdict == Verdict.SEPARATE] > 0.0).all()
    assert (gaps[verdict == Verdict.OVERLAP] < 0.0).all()


@each("name", FAMILIES)
def test_moving_by_the_depth_ends_the_overlap(name: str) -> None:
    """The axis points from a to b: b pushed along it by the depth, and a little, is free."""
    a, b = family(name, 500)
    rows = np.flatnonzero(verdicts(a, b) == Verdict.OVERLAP)
    a, b = a[rows], b[rows]
    gaps, axes = witnesses(a, b)
    coordinates = np.abs(b.centers).max(axis=1) + np.abs(a.centers).max(axis=1)
    little = 1e-9 * sizes(a, b) + 8.0 * np.finfo(float).eps * coordinates
    free = Boxes(b.centers + (little - gaps)[:, None] * axes, b.rotations, b.half_extents)
    assert (verdicts(a, free) == Verdict.SEPARATE).all()
    kept = Boxes(b.centers - (little + gaps)[:, None] * axes, b.rotations, b.half_extents)
    assert (verdicts(a, kept)[-gaps > 2.0 * little] == Verdict.OVERLAP).all()


def test_all_15_axes_come_out_as_least_penetration() -> None:
    a, b = family("each of the 15 axes alone", 15 * 40)
    for row in range(len(a)):
        found, _ = box_witness(box_of(*row_of(a, row)), box_of(*row_of(b, row)))
        assert found[2] == row % 15


@each("name", FAMILIES)
def test_axes_left_out_by_a_rough_look_could_not_have_won(name: str) -> None:
    a, b = family(name, 300)
    for row in range(len(a)):
        boxes = box_of(*row_of(a, row)), box_of(*row_of(b, row))
        (gap, axis, number), _ = box_witness(*boxes)
        every = [careful_gap(*boxes, k) for k in range(AXES)]
        _, most = gap_bounds(*pair_of(*boxes))
        assert gap == max(found[0] for found in every)
        assert all(found[0] <= bound for found, bound in zip(every, sum(most, ()), strict=True))
        assert every[number][1] == axis


@pytest.mark.parametrize("turned", [False, True])
def test_boxes_with_equal_axes_have_the_witness_of_all_15(turned: bool) -> None:
    rng = np.random.default_rng(3)
    count = 300
    rotations = random_rotations(rng, count) if turned else np.tile(np.eye(3), (count, 1, 1))
    numbers = rng.integers(-3, 4, (2, count, 3)) * 0.5  # many gaps are equal
    extents = rng.integers(0, 3, (2, count, 3)) * 0.5
    a, b = (Boxes(c, rotations, h) for c, h in zip(numbers, extents, strict=True))
    for row in range(count):
        boxes = box_of(*row_of(a, row)), box_of(*row_of(b, row))
        (gap, n, number), _ = box_witness(*boxes)
        every = [careful_gap(*boxes, k) for k in range(AXES)]
        first = int(np.argmax([one for one, _ in every]))
        assert (gap, number) == (every[first][0], first)
        best = [axis for one, axis in every if one == gap]
        assert n in best
        assert not any(_before(other, n) for other in best)


@pytest.mark.parametrize("half", [(1.0, 2.0, 3.0), (1.0, 2.0, 0.0), (1.0, 0.0, 0.0), (0.0,) * 3])
def test_identical_boxes_have_a_depth_and_a_normal(half: tuple[float, float, float]) -> None:
    box = OBB([7.0, -3.0, 1e5], np.eye(3), half)
    result = box.separation(box)
    assert result.gap == -2.0 * min(half)
    assert np.linalg.norm(result.axis) == 1.0
    assert result.verdict is (Verdict.OVERLAP if min(half) > 0.0 else Verdict.TOUCHING)


@given(st.sampled_from(sorted(FAMILIES)), st.integers(0, 199))
def test_single_boxes_answer_as_batches_do(name: str, row: int) -> None:
    a, b = family(name, 200)
    one, other = OBB(*row_of(a, row)), OBB(*row_of(b, row))
    gaps, axes = witnesses(a, b)
    result = one.separation(other)
    assert result.gap == gaps[row]
    np.testing.assert_array_equal(result.axis, axes[row])
    assert result.verdict == verdicts(a, b)[row]
    assert one.intersects(other) == (result.verdict != Verdict.SEPARATE)
    exact = verdicts(a, b, exact=True)[row] != Verdict.SEPARATE
    assert one.intersects(other, exact=True) == exact
