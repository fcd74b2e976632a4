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


"""Clouds beside robots: as if each of their balls were a sphere of the scene."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pytest
from small_robots import random_arm, random_states

import obb_collision as oc
from obb_collision.geometry.poses import compose_poses

RADIUS = 0.02
POSE = (0.1, -0.2, 0.05, 0.0, 0.0, 0.6, 0.8)
LEVELS = ("sphere", "aabb", "obb", "hull", "mesh")


def scenes(seed: int, accuracy: str) -> tuple[oc.Robot, oc.RobotScene, oc.RobotScene]:
    """Return an arm beside a cloud, and beside a sphere for each ball."""
    rng = np.random.default_rng(seed)
    robot = oc.Robot.from_urdf(random_arm(rng, 4))
    points = rng.normal(0, 0.6, (60, 3))
    checkers = []
    for single in (False, True):
        scene = oc.Scene(accuracy="mesh", padding=0.003)
        scene.add("box", oc.shapes.Box([0.2, 0.1, 0.3]), [0.4, 0, 0, 0, 0, 0, 1])
        scene.add("ball", oc.shapes.Sphere(0.1), [-0.4, 0, 0.5, 0, 0, 0, 1])
        if single:
            frame = oc.OBB.from_quaternion(POSE[:3], POSE[3:], [1, 1, 1])
            for number, point in enumerate(points @ frame.rotation.T + frame.center):
                where = [*point, 0, 0, 0, 1]
                scene.add(f"cloud/{number}", oc.shapes.Sphere(RADIUS), where)
        else:
            scene.add("cloud", oc.shapes.Cloud(points, RADIUS), POSE)
        checkers.append(oc.RobotScene([robot], scene, accuracy))
    return robot, checkers[0], checkers[1]


def named(pairs: object) -> set[tuple[str, ...]]:
    """Return pairs of names, each sphere of the cloud as the cloud."""
    return {tuple(sorted(name.split("/")[0] for name in pair)) for pair in pairs}  # type: ignore[attr-defined]


@pytest.mark.parametrize("accuracy", LEVELS)
def test_states_are_valid_as_beside_spheres(accuracy: str) -> None:
    robot, cloud, spheres = scenes(1, accuracy)
    states = random_states(np.random.default_rng(5), robot, 60)
    got, want = cloud.check(states, all_pairs=True), spheres.check(states, all_pairs=True)
    assert got.colliding.sum() > 5
    for row in range(len(states)):
        assert named(got.pairs_of(row)) == named(want.pairs_of(row))
    np.testing.assert_array_equal(cloud.check(states).colliding, want.colliding)
    assert any("cloud" in pair for row in range(60) for pair in got.pairs_of(row))


@pytest.mark.parametrize("accuracy", ["hull", "mesh"])
def test_distances_are_those_of_the_nearest_ball(accuracy: str) -> None:
    robot, cloud, spheres = scenes(2, accuracy)
    states = random_states(np.random.default_rng(6), robot, 20)
    for limit in (np.inf, 0.2):
        got = cloud.distances(states, max_distance=limit, jacobian=True)
        want = spheres.distances(states, max_distance=limit, jacobian=True)
        np.testing.assert_allclose(got.distances, want.distances, atol=1e-9)
        assert got.jacobians is not None
        assert want.jacobians is not None
        np.testing.assert_allclose(got.jacobians, want.jacobians, atol=1e-6)
        assert [named([pair]) for pair in got.pairs if pair] == [
            named([pair]) for pair in want.pairs if pair
        ]


@pytest.mark.parametrize("accuracy", ["hull", "mesh"])
def test_motions_are_proved_as_beside_spheres(accuracy: str) -> None:
    robot, cloud, spheres = scenes(8, accuracy)
    rng = np.random.default_rng(7)
    starts, ends = (random_states(rng, robot, 4000) for _ in range(2))
    ends = starts + 0.3 * (ends - starts)
    good = np.flatnonzero(spheres.check(starts).valid)[:30]
    starts, ends = starts[good], ends[good]
    got, want = cloud.check_motions(starts, ends), spheres.check_motions(starts, ends)
    np.testing.assert_array_equal(got.valid, want.valid)
    assert 3 < got.valid.sum() < 27
    np.testing.assert_allclose(got.fractions, want.fractions, atol=2e-3)


def test_rules_padding_and_attached_objects_hold_for_clouds() -> None:
    robot, cloud, _ = scenes(4, "hull")
    states = random_states(np.random.default_rng(8), robot, 40)
    before = cloud.check(states, all_pairs=True)
    cloud.scene.allow("cloud", "arm_*")
    after = cloud.check(states, all_pairs=True)
    for row in range(len(states)):
        want = {pair for pair in named(before.pairs_of(row)) if "cloud" not in pair}
        assert named(after.pairs_of(row)) == want
    cloud.attach("tool", oc.shapes.Sphere(0.4), "arm_3")
    held = cloud.check(states, all_pairs=True)
    assert any(("cloud", "tool") in named(held.pairs_of(row)) for row in range(len(states)))


def test_a_new_cloud_counts_and_the_old_one_is_forgotten() -> None:
    robot, cloud, _ = scenes(5, "hull")
    states = random_states(np.random.default_rng(9), robot, 10)
    blocks = 0
    for number in range(60):
        if number == 30:
            gc.collect()
            blocks = sys.getallocatedblocks()
        far = np.full((50, 3), 50.0 + number)
        cloud.scene.set_shape("cloud", oc.shapes.Cloud(far))
        report = cloud.check(states, all_pairs=True)
        assert not any("cloud" in p for row in range(10) for p in named(report.pairs_of(row)))
    gc.collect()
    assert sys.getallocatedblocks() < blocks + 500
    cloud.scene.set_shape("cloud", oc.shapes.Cloud(np.zeros((0, 3))))
    assert len(cloud.check(states).valid) == 10


def test_own_points_are_in_hulls_or_hidden_by_them() -> None:
    robot, checker, _ = scenes(8, "hull")
    rng = np.random.default_rng(11)
    state, points = random_states(rng, robot, 1)[0], rng.normal(0, 0.3, (2000, 3))
    points[::100, 1] = np.nan
    tool, links = oc.shapes.Box([0.2, 0.2, 0.2]), robot.link_poses(state)
    checker.attach("tool", tool, "arm_3")
    bodies = oc.Scene(accuracy="hull")
    bodies.add("tool", tool, links[-1])
    for link, shapes in enumerate(robot.shapes):
        for number, (shape, pose) in enumerate(shapes):
            bodies.add(f"{link}/{number}", shape, compose_poses(links[link], np.asarray(pose)))
    seen = np.flatnonzero(np.isfinite(points).all(axis=1))[:300]
    own = checker.own_points(state, points)
    dot = oc.shapes.Cloud([[0, 0, 0]])
    want = [bool(bodies.query(dot, [*points[row], 0, 0, 0, 1])) for row in seen]
    np.testing.assert_array_equal(own[seen], want)
    assert not own[::100].any()
    assert checker.own_points(state, points, 0.05).sum() > own.sum() > 20
    sensor = np.array([0.0, 0.0, 3.0])
    behind, ways = checker.own_points(state, points, sensor=sensor), points[seen] - sensor
    reaches = np.linalg.norm(ways, axis=1)
    hits = bodies.cast_rays(np.tile(sensor, (len(seen), 1)), ways, max_distance=reaches)
    np.testing.assert_array_equal(behind[seen], (hits.boxes >= 0) | own[seen])
    assert own[behind].sum() == own.sum() < behind.sum()
