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

"""Boxes of points, and under 4 x 4 matrices: they hold what they must, exactly, and are tight."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from each import each
from exact_bodies import assert_proper, holds, outside
from exact_vectors import Box, Point, corners, determinant, exact, moved
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support import quaternions, refused

import obb_collision as oc
from obb_collision.geometry.fitting import EXACT_POINTS, FITS, enclose_points, enclosing, fit_points
from obb_collision.typing import Floats

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CASES = json.loads((Path(__file__).parents[2] / "data" / "fit_point_sets.json").read_text())
EVERY_FIT = each("fit", FITS)


def fitted(points: Floats, fit: str = "best") -> tuple[Floats, Floats, Floats]:
    """Return the box, after checking that it is one and contains the points."""
    box = fit_points(points, fit)
    assert_proper(box)
    assert holds(box, points)
    return box


def volume(half_extents: Floats) -> float:
    return 8.0 * float(np.prod(half_extents))


@each("case", CASES)
def test_point_sets_of_bug_reports_are_contained_in_the_known_volumes(case: dict[str, Any]) -> None:
    points = np.array(case["points"])
    # 1.005: the known volume of mathgeolib_case is 1.0033 times better than ours.
    sizes = {fit: volume(fitted(points, fit)[2]) for fit in FITS}
    assert sizes["best"] <= 1.005 * case["best_volume"]


def test_diagonal_square_gets_its_sides() -> None:
    points = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0.0]])
    for fit in ("min_volume", "best"):
        _, rotation, half = fitted(points, fit)
        assert np.sort(half)[0] == 0.0
        assert 4.0 * np.prod(np.sort(half)[1:]) == pytest.approx(2.0, rel=1e-15)
        assert np.abs(rotation).max(axis=0)[half == 0.0] == 1.0


def test_smallest_rectangles_turned_from_the_principal_axes_stay_in_their_plane() -> None:
    plane = np.array([[1.0, 2.0, 2.0], [2.0, 1.0, -2.0]]) / 3.0
    kite = [[0, 0], [1, 0], [0, 1], [0.8, 0.8]]  # by 45 degrees: what is across has a way to fail
    for outline, area in ((kite, 1.0), ([[0, 0], [4, 0], [1, 2]], 8.0)):
        thickness, x, y = np.sort(fitted(np.array(outline) @ plane, "min_volume")[2])
        assert thickness < 4e-15
        assert 4.0 * x * y == pytest.approx(area, rel=1e-14)


def test_tilted_flat_sets_compare_by_area_among_flat_boxes() -> None:
    points = np.array([[0, 0, 0], [0, 1, 1], [1, 0, 0], [0, 0.5, 0.5]])
    _, _, half = fitted(points)
    assert np.sort(2.0 * half) == pytest.approx([0.0, 1.0, np.sqrt(2.0)], abs=1e-15)


@each("exponent", range(-17, 1))
def test_slightly_turned_cubes_get_their_volume(exponent: int) -> None:
    turned = Rotation.from_rotvec(10.0**exponent * np.array([0.3, -0.7, 0.5])).as_matrix()
    _, _, half = fitted(CUBE @ turned.T + [3.0, 4.0, 5.0])
    assert volume(half) <= 8.0 * 1.001


SMALL_SETS = st.lists(
    st.tuples(*[st.one_of(st.integers(-3, 3), st.floats(-5, 5)) for _ in range(3)]),
    min_size=1,
    max_size=12,
)


@settings(max_examples=120)
@given(
    SMALL_SETS, st.integers(0, 2**32 - 1), st.sampled_from(sorted(FITS)), st.integers(1, 3),
    st.one_of(st.just(0), st.integers(-520, 490)),
)  # fmt: skip
def test_any_sets_are_contained_and_flat_ones_thin(
    points: list[tuple[float, ...]], seed: int, fit: str, dimensions: int, exponent: int
) -> None:
    array = np.ldexp(np.array(points, dtype=np.float64), exponent)
    array[:, dimensions:] = 0.0
    turned = array @ Rotation.random(random_state=seed).as_matrix() if seed % 2 else array
    _, _, half = fitted(turned, fit)
    size = float(np.ptp(turned, axis=0).max(initial=0.0))
    thin = np.sort(half)[: 3 - dimensions]
    assert fit == "aabb" or (thin <= 1e-11 * size + 1e-300).all()


def hard_set(rng: np.random.Generator) -> Floats:
    """Return 1 to 40 points: flat, gridded, thin, in a skew plane, a cube's, one, turned, moved."""
    points = rng.normal(size=(int(rng.integers(1, 41)), 3))
    kind = rng.integers(8)
    if kind < 2:
        points[:, 2 - kind :] = 0.0
    elif kind == 2:
        points = np.round(points)
    elif kind == 3:
        points *= 10.0 ** rng.integers(-12, 0, 3)
    elif kind == 4:
        points[:, 2] = points[:, 0] + points[:, 1]
    elif kind == 5:
        points = np.sign(points)
    elif kind == 6:
        points[:] = points[0]
    if rng.random() < 0.7:
        points = points @ Rotation.random(random_state=rng).as_matrix()
    if rng.random() < 0.5:
        points = points + rng.normal(size=3) * 10.0 ** rng.integers(-3, 10)
    return np.asarray(points * 10.0 ** rng.integers(-320, 290) if rng.random() < 0.2 else points)


