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

"""A robot meets a cloud as it meets as many spheres, in reports under one name."""

from __future__ import annotations

import gc
import sys
from pathlib import Path

import numpy as np
import pytest
from small_robots import SHAPES, cup, random_arm, random_states, slider
from support import refused

import obb_collision as oc
from obb_collision.geometry.poses import compose_poses

POSE = np.array([0.1, -0.2, 0.05, 0.5, -0.5, 0.5, 0.5])
LEVELS = "sphere", "aabb", "obb", "hull", "mesh"


def points_about(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.asarray(rng.normal(0, 0.6, (count, 3)))


def as_spheres(
    scene: oc.Scene, points: np.ndarray, radius: float, pose: np.ndarray, padding: float
) -> oc.Scene:
    """Return a scene of an object for each point; of no radius: a box without a size."""
    places = compose_poses(
        pose, np.column_stack([points, np.tile([0, 0, 0, 1.0], (len(points), 1))])
    )
    for number, point in enumerate(places[:, :3]):
        shape = oc.shapes.Sphere(radius) if radius else oc.shapes.Box([0, 0, 0])
        scene.add(f"cloud#{number}", shape, [*point, 0, 0, 0, 1], padding=padding)
    return scene


def twins(
    rng: np.random.Generator, accuracy: str, radius: float, robot: oc.Robot | None = None
) -> tuple[oc.RobotScene, oc.RobotScene]:
    """Return a robot among a cloud and a box, and among as many spheres and the box."""
    robot = robot or oc.Robot.from_urdf(random_arm(rng, 5))
    points, padding = points_about(rng, 40), float(rng.choice([0.0, 0.02])) if radius else 0.0
    scenes = oc.Scene(), oc.Scene()
    scenes[0].add("cloud", oc.shapes.Cloud(points, radius), POSE, padding=padding)
    as_spheres(scenes[1], points, radius, POSE, padding)
    for scene in scenes:
        scene.add("crate", oc.shapes.Box([0.3, 0.2, 0.1]), [0.5, 0.5, 0, 0, 0, 0, 1])
    one, other = (oc.RobotScene([robot], scene, accuracy) for scene in scenes)
    return one, other


def plain(pairs: list[tuple[str, str]]) -> set[tuple[str, str]]:
    return {(a.split("#")[0], b.split("#")[0]) for a, b in pairs}


@pytest.mark.parametrize("radius", [0.0, 0.03])
@pytest.mark.parametrize("accuracy", LEVELS)
@pytest.mark.parametrize("seed", range(4))
def test_a_cloud_collides_as_its_spheres_do(seed: int, accuracy: str, radius: float) -> None:
    rng = np.random.default_rng(seed)
    one, other = twins(rng, accuracy, radius)
    states = random_states(rng, one.robots[0], 20)
    mine, truth = one.check(states, all_pairs=True), other.check(states, all_pairs=True)
    for n in range(len(states)):
        found = mine.pairs_of(n)
        assert len(found) == len(set(found))
        assert set(found) == plain(truth.pairs_of(n))
        pair = one.check(states[n]).pairs[0]
        assert pair in found if found else pair is None


@pytest.mark.parametrize(
    ("accuracy", "radius"),
    [("obb", 0.0), ("hull", 0.0), ("hull", 0.03), ("mesh", 0.0), ("mesh", 0.03)],
)
def test_distances_are_those_of_the_spheres(accuracy: str, radius: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    kinds = [cup(tmp_path), *SHAPES[:2]] if accuracy == "mesh" else SHAPES
    one, other = twins(
        rng,
        accuracy,
        radius,
        oc.Robot.from_urdf(random_arm(rng, 4, shapes=kinds), package_dirs=[tmp_path]),
    )
    states = random_states(rng, one.robots[0], 30)
    for limit in (np.inf, 0.2):
        mine = one.distances(states, max_distance=limit, jacobian=True)
        truth = other.distances(states, max_distance=limit, jacobian=True)
        assert np.allclose(mine.distances, truth.distances, atol=1e-9)
        for n in np.flatnonzero(np.isfinite(truth.distances)).tolist():
            assert plain([mine.pairs[n]]) == plain([truth.pairs[n]])  # type: ignore[list-item]
            if truth.distances[n] > 1e-6:
                assert np.allclose(mine.points[n], truth.points[n], atol=1e-6)
                assert np.allclose(mine.jacobians[n], truth.jacobians[n], atol=1e-6)  # type: ignore[index]
    mine = one.distances(states, max_distance=0.2, all_pairs=True)
    truth = other.distances(states, max_distance=0.2, all_pairs=True)
    least: dict[tuple[int, str, str], float] = {}
    for state, pair, distance in zip(truth.states, truth.pairs, truth.distances, strict=True):
        (key,) = plain([pair])  # type: ignore[list-item]
        row = int(state), *key
        least[row] = min(least.get(row, np.inf), distance)
    rows = zip(mine.states.tolist(), mine.pairs, strict=True)
    found = dict(zip(((n, *pair) for n, pair in rows), mine.distances, strict=True))  # type: ignore[misc]
    assert len(found) == len(mine.states)
    assert found.keys() == least.keys()
    assert all(abs(found[key] - least[key]) < 1e-9 for key in found)


@pytest.mark.parametrize("accuracy", ["obb", "hull", "mesh"])
@pytest.mark.parametrize("first", [False, True])
def test_motions_called_free_are_free(accuracy: str, first: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    kinds = [cup(tmp_path), *SHAPES[:2]] if accuracy == "mesh" else SHAPES
    robot = oc.Robot.from_urdf(random_arm(rng, 4, shapes=kinds), package_dirs=[tmp_path])
    one, other = twins(rng, accuracy, 0.01, robot)
    starts = random_states(rng, robot, 200)
    ends = starts + rng.uniform(-0.3, 0.3, starts.shape)
    mine = one.check_motions(starts, ends, first=first)
    truth = other.check_motions(starts, ends, first=first)
    assert 5 < mine.colliding.sum() < 195
    assert np.array_equal(mine.valid, truth.valid)
    assert (mine.undecided & mine.colliding).sum() <= 2
    if first:
        assert np.allclose(mine.fractions, truth.fractions, atol=1e-3, equal_nan=True)
    for n in np.flatnonzero(~mine.colliding)[:20].tolist():
        share = np.linspace(0, 1, 60)[:, None]
        assert not one.check(starts[n] + share * (ends[n] - starts[n])).colliding.any()
    path = one.check_path(starts[:5])
    assert np.array_equal(path.valid, one.check_motions(starts[:4], starts[1:5]).valid)


def test_rules_left_out_objects_and_attached_ones_hold_for_clouds() -> None:
    robot = oc.Robot.from_urdf(slider('<box size="0.2 0.2 0.2"/>'))
    scene = oc.Scene()
    scene.add("cloud", oc.shapes.Cloud(np.array([[0, 0, 0], [0.05, 0, 0], [5, 0, 0]])))
    scene.add("empty", oc.shapes.Cloud(np.full((3, 3), np.nan)))
    checker = oc.RobotScene([robot], scene)
    report = checker.check([[0.0], [1.0], [4.95]], all_pairs=True)
    assert report.pairs == [("body", "cloud"), None, ("body", "cloud")]
    assert report.pairs_of(0) == [("body", "cloud")]
    checker.attach("cup", oc.shapes.Sphere(0.1), "body", [1, 0, 0, 0, 0, 0, 1])
    assert checker.check([[3.95]]).pairs == [("cup", "cloud")]
    scene.allow("cup", "cloud")
    assert checker.check([[3.95]]).valid.all()
    checker.link_objects = {"body": ["cloud"]}
    assert checker.check([[0.0]]).valid.all()
    checker.link_objects = {}
    scene.set_padding("cloud", 0.5)
    assert checker.check([[0.55]]).pairs == [("body", "cloud")]
    seen = oc.shapes.Cloud([[0, 0, 0]])
    refused("shape must not be a Cloud", checker.attach, "seen", seen, "body")


def test_a_replaced_or_moved_cloud_is_seen_at_once() -> None:
    robot = oc.Robot.from_urdf(slider('<box size="0.2 0.2 0.2"/>'))
    scene = oc.Scene()
    scene.add("cloud", oc.shapes.Cloud([[9, 0, 0]]))
    scene.add("ball", oc.shapes.Sphere(0.1), [0, 5, 0, 0, 0, 0, 1])
    checker = oc.RobotScene([robot], scene)
    for at in np.linspace(0, 3, 20):
        scene.set_shape("cloud", oc.shapes.Cloud(np.tile([at, 0, 0], (int(3 + 10 * at), 1))))
        assert checker.check([[at], [at + 0.5]]).pairs == [("body", "cloud"), None]
        scene.move("cloud", [0.5, 0, 0, 0, 0, 0, 1])
        assert checker.check([[at], [at + 0.5]]).pairs == [None, ("body", "cloud")]
        scene.move("cloud", [0, 0, 0, 0, 0, 0, 1])
    blocks = 0
    for number in range(60):
        if number == 30:
            gc.collect()
            blocks = sys.getallocatedblocks()
        scene.set_shape("cloud", oc.shapes.Cloud(np.full((50, 3), 50.0 + number)))
        assert checker.check([[3.0]]).valid.all()
    gc.collect()
    assert sys.getallocatedblocks() < blocks + 500, "old clouds are forgotten"
    scene.set_shape("cloud", oc.shapes.Cloud(np.zeros((0, 3))))
    assert checker.check([[3.0]]).valid.all()
    scene.remove("cloud")
    assert checker.check([[3.0]]).valid.all()


@pytest.mark.parametrize("accuracy", ["obb", "hull"])
def test_balls_are_round_on_all_levels_with_distances(accuracy: str) -> None:
    """The nearest ball lies beyond a corner of a box; there its bounds would be nearer."""
    robot = oc.Robot.from_urdf(slider('<box size="0.2 0.2 0.2"/>'))
    scene = oc.Scene()
    scene.add("cloud", oc.shapes.Cloud([[0.4, 0.4, 0.4], [0.5, 0.5, 0.5]], 0.1))
    checker = oc.RobotScene([robot], scene, accuracy, padding=0.0)
    found = checker.distances([0.0], jacobian=True)
    wanted = np.sqrt(3 * 0.3**2) - 0.1
    assert found.distances == pytest.approx(wanted, abs=1e-9)
    assert found.jacobians == pytest.approx(-np.sqrt(1 / 3), abs=1e-6)
    inside = checker.distances([0.4])
    assert inside.distances[0] == pytest.approx(np.sqrt(2 * 0.3**2) - 0.1, abs=1e-9)


def gaps_to(
    checker: oc.RobotScene, state: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """Return (n, b) distances of segments (n,) from the hulls of the bodies of a robot."""
    robot, scene = checker.robots[0], oc.Scene(accuracy="hull")
    bodies: list[str] = []
    for frame, placed in zip(robot.link_poses(state), robot.shapes, strict=True):
        for shape, pose in placed:
            bodies.append(f"body{len(bodies)}")
            scene.add(bodies[-1], shape, compose_poses(frame, pose))
    for n, (a, b) in enumerate(zip(starts, ends, strict=True)):
        length = float(np.linalg.norm(b - a))
        axis = (b - a) / length if length else np.array([0, 0, 1.0])
        turn = np.append(np.cross([0, 0, 1.0], axis), 1.0 + axis[2])
        where = np.concatenate([0.5 * (a + b), turn / np.linalg.norm(turn)])
        scene.add(f"ray{n}", oc.shapes.Capsule(1e-9, max(length, 1e-9)), where)
    scene.check_only([(body, f"ray{n}") for body in bodies for n in range(len(starts))])
    scene.set_effect("clearance", max_distance=100.0)
    report = scene.check("clearance")
    gaps = np.full((len(starts), len(bodies)), np.nan)
    names, found = report.slot_names, report.clearances
    for pair, gap in zip(found.pairs.tolist(), found.distances, strict=True):
        body, ray = sorted(str(names[slot]) for slot in pair)
        gaps[int(ray[3:]), bodies.index(body)] = gap
    assert np.isfinite(gaps).all()
    return gaps


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("padding", [0.0, 0.05])
def test_own_points_are_in_links_or_behind_them(seed: int, padding: float) -> None:
    rng = np.random.default_rng(seed)
    robot = oc.Robot.from_urdf(random_arm(rng, 4, shapes=(SHAPES[0], SHAPES[1], SHAPES[3])))
    checker = oc.RobotScene([robot])
    (state,) = random_states(rng, robot, 1)
    points = np.concatenate([points_about(rng, 150), rng.normal(0, 0.2, (50, 3))])
    truth = gaps_to(checker, state, points, points).min(axis=1) - padding
    found = checker.own_points(state, points.astype(np.float32), padding)
    assert np.array_equal(found[np.abs(truth) > 1e-6], truth[np.abs(truth) > 1e-6] < 0)
    assert 2 < found.sum() < 195
    for sensor in (np.array([1.0, 1.0, 1.0]), robot.link_poses(state)[1, :3]):
        eyes = np.tile(sensor, (len(points), 1))
        own, (in_it,) = (
            gaps_to(checker, state, points, points),
            gaps_to(checker, state, sensor[None], sensor[None]),
        )
        rays = gaps_to(checker, state, eyes, points)
        rays[:, in_it < padding] += padding  # in the padding alone: hidden by the shape itself
        rays[:, in_it < 0] = np.inf
        truth = np.minimum(own, rays).min(axis=1) - padding
        clear = np.abs(truth) > 1e-6
        found = checker.own_points(state, points, padding, sensor)
        assert np.array_equal(found[clear], truth[clear] < 0)


def test_own_points_with_bases_attached_objects_and_bad_points() -> None:
    robot = oc.Robot.from_urdf(slider('<box size="0.2 0.2 0.2"/>'))
    checker = oc.RobotScene([robot], bases=[[100, 0, 0, 0, 0, 0, 1]], padding=0.01)
    checker.attach("cup", oc.shapes.Sphere(0.1), "body", [1, 0, 0, 0, 0, 0, 1])
    points = [[101.105, 0, 0], [102.11, 0, 0], [102.115, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]]
    assert checker.own_points([1.0], points).tolist() == [True, True, False, False, False]
    behind = checker.own_points([1.0], points, 0.01, [99.0, 0, 0])
    assert behind.tolist() == [True, True, True, False, False]
    assert checker.own_points([1.0], np.empty((0, 3))).shape == (0,)
    refused("padding", checker.own_points, [1.0], points, -1.0)
    refused("sensor must have shape", checker.own_points, [1.0], points, 0.0, [1.0])
    refused("state must have shape", checker.own_points, [1.0, 2.0], points)
