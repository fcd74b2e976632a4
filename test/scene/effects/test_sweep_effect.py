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

"""The effect ``sweep``: tunnelling between checks, prediction by twists, on every level."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from each import each
from scenes import at
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.scene.effects import LEVELS
from obb_collision.scene.effects import sweep as module
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere

HORIZON = 4.0
LEVELS_OF_SWEEP = ("obb", *(level.name.lower() for level in LEVELS["sweep"]))


def bullet_and_wall(**options: Any) -> oc.Scene:
    scene = oc.Scene()
    scene.add("wall", Box([0.0625, 4, 4]))
    scene.add("fast/1", Box([0.125, 0.125, 0.125]), at(-1))
    scene.add("slow/1", Box([0.125, 0.125, 0.125]), at(-3))
    scene.set_effect("sweep", "on", **options)
    scene.check()
    return scene


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Record the calls of the queries of the effect."""
    made: list[str] = []

    def counted(moving: Any, *arguments: Any, **more: Any) -> Any:
        made.append("from pose to pose" if moving.arrays.seconds == 0.0 else "by twists")
        return oc.sweeps(moving, *arguments, **more)

    monkeypatch.setattr(module, "box_sweeps", counted)
    return made


def test_what_passes_through_between_checks_is_seen_once(calls: list[str]) -> None:
    scene = bullet_and_wall()
    for x in (-0.95, -0.9, -0.95, -1.0):  # too small to pass through anything
        scene.move("fast/1", at(x))
        assert len(scene.check().swept.passed) == 0
    assert calls == []
    scene.move("fast/1", at(1))
    report = scene.check()
    assert len(report) == 0
    passed = report.swept.passed
    assert passed.pairs.tolist() == [[0, 1]]
    assert passed.times[0] == pytest.approx((1 - 0.03125 - 0.0625) / 2)
    assert passed.normals.tolist() == [[-1.0, 0.0, 0.0]]
    assert passed.positions[0, 0] == pytest.approx(-0.03125)
    assert calls == ["from pose to pose"]
    assert len(scene.check().swept.passed) == 0
    scene.move("fast/1", at(0.0))
    for pairs in (1, 0):  # what collides before or after is left to the pairs
        report = scene.check()
        assert (len(report), len(report.swept.passed)) == (pairs, 0)
        scene.move("fast/1", at(-1.0))


@each("change", ["new object", "other shape", "disabled", "allowed", "caller"])
def test_what_has_no_way_from_the_check_before_is_not_swept(change: str) -> None:
    scene = bullet_and_wall(objects="fast/*")
    if change == "new object":
        scene.remove("fast/1")
        scene.add("fast/2", Box([0.125, 0.125, 0.125]), at(1))
    elif change == "other shape":
        scene.add("fast/1", Box([0.125, 0.125, 0.25]), at(1))
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
    scene.objects.set_twists([scene.index("slow/1")], [[1.0, 0, 0, 0, 0, 0]])
    ahead = scene.check().swept.predicted
    assert ahead.pairs.tolist() == [[0, 1]]
    assert ahead.times[0] == pytest.approx((1 - 0.03125 - 0.0625) / 0.5)
    scene.set_effect("sweep", horizon=4.0)
    ahead = scene.check().swept.predicted
    assert ahead.pairs.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert ahead.times[2] == pytest.approx((2 - 0.125) / 0.5)
    del calls[:]
    scene.objects.set_twists([1, 2], np.zeros((2, 6)))
    assert len(scene.check().swept.predicted) == 0
    scene.set_effect("sweep", horizon=0.0)
    scene.set_twist("fast/1", [0.5, 0, 0, 0, 0, 0])
    assert len(scene.check().swept.predicted) == 0
    assert calls == []


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


def test_a_sweep_that_fails_is_named_and_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = bullet_and_wall()

    def failing(moving: Any, _: Any, pairs: Any, tolerance: float) -> Any:
        if (pairs == 1).any():
            raise ArithmeticError("no answer")
        return oc.sweeps(moving, moving, pairs, tolerance=tolerance)

    monkeypatch.setattr(module, "box_sweeps", failing)
    scene.move(["fast/1", "slow/1"], [at(1), at(3, 1)])
    report = scene.check()
    assert report.swept.passed.pairs.tolist() == [[0, 2]]
    assert "ArithmeticError: no answer" in report.costs["sweep"].failures[0]


