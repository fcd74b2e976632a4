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

"""The effect ``sweep``: tunnelling between checks, prediction by twists, and when neither runs."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision import sweeps
from obb_collision.scene.effects import sweep as module


def at(x: float, y: float = 0.0, z: float = 0.0) -> list[float]:
    return [x, y, z, 0.0, 0.0, 0.0, 1.0]


def bullet_and_wall(**options: Any) -> oc.Scene:
    scene = oc.Scene()
    scene.add("wall", oc.shapes.Box([0.0625, 4, 4]))
    scene.add("fast/1", oc.shapes.Box([0.125, 0.125, 0.125]), at(-1))
    scene.add("slow/1", oc.shapes.Box([0.125, 0.125, 0.125]), at(-3))
    scene.set_effect("sweep", "on", **options)
    scene.check()
    return scene


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Record the calls of the queries of the effect."""
    made: list[str] = []

    def counted(moving: Any, *arguments: Any, **more: Any) -> Any:
        made.append("from pose to pose" if moving.motion.seconds == 0.0 else "by twists")
        return sweeps(moving, *arguments, **more)

    monkeypatch.setattr(module, "box_sweeps", counted)
    return made


def test_what_passes_through_between_checks_is_seen(calls: list[str]) -> None:
    scene = bullet_and_wall()
    scene.move("fast/1", at(1))
    report = scene.check()
    assert len(report) == 0
    passed = report.swept.passed
    assert passed.pairs.tolist() == [[0, 1]]
    assert passed.times[0] == pytest.approx((1 - 0.03125 - 0.0625) / 2)
    assert passed.normals.tolist() == [[-1.0, 0.0, 0.0]]
    assert passed.positions[0, 0] == pytest.approx(-0.03125)
    assert calls == ["from pose to pose"]
    assert len(scene.check().swept.passed) == 0  # once


def test_a_motion_too_small_to_pass_through_anything_is_not_swept(calls: list[str]) -> None:
    scene = bullet_and_wall()
    for x in (-0.95, -0.9, -0.85):
        scene.move("fast/1", at(x))
        assert len(scene.check().swept.passed) == 0
    assert calls == []


def test_pairs_that_collide_before_or_after_are_left_to_the_pairs() -> None:
    scene = bullet_and_wall()
    scene.move("fast/1", at(0.0))
    report = scene.check()
    assert (len(report), len(report.swept.passed)) == (1, 0)
    scene.move("fast/1", at(1.0))
    report = scene.check()
    assert (len(report), len(report.swept.passed)) == (0, 0)


@each("change", ["new object", "other shape", "disabled", "allowed", "caller"])
def test_what_has_no_way_from_the_check_before_is_not_swept(change: str) -> None:
    scene = bullet_and_wall(objects="fast/*")
    if change == "new object":
        scene.remove("fast/1")
        scene.add("fast/2", oc.shapes.Box([0.125, 0.125, 0.125]), at(1))
    elif change == "other shape":
        scene.add("fast/1", oc.shapes.Box([0.125, 0.125, 0.25]), at(1))
    elif change == "disabled":
        scene.set_enabled("fast/1", False)
        scene.move("fast/1", at(1))
    elif change == "allowed":
        scene.allow("fast/*", "wall")
        scene.move("fast/1", at(1))
    else:
        scene.move("slow/1", at(1))
    assert len(scene.check().swept.passed) == 0


def test_prediction_follows_twists_over_the_horizon(calls: list[str]) -> None:
    scene = bullet_and_wall(horizon=2.0)
    scene.set_twist("fast/1", [0.5, 0, 0, 0, 0, 0])
    scene.set_twists([scene.index("slow/1")], [[1.0, 0, 0, 0, 0, 0]])
    ahead = scene.check().swept.predicted
    assert ahead.pairs.tolist() == [[0, 1]]
    assert ahead.times[0] == pytest.approx((1 - 0.03125 - 0.0625) / 0.5)
    scene.set_effect("sweep", horizon=4.0)
    ahead = scene.check().swept.predicted
    assert ahead.pairs.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert ahead.times[2] == pytest.approx((2 - 0.125) / 0.5)
    del calls[:]
    scene.set_twists([1, 2], np.zeros((2, 6)))
    assert len(scene.check().swept.predicted) == 0
    scene.set_effect("sweep", horizon=0.0)
    scene.set_twist("fast/1", [0.5, 0, 0, 0, 0, 0])
    assert len(scene.check().swept.predicted) == 0
    assert calls == []


