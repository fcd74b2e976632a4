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

"""Bounds of motions and of bodies of robots, measured with twice the digits or more."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction

import numpy as np
from error_bounds import (
    Moved,
    Rows,
    check_flips,
    check_ratios,
    edge_lengths,
    exact_gaps,
    rounded,
    turn,
)
from exact_vectors import Vector, along, corners, dot, exact, minus, norm
from kinematics_oracle import OracleJoint, written
from small_robots import link, urdf
from support import joined, row_of, sweep
from sweep_oracle import ExactMotion

import obb_collision as oc
from obb_collision import Boxes
from obb_collision.numerics.constants import CAREFUL_BOUND, TIME_ROUNDING
from obb_collision.numerics.vec3 import columns, vector, vector_at
from obb_collision.queries.sweep.bounds import (
    CORNER_ROWS,
    SLICE_SLACK,
    Approach,
    best_step,
    fill_corners,
    free_slice,
    turning,
)
from obb_collision.queries.sweep.motion import (
    ANGLE_SLACK,
    CORNER_SLACK,
    OUTWARD,
    bounding_radii,
    offset_and_way,
    rotated,
)
from obb_collision.queries.sweep.rigid import (
    ANGLE_ROUNDING,
    ARM_ROUNDING,
    GAP_ROUNDING,
    POSITION_ROUNDING,
    ROTATION_ROUNDING,
)
from obb_collision.robots.checks.arrays import (
    LINK_PLACING,
    new_placed,
    place_state,
    placed_box,
    slack_of,
)
from obb_collision.robots.checks.model import Model

RNG = np.random.default_rng(9)
COUNT = 60
SIGNS = [(i, j) for i in (-1, 1) for j in (-1, 1)]


def test_times_of_contact() -> None:
    """At the time given, the gap is the bound by which the boxes are grown, but for the error."""
    moved = Moved(8)
    a, b = moved.at(moved.farthest)
    end = Boxes.trusted(a.centers + 0.3 * RNG.normal(size=(len(a), 3)), b.rotations, b.half_extents)
    boxes, pairs = joined(a, b)
    ends = Boxes.trusted(
        np.concatenate([a.centers, end.centers]), boxes.rotations, boxes.half_extents
    )
    times = sweep(boxes, ends, pairs).times
    hit = np.flatnonzero((times > 0.0) & np.isfinite(times))
    assert len(hit) > 20
    ratios = []
    for n in hit:
        motion = ExactMotion.of((row_of(a, n), row_of(b, n)), (row_of(a, n), row_of(end, n)))
        gap = Fraction(motion.gap(times[n]))  # over the size
        assert gap >= 0
        bound = Fraction(CAREFUL_BOUND)
        ratios.append(abs(gap - bound) / (bound + Fraction(TIME_ROUNDING)))
    check_ratios(ratios)


def test_radii() -> None:
    moved = Moved(8)
    ratios = []
    slack = Fraction(OUTWARD) - 1
    for radius, half in zip(
        bounding_radii(moved.a.half_extents).tolist(), moved.a.half_extents, strict=True
    ):
        true = norm(exact(half))
        if true > Fraction(2) ** -900:
            ratios.append(abs(Fraction(radius) / true - 1 - slack) / slack)
    check_ratios(ratios)


def test_offsets() -> None:
    """From velocities: where the second box is from the first at the end."""
    ratios = []
    for starts, velocities in RNG.normal(size=(COUNT, 2, 2, 3)) * [[[[1e6]], [[3.0]]]]:
        _, last, way = offset_and_way(starts, velocities, 0.7, 0, 1)
        first = minus(exact(starts[1]), exact(starts[0]))
        rate = minus(exact(velocities[1]), exact(velocities[0]))
        bound = Fraction(POSITION_ROUNDING) * (norm(first) + norm(exact(way)))
        ratios.append(norm(minus(exact(last), along(first, Fraction(0.7), rate))) / bound)
    check_ratios(ratios)


def exactly_turned(rotation: np.ndarray, way: np.ndarray, time: float) -> list[Vector]:
    """Return the columns of a rotation turned by ``time`` times a rotation vector, to 50 digits."""
    spin = exact(way)
    rows = turn(spin, norm(spin) * Fraction(time))
    return [[dot(row, exact(column)) for row in rows] for column in rotation.T]


def random_turns() -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Return rotations, rotation vectors of angles up to 30, and times."""
    boxes = Moved(4).a
    turns = RNG.normal(size=(len(boxes), 3)) * 10.0 ** RNG.uniform(-3.0, 1.0, (len(boxes), 1))
    return list(
        zip(boxes.rotations, turns, RNG.uniform(0.1, 1.0, len(boxes)).tolist(), strict=True)
    )


