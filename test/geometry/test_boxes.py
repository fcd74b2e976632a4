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

"""Boxes: construction, refusals, representations, world bounds."""

from fractions import Fraction

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support import refused, row_of

import obb_collision as oc
from obb_collision.geometry.representations import (
    corner_and_edges,
    face_planes,
    from_compact,
    to_compact,
)
from obb_collision.geometry.validation import orthonormal_defect


def random_boxes(count: int, seed: int = 0) -> oc.Boxes:
    rng = np.random.default_rng(seed)
    rotations = Rotation.random(count, random_state=seed).as_matrix()
    return oc.Boxes(rng.normal(size=(count, 3)), rotations, rng.uniform(0, 2, (count, 3)))


@each("size", [0.0, 1e-14, 1e-10, 9e-8])
def test_nearly_orthonormal_rotations_are_made_orthonormal(size: float) -> None:
    rng = np.random.default_rng(5)
    rotations = Rotation.random(200, random_state=5).as_matrix()
    bent = rotations + size * rng.uniform(-1, 1, rotations.shape)
    boxes = oc.Boxes(np.zeros((200, 3)), bent, np.ones((200, 3)))
    least = 2.0**-50 if size else 16.0 * 2.0**-53  # what is kept as it is
    assert (np.abs(orthonormal_defect(boxes.rotations)) <= least).all()
    assert np.allclose(np.linalg.det(boxes.rotations), 1.0, atol=1e-14)
    assert np.abs(boxes.rotations - rotations).max() <= 4 * size  # 0: kept bit for bit


def test_a_left_handed_frame_is_the_same_box_with_determinant_one() -> None:
    mirror = np.diag([1.0, 1.0, -1.0])
    box = oc.OBB([1, 2, 3], mirror, [1, 2, 3])
    assert (box.rotation == np.eye(3)).all()


