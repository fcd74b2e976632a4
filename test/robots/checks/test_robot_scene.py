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

"""RobotScene finds what a scene finds in which every shape of every link is an object."""

from __future__ import annotations

import pickle
from concurrent.futures import ProcessPoolExecutor
from fractions import Fraction
from itertools import combinations
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import random_poses
from small_robots import SHAPES, arm_in_world, cup, random_arm, random_states, random_world, slider
from support import by_threads, refused

import obb_collision as oc
from obb_collision.geometry.poses import compose_poses

LIFT = """<robot name="lift">
  <link name="base"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
  <link name="arm"><collision><geometry><box size="0.1 0.1 0.6"/></geometry></collision></link>
  <link name="hand"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="arm"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="2" velocity="1" effort="1"/></joint>
  <joint name="out" type="prismatic"><parent link="arm"/><child link="hand"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>"""
Pairs = set[tuple[str, str]]


def lift(scene: oc.Scene | None = None, **options: object) -> oc.RobotScene:
    return oc.RobotScene([oc.Robot.from_urdf(LIFT)], scene, **options)  # type: ignore[arg-type]


def with_box(name: str, x: float, z: float = 0.0, size: float = 0.2) -> oc.Scene:
    """Return a scene of a cube."""
    scene = oc.Scene()
    scene.add(name, oc.shapes.Box([size] * 3), [x, 0, z, 0, 0, 0, 1])
    return scene


def brute_force(
    robot: oc.Robot, world: oc.Scene, state: np.ndarray, accuracy: str, padding: float
) -> Pairs:
    """Return the colliding pairs of links and objects, by a scene that has all of them."""
    skipped = robot.disabled_pairs | robot.adjacent_pairs | rigid_pairs(robot)
    scene = oc.Scene(accuracy=accuracy)
    owner = {}
    for row, link in enumerate(robot.link_names):
        for number, (shape, pose) in enumerate(robot.shapes[row]):
            name = f"{link}#{number}"
            owner[name] = link
            where = compose_poses(robot.link_poses(state)[row], pose)
            scene.add(name, shape, where, padding=padding)
    for name in world.names:
        given = world.objects.shape_of(name)
        body = oc.shapes.Box(2 * given.half_extents) if isinstance(given, oc.OBB) else given
        scene.add(name, body, world.pose(name))
        owner[name] = name
    found = set()
    for one, other in scene.check().names():
        a, b = sorted((owner[one], owner[other]))
        world_only = a in world.names and b in world.names
        if a != b and not world_only and (a, b) not in skipped:
            found.add((a, b))
    return found


def overlapping(checker: oc.RobotScene, state: np.ndarray) -> Pairs:
    """Return the pairs whose hulls overlap."""
    near = checker.distances(state, max_distance=0.01, all_pairs=True)
    found = zip(near.pairs, near.distances, strict=True)
    return {(min(pair), max(pair)) for pair, distance in found if pair and distance <= 0.0}


def rigid_pairs(robot: oc.Robot) -> Pairs:
    """Return pairs of links between which no joint moves."""
    group: list[int] = []
    for row, (parent, kind) in enumerate(zip(robot.tree.parents, robot.tree.kinds, strict=True)):
        group.append(group[parent] if parent >= 0 and kind == 0 else row)
    pairs = combinations(zip(robot.link_names, group, strict=True), 2)
    return {(min(a, b), max(a, b)) for (a, one), (b, other) in pairs if one == other}


