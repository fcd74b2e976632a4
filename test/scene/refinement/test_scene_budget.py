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
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.accuracy import Accuracy
from obb_collision.queries.verdict.verdict import Verdicts
from obb_collision.scene.effects import clearance
from obb_collision.scene.refinement.budget import ABOVE, Budget
from obb_collision.scene.refinement.mesh_pairs import MeshPairs
from obb_collision.typing import Rows

OBB, HULL, MESH = Accuracy.OBB, *ABOVE
ZOO = zoo()
BUDGET = 0.01
#: Seconds a pair takes.
COSTS = {HULL: 4e-6, MESH: 1e-4}


class Ticking:
    """A clock that only deciding pairs of a real scene moves on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        decide = MeshPairs.decide

        def timed(pairs: MeshPairs, level: Accuracy, rows: Rows) -> Verdicts:
            self.now += COSTS[level] * len(rows)
            return decide(pairs, level, rows)

        monkeypatch.setattr(MeshPairs, "decide", timed)

    def clock(self) -> float:
        return self.now


def crowd(count: int, **options: Any) -> tuple[oc.Scene, Any]:
    """Return a scene of rings and boxes, and a function that gives new poses to some."""
    rng = np.random.default_rng(count)
    scene = oc.Scene(accuracy="mesh", **options)
    ring = oc.shapes.Mesh(*ZOO["torus0"])
    for k in range(count):
        scene.add(f"{k}", ring if k % 3 else oc.shapes.Box([0.3, 0.4, 0.5]))

    def move(rows: NDArray[np.int64]) -> None:
        places = rng.uniform(-1.0, 1.0, (len(rows), 3))
        quaternions = Rotation.random(len(rows), rng).as_quat()
        scene.move_indices(rows, np.concatenate([places, quaternions], axis=1))

    move(np.arange(count))
    return scene, move


def test_a_scene_within_its_budget_loses_no_collision(monkeypatch: pytest.MonkeyPatch) -> None:
    ticking = Ticking(monkeypatch)
    scene, move = crowd(60)
    twin, twin_move = crowd(60)
    everything = len(twin.check())
    scene.accuracy = "obb"
    asked = (len(scene.check()) - everything) * COSTS[MESH]
    scene.accuracy = "mesh"
    scene.time_budget = Budget(0.3 * asked, ticking.clock)
    for _ in range(40):
        move(np.arange(60))
        twin_move(np.arange(60))
        start = ticking.now
        report = scene.check()
        assert ticking.now - start <= 0.3 * asked
        assert report.cap is not None
        assert report.accuracies.max() <= report.cap
        assert set(report.names()) >= set(twin.check().names())
    assert report.cap == HULL


def test_a_scene_at_rest_is_refined_until_nothing_is_left_behind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ticking = Ticking(monkeypatch)
    scene, move = crowd(60)
    expected = scene.check()
    scene.time_budget = Budget(20 * COSTS[MESH], ticking.clock)
    scene.padding, scene.padding = 0.5, 0.0  # all count as changed
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

    move(np.arange(2))  # the others stay as they are
    moved = scene.check()
    touched = (moved.pairs < 2).any(axis=1)
    assert (
        moved.accuracies[~touched] == expected.accuracies[(expected.pairs >= 2).all(axis=1)]
    ).all()


def test_effects_are_lowered_where_nothing_collides(monkeypatch: pytest.MonkeyPatch) -> None:
    """What they take counts, and their levels are reported."""
    ticking = Ticking(monkeypatch)
    for level, compute in dict(clearance.BY_LEVEL).items():

        def timed(
            boxes: Any, shapes: Any, pairs: Any, setting: Any,
            level: Accuracy = level, compute: Any = compute,
        ) -> Any:  # fmt: skip
            ticking.now += COSTS[level] * len(pairs)
            return compute(boxes, shapes, pairs, setting)

        monkeypatch.setitem(clearance.BY_LEVEL, level, timed)
    scene = oc.Scene(accuracy="mesh")
    scene.set_effect("clearance", "on", max_distance=100.0)
    ring = oc.shapes.Mesh(*ZOO["torus0"])
    for k in range(10):
        scene.add(f"{k}", ring, [5.0 * k, 0, 0, 0, 0, 0, 1])
    count = len(scene.check().clearances)
    assert count == 45
    assert set(scene.check().accuracies_of("clearance").tolist()) == {MESH}
    budget = 10.0 * count * COSTS[HULL]
    assert budget < count * COSTS[MESH]
    scene.time_budget = Budget(budget, ticking.clock)
    levels, late = [], 0
    for cycle in range(60):
        scene.move("0", [0, 0, 0.01 * (cycle + 1), 0, 0, 0, 1])
        start = ticking.now
        report = scene.check()
        late += ticking.now - start > budget
        levels.append(set(report.accuracies_of("clearance").tolist()))
        assert len(report) == 0
        assert levels[-1] == {report.cap}
    assert levels[10:25] == [{HULL}] * 15
    assert late < 10
    scene.time_budget = 10.0 * count * COSTS[MESH]
    scene.move("0", [0, 0, 0, 0, 0, 0, 1])
    assert set(scene.check().accuracies_of("clearance").tolist()) == {MESH}


def test_a_budget_may_come_and_go(monkeypatch: pytest.MonkeyPatch) -> None:
    ticking = Ticking(monkeypatch)
    scene, _ = crowd(60)
    expected = scene.check()
    assert expected.cap is None
    scene.time_budget = Budget(1e-6, ticking.clock)
    assert scene.time_budget == 1e-6
    scene.padding, scene.padding = 0.5, 0.0  # all count as changed
    assert (scene.check().accuracies == OBB).all()
    scene.time_budget = None
    report = scene.check()
    assert report.names() == expected.names()
    assert report.accuracies.tolist() == expected.accuracies.tolist()
    with pytest.raises(ValueError, match="time_budget"):
        scene.time_budget = -1.0
    with pytest.raises(ValueError, match="time_budget"):
        oc.Scene(time_budget=0.0)


def test_trees_are_built_in_the_time_there_is_or_before(monkeypatch: pytest.MonkeyPatch) -> None:
    ticking = Ticking(monkeypatch)
    scene, _ = crowd(30, time_budget=Budget(1e-9, ticking.clock))
    ticking.now += 1.0  # all the time of this cycle has gone when trees are asked for
    monkeypatch.setattr(Budget, "left", lambda budget: -1.0)
    scene.check()
    assert len(scene._cache) == 0
    scene.prepare()
    assert len(scene._cache) == 4  # the ring and the box, and their hulls
    oc.Scene().prepare()