@EVERY_FIT
@each("exact_points", [0, EXACT_POINTS])
def test_hard_sets_are_contained_by_integers_and_by_the_bound_alone(
    fit: str, exact_points: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(enclosing, "EXACT_POINTS", exact_points)
    rng = np.random.default_rng(exact_points)
    for _ in range(50):
        fitted(hard_set(rng), fit)


@EVERY_FIT
@each("normal", range(3))
def test_flat_in_a_coordinate_plane_stays_exactly_flat(fit: str, normal: int) -> None:
    rng = np.random.default_rng(normal)
    points = rng.normal(size=(50, 3))
    points[:, normal] = 0.1
    center, rotation, half = fitted(points, fit)
    flat = int(np.argmin(half))
    assert half[flat] == 0.0
    assert center[normal] == 0.1
    assert np.abs(rotation[:, flat]).tolist() == np.eye(3)[normal].tolist()


@EVERY_FIT
def test_points_and_aligned_lines_are_exact(fit: str) -> None:
    point = np.array([[1e6, 2.0, 3.3]])
    for points in (point, np.repeat(point, 7, axis=0)):
        center, rotation, half = fitted(points, fit)
        assert center.tolist() == point[0].tolist()
        assert half.tolist() == [0.0, 0.0, 0.0]
        assert (rotation == np.eye(3)).all()
    center, _, half = fitted(point + np.array([[0, 0, 0], [0, 0, 1], [0, 0, 4]]), fit)
    assert half.tolist() == [0.0, 0.0, pytest.approx(2.0)]


@EVERY_FIT
@each("size", [1e-300, 1e-160, 1e-30, 1.0, 1e9, 1e150, 3e299])
def test_sizes_and_offsets_of_all_magnitudes(fit: str, size: float) -> None:
    turned = CUBE @ Rotation.random(random_state=4).as_matrix().T
    _, _, half = fitted(size * turned, fit)
    assert (half <= size * 1.8).all()
    assert fit not in ("best", "min_volume") or half == pytest.approx(np.full(3, size))
    fitted(size * turned + 1e9, fit)


@each("thickness", 10.0 ** np.arange(-20.0, 0.0, 2.0))
def test_nearly_flat_sets(thickness: float) -> None:
    turned = Rotation.random(random_state=5).as_matrix().T
    points = CUBE * [1.0, 2.0, thickness] @ turned
    for fit in FITS:
        fitted(points, fit)
    _, _, half = fitted(points)
    assert np.sort(half) == pytest.approx([thickness, 1.0, 2.0], rel=1e-3, abs=1e-15)


def test_best_is_no_larger_than_any_other_fit_and_close_to_trimesh() -> None:
    rng = np.random.default_rng(6)
    ratios = []
    for n in [4, 5, 6, 8, 12, 30, 100] * 2:
        points = rng.normal(size=(n, 3)) * rng.uniform(0.1, 2.0, 3) + 3.0
        sizes = {fit: volume(fitted(points, fit)[2]) for fit in FITS}
        assert sizes["best"] <= min(sizes.values()) * (1.0 + 1e-8)
        _, extents = trimesh.bounds.oriented_bounds(points)
        ratios.append(sizes["best"] / np.prod(extents))
    assert max(ratios) <= 1.01  # of all versions of trimesh
    assert np.mean(ratios) < 0.95


@each("count", [1, 2, 3, 40])
def test_upright_boxes_are_the_smallest_with_z_up(count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(20):
        points = rng.normal(size=(count, 3)) @ rng.normal(size=(3, 3)) + rng.normal(0, 10, 3)
        box = oc.OBB.from_points(points, fit="upright")
        assert box.rotation[:, 2].tolist() == [0.0, 0.0, 1.0]
        assert np.all(box.contains(points, exact=True))
        angles = np.linspace(0, 0.5 * np.pi, 2000)
        sides = [
            np.ptp(points[:, :2] @ axis, axis=0)
            for axis in (
                np.array([np.cos(angles), np.sin(angles)]),
                np.array([-np.sin(angles), np.cos(angles)]),
            )
        ]
        assert 4 * box.half_extents[0] * box.half_extents[1] <= (sides[0] * sides[1]).min() + 1e-12
        assert 2 * box.half_extents[2] == pytest.approx(np.ptp(points[:, 2]), abs=1e-12)


def test_hull_covariance_ignores_how_densely_sides_are_sampled() -> None:
    rng = np.random.default_rng(7)
    box = CUBE * [3.0, 2.0, 1.0]
    dense = np.vstack([box, rng.uniform(-1, 1, size=(500, 3)) * 0.4 + [2.0, 1.0, 0.5]])
    _, sparse_axes, _ = fitted(box, "hull_covariance")
    _, dense_axes, half = fitted(dense, "hull_covariance")
    assert np.abs(dense_axes) == pytest.approx(np.abs(sparse_axes), abs=1e-12)
    assert half == pytest.approx([3.0, 2.0, 1.0])
    _, _, plain = fitted(dense, "covariance")
    assert volume(plain) > 1.2 * volume(half)


@settings(max_examples=20)
@given(st.permutations(range(12)), st.integers(-300, 300))
def test_scale_by_powers_of_two_scales_the_box(order: list[int], exponent: int) -> None:
    points = np.random.default_rng(8).normal(size=(12, 3))
    center, rotation, half = fit_points(points)
    scaled = fit_points(np.ldexp(points, exponent))
    assert (scaled[0] == np.ldexp(center, exponent)).all()
    assert (scaled[1] == rotation).all()
    assert (scaled[2] == np.ldexp(half, exponent)).all()
    shuffled = fit_points(points[order])
    assert volume(shuffled[2]) == pytest.approx(volume(half), rel=1e-2)


@each("fit", ["covariance", "best"])
def test_half_extents_are_the_least_that_hold(fit: str) -> None:
    points = np.random.default_rng(9).normal(size=(20, 3))
    center, rotation, half = fitted(points, fit)
    for axis in range(3):
        smaller = half.copy()
        smaller[axis] = np.nextafter(half[axis], 0.0)
        assert not holds((center, rotation, smaller), points)


def test_many_points_on_a_face_move_it_by_roundoffs_only() -> None:
    turned = Rotation.random(random_state=10).as_matrix()
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 21)] * 3), axis=-1).reshape(-1, 3)
    points = grid[np.abs(grid).max(axis=1) == 1.0] @ turned.T + [1e3, 2e3, 3e3]
    assert len(points) > 6 * EXACT_POINTS
    center, half = enclose_points(points, turned)
    assert holds((center, turned, half), points)
    assert (half <= 1.0 + 1e-12).all()  # a roundoff of the coordinates is 4.5e-13


