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

"""Step after step: whichever way a check takes, it finds what a new scene does; no memory leaks."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from each import each
from scenes import random_poses

import obb_collision as oc
from obb_collision.scene import checker

#: Steps of which the memory is measured, several times: what grows does so each time, which caches
#: that fill and other threads do not.
STEPS, TIMES = 200, 6
COLUMNS = ("pairs", "verdicts", "accuracies", "separations", "normals", "positions")


def boxes_at(poses: np.ndarray, exact: bool = False, seed: int = 0) -> oc.Scene:
    """Return boxes of sizes that depend on the seed alone, some of which rest on one another."""
    scene = oc.Scene(exact=exact)
    sizes = np.random.default_rng(seed).choice([0.0, 0.25, 0.5, 0.7, 1.1], (len(poses), 3))
    scene.add_boxes([f"box/{k}" for k in range(len(poses))], sizes, poses)
    return scene


def some_poses(count: int, rng: np.random.Generator, spread: float) -> np.ndarray:
    """Return poses, some on a grid, where boxes touch, and quaternions not quite of length 1."""
    poses = random_poses(count, rng, spread)
    resting = rng.random(count) < 0.4
    poses[resting, :3] = np.round(poses[resting, :3], 1)
    poses[resting, 3:] = 0.0, 0.0, 0.0, 1.0
    poses[:, 3:] *= rng.choice([1.0, 0.95, 1.05], (count, 1))
    return poses


@each("exact", [False, True])
@each("count", [2, 63, 64, 65, 300])
def test_every_step_finds_what_a_new_scene_does(count: int, exact: bool) -> None:
    rng = np.random.default_rng(count)
    spread = 0.5 * count ** (1 / 3)
    poses = some_poses(count, rng, spread)
    scene = boxes_at(poses, exact)
    scene.set_effect("separations", "on")
    for step in range(24):
        share = (1.0, 0.5, 0.02, 0.02)[step % 4]
        moved = rng.random(count) < share
        moved[rng.integers(count)] = True
        poses[moved] = some_poses(int(moved.sum()), rng, spread)
        scene.move_indices(np.flatnonzero(moved), poses[moved])
        if step % 6 == 5:
            poses[0, :3] += 10.0
            scene.move("box/0", poses[0])  # after others, before the check
        if step == 12:
            scene.allow("box/1*", "box/2*")
        report, fresh = scene.check(), boxes_at(poses, exact)
        fresh.rules.allowed = scene.rules.allowed
        for name in COLUMNS:
            found, wanted = getattr(report, name), getattr(fresh.check(), name)
            assert found.tobytes() == wanted.tobytes(), (step, name)
    assert len(report) or count == 2


def test_boxes_are_where_poses_say_for_any_number_of_threads() -> None:
    rng = np.random.default_rng(5)
    count = 5_000
    poses = some_poses(count, rng, 9.0)
    expected = oc.Boxes.from_poses(poses, np.zeros((count, 3)))
    try:
        for number in (1, 3):
            oc.set_threads(number)
            scene = boxes_at(np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (count, 1)))
            scene.move_indices(np.arange(count), poses)
            found = scene.boxes
            assert (found.centers == expected.centers).all()
            assert (found.rotations == expected.rotations).all()
    finally:
        oc.set_threads(None)


def test_effects_have_the_same_bits_for_any_number_of_threads() -> None:
    rng = np.random.default_rng(10)
    start, end = some_poses(900, rng, 4.0), some_poses(900, rng, 4.0)
    seen = []
    try:
        for number in (1, 2, 5):
            oc.set_threads(number)
            scene = boxes_at(start)
            scene.objects.set_twists(scene.indices, np.ones((900, 6)))
            scene.check("sweep")
            scene.move_indices(scene.indices, end)
            report = scene.check(("separations", "contacts", "clearance", "sweep"))
            assert len(report) > 500
            swept = (report.swept.passed, report.swept.predicted)
            tables = (report.result("separations"), report.contacts, report.clearances, *swept)
            assert all(len(table) > 100 for table in tables)
            seen.append([column.tobytes() for table in tables for column in vars(table).values()])
    finally:
        oc.set_threads(None)
    assert seen[0] == seen[1] == seen[2]


def test_what_nothing_has_changed_about_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    find = checker.Checker.find

    def counted(*arguments: Any) -> Any:
        calls.append(1)
        return find(*arguments)

    monkeypatch.setattr(checker.Checker, "find", counted)
    scene = boxes_at(some_poses(300, np.random.default_rng(9), 3.0))
    scene.check("contacts")
    for _ in range(5):  # nobody holds the report before
        report = scene.check("contacts")
        assert report.costs["contacts"].count == 0, "nor is the effect computed again"
        assert len(report.contacts) == len(report) > 0
        assert report.names() == boxes_at(scene.objects.poses_of(scene.indices)).check().names()
    assert len(calls) == 6
    scene.set_effect("contacts", max_points=8)
    assert scene.check("contacts").costs["contacts"].count == len(report)


def steps_of(count: int, share: float, effects: tuple[str, ...]) -> Callable[[int], None]:
    """Return what makes so many steps, with the report before in use while objects move.

    Where none moves, it is not in use at the next check.
    """
    rng = np.random.default_rng(count)
    frames = [random_poses(count, rng, 0.5 * count ** (1 / 3)) for _ in range(4)]
    scene = boxes_at(frames[0])
    moved = np.flatnonzero(rng.random(count) < share)
    reports = [scene.check(effects)]

    def run(steps: int) -> None:
        for step in range(steps):
            scene.move_indices(moved, frames[step % 4][moved])
            if len(moved) == 0:
                reports.clear()
            reports[:] = [scene.check(effects)]

    return run


@each("effects", [(), ("separations", "contacts")])
@each("share", [1.0, 0.05, 0.0])
@each("count", [20, 600])
def test_memory_does_not_grow_with_the_steps(
    count: int, share: float, effects: tuple[str, ...]
) -> None:
    run = steps_of(count, share, effects)
    run(40)  # what the first steps allocate for good
    gc.collect()
    tracemalloc.start()
    try:
        sizes = []
        run(5 * STEPS)  # replaces what was there before it was traced
        for _ in range(1 + TIMES):
            run(STEPS)
            gc.collect()
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    grown = min(np.diff(sizes))
    assert grown < STEPS * 32, f"{grown / STEPS} bytes a step: less than any object takes"
