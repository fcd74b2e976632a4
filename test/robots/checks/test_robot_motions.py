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

"""Motions are checked between their ends; distances, their gradients, and groups of joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from each import each
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small_robots import (
    LIMIT,
    SHAPES,
    arm_in_world,
    cup,
    joint,
    link,
    random_arm,
    random_states,
    random_world,
    slider,
    urdf,
)
from support import by_threads, refused

import obb_collision as oc
from obb_collision.geometry.poses import compose_poses

MOBILE = """<robot name="mobile">
  <link name="world"/>
  <link name="base"><collision><geometry><box size="0.4 0.2 0.1"/></geometry></collision></link>
  <link name="drone"><collision><geometry><box size="0.3 0.1 0.05"/></geometry></collision></link>
  <joint name="drive" type="planar"><parent link="world"/><child link="base"/>
    <axis xyz="0 0 1"/></joint>
  <joint name="fly" type="floating"><parent link="base"/><child link="drone"/></joint>
</robot>"""
BALL = slider('<sphere radius="0.1"/>')
ROTOR = """<robot name="rotor">
  <link name="world"/>
  <link name="blade"><collision><origin xyz="0.5 0 0"/>
    <geometry><box size="1 0.1 0.1"/></geometry></collision></link>
  <joint name="turn" type="continuous"><parent link="world"/><child link="blade"/>
    <axis xyz="0 0 1"/></joint>
</robot>"""
SAMPLES = 400


def ball(gap: float = 0.0, wall: bool = False) -> oc.RobotScene:
    """Return a ball that slides along a floor at a gap, maybe to a wall at 1."""
    scene = oc.Scene()
    scene.add("floor", oc.shapes.Box([30, 1, 1]), [0, 0, -0.6 - gap, 0, 0, 0, 1])
    if wall:
        scene.add("wall", oc.shapes.Box([1, 1, 1]), [1.6, 0, 0, 0, 0, 0, 1])
    return oc.RobotScene([oc.Robot.from_urdf(BALL)], scene)


def sampled(checker: oc.RobotScene, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return (n,) where the first of many states of each motion collides, NaN for none."""
    times = np.linspace(0.0, 1.0, SAMPLES)
    states = starts[:, None] + times[None, :, None] * (ends - starts)[:, None]
    found = checker.check(states.reshape(-1, starts.shape[1])).colliding.reshape(-1, SAMPLES)
    return np.where(found.any(axis=1), times[found.argmax(axis=1)], np.nan)


def compare(checker: oc.RobotScene, starts: np.ndarray, ends: np.ndarray) -> int:
    """Compare with samples; return how many motions collide."""
    report = checker.check_motions(starts, ends, first=True)
    first = sampled(checker, starts, ends)
    collides = ~np.isnan(first)
    assert report.colliding[collides].all()
    assert (report.fractions[collides] <= first[collides] + 1e-12).all()
    assert np.array_equal(np.isnan(report.fractions), ~report.colliding)
    certain = report.colliding & ~report.undecided
    for row in np.flatnonzero(certain & ~collides):  # between two samples
        t = report.fractions[row] + np.geomspace(1e-7, 1e-1, 600)
        near = starts[row] + t[t <= 1.0, None] * (ends[row] - starts[row])
        assert checker.check(near).colliding.any(), "neither sampled nor near the parameter"
    return int(collides.sum())


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10**6))
def test_no_collision_of_fine_samples_is_missed(seed: int) -> None:
    rng, robot, checker = arm_in_world(seed, 5, 6)
    starts = random_states(rng, robot, 8)
    ends = starts + rng.choice((0.05, 1.0)) * (random_states(rng, robot, 8) - starts)
    compare(checker, starts, ends)


@each("accuracy", ["sphere", "aabb", "obb", "hull"])
@each("seed", [0, 3, 5])
def test_motions_on_a_level_are_those_of_its_states(accuracy: str, seed: int) -> None:
    rng, robot, checker = arm_in_world(seed, 5, 3, accuracy)
    states = random_states(rng, robot, 400)
    starts = states[checker.check(states).valid][:40]
    ends = starts + rng.choice((0.05, 0.5), (len(starts), 1)) * (states[: len(starts)] - starts)
    collides = compare(checker, starts, ends)
    report = checker.check_motions(starts, ends)
    assert len(starts) > 20
    assert report.valid.sum() >= 0.9 * (len(starts) - collides)
    any_, first = (checker.check_motions(starts, ends, first=where) for where in (False, True))
    assert np.array_equal(any_.valid, first.valid)
    found = any_.colliding & ~any_.undecided
    at = any_.fractions[found, None]
    assert checker.check(starts[found] + at * (ends - starts)[found]).colliding.all()
    assert (first.fractions[found] <= any_.fractions[found]).all()