@pytest.mark.parametrize("accuracy", ["obb", "hull"])
@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 10**6), links=st.integers(2, 7), things=st.integers(0, 12),
    padding=st.one_of(st.just(0.0), st.floats(0.0, 0.3)),
)  # fmt: skip
def test_all_pairs_are_those_of_brute_force(
    accuracy: str, seed: int, links: int, things: int, padding: float
) -> None:
    """With padding boxes, which become larger boxes, and balls: the same in both to rounding."""
    rng = np.random.default_rng(seed)
    robot = oc.Robot.from_urdf(random_arm(rng, links, shapes=SHAPES[:2] if padding else SHAPES))
    world = random_world(rng, min(things, 2) if padding else things)
    states = random_states(rng, robot, 4)
    checker = oc.RobotScene([robot], world, accuracy, padding=padding)
    report, distances = (
        checker.check(states, all_pairs=True),
        checker.distances(states, still_pairs=True).distances,
    )
    assert np.array_equal(checker.check(states).first_pairs, report.first_pairs)
    for number, state in enumerate(states):
        wanted = brute_force(robot, world, state, accuracy, padding)
        found = {(min(pair), max(pair)) for pair in report.pairs_of(number)}
        if accuracy == "hull":  # which of round shapes may overlap where these do not
            assert wanted <= found <= wanted | overlapping(checker, state)
            assert distances[number] <= 0.0 or not wanted
        else:  # spheres around the shapes' own points cull some pairs of boxes
            assert found <= wanted
        assert bool(report.valid[number]) == (not found)
        pair = report.pairs[number]
        assert (pair is None) == (not found)
        assert pair is None or (min(pair), max(pair)) in found


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10**6))
def test_a_cheaper_level_never_misses_what_a_dearer_one_reports(seed: int) -> None:
    rng, robot, checker = arm_in_world(seed, 5, 8)
    states = random_states(rng, robot, 30)
    before = np.zeros(len(states), np.bool_)
    for level in ("mesh", "hull", "obb", "aabb", "sphere"):
        checker.accuracy = level
        now = checker.check(states).colliding
        assert not (before & ~now).any(), level
        before = now


def test_limits_are_reported_by_joint_and_links_that_collide_by_name_unless_they_may() -> None:
    report = lift().check([[1.0, 0.0], [-0.1, 2.0], [0.5, -1.0]])
    assert report.out_of_limits.tolist() == [[False, False], [True, True], [False, False]]
    assert report.valid.tolist() == [True, False, True]
    assert report.pairs == [None, None, None]
    report = lift().check([[0.0, -0.5], [0.5, 0.0]])
    assert report.pairs == [("base", "hand"), None]
    assert repr(report) == "StateReport(1 of 2 states valid)"
    scene = oc.Scene()
    scene.allow("hand", "base")
    assert lift(scene).check([[0.0, -0.5]]).valid[0]
    assert lift().check([1.0, 0.0]).valid.tolist() == [True], "a single state"
    empty = lift().check(np.zeros((0, 2)), all_pairs=True)
    assert len(empty) == len(empty.pairs) == 0


def test_objects_that_are_links_are_no_obstacles_and_have_their_rules() -> None:
    scene = oc.Scene()
    for name in ("hand/0", "hand/1", "crate"):
        scene.add(name, oc.shapes.Box([0.1, 0.1, 0.1]), [1.0, 0, 0, 0, 0, 0, 1])
    checker, state = lift(scene), [[0.0, 0.5]]
    checker.link_objects = {"hand": ["hand/0", "hand/1"]}
    assert checker.link_objects == {"hand": ("hand/0", "hand/1")}
    assert checker.check(state, all_pairs=True).pairs_of(0) == [("hand", "crate")]
    scene.allow("hand/0", "crate")
    assert checker.check(state).pairs == [("hand", "crate")]  # the other one may not
    scene.allow("crate", "hand/1")
    assert checker.check(state).pairs == [None]
    checker.link_objects = {}
    assert checker.check(state).colliding.all()


