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

"""Sweeps of boxes that turn, against exact circles and fine steps."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support import sweep, sweep_twists
from sweep_motions import TURNING, about_pi, pair_rows
from sweep_oracle import PoseCourse, TwistCourse, check_promises, first_sampled_contact, gaps_at

from obb_collision import Boxes
from obb_collision.queries.sweep import TOLERANCE, Sweeps
from obb_collision.queries.sweep.motion import bounding_radii
from obb_collision.queries.sweep.rigid import FLOOR

EYE = np.eye(3)
STILL = [0.0] * 6


@settings(max_examples=100)
@given(
    radius=st.floats(0.01, 100.0),
    share=st.floats(-0.98, 0.98),
    speed=st.floats(1e-3, 1e3),
    turns=st.sampled_from([1, 2, 64, 500]),
    size=st.floats(1e-4, 1.0),
    far=st.sampled_from([0.0, 1.0, 1e7]),
    flight=st.sampled_from([0.0, 1e3]),
)
def test_a_point_on_a_circle_meets_a_plate_on_time(
    radius: float, share: float, speed: float, turns: int, size: float, far: float, flight: float
) -> None:
    """From the right side counterclockwise to a plate below it, wide enough to stop the point."""
    origin, center = np.array([far, -far, far]), np.array([far + radius, -far, far])
    arm = np.longdouble(center[0]) - np.longdouble(far)
    depth = 0.5 * size * radius
    low = share * radius  # the plate's upper side is there, its right edge at 0
    plate = np.array([far - 2.0 * radius, -far - low, far])
    boxes = Boxes([center, plate], [EYE, EYE], [[0.0, 0.0, 0.0], [2.0 * radius, depth, 1.0]])
    # the first side met is the one that faces up at the point: y = upper end of the plate
    top = np.longdouble(plate[1]) + np.longdouble(far) + np.longdouble(depth)
    if not abs(top) < 0.99 * arm:
        return
    right = np.longdouble(plate[0]) - np.longdouble(far) + 2 * np.longdouble(radius)
    angle = np.longdouble(np.pi) + (np.longdouble(1.2246467991473532e-16)) - np.arcsin(top / arm)
    if arm * np.cos(angle) > right - 1e-6 * arm:
        return  # it comes in by the edge
    truth = angle / np.longdouble(speed)
    drift = [flight, 2.0 * flight, 0.0]
    twists = [[*drift, 0.0, 0.0, speed], [*drift, 0.0, 0.0, 0.0]]
    found = sweep_twists(
        boxes, twists, [[0, 1]], 2.0 * np.pi * turns / speed, origins=[origin, plate]
    )
    assert found.hits[0]
    assert np.longdouble(found.times[0]) <= truth
    near = FLOOR * bounding_radii(boxes.half_extents)[1]
    # how fast it falls on the plate, to first order and to second
    fall = abs(np.cos(angle)) * arm * speed
    early = min(near / fall * 1.2, np.sqrt(4.0 * near / (arm * speed**2)) + near / fall)
    assert float(truth - np.longdouble(found.times[0])) <= early


def is_free(found: Sweeps) -> bool:
    return not found.hits[0] and not found.undecided[0] and bool(found.free_until[0] == np.inf)


def fan_beside_wall(gap: float) -> Boxes:
    reach = np.hypot(0.5, 0.02)
    return Boxes(
        [[0.0] * 3, [reach + gap + 0.1, 0, 0]], [EYE] * 2, [[0.5, 0.02, 0.01], [0.1, 2, 2]]
    )


@each("turns", [1, 10, 200, 1e4, 1e9])
@each("gap", [1e-3, 0.02, 0.1])
def test_a_fan_beside_a_wall_is_free_for_any_number_of_turns(gap: float, turns: float) -> None:
    spin = [0, 0, 0, 0, 0, 2.0 * np.pi * turns]
    along, lean = [0, 1.0, 0.3, 0, 0, 2.0 * np.pi * turns], [0, 0, 0, 0.1, 0, 0.1 * gap]
    for fan, wall in ((spin, STILL), (along, STILL), (along, lean)):
        for rows in ([[0, 1]], [[1, 0]]):
            assert is_free(sweep_twists(fan_beside_wall(gap), [fan, wall], rows, 1.0))


@each("turns", [1, 10, 200, 1e4])
def test_a_fan_that_drifts_into_a_wall_hits_it_within_a_turn(turns: float) -> None:
    found = sweep_twists(
        fan_beside_wall(0.5), [[1.0, 0, 0, 0, 0, 2.0 * np.pi * turns], STILL], [[0, 1]], 1.0
    )
    assert found.hits[0]
    assert 0.5 <= found.times[0] <= 0.5 + 1.0 / turns


@each("turns", [1, 100, 1e6, 1e12])
def test_a_post_in_the_middle_of_a_ring_is_free(turns: float) -> None:
    """No plane separates it from what the arm sweeps: but one turn is like any other."""
    boxes = Boxes([[2.0, 0, 0], [0.3, 0, 0]], [EYE] * 2, [[0.05] * 3, [0.1] * 3])
    spin = [0, 0, 0, 0, 0, 2.0 * np.pi * turns]
    flying = [[5.0, 1.0, 0, *spin[3:]], [5.0, 1.0, 0, 0, 0, 0]]
    for twists in ([spin, STILL], flying):
        assert is_free(sweep_twists(boxes, twists, [[0, 1]], 1.0, origins=np.zeros((2, 3))))


@each("turns", [1e3, 1e5])
def test_small_things_are_hit_after_many_turns(turns: float) -> None:
    """A post of 2 mm drifts into the circle of a fan of a metre: its end comes by at once."""
    boxes = Boxes([[0.0] * 3, [1.1, 0, 0]], [EYE] * 2, [[1.0, 0.02, 0.02], [0.001] * 3])
    twists = [[0, 0, 0, 0, 0, 2.0 * np.pi * turns], [-0.2, 0, 0, 0, 0, 0]]
    found = sweep_twists(boxes, twists, [[0, 1]], 1.0)
    assert found.hits[0]
    meets = (1.099 - np.hypot(1.0, 0.02)) / 0.2
    assert meets - 1e-4 < found.times[0] < meets + 1e-3 / 0.2 / np.sqrt(turns) + 1.0 / turns


def test_what_takes_too_many_steps_is_undecided_and_never_a_time() -> None:
    """An arm going round a post that drifts: nothing but the walk could tell, for 1e6 turns."""
    boxes = Boxes([[2.0, 0, 0], [0.3, 0, 0]], [EYE] * 2, [[0.05] * 3, [0.1] * 3])
    twists = [[0, 0, 0, 0, 0, 2e6 * np.pi], [0.01, 0, 0, 0, 0, 0]]
    found = sweep_twists(boxes, twists, [[0, 1]], 10.0, origins=np.zeros((2, 3)))
    assert found.undecided[0]
    assert not found.hits[0]
    assert np.isnan(found.times[0])
    assert 0.0 < found.free_until[0] < 10.0
    assert np.isnan(found.positions).all()
    assert np.isnan(found.normals).all()
    alone = sweep_twists(boxes, twists, [[0, 1]], 10.0, origins=np.zeros((2, 3)), contacts=False)
    assert alone.undecided[0]
    assert alone.free_until[0] == found.free_until[0]


@each("far", [0.0, 1e5, 1e7])
def test_being_far_from_the_origin_makes_no_time_late(far: float) -> None:
    """A millimetre to go, both on a train of 100 m/s: which no rounding may take."""
    rng = np.random.default_rng(0)
    place, gap = np.array([far, 2.0 * far, -far]), np.array([0.25, 0.0, 0.0])
    boxes = Boxes([place, place + gap], [EYE] * 2, [[0.125 - 2**-11] * 3] * 2)
    for _ in range(12):
        u, v, turn = 100.0 + rng.random(), 99.0 + 0.5 * rng.random(), rng.random()
        twists = np.array([[u, 50.3, 0, 0, 0, 0], [v, 50.3, 0, 0, 0, 0]])
        truth = Fraction(2) ** -10 / (Fraction(u) - Fraction(v))
        time = sweep_twists(boxes, twists, [[0, 1]], 1.0).times[0]
        assert 0 <= truth - Fraction(time) < 1e-14
        twists[0, 5] = turn  # the corner of the one that turns comes nearer
        course = TwistCourse(boxes, twists, boxes.centers, 1.0 / 64.0)
        near = first_sampled_contact(course, np.array([[0, 1]]), 400)[0]
        time = sweep_twists(boxes, twists, [[0, 1]], 1.0).times[0]
        assert time <= near
        assert near - time < TOLERANCE * 0.22 / (u - v)


def test_collisions_at_the_start_are_found_however_far_and_fast() -> None:
    for far in (0.0, 1e7, 1e12):
        boxes = Boxes([[far, 0, 0], [far + 2.0, 0, 0]], [EYE] * 2, [[1.0] * 3, [1.25] * 3])
        for spin in (1.0, 1e6, 1e200):
            twists = [[1e9, 0, 0, 0, spin, 0], [-1e9, 0, 0, 0, 0, 0]]
            assert sweep_twists(boxes, twists, [[0, 1]], 1.0).times[0] == 0.0


def test_where_rounding_leaves_too_little_nothing_is_claimed() -> None:
    """A box of a millimetre from 1e8 m: doubles can't tell a tenth of a micrometre there."""
    boxes = Boxes([[0.0] * 3, [1e8, 0, 0]], [EYE] * 2, [[0.0005] * 3] * 2)
    twists = [[0, 0, 0, 0.1, 0.2, 0.3], [-1.5e8, 0, 0, 0.3, 0.1, 0.1]]
    found = sweep_twists(boxes, twists, [[0, 1]], 1.0)
    assert found.undecided[0]
    assert np.isnan(found.times[0])
    course = TwistCourse(boxes, np.array(twists), boxes.centers, 1.0)
    first, last = course.window(np.array([[0, 1]]))
    assert first[0] - 1e-10 < found.free_until[0] < last[0]
    assert gaps_at(course, np.array([[0, 1]]), found.free_until)[0] > 0.0


