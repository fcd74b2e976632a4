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

"""The time budget, on a clock of its own: it holds, it settles, and no collision is lost by it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.queries.verdict.verdict import SEPARATE, TOUCHING, Verdicts
from obb_collision.scene.refinement.budget import ABOVE, SETTLING, WAIT, Budget
from obb_collision.scene.refinement.refine import refine
from obb_collision.typing import Rows

OBB, HULL, MESH = Accuracy.OBB, *ABOVE
ZOO = zoo()
BUDGET = 0.01
#: Seconds a pair takes.
COSTS = {HULL: 4e-6, MESH: 1e-4}


class World:
    """Pairs that collide up to a level each, and a clock that deciding them moves on.

    levels (m,): the last level that reports a pair; noise: of the times; spikes: share of the
    calls in which somebody else has the processor for 3 ms; slow: how many times as long all takes;
    shared: seconds that the first call of a cycle takes, call: seconds that each call for pairs
    does.
    """

    shared, call, slow = 0.0, 0.0, 1.0

    def __init__(self, count: int, noise: float = 0.0, spikes: float = 0.0) -> None:
        self.rng = np.random.default_rng([count, 1])
        self.levels = self.rng.choice([OBB, *ABOVE], count)
        self.noise, self.spikes = noise, spikes
        self.now = 0.0
        self.costs = dict(COSTS)
        self.before, self.after = 1e-3, 5e-4
        self.began = False
        self.decided: list[tuple[Accuracy, int]] = []

    def clock(self) -> float:
        return self.now

    def spend(self, seconds: float) -> None:
        self.now += self.slow * seconds * self.rng.lognormal(0.0, self.noise)
        self.now += 3e-3 * (self.rng.random() < self.spikes)

    def prepare(self, level: Accuracy, rows: Rows, budget: Budget | None) -> NDArray[np.bool_]:
        return np.ones(len(rows), np.bool_)

    def decide(self, level: Accuracy, rows: Rows) -> Verdicts:
        self.spend(2e-5 + self.costs[level] * len(rows))
        if len(rows):
            self.spend(self.call + (0.0 if self.began else self.shared))
            self.began = True
        self.decided.append((level, len(rows)))
        return np.where(self.levels[rows] >= level, TOUCHING, SEPARATE).astype(np.int8)

    def cycle(self, budget: Budget | None, asked: Accuracy = MESH) -> NDArray[np.int8]:
        """Run one cycle and return the levels, having checked that no collision is lost."""
        count = len(self.levels)
        levels, verdicts = np.full(count, OBB, np.int8), np.full(count, TOUCHING, np.int8)
        if budget is not None:
            budget.start()
        self.began = False
        self.spend(self.before)
        refine(
            self,
            np.full(count, asked, np.int8),
            np.zeros(count, np.bool_),
            levels,
            verdicts,
            budget,
        )
        self.spend(self.after)
        if budget is not None:
            budget.finish()
        assert ((verdicts != SEPARATE) == (self.levels >= levels)).all()
        assert (levels <= asked).all()
        return levels


def changes(caps: list[Accuracy]) -> int:
    return sum(a != b for a, b in pairwise(caps))


def test_without_a_budget_every_pair_is_decided_on_the_level_it_asks_for() -> None:
    world = World(1000)
    for asked in ABOVE:
        assert (world.cycle(None, asked) == asked).all()


def test_what_fits_is_decided_on_the_level_asked_for_from_the_start() -> None:
    world = World(50)
    budget = Budget(BUDGET, world.clock)
    for _ in range(50):
        assert (world.cycle(budget) == MESH).all()
    assert world.cycle(budget, HULL).tolist() == [HULL] * 50


@each("noise", [0.0, 0.1, 0.3])
def test_a_scene_that_takes_ten_times_the_budget_keeps_it(noise: float) -> None:
    world = World(1000, noise, spikes=0.01)
    assert COSTS[MESH] * len(world.levels) == 10.0 * BUDGET
    budget = Budget(BUDGET, world.clock)
    used, caps, levels = [], [], []
    for _ in range(500):
        levels.append(world.cycle(budget))
        used.append(budget.used)
        caps.append(budget.cap)
    assert np.mean(np.array(used) <= BUDGET) >= 0.95
    assert changes(caps[SETTLING:]) == 0
    assert caps[-1] == HULL
    assert np.mean([(level == HULL).all() for level in levels]) >= 0.95


@each("share", [0.7, 0.85, 1.0])
@each("noise", [0.05, 0.3])
def test_a_level_that_just_fits_or_just_not_makes_nothing_flicker(
    share: float, noise: float
) -> None:
    world = World(100, noise)
    world.costs[MESH] = share * BUDGET / 100
    budget = Budget(BUDGET, world.clock)
    caps, used = [], []
    for _ in range(4000):
        world.costs[MESH] *= world.rng.lognormal(0.0, 0.02)  # wanders: things move
        world.costs[MESH] += 0.1 * (share * BUDGET / 100 - world.costs[MESH])
        world.cycle(budget)
        caps.append(budget.cap)
        used.append(budget.used)
    assert changes(caps[SETTLING:]) <= 8
    assert changes(caps[2000:]) <= 2
    assert np.mean(np.array(used) <= BUDGET) >= 0.95


def test_the_cap_falls_at_once_and_rises_after_a_while() -> None:
    world = World(1000, noise=0.1)
    budget = Budget(BUDGET, world.clock)
    for _ in range(50):
        world.cycle(budget)
    assert budget.cap == HULL
    everything = world.levels
    world.levels = everything[:30]  # most have gone
    caps = []
    for _ in range(WAIT + 1):
        world.cycle(budget)
        caps.append(budget.cap)
    assert caps == sorted(caps)
    assert caps[-1] == MESH
    world.levels = everything
    world.cycle(budget)
    assert budget.cap == HULL
    assert budget.used <= BUDGET


def test_pairs_that_get_cheaper_are_noticed_though_the_level_is_not_in_use() -> None:
    world = World(1000, noise=0.1)
    budget = Budget(BUDGET, world.clock)
    for _ in range(20):
        world.cycle(budget)
    assert budget.cap == HULL
    world.costs[MESH] = 2e-6
    for _ in range(200):
        world.cycle(budget)
    assert budget.cap == MESH


def test_pairs_that_get_dearer_are_left_behind_always_the_same_ones() -> None:
    world = World(45)
    budget = Budget(BUDGET, world.clock)
    for _ in range(20):
        assert (world.cycle(budget) == MESH).all()
    world.costs[MESH] *= 3.0
    first = world.cycle(budget)
    assert budget.used <= BUDGET
    left = np.flatnonzero(first == OBB)
    assert left[0] > 0
    assert left.tolist() == list(range(left[0], 45))
    assert budget.cap == MESH  # one cycle may be an accident
    for _ in range(10):
        world.cycle(budget)
    assert budget.cap == HULL
    assert (world.cycle(budget) == HULL).all()


def busy(world: World, count: int) -> World:
    """Return a world of so many pairs in which calls take as long as those of real scenes."""
    world.shared, world.call = 3e-4, 1e-4
    world.levels = world.levels[:count]
    return world


@each("noise", [0.0, 0.3])
@each("slow", [2.0, 20.0, 1000.0])
@each("cycles", [1, 5, 20, 200])
def test_a_slow_start_is_forgotten(cycles: int, slow: float, noise: float) -> None:
    world = busy(World(1000, noise), 400)
    budget = Budget(0.6 * BUDGET, world.clock)
    world.slow = slow
    for _ in range(cycles):
        world.cycle(budget)
    world.slow = 1.0
    for _ in range(250):
        world.cycle(budget)
    used, levels = [], []
    for _ in range(200):
        levels.append(world.cycle(budget))
        used.append(budget.used)
    assert np.mean([(level == HULL).all() for level in levels]) >= 0.95
    assert np.mean(np.array(used) <= 0.6 * BUDGET) >= 0.95


@each("slow", [5.0, 100.0])
@each("cycles", [1, 10, 100])
def test_the_level_is_found_again_after_a_slow_time(cycles: int, slow: float) -> None:
    world = busy(World(1000, 0.2, spikes=0.002), 400)
    budget = Budget(0.6 * BUDGET, world.clock)
    for _ in range(100):
        world.cycle(budget)
    assert budget.cap == HULL
    for _ in range(3):
        world.slow = slow
        for _ in range(cycles):
            world.cycle(budget)
        world.slow = 1.0
        for _ in range(400):
            world.cycle(budget)
        assert budget.cap == HULL


@each("spikes", [0.005, 0.01, 0.02])  # of some 20 times a cycle
def test_others_that_take_the_processor_again_and_again_do_not_keep_from_the_level(
    spikes: float,
) -> None:
    world = busy(World(1000, 0.2, spikes), 400)
    budget = Budget(0.8 * BUDGET, world.clock)
    caps = []
    for _ in range(600):
        world.cycle(budget)
        caps.append(budget.cap)
    assert caps[150:].count(HULL) >= 0.9 * len(caps[150:])


def test_few_pairs_in_a_call_do_not_seem_to_cost_more_than_many() -> None:
    world = busy(World(1000, noise=0.1), 400)
    budget = Budget(0.6 * BUDGET, world.clock)
    world.slow = 1000.0
    world.cycle(budget)  # what is learnt from is trials alone, until a level is taken
    world.slow = 1.0
    for _ in range(200):
        world.cycle(budget)
    for level, factor in ((HULL, 2.0), (MESH, 3.0)):
        cost = budget.cost(level)
        assert cost is not None
        assert 0.3 * COSTS[level] <= cost <= factor * COSTS[level]
    assert 0.5 * (world.call + 2e-5) <= budget.overhead(HULL) <= 2.0 * (world.call + 2e-5)


def test_a_dearer_level_below_does_not_keep_from_a_cheaper_one_above() -> None:
    world = World(1000)
    world.costs.update({HULL: 1e-4, MESH: 2e-6})
    budget = Budget(BUDGET, world.clock)
    for _ in range(SETTLING):
        world.cycle(budget)
    assert budget.cap == MESH


def test_too_little_time_leaves_all_on_obb() -> None:
    world = World(1000)
    budget = Budget(1e-3, world.clock)
    for _ in range(100):
        assert (world.cycle(budget) == OBB).all()
    assert world.decided == []
    budget.seconds = BUDGET
    for _ in range(SETTLING):
        levels = world.cycle(budget)
    assert (levels == HULL).all()


def test_what_waits_is_refined_with_the_time_that_remains() -> None:
    world = World(1000)
    count = len(world.levels)
    asked, waiting = np.full(count, MESH, np.int8), np.ones(count, np.bool_)
    levels, verdicts = np.full(count, OBB, np.int8), np.full(count, TOUCHING, np.int8)
    budget = Budget(BUDGET, world.clock)
    done = []
    while waiting.any():
        rows = np.flatnonzero(waiting)
        part = levels[rows], verdicts[rows]
        world.levels, all_levels = world.levels[rows], world.levels
        budget.start()
        refine(world, asked[rows], waiting[rows], *part, budget)
        budget.finish()
        world.levels = all_levels
        levels[rows], verdicts[rows] = part
        waiting = levels < asked
        done.append(count - int(waiting.sum()))
        assert budget.used <= BUDGET
    assert done == sorted(set(done))
    assert 10 <= len(done) <= 20
    assert ((verdicts != SEPARATE) == (world.levels == MESH)).all()


@each("wrong", [0.0, -1.0, float("nan"), float("inf"), True])
def test_a_budget_is_positive_seconds(wrong: float) -> None:
    with pytest.raises(ValueError, match="time_budget"):
        Budget(wrong)
