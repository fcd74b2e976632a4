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

"""``max_pairs``: the first pairs, every object that collides, and no more memory than for these."""

from __future__ import annotations

import itertools
from functools import partial
from typing import Any

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from scenes import allocated, counted
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.scene import limit
from obb_collision.scene.broad_phase import find_pairs as pairs
from obb_collision.scene.refinement import Budget
from obb_collision.shapes import Box, Cylinder, Mesh, Sphere


def leave_no_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let candidates of small scenes be too many to hold, too."""
    monkeypatch.setattr(limit, "PER_OBJECT", 0)
    monkeypatch.setattr(limit, "PER_PAIR", 1)
    monkeypatch.setattr(limit, "PIECE", 16)


RULES = [("0/*", "1/*", True), ("*/3", "*", True)]


def crowd(seed: int, accuracy: str, **settings: Any) -> oc.Scene:
    """Return piles, a loose heap, a bundle of rods that don't touch, and loners, mixed up."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(accuracy=accuracy, **settings)
    shapes = [Box([0.5, 0.5, 0.5]), Mesh(*zoo()["torus0"]), Sphere(0.3), Cylinder(0.2, 0.6)]
    turned = [0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8)]
    for k in rng.permutation(90):
        kind, name = k % 6, f"{k % 3}/{k}"
        pose = [*rng.uniform(-0.1, 0.1, 3), *Rotation.random(random_state=int(k)).as_quat()]
        if kind == 0:
            pose[0] += 10.0
        elif kind == 1:
            pose[0] += 20.0 + 0.3 * k
        elif kind == 3:
            pose[1] += 10.0 + rng.uniform(0.0, 2.0)
        elif kind == 4:
            pose = [30.0 + 0.15 * k, 10.0 - 0.15 * k, 0.0, *turned]
        elif kind == 5:
            pose[2] += 50.0 + 10.0 * k
        shape = Box([20.0, 0.1, 0.1]) if kind == 4 else shapes[k % 4]
        scene.add(name, shape, pose)
    return scene


