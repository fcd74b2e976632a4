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

"""Bounds on motions contain them, and what is skipped as too slow could not pass through."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from support import sizes
from sweep_motions import TURNING, Motion, directions, motion, pair_rows, turn
from sweep_oracle import PoseCourse, gaps_at, poses_at

from obb_collision import Boxes
from obb_collision.queries.sweep.motion import (
    bounding_radii,
    motion_bounds,
    sweep_needed,
    swept_bounds,
    turns_between,
)
from tools.cases.placement import log_uniform, random_rotations

TIMES = np.linspace(0.0, 1.0, 41)


@each("name", TURNING)
def test_swept_bounds_contain_the_motion(name: str) -> None:
    start, end = TURNING[name](np.random.default_rng(1), 100)
    low, high = swept_bounds(start, end)
    rows = np.arange(len(start))
    slack = 1e-14 * (np.abs(start.centers) + np.abs(end.centers) + 1.0)
    for time in TIMES:
        least, most = poses_at(start, end, rows, np.full(len(start), time)).world_bounds()
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
    signs = np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, 8).T
    way, before = np.zeros((len(start), 8)), None
    for time in TIMES:
        boxes = poses_at(start, end, rows, np.full(len(start), time))
        local = boxes.half_extents[:, None] * signs
        corners = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, local)
        if before is not None:
            way += np.linalg.norm(corners - before, axis=2)
        before = corners
    assert (way.max(axis=1) <= bounds).all()


def test_turns_are_those_of_the_poses() -> None:
    start, end = TURNING["spinning blades"](np.random.default_rng(4), 300)
    turned = turns_between(start, end)
    assert (np.linalg.norm(turned, axis=1) <= np.pi * (1.0 + 1e-15)).all()
    again = poses_at(start, end, np.arange(len(start)), np.ones(len(start)))
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
    for time in np.linspace(0.0, 1.0, 25):
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


def test_other_boxes_are_refused() -> None:
    boxes = Boxes(np.zeros((2, 3)), [np.eye(3)] * 2, np.ones((2, 3)))
    grown = Boxes(np.zeros((2, 3)), [np.eye(3)] * 2, [[1.0] * 3, [2.0] * 3])
    for question in (swept_bounds, sweep_needed):
        with pytest.raises(ValueError, match="row 1"):
            question(boxes, grown)
        with pytest.raises(ValueError, match="same length"):
            question(boxes, boxes[np.array([0])])
