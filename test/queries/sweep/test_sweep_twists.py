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

"""Sweeps of boxes that turn, by twists and from pose to pose: circles, fine steps, and bounds."""

from __future__ import annotations

import zlib
from fractions import Fraction

import numpy as np
from convex_bodies import CORNER_SIGNS
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support import numbers, refused, sizes, sweep, sweep_twists
from sweep_motions import TURNING, TWISTING, Motion, Twisting, directions, motion, pair_rows, turn
from sweep_oracle import PoseCourse, TwistCourse, check_promises, first_sampled_contact, gaps_at

from obb_collision import Boxes, Verdict, verdicts
from obb_collision.queries.sweep import TOLERANCE, Sweeps
from obb_collision.queries.sweep.motion import (
    bounding_radii,
    motion_bounds,
    sweep_needed,
    swept_bounds,
    turns_between,
    twist_bounds,
)
from obb_collision.queries.sweep.rigid import TOLERANCE_FLOOR
from tools.cases.placement import log_uniform, random_rotations

CHUNK = 500
EYE = np.eye(3)
STILL = [0.0] * 6

#: Samples of a motion per turn of the box that turns fastest.
PER_TURN = 60


def swept(motion: Twisting, rows: np.ndarray) -> Sweeps:
    return sweep_twists(motion.boxes, motion.twists, rows, motion.horizon, origins=motion.origins)


