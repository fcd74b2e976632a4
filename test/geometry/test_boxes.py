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

"""Boxes and poses: construction, refusals, world bounds, equality by numbers, and against scipy."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support import by_threads, refused, row_of

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
from obb_collision.geometry.representations import (
    corner_and_edges,
    face_planes,
    from_compact,
    to_compact,
)
from obb_collision.geometry.validation import as_quaternions, orthonormal_defect
from obb_collision.typing import Floats
from tools.cases.placement import random_rotations


def some_boxes(seed: int, count: int) -> oc.Boxes:
    rng = np.random.default_rng(seed)
    # older scipy makes no empty Rotation
    rotations = Rotation.random(max(count, 1), random_state=seed).as_matrix()[:count]
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
        (([[0, 0, 0]] * 3, [np.eye(3)] * 3, [[1, 1, 1], [1, 1, 1], [1, -1, 1]]), "half_ex.*row 2"),
        (([[0, 0]], [np.eye(3)], [[1, 1, 1]]), "centers must have shape"),
        (([[0, 0, 0]] * 2, [np.eye(3), 2 * np.eye(3)], [[1, 1, 1]] * 2), "rotations.*row 1"),
        (([[0, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2), "same length"),
        (([["a", 0, 0]], [np.eye(3)], [[1, 1, 1]]), "centers must be numbers"),
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
    assert all(np.isfinite(array).all() for array in boxes.arrays)


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
        [-1, 2, 3], [-1, -2, 3], [1, -2, 3], [1, 2, 3],
        [1, 2, -3], [1, -2, -3], [-1, -2, -3], [-1, 2, -3],
    ]  # fmt: skip
    assert oc.OBB([0, 0, 0], np.eye(3), [1, 2, 3]).corners().tolist() == expected
    assert oc.AABB([-1, -2, -3], [1, 2, 3]).corners().tolist() == expected


def test_representations_describe_the_same_boxes_and_the_compact_form_comes_back() -> None:
    boxes = some_boxes(0, 200)
    cloud = boxes.corners()
    planes = face_planes(boxes)
    heights = np.einsum("nfk,nck->nfc", planes[..., :3], cloud) - planes[..., 3:]
    assert np.abs(heights.max(axis=2)).max() < 1e-14
    assert ((np.abs(heights) < 1e-14).sum(axis=2) == 4).all()
    frame = corner_and_edges(boxes)
    assert np.allclose(frame[:, 0], cloud[:, 6], atol=1e-14)
    assert np.allclose(frame.sum(axis=1), cloud[:, 3], atol=1e-14)
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


SHEAR = np.array([[1.0, 0.5, 0, 1], [0, 2, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 6))
def test_many_answer_as_each_does(seed: int, count: int) -> None:
    boxes, points = some_boxes(seed, count), SHEAR[:, :3]
    for answer, alone in (
        (boxes.corners(), [box.corners() for box in boxes]),
        (boxes.volumes, [box.volume for box in boxes]),
        (boxes.quaternions, [box.quaternion for box in boxes]),
        (boxes.contains([1, 1, 1]), [box.contains([1, 1, 1]) for box in boxes]),
        (boxes.contains(points), [box.contains(points) for box in boxes]),
    ):
        assert np.array_equal(answer, np.reshape(np.array(alone), np.shape(answer)))
    assert list(boxes.padded(0.1)) == [box.padded(0.1) for box in boxes]
    assert list(boxes.transformed(SHEAR)) == [box.transformed(SHEAR) for box in boxes]


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 9), data=st.data())
def test_rows_give_boxes_and_a_row_a_box(seed: int, count: int, data: st.DataObject) -> None:
    boxes = some_boxes(seed, count)
    assert oc.Boxes.from_obbs(boxes) == boxes == oc.Boxes.from_obbs(list(boxes))
    row = data.draw(st.integers(-count, count - 1))
    assert boxes[row] == oc.OBB(*row_of(boxes, row)) == boxes[np.int64(row)]
    rows = data.draw(st.lists(st.integers(0, count - 1), max_size=5))
    assert list(boxes[rows]) == [boxes[k] for k in rows] == list(boxes[np.array(rows, np.int64)])
    assert list(boxes[1::2]) == list(boxes)[1::2]
    mask = np.arange(count) % 2 == 0
    assert boxes[mask] == boxes[::2]


def test_boxes_by_yaw_and_by_matrices_are_those_of_poses() -> None:
    rng = np.random.default_rng(3)
    centers, sizes = rng.normal(size=(20, 3)), rng.uniform(0, 3, (20, 3))
    yaw = rng.uniform(-4, 4, 20)
    turns = Rotation.from_euler("z", yaw[:, None])
    poses = np.column_stack([centers, turns.as_quat()])
    wanted = oc.Boxes.from_poses(poses, 0.5 * sizes)
    boxes = oc.Boxes.from_yaw(centers, sizes, yaw)
    moves = np.tile(np.eye(4), (20, 1, 1))
    moves[:, :3, :3], moves[:, :3, 3] = turns.as_matrix(), centers
    for made in (boxes, oc.Boxes.from_matrices(moves, 0.5 * sizes)):
        assert np.array_equal(made.half_extents, wanted.half_extents)
        assert np.array_equal(made.centers, centers)
        np.testing.assert_allclose(made.rotations, wanted.rotations, atol=1e-15)
    refused("matrices must have the last row .*; transpose it", oc.Boxes.from_matrices,
            moves.transpose(0, 2, 1), sizes)  # fmt: skip
    refused("matrices must be orthonormal .* in row 1", oc.Boxes.from_matrices,
            [np.eye(4), np.diag([2, 2, 2, 1])], sizes[:2])  # fmt: skip
    refused("transpose it", boxes[0].transformed, moves[0].T)
    refused("sizes must not be negative", oc.Boxes.from_yaw, centers[:1], [[1, -1, 1]], [0])
    refused("the same length", oc.Boxes.from_yaw, centers, sizes, yaw[:3])


def area(polygon: Floats) -> float:
    """Return the area of corners (n, 2), counter-clockwise (the shoelace formula)."""
    x, y = polygon.reshape(-1, 2).T
    return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def clipped(polygon: Floats, by: Floats) -> Floats:
    """Return the common part of two convex polygons (Sutherland, Hodgman 1974)."""
    for start, end in zip(by, np.roll(by, -1, axis=0), strict=True):
        normal = np.array([start[1] - end[1], end[0] - start[0]])
        heights, kept = (polygon - start) @ normal, []
        for k in range(len(polygon)):
            here, there = heights[k - 1], heights[k]
            if here * there < 0.0:
                kept.append(polygon[k - 1] + here / (here - there) * (polygon[k] - polygon[k - 1]))
            if there >= 0.0:
                kept.append(polygon[k])
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def test_footprints_are_boxes_seen_from_above() -> None:
    rng = np.random.default_rng(4)
    boxes = oc.Boxes.from_yaw(
        rng.normal(0, 1, (30, 3)), rng.uniform(0.2, 3, (30, 3)), rng.normal(size=30)
    )
    order = rng.permuted(np.tile(np.arange(3), (30, 1)), axis=1)  # any axis may be the vertical one
    rows = np.arange(30)[:, None]
    axes = np.moveaxis(boxes.rotations, 2, 1)[rows, order].transpose(0, 2, 1)
    mixed = oc.Boxes(boxes.centers, axes, boxes.half_extents[rows, order])
    flat = mixed.footprints()
    assert (flat.half_extents[:, 2] == 0.5).all()
    assert (flat.centers[:, 2] == 0.0).all()
    polygons = [corners[[3, 0, 1, 2], :2] for corners in boxes.corners()]
    for i, j in np.argwhere(oc.iou_matrix(flat, flat) >= 0.0):
        shared = area(clipped(polygons[i], polygons[j]))
        truth = shared / (area(polygons[i]) + area(polygons[j]) - shared)
        assert flat[i].iou(flat[j]) == pytest.approx(truth, abs=1e-9)
    tilted = oc.Boxes.from_poses([[0, 0, 0, 0.6, 0, 0, 0.8]], [[1, 1, 1]])
    refused("boxes must have a vertical axis", tilted.footprints)


def test_the_closest_point_the_distance_and_the_merged_box() -> None:
    rng = np.random.default_rng(5)
    for _ in range(100):
        centers = rng.normal(0, 2, (2, 3))
        turns = random_rotations(rng, 2)
        a, b = (oc.OBB(*where, rng.uniform(0, 1, 3)) for where in zip(centers, turns, strict=True))
        point = rng.normal(0, 3, 3)
        near = a.closest_point(point)
        local = a.rotation.T @ (near - a.center)
        assert (np.abs(local) <= a.half_extents + 1e-12).all()
        grid = (point - a.center) @ a.rotation - local  # outwards at each face that it is on
        on = np.abs(local) >= a.half_extents - 1e-12
        assert (np.abs(grid[~on]) < 1e-12).all()
        assert (grid * local >= -1e-12).all()
        gap = a.separation(b).gap
        distance = a.distance(b)
        assert distance == b.distance(a)
        assert (distance == 0) == a.intersects(b)
        assert distance >= gap - 1e-12
        assert distance == pytest.approx(by_projections(a, b), abs=1e-6)
        both = a.merge(b)
        for part in (a, b):
            assert np.all(both.contains(part.corners(), exact=True))
    assert a.closest_point(a.center).tolist() == a.center.tolist()


def by_projections(a: oc.OBB, b: oc.OBB) -> float:
    """Return the distance of two boxes by projecting on each in turn."""
    point = a.center
    for _ in range(20_000):
        other = b.closest_point(point)
        last, point = point, a.closest_point(other)
        if np.linalg.norm(point - last) < 1e-13:
            break
    return float(np.linalg.norm(point - other))


def test_a_box_taken_from_many_is_a_copy() -> None:
    boxes = some_boxes(0, 3)
    box, before = boxes[1], boxes.centers.copy()
    box.center = [9.0, 9.0, 9.0]
    np.testing.assert_array_equal(boxes.centers, before)


@each("index", [3, -4, 10**30, "a", None, 1.0, (0, 1, 2.5), [[0]], True, {}])
def test_what_is_no_index_or_a_row_that_is_not_there_is_refused(index: Any) -> None:
    missing = type(index) is int
    reason = (
        "index must be a row of 3 boxes" if missing else "index must be a row|rows must be rows"
    )
    with pytest.raises(IndexError if missing else (TypeError, ValueError), match=reason):
        some_boxes(0, 3)[index]


def test_each_box_gets_its_own_margin_and_matrix() -> None:
    boxes = some_boxes(1, 3)
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
    boxes = some_boxes(2, 5)
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
    turns = np.broadcast_to(np.eye(3), (10**5, 3, 3))
    many = oc.Boxes(np.zeros((10**5, 3)), turns, np.ones((10**5, 3)))
    assert repr(many) == "Boxes(100000 boxes within [-1.0, -1.0, -1.0] to [1.0, 1.0, 1.0])"
    assert repr(many[:1]) == "Boxes(1 box within [-1.0, -1.0, -1.0] to [1.0, 1.0, 1.0])"
    assert repr(many[:0]) == "Boxes(0 boxes)"
    assert repr(oc.Capsules.spheres(np.zeros((2, 3)), np.ones(2))) == "Capsules(2 capsules)"
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
    identity = np.tile(IDENTITY_POSE, (20, 1))
    np.testing.assert_allclose(compose_poses(inverse_poses(OUTER), OUTER), identity, atol=1e-14)
    np.testing.assert_allclose(compose_poses(OUTER, inverse_poses(OUTER)), identity, atol=1e-14)


def test_the_identity_changes_no_bit_of_a_position() -> None:
    identity = np.tile(IDENTITY_POSE, (20, 1))
    assert np.array_equal(compose_poses(IDENTITY_POSE, INNER)[:, :3], INNER[:, :3])
    assert np.array_equal(compose_poses(INNER, identity)[:, :3], INNER[:, :3])
    np.testing.assert_allclose(compose_poses(INNER, identity), unit_poses(INNER), atol=1e-15)


def some_poses(count: int) -> Floats:
    rng = np.random.default_rng(count)
    quaternions = quaternions_from_matrices(random_rotations(rng, count))
    quaternions *= rng.uniform(0.95, 1.05, (count, 1))
    quaternions[::5, :3] *= 1e-9  # nearly no turn
    quaternions[::5, 3] = -1.0
    quaternions[::7] = 0.5
    return np.concatenate([rng.uniform(-1e7, 1e7, (count, 3)), quaternions], axis=1)


@each("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 20_000])
def test_blocks_give_what_numpy_does_also_of_poses_that_cannot_be_written_to(count: int) -> None:
    poses = some_poses(count)
    unit = as_quaternions(poses[:, 3:], "quaternions", (None, 4))
    rotations = matrices_from_quaternions(unit)
    poses.setflags(write=False)
    for positions, found in by_threads(lambda: as_poses(poses), 1, 3):
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


def test_attributes_of_a_box_are_checked() -> None:
    box = oc.OBB(half_extents=[1, 1, 1])
    box.center = [1, 2, 3]
    assert box.center.dtype == np.float64
    assert box.intersects(oc.OBB([1, 2, 3], np.eye(3), [0, 0, 0]))
    for name, value in (("center", [np.nan] * 3), ("rotation", np.ones((3, 3))),
                        ("half_extents", [-1, 1, 1])):  # fmt: skip
        with pytest.raises(ValueError, match=f"^{name} must"):
            setattr(box, name, value)
    assert box == oc.OBB([1, 2, 3], np.eye(3), [1, 1, 1])