def test_the_padding_of_objects_that_are_links_counts_for_them() -> None:
    scene, state = with_box("crate", 2.0, 0.5, 0.1), [[0.0, 0.5]]
    scene.add("hand/0", oc.shapes.Box([0.1, 0.1, 0.1]), [1.0, 0, 0.5, 0, 0, 0, 1])
    checker = lift(scene)
    checker.link_objects = {"hand": ["hand/0", "gone"]}
    assert checker.check(state).valid[0]
    room = checker.distances(state, max_distance=9.0, self_pairs=False).distances[0]
    scene.objects.padding_overrides = [("hand/*", 0.1)]
    padded = checker.distances(state, max_distance=9.0, self_pairs=False).distances[0]
    assert padded == pytest.approx(room - 0.1, abs=1e-6)
    scene.objects.padding_overrides = [("hand/*", room + 1e-3)]
    assert checker.check(state).pairs == [("hand", "crate")]
    assert not checker.check_motions(state, state).valid[0]
    checker.link_objects = {}
    scene.remove("hand/0")
    assert checker.check(state).valid[0]


def test_distances_may_leave_out_pairs_of_links() -> None:
    checker = lift(with_box("crate", 3.0))
    assert checker.distances([[0.0, 0.0]]).pairs == [("base", "hand")]
    found = checker.distances([[0.0, 0.0]], self_pairs=False)
    assert found.pairs == [("hand", "crate")]
    assert found.distances[0] == pytest.approx(2.3, abs=1e-6)


def test_padding_is_a_distance() -> None:
    checker = lift(with_box("shelf", 1.0, 1.0))
    state = [[1.0, 0.25]]  # 0.05 between hand and shelf
    assert checker.check(state).valid[0]
    checker.padding = {"hand": 0.049}
    assert checker.check(state).valid[0]
    checker.padding = {"hand": 0.051}
    assert checker.check(state).pairs == [("hand", "shelf")]
    assert checker.padding == {"base": 0.0, "arm": 0.0, "hand": 0.051}
    checker.padding = 0.0
    assert checker.check(state).valid[0]


def test_what_is_attached_moves_along_and_may_touch_some_links() -> None:
    checker = lift(with_box("shelf", 1.5, 1.0))
    state = [[1.0, 0.5]]
    rod = oc.shapes.Box([0.6, 0.02, 0.02])
    checker.attach("rod", rod, "hand", [0.3, 0, 0, 0, 0, 0, 1])
    assert checker.attached == {"rod": "hand"}
    assert checker.check(state).pairs == [("rod", "shelf")]
    checker.attach("rod", rod, "hand", [-0.3, 0, 0, 0, 0, 0, 1])
    assert checker.check(state).pairs == [("arm", "rod")]
    checker.attach("rod", rod, "hand", [-0.3, 0, 0, 0, 0, 0, 1], touch_links="arm")
    assert checker.check(state).valid[0]
    checker.detach("rod")
    assert checker.check(state).valid[0]
    assert checker.attached == {}
    with pytest.raises(KeyError, match="'rod'"):
        checker.detach("rod")


def test_robots_are_checked_against_each_other() -> None:
    robot = oc.Robot.from_urdf(LIFT)
    bases = np.array([[0] * 6 + [1], [1.7, 0, 0, 0, 0, 1, 0]])  # the second one faces the first
    checker = oc.RobotScene({"a": robot, "b": robot}, bases=bases)
    assert checker.joint_names == ("a/lift", "a/out", "b/lift", "b/out")
    report = checker.check([[1, 0.2, 1, 0.2], [1, 0.3, 1.5, 0.3], [1, 0.3, 1, 0.3]])
    assert report.pairs == [None, None, ("a/hand", "b/hand")]


def test_far_from_the_origin_a_base_may_move() -> None:
    x = 1e6
    checker = lift(with_box("shelf", x + 1.0, 1.0), bases=[[x, 0, 0, 0, 0, 0, 1]])
    for step in (0.0, 0.25, -0.5, 1.75, 2.5, 3.0, -40.0, -41.5):
        checker.bases = [[x + step, 0, 0, 0, 0, 0, 1]]
        out = 0.3 - step
        report = checker.check([[1.0, out + 1e-8], [1.0, out - 1e-8]])
        assert report.colliding.tolist() == [True, False], step
        distance = checker.distances([[1.0, out - 0.0625]], self_pairs=False).distances
        np.testing.assert_allclose(distance, [0.0625], atol=1e-9)