@each("name", [*TURNING, *TWISTING])
def test_none_missed_none_late_and_none_too_early(name: str, pairs: int) -> None:
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    left = total = max(40, pairs // 7) if name in TURNING else max(24, pairs // 70)
    certain = hits = open_ = 0
    while left > 0:
        count = min(left, CHUNK)
        rows = pair_rows(count)
        if name in TURNING:
            start, end = TURNING[name](rng, count)
            found = sweep(start, end, rows)
            certain += check_promises(PoseCourse(start, end), found, rows)
        else:
            motion = TWISTING[name](rng, count)
            found = swept(motion, rows)
            turns = np.linalg.norm(motion.twists[:, 3:], axis=1).max() * motion.horizon
            samples = max(160, int(PER_TURN * turns / (2.0 * np.pi)))
            certain += check_promises(TwistCourse(*motion), found, rows, samples)
        hits, open_ = hits + int(found.hits.sum()), open_ + int(found.undecided.sum())
        left -= len(rows)
    assert 0.05 * total < certain
    assert open_ <= (0.0 if name in TURNING else 0.03) * total
    if name in TURNING:
        # a hit that no sample confirms is a pass by less than the tolerance: rare but for contacts
        assert hits - certain <= (0.5 if name == "starting in contact" else 0.03) * total
    print(f"{name}: {total} motions, {certain} certain hits, {hits} found, {open_} undecided")  # noqa: T201


@each("name", TWISTING)
def test_bounds_hold_the_whole_motion(name: str) -> None:
    motion = TWISTING[name](np.random.default_rng(3), 60)
    low, high = twist_bounds(motion.boxes, motion.twists, motion.origins, motion.horizon)
    # places relative to where each began, from a box that stays there
    count = len(motion.boxes)
    start = motion.boxes.centers
    boxes = Boxes(*(np.concatenate([x, x]) for x in
                    (start, motion.boxes.rotations, motion.boxes.half_extents)))  # fmt: skip
    twists = np.concatenate([motion.twists, 0.0 * motion.twists])
    course = TwistCourse(boxes, twists, np.tile(motion.origins, (2, 1)), motion.horizon)
    rows = np.column_stack([np.arange(count, 2 * count), np.arange(count)])
    slack = 1e-15 * (1.0 + np.abs(low) + np.abs(high))
    for time in np.linspace(0.0, motion.horizon, 60):
        least, most = course.pair_at(rows, np.full(count, time))[1].world_bounds()
        assert (start + least >= low - slack).all()
        assert (start + most <= high + slack).all()


def test_bounds_hold_what_turns_next_to_an_axis_of_the_world() -> None:
    """Circles of corners in extended precision, about axes 1e-17 to 0.1 rad beside it."""
    rng, count = np.random.default_rng(8), 300
    turns = np.eye(3)[rng.integers(0, 3, count)]
    turns += directions(rng, count) * 10.0 ** rng.uniform(-17.0, -1.0, (count, 1))
    half = rng.uniform(0.01, 1.0, (count, 3))
    boxes = Boxes(np.zeros((count, 3)), np.tile(EYE, (count, 1, 1)), half)
    bounds = twist_bounds(boxes, np.hstack([np.zeros((count, 3)), 20.0 * turns]), None, 1.0)
    axis = turns.astype(np.longdouble)
    axis /= np.sqrt((axis * axis).sum(axis=1))[:, None]
    height = (CORNER_SIGNS[:, None] * half * axis).sum(axis=2)[..., None]
    across = CORNER_SIGNS[:, None] * half - height * axis
    tilt = np.sqrt(np.roll(axis, -1, axis=1) ** 2 + np.roll(axis, -2, axis=1) ** 2)
    reach = (height * axis + np.sqrt((across * across).sum(axis=2))[..., None] * tilt).max(axis=0)
    for bound in (-bounds[0], bounds[1]):
        assert (bound >= reach).all()
        assert (bound <= reach + 1e-13).all()


def test_bounds_are_tight_for_small_turns_and_grow_no_more_after_a_whole_one() -> None:
    boxes = Boxes([[5.0, 0.0, 0.0]], [EYE], [[1.0, 0.1, 0.1]])
    turn = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    low, high = twist_bounds(boxes, turn, np.zeros((1, 3)), 1e-3)
    np.testing.assert_allclose(
        [low[0], high[0]], [[3.9999, -0.1, -0.1], [6.0, 0.106, 0.1]], atol=1e-4
    )
    corner = np.hypot(6.0, 0.1)
    for seconds in (7.0, 1e3, 1e9):
        low, high = twist_bounds(boxes, turn, np.zeros((1, 3)), seconds)
        np.testing.assert_allclose(high[0], [corner, corner, 0.1], rtol=1e-12)
        np.testing.assert_allclose(low[0], [-corner, -corner, -0.1], rtol=1e-12)


def test_any_number_of_steps_is_enough_for_free_until() -> None:
    """Rods that spin near each other: what is undecided is apart until the time given."""
    motion = TWISTING["rods that both spin"](np.random.default_rng(9), 40)
    motion = motion._replace(twists=motion.twists * [1, 1, 1, 100, 100, 100])
    rows = pair_rows(40)
    found = swept(motion, rows)
    open_ = np.flatnonzero(found.undecided)
    assert len(open_) > 0
    course = TwistCourse(*motion)
    for share in np.linspace(0.0, 1.0, 300):
        a, b = course.pair_at(rows[open_], share * found.free_until[open_])
        assert (verdicts(a, b) != Verdict.OVERLAP).all()


@settings(max_examples=60)
@given(
    st.tuples(*12 * [numbers]), st.tuples(*12 * [numbers]), st.tuples(*6 * [st.floats(0, 1e300)]),
    st.floats(1e-300, 1.0),
)  # fmt: skip
def test_any_doubles_at_all(one: tuple, two: tuple, half: tuple, horizon: float) -> None:  # type: ignore[type-arg]
    """Whatever is accepted gets one of three answers, whole."""
    boxes = Boxes([one[:3], two[:3]], [EYE] * 2, [half[:3], half[3:]])
    for scale in (1.0, 1e-150, 1e-300):
        moves = scale * np.array([one, two])
        try:
            found = sweep_twists(boxes, moves[:, 6:], [[0, 1]], horizon, origins=moves[:, 3:6])
        except ValueError as error:
            assert "must not exceed" in str(error)  # noqa: PT017 - the others must pass
            continue
        assert found.hits[0] == np.isfinite(found.times[0])
        assert found.undecided[0] == np.isnan(found.times[0])
        assert found.free_until[0] >= 0.0
        assert np.isfinite(found.positions).all() == found.hits[0]
        start = verdicts(boxes[:1], boxes[1:])[0]
        if start == Verdict.OVERLAP:
            assert found.free_until[0] == 0.0


def test_other_boxes_and_origins_are_refused() -> None:
    boxes = Boxes(np.zeros((2, 3)), [EYE, EYE], np.ones((2, 3)))
    for match, origins in (
        ("origins must have one row per box", np.zeros((3, 3))),
        ("origins", np.zeros((2, 2))),
        ("origins must be finite in row 0", np.array([[0, 0, np.nan], [0, 0, 0]])),
    ):
        refused(match, sweep_twists, boxes, [STILL, STILL], [[0, 1]], 1.0, origins=origins)
    grown = Boxes(boxes.centers, boxes.rotations, [[1.0] * 3, [2.0] * 3])
    for question in (swept_bounds, sweep_needed):
        refused("row 1", question, boxes, grown)
        refused("same length", question, boxes, boxes[:1])


def test_an_origin_at_the_centre_is_the_default() -> None:
    motion = TWISTING["boxes beside their origins"](np.random.default_rng(4), 50)
    rows = pair_rows(50)
    given_ = sweep_twists(motion.boxes, motion.twists, rows, 1.0, origins=motion.boxes.centers)
    default = sweep_twists(motion.boxes, motion.twists, rows, 1.0)
    assert given_.times.tolist() == default.times.tolist()


TIMES = np.linspace(0.0, 1.0, 41)


@each("name", TURNING)
def test_swept_bounds_contain_the_motion(name: str) -> None:
    start, end = TURNING[name](np.random.default_rng(1), 100)
    low, high = swept_bounds(start, end)
    course, rows = PoseCourse(start, end), np.arange(len(start))
    slack = 1e-14 * (np.abs(start.centers) + np.abs(end.centers) + 1.0)
    for time in TIMES:
        least, most = course.boxes_at(rows, np.full(len(start), time)).world_bounds()
        assert (least >= low - slack).all()
        assert (most <= high + slack).all()


def test_swept_bounds_are_tight_for_small_turns_and_none() -> None:
    start, end = TURNING["small motions, close together"](np.random.default_rng(2), 300)
    low, high = swept_bounds(start, end)
    ends = np.array([start.world_bounds(), end.world_bounds()])
    sag = bounding_radii(start.half_extents)[:, None] * 0.1**2 / 8.0
    assert (low >= ends[:, 0].min(axis=0) - 1.01 * sag).all()
    assert (high <= ends[:, 1].max(axis=0) + 1.01 * sag).all()
    straight = Boxes(end.centers, start.rotations, start.half_extents)
    low, high = swept_bounds(start, straight)
    ends = np.array([start.world_bounds(), straight.world_bounds()])
    np.testing.assert_array_equal(low, ends[:, 0].min(axis=0))
    np.testing.assert_array_equal(high, ends[:, 1].max(axis=0))


def test_no_corner_moves_farther_than_the_bound() -> None:
    start, end = TURNING["ordinary"](np.random.default_rng(3), 200)
    bounds, rows = motion_bounds(start, end), np.arange(len(start))
    way, before = np.zeros((len(start), 8)), None
    for time in TIMES:
        boxes = PoseCourse(start, end).boxes_at(rows, np.full(len(start), time))
        local = boxes.half_extents[:, None] * CORNER_SIGNS
        corners = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, local)
        if before is not None:
            way += np.linalg.norm(corners - before, axis=2)
        before = corners
    assert (way.max(axis=1) <= bounds).all()


