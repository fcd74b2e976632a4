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

"""The soak: what counts as wrong, the brute force behind it, and a short run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import oracle
import pytest
from each import each

pytest.importorskip("rclpy")
import rig  # noqa: F401 - of this machine only

from obb_collision.node.topics.topics import COLLISIONS
from tools.cases.placement import rotations_of
from tools.fuzz.process import Usage
from tools.soak import __main__ as command
from tools.soak.checker import Checker, Found, Result, pair_of, truth_of
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
    rows_of,
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


def new_checker() -> Checker:
    """Return a checker of 30 bodies, before the first step."""
    world = World(5, 30)
    world.apply(world.first())
    return Checker(world, Result(growth=1.0))


@pytest.fixture
def checker() -> Checker:
    return new_checker()


def after(checker: Checker, changes: dict[str, Change], *topics: str) -> Bodies:
    bodies = dict(checker.world.bodies)
    for topic in topics:
        changes[topic].apply(bodies)
    return bodies


def test_answers_with_any_changes_of_a_step_are_right_if_they_are(checker: Checker) -> None:
    result = checker.result
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


def spoiled(what: str, found: Found) -> None:
    first = next(iter(found))
    if what == "missing":
        del found[first]
    elif what == "too many":
        found[(1, 1), (2, 2)] = 0.1
    else:
        found[first] += 1e-6 if what == "wrong depth" else np.nan


@each("what", ["missing", "too many", "wrong depth", "wrong depth: none"])
def test_a_wrong_answer_is_found(what: str) -> None:
    checker = new_checker()
    found = right(checker.world.bodies)
    spoiled(what, found)
    checker.judge(rows(found))
    result = checker.result
    assert result.wrong == 1
    assert "1 wrong answers" in result.faults()
    assert what.partition(":")[0] in result.failure
    assert len(result.failure["bodies"]) == len(checker.world.bodies)


def test_a_pair_that_is_there_twice_is_wrong(checker: Checker) -> None:
    table = rows(right(checker.world.bodies))
    checker.judge(np.concatenate([table, table[:1]]))
    assert checker.result.wrong == 1


def test_an_answer_to_the_step_before_is_wrong_afterwards(checker: Checker) -> None:
    before = right(checker.world.bodies)
    changes = checker.world.step()
    checker.begin(changes)
    checker.end()
    checker.judge(rows(before))
    assert checker.result.wrong == 1


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
    assert checker.result.wrong == 0
    some = dict(checker.world.bodies) | {second: moved[second]}
    checker.judge(rows(right(some)))
    assert checker.result.wrong == 1


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
    result.usages.samples = [Usage(1e8 + 1e4 * k, 20, 10, 5e7) for k in range(100)]
    assert result.faults() == []
    result.usages.samples = [Usage(1e8 + 2e4 * k, 20 + k, 10, 5e7) for k in range(100)]
    assert result.faults() == ["memory grew by 1.8 MB", "descriptors grew by 90"]
    assert "memory of the node (MB): 100.09 after the warm-up, 101.89 at the end" in result.lines()


def test_brute_force_is_right() -> None:
    seen = set()
    for seed in range(5):
        world = World(seed, 40)
        world.apply(world.first())
        world.apply(world.step())
        poses, sizes = rows_of(world.bodies)
        boxes = list(zip(poses[:, :3], rotations_of(poses[:, 3:]), 0.5 * sizes, strict=True))
        i, j = np.triu_indices(len(boxes), 1)
        pairs = [oracle.ExactPair(boxes[a], boxes[b]) for a, b in zip(i, j, strict=True)]
        verdicts = np.array([pair.verdict() for pair in pairs])
        truth = truth_of(poses, sizes)
        assert truth.sure.all()
        colliding = np.flatnonzero(verdicts != oracle.SEPARATE)
        assert truth.pairs.tolist() == np.stack([i, j], axis=1)[colliding].tolist()
        depths = [-pairs[k].separation() for k in colliding]
        np.testing.assert_allclose(truth.depths, depths, atol=1e-12)
        seen |= set(verdicts.tolist())
    assert seen == {oracle.SEPARATE, oracle.TOUCHING, oracle.OVERLAP}, "some rest on others"


def test_what_doubles_do_not_decide_is_said() -> None:
    turned = np.array([0.0, 0.0, np.sin(0.3), np.cos(0.3)])
    # edge to edge along the rotated x axis, apart by less than is sure
    offset = 1.0 * rotations_of(turned[None])[0, :, 0]
    poses = np.array([[0.0, 0.0, 0.0, *turned], [*(offset * (1.0 + 1e-11)), *turned]])
    truth = truth_of(poses, np.ones((2, 3)))
    assert truth.pairs.tolist() == [[0, 1]]
    assert not truth.sure[0]
    poses[:, 3:] = 0.0, 0.0, 0.0, 1.0
    poses[1, :3] = 1.0, 1.0, 1.0
    truth = truth_of(poses, np.ones((2, 3)))
    assert truth.sure.all()
    assert truth.depths.tolist() == [0.0]


@pytest.mark.slow  # .ci/full runs a long one
def test_a_short_soak_holds(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "result.json"
    arguments = ["--seconds", "1000", "--steps", "60", "--seed", "2", "--json", str(file)]
    # what caches fill in the first seconds is no growth
    code = command.main([*arguments, "--objects", "40", "--growth", "100"])
    output = capfd.readouterr().out
    assert code == 0, output
    assert output.endswith("everything held\n")
    result = json.loads(file.read_text())
    assert result["steps"] == 60
    assert result["checked"] >= 60
    assert result["wrong"] == result["unsure"] == 0
    assert result["not held"] == []
    assert min(result["sent"].values()) > 5
    assert min(result["bodies"].values()) > 5
    assert result["latency (ms)"]["99 %"] > 0.0


@pytest.mark.slow  # test_a_wrong_answer_is_found finds them without a node
def test_objects_that_are_missing_are_found(capfd: pytest.CaptureFixture[str]) -> None:
    # whatever has moved is in no pair by the next check, however soon that is
    wrong = ["-p", "object_timeout:=0.000001", "-p", "stale_policy:=ignore"]
    code = command.main(["--seconds", "60", "--objects", "30", "--", *wrong])
    output = capfd.readouterr().out
    assert code == 1
    assert '"missing"' in output
    assert "python -m tools.soak --seed 1 --steps" in output
    assert "\nNOT held: " in output
    assert "wrong answers" in output


def test_a_node_that_ends_is_found(capfd: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--", "--no-such-argument"]) == 1
    assert "NOT held: the node ended with" in capfd.readouterr().out
