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

"""The time budget, on clocks of its own: it holds, the nearest come first, and none is lost."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray
from scenes import builds, random_poses
from support import refused

import obb_collision as oc
from obb_collision import Accuracy
from obb_collision.scene import checker
from obb_collision.scene.effects import clearance
from obb_collision.scene.refinement import mesh_pairs
from obb_collision.scene.refinement.budget import Budget, refine

OBB, HULL, MESH = Accuracy.OBB, Accuracy.HULL, Accuracy.MESH
SEPARATE, TOUCHING = oc.Verdict.SEPARATE, oc.Verdict.TOUCHING
BUDGET = 0.01
#: Seconds a pair takes.
COSTS = {HULL: 4e-6, MESH: 1e-4}


class World:
    """Pairs that collide up to a level each, and a clock that deciding them moves on.

    levels (m,): the last level that reports a pair; order (m,): nearest first; noise: of the times;
    call: seconds that each call takes; before, after: that a cycle takes besides its pairs.
    """

    call, before, after = 1e-4, 1e-3, 5e-4

    def __init__(self, count: int, noise: float = 0.0, seconds: float = BUDGET) -> None:
        self.rng = np.random.default_rng(count)
        self.levels = self.rng.choice([OBB, HULL, MESH], count)
        self.order = self.rng.permutation(count)
        self.noise = noise
        self.now = 0.0
        self.costs = dict(COSTS)
        self.calls = 0
        self.budget = Budget(seconds, lambda: self.now)
        self.known = np.full(count, OBB, np.int8), np.full(count, TOUCHING, np.int8)

    def spend(self, seconds: float) -> None:
        self.now += seconds * self.rng.lognormal(0.0, self.noise)

    def prepare(self, level: Accuracy, rows: Any, budget: Budget | None) -> NDArray[np.bool_]:
        return np.ones(len(rows), np.bool_)

    def decide(self, level: Accuracy, rows: NDArray[np.int64]) -> NDArray[np.int8]:
        self.spend(self.call + self.costs[level] * len(rows))
        self.calls += 1
        return np.where(self.levels[rows] >= level, TOUCHING, SEPARATE).astype(np.int8)

    def go_on(self, asked: NDArray[np.int8]) -> float:
        """Run a cycle in which nothing has changed; return the seconds that it took."""
        levels, verdicts = self.known
        start = self.now
        self.budget.start()
        self.spend(self.before)
        waiting = self.order[(levels < asked)[self.order]]
        rows = np.sort(waiting)
        state = levels[rows], verdicts[rows]
        part, self.levels = self.levels, self.levels[rows]
        refine(self, asked[rows], *state, self.budget, np.searchsorted(rows, waiting))
        self.levels = part
        levels[rows], verdicts[rows] = state
        self.spend(self.after)
        self.budget.finish()
        assert ((verdicts != SEPARATE) == (self.levels >= levels)).all()  # no collision is lost
        assert ((levels == asked) | (levels == OBB)).all()
        return self.now - start

    def cycle(self, asked: NDArray[np.int8]) -> float:
        """Run a cycle in which all has changed; return the seconds that it took."""
        for column, value in zip(self.known, (OBB, TOUCHING), strict=True):
            column[:] = value
        return self.go_on(asked)


def mixed(count: int) -> NDArray[np.int8]:
    return np.where(np.arange(count) % 4 == 0, HULL, MESH).astype(np.int8)


def test_without_a_budget_or_where_all_fits_pairs_are_decided_on_the_level_asked_for() -> None:
    world, asked = World(50), mixed(50)
    assert world.cycle(asked) <= BUDGET
    assert (world.known[0] == asked).all()
    levels, verdicts = np.full(50, OBB, np.int8), np.full(50, TOUCHING, np.int8)
    world.calls = 0
    refine(world, asked, levels, verdicts)
    assert (levels == asked).all()
    assert (verdicts == world.known[1]).all()
    assert world.calls == 2


@each("noise, after", [(0.0, 5e-4), (0.1, 5e-4), (0.3, 5e-4), (0.1, 3e-3)])
def test_a_scene_that_takes_ten_times_the_budget_keeps_it(noise: float, after: float) -> None:
    world, asked = World(1000, noise), mixed(1000)
    world.after = after
    used = [world.cycle(asked) for _ in range(200)][2:]  # until it is known what comes after
    assert np.mean(np.array(used) <= BUDGET) >= 0.95
    assert max(used) <= 1.5 * BUDGET
    assert np.mean(used) >= 0.7 * BUDGET  # which is used
    done = (world.known[0] == asked)[world.order]
    assert done.any()
    assert (done[:-1] >= done[1:]).all()  # nearest first
    assert world.calls <= 200 * 2 * 12


@each("factor", [1.0, 1.9])
def test_pairs_that_get_dearer_on_the_way_are_left_in_time(factor: float) -> None:
    world, asked = World(1000), np.full(1000, MESH, np.int8)
    decide = world.decide

    def dearer(level: Accuracy, rows: NDArray[np.int64]) -> NDArray[np.int8]:
        found = decide(level, rows)
        world.costs[level] *= factor  # with each call
        return found

    world.decide = dearer  # type: ignore[method-assign]
    assert world.cycle(asked) <= BUDGET


def test_one_pair_is_the_most_that_a_cycle_can_be_late_by() -> None:
    world, asked = World(20), np.full(20, MESH, np.int8)
    world.costs[MESH] = 3.0 * BUDGET
    for done in range(1, 21):
        assert world.go_on(asked) <= 4.5 * BUDGET
        assert (world.known[0] == MESH).sum() == done


def test_an_accident_is_forgotten() -> None:
    world, asked = World(1000), mixed(1000)
    for _ in range(3):
        world.cycle(asked)
    usual = (world.known[0] == asked).sum()
    world.after, after = 10.0, world.after
    world.cycle(asked)
    world.after = after
    world.cycle(asked)
    assert (world.known[0] == asked).sum() == usual


def test_too_little_time_leaves_all_on_obb() -> None:
    world, asked = World(1000, seconds=1e-3), mixed(1000)
    world.cycle(asked)
    assert (world.known[0] == OBB).all()
    assert world.calls == 0
    world.budget.seconds = BUDGET
    world.cycle(asked)
    assert (world.known[0] > OBB).any()


def test_what_is_left_is_refined_in_the_cycles_to_come() -> None:
    world, asked, done = World(1000), np.full(1000, MESH, np.int8), [0]
    while done[-1] < 1000:
        assert world.go_on(asked) <= BUDGET
        done.append(int((world.known[0] == MESH).sum()))
        assert done[-1] > done[-2]
    assert 10 <= len(done) <= 20
    assert ((world.known[1] != SEPARATE) == (world.levels == MESH)).all()


RING = oc.shapes.Mesh(*zoo()["torus0"])


class Clock:
    """A clock that only deciding pairs of a real scene moves on."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made, decide = Clock(), mesh_pairs.MeshPairs.decide

    def timed(pairs: Any, level: Accuracy, rows: NDArray[np.int64]) -> NDArray[np.int8]:
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
        assert 0.5 * 0.3 * asked <= clock.now - start <= 0.3 * asked
        assert report.behind
        assert set(report.names()) >= set(twin.check().names())
        assert len(set(report.accuracies.tolist())) > 1


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