@each("tolerance", [1e-5, 1e-3, 0.1, 1.0])
def test_any_tolerance_is_kept(tolerance: float) -> None:
    rng = np.random.default_rng(5)
    start, end = TURNING["ordinary"](rng, 80)
    rows = pair_rows(80)
    found = sweep(start, end, rows, tolerance)
    assert check_promises(PoseCourse(start, end), found, rows, tolerance=tolerance) > 8


def test_turns_by_exactly_pi_go_one_of_both_ways() -> None:
    rng = np.random.default_rng(6)
    start, moved = TURNING["ordinary"](rng, 200)
    end = about_pi(Boxes(moved.centers, start.rotations, start.half_extents), rng)
    rows = pair_rows(200)
    found = sweep(start, end, rows)
    hits = np.flatnonzero(found.hits)
    shade = 1.0 - 1e-9
    gaps = [
        gaps_at(PoseCourse(start, moved_with(start, end, np.tile([one, other], 200))),
                rows[hits], found.times[hits])
        for one in (shade, -shade) for other in (shade, -shade)
    ]  # fmt: skip
    assert len(hits) > 20
    assert (np.min(gaps, axis=0) <= TOLERANCE * bounding_radii(start.half_extents).max()).all()
    # a shade less than pi decides the way
    less = moved_with(start, end, np.full(400, shade))
    assert check_promises(PoseCourse(start, less), sweep(start, less, rows), rows) > 20


def moved_with(start: Boxes, end: Boxes, shares: np.ndarray) -> Boxes:
    """End poses, turned by those shares (n,) of the way only; negative: the other way."""
    first = Rotation.from_matrix(start.rotations)
    turned = (Rotation.from_matrix(end.rotations) * first.inv()).as_rotvec()
    rotations = (Rotation.from_rotvec(shares[:, None] * turned) * first).as_matrix()
    return Boxes(end.centers, rotations, start.half_extents)


def test_swapping_a_pair_changes_nothing_much() -> None:
    start, end = TURNING["ordinary"](np.random.default_rng(7), 300)
    rows = pair_rows(300)
    found, swapped = sweep(start, end, rows), sweep(start, end, rows[:, ::-1])
    np.testing.assert_array_equal(found.hits, swapped.hits)
    np.testing.assert_allclose(found.times, swapped.times, rtol=0.0, atol=1e-3)