@pytest.mark.parametrize("count", [30_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
@each("shape", ["plane", "sphere", "line"])
def test_a_million_points_take_seconds(shape: str, count: int) -> None:
    rng = np.random.default_rng(11)
    points = rng.normal(size=(count, 3))
    if shape == "plane":
        points[:, 2] = 0.0
        points = points @ Rotation.random(random_state=12).as_matrix().T + 5.0
    elif shape == "sphere":
        points /= np.linalg.norm(points, axis=1)[:, None]
    else:
        points = points[:, :1] * [1.0, 2.0, 3.0] + 5.0
    start = time.process_time()
    center, rotation, half = fit_points(points)
    # 1 to 2 s for a million; this only catches quadratic time
    assert time.process_time() - start < 30.0 * count / 1_000_000
    reach = np.abs((points - center) @ rotation)
    doubtful = np.unique(np.argpartition(-reach, 30, axis=0)[:30].ravel())
    assert holds((center, rotation, half), points[doubtful])


def test_bad_input_is_refused_by_name() -> None:
    refused("fit must be one of 'aabb', 'covariance'", fit_points, CUBE, "tight")
    refused("points must be finite in row 1", fit_points, np.array([[0, 0, 0], [0, np.nan, 0]]))
    refused("points must be finite in row 0", fit_points, np.array([[0, 0, np.inf]]), "aabb")
    refused("points must not be empty", fit_points, np.empty((0, 3)))
    refused("points must have shape", fit_points, [[0.0, 1.0]])
    refused("points must have shape", fit_points, [0.0, 1.0, 2.0])


@settings(max_examples=40)
@given(st.lists(st.integers(0, 2**32 - 1), max_size=5), st.sampled_from(sorted(FITS)))
def test_each_cloud_gets_the_box_of_its_points_alone_and_is_contained(
    seeds: list[int], fit: str
) -> None:
    clouds = [hard_set(np.random.default_rng(seed)) for seed in seeds]
    boxes = oc.Boxes.from_points(clouds, fit=fit)
    together = np.concatenate([np.empty((0, 3)), *clouds])
    offsets = np.cumsum([0, *map(len, clouds)])
    assert oc.Boxes.from_points(together, offsets, fit) == boxes
    assert len(boxes) == len(clouds)
    for k, points in enumerate(clouds):
        assert boxes[k] == oc.OBB.from_points(points, fit) == oc.OBB(*fitted(points, fit))


def test_clouds_of_equal_size_come_as_one_array() -> None:
    points = np.random.default_rng(1).normal(size=(3, 10, 3))
    assert oc.Boxes.from_points(points) == oc.Boxes.from_points(list(points))
    assert oc.Boxes.from_points(one for one in points) == oc.Boxes.from_points(points)


def test_bad_clouds_are_refused_by_their_number() -> None:
    good, of_points = np.eye(3), oc.Boxes.from_points
    refused("points must not be empty in cloud 1", of_points, [good, np.empty((0, 3)), good])
    refused("points must not be empty in cloud 1", of_points, good, [0, 2, 2, 3])
    bad = np.array([[0, 0, 0], [0, np.nan, 0]])
    refused("points of cloud 2 must be finite in row 1", of_points, [good, good, bad])
    refused(r"points of cloud 0 must have shape \(n, 3\)", of_points, good)
    refused("fit must be one of", of_points, [good], fit="tight")
    for offsets in ([], [0], [0, 2], [1, 3], [0, 2, 1, 3]):
        refused("offsets must ascend from 0 to the number of points, 3", of_points, good, offsets)
    refused("offsets must be from 0 to 3 in row 1", of_points, good, [0, 4])


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
