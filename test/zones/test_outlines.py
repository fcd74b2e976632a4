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


"""Outlines about a base that moves by a twist, against tiny steps, and boxes against their points.

The steps move the outline through the world, not points through its frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from each import each
from scipy.spatial.transform import Rotation

from obb_collision.typing import Floats, Mask
from obb_collision.zones import (
    MOST_CORNERS,
    Outline,
    Twist,
    box_outlines,
    count_inside,
    distances_at,
    first_visit,
    meeting_times,
    seen_at,
    time_of_many,
)

SQUARE = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])
SIGNS = np.array([corner[::-1] for corner in product((-1.0, 1.0), repeat=3)])
STEPS = 3000


def cases(count: int) -> Iterator[tuple[np.random.Generator, Outline, Twist, float]]:
    """Yield outlines of all kinds, twists of which any part may be 0, and times (s)."""
    rng = np.random.default_rng(42)
    for number in range(count):
        corners = int(rng.integers(3, 8))
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, corners))
        radii = rng.uniform(0.2, 0.7, corners)
        points = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        outline = Outline(points + rng.normal(0.0, 0.2, 2))
        if number % 3 == 0:
            outline = Outline(np.empty((0, 2)), float(rng.uniform(0.2, 0.6)))
        x, y, turn = (rng.normal(0.0, 1.0, 3) * (rng.random(3) < 0.7)).tolist()
        yield rng, outline, (x, y, turn), float(rng.uniform(0.5, 4.0))


def poses_along(twist: Twist, times: Floats) -> tuple[Floats, Floats]:
    """Return angles (n,) and places (n, 2) of a base, by tiny steps."""
    fine = np.linspace(0.0, times[-1], 20 * len(times) + 1)
    x, y, turn = twist
    cosine, sine = np.cos(turn * fine), np.sin(turn * fine)
    speeds = np.column_stack([x * cosine - y * sine, x * sine + y * cosine])
    steps = 0.5 * (speeds[1:] + speeds[:-1]) * np.diff(fine)[:, None]
    ways = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    places = np.column_stack([np.interp(times, fine, ways[:, k]) for k in range(2)])
    return turn * times, places


def inside(outline: Outline, points: Floats) -> Mask:
    """Return which points (n, 2) are inside, by the angles that corners go round them."""
    corners, radius = outline
    if len(corners) == 0:
        return np.asarray(np.hypot(*points.T) < radius)
    arms = corners[None] - points[:, None]
    angles = np.arctan2(arms[..., 1], arms[..., 0])
    turns = np.diff(angles, axis=1, append=angles[:, :1])
    turns = (turns + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(np.abs(turns.sum(axis=1)) > np.pi)


def to_border(outline: Outline, points: Floats) -> Floats:
    """Return the distances (n,) of points (n, 2) from many points of a border."""
    shares = np.linspace(0.0, 1.0, 20_000, endpoint=False)
    corners, radius = outline
    border = radius * np.column_stack([np.cos(2.0 * np.pi * shares), np.sin(2.0 * np.pi * shares)])
    if len(corners):
        ways = np.roll(corners, -1, axis=0) - corners
        border = (corners[:, None] + shares[:, None] * ways[:, None]).reshape(-1, 2)
    return np.array([np.hypot(*(border - point).T).min() for point in points])


def test_the_time_at_which_enough_points_are_inside_is_exact() -> None:
    reached = 0
    for rng, outline, twist, end in cases(300):
        points = rng.uniform(-2.0, 2.0, (int(rng.integers(1, 12)), 2))
        least = int(rng.integers(1, 3))
        found, rows = time_of_many(points, outline, twist, end, least)
        times = np.linspace(0.0, end, STEPS + 1)
        angles, places = poses_along(twist, times)
        counts = np.zeros(len(times), np.int64)
        for point in points:
            x, y = (point - places).T
            there = np.column_stack(
                [np.cos(angles) * x + np.sin(angles) * y, np.cos(angles) * y - np.sin(angles) * x]
            )
            counts += inside(outline, there)
        first = np.flatnonzero(counts >= least)
        stepped = times[first[0]] if len(first) else math.inf
        assert found <= stepped + 1e-6, "never late"
        if found < math.inf:
            reached += 1
            assert len(rows) >= least
            assert stepped - found < end / STEPS + 1e-6 or stepped == math.inf
            near = np.array([seen_at(x, y, twist, found) for x, y in points[rows].tolist()])
            assert (inside(outline, near) | (to_border(outline, near) < 1e-3)).all(), "not early"
    assert reached > 50


def test_borders_count_and_circles_are_open() -> None:
    border = np.array([[0.5, 0.2], [-0.5, 0.2], [0.2, 0.5], [0.2, -0.5], [0.5, 0.5]])
    rows = np.empty(5, np.bool_)
    assert count_inside(border, SQUARE, 0.0, rows) == 5
    assert count_inside(border * 1.001, SQUARE, 0.0, rows) == 0
    circle = np.array([[0.5, 0.0], [0.0, -0.5], [0.3, -0.4], [np.nextafter(0.5, 0.0), 0.0]])
    assert count_inside(circle, SQUARE[:0], 0.5, rows[:4]) == 1


@each("speed", [1e-3, 1.0, 1e3, 1e9])
@each("turn", [0.0, 1e-300, 1e-12, 1e-6, 1e-3])
def test_slow_turns_and_high_speeds_lose_no_digits(speed: float, turn: float) -> None:
    point = np.array([[1.5, 0.1]])
    for outline in (Outline(SQUARE), Outline(SQUARE[:0], 0.5)):
        border = 0.5 if len(outline.corners) else math.sqrt(0.24)
        expected = (1.5 - border) / speed
        twist = (speed, 0.0, turn * speed)
        found, _ = time_of_many(point, outline, twist, 2.0 * expected, 1)
        bent = expected if turn < 1e-3 else found
        assert found == pytest.approx(bent, rel=1e-5)
        assert abs(found / expected - 1.0) < 1e-3


def test_nav2_rotates_on_the_spot_into_a_point() -> None:
    """In its own test nav2 says 0.80 s, steps of 0.1 s, and the point is reached after 0.807 s."""
    points = np.array([[0.0, 0.55]] * 4)
    footprint = Outline(np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]]))
    found, rows = time_of_many(points, footprint, (0.0, 0.0, 1.0), 2.0, 4)
    assert found == pytest.approx(math.acos(0.5 / 0.55), abs=1e-12)
    assert rows.tolist() == [0, 1, 2, 3]
    assert time_of_many(points, footprint, (0.0, 0.0, 1.0), 2.0, 5)[0] == math.inf


def test_a_mitre_contains_what_is_within_a_margin() -> None:
    rng = np.random.default_rng(1)
    for _, outline, _, _ in cases(60):
        angles, shares = rng.uniform(0.0, 2.0 * np.pi, 200), rng.random(200)
        corners, radius = outline
        start = radius * np.column_stack([np.cos(angles), np.sin(angles)])
        if len(corners):
            side = rng.integers(0, len(corners), 200)
            way = np.roll(corners, -1, axis=0)[side] - corners[side]
            start = corners[side] + shares[:, None] * way
        normals = 0.0999 * np.column_stack([np.cos(angles), np.sin(angles)])
        grown = outline.grown(0.1)
        assert inside(grown, start + normals).all()


def test_boxes_between_heights_meet_the_base_when_their_points_do() -> None:
    reached = 0
    for rng, outline, twist, end in cases(200):
        halves, center = rng.uniform(0.02, 0.6, 3), rng.uniform(-1.5, 1.5, 3)
        axes = Rotation.random(rng=rng).as_matrix()
        low, high = np.sort(rng.uniform(-1.0, 1.0, 2)) if rng.random() < 0.6 else (-np.inf, np.inf)
        sides = rng.uniform(-1.0, 1.0, (8000, 3))
        at_edge = rng.random((8000, 3)) < 0.7
        sides[at_edge] = np.sign(sides[at_edge])
        points = center + (sides * halves) @ axes.T
        points = points[(points[:, 2] >= low) & (points[:, 2] <= high)]
        corners = (center + (SIGNS * halves) @ axes.T)[None]
        out, ends, found = np.empty((MOST_CORNERS, 2)), np.empty(2, np.int64), np.empty(1)
        box_outlines(corners, low, high, out, ends)
        meeting_times(out, ends, *outline, twist, end, found)
        of_points = first_visit(points, *outline, twist, end)
        assert found[0] <= of_points + 1e-9
        if found[0] < math.inf:
            reached += 1
            apart = np.empty(1)
            distances_at(out, ends, *outline, twist, float(found[0]), apart)
            assert apart[0] < 1e-5
    assert reached > 50
