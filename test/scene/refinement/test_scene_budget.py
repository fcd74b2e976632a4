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

"""A scene with a time budget: it loses no collision, and gets to the level asked for."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from mesh_zoo import zoo
from numpy.typing import NDArray
from scenes import builds, random_poses

import obb_collision as oc
from obb_collision import Accuracy
from obb_collision.scene.effects import clearance
from obb_collision.scene.refinement import Budget, mesh_pairs

OBB, HULL, MESH = Accuracy.OBB, Accuracy.HULL, Accuracy.MESH
#: Seconds a pair takes.
COSTS = {HULL: 4e-6, MESH: 1e-4}
RING = oc.shapes.Mesh(*zoo()["torus0"])


class Clock:
    """A clock that only deciding pairs of a real scene moves on."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made, decide = Clock(), mesh_pairs.MeshPairs.decide

    def timed(
        pairs: mesh_pairs.MeshPairs, level: Accuracy, rows: NDArray[np.int64]
    ) -> NDArray[np.int8]:
        made.now += COSTS[level] * len(rows)
        return decide(pairs, level, rows)

    monkeypatch.setattr(mesh_pairs.MeshPairs, "decide", timed)
    return made


def crowd(count: int, **options: Any) -> tuple[oc.Scene, Any]:
    """Return a scene of rings and boxes, and a function that gives new poses to the first ones."""
    rng = np.random.default_rng(count)
    scene = oc.Scene(accuracy="mesh", **options)
    for k in range(count):
        scene.add(f"{k}", RING if k % 3 else oc.shapes.Box([0.3, 0.4, 0.5]))

    def move(number: int) -> None:
        scene.move_indices(np.arange(number), random_poses(number, rng, 1.0))

    move(count)
    return scene, move


def change_all(scene: oc.Scene) -> None:
    """Let all objects count as changed."""
    scene.padding, scene.padding = 0.5, 0.0


def test_a_scene_within_its_budget_loses_no_collision(clock: Clock) -> None:
    scene, move = crowd(60)
    twin, twin_move = crowd(60)
    everything = len(twin.check())
    scene.accuracy = "obb"
    asked = (len(scene.check()) - everything) * COSTS[MESH]
    scene.accuracy = "mesh"
    scene.time_budget = Budget(0.3 * asked, clock)
    for _ in range(40):
        move(60)
        twin_move(60)
        start = clock.now
        report = scene.check()
        assert clock.now - start <= 0.3 * asked
        assert report.cap is not None
        assert report.accuracies.max() <= report.cap
        assert set(report.names()) >= set(twin.check().names())
    assert report.cap == HULL


def test_a_scene_at_rest_is_refined_until_nothing_is_left_behind(clock: Clock) -> None:
    scene, move = crowd(60)
    expected = scene.check()
    scene.time_budget = Budget(20 * COSTS[MESH], clock)
    change_all(scene)
    counts, levels = [], []
    for _ in range(100):
        report = scene.check()
        counts.append(len(report))
        levels.append(dict(zip(report.names(), report.accuracies.tolist(), strict=True)))
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > len(expected)
    for before, after in pairwise(levels):
        assert all(after[pair] >= before[pair] for pair in after)
    assert report.names() == expected.names()
    assert report.accuracies.tolist() == expected.accuracies.tolist()
    assert report is scene.check()

    move(2)  # the others stay as they are
    moved = scene.check()
    stayed = moved.accuracies[(moved.pairs >= 2).all(axis=1)]
    assert (stayed == expected.accuracies[(expected.pairs >= 2).all(axis=1)]).all()


def test_effects_are_lowered_where_nothing_collides(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What they take counts, and their levels are reported."""
    for level, compute in dict(clearance.BY_LEVEL).items():

        def timed(*given: Any, level: Accuracy = level, compute: Any = compute) -> Any:
            clock.now += COSTS[level] * len(given[2])
            return compute(*given)

        monkeypatch.setitem(clearance.BY_LEVEL, level, timed)
    scene = oc.Scene(accuracy="mesh")
    scene.set_effect("clearance", "on", max_distance=100.0)
    for k in range(10):
        scene.add(f"{k}", RING, [5.0 * k, 0, 0, 0, 0, 0, 1])
    count = len(scene.check().clearances)
    assert count == 45
    assert set(scene.check().accuracies_of("clearance").tolist()) == {MESH}
    budget = 10.0 * count * COSTS[HULL]
    assert budget < count * COSTS[MESH]
    scene.time_budget = Budget(budget, clock)
    levels, late = [], 0
    for cycle in range(60):
        scene.move("0", [0, 0, 0.01 * (cycle + 1), 0, 0, 0, 1])
        start = clock.now
        report = scene.check()
        late += clock.now - start > budget
        levels.append(set(report.accuracies_of("clearance").tolist()))
        assert len(report) == 0
        assert levels[-1] == {report.cap}
    assert levels[10:25] == [{HULL}] * 15
    assert late < 10
    scene.time_budget = 10.0 * count * COSTS[MESH]
    scene.move("0", [0, 0, 0, 0, 0, 0, 1])
    assert set(scene.check().accuracies_of("clearance").tolist()) == {MESH}


def test_a_budget_may_come_and_go(clock: Clock) -> None:
    scene, _ = crowd(60)
    expected = scene.check()
    assert expected.cap is None
    scene.time_budget = Budget(1e-6, clock)
    assert scene.time_budget == 1e-6
    change_all(scene)
    assert (scene.check().accuracies == OBB).all()
    scene.time_budget = None
    report = scene.check()
    assert report.names() == expected.names()
    assert report.accuracies.tolist() == expected.accuracies.tolist()
    for wrong in (0.0, -1.0, float("nan"), float("inf"), True):
        with pytest.raises(ValueError, match="time_budget"):
            scene.time_budget = wrong
        with pytest.raises(ValueError, match="time_budget"):
            oc.Scene(time_budget=wrong)


def test_trees_are_built_in_the_time_there_is_or_before(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = builds(monkeypatch)
    scene, _ = crowd(30, time_budget=Budget(1e-9, clock))
    clock.now += 1.0  # all the time of this cycle has gone when trees are asked for
    monkeypatch.setattr(Budget, "left", lambda budget: -1.0)
    scene.check()
    assert built == []
    for _ in range(2):
        scene.objects.prepare()
        kinds = sorted(name for name, _ in built)
        assert kinds == ["box_corners", "box_tree", "hull_mesh", "mesh_tree"]
    oc.Scene().objects.prepare()