@pytest.fixture
def slow(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Return the clock, which clearances move on, too."""
    for level, compute in dict(clearance.BY_LEVEL).items():

        def timed(*given: Any, level: Accuracy = level, compute: Any = compute) -> Any:
            clock.now += COSTS[level] * len(given[2])
            return compute(*given)

        monkeypatch.setitem(clearance.BY_LEVEL, level, timed)
    return clock


def row_of_rings(**options: Any) -> oc.Scene:
    """Return rings that are apart, with clearances."""
    scene = oc.Scene(accuracy="mesh")
    scene.set_effect("clearance", "on", max_distance=100.0, **options)
    for k in range(10):
        scene.add(f"{k}", RING, [5.0 * k, 0, 0, 0, 0, 0, 1])
    return scene


def test_effects_alone_are_lowered(slow: Clock) -> None:
    """The nearest pairs come first, and the report says which."""
    scene, whole = row_of_rings(), row_of_rings().check().clearances
    budget = 0.5 * len(whole) * COSTS[MESH]
    scene.time_budget = Budget(budget, slow)
    for cycle in range(20):
        scene.move("0", [0, 0, 1e-9 * (cycle + 1), 0, 0, 0, 1])
        start = slow.now
        report = scene.check()
        assert slow.now - start <= budget
        assert report.behind
        assert len(report) == 0
        found, levels = report.clearances, report.accuracies_of("clearance")
        assert (levels == MESH).sum() >= 10
        assert set(levels.tolist()) == {OBB, MESH}
        assert (found.distances[levels == OBB] < whole.distances[levels == OBB] - 1e-6).all()
        assert found.distances[levels == MESH] == pytest.approx(whole.distances[levels == MESH])
        steps = np.diff(found.pairs, axis=1)[:, 0]
        assert steps[levels == MESH].max() <= steps[levels == OBB].min()
    scene.time_budget = 1.0
    assert set(scene.check().accuracies_of("clearance").tolist()) == {MESH}  # though nothing moves
    assert not scene.check().behind


def test_an_effect_with_an_accuracy_of_its_own_is_not_lowered(slow: Clock) -> None:
    scene = row_of_rings(accuracy="mesh")
    scene.time_budget = Budget(COSTS[MESH], slow)
    report = scene.check()
    assert set(report.accuracies_of("clearance").tolist()) == {MESH}
    assert not report.behind


@each("effect", [False, True])
@each("limit", [None, 5])
def test_a_report_that_is_kept_is_on_the_levels_asked_for(
    effect: bool, limit: int | None, slow: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a slow check of what then stands still there is all the time that is needed."""
    scene = row_of_rings() if effect else crowd(20)[0]
    scene.time_budget, scene.max_pairs = Budget(1.0, slow), limit
    with monkeypatch.context() as others:  # which have the processor meanwhile
        others.setattr(
            checker.Checker, "settle_region", lambda _: setattr(slow, "now", slow.now + 2.0)
        )
        first = scene.check()
    assert effect or OBB in first.accuracies.tolist()
    assert not effect or set(first.accuracies_of("clearance").tolist()) == {OBB}
    for _ in range(3):
        report = scene.check()
    expected = row_of_rings() if effect else crowd(20)[0]
    expected.max_pairs = limit
    wanted = expected.check()
    assert report.names() == wanted.names()
    assert report.accuracies.tolist() == wanted.accuracies.tolist()
    if effect:
        levels = (one.accuracies_of("clearance").tolist() for one in (report, wanted))
        assert len(set(map(tuple, levels))) == 1
    assert not report.behind
    assert report is scene.check()


def test_a_budget_may_come_and_go(clock: Clock) -> None:
    scene, _ = crowd(60)
    expected = scene.check()
    scene.time_budget = Budget(1e-6, clock)
    assert scene.time_budget == 1e-6
    change_all(scene)
    late = scene.check()
    assert set(late.names()) > set(expected.names())
    assert late.behind
    scene.time_budget = None
    report = scene.check()
    assert report.names() == expected.names()
    assert report.accuracies.tolist() == expected.accuracies.tolist()
    for wrong in (0.0, -1.0, float("nan"), float("inf"), True):
        refused("time_budget", setattr, scene, "time_budget", wrong)
        refused("time_budget", oc.Scene, time_budget=wrong)


def test_trees_are_built_in_time_or_before(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
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
