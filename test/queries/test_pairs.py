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

"""One convention, f(a, b, pairs=None), for all questions of pairs; overlap volume and IoU."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import permutations, product
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support import family, joined, refused

import obb_collision as oc
from obb_collision.typing import Floats
from tools.cases.placement import random_rotations

A, B = family("ordinary scene", 24)
BOTH, ROWS = joined(A, B)
PAIRS = np.argwhere(np.ones((24, 24)))[::7]
TWISTS = np.random.default_rng(0).normal(size=(48, 6))


def moving(boxes: oc.Boxes, rows: slice) -> oc.MovingBoxes:
    return oc.MovingBoxes.from_twists(boxes, TWISTS[rows], 2.0)


def posed(boxes: oc.Boxes, rows: slice) -> oc.MovingBoxes:
    end = oc.Boxes(boxes.centers + TWISTS[rows, :3], boxes.rotations, boxes.half_extents)
    return oc.MovingBoxes(boxes, end)


def rounded(boxes: oc.Boxes, rows: slice) -> oc.Capsules:
    ends = np.einsum("nij,nj->ni", boxes.rotations, boxes.half_extents)
    return oc.Capsules(boxes.centers - ends, boxes.centers + ends, boxes.half_extents[:, 0])


def still(boxes: oc.Boxes, rows: slice) -> oc.Boxes:
    return boxes


QUESTIONS: dict[str, tuple[Callable[..., Any], Callable[[oc.Boxes, slice], Any]]] = {
    "verdicts": (oc.verdicts, still),
    "verdicts of capsules": (oc.verdicts, rounded),
    "separations": (oc.separations, still),
    "clearances": (oc.clearances, still),
    "near clearances": (partial(oc.clearances, max_distance=0.5), still),
    "contacts": (oc.contacts, still),
    "overlap_volumes": (oc.overlap_volumes, still),
    "iou": (oc.iou, still),
    "sweeps of boxes that stand": (oc.sweeps, still),
    "sweeps from pose to pose": (oc.sweeps, posed),
    "sweeps by twists": (oc.sweeps, moving),
}


def columns(answer: Any) -> dict[str, Any]:
    """Return the arrays of an answer, but for the rows that it is about."""
    if isinstance(answer, np.ndarray):
        return {"answer": answer}
    return {name: column for name, column in vars(answer).items() if name != "pairs"}


def assert_same(one: Any, other: Any) -> None:
    for name, column in columns(one).items():
        np.testing.assert_array_equal(column, columns(other)[name], err_msg=name)


@each("name", QUESTIONS)
def test_rows_of_two_sets_are_rows_of_one_that_holds_both(name: str) -> None:
    ask, make = QUESTIONS[name]
    a, b, both = make(A, slice(24)), make(B, slice(24, 48)), make(BOTH, slice(48))
    found = ask(a, b, PAIRS)
    assert_same(found, ask(both, both, PAIRS + np.array([0, 24])))
    assert_same(ask(a, b), ask(both, both, ROWS))
    assert_same(ask(a, b), ask(a, b, np.stack([np.arange(24)] * 2, axis=1)))
    assert all(len(column) == 0 for column in columns(ask(a, b, [])).values())
    if hasattr(found, "pairs"):
        rows = {tuple(pair) for pair in PAIRS.tolist()}
        assert {tuple(pair) for pair in found.pairs.tolist()} <= rows


@each("name", QUESTIONS)
def test_what_are_no_rows_of_both_is_refused(name: str) -> None:
    ask, make = QUESTIONS[name]
    a, b = make(A, slice(24)), make(B[:5], slice(5))
    refused("a and b must have the same length, got 24 and 5", ask, a, b)
    for bad in ([[0, 5]], [[24, 0]], [[-1, 0]]):
        refused("pairs must be rows of 24 and 5", ask, a, b, bad)
    refused(r"pairs must be rows of 24 and 5, got \[0, 5\] in row 1", ask, a, b, [[0, 1], [0, 5]])
    refused(r"pairs must have shape \(m, 2\)", ask, a, b, [0, 1])
    refused("pairs must be whole numbers", ask, a, b, [[0.0, 1.0]])
    with pytest.raises(TypeError, match="b must be"):
        ask(a, [[0, 1]])


def test_sets_that_move_at_different_times_are_refused() -> None:
    times = "a and b must move during the same times"
    refused(times, oc.sweeps, moving(A, slice(24)), posed(B, slice(24)))
    against_still = oc.sweeps(moving(A, slice(24)), B)
    assert against_still.hits.any()
    assert (against_still.times[against_still.hits] <= 2.0).all()
    assert repr(moving(A, slice(24))) == "MovingBoxes(24 for 2 s)"
    assert repr(posed(A, slice(24))) == "MovingBoxes(24 from pose to pose)"


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


def test_generalized_iou_is_that_of_aligned_boxes_and_moves_with_them() -> None:
    rng = np.random.default_rng(6)
    centers, halves = rng.normal(0, 1.5, (2, 200, 3)), rng.uniform(0, 1.5, (2, 200, 3))
    a, b = (oc.Boxes(c, [np.eye(3)] * 200, h) for c, h in zip(centers, halves, strict=True))
    low = np.minimum(centers[0] - halves[0], centers[1] - halves[1])
    high = np.maximum(centers[0] + halves[0], centers[1] + halves[1])
    sides = np.minimum(centers[0] + halves[0], centers[1] + halves[1])
    sides -= np.maximum(centers[0] - halves[0], centers[1] - halves[1])
    shared = np.clip(sides, 0, None).prod(axis=1)
    union, around = a.volumes + b.volumes - shared, (high - low).prod(axis=1)
    truth = shared / union - (around - union) / around  # Rezatofighi et al. 2019
    found = oc.iou(a, b, generalized=True)
    np.testing.assert_allclose(found, truth, atol=1e-12)
    np.testing.assert_array_equal(found, oc.iou(b, a, generalized=True))
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = random_rotations(rng, 1)[0], (3.0, -2.0, 1.0)
    moved = oc.iou(a.transformed(move), b.transformed(move), generalized=True)
    np.testing.assert_allclose(moved, truth, atol=1e-9)
    matrix = oc.iou_matrix(a[:20], b[:30], generalized=True)
    assert matrix[7, 7] == found[7]
    assert matrix.shape == (20, 30)
    pairs = np.argwhere(np.ones((200, 200)))
    plain = oc.iou(a, b, pairs).reshape(200, 200)
    np.testing.assert_array_equal(oc.iou_matrix(a, b), plain)
    point = oc.Boxes(np.zeros((2, 3)), [np.eye(3)] * 2, np.zeros((2, 3)))
    assert oc.iou(point, point, generalized=True).tolist() == [1.0, 1.0]
    assert oc.iou_matrix(a[:0], b).shape == (0, 200)