@each(
    "arguments, message",
    [
        (([[0, 0, 0], [np.nan, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2), "centers.*row 1"),
        (([[0, 0, 0]], [np.eye(3)], [[1, np.inf, 1]]), "half_extents.*row 0"),
        (([[0, 0, 0]] * 3, [np.eye(3)] * 3, [[1, 1, 1], [1, 1, 1], [1, -1, 1]]), "half_ex.*row 2"),
        (([[0, 0]], [np.eye(3)], [[1, 1, 1]]), "centers must have shape"),
        (([[0, 0, 0]] * 2, [np.eye(3), 2 * np.eye(3)], [[1, 1, 1]] * 2), "rotations.*row 1"),
        (([[0, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2), "same length"),
        (([["a", 0, 0]], [np.eye(3)], [[1, 1, 1]]), "centers must be numbers"),
        (([[1e301, 0, 0]], [np.eye(3)], [[1, 1, 1]]), "centers.*magnitude"),
        (([[1e301, -1e301, 1e301]], [np.eye(3)], [[1, 1, 1]]), "centers.*magnitude"),
        (([[0, 0, 0]], [np.eye(3)], [[1e301, 1e301, 1e301]]), "half_extents.*magnitude"),
        (([[0, 0, 0]], [np.zeros((3, 3))], [[1, 1, 1]]), "rotations.*orthonormal"),
    ],
)
def test_bad_boxes_are_refused_by_name_and_row(
    arguments: tuple[list[object], list[object], list[object]], message: str
) -> None:
    refused(message, oc.Boxes, *arguments)


def test_boxes_do_not_change_with_the_arrays_they_were_made_from() -> None:
    centers, rotations, half_extents = np.zeros((2, 3)), np.array([np.eye(3)] * 2), np.ones((2, 3))
    boxes = oc.Boxes(centers, rotations, half_extents)
    for array in (centers, rotations, half_extents):
        array[...] = np.nan
    assert np.isfinite(boxes.centers).all()
    assert np.isfinite(boxes.rotations).all()
    assert np.isfinite(boxes.half_extents).all()


def test_no_boxes_have_no_pairs() -> None:
    none = oc.Boxes(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 3)))
    assert len(none) == 0
    assert oc.find_pairs(none).shape == (0, 2)
    assert oc.verdicts(none, none).shape == (0,)
    assert oc.verdicts(none, none, exact=True).dtype == np.int8
    assert none.world_bounds()[0].shape == (0, 3)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@given(st.integers(-900, 900))
def test_quaternions_of_any_length_are_normalised(power: int) -> None:
    rotation = Rotation.from_rotvec([0.3, -0.4, 0.5])
    box = oc.OBB.from_quaternion([0, 0, 0], np.ldexp(rotation.as_quat(), power), [1, 1, 1])
    assert np.allclose(box.rotation, rotation.as_matrix(), atol=1e-15)
    assert np.allclose(box.quaternion, rotation.as_quat(canonical=True), atol=1e-15)


def test_quaternions_and_matrices_agree_with_scipy_both_ways() -> None:
    rotations = Rotation.random(500, random_state=7)
    poses = np.concatenate([np.zeros((500, 3)), rotations.as_quat()], axis=1)
    boxes = oc.Boxes.from_poses(poses, np.ones((500, 3)))
    assert np.allclose(boxes.rotations, rotations.as_matrix(), atol=1e-15)
    back = np.array([oc.OBB(*row_of(boxes, k)).quaternion for k in range(500)])
    assert np.allclose(back, rotations.as_quat(canonical=True), atol=1e-14)


@given(
    st.lists(st.floats(-1e9, 1e9), min_size=3, max_size=3),
    st.lists(st.floats(0, 1e9), min_size=3, max_size=3),
)
def test_bounds_of_aligned_boxes_contain_them_exactly(c: list[float], h: list[float]) -> None:
    boxes = oc.Boxes([c], [np.eye(3)], [h])
    minimum, maximum = boxes.world_bounds()
    for k in range(3):
        assert Fraction(minimum[0, k]) <= Fraction(c[k]) - Fraction(h[k])
        assert Fraction(maximum[0, k]) >= Fraction(c[k]) + Fraction(h[k])


def test_bounds_are_exact_where_that_is_representable() -> None:
    box = oc.OBB([0.5, 1.5, -2.0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.25, 1.0, 3.0])
    aabb = box.aabb()
    assert aabb.minimum.tolist() == [-0.5, 1.25, -5.0]
    assert aabb.maximum.tolist() == [1.5, 1.75, 1.0]


@given(
    st.lists(st.floats(-1e150, 1e150), min_size=3, max_size=3),
    st.lists(st.floats(0, 1e150), min_size=3, max_size=3),
)
def test_a_box_from_an_aabb_contains_it_exactly(low: list[float], size: list[float]) -> None:
    aabb = oc.AABB(low, np.add(low, size))
    box = oc.OBB.from_aabb(aabb)
    assert box.contains(aabb.corners(), exact=True).all()  # type: ignore[union-attr]


@given(st.floats(0, 1e6), st.floats(0, 1e3))
def test_padding_rounds_outwards(extent: float, margin: float) -> None:
    box = oc.OBB(half_extents=[extent] * 3).padded(margin)
    assert Fraction(box.half_extents[0]) >= Fraction(extent) + Fraction(margin)


def test_corners_come_in_the_documented_order() -> None:
    expected = [
        (-1, 2, 3), (-1, -2, 3), (1, -2, 3), (1, 2, 3),
        (1, 2, -3), (1, -2, -3), (-1, -2, -3), (-1, 2, -3),
    ]  # fmt: skip
    assert oc.OBB([0, 0, 0], np.eye(3), [1, 2, 3]).corners().tolist() == [list(c) for c in expected]
    assert oc.AABB([-1, -2, -3], [1, 2, 3]).corners().tolist() == [list(c) for c in expected]


def test_representations_describe_the_same_boxes() -> None:
    boxes = random_boxes(50)
    cloud = boxes.corners()
    planes = face_planes(boxes)
    heights = np.einsum("nfk,nck->nfc", planes[..., :3], cloud) - planes[..., 3:]
    assert np.abs(heights.max(axis=2)).max() < 1e-14
    assert ((np.abs(heights) < 1e-14).sum(axis=2) == 4).all()
    frame = corner_and_edges(boxes)
    assert np.allclose(frame[:, 0], cloud[:, 6], atol=1e-14)
    assert np.allclose(frame.sum(axis=1), cloud[:, 3], atol=1e-14)


def test_the_compact_form_comes_back() -> None:
    boxes = random_boxes(200)
    back = from_compact(to_compact(boxes))
    assert (back.centers == boxes.centers).all()
    assert (back.half_extents == boxes.half_extents).all()
    assert np.allclose(back.rotations, boxes.rotations, atol=1e-15)


def test_edges_and_faces_by_index() -> None:
    box = oc.OBB([1, 2, 3], Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), [1, 2, 3])
    for i in range(3):
        assert (box.edge_direction(i) == box.rotation[:, i]).all()
        assert (box.face_normal(2 * i) == box.rotation[:, i]).all()
        assert (box.face_normal(2 * i + 1) == -box.rotation[:, i]).all()
    refused("0, 1 or 2", box.edge_direction, 3)
    refused("0 to 5", box.face_normal, -1)


def test_set_and_reset() -> None:
    box = oc.OBB([1, 2, 3], np.eye(3), [1, 1, 1])
    box.reset()
    assert box == oc.OBB()
    assert box.corners().tolist() == [[0.0, 0.0, 0.0]] * 8
    assert box.intersects(oc.OBB(half_extents=[1, 1, 1]))
    refused("half_extents", box.set, [9, 9, 9], np.eye(3), [1, -1, 1])
    assert box == oc.OBB()


def test_aabb_questions_are_exact_comparisons() -> None:
    a = oc.AABB([0, 0, 0], [1, 1, 1])
    assert a.intersects(oc.AABB([1, 1, 1], [2, 2, 2]))
    assert not a.intersects(oc.AABB([np.nextafter(1, 2), 0, 0], [2, 1, 1]))
    assert a.contains([1, 1, 1])
    assert a.contains([[0.5, 0.5, 0.5], [np.nextafter(1, 2), 0, 0]]).tolist() == [True, False]  # type: ignore[union-attr]
    refused("minimum must not exceed", oc.AABB, [0, 0, 2], [1, 1, 1])
    refused("empty", oc.AABB.from_points, np.empty((0, 3)))
    fitted = oc.AABB.from_points([[0, 5, 1], [2, 3, -1]])
    assert (fitted.minimum.tolist(), fitted.maximum.tolist()) == ([0, 3, -1], [2, 5, 1])