def test_turns_are_those_of_the_poses() -> None:
    start, end = TURNING["spinning blades"](np.random.default_rng(4), 300)
    turned = turns_between(start, end)
    assert (np.linalg.norm(turned, axis=1) <= np.pi * (1.0 + 1e-15)).all()
    again = PoseCourse(start, end).boxes_at(np.arange(len(start)), np.ones(len(start)))
    np.testing.assert_allclose(again.rotations, end.rotations, atol=1e-14)
    assert (turns_between(start, start) == 0.0).all()


def slow(rng: np.random.Generator, n: int) -> Motion:
    """Plates, rods and cubes close together, each moving about as far as it is thin."""
    half = log_uniform(rng, -2.5, 0.0, (2, n, 3))
    thin = half.min(axis=2)
    share = rng.uniform(0.0, 0.6, (2, n))
    radii = np.linalg.norm(half, axis=2)
    moved = [directions(rng, n) * (s * t)[:, None] for s, t in zip(share, thin, strict=True)]
    angles = rng.uniform(0.0, 0.6, (2, n)) * thin / radii
    first = np.zeros((n, 3))
    second = directions(rng, n) * (rng.uniform(0.0, 1.0, n) * radii.sum(axis=0))[:, None]
    rot = random_rotations(rng, n), random_rotations(rng, n)
    turned = turn(rng, angles[0]), turn(rng, angles[1])
    return motion(
        (first, second), (first + moved[0], second + moved[1]), rot, turned, (half[0], half[1])
    )


