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

"""What counts as wrong: any pair missing or too many, or a depth, whatever of a step is there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("rclpy")
from obb_collision.node.topics.topics import COLLISIONS
from tools.soak.checker import Checker, Found, found_in, pair_of
from tools.soak.encoding import rows_of
from tools.soak.result import Result
from tools.soak.truth import truth_of
from tools.soak.watch import Sample
from tools.soak.world import (
    BOXES,
    MARKERS,
    TOPICS,
    TRANSFORM,
    Bodies,
    Body,
    Change,
    World,
    anchor,
    beacon,
)


def rows(found: Found) -> np.ndarray:
    """Return rows as a node publishes them."""
    table = np.zeros(len(found), COLLISIONS.dtype)
    for row, (((ns_a, a), (ns_b, b)), depth) in enumerate(found.items()):
        table[row]["ns_a"], table[row]["id_a"] = ns_a, a
        table[row]["ns_b"], table[row]["id_b"] = ns_b, b
        table[row]["depth"] = depth
    return table


def right(bodies: Bodies) -> Found:
    keys, truth = list(bodies), truth_of(*rows_of(bodies))
    pairs = [pair_of(keys[i], keys[j]) for i, j in truth.pairs]
    return dict(zip(pairs, truth.depths.tolist(), strict=True))


@pytest.fixture
def checker() -> Checker:
    """Return a checker of 30 bodies, before the first step."""
    world = World(5, 30)
    world.apply(world.first())
    return Checker(world, Result(growth=1.0))


def after(checker: Checker, changes: dict[str, Change], *topics: str) -> Bodies:
    bodies = dict(checker.world.bodies)
    for topic in topics:
        changes[topic].apply(bodies)
    return bodies


def test_answers_with_any_changes_of_a_step_are_right_if_they_are(checker: Checker) -> None:
    result = checker._result
    assert checker.judge(rows(right(checker.world.bodies)))
    for number in range(20):
        changes = checker.world.step()
        checker.begin(changes)
        topics = list(changes)
        for count in range(len(topics) + 1):
            answer = right(after(checker, changes, *topics[:count]))
            assert checker.judge(rows(answer)) == (count == len(topics)), number
        checker.end()
        assert checker.judge(rows(right(checker.world.bodies)))
    assert result.wrong == 0
    assert result.checked > 60
    assert set(result.bodies) == {"came", "went", "moved"}


def spoil_missing(found: Found) -> None:
    del found[next(iter(found))]


def spoil_more(found: Found) -> None:
    found[(1, 1), (2, 2)] = 0.1


def spoil_depth(found: Found) -> None:
    found[next(iter(found))] += 1e-6


def spoil_unknown_depth(found: Found) -> None:
    found[next(iter(found))] = np.nan


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        (spoil_missing, "missing"),
        (spoil_more, "too many"),
        (spoil_depth, "wrong depth"),
        (spoil_unknown_depth, "wrong depth"),
    ],
)
def test_a_wrong_answer_is_found(
    checker: Checker, spoil: Callable[[Found], None], what: str
) -> None:
    found = right(checker.world.bodies)
    spoil(found)
    checker.judge(rows(found))
    result = checker._result
    assert result.wrong == 1
    assert "1 wrong answers" in result.faults()
    assert what in result.failure
    assert len(result.failure["bodies"]) == len(checker.world.bodies)


def test_a_pair_that_is_there_twice_is_wrong(checker: Checker) -> None:
    table = rows(right(checker.world.bodies))
    checker.judge(np.concatenate([table, table[:1]]))
    assert checker._result.wrong == 1


def test_an_answer_to_the_step_before_is_wrong_afterwards(checker: Checker) -> None:
    before = right(checker.world.bodies)
    changes = checker.world.step()
    checker.begin(changes)
    checker.end()
    checker.judge(rows(before))
    assert checker._result.wrong == 1


def test_single_poses_may_come_one_by_one_in_order(checker: Checker) -> None:
    here = [key for key in checker.world.bodies if key[0].startswith("crate")]
    first, second, target = here[:3]
    there = checker.world.bodies[target]
    moved = {key: Body(there.kind, there.pose, there.size) for key in (first, second)}
    lit = checker.world.bodies[beacon(TRANSFORM)]
    at = checker.world.bodies[anchor(TRANSFORM)]
    checker.begin({TRANSFORM: Change({**moved, beacon(TRANSFORM): lit._replace(pose=at.pose)})})
    some = dict(checker.world.bodies) | {first: moved[first]}
    assert not checker.judge(rows(right(some)))
    assert checker._result.wrong == 0
    some = dict(checker.world.bodies) | {second: moved[second]}
    checker.judge(rows(right(some)))
    assert checker._result.wrong == 1


def test_rows_are_read_as_they_were_written(checker: Checker) -> None:
    found = right(checker.world.bodies)
    assert found_in(rows(found)) == found
    assert len(found) > 5


def test_the_same_seed_is_the_same_steps() -> None:
    def steps(seed: int) -> list[str]:
        world = World(seed, 20)
        made = [world.first()]
        world.apply(made[0])
        for _ in range(50):
            made.append(world.step())
            world.apply(made[-1])
        return [repr([(t, c.bodies, sorted(c.gone)) for t, c in one.items()]) for one in made]

    assert steps(1) == steps(1)
    assert steps(1) != steps(2)


def test_every_input_changes_bodies_and_no_body_is_changed_twice_in_a_step() -> None:
    world = World(3, 60)
    world.apply(world.first())
    counts = dict.fromkeys(TOPICS, 0)
    for _ in range(300):
        changes = world.step()
        keys = [key for change in changes.values() for key in {*change.bodies, *change.gone}]
        assert len(keys) == len(set(keys))
        for topic, change in changes.items():
            assert list(change.bodies)[-1] == beacon(topic)
            counts[topic] += len(change.bodies) - 1 + len(change.gone)
        world.apply(changes)
        assert 40 < len(world.bodies) < 100
    assert min(counts.values()) > 100
    assert {key[0] == "boxes" for key in world.bodies} == {True, False}
    assert MARKERS in counts
    assert BOXES in counts


def test_growth_is_found() -> None:
    result = Result(growth=1.0, checked=1)
    result.samples = [Sample(k, 100.0 + 0.01 * k, 50.0, 20, 10) for k in range(100)]
    assert result.faults() == []
    result.samples = [Sample(k, 100.0 + 0.02 * k, 50.0, 20 + k, 10) for k in range(100)]
    assert result.faults() == ["memory grew by 1.8 MB", "descriptors grew by 90"]
    assert "memory of the node (MB): 100.09 after the warm-up, 101.89 at the end" in result.lines()
