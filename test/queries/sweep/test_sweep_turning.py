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

"""Sweeps of boxes that turn: none missed, none late, and early by no more than promised.

The truth is sampled densely, with poses by scipy and certified verdicts (`sweep_oracle`).
``--pairs 100000`` spreads that many motions over the families: the long run.
"""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from one_set import sweep, sweep_twists
from scipy.spatial.transform import Rotation
from sweep_motions import TURNING, about_pi, pair_rows
from sweep_oracle import PoseCourse, first_sampled_contact, gaps_at, poses_at

from obb_collision import Boxes
from obb_collision.queries.sweep.motion import bounding_radii
from obb_collision.queries.sweep.rigid import FLOOR
from obb_collision.queries.sweep.sweep import TOLERANCE, Sweeps

CHUNK = 2000


def check_never_late(start: Boxes, end: Boxes, found: Sweeps, rows: np.ndarray) -> int:
    """Assert that a certain overlap is hit and not later than it; return how many there are."""
    truth = first_sampled_contact(PoseCourse(start, end), rows)
    seen = np.isfinite(truth)
    assert found.hits[seen].all()
    assert (found.times[seen] <= truth[seen]).all()
    return int(seen.sum())


def check_nearness(
    start: Boxes, end: Boxes, found: Sweeps, rows: np.ndarray, tolerance: float = TOLERANCE
) -> None:
    """Assert that at the time given the boxes are as near as promised, and the contact theirs."""
    hits = np.flatnonzero(found.hits)
    radii = bounding_radii(start.half_extents)[rows[hits]]
    near = np.maximum(tolerance * radii.min(axis=1), FLOOR * radii.max(axis=1))
    ways = np.abs(end.centers - start.centers)[rows[hits]].sum(axis=(1, 2))
    near += 1e-12 * (ways + np.abs(start.centers)[rows[hits]].sum(axis=(1, 2)))
    assert (gaps_at(PoseCourse(start, end), rows[hits], found.times[hits]) <= near).all()
    np.testing.assert_allclose(np.linalg.norm(found.normals[hits], axis=1), 1.0, atol=1e-14)
    assert np.isnan(found.positions[~found.hits]).all()
    for side in (0, 1):
        box = poses_at(start, end, rows[hits, side], found.times[hits])
        local = np.einsum("nji,nj->ni", box.rotations, found.positions[hits] - box.centers)
        excess = np.abs(local) - box.half_extents
        # of thin boxes that overlap at the start it may be outside of one: see common_point
        reach = 3.0 * near + np.where(found.times[hits] == 0.0, 0.1 * radii.max(axis=1), 0.0)
        assert (excess.max(axis=1) <= reach).all()


@pytest.mark.parametrize("name", TURNING)
def test_none_missed_none_late(name: str, pairs: int) -> None:
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    left, certain, hits, total = max(150, pairs // len(TURNING)), 0, 0, 0
    while left > 0:
        n = min(left, CHUNK)
        start, end = TURNING[name](rng, n)
        rows = pair_rows(n)
        found = sweep(start, end, rows)
        certain += check_never_late(start, end, found, rows)
        check_nearness(start, end, found, rows)
        hits, total, left = hits + int(found.hits.sum()), total + n, left - n
    assert 0.05 * total < certain
    # a hit that no sample confirms is a pass by less than the tolerance: rare but for contacts
    assert hits - certain <= (0.5 if name == "starting in contact" else 0.03) * total
    print(f"{name}: {total} motions, {certain} certain hits, {hits} found")  # noqa: T201


@pytest.mark.parametrize("tolerance", [1e-5, 1e-3, 0.1, 1.0])
def test_any_tolerance_is_kept(tolerance: float) -> None:
    rng = np.random.default_rng(5)
    start, end = TURNING["ordinary"](rng, 200)
    rows = pair_rows(200)
    found = sweep(start, end, rows, tolerance)
    check_never_late(start, end, found, rows)
    check_nearness(start, end, found, rows, tolerance)


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
    assert check_never_late(start, less, sweep(start, less, rows), rows) > 20


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


def test_a_blade_that_turns_several_times_hits_in_the_first_turn() -> None:
    """A quarter of a turn brings the blade, half a metre long, to the post at its side."""
    boxes = Boxes(
        [[0.0, 0.0, 0.0], [0.0, 0.4, 0.0]], [np.eye(3)] * 2, [[0.5, 0.01, 0.01], [0.01] * 3]
    )
    speed = 8.0 * np.pi
    twists = [[0.0, 0.0, 0.0, 0.0, 0.0, speed], [0.0] * 6]
    found = sweep_twists(boxes, twists, [[0, 1]], 3.0)
    # the corner of the post meets the long side of the blade, 0.01 m off its middle line
    corner = np.array([0.01, 0.39])
    angle = np.arctan2(corner[1], corner[0]) - np.arcsin(0.01 / np.linalg.norm(corner))
    assert found.hits[0]
    assert angle / speed - 1e-5 < found.times[0] <= angle / speed
    np.testing.assert_allclose(found.positions[0][:2], corner, atol=1e-4)
