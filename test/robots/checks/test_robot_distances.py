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

"""Least distances are those of brute force over all pairs, and agree with the checks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small_robots import SHAPES, cup, random_arm, random_states, random_world

import obb_collision as oc
from obb_collision.geometry.poses import compose_poses

BALL = """<robot name="ball">
  <link name="world"/>
  <link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="x" type="prismatic"><parent link="world"/><child link="ball"/>
    <axis xyz="1 0 0"/><limit lower="-9" upper="9" velocity="1" effort="1"/></joint>
</robot>"""


def ball(x: float = 0.0, **options: object) -> oc.RobotScene:
    """Return a ball on a line, and a wall whose face is at x = 1.1, both moved by x."""
    scene = oc.Scene()
    scene.add("wall", oc.shapes.Box([1, 1, 1]), [x + 1.6, 0, 0, 0, 0, 0, 1])
    robot = oc.Robot.from_urdf(BALL)
    return oc.RobotScene([robot], scene, bases=[[x, 0, 0, 0, 0, 0, 1]], **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("x", [0.0, 1e5])
def test_distance_points_and_direction(x: float) -> None:
    found = ball(x).distances([[0.0], [1.05], [0.5]])
    np.testing.assert_allclose(found.distances, [1.0, -0.05, 0.5], atol=1e-9)
    np.testing.assert_allclose(found.directions, [[1, 0, 0]] * 3, atol=1e-9)
    np.testing.assert_allclose(found.points[0], [[x + 0.1, 0, 0], [x + 1.1, 0, 0]], atol=1e-9)
    assert found.pairs == [("ball", "wall")] * 3
    assert (found.distances <= found.upper_bounds).all()


@pytest.mark.parametrize("accuracy", ["hull", "mesh"])
@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_upper_bounds_are_those_of_the_cylinder_itself(accuracy: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ball, cylinder = '<sphere radius="0.1"/>', '<cylinder radius="0.3" length="0.8"/>'
    turn, place = Rotation.random(None, rng), rng.uniform(-1.0, 1.0, 3)
    there = [*place, *turn.as_quat()]
    for link, back in ((ball, False), (cylinder, True)):
        scene = oc.Scene()
        scene.add("it", oc.shapes.Sphere(0.1) if back else oc.shapes.Cylinder(0.3, 0.8), there)
        robot = oc.Robot.from_urdf(BALL.replace(ball, link))
        found = oc.RobotScene([robot], scene, accuracy).distances([[0.0]])
        x, y, z = place if back else turn.inv().apply(-place)
        far = np.hypot(max(np.hypot(x, y) - 0.3, 0.0), max(abs(z) - 0.4, 0.0)) - 0.1
        assert found.distances[0] <= far + 1e-9
        assert found.upper_bounds[0] >= far - 1e-9
        assert found.upper_bounds[0] <= max(far, 0.0) + 0.013


def test_padding_lessens_distances() -> None:
    found = ball(padding=0.2).distances([[0.0]])
    np.testing.assert_allclose(found.distances, [0.8], atol=1e-9)


def test_what_is_farther_does_not_count() -> None:
    found = ball().distances([[0.0], [0.9]], max_distance=0.5)
    assert found.distances[0] == np.inf
    assert found.pairs == [None, ("ball", "wall")]
    assert np.isnan(found.points[0]).all()
    nothing = oc.RobotScene(oc.Robot.from_urdf(BALL)).distances([[0.0]])
    assert nothing.pairs == [None]
    assert nothing.distances.tolist() == [np.inf]


def test_bad_limits_are_refused() -> None:
    with pytest.raises(ValueError, match="max_distance must be positive"):
        ball().distances([[0.0]], max_distance=0.0)
    with pytest.raises(ValueError, match="configurations"):
        ball().distances([[np.nan]])


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10**6), boxes=st.booleans())
def test_distances_are_those_between_links_and_things(seed: int, boxes: bool) -> None:
    rng = np.random.default_rng(seed)
    robot = oc.Robot.from_urdf(random_arm(rng, 4, shapes=SHAPES if boxes else SHAPES[1:]))
    reach = 3.0**0.5 if boxes else 1.0  # of padding, at corners of boxes
    world = random_world(rng, 5)
    checker = oc.RobotScene([robot], world)
    states = random_states(rng, robot, 6)
    found, report = checker.distances(states), checker.check(states)
    assert np.array_equal(found.distances <= 0.0, report.colliding)
    for row in np.flatnonzero(found.distances > 1e-6):
        distance, normal = found.distances[row], found.directions[row]
        a, b = found.points[row]
        np.testing.assert_allclose(b - a, distance * normal, atol=1e-8)
        # nothing that is checked is nearer: grown by half of it, links do not even touch each other
        checker.padding = 0.5 * distance / reach * (1.0 - 1e-6)
        assert not checker.check(states[row]).colliding[0]
        checker.padding = distance * (1.0 + 1e-6)
        assert checker.check(states[row]).colliding[0]
    checker.padding = 0.0


@settings(deadline=None, max_examples=10, suppress_health_check=[*HealthCheck])
@given(seed=st.integers(0, 10**6))
def test_distances_of_meshes_are_those_of_brute_force(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    text = random_arm(rng, 3, shapes=(*SHAPES, *[cup(tmp_path)] * 4))
    (tmp_path / "arm.urdf").write_text(text)
    robot = oc.Robot.from_urdf(tmp_path / "arm.urdf")
    world = random_world(rng, 4)
    checker = oc.RobotScene([robot], world, "mesh")
    states = random_states(rng, robot, 6)
    hulls = oc.RobotScene([robot], world).distances(states)
    found = checker.distances(states)
    assert (found.distances >= hulls.distances - 1e-9).all()
    assert (found.upper_bounds >= found.distances - 1e-12).all()
    assert np.array_equal(found.distances <= 0.0, checker.check(states).colliding)
    for limit in (0.01, 0.1):
        near = checker.distances(states, max_distance=limit).distances
        beyond = found.distances > limit
        assert np.isinf(near[beyond]).all()
        np.testing.assert_allclose(near[~beyond], found.distances[~beyond], atol=1e-9)
    for row in np.flatnonzero(found.distances > 1e-6):
        a, b = found.points[row]
        np.testing.assert_allclose(b - a, found.distances[row] * found.directions[row], atol=1e-7)
        # nothing is nearer: padded by half of it links do not touch, by more than that they do
        checker.padding = 0.5 * found.distances[row] * (1.0 - 1e-6)
        assert not checker.check(states[row]).colliding[0]
        checker.padding = found.distances[row] * (1.0 + 1e-6)
        assert checker.check(states[row]).colliding[0]
    checker.padding = 0.0


@pytest.mark.parametrize("accuracy", ["sphere", "aabb", "obb"])
def test_below_hull_distances_are_those_of_boxes(accuracy: str) -> None:
    rng = np.random.default_rng(3)
    robot = oc.Robot.from_urdf(random_arm(rng, 4))
    world, states = random_world(rng, 5), random_states(rng, robot, 20)
    checker = oc.RobotScene([robot], world, accuracy)
    found = checker.distances(states, self_pairs=False)
    hulls = oc.RobotScene([robot], world).distances(states, self_pairs=False)
    assert (found.distances <= hulls.distances + 1e-9).all()
    for state, distance in zip(states, found.distances, strict=True):
        links = robot.link_poses(state[None])[0]
        own = oc.Scene()
        for link, placed in zip(links, robot.shapes, strict=True):
            for shape, pose in placed:
                own.add(f"shape{len(own)}", shape, compose_poses(link, pose))
        pairs = list(np.ndindex(len(own), len(world)))
        expected = oc.clearances(own.boxes, world.boxes, pairs).distances.min()
        assert distance == pytest.approx(expected, abs=1e-8)