@settings(deadline=None, max_examples=6, suppress_health_check=[*HealthCheck])
@given(seed=st.integers(0, 10**6))
def test_no_collision_of_meshes_is_missed(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    text = random_arm(rng, 3, shapes=(*SHAPES, cup(tmp_path)))
    (tmp_path / "arm.urdf").write_text(text)
    checker = oc.RobotScene([oc.Robot.from_urdf(tmp_path / "arm.urdf")], random_world(rng, 4))
    starts, ends = (random_states(rng, checker.robots[0], 8) for _ in range(2))
    hulls = checker.check_motions(starts, ends, first=True)
    checker.accuracy = "mesh"
    compare(checker, starts, ends)
    found = checker.check_motions(starts, ends, first=True)
    assert not (found.colliding & ~hulls.colliding).any()
    both, checker.accuracy = found.colliding, "hull"
    at = starts + found.fractions[:, None] * (ends - starts)
    if both.any():  # within the resolution of motions, for either body of a pair
        assert (checker.distances(at[both]).distances <= 2e-4).all()


def test_a_pole_passes_between_bars_that_their_hull_joins(tmp_path: Path) -> None:
    scene = oc.Scene()
    scene.add("pole", oc.shapes.Cylinder(0.05, 1.0), [0, 2, 0, 0, 0, 0, 1])
    (tmp_path / "cup.urdf").write_text(slider(cup(tmp_path), "0 1 0"))
    checker = oc.RobotScene([oc.Robot.from_urdf(tmp_path / "cup.urdf")], scene, "hull")
    assert not checker.check_motions([[0.0]], [[4.0]]).valid[0]
    checker.accuracy = "mesh"
    assert checker.check_motions([[0.0]], [[4.0]]).valid[0]
    checker.padding = 0.07  # the pole, a prism of many sides, is 0.074 from either bar
    assert checker.check_motions([[0.0]], [[4.0]]).valid[0]
    checker.padding = 0.08
    report = checker.check_motions([[0.0]], [[4.0]], first=True)
    assert report.pairs == [("body", "pole")]
    assert not report.undecided[0]
    # where a corner at x = 0.125, y = 0.2 is 0.13 from the middle of the pole
    assert 1.755 < 4.0 * report.fractions[0] <= 1.8 - np.sqrt(0.13**2 - 0.125**2)


def test_a_mesh_without_faces_counts_as_its_box(tmp_path: Path) -> None:
    points = np.random.default_rng(1).normal(0, 0.1, (5, 3))
    shape, reports = oc.shapes.Mesh(points, np.empty((0, 3), np.int64)), []
    (tmp_path / "cup.urdf").write_text(slider(cup(tmp_path), "0 1 0"))
    robot = oc.Robot.from_urdf(tmp_path / "cup.urdf")
    states = np.linspace(-3.0, 3.0, 40)[:, None]

    def answers(checker: oc.RobotScene) -> list[np.ndarray]:
        motions = checker.check_motions(states[:-1], states[1:])
        return [checker.check(states).valid, checker.distances(states).distances, motions.valid]

    for thing in (shape, oc.OBB(*shape.local_box)):
        scene = oc.Scene()
        scene.add("annulus", oc.shapes.Mesh(trimesh.creation.annulus(0.2, 0.3, 0.4)))
        checker = oc.RobotScene([robot], scene, "mesh")
        checker.attach("thing", thing, "body", [0, 0, 0.4, 0, 0, 0, 1])
        reports.append(answers(checker))
    scene = oc.Scene()
    scene.add("thing", shape, [0, 2, 0, 0, 0, 0, 1])
    levels = [answers(oc.RobotScene([robot], scene, accuracy)) for accuracy in ("hull", "mesh")]
    for pair in (reports, levels):
        assert all(np.allclose(a, b, atol=1e-9) for a, b in zip(*pair, strict=True))
        assert 0 < pair[0][0].sum() < 40


def test_planar_and_floating_joints_are_bounded_and_no_quaternion_goes_through_zero() -> None:
    rng = np.random.default_rng(2)
    checker = oc.RobotScene([oc.Robot.from_urdf(MOBILE)], random_world(rng, 6))
    states = rng.normal(0, 0.7, (2, 80, len(checker.joint_names)))
    assert 10 < compare(checker, *states) < 80
    start = np.array([0, 0, 0, 0, 0, 1.0, 0, 0, 0, 1])
    end = start * [1, 1, 1, 1, 1, 1, 1, 1, 1, -1]
    reason = r"ends must not have quaternions opposite .* row 1"
    refused(reason, checker.check_motions, [start, start], [start, end])


def test_where_a_ball_first_touches_a_wall_and_which_motion_of_a_path_is_bad() -> None:
    checker = ball(0.5, wall=True)
    report = checker.check_motions([[0.0], [0.0], [1.5]], [[2.0], [0.9], [0.0]], first=True)
    assert report.pairs == [("body", "wall"), None, ("body", "wall")]
    # the face of the wall is at x = 1.1
    assert report.fractions[0] == pytest.approx(0.5, abs=1e-4)
    assert report.fractions[0] <= 0.5
    assert report.fractions[2] == 0.0
    assert not report.undecided.any()
    assert report.first_invalid == 0
    assert checker.check_path([[0.0], [0.5], [0.9]]).first_invalid is None
    report = checker.check_path([[0.0], [0.5], [2.8], [0.0]], first=True)
    assert report.first_invalid == 1
    assert report.fractions[1] == pytest.approx((1.0 - 0.5) / 2.3, abs=1e-4)
    assert checker.check_path([[0.5]]).valid.tolist() == [True]
    assert checker.check_path([[1.5]]).valid.tolist() == [False]


def test_near_misses_are_undecided_by_the_resolution() -> None:
    assert ball(1e-9).check_motions([[0.0]], [[1.0]]).valid[0]  # a straight line is no near miss
    scene = oc.Scene()
    reach = np.hypot(1.0, 0.05)  # of the corners of the blade
    scene.add("wall", oc.shapes.Box([1, 1, 1]), [0.5 + reach + 1e-5, 0, 0, 0, 0, 0, 1])
    checker = oc.RobotScene([oc.Robot.from_urdf(ROTOR)], scene)
    loose = checker.check_motions([[-1.0]], [[1.0]], resolution=0.01)
    assert loose.undecided.tolist() == [True]
    assert loose.valid.tolist() == [False]
    assert loose.pairs == [("blade", "wall")]
    fine = checker.check_motions([[-1.0]], [[1.0]])
    assert fine.valid.tolist() == [True]


@each("accuracy", ["hull", "mesh"])
@each("turns", [1e7, 1e12, 1e300])
def test_what_turns_too_often_beside_something_is_undecided(accuracy: str, turns: float) -> None:
    scene = oc.Scene()
    scene.add("wall", oc.shapes.Box([1, 1, 1]), [1.6, 0, 0, 0, 0, 0, 1])
    checker = oc.RobotScene([oc.Robot.from_urdf(ROTOR)], scene, accuracy)
    report = checker.check_motions([[0.0], [0.0]], [[turns], [7.0]])
    assert report.valid.tolist() == [False, True]
    assert report.undecided.tolist() == [True, False]
    assert report.pairs[0] == ("blade", "wall")


def column(*shapes: str) -> oc.RobotScene:
    """Return a robot on a table: a base, a column that turns about itself, and an arm on that."""
    text = urdf(
        link("base", '<box size="0.2 0.2 0.1"/>'), link("column", *shapes),
        link("arm", '<box size="0.1 0.1 0.1"/>'),
        joint("turn", "continuous", "base", "column", '<origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>'),
        joint("slide", "prismatic", "column", "arm",
              f'<origin xyz="0 0 0.5"/><axis xyz="1 0 0"/>{LIMIT}'),
    )  # fmt: skip
    scene = oc.Scene()
    scene.add("table", oc.shapes.Box([2, 2, 0.02]), [0, 0, -0.07, 0, 0, 0, 1])
    return oc.RobotScene([oc.Robot.from_urdf(text)], scene)


@pytest.mark.parametrize(
    ("shape", "still"),
    [
        ('<cylinder radius="0.1" length="0.1"/>', True),
        ('<capsule radius="0.02" length="0.05"/>', True),
        ('<sphere radius="0.06"/>', True),
        ('<box size="0.1 0.1 0.1"/>', False),
    ],
)
@pytest.mark.parametrize("accuracy", ["obb", "hull", "mesh"])
def test_pairs_whose_distance_no_joint_changes_are_left_out(
    shape: str, still: bool, accuracy: str
) -> None:
    checker = column(shape)
    checker.accuracy = accuracy
    state = [[0.4, 0.0]]
    everything = checker.distances(state, still_pairs=True)
    assert everything.pairs == [("base", "table")]
    alone = checker.distances(state, self_pairs=False, jacobian=True)
    assert alone.pairs == [("arm" if still else "column", "table")]
    near = checker.distances(state, max_distance=9.0, all_pairs=True)
    assert ("base", "table") in near.pairs
    checker.scene.move("table", [0, 0, 0, 0, 0, 0, 1])  # it still collides
    assert checker.check(state).pairs == [("base", "table")]


def test_two_bases_that_stand_are_left_out_and_joints_count_by_robot() -> None:
    checker = column('<sphere radius="0.01"/>')
    robot = checker.robots[0]
    bases = [[x, 0, 0, 0, 0, 0, 1] for x in (0.0, 0.3)]
    both = oc.RobotScene({"a": robot, "b": robot}, bases=bases)
    state = [[0.0, 0.0, 0.0, 0.0]]
    assert both.distances(state, still_pairs=True).pairs == [("a/base", "b/base")]
    assert both.distances(state).pairs == [("a/arm", "b/arm")]


def test_motions_out_of_limits_are_not_valid() -> None:
    report = ball(0.5).check_motions([[0.0], [0.0]], [[10.0], [1.0]])
    assert report.out_of_limits.tolist() == [[True], [False]]
    assert report.colliding.tolist() == [False, False]
    assert report.valid.tolist() == [False, True]
    assert report.pairs == [("x", "out of limits"), None]
    assert repr(report) == "MotionReport(1 of 2 valid, 1 out of limits)"


def test_threads_do_not_change_motions() -> None:
    rng, robot, checker = arm_in_world(7, 5, 6)
    starts, ends = random_states(rng, robot, 60), random_states(rng, robot, 60)
    reports = by_threads(lambda: checker.check_motions(starts, ends), 1, 2)
    assert np.array_equal(reports[0].first_pairs, reports[1].first_pairs)
    assert np.array_equal(reports[0].fractions, reports[1].fractions, equal_nan=True)


def test_bad_motions_are_refused_by_name() -> None:
    checker = ball()
    refused("starts and ends", checker.check_motions, [[0.0]], [[0.0], [1.0]])
    refused("ends", checker.check_motions, [[0.0]], [[np.nan]])
    refused("resolution must be pos", checker.check_motions, [[0.0]], [[1.0]], resolution=0.0)
    refused("must not be empty", checker.check_path, np.zeros((0, 1)))
    refused("max_distance must be positive", checker.distances, [[0.0]], max_distance=0.0)
    refused("states", checker.distances, [[np.nan]])


def walled(x: float = 0.0, **options: object) -> oc.RobotScene:
    """Return a ball on a line, and a wall whose face is at x = 1.1, both moved by x."""
    scene = oc.Scene()
    scene.add("wall", oc.shapes.Box([1, 1, 1]), [x + 1.6, 0, 0, 0, 0, 0, 1])
    robot = oc.Robot.from_urdf(BALL)
    return oc.RobotScene([robot], scene, bases=[[x, 0, 0, 0, 0, 0, 1]], **options)  # type: ignore[arg-type]


@each("x", [0.0, 1e5])
def test_distance_points_and_direction(x: float) -> None:
    found = walled(x).distances([[0.0], [1.05], [0.5]])
    np.testing.assert_allclose(found.distances, [1.0, -0.05, 0.5], atol=1e-9)
    np.testing.assert_allclose(found.directions, [[1, 0, 0]] * 3, atol=1e-9)
    np.testing.assert_allclose(found.points[0], [[x + 0.1, 0, 0], [x + 1.1, 0, 0]], atol=1e-9)
    assert found.pairs == [("body", "wall")] * 3
    assert (found.distances <= found.upper_bounds).all()


@pytest.mark.parametrize("accuracy", ["hull", "mesh"])
@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_upper_bounds_are_those_of_the_cylinder_itself(accuracy: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, place = Rotation.random(None, rng), rng.uniform(-1.0, 1.0, 3)
    there = [*place, *turn.as_quat()]
    for text, back in ((BALL, False), (slider('<cylinder radius="0.3" length="0.8"/>'), True)):
        scene = oc.Scene()
        scene.add("it", oc.shapes.Sphere(0.1) if back else oc.shapes.Cylinder(0.3, 0.8), there)
        found = oc.RobotScene([oc.Robot.from_urdf(text)], scene, accuracy).distances([[0.0]])
        x, y, z = place if back else turn.inv().apply(-place)
        far = np.hypot(max(np.hypot(x, y) - 0.3, 0.0), max(abs(z) - 0.4, 0.0)) - 0.1
        assert found.distances[0] <= far + 1e-9
        assert found.upper_bounds[0] >= far - 1e-9
        assert found.upper_bounds[0] <= max(far, 0.0) + 0.013


def test_padding_lessens_distances_and_what_is_farther_does_not_count() -> None:
    found = walled(padding=0.2).distances([[0.0]])
    np.testing.assert_allclose(found.distances, [0.8], atol=1e-9)
    found = walled().distances([[0.0], [0.9]], max_distance=0.5)
    assert found.distances[0] == np.inf
    assert found.pairs == [None, ("body", "wall")]
    assert np.isnan(found.points[0]).all()
    nothing = oc.RobotScene(oc.Robot.from_urdf(BALL)).distances([[0.0]])
    assert nothing.pairs == [None]
    assert nothing.distances.tolist() == [np.inf]


REACH = 3.0**0.5
"""How far padding reaches at corners of boxes; at edges of cylinders less."""


def check_nearest(checker: oc.RobotScene, states: np.ndarray, found: Any) -> None:
    """Check points, and that nothing is nearer: where padded by half of it, links do not touch.

    Where they are padded by the upper bound they do.
    """
    assert (found.distances[checker.check(states).colliding] <= 0.0).all()
    for row in np.flatnonzero(found.distances > 1e-6):
        distance, (a, b) = found.distances[row], found.points[row]
        np.testing.assert_allclose(b - a, distance * found.directions[row], atol=1e-8)
        for padding, collides in ((0.5 * distance / REACH * (1.0 - 1e-6), False),
                                  (found.upper_bounds[row] * (1.0 + 1e-6), True)):  # fmt: skip
            checker.padding = padding
            assert checker.check(states[row]).colliding[0] == collides
    checker.padding = 0.0


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10**6), boxes=st.booleans())
def test_distances_are_those_between_links_and_things(seed: int, boxes: bool) -> None:
    rng = np.random.default_rng(seed)
    robot = oc.Robot.from_urdf(random_arm(rng, 4, shapes=SHAPES if boxes else SHAPES[1:]))
    world = random_world(rng, 5)
    checker = oc.RobotScene([robot], world)
    states = random_states(rng, robot, 6)
    check_nearest(checker, states, checker.distances(states, still_pairs=True))


