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

"""Overlap volume and IoU: exact where that is promised, symmetric; errors: ``test/numerics``."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.typing import Floats

EXACTLY = [np.eye(3), np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])]


def random_pairs(
    seed: int, count: int, near: float = 1.0, exponents: tuple[float, float] = (0.0, 0.0)
) -> tuple[oc.Boxes, oc.Boxes]:
    rng = np.random.default_rng(seed)
    sides = []
    for side in range(2):
        rotations = Rotation.random(count, random_state=2 * seed % 2**31 + side).as_matrix()
        extents = rng.uniform(0.1, 1.0, (count, 3)) * 10.0 ** rng.uniform(*exponents, (count, 3))
        sides.append(oc.Boxes(near * rng.normal(size=(count, 3)), rotations, extents))
    return sides[0], sides[1]


def grid_box(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return a box whose corners are eighths, its axes those of space in some order."""
    return (rng.integers(-16, 17, 3) / 8.0, EXACTLY[rng.integers(2)], rng.integers(1, 17, 3) / 8.0)


@given(st.integers(0, 2**32 - 1))
def test_aligned_boxes_are_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = oc.OBB(*grid_box(rng)), oc.OBB(*grid_box(rng))
    low = np.maximum(a.aabb().minimum, b.aabb().minimum)
    high = np.minimum(a.aabb().maximum, b.aabb().maximum)
    expected = np.maximum(high - low, 0.0).prod()
    assert a.overlap_volume(b) == expected
    assert a.iou(b) == pytest.approx(expected / (a.volume + b.volume - expected), rel=1e-15)


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([(0, 0), (-8, 0), (-3, 3), (-100, -90), (90, 100), (-150, 150), (-300, 299)]),
    st.sampled_from([0.0, 1e-3, 1.0, 1e6]),
)
def test_what_is_certain_holds_at_every_size(
    seed: int, exponents: tuple[int, int], far: float
) -> None:
    a, b = random_pairs(seed, 20, 0.0, exponents)
    rng = np.random.default_rng(seed)
    offset = far * 10.0 ** exponents[0] * rng.normal(size=3)
    a, b = (oc.Boxes(x.centers + offset, x.rotations, x.half_extents) for x in (a, b))
    b = oc.Boxes(b.centers + rng.normal(size=(20, 3)) * a.half_extents, b.rotations, b.half_extents)
    volumes, ratios = oc.overlap_volumes(a, b), oc.iou(a, b)
    np.testing.assert_array_equal(volumes, oc.overlap_volumes(b, a))
    np.testing.assert_array_equal(ratios, oc.iou(b, a))
    overlap = oc.verdicts(a, b) == oc.Verdict.OVERLAP
    np.testing.assert_array_equal(volumes > 0.0, overlap)
    np.testing.assert_array_equal(ratios > 0.0, overlap)
    assert (volumes <= np.minimum(a.volumes, b.volumes) + 5e-324).all()
    assert (ratios <= 1.0).all()


def relabelled(box: oc.OBB) -> list[oc.OBB]:
    """Return the same set 24 times: its axes swapped and reversed, with determinant one."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        rotation = box.rotation[:, order] * signs
        if np.linalg.det(rotation) > 0.0:
            found.append(oc.OBB(box.center, rotation, box.half_extents[list(order)]))
    return found


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1.0, 1e-20, 1e-200, 1e100]))
def test_the_same_set_has_one_and_its_whole_volume(seed: int, thin: float) -> None:
    (box,), _ = random_pairs(seed, 1)
    box = oc.OBB(box.center, box.rotation, box.half_extents * [1.0, 1.0, thin])
    same = relabelled(box)
    assert len(same) == 24
    many = oc.Boxes.from_obbs(same)
    pairs = np.argwhere(np.ones((24, 24)))
    assert (oc.iou(many, many, pairs) == 1.0).all()
    assert (oc.overlap_volumes(many, many, pairs) == box.volume).all()
    assert set(many.volumes.tolist()) == {box.volume}


def test_what_differs_by_a_bit_is_not_the_same_set() -> None:
    box = oc.OBB([0, 0, 0], np.eye(3), [1, 2, 3])
    taller = oc.OBB([0, 0, 0], np.eye(3), [1, 2, 3.5])
    assert box.iou(taller) == 6.0 / 7.0
    turned = oc.OBB([0, 0, 0], np.eye(3), [2, 1, 3])
    assert 0.0 < box.iou(turned) < 1.0


def test_flat_boxes_have_no_volume_and_one_only_with_themselves() -> None:
    box = oc.OBB([0, 0, 0], np.eye(3), [1, 1, 1])
    plate = oc.OBB([0, 0, 0], np.eye(3), [1, 1, 0])
    wider = oc.OBB([0, 0, 0], np.eye(3), [2, 1, 0])
    point = oc.OBB([0, 0, 0])
    for flat in (plate, wider, point):
        assert flat.overlap_volume(box) == box.overlap_volume(flat) == 0.0
        assert flat.iou(box) == box.iou(flat) == 0.0
        assert flat.iou(flat) == 1.0
    assert plate.iou(wider) == 0.0
    assert point.iou(oc.OBB([0, 0, 0], EXACTLY[1])) == 1.0
