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

"""Boxes under 4 x 4 matrices: the moved box contains the moved corners, exactly, and is tight."""

import numpy as np
import pytest
from each import each
from exact_bodies import assert_proper, outside
from exact_vectors import Box, Point, corners, determinant, exact, moved
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support import quaternions, refused

import obb_collision as oc
from obb_collision.typing import Floats

ENTRY = st.one_of(st.integers(-3, 3).map(float), st.floats(-10, 10))
MATRIX = st.lists(ENTRY, min_size=12, max_size=12)
HALF = st.lists(st.one_of(st.just(0.0), st.floats(1e-9, 1e3)), min_size=3, max_size=3)


def affine(linear: Floats, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    matrix[:3, 3] = shift
    return matrix


def turn(quaternion: list[float]) -> Floats:
    """Return a rotation as the library stores it."""
    return oc.OBB.from_quaternion(np.zeros(3), quaternion, np.ones(3)).rotation


def exactly(box: Box, matrix: Floats) -> list[Point]:
    """Return the moved corners."""
    return moved(corners(box), matrix[:3, 3], matrix[:3, :3])


def transformed(box: Box, matrix: Floats) -> Box:
    """Return the moved box, after checking that it is one and contains the corners."""
    new = oc.OBB(*box).transformed(matrix)
    result = new.center, new.rotation, new.half_extents
    assert_proper(result)
    assert all(gap <= 0 for gap in outside(result, exactly(box, matrix)))
    return result


def box_of(seed: int, half: tuple[float, float, float] = (1.0, 2.0, 3.0)) -> Box:
    rotation: Floats = Rotation.random(random_state=seed).as_matrix()
    return np.array([0.1, -0.2, 0.3]), rotation, np.array(half)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=50)
@given(quaternions, HALF, MATRIX, st.integers(-500, 480))
def test_any_box_under_any_invertible_matrix_is_contained(
    quaternion: list[float], half: list[float], entries: list[float], exponent: int
) -> None:
    matrix = np.vstack([np.reshape(entries, (3, 4)), [0, 0, 0, 1.0]])
    smaller = matrix.copy()
    smaller[:3] = np.ldexp(matrix[:3], -exponent)
    assume(all(determinant(*map(exact, m[:3, :3].T)) != 0 for m in (matrix, smaller)))
    center = np.ldexp(np.array([0.1, 0.7, -0.3]), exponent)
    box = center, turn(quaternion), np.ldexp(np.array(half), exponent)
    transformed(box, matrix)
    transformed(box, smaller)


TURN = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
#: A matrix, and the axes and half extents of a box along the world's axes afterwards.
EXACT: list[tuple[Floats, Floats, Floats]] = [
    (np.eye(4), np.eye(3), np.ones(3)),
    (affine(2.0 * np.eye(3)), np.eye(3), np.full(3, 2.0)),
    (affine(-0.25 * np.eye(3)), np.eye(3), np.full(3, 0.25)),
    (affine(TURN, (1.0, 1.0, 1.0)), TURN, np.ones(3)),
    (affine(np.diag([-1.0, 1.0, 1.0])), np.eye(3), np.ones(3)),
    (np.diag([3.0, -0.5, 7.0, 1.0]), np.eye(3), np.array([3.0, 0.5, 7.0])),
]


@each("matrix, axes, scale", EXACT)
def test_scales_quarter_turns_and_reflections_are_exact(
    matrix: Floats, axes: Floats, scale: Floats
) -> None:
    for half in ([1.0, 2.0, 3.0], [1.0, 0.0, 0.1], [0.0, 0.0, 0.0]):
        box = np.array([1.0, -2.0, 0.125]), np.eye(3), np.array(half)
        new = transformed(box, matrix)
        assert (new[0] == matrix[:3, :3] @ box[0] + matrix[:3, 3]).all()
        assert (new[1] == axes).all()
        assert (new[2] == scale * half).all()
    turned = box_of(2, (1.0, 0.1, 0.0))
    for size in (1.0, 2.0, -4.0):
        new = transformed(turned, affine(size * np.eye(3)))
        assert (new[0] == size * turned[0]).all()
        assert (new[1] == turned[1]).all()
        assert (new[2] == abs(size) * turned[2]).all()


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=30)
@given(quaternions, quaternions, HALF, st.floats(1e-3, 1e3), st.booleans())
def test_similarities_are_tight(
    first: list[float], second: list[float], half: list[float], scale: float, mirror: bool
) -> None:
    box = np.array([1.0, 2.0, 3.0]), turn(first), np.array(half)
    linear = scale * turn(second) * ([1, 1, -1] if mirror else [1, 1, 1])
    center, axes, new = transformed(box, affine(linear, (5.0, 6.0, 7.0)))
    size = scale * (np.array(half).sum() + 10.0) + 10.0  # the centre is rounded too
    assert new == pytest.approx(scale * np.array(half), rel=1e-14, abs=1e-14 * size)
    assert center == pytest.approx(linear @ box[0] + [5, 6, 7], abs=1e-14 * size)
    along = (linear @ box[1] / scale).T @ axes  # the axes turn with the box
    assert np.abs(along) == pytest.approx(np.eye(3), abs=1e-13)


