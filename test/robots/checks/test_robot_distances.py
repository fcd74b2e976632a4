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

"""Distances of every pair and their gradients by the joints; states of groups of joints."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from small_robots import SHAPES, random_arm, random_states, random_world
from test_robot_motions import MOBILE

import obb_collision as oc

STEP = 1e-6
NEAR = 2.0
ARM = "config/arm.urdf", "config/arm.srdf"


def distances_by_pair(checker: oc.RobotScene, state: np.ndarray) -> dict[object, float]:
    found = checker.distances(state, max_distance=NEAR, all_pairs=True)
    return dict(zip(found.pairs, found.distances.tolist(), strict=True))


@each("accuracy", ["obb", "hull", "mesh"])
@each("mobile", [False, True])
def test_gradients_are_those_of_finite_differences(accuracy: str, mobile: bool) -> None:
    """Of every pair, and so of the least distance."""
    rng = np.random.default_rng(3)
    text = MOBILE if mobile else random_arm(rng, 5, shapes=SHAPES)
    robot = oc.Robot.from_urdf(text)
    base = [[0.3, -0.2, 0.1, 0.1, 0.2, 0.3, 0.9]]
    checker = oc.RobotScene([robot], random_world(rng, 3), accuracy, bases=base)
    joints = len(robot.joint_names)
    states = rng.normal(0, 1.0, (60, joints)) if mobile else random_states(rng, robot, 40)
    every = checker.distances(states, max_distance=NEAR, all_pairs=True, jacobian=True)
    assert every.jacobians is not None
    errors: list[float] = []
    for n, state in enumerate(states):
        ends = [
            [distances_by_pair(checker, state + way * step) for way in (1.0, -1.0)]
            for step in STEP * np.eye(joints)
        ]
        for row in np.flatnonzero((every.states == n) & (every.distances > 1e-3)):
            pair = every.pairs[row]
            if all(pair in end for both in ends for end in both):
                slopes = [(after[pair] - before[pair]) / (2.0 * STEP) for after, before in ends]
                errors.append(np.abs(every.jacobians[row] - slopes).max())
    assert len(errors) >= 40
    assert np.mean(np.array(errors) < 1e-7) >= 0.9  # others are where the closest features change
    assert np.abs(every.jacobians[every.distances > 1e-3]).max() > 0.01
    least = checker.distances(states, max_distance=NEAR, jacobian=True)
    assert least.jacobians is not None
    for at in np.flatnonzero((least.distances > 1e-3) & (least.distances < NEAR)):
        rows = [k for k in np.flatnonzero(every.states == at) if every.pairs[k] == least.pairs[at]]
        same = every.jacobians[rows]
        np.testing.assert_allclose(least.jacobians[at : at + 1], same, rtol=0, atol=1e-6)


@each("accuracy", ["obb", "hull", "mesh"])
def test_distances_of_every_pair(accuracy: str) -> None:
    rng = np.random.default_rng(5)
    robot = oc.Robot.from_urdf(random_arm(rng, 5))
    checker = oc.RobotScene([robot], random_world(rng, 5), accuracy)
    states = random_states(rng, robot, 20)
    least = checker.distances(states, max_distance=0.3)
    every = checker.distances(states, max_distance=0.3, all_pairs=True, jacobian=True)
    assert every.jacobians is not None
    assert every.jacobians.shape == (len(every), len(robot.joint_names))
    report = checker.check(states, all_pairs=True)
    for n in range(len(states)):
        rows = np.flatnonzero(every.states == n)
        pairs = [every.pairs[row] for row in rows]
        assert len(set(pairs)) == len(pairs)
        apart = every.distances[rows] > 0.0
        colliding = {pair for pair, free in zip(pairs, apart, strict=True) if not free}
        if accuracy != "obb":  # there, states have spheres besides boxes
            assert colliding == set(report.pairs_of(n))
        if least.distances[n] > 0.0 and len(rows):
            assert every.distances[rows].min() == pytest.approx(least.distances[n], abs=1e-9)
        assert (len(rows) == 0) == np.isinf(least.distances[n])
    with pytest.raises(ValueError, match="max_distance must be given for all_pairs"):
        checker.distances(states, all_pairs=True)


def test_states_of_a_group() -> None:
    robot = oc.Robot.from_urdf(*ARM)
    checker = oc.RobotScene({"left": robot, "right": robot}, bases=np.eye(2, 7) + np.eye(7)[[6, 6]])
    columns = [name.startswith("right/grip") for name in checker.joint_names]
    base = np.full(14, 0.2)
    full = checker.states_of_group("right/gripper", [[0.01], [0.02]], base)
    assert full[:, columns].tolist() == [[0.01], [0.02]]
    assert (full[:, ~np.array(columns)] == 0.2).all()
    one = checker.check([[0.01], [9.0]], group="right/gripper")
    assert one.out_of_limits.sum(axis=1).tolist() == [0, 1]
    with pytest.raises(KeyError, match="group must be one of the SRDF"):
        checker.check([[0.0]], group="gripper")
    with pytest.raises(ValueError, match=r"states must have shape .*the joints are right/grip"):
        checker.check([[0.0, 1.0]], group="right/gripper")
    with pytest.raises(ValueError, match="the joints are left/turn, left/shoulder_lift"):
        checker.check([[0.0, 1.0]])