@settings(deadline=None, max_examples=10, suppress_health_check=[*HealthCheck])
@given(seed=st.integers(0, 10**6), boxes=st.booleans())
def test_distances_of_meshes_are_as_by_brute_force(seed: int, boxes: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    text = random_arm(rng, 3, shapes=(*SHAPES[not boxes :], *[cup(tmp_path)] * 4))
    (tmp_path / "arm.urdf").write_text(text)
    robot = oc.Robot.from_urdf(tmp_path / "arm.urdf")
    world = random_world(rng, 4)
    checker = oc.RobotScene([robot], world, "mesh")
    states = random_states(rng, robot, 6)
    hulls = oc.RobotScene([robot], world).distances(states, still_pairs=True)
    found = checker.distances(states, still_pairs=True)
    assert (found.distances >= hulls.distances - 1e-9).all()
    assert (found.upper_bounds >= found.distances - 1e-12).all()
    for limit in (0.01, 0.1):
        near = checker.distances(states, max_distance=limit, still_pairs=True).distances
        beyond = found.distances > limit
        assert np.isinf(near[beyond]).all()
        np.testing.assert_allclose(near[~beyond], found.distances[~beyond], atol=1e-9)
    check_nearest(checker, states, found)


@each("accuracy", ["sphere", "aabb", "obb"])
def test_below_hull_distances_are_those_of_boxes(accuracy: str) -> None:
    rng = np.random.default_rng(3)
    robot = oc.Robot.from_urdf(random_arm(rng, 4))
    world, states = random_world(rng, 5), random_states(rng, robot, 20)
    checker = oc.RobotScene([robot], world, accuracy)
    found = checker.distances(states, self_pairs=False, still_pairs=True)
    hulls = oc.RobotScene([robot], world).distances(states, self_pairs=False, still_pairs=True)
    assert (found.distances <= hulls.distances + 1e-9).all()
    for state, distance in zip(states, found.distances, strict=True):
        links = robot.link_poses(state[None])[0]
        own = oc.Scene()
        for frame, placed in zip(links, robot.shapes, strict=True):
            for shape, pose in placed:
                own.add(f"shape{len(own)}", shape, compose_poses(frame, pose))
        pairs = list(np.ndindex(len(own), len(world)))
        expected = oc.clearances(own.boxes, world.boxes, pairs).distances.min()
        assert distance == pytest.approx(expected, abs=1e-8)


STEP = 1e-6
NEAR = 2.0


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
    steps = STEP * np.concatenate([np.eye(joints), -np.eye(joints)])
    moved = (states[:, None] + steps).reshape(-1, joints)
    found = checker.distances(moved, max_distance=NEAR, all_pairs=True)
    ends: list[dict[object, float]] = [{} for _ in moved]
    for state, pair, distance in zip(found.states, found.pairs, found.distances, strict=True):
        ends[state][pair] = distance
    for row in np.flatnonzero(every.distances > 1e-3):
        first, pair = 2 * joints * every.states[row], every.pairs[row]
        around = ends[first : first + 2 * joints]
        if all(pair in end for end in around):
            there = np.array([end[pair] for end in around]).reshape(2, joints)
            slopes = (there[0] - there[1]) / (2.0 * STEP)
            errors.append(np.abs(every.jacobians[row] - slopes).max())
    assert len(errors) >= 40
    assert np.mean(np.array(errors) < 1e-7) >= 0.9  # others are where the closest features change
    assert np.abs(every.jacobians[every.distances > 1e-3]).max() > 0.01
    least = checker.distances(states, max_distance=NEAR, jacobian=True, still_pairs=True)
    assert least.jacobians is not None
    for at in np.flatnonzero((least.distances > 1e-3) & (least.distances < NEAR)):
        rows = [k for k in np.flatnonzero(every.states == at) if every.pairs[k] == least.pairs[at]]
        same = every.jacobians[rows]
        np.testing.assert_allclose(least.jacobians[at : at + 1], same, rtol=0, atol=1e-6)


@each("accuracy", ["obb", "hull", "mesh"])
def test_distances_of_every_pair(accuracy: str) -> None:
    rng, robot, checker = arm_in_world(5, 5, 5, accuracy)
    states = random_states(rng, robot, 20)
    least = checker.distances(states, max_distance=0.3, still_pairs=True)
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
    refused("all_pairs=True needs max_distance", checker.distances, states, all_pairs=True)


def test_states_of_a_group() -> None:
    robot = oc.Robot.from_urdf("config/arm.urdf", "config/arm.srdf")
    checker = oc.RobotScene({"left": robot, "right": robot}, bases=np.eye(2, 7) + np.eye(7)[[6, 6]])
    columns = [name.startswith("right/grip") for name in checker.joint_names]
    base = np.full(14, 0.2)
    full = checker.states_of_group("right/gripper", [[0.01], [0.02]], base)
    assert full[:, columns].tolist() == [[0.01], [0.02]]
    assert (full[:, ~np.array(columns)] == 0.2).all()
    one = checker.check([[0.01], [9.0]], group="right/gripper")
    assert one.out_of_limits.sum(axis=1).tolist() == [0, 1]
    with pytest.raises(KeyError, match="group must be a group of the SRDF"):
        checker.check([[0.0]], group="gripper")
    joints = r"states must have shape .*the joints are right/grip"
    refused(joints, checker.check, [[0.0, 1.0]], group="right/gripper")
    refused("the joints are left/turn, left/shoulder_lift", checker.check, [[0.0, 1.0]])