def test_rotations_at_a_time() -> None:
    ratios = []
    for rotation, way, time in random_turns():
        found = rotated(columns(rotation), vector(way), time)
        bound = Fraction(ROTATION_ROUNDING) + Fraction(ANGLE_ROUNDING) * norm(
            exact(way)
        ) * Fraction(time)
        for column, expected in zip(found, exactly_turned(rotation, way, time), strict=True):
            ratios.append(norm(minus(exact(column), expected)) / bound)
    check_ratios(ratios)


def test_corners_of_turned_boxes() -> None:
    ratios, corners = [], np.empty((CORNER_ROWS, 3))
    half = np.array([0.4, 0.7, 1.1])
    for rotation, way, time in random_turns():
        found = rotated(columns(rotation), vector(way), time)
        fill_corners(found, vector(half), (0.0, 0.0, 0.0), vector(way), corners)
        expected_columns = exactly_turned(rotation, way, time)
        reach = norm(exact(half))
        bound = Fraction(CORNER_SLACK) + Fraction(ANGLE_SLACK) * norm(exact(way)) * Fraction(time)
        for n in range(8):
            sides = [h if n >> k & 1 else -h for k, h in enumerate(exact(half))]
            expected = [dot(sides, row) for row in zip(*expected_columns, strict=True)]
            ratios.append(norm(minus(exact(corners[1 + n]), expected)) / (bound * reach))
    check_ratios(ratios)


def test_free_slices() -> None:
    """Two boxes of one rotation, one beyond a face of the other, that do not turn in a slice."""
    moved = Moved(4, ("ordinary scene", "thin plates and rods"))
    boxes = moved.a
    still = (0.0, 0.0, 0.0)
    corners = np.empty((len(boxes), CORNER_ROWS, 3))
    for n in range(len(boxes)):
        axes, half = columns(boxes.rotations[n]), vector(boxes.half_extents[n])
        fill_corners(axes, half, still, still, corners[n])

    def at(n: int, distance: float) -> np.ndarray:
        return np.asarray(distance * boxes.rotations[n, :, n % 3])

    def free(distances: np.ndarray) -> np.ndarray:
        answers = []
        for n, distance in enumerate(distances.tolist()):
            place = tuple(at(n, distance).tolist())
            answers.append(free_slice(place, place, corners[n], 0.0, corners[n], 0.0, 0.0))
        return np.array(answers)

    def quantity(n: int, distance: float) -> Fraction:
        place, normal = exact(at(n, distance)), exact(boxes.rotations[n, :, n % 3])
        axes = [exact(column) for column in boxes.rotations[n].T]
        half = exact(boxes.half_extents[n])
        reach = dot(half, [abs(dot(normal, column)) for column in axes])
        gap = (dot(normal, place) - 2 * reach) / norm(normal)
        sides = [[h * x for x in column] for h, column in zip(half, axes, strict=True)]
        ends = [[x + i * y + j * z for x, y, z in zip(*sides, strict=True)] for i, j in SIGNS]
        # about the axis that is taken where nothing turns: z
        radius = max(abs(end[2]) for end in ends) + max(norm((end[0], end[1], 0)) for end in ends)
        return gap / (Fraction(SLICE_SLACK) * (2 * norm(place) + 2 * radius))

    check_flips(free, quantity, 10.0 * boxes.half_extents.max(axis=1))


def certain_gap(a: Boxes, b: Boxes, n: int, rounding: float) -> float:
    """Return the largest certain gap of boxes that approach: no axis separates them for long."""
    still = (0.0, 0.0, 0.0)
    offset = b.centers[n] - a.centers[n]
    distance = float(np.linalg.norm(offset))
    approach = Approach(vector(offset), vector(-offset), distance, distance, 10.0)
    first, second = (
        turning(columns(side.rotations[n]), vector(side.half_extents[n]), still, 1.0)
        for side in (a, b)
    )
    return best_step(approach, first, second, rounding, 0.0)[0]