def test_what_is_skipped_does_not_pass_through() -> None:
    """Apart at both ends: never deeper than half of both ways, no centre in the other box."""
    n = 6000
    start, end = slow(np.random.default_rng(5), n)
    rows = pair_rows(n)
    skipped = ~sweep_needed(start, end)[rows].any(axis=1)
    course = PoseCourse(start, end)
    apart = (gaps_at(course, rows, np.zeros(n)) > 0.0) & (gaps_at(course, rows, np.ones(n)) > 0.0)
    rows = rows[skipped & apart]
    assert len(rows) > 500
    limit = 0.5 * motion_bounds(start, end)[rows].sum(axis=1)
    thin = start.half_extents.min(axis=1)[rows]
    assert (limit <= thin.max(axis=1)).all()
    slack = 1e-12 * sizes(start[rows[:, 0]], start[rows[:, 1]])
    deepest = np.zeros(len(rows))
    for time in np.linspace(0.0, 1.0, 13):
        deepest = np.maximum(deepest, -gaps_at(course, rows, np.full(len(rows), time)))
    assert (deepest <= limit + slack).all()
    assert (deepest > 0.0).any(), "a test in which nothing grazes would show nothing"
    # a centre inside means a depth of the smallest half extent: the thicker one's never is
    assert (deepest < thin.max(axis=1)).all()


def test_sweeps_are_called_for_by_fast_boxes_only() -> None:
    boxes = Boxes(np.zeros((5, 3)), [np.eye(3)] * 5, [[0.1, 0.2, 0.3]] * 3 + [[0.0, 1.0, 1.0]] * 2)
    moved = Boxes(
        [[0.09, 0.0, 0.0], [0.0, 0.11, 0.0], [0.0] * 3, [0.0] * 3, [0.0, 1e-9, 0.0]],
        boxes.rotations,
        boxes.half_extents,
    )
    assert sweep_needed(boxes, moved).tolist() == [False, True, False, False, True]
    turned = Boxes(boxes.centers, [[[0, -1, 0], [1, 0, 0], [0, 0, 1]]] * 5, boxes.half_extents)
    assert sweep_needed(boxes, turned).all()


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
    near = TOLERANCE_FLOOR * bounding_radii(boxes.half_extents)[1]
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
    turned = Rotation.from_rotvec(np.pi * directions(rng, 400)).as_matrix() @ start.rotations
    end = Boxes(moved.centers, turned, start.half_extents)
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
    first = Rotation.from_matrix(start.rotations.copy())
    turned = (Rotation.from_matrix(end.rotations.copy()) * first.inv()).as_rotvec()
    rotations = (Rotation.from_rotvec(shares[:, None] * turned) * first).as_matrix()
    return Boxes(end.centers, rotations, start.half_extents)


def test_swapping_a_pair_changes_nothing_much() -> None:
    start, end = TURNING["ordinary"](np.random.default_rng(7), 300)
    rows = pair_rows(300)
    found, swapped = sweep(start, end, rows), sweep(start, end, rows[:, ::-1])
    np.testing.assert_array_equal(found.hits, swapped.hits)
    np.testing.assert_allclose(found.times, swapped.times, rtol=0.0, atol=1e-3)
