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

"""Patches of contacts stay put under noise, and move with the boxes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from contact_pairs import CUBE, colliding, turned
from each import each
from one_set import contacts
from support import joined, sizes, stored

from obb_collision import Boxes
from obb_collision.typing import Floats
from tools.cases.placement import turns

#: Noise on poses: metres and radians.
NOISE = 1e-9


def stack(yaw: float, depth: float, base: Floats) -> tuple[Floats, Floats, Floats]:
    """Ten cubes of 1 m on top of each other, each turned by ``yaw`` degrees more than the last."""
    heights = np.arange(10) * (1.0 - depth)
    rotations = turns(np.tile([0.0, 0.0, 1.0], (10, 1)), np.radians(yaw) * np.arange(10))
    centers = np.stack([0.0 * heights, 0.0 * heights, heights], axis=1)
    return centers @ base.T, base @ rotations, np.full((10, 3), 0.5)


BASES = {"upright": np.eye(3), "tilted": turned([1.0, 2.0, -0.5], 40.0)}
STACK_PAIRS = np.stack([np.arange(9), np.arange(1, 10)], axis=1)


def noisy(boxes: tuple[Floats, Floats, Floats], rng: np.random.Generator) -> Boxes:
    centers, rotations, half = boxes
    turn = rng.normal(size=centers.shape)
    small = turns(turn, rng.uniform(-NOISE, NOISE, len(centers)))
    return Boxes(centers + rng.uniform(-NOISE, NOISE, centers.shape), small @ rotations, half)


@each("limit", [4, 8])
@each("yaw", [0.0, 30.0, 45.0, 90.0, 17.0])
@each("depth", [1e-6, 1e-3, 0.05])
@each("base", BASES)
def test_a_resting_stack_stays_under_noise(base: str, depth: float, yaw: float, limit: int) -> None:
    """Points keep their order and their places, to ten times the noise."""
    boxes = stack(yaw, depth, BASES[base])
    resting = contacts(Boxes(*boxes), STACK_PAIRS, limit)
    assert (resting.counts == (limit if yaw % 90.0 else 4)).all()
    rng = np.random.default_rng(5)
    for _ in range(100):
        found = contacts(noisy(boxes, rng), STACK_PAIRS, limit)
        np.testing.assert_array_equal(found.counts, resting.counts)
        moved = np.linalg.norm(found.positions - resting.positions, axis=2)
        assert np.nanmax(moved) <= 10.0 * NOISE
        assert np.abs(found.depths - resting.depths).max() <= 10.0 * NOISE
        assert np.abs(found.normals - resting.normals).max() <= 10.0 * NOISE


@each("limit", [4, 8])
@each("angle", [1e-6, 1e-4, 1e-2])
def test_edges_that_cross_at_a_small_angle_give_no_loose_points(angle: float, limit: int) -> None:
    """Where they cross moves a hundred to a million times as far as they do: no place for one."""
    boxes = stack(np.degrees(angle), 1e-3, BASES["tilted"])
    resting = contacts(Boxes(*boxes), STACK_PAIRS, limit)
    rng = np.random.default_rng(8)
    for _ in range(50):
        found = contacts(noisy(boxes, rng), STACK_PAIRS, limit)
        np.testing.assert_array_equal(found.counts, 4)
        assert (
            np.nanmax(np.linalg.norm(found.positions - resting.positions, axis=2)) <= 10.0 * NOISE
        )


def test_faces_that_lean_alike_do_not_take_turns() -> None:
    """An edge sunk into a wall hardly wider: both faces beside it face the wall equally."""
    wall, cube = [0.03, 1.0, 1.0], [0.5] * 3
    centers = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0 + np.sqrt(0.5) - 0.05]])
    rotations = np.array([np.eye(3), turned([0, 1, 0], 45)])
    boxes = (centers, rotations, np.array([wall, cube]))
    resting = contacts(Boxes(*boxes), [[0, 1]])
    rng = np.random.default_rng(9)
    for _ in range(50):
        found = contacts(noisy(boxes, rng), [[0, 1]])
        assert np.nanmax(np.abs(found.positions - resting.positions)) <= 10.0 * NOISE


@pytest.mark.parametrize("yaw", [0.0, 45.0])
@pytest.mark.parametrize("base", BASES)
def test_a_thousand_identical_frames_are_identical(base: str, yaw: float) -> None:
    boxes = stack(yaw, 1e-3, BASES[base])
    first = contacts(Boxes(*boxes), STACK_PAIRS)
    for _ in range(1000):
        again = contacts(Boxes(*boxes), STACK_PAIRS)
        np.testing.assert_array_equal(again.positions, first.positions)
        np.testing.assert_array_equal(again.position_depths, first.position_depths)


@pytest.mark.parametrize("limit", [4, 8])
@pytest.mark.parametrize("name", ["ordinary scene", "each of the 15 axes alone"])
def test_points_of_any_pair_stay_under_noise(name: str, limit: int) -> None:
    """However they overlap: each point has one of before nearby, moved with both its boxes."""
    a, b = colliding(name, 3000)
    boxes, rows = joined(a, b)
    before = contacts(boxes, rows, limit)
    after = contacts(noisy(stored(boxes), np.random.default_rng(7)), rows, limit)
    np.testing.assert_array_equal(after.counts, before.counts)
    apart = np.linalg.norm(after.positions[:, :, None] - before.positions[:, None], axis=3)
    nearest = np.where(np.isnan(apart), np.inf, apart).min(axis=2)
    used = np.arange(limit) < after.counts[:, None]
    moved = 2.0 * NOISE * (1.0 + sizes(a, b))  # two boxes shift, and turn about their centres
    assert (nearest <= 10.0 * moved[:, None])[used].all()


@pytest.mark.parametrize("yaw", [0.0, 30.0, 45.0])
def test_boxes_that_only_just_touch_lose_points_but_move_none(yaw: float) -> None:
    boxes = stack(yaw, 0.0, BASES["upright"])
    resting = contacts(Boxes(*boxes), STACK_PAIRS)
    rng = np.random.default_rng(6)
    for _ in range(200):
        found = contacts(noisy(boxes, rng), STACK_PAIRS)
        for row, count in enumerate(found.counts):
            apart = found.positions[row, :count, None] - resting.positions[row, None]
            nearest = np.linalg.norm(apart, axis=2).min(axis=1)
            assert (nearest <= 10.0 * NOISE).all()


LEAN = turned([1, 1, 0], 1)
#: Small boxes in motion on a large one: 0 to 1 is a movement of about a metre or a radian.
PATHS: dict[str, Callable[[float], tuple[list[float], Floats]]] = {
    "slides off": lambda t: ([0.5 + t, 0.1, 1.24], turned([0, 0, 1], 20)),
    "turns": lambda t: ([0.9, 0.1, 1.24], turned([0, 0, 1], 10 + 57 * t)),
    "leans": lambda t: ([0.5, 0.1, 1.24], turned([1, 0.4, 0], 1 + 10 * t) @ LEAN),
    "sinks": lambda t: ([0.8, 0.1, 1.24 - 0.2 * t], LEAN @ turned([0, 0, 1], 25)),
}


@pytest.mark.parametrize("name", PATHS)
def test_small_motion_moves_points_a_little(name: str) -> None:
    """Points that stay in contact move with the boxes; those that come or go have no depth.

    Of a patch with more corners than points, those least needed change places: with eight
    points nothing is left out.
    """
    steps = 2000
    places = [PATHS[name](t) for t in np.linspace(0.0, 1.0, steps)]
    boxes = Boxes(
        [CUBE[0], *(center for center, _ in places)],
        [CUBE[1], *(rotation for _, rotation in places)],
        [CUBE[2], *([[0.3, 0.2, 0.25]] * steps)],
    )
    found = contacts(boxes, np.stack([np.zeros(steps, int), 1 + np.arange(steps)], axis=1), 8)
    jumps = []
    for row in range(1, steps):
        if found.counts[row] == 0 or found.axes[row] != found.axes[row - 1]:
            continue
        now, before = (found.positions[k, : found.counts[k]] for k in (row, row - 1))
        apart = np.linalg.norm(now[:, None] - before[None], axis=2).min(axis=1)
        shallow = found.position_depths[row, : len(now)] <= 5.0 / steps
        jumps += [row] * int(((apart > 5.0 / steps) & ~shallow).sum())
    assert jumps == []