def test_threads_do_not_change_the_answer() -> None:
    rng, robot, checker = arm_in_world(5, 6, 10)
    states = random_states(rng, robot, 500)
    reports = by_threads(lambda: checker.check(states, all_pairs=True), 1, 2, 3)
    one, *others = [(r.first_pairs.tolist(), [r.pairs_of(n) for n in range(500)]) for r in reports]
    assert others == [one, one]


@given(st.floats(-1.0, 1.0), st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))
def test_a_joint_that_mimics_another_has_limits_of_its_own(
    value: float, multiplier: float, offset: float, limit: float
) -> None:
    mimic = f'<mimic joint="lift" multiplier="{multiplier}" offset="{offset}"/>'
    ends = f'<limit lower="{min(limit, 0.0)}" upper="{max(limit, 0.0)}"'
    text = LIFT.replace('<limit lower="-1" upper="1"', mimic + ends)
    robot = oc.Robot.from_urdf(text.replace('"0" upper', '"-1" upper'))
    out = oc.RobotScene([robot]).check([[value]]).out_of_limits
    exact = Fraction(multiplier) * Fraction(value) + Fraction(offset)
    beyond = max(exact - Fraction(max(limit, 0.0)), Fraction(min(limit, 0.0)) - exact)
    if not 0 < beyond <= 1e-14:  # else off by rounding
        assert out.tolist() == [[beyond > 0]]


def test_bad_states_and_unknown_links_are_refused_by_name() -> None:
    checker = lift()
    refused("states.*1", checker.check, [[0.0, 0.0], [np.inf, 0.0]])
    refused(r"states must have shape \(n, 2\)", checker.check, [[0.0]])
    refused("states", checker.check, [[[0.0, 0.0]]])
    refused("states", checker.check, "ab")
    hund = "padding must name links, got 'hund'; did you mean hand"
    refused(hund, setattr, checker, "padding", {"hund": 0.1})
    refused("padding must not be negative", setattr, checker, "padding", -1.0)
    refused("accuracy", setattr, checker, "accuracy", "best")
    named = "link_objects must name links"
    refused(named, setattr, checker, "link_objects", {"foot": ["hand/0"]})
    ball = oc.shapes.Sphere(0.1)
    refused("link must name links", checker.attach, "rod", ball, "nowhere")
    refused("touch_links must name links", checker.attach, "rod", ball, "hand", touch_links=["x"])
    refused("all pairs were not requested", checker.check([[0.0, 0.0]]).pairs_of, 0)
    refused("distinct names", oc.RobotScene, [checker.robots[0]] * 2)
    with pytest.raises(TypeError, match="robots"):
        oc.RobotScene(["no robot"])  # type: ignore[list-item]
    with pytest.raises(TypeError, match="shape"):
        checker.attach("rod", "a rod", "hand")  # type: ignore[arg-type]


def test_what_is_within_a_hull_may_be_outside_of_its_mesh(tmp_path: Path) -> None:
    (tmp_path / "cup.urdf").write_text(slider(cup(tmp_path)))
    scene = oc.Scene()
    scene.add("ball", oc.shapes.Sphere(0.05), [10.0, 0, 0, 0, 0, 0, 1])
    scene.add("pole", oc.shapes.Box([0.1, 0.1, 2.0]), [-10.0, 0, 0, 0, 0, 0, 1])
    robot = oc.Robot.from_urdf(tmp_path / "cup.urdf")
    checker = oc.RobotScene([robot], scene, "mesh", bases=[[1.0, 0, 0, 0, 0, 0, 1]])
    states = [[9.0], [8.9], [-11.0], [-10.9], [0.0]]
    report = checker.check(states, all_pairs=True)
    assert report.pairs == [None, ("body", "ball"), None, ("body", "pole"), None]
    assert [report.pairs_of(n) for n in range(2)] == [[], [("body", "ball")]]
    checker.accuracy = "hull"
    assert checker.check(states).colliding.tolist() == [True, True, True, True, False]