def test_a_twist_is_that_of_the_pose_and_swings_a_box_beside_it() -> None:
    scene = oc.Scene()
    scene.add("arm", oc.OBB([1.0, 0, 0], np.eye(3), [0.125, 0.125, 0.125]))
    scene.add("post", oc.shapes.Box([0.25, 0.25, 0.25]), at(0.0, 1.0))
    scene.set_twist("arm", [0, 0, 0, 0, 0, np.pi / 2])
    ahead = scene.check(effects=["sweep"]).swept.predicted
    assert ahead.pairs.tolist() == [[0, 1]]  # a quarter turn takes one second
    assert 0.75 < ahead.times[0] < 1.0
    assert scene.check(effects=["sweep"]).costs["sweep"].count >= 1


def test_it_must_be_asked_for_at_the_check() -> None:
    scene = bullet_and_wall()
    scene.set_effect("sweep", "auto")
    with pytest.raises(ValueError, match="ask for it"):
        _ = scene.check().swept
    scene.check(effects=["sweep"])
    scene.move("fast/1", at(1))
    assert len(scene.check(effects=["sweep"]).swept.passed) == 1
    scene.check()  # nobody asks: the next one that does has nothing to compare with
    scene.move("fast/1", at(-1))
    assert len(scene.check(effects=["sweep"]).swept.passed) == 0


def test_a_pair_whose_sweep_fails_is_named_and_the_others_are_swept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = bullet_and_wall()

    def failing(moving: Any, _: Any, pairs: Any, tolerance: float) -> Any:
        if (pairs == 1).any():
            raise ArithmeticError("no answer")
        return sweeps(moving, moving, pairs, tolerance=tolerance)

    monkeypatch.setattr(module, "box_sweeps", failing)
    scene.move_many(["fast/1", "slow/1"], [at(1), at(3, 1)])
    report = scene.check()
    assert report.swept.passed.pairs.tolist() == [[0, 2]]
    assert "ArithmeticError: no answer" in report.costs["sweep"].failures[0]


def arm_and_post(post: Any, speed: float, horizon: float) -> Any:
    scene = oc.Scene()
    scene.add("arm", oc.OBB([2.0, 0, 0], np.eye(3), [0.0005, 0.0005, 0.0005]), at(5.0, 5.0))
    scene.add("post", oc.shapes.Box([0.008, 0.008, 0.008]), at(5.0 + post, 5.0))
    scene.set_twist("arm", [0, 0, 0, 0, 0, speed])
    scene.set_effect("sweep", horizon=horizon)
    return scene.check(effects=["sweep"]).swept


@each("speed, horizon", [(1.0, 4.0), (1.0, 60.0), (1.0, 3600.0), (400.0, 1.0), (4000.0, 1.0)])
def test_an_arm_goes_round_in_a_circle_and_not_along_chords(speed: float, horizon: float) -> None:
    """A post 4 mm inside of the circle of 2 m, half a turn away; the corner meets it before."""
    swept = arm_and_post(-1.996, speed, horizon)
    assert swept.predicted.pairs.tolist() == [[0, 1]]
    assert 3.138 / speed < swept.predicted.times[0] < 3.1397 / speed  # pi - 4.5 mm / 2 m
    assert len(arm_and_post(-1.994, speed, horizon).predicted) == 0  # out of reach


def test_what_is_not_known_is_undecided_and_no_prediction() -> None:
    scene = oc.Scene()
    scene.add("arm", oc.OBB([2.0, 0, 0], np.eye(3), [0.05, 0.05, 0.05]))
    scene.add("post", oc.shapes.Box([0.2, 0.2, 0.2]), at(0.3))
    scene.set_twists([0, 1], [[0, 0, 0, 0, 0, 1e6], [0.01, 0, 0, 0, 0, 0]])
    swept = scene.check(effects=["sweep"]).swept
    found = swept.predicted
    assert (found.pairs.tolist(), found.hits.tolist()) == ([[0, 1]], [False])
    assert found.undecided.tolist() == [True]
    assert 0.0 < found.free_until[0] < 1.0
    assert np.isnan(found.times).all()
    assert len(swept.passed) == 0


def test_a_step_that_can_not_be_decided_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = bullet_and_wall()

    def unknown(moving: Any, _: Any, pairs: Any, tolerance: float) -> Any:
        found = sweeps(moving, moving, pairs, tolerance=tolerance)
        nowhere = np.full((len(pairs), 3), np.nan)
        return replace(found, hits=~found.hits & False, undecided=found.hits,
                       times=nowhere[:, 0], positions=nowhere, normals=nowhere)  # fmt: skip

    monkeypatch.setattr(module, "box_sweeps", unknown)
    scene.move("fast/1", at(1))
    found = scene.check().swept.passed
    assert (found.pairs.tolist(), found.hits.tolist()) == ([[0, 1]], [False])
    assert found.undecided.tolist() == [True]
    assert found.free_until[0] == pytest.approx((1 - 0.03125 - 0.0625) / 2)