def arm_and_post(post: float, speed: float, horizon: float) -> Any:
    scene = oc.Scene()
    scene.add("arm", oc.OBB([2.0, 0, 0], np.eye(3), [0.0005, 0.0005, 0.0005]), at(5.0, 5.0))
    scene.add("post", Box([0.008, 0.008, 0.008]), at(5.0 + post, 5.0))
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
    scene.add("post", Box([0.2, 0.2, 0.2]), at(0.3))
    scene.objects.set_twists([0, 1], [[0, 0, 0, 0, 0, 1e6], [0.01, 0, 0, 0, 0, 0]])
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
        found = oc.sweeps(moving, moving, pairs, tolerance=tolerance)
        nowhere = np.full((len(pairs), 3), np.nan)
        return replace(found, hits=~found.hits & False, undecided=found.hits,
                       times=nowhere[:, 0], positions=nowhere, normals=nowhere)  # fmt: skip

    monkeypatch.setattr(module, "box_sweeps", unknown)
    scene.move("fast/1", at(1))
    found = scene.check().swept.passed
    assert (found.pairs.tolist(), found.hits.tolist()) == ([[0, 1]], [False])
    assert found.undecided.tolist() == [True]
    assert found.free_until[0] == pytest.approx((1 - 0.03125 - 0.0625) / 2)


def shapes_of(rng: np.random.Generator, count: int) -> list[Shape]:
    """Return shapes of all kinds."""
    shapes: list[Shape] = []
    while len(shapes) < count:
        size = rng.uniform(0.1, 0.4, 3)
        x, y, _ = size
        shapes += [Box(2.0 * size), Sphere(x), Capsule(x, y), Cylinder(x, 2.0 * y)]
        shapes += [Cone(x, 2.0 * y), Ellipsoid(size), Hull(rng.normal(size=(12, 3)) * 0.5 * size)]
        shapes.append(Mesh(rng.normal(size=(4, 3)) * size, [[0, 2, 1], [0, 1, 3]]))
        shapes.append(Mesh(rng.normal(size=(6, 3)) * size, [[0, 2, 1], [3, 4, 5]]))
    return shapes[:count]


def twists_of(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed + 100)
    return np.asarray(rng.normal(size=(count, 6)) * rng.choice([0.0, 0.3, 1.0], (count, 1)))