def test_gaps_of_turning_boxes() -> None:
    """The largest gap that is certain: by the bound below the largest, but for the error.

    The centres are at the ends of arms from the origin: their difference is rounded, too.
    """
    moved = Moved(8, ("ordinary scene", "edge against edge", "near touching, to 1e-12 of the size"))
    a, b = moved.at(moved.farthest)
    arms = 1e3 * RNG.normal(size=(len(a), 3))
    a, b = (Boxes.trusted(s.centers + arms, s.rotations, s.half_extents) for s in (a, b))
    ratios = []
    for n in range(len(a)):
        radii = [float(np.linalg.norm(s.half_extents[n])) for s in (a, b)]
        reaches = radii + [float(np.linalg.norm(s.centers[n])) for s in (a, b)]
        offset = float(np.linalg.norm(b.centers[n] - a.centers[n]))
        rounding = GAP_ROUNDING * (sum(radii) + offset) + ARM_ROUNDING * sum(reaches)
        row = row_of(a, n), row_of(b, n)
        lengths = [1.0] * 6 + edge_lengths(*row)
        certain, length = max(
            (gap - Fraction(rounding) / Fraction(length), length)
            for gap, length in zip(exact_gaps(*row), lengths, strict=True)
        )
        error = abs(Fraction(certain_gap(a, b, n, rounding)) - certain)
        ratios.append(error * Fraction(length) / Fraction(rounding))
    check_ratios(ratios)


BOX = (0.2, 0.1, 0.3)
END = '<box size="{} {} {}"/>'.format(*BOX)
CORNERS = corners((np.zeros(3), np.eye(3), 0.5 * np.array(BOX)))


def product(a: Rows, b: Rows) -> Rows:
    return [[rounded(dot(row, column)) for column in zip(*b, strict=True)] for row in a]


def applied(a: Iterable[Vector], p: Vector) -> Vector:
    return [rounded(dot(row, p)) for row in a]


def chain(rng: np.random.Generator, count: int, size: float) -> list[OracleJoint]:
    """Return a chain of random joints."""
    joints = []
    for n in range(count):
        kind = "prismatic" if rng.random() < 0.2 else "continuous"
        numbers = rng.normal(0, size, 3), rng.uniform(-3, 3, 3), rng.normal(size=3)
        xyz, rpy, axis = (tuple(each.tolist()) for each in numbers)
        joints.append(OracleJoint(f"j{n}", kind, f"l{n}", f"l{n + 1}", xyz, rpy, axis))
    return joints


def exact_corners(joints: list[OracleJoint], state: list[float]) -> list[Vector]:
    """Return the corners of the box at the end."""
    units: Rows = [exact(unit) for unit in np.eye(3)]
    place, rows = exact(np.zeros(3)), units
    for joint, value in zip(joints, state, strict=True):
        xyz, axis = exact(joint.xyz), exact(joint.axis)
        place = along(place, 1, applied(rows, xyz))
        for angle, unit in zip(joint.rpy[::-1], reversed(units), strict=True):
            rows = product(rows, turn(unit, Fraction(angle)))
        if joint.kind == "prismatic":
            place = along(place, Fraction(value) / norm(axis), applied(rows, axis))
        else:
            rows = product(rows, turn(axis, Fraction(value)))
    return [along(place, 1, applied(rows, corner)) for corner in CORNERS]


def test_bodies_of_robots() -> None:
    """Corners of a box at the end of chains of joints of all lengths and sizes."""
    rng = np.random.default_rng(7)
    ratios = []
    for count in (1, 2, 7, 30, 100):
        for size in (0.0, 1e-3, 0.3, 1e3) if count < 30 else (0.3,):
            joints = chain(rng, count, size)
            links = [link(f"l{n}") for n in range(count)] + [link(f"l{count}", END)]
            robot = oc.Robot.from_urdf(urdf(*links, *map(written, joints)))
            model = Model([robot], [None], np.array([[0.0, 0, 0, 0, 0, 0, 1]]))
            arrays = model.prepared(oc.Scene()).checked
            state = np.where([j.kind == "prismatic" for j in joints],
                             rng.uniform(-1, 1, count), rng.uniform(-6, 6, count))  # fmt: skip
            placed = new_placed(arrays)
            place_state(arrays, state[None], 0, placed)
            box = placed_box(arrays.bodies, placed, 0)
            center, axes = exact(box.center), [exact(axis) for axis in box.axes]
            bound = Fraction(slack_of(arrays.bodies, 0, vector_at(placed.centers, 0)))
            assert bound >= Fraction(LINK_PLACING) * norm(center)
            found = [along(center, 1, applied(zip(*axes, strict=True), x)) for x in CORNERS]
            for ours, true in zip(found, exact_corners(joints, state.tolist()), strict=True):
                ratios.append(norm(minus(ours, true)) / bound)
    check_ratios(ratios)
