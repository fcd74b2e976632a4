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

"""Robots in a made room, beside every point of its cloud: states, motions, and the self-filter.

``--pairs 20000`` checks that many states, a tenth of that of motions, and a hundredth of frames. A
Panda and a UR5 are checked where ``example-robot-data`` is installed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from cloud_oracle import box_distance, capsule_distance, cylinder_distance, triangle_distances
from scipy.spatial import ConvexHull, cKDTree
from small_robots import random_states

import obb_collision as oc
from obb_collision.geometry.poses import as_poses, compose_poses
from obb_collision.scene_files import find_scene
from obb_collision.typing import Floats, Mask
from tools.clouds import room
from tools.robot_motions import ends_of, free_states, sampled
from tools.robots import default_robot

ROBOTS = "arm", "panda", "ur5"
POINTS, RADIUS, LENGTH, PADDING = 20_000, 0.01, 0.3, 0.02
#: Of states and motions that are free, at most this share may not be called so.
DOUBTED = 0.003
#: The camera of the frames, and how far a point beyond the padding may be lost, metres.
CAMERA, CORNERS = ((48, 64), 52.0), 1e-6


@cache
def robot_of(name: str) -> oc.Robot:
    """Return a robot; skip the test where it is not installed."""
    urdf, srdf, share = default_robot()
    if name == "arm":
        config = find_scene("tabletop").parent
        return oc.Robot.from_urdf(config / "arm.urdf", config / "arm.srdf", [config])
    if share.name != "share":
        pytest.skip("example-robot-data is not installed")
    if name == "panda":
        return oc.Robot.from_urdf(urdf, srdf, [share])
    ur5 = share / "example-robot-data/robots/ur_description"
    return oc.Robot.from_urdf(ur5 / "urdf/ur5_robot.urdf", ur5 / "srdf/ur5.srdf", [share])


@cache
def room_points() -> Floats:
    """Return the points of the room, of a camera with fewer pixels."""
    return room.room_points(POINTS, 1, ((320, 320), 190.0)).astype(np.float64)


def gaps_of(shape: oc.shapes.Shape, reach: float) -> Callable[[Floats], Floats]:
    """Return signed distances (n,) of points from a shape, or a lower bound beyond the reach."""
    if isinstance(shape, oc.shapes.Box):
        return box_distance(0.5 * np.array(shape.size))
    if isinstance(shape, (oc.shapes.Sphere, oc.shapes.Capsule)):
        return capsule_distance(shape.radius, getattr(shape, "length", 0.0))
    if isinstance(shape, oc.shapes.Cylinder):
        return cylinder_distance(shape.radius, shape.length)
    hull = ConvexHull(room.points_of(shape))

    def gaps(points: Floats) -> Floats:
        found = np.asarray((points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1))
        near = (found > 0.0) & (found <= reach)
        found[near] = triangle_distances(hull.points[hull.simplices], points[near])
        return found

    return gaps


def touched(robot: oc.Robot, states: Floats, points: Floats, radius: float) -> Mask:
    """Return (n,) in which states a ball about one of the points touches a link."""
    tree, result, poses = cKDTree(points), np.zeros(len(states), np.bool_), robot.link_poses(states)
    for link, placed in enumerate(robot.shapes):
        for shape, pose in placed:
            gaps, (center, _, half) = gaps_of(shape, radius), shape.local_box
            reach = float(np.linalg.norm(half) + radius) + 1e-9
            positions, turns = as_poses(compose_poses(poses[:, link], np.asarray(pose)))
            middles = positions + turns @ center
            for n in np.flatnonzero(~result).tolist():
                near = points[tree.query_ball_point(middles[n], reach)]
                if len(near):
                    result[n] = (gaps((near - positions[n]) @ turns[n]) <= radius).any()
    return result


def checker_of(robot: oc.Robot, radius: float) -> oc.RobotScene:
    """Return a robot in the room, of which only pairs with the cloud count."""
    scene = oc.Scene()
    scene.add("camera", oc.shapes.Cloud(room_points(), radius))
    scene.check_only([("camera", "*")])
    return oc.RobotScene([robot], scene)


@pytest.mark.parametrize("radius", [0.0, RADIUS])
@pytest.mark.parametrize("name", ROBOTS)
def test_no_state_is_called_free_that_touches_a_point(name: str, radius: float, pairs: int) -> None:
    robot = robot_of(name)
    states = random_states(np.random.default_rng(2), robot, max(100, pairs // 6))
    truth = touched(robot, states, room_points(), radius)
    found = checker_of(robot, radius).check(states).colliding
    assert 0.02 < truth.mean() < 0.98
    assert not (truth & ~found).any()
    assert (found & ~truth).sum() <= np.ceil(DOUBTED * (~truth).sum())


@pytest.mark.parametrize("name", ROBOTS)
def test_no_motion_is_called_free_that_collides_at_a_sample(name: str, pairs: int) -> None:
    robot, rng = robot_of(name), np.random.default_rng(3)
    checker = checker_of(robot, RADIUS)
    starts = free_states(checker, max(60, pairs // 30), rng)
    ends = ends_of(robot, starts, LENGTH, rng)
    truth, found = sampled(checker, starts, ends), checker.check_motions(starts, ends).valid
    assert truth.any()
    assert not (truth & found).any()
    assert (~truth & ~found).sum() <= np.ceil(DOUBTED * (~truth).sum())


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_the_self_filter_keeps_what_is_foreign_and_nothing_of_the_robot(
    name: str, pairs: int
) -> None:
    """Each ray says what it met: the robot, or the room, which may be behind the robot."""
    robot, rng = robot_of(name), np.random.default_rng(4)
    checker, ways = oc.RobotScene([robot]), room.pixel_rays(*CAMERA)
    kept = owned = 0
    for state in random_states(rng, robot, max(2, pairs // 200)):
        hulls = room.placed_hulls(robot, state)
        eye, turn = room.camera_pose(np.array(room.EYE) + rng.uniform(-0.1, 0.1, 3))
        there = ways @ turn.T
        onto, beyond = room.see(hulls, eye, there), room.see(room.room(), eye, there)
        own = onto.ranges < beyond.ranges
        noise = rng.uniform(-0.5, 0.5, len(ways)) * PADDING / np.linalg.norm(there, axis=1)
        robots = eye + (onto.ranges + noise)[own, None] * there[own]
        rooms = eye + beyond.ranges[:, None] * there
        assert checker.own_points(state, robots, PADDING).all()
        assert checker.own_points(state, rooms[own], PADDING, eye).all()
        lost = checker.own_points(state, rooms, PADDING, eye)
        larger = [room.Solid(one.normals, one.offsets + PADDING + CORNERS) for one in hulls]
        reached = room.see(larger, eye, there).ranges <= beyond.ranges
        assert not lost[~reached].any()
        assert not checker.own_points(state, rooms, PADDING)[~reached].any()
        kept, owned = kept + int((~lost).sum()), owned + int(own.sum())
    assert owned > 20
    assert kept > 10 * owned