@each("accuracy", [level.label for level in oc.Accuracy])
@each("room, rules", [(True, RULES), (False, RULES), (False, [])])
def test_the_first_pairs_are_kept_and_all_that_collide_are_marked(
    room: bool,
    accuracy: str,
    rules: list[tuple[str, str, bool]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if not room:
        leave_no_room(monkeypatch)
    scene = crowd(1, accuracy)
    scene.rules.allowed = rules
    everything = scene.check()
    count = len(everything)
    assert count > 100
    for most in (1, 7, 60, count - 1, count, count + 1):
        scene.max_pairs = most
        report = scene.check()
        for name in ("pairs", "verdicts", "accuracies"):
            expected = getattr(everything, name)[:most]
            assert getattr(report, name).tobytes() == expected.tobytes(), (most, name)
        assert report.truncated == (count > most)
        assert min(count, most + 1) <= report.total <= count
        assert report.total == count or not room or most < 60
        assert (report.colliding == everything.colliding).all()
        assert ("at least" in repr(report)) == report.truncated
        assert len(report.depths) == min(count, most)
    scene.max_pairs = None
    assert len(scene.check()) == count


@each("room", [True, False])
def test_changes_of_a_limited_scene(room: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not room:
        leave_no_room(monkeypatch)
    scene, twin = crowd(2, "obb", max_pairs=50), crowd(2, "obb")
    rng = np.random.default_rng(5)
    seen = set()
    for step in range(80):
        name = scene.names[rng.integers(90)]
        where = [10.0, 0.0, 0.0] if step % 40 < 20 else [*rng.uniform(100.0, 200.0, 3)]
        for made in (scene, twin):
            made.move(name, [*where, 0, 0, 0, 1])
        report, expected = scene.check(), twin.check()
        assert report.names() == expected.names()[:50]
        assert (report.colliding == expected.colliding).all()
        assert report.truncated == (len(expected) > 50)
        assert report.depths.tobytes() == expected.depths[:50].tobytes()
        seen.add(report.truncated)
        if step == 60:
            for other in scene.names:
                for made in (scene, twin):
                    made.move(other, [1e3, 0.0, float(scene.index(other)) * 10, 0, 0, 0, 1])
    assert seen == {False, True}


def test_work_and_memory_do_not_grow_with_the_square(monkeypatch: pytest.MonkeyPatch) -> None:
    decided = counted(monkeypatch, pairs, "colliding_keys", 1)
    work, peaks = [], []
    for count in (1500, 3000):
        scene = oc.Scene(max_pairs=1000)
        poses = np.outer(1e-6 * np.arange(count), np.eye(7)[0]) + np.eye(7)[6]
        scene.add_boxes([f"{k}" for k in range(count)], np.ones((count, 3)), poses)
        scene.check()  # whatever is made once
        scene.move_indices([0], [[0.0, 0, 0.1, 0, 0, 0, 1]])
        decided.clear()
        peaks.append(allocated(partial(scene.check, ["separations", "contacts"])))
        work.append(sum(decided))
        report = scene.check()
        assert len(report) == 1000
        assert report.truncated
        assert report.colliding[:count].all()
    assert 0 < max(work) <= 2 * 3000  # of one row of all, and not of 4.5 million
    assert peaks[1] < 8e6  # of 4.5 million pairs 72e6 would be the indices alone


def test_many_candidates_of_which_none_collide_are_looked_at_piece_by_piece() -> None:
    scene = oc.Scene(max_pairs=10)
    turned = [0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8)]
    poses = np.array([[0.15 * k, -0.15 * k, 0.0, *turned] for k in range(1500)])
    sizes = np.tile([1e4, 0.1, 0.1], (1500, 1))  # bounds of all overlap
    scene.add_boxes([f"{k}" for k in range(1500)], sizes, poses)
    scene.check()
    scene.move_indices(np.arange(1500), poses + np.eye(7)[2])  # 1 m up
    peak = allocated(scene.check)
    report = scene.check()
    assert (len(report), report.truncated, report.total) == (0, False, 0)
    assert peak < 8e6  # all candidates, 1.1 million, would be 18e6


def test_effects_with_pairs_of_their_own_have_a_limit_and_say_so() -> None:
    scene = oc.Scene(max_pairs=10)
    for k in range(200):
        scene.add(f"{k}", Box([0.1, 0.1, 0.1]), [0.101 * k, 0, 0, 0, 0, 0, 1])
    scene.set_effect("clearance", max_distance=0.05)
    report = scene.check(effects=["clearance"])
    assert len(report.clearances) == 100
    assert report.clearances.pairs[-1].tolist() == [99, 100]
    assert "more than 100 pairs" in report.costs["clearance"].failures[0]
    scene.max_pairs = 20
    report = scene.check(effects=["clearance"])
    assert len(report.clearances) == 199
    assert report.costs["clearance"].failures == ()


def test_a_budget_and_a_limit_together_lose_no_object_that_collides() -> None:
    expected = crowd(3, "mesh").check()
    clock = itertools.count(0.0, 1e-4)
    scene = crowd(3, "mesh", max_pairs=40, time_budget=Budget(0.01, lambda: next(clock)))
    for _ in range(10):
        scene.padding, scene.padding = 0.5, 0.0  # all count as changed
        report = scene.check()
        assert report.truncated
        assert len(report) == 40
        assert not (expected.colliding & ~report.colliding).any()
        assert not report.pairs.flags.writeable


@each("wrong", [0, -1, 1.0, True, "1", float("nan"), 2**53 + 1, 2**62, 2**64])
def test_a_limit_is_a_positive_whole_number(wrong: Any) -> None:
    with pytest.raises(ValueError, match="max_pairs must be a whole number"):
        oc.Scene(max_pairs=wrong)
    scene = oc.Scene(max_pairs=5)
    with pytest.raises(ValueError, match="max_pairs"):
        scene.max_pairs = wrong
    assert scene.max_pairs == 5
    for name in ("a", "b"):
        scene.add(name, Box([1.0, 1.0, 1.0]))
    scene.max_pairs = 2**53
    assert scene.check(effects=["clearance"]).names() == [("a", "b")]
