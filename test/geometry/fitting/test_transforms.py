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

from fractions import Fraction

import numpy as np
import pytest
from each import each
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from membership import Box, assert_proper, corners, determinant, fractions, moved, outside
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.geometry.fitting.transform import transform_box
from obb_collision.typing import Floats

QUATERNION = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(np.any)
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


def rotation(seed: int) -> Floats:
    matrix: Floats = Rotation.random(random_state=seed).as_matrix()
    return matrix


def transformed(box: Box, matrix: Floats) -> Box:
    """Return the moved box, after checking that it is one and contains the corners."""
    result = transform_box(*box, matrix)
    assert_proper(result)
    assert all(gap <= 0 for gap in outside(result, moved(corners(box), matrix)))
    return result


def box_of(seed: int, half: tuple[float, float, float] = (1.0, 2.0, 3.0)) -> Box:
    return np.array([0.1, -0.2, 0.3]), rotation(seed), np.array(half)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@given(QUATERNION, HALF, MATRIX, st.integers(-500, 480))
def test_any_box_under_any_invertible_matrix_is_contained(
    quaternion: list[float], half: list[float], entries: list[float], exponent: int
) -> None:
    matrix = np.vstack([np.reshape(entries, (3, 4)), [0, 0, 0, 1.0]])
    exact = [fractions(column) for column in matrix[:3, :3].T]
    assume(determinant(*exact) != 0)
    center = np.ldexp(np.array([0.1, 0.7, -0.3]), exponent)
    box = center, turn(quaternion), np.ldexp(np.array(half), exponent)
    transformed(box, matrix)
    matrix[:3] = np.ldexp(matrix[:3], -exponent)
    transformed(box, matrix)


def test_identity_keeps_every_bit() -> None:
    for half in ((1.0, 2.0, 3.0), (1.0, 0.0, 0.1), (0.0, 0.0, 0.0)):
        box = box_of(1, half)
        for old, new in zip(box, transformed(box, np.eye(4)), strict=True):
            assert (old == new).all()


@each("scale", [2.0, 0.5, -4.0])
def test_uniform_scale_by_powers_of_two_is_exact(scale: float) -> None:
    box = box_of(2, (1.0, 0.1, 0.0))
    center, axes, half = transformed(box, affine(scale * np.eye(3)))
    assert (center == scale * box[0]).all()
    assert (axes == box[1]).all()
    assert (half == abs(scale) * box[2]).all()


def test_quarter_turns_and_reflections_are_exact() -> None:
    box = np.array([1.0, 2.0, 3.0]), np.eye(3), np.array([0.1, 0.2, 0.0])
    turned = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    center, axes, half = transformed(box, affine(turned, (1.0, 1.0, 1.0)))
    assert center.tolist() == [-1.0, 2.0, 4.0]
    assert (axes == turned).all()
    assert (half == box[2]).all()
    center, _, half = transformed(box, affine(np.diag([-1.0, 1.0, 1.0])))
    assert center.tolist() == [-1.0, 2.0, 3.0]
    assert (half == box[2]).all()


def test_scale_along_the_box_axes_is_exact() -> None:
    box = np.zeros(3), np.eye(3), np.array([1.0, 2.0, 0.0])
    _, axes, half = transformed(box, np.diag([3.0, -0.5, 7.0, 1.0]))
    assert (axes == np.eye(3)).all()
    assert half.tolist() == [3.0, 1.0, 0.0]


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=50)
@given(QUATERNION, QUATERNION, HALF, st.floats(1e-3, 1e3), st.booleans())
def test_similarities_are_tight(
    first: list[float], second: list[float], half: list[float], scale: float, mirror: bool
) -> None:
    box = np.array([1.0, 2.0, 3.0]), turn(first), np.array(half)
    linear = scale * turn(second) * ([1, 1, -1] if mirror else [1, 1, 1])
    center, axes, new = transformed(box, affine(linear, (5.0, 6.0, 7.0)))
    size = scale * (np.array(half).sum() + 10.0) + 10.0  # the centre is rounded too
    assert new == pytest.approx(scale * np.array(half), rel=1e-14, abs=1e-14 * size)
    assert center == pytest.approx(linear @ box[0] + [5, 6, 7], abs=1e-14 * size)
    along = (linear @ box[1] / scale).T @ axes
    assert np.abs(along) == pytest.approx(np.eye(3), abs=1e-13)


@each("seed", range(40))
def test_shear_is_contained_and_close_to_the_best_fit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = box_of(seed, tuple(rng.uniform(0.1, 1.0, 3)))
    matrix = affine(rng.normal(size=(3, 3)), (1.0, 2.0, 3.0))
    new = transformed(box, matrix)
    points = np.array([[float(x) for x in p] for p in moved(corners(box), matrix)])
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


def test_obb_transformed_speaks_the_same() -> None:
    obb = oc.OBB(*box_of(7))
    matrix = affine(rotation(8) @ np.diag([1.0, 2.0, 3.0]))
    new = obb.transformed(matrix)
    expected = transform_box(obb.center, obb.rotation, obb.half_extents, matrix)
    assert all((x == y).all() for x, y in zip((new.center, new.rotation), expected, strict=False))
    assert (new.half_extents == expected[2]).all()


def test_bad_matrices_are_refused_by_name() -> None:
    box = box_of(9)
    bad_row = np.eye(4)
    bad_row[3, 0] = 1e-20
    with pytest.raises(ValueError, match="matrix must have the last row 0 0 0 1"):
        transform_box(*box, bad_row)
    with pytest.raises(ValueError, match="matrix must be invertible"):
        transform_box(*box, affine(np.array([[1.0, 2, 3], [2, 4, 6], [0, 0, 1]])))
    with pytest.raises(ValueError, match="matrix must be finite"):
        transform_box(*box, affine(np.full((3, 3), np.nan)))
    with pytest.raises(ValueError, match=r"matrix must have shape \(4, 4\)"):
        transform_box(*box, np.eye(3))
    with pytest.raises(ValueError, match="beyond 1e"):
        transform_box(*box, affine(1e300 * np.eye(3)))


def test_exactly_singular_and_barely_invertible_are_told_apart() -> None:
    # In doubles the determinant of both is rounding: only exact arithmetic tells.
    third = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]])
    with pytest.raises(ValueError, match="invertible"):
        transform_box(*box_of(1), affine(third))
    third[2, 2] = np.nextafter(9.0, 10.0)
    assert determinant(*(fractions(c) for c in third.T)) != Fraction(0)
    transformed(box_of(1), affine(third))