def test_an_object_of_the_scene_is_no_obstacle_while_it_is_attached() -> None:
    rng = np.random.default_rng(11)
    robot = oc.Robot.from_urdf(random_arm(rng, 3))
    scene, states = random_world(rng, 5), random_states(rng, robot, 300)
    checker, expected = oc.RobotScene([robot], scene), oc.RobotScene([robot])
    link, pose = robot.link_names[-1], [0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0]
    before = checker.check(states)
    places = scene.objects.poses_of(range(5))
    for number in range(5):
        name = f"thing{number}"
        checker.attach_object(name, link, pose)
        expected.attach(name, scene.objects.shape_of(name), link, pose)
    found = checker.check(states)
    assert found.pairs == expected.check(states).pairs
    assert found.pairs != before.pairs
    scene.move("thing3", [0, 0, 0, 0, 0, 0, 1])  # it is no part of the world
    assert checker.check(states).pairs == found.pairs
    for number in range(5):
        checker.detach(f"thing{number}")
    scene.move("thing3", places[3])
    assert checker.check(states).pairs == before.pairs
    with pytest.raises(KeyError, match="nothing"):
        checker.attach_object("nothing", link, pose)


@each("seed", range(4))
def test_an_object_of_the_scene_is_grasped_where_it_is(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = oc.Robot.from_urdf(random_arm(rng, 3))
    scene, (state, *others) = random_world(rng, 5), random_states(rng, robot, 100)
    base = random_poses(1, rng, 300.0)  # so far that bodies are relative to a place nearby
    checker, expected = (oc.RobotScene([robot], scene, bases=base) for _ in range(2))
    link = robot.link_names[-1]
    hand = compose_poses(base[0], robot.link_poses(state)[-1])
    for name in scene.names:
        on_link = random_poses(1, rng, 1.0)[0]
        scene.move(name, compose_poses(hand, on_link))
        checker.attach_object(name, link, state=state)
        expected.attach_object(name, link, on_link)
    assert checker.check(others, all_pairs=True).pairs == expected.check(others).pairs
    for both in ({}, {"pose": on_link, "state": state}):
        refused("pose .on the link. or state", checker.attach_object, name, link, **both)


@each("count", [1, 2])
def test_bases_that_are_set_are_as_those_of_a_new_one(count: int) -> None:
    rng = np.random.default_rng(count)
    robot = oc.Robot.from_urdf(random_arm(rng, 5))
    scene = random_world(rng, 10)
    robots = {f"r{number}": robot for number in range(count)}
    states = np.hstack([random_states(rng, robot, 200) for _ in robots])
    checker = oc.RobotScene(robots, scene)
    kept = set()
    for _ in range(4):
        bases = np.hstack([rng.normal(0, 0.5, (count, 3)), rng.normal(size=(count, 4))])
        checker.bases = bases
        report = checker.check(states)
        new = oc.RobotScene(robots, scene, bases=bases).check(states)
        np.testing.assert_array_equal(report.valid, new.valid)
        assert report.pairs == new.pairs
        kept.add(str(report.pairs))
    assert len(kept) == 4
    refused("bases", setattr, checker, "bases", np.zeros((count, 6)))


def test_only_what_counts_of_the_scene_makes_the_world_anew() -> None:
    rng = np.random.default_rng(3)
    robot = oc.Robot.from_urdf(random_arm(rng, 3))
    scene = random_world(rng, 5)
    scene.add("own", oc.shapes.Box((0.1, 0.1, 0.1)))
    checker = oc.RobotScene([robot], scene)
    checker.link_objects = {robot.link_names[0]: ["own"]}
    state = checker.world_state()
    scene.move("own", [5, 0, 0, 0, 0, 0, 1])
    assert state.is_current(scene)
    scene.move("thing2", [5, 0, 0, 0, 0, 0, 1])
    assert not state.is_current(scene)


def test_a_world_of_which_parts_change_is_as_a_new_one() -> None:
    rng = np.random.default_rng(8)
    robot = oc.Robot.from_urdf(random_arm(rng, 4))
    scene, states = random_world(rng, 15), random_states(rng, robot, 60)
    checker, seen = oc.RobotScene([robot], scene), set()
    found, pair = checker.check(states).pairs, ("", "")
    for step in range(60):
        name = f"thing{rng.integers(15)}"
        pose = [*rng.normal(0, 0.5, 3), 0.0, 0.0, 0.6, 0.8]
        if step % 4 == 0:
            shapes = oc.shapes.Sphere(0.2), oc.shapes.Capsule(0.1, 0.3), oc.shapes.Cone(0.2, 0.2)
            scene.add(name, shapes[step // 4 % 3], pose)
        elif step % 4 == 1 and name in scene.names:
            scene.remove(name)
        elif step % 4 == 2:  # what has just collided, and again
            pair = next(filter(None, found)) if step % 8 == 2 else pair
            scene.allow(*pair, allowed=step % 8 == 2)
        elif name in scene.names:
            scene.move(name, pose)
            if step % 8 == 3:
                scene.set_padding(name, float(rng.uniform(0.0, 0.1)))
        found = checker.check(states).pairs
        assert found == oc.RobotScene([robot], scene).check(states).pairs
        seen.add(str(found))
    assert len(seen) > 10


def test_points_are_obstacles_for_robots_as_a_cloud_and_not_where_they_are_watched() -> None:
    scene, states, points = oc.Scene(), [[0.0, 0.0]], [[0.5, 0.0, 0.0]]
    scene.obstacle_points = points
    checker = lift(scene)
    assert checker.check(states).valid.all()
    scene.add("cloud", oc.shapes.Cloud(points))
    assert not checker.check(states).valid.any()


def robot_answers(checker: oc.RobotScene, states: np.ndarray) -> list[Any]:
    found = checker.distances(states, max_distance=1.0, jacobian=True)
    motions = checker.check_motions(states[:-1], states[1:])
    poses = checker.robots[0].link_poses(states)
    values = [poses, found.distances, found.jacobians, found.points, motions.fractions]
    report = checker.check(states)
    return [report.pairs, motions.pairs, *(np.asarray(value).tobytes() for value in values)]


def test_a_pickled_robot_scene_gives_the_same_bit_for_bit_in_another_process() -> None:
    description = oc.load_scene("arm_cell")
    arm = description.robots[0]
    checker = oc.RobotScene({"arm": arm.robot}, description.build(), padding=0.01, bases=[arm.pose])
    checker.attach("cup", oc.shapes.Sphere(0.02), "arm/hand", [0, 0, 0.2, 0, 0, 0, 1])
    checker.bases = [[0.3, 0.1, 0.75, 0, 0, 0, 1]]  # relative to where it was
    rng = np.random.default_rng(1)
    states = rng.uniform(-1.0, 1.0, (40, len(checker.joint_names)))
    here = robot_answers(checker, states)
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        assert pool.submit(robot_answers, checker, states).result() == here
    robot = pickle.loads(pickle.dumps(arm.robot))
    assert not robot.tree.parents.flags.writeable
    assert robot.disabled_pairs == arm.robot.disabled_pairs
    shape = pickle.loads(pickle.dumps(oc.shapes.Hull(np.eye(3))))
    assert shape == oc.shapes.Hull(np.eye(3))
    assert not shape.points.flags.writeable