def moving_scene(seed: int, *, padding: float = 0.0, count: int = 24, **options: str) -> oc.Scene:
    """Return such shapes that move all over the place."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(padding=padding)
    for number, shape in enumerate(shapes_of(rng, count)):
        turn = Rotation.random(1, rng).as_quat()[0]
        scene.add(str(number), shape, [*rng.uniform(-1.2, 1.2, 3), *turn])
    scene.objects.set_twists(np.arange(count), twists_of(seed, count))
    scene.set_effect("sweep", "on", horizon=HORIZON, **options)
    return scene


def free(found: Any) -> dict[tuple[int, int], float]:
    return {(i, j): t for (i, j), t in zip(found.pairs.tolist(), found.free_until, strict=True)}


@each("seed", range(4))
@each("padding", [0.0, 0.02])
def test_no_impact_is_before_that_at_a_coarser_level(seed: int, padding: float) -> None:
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(-1.2, 1.2, (24, 3)), Rotation.random(24, rng).as_quat()])
    seen: list[list[dict[tuple[int, int], float]]] = []
    for level in LEVELS_OF_SWEEP:
        scene = moving_scene(seed, padding=padding, accuracy=level)
        ahead = scene.check().swept.predicted
        scene.move_indices(np.arange(24), poses)
        seen.append([free(ahead), free(scene.check().swept.passed)])
    for coarse, fine in pairwise(seen):
        assert len(fine[0]) > 5
        for k in range(2):
            for pair, time in fine[k].items():
                if pair in coarse[k]:  # what is nearer than a radius is swept, however short
                    assert time >= coarse[k][pair]
        assert set(fine[0]) <= set(coarse[0])
        assert fine[0] != coarse[0]


@each("level", LEVELS_OF_SWEEP)
@each("seed", range(3))
def test_nothing_predicted_is_late_or_missed(level: str, seed: int) -> None:
    """Against clearances on that level, step by step along the twists."""
    scene = moving_scene(seed, accuracy=level)
    scene.set_effect("clearance", max_distance=0.0, accuracy=level)
    report = scene.check()
    until, known = free(report.swept.predicted), set(map(tuple, report.pairs.tolist()))
    poses, twists = scene.objects.poses_of(scene.indices), twists_of(seed, 24)
    scene.set_effect("sweep", "off")
    collided = set()
    for time in np.linspace(0.0, HORIZON, 60)[1:]:
        turned = Rotation.from_rotvec(twists[:, 3:] * time) * Rotation.from_quat(poses[:, 3:])
        places = poses[:, :3] + twists[:, :3] * time
        scene.move_indices(np.arange(24), np.column_stack([places, turned.as_quat()]))
        near = set(map(tuple, scene.check().clearances.pairs.tolist())) - known
        assert all(until[pair] <= time * (1.0 + 1e-9) for pair in near)
        collided |= near
    assert len(collided) > 5


@each("level, hits", [("obb", True), ("hull", False)])
def test_shapes_pass_each_other_where_boxes_do_not(level: str, hits: bool) -> None:
    scene = oc.Scene(accuracy=level)
    scene.add("ball", Sphere(0.5), at(-3))
    scene.add("post", Cylinder(0.5, 4.0), [0, 0.8, 0.9, 0.0, 0.6, 0.0, 0.8])
    scene.add("other", Sphere(0.5), at(0, -0.8, 0.8))
    scene.set_effect("sweep", "on", horizon=10.0)
    scene.set_twist("ball", [1, 0, 0, 0, 0, 0])
    assert ([0, 2] in scene.check().swept.predicted.pairs.tolist()) == hits
    scene.move("ball", at(3))
    assert ([0, 2] in scene.check().swept.passed.pairs.tolist()) == hits


@each("order", [1, -1])
def test_round_shapes_meet_meshes_at_their_very_radius(order: int) -> None:
    """A mesh around the cylinder would be up to a few percent early."""
    corners = np.array([[0.0, -1, -1], [0, 1, -1], [0, 0, 1], [-0.1, 0, 0]])
    wall = Mesh(corners, [[0, 1, 2], [0, 2, 3], [2, 1, 3], [1, 0, 3]])
    scene = oc.Scene(accuracy="mesh", padding=0.02)
    can = "can", Cylinder(0.3, 0.4), [2.0, 0, 0, 0, 0, 0.1, 0.99498744]
    for thing in (can, ("wall", wall, at(0)))[::order]:
        scene.add(*thing)
    scene.set_twist("can", [-0.5, 0, 0, 0, 0, 0])
    scene.set_effect("sweep", "on", horizon=HORIZON)
    found = scene.check().swept.predicted
    truth = (2.0 - 0.3 - 0.04) / 0.5
    assert len(found) == 1
    assert truth - 2e-4 <= found.times[0] <= truth
    np.testing.assert_allclose(found.normals[0], [-order, 0, 0], atol=1e-6)


def test_a_short_motion_through_something_thin_in_a_thick_box_is_seen() -> None:
    """A needle of a hull through another: far less than half a box, and apart before and after."""
    points = np.array([[0, 0, 0], [1, 1, 1], [1, 1, 1.001], [0, 0.001, 0], [1, 0.2, 0.1]])
    scene = oc.Scene(accuracy="hull")
    scene.add("thin", Hull(points))
    assert scene.obb("thin").half_extents.min() > 0.0
    scene.add("ball", Capsule(0.001, 0.3), at(0.3, 0.3, 0.1))
    scene.set_effect("sweep", "on", horizon=0.0)
    seen = 0
    for step in range(200):
        before = scene.check()
        scene.move("ball", at(0.3 + 0.004 * step, 0.3, 0.1))
        after = scene.check()
        passed = len(after.swept.passed)
        assert not (len(before) and passed)
        seen += passed + len(after)
    assert seen > 0


@each("height, passed", [(0.105 + 1e-9, 1), (0.05, 0)])
def test_what_begins_within_tolerance_is_swept_unless_colliding(height: float, passed: int) -> None:
    scene = oc.Scene(accuracy="hull")
    scene.add("wall", Cylinder(3.0, 0.01))
    scene.add("ball", Sphere(0.1), at(0, 0, height))
    scene.set_effect("sweep", "on")
    assert len(scene.check()) == 1 - passed
    scene.move("ball", at(0, 0, -0.5))
    report = scene.check()
    assert len(report) == 0
    assert report.swept.passed.pairs.tolist() == [[0, 1]] * passed
    assert (report.swept.passed.times <= 2e-9).all()


def test_a_budget_lowers_sweeps_with_their_pairs() -> None:
    scene = moving_scene(0)
    scene.accuracy, scene.time_budget = "hull", 1e-9
    report = scene.check()
    assert report.behind
    assert free(report.swept.predicted) == free(moving_scene(0).check().swept.predicted)
