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

"""Values that show themselves and are equal by their numbers; poses against scipy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support import refused, row_of

import obb_collision as oc
from obb_collision.geometry.poses import (
    BLOCK,
    IDENTITY_POSE,
    as_poses,
    compose_poses,
    inverse_poses,
    matrices_from_quaternions,
    quaternions_from_matrices,
    unit_poses,
)
from obb_collision.geometry.validation import as_quaternions
from obb_collision.typing import Floats
from tools.cases.placement import random_rotations

SHEAR = np.array([[1.0, 0.5, 0, 1], [0, 2, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


def random_boxes(seed: int, count: int) -> oc.Boxes:
    rng = np.random.default_rng(seed)
    # older scipy makes no empty Rotation
    rotations = Rotation.random(max(count, 1), random_state=seed).as_matrix()[:count]
    return oc.Boxes(rng.normal(size=(count, 3)), rotations, rng.uniform(0, 2, (count, 3)))


#: What is asked of many, and of one.
QUESTIONS: dict[str, tuple[Callable[[oc.Boxes], Any], Callable[[oc.OBB], Any]]] = {
    "corners": (lambda many: many.corners(), lambda one: one.corners()),
    "volumes": (lambda many: many.volumes, lambda one: one.volume),
    "quaternions": (lambda many: many.quaternions, lambda one: one.quaternion),
    "padded": (lambda many: many.padded(0.1), lambda one: one.padded(0.1)),
    "transformed": (lambda many: many.transformed(SHEAR), lambda one: one.transformed(SHEAR)),
    "contains": (lambda many: many.contains([1, 1, 1]), lambda one: one.contains([1, 1, 1])),
    "contains each": (
        lambda many: many.contains(SHEAR[:, :3]), lambda one: one.contains(SHEAR[:, :3])
    ),
}  # fmt: skip


@pytest.mark.parametrize("question", QUESTIONS)
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 6))
def test_many_answer_as_each_does(question: str, seed: int, count: int) -> None:
    of_many, of_one = QUESTIONS[question]
    boxes = random_boxes(seed, count)
    answer = of_many(boxes)
    assert len(answer) == count
    for k in range(count):
        assert np.array_equal(answer[k], of_one(boxes[k])) or answer[k] == of_one(boxes[k])


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 9), data=st.data())
def test_rows_give_boxes_and_a_row_a_box(seed: int, count: int, data: st.DataObject) -> None:
    boxes = random_boxes(seed, count)
    assert oc.Boxes.from_obbs(boxes) == boxes == oc.Boxes.from_obbs(list(boxes))
    row = data.draw(st.integers(-count, count - 1))
    assert boxes[row] == oc.OBB(*row_of(boxes, row)) == boxes[np.int64(row)]
    rows = data.draw(st.lists(st.integers(0, count - 1), max_size=5))
    assert list(boxes[rows]) == [boxes[k] for k in rows] == list(boxes[np.array(rows, np.int64)])
    assert list(boxes[1::2]) == list(boxes)[1::2]
    mask = np.arange(count) % 2 == 0
    assert boxes[mask] == boxes[::2]


def test_a_box_taken_from_many_is_a_copy() -> None:
    boxes = random_boxes(0, 3)
    box, before = boxes[1], boxes.centers.copy()
    box.center[:] = 9.0
    np.testing.assert_array_equal(boxes.centers, before)


@each("index", [3, -4, 10**30])
def test_a_row_that_is_not_there_is_an_index_error(index: int) -> None:
    with pytest.raises(IndexError, match="index must be a row of 3 boxes"):
        random_boxes(0, 3)[index]


@each("index", ["a", None, 1.0, (0, 1, 2.5), [[0]], True, {}])
def test_what_is_no_index_is_refused(index: Any) -> None:
    with pytest.raises((TypeError, ValueError), match=r"index must be a row|rows must be rows"):
        random_boxes(0, 3)[index]


def test_each_box_gets_its_own_margin_and_matrix() -> None:
    boxes = random_boxes(1, 3)
    margins = np.array([0.0, 0.5, 1.0])
    assert list(boxes.padded(margins)) == [
        box.padded(m) for box, m in zip(boxes, margins.tolist(), strict=True)
    ]
    moves = np.stack([np.eye(4), SHEAR, np.diag([2.0, 2.0, 2.0, 1.0])])
    assert list(boxes.transformed(moves)) == [
        box.transformed(move) for box, move in zip(boxes, moves, strict=True)
    ]
    for bad in (np.ones(2), np.ones((3, 1)), [0.0, -1.0, 0.0]):
        refused("margin must", boxes.padded, bad)
    refused("matrix must have shape", boxes.transformed, moves[:2])


def test_the_aabb_is_around_all() -> None:
    boxes = random_boxes(2, 5)
    minimum, maximum = boxes.world_bounds()
    assert boxes.aabb() == oc.AABB(minimum.min(axis=0), maximum.max(axis=0))
    assert boxes[2:3].aabb() == boxes[2].aabb()
    refused("boxes must not be empty", boxes[:0].aabb)


def changed(array: Floats) -> Floats:
    other = array.copy()
    other.flat[-1] = np.nextafter(other.flat[-1], 9.0)
    return other


VALUES: dict[str, tuple[Callable[..., Any], tuple[Floats, ...]]] = {
    "OBB": (oc.OBB, (np.zeros(3), np.eye(3), np.ones(3))),
    "AABB": (oc.AABB, (np.zeros(3), np.ones(3))),
    "Boxes": (oc.Boxes, (np.zeros((2, 3)), np.stack([np.eye(3)] * 2), np.ones((2, 3)))),
    "Capsules": (oc.Capsules, (np.zeros((2, 3)), np.ones((2, 3)), np.ones(2))),
}


@each("kind", VALUES)
def test_values_are_equal_by_their_numbers_and_have_no_hash(kind: str) -> None:
    make, arrays = VALUES[kind]
    value = make(*arrays)
    assert value == make(*arrays)
    for k in range(len(arrays)):
        if arrays[k].shape[-2:] != (3, 3) or arrays[k].shape[0] != 3:
            other = [changed(array) if n == k else array for n, array in enumerate(arrays)]
            assert value != make(*other)
    assert value != 3
    with pytest.raises(TypeError, match="unhashable"):
        hash(value)


def test_values_show_themselves_in_a_line() -> None:
    many = oc.Boxes(
        np.zeros((10**5, 3)), np.broadcast_to(np.eye(3), (10**5, 3, 3)), np.ones((10**5, 3))
    )
    assert repr(many) == "Boxes(100000 boxes within [-1.0, -1.0, -1.0] to [1.0, 1.0, 1.0])"
    assert repr(many[:1]) == "Boxes(1 box within [-1.0, -1.0, -1.0] to [1.0, 1.0, 1.0])"
    assert repr(many[:0]) == "Boxes(0 boxes)"
    assert (
        repr(oc.Capsules(np.zeros((2, 3)), np.ones((2, 3)), np.ones(2))) == "Capsules(2 capsules)"
    )
    box = oc.OBB([1, 2, 3], np.eye(3), [1, 1, 1])
    assert eval(repr(box), {"OBB": oc.OBB}) == box
    around = oc.AABB([1, 2, 3], [4, 5, 6])
    assert eval(repr(around), {"AABB": oc.AABB}) == around


RNG = np.random.default_rng(5)
OUTER, INNER = RNG.normal(size=(20, 7)), RNG.normal(size=(20, 7))


@each("outer", [OUTER, OUTER[0]])
def test_composed_poses_agree_with_matrices(outer: np.ndarray) -> None:
    got = compose_poses(outer, INNER)
    turn = Rotation.from_quat(outer[..., 3:])
    expected = outer[..., :3] + turn.apply(INNER[:, :3])
    np.testing.assert_allclose(got[:, :3], expected, atol=1e-14)
    rotations = (turn * Rotation.from_quat(INNER[:, 3:])).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(got[:, 3:]).as_matrix(), rotations, atol=1e-14)


def test_a_pose_and_its_inverse_undo_each_other() -> None:
    for product in (
        compose_poses(inverse_poses(OUTER), OUTER),
        compose_poses(OUTER, inverse_poses(OUTER)),
    ):
        np.testing.assert_allclose(product, np.tile(IDENTITY_POSE, (20, 1)), atol=1e-14)


def test_the_identity_changes_no_bit_of_a_position() -> None:
    identity = np.tile(IDENTITY_POSE, (20, 1))
    assert np.array_equal(compose_poses(IDENTITY_POSE, INNER)[:, :3], INNER[:, :3])
    assert np.array_equal(compose_poses(INNER, identity)[:, :3], INNER[:, :3])
    np.testing.assert_allclose(compose_poses(INNER, identity), unit_poses(INNER), atol=1e-15)


@pytest.fixture(autouse=True)
def _restore() -> Iterator[None]:
    yield
    oc.set_threads(None)


def some_poses(count: int) -> Floats:
    rng = np.random.default_rng(count)
    quaternions = quaternions_from_matrices(random_rotations(rng, count))
    quaternions *= rng.uniform(0.95, 1.05, (count, 1))
    quaternions[::5, :3] *= 1e-9  # nearly no turn
    quaternions[::5, 3] = -1.0
    quaternions[::7] = 0.5
    return np.concatenate([rng.uniform(-1e7, 1e7, (count, 3)), quaternions], axis=1)


@each("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 20_000])
def test_blocks_give_what_numpy_does(count: int) -> None:
    poses = some_poses(count)
    unit = as_quaternions(poses[:, 3:], "quaternions", (None, 4))
    rotations = matrices_from_quaternions(unit)
    for threads in (1, 3):
        oc.set_threads(threads)
        positions, found = as_poses(poses)
        assert positions.tobytes() == np.ascontiguousarray(poses[:, :3]).tobytes()
        assert found.tobytes() == rotations.tobytes()


@each("row", [0, BLOCK, 299])
@each(
    "column, value, message",
    [
        (0, np.nan, "poses must be finite in row {}"),
        (2, 2e300, "poses must not exceed 1e[+]300 in magnitude in row {}"),
        (6, -np.inf, "poses must be finite in row {}"),
        (slice(3, 7), 0.0, r"poses \(quaternion\) must not be a zero quaternion in row {}"),
    ],
)
def test_the_row_of_a_bad_pose_is_named(
    row: int, column: int | slice, value: float, message: str
) -> None:
    poses = some_poses(300)
    poses[row, column] = value
    refused(message.format(row), as_poses, poses)


def test_a_quaternion_far_from_unit_length_is_warned_about_and_used() -> None:
    poses = some_poses(300)
    expected = as_poses(poses)[1]
    poses[200, 3:] *= 2.0
    with pytest.warns(UserWarning, match="far from unit length in row 200"):
        found = as_poses(poses)[1]
    assert found.tobytes() == expected.tobytes()


def test_poses_that_cannot_be_written_to_are_read() -> None:
    poses = some_poses(10)
    expected = as_poses(poses)[1]
    poses.setflags(write=False)
    assert (as_poses(poses)[1] == expected).all()