@each("seed", range(40))
def test_shear_is_contained_and_close_to_the_best_fit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = box_of(seed, tuple(rng.uniform(0.1, 1.0, 3)))
    matrix = affine(rng.normal(size=(3, 3)), (1.0, 2.0, 3.0))
    new = transformed(box, matrix)
    points = np.array(exactly(box, matrix), float)
    fit = oc.OBB.from_points(points)
    assert np.prod(new[2]) <= 1.01 * np.prod(fit.half_extents)


@each("flat", [(0.0, 1.0, 2.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_flat_boxes_stay_thin_under_shear(flat: tuple[float, float, float]) -> None:
    matrix = affine(np.array([[1.0, 2.0, 0.0], [0.5, 3.0, 1.0], [0.0, 0.2, 1.0]]))
    _, _, half = transformed(box_of(5, flat), matrix)
    zeros = flat.count(0.0)
    assert (np.sort(half)[:zeros] <= 1e-14).all()
    assert (np.sort(half)[zeros:] > 0.1).all()


@each("power", [-160, -100, 0, 100, 150])
def test_sizes_of_all_magnitudes(power: int) -> None:
    size = 10.0**power
    center, axes, half = box_of(6)
    matrix = affine(np.array([[1.0, 2.0, 0.0], [0.5, 3.0, 1.0], [0.0, 0.2, 1.0]]))
    reference = transformed((center, axes, half), matrix)[2]
    new = transformed((size * center, axes, size * half), matrix)[2]
    assert new == pytest.approx(size * reference, rel=1e-12)
    new = transformed((center, axes, half), matrix @ np.diag([size, size, size, 1.0]))[2]
    assert new == pytest.approx(size * reference, rel=1e-12)


def test_nearly_singular_matrices_are_contained() -> None:
    for small in 10.0 ** np.arange(-320.0, 0.0, 20.0):
        shear = np.array([[1.0, 1.0, 0.0], [0.0, small, 0.0], [0.0, 0.0, 1.0]])
        box = np.zeros(3), np.eye(3), np.ones(3)
        _, _, half = transformed(box, affine(shear))
        assert np.sort(half)[1:] == pytest.approx([1.0, 2.0], rel=0.05)


def test_results_below_the_least_double_round_up() -> None:
    box = np.zeros(3), np.eye(3), np.full(3, 1e-200)
    _, _, half = transformed(box, affine(1e-200 * np.eye(3)))
    assert half.tolist() == [5e-324] * 3


def test_bad_matrices_are_refused_by_name() -> None:
    transform = oc.OBB(*box_of(9)).transformed
    bad_row = np.eye(4)
    bad_row[3, 0] = 1e-20
    refused("matrix must have the last row 0 0 0 1", transform, bad_row)
    refused(r"matrix must have shape \(4, 4\)", transform, np.eye(3))
    refused("beyond 1e", transform, affine(1e300 * np.eye(3)))


def test_exactly_singular_and_barely_invertible_are_told_apart() -> None:
    # In doubles the determinant of both is rounding: only exact arithmetic tells.
    third = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]])
    refused("invertible", oc.OBB(*box_of(1)).transformed, affine(third))
    third[2, 2] = np.nextafter(9.0, 10.0)
    assert determinant(*map(exact, third.T)) != 0
    transformed(box_of(1), affine(third))
