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

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import trimesh
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import random_poses
from scipy.spatial.transform import Rotation
from small_robots import SHAPES, random_arm, random_states, random_world

import obb_collision as oc
from obb_collision.geometry.poses import compose_poses
from obb_collision.typing import Floats

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
IDENTITY = [0, 0, 0, 0, 0, 0, 1]


def lift(scene: oc.Scene | None = None, **options: object) -> oc.RobotScene:
    return oc.RobotScene([oc.Robot.from_urdf(LIFT)], scene, **options)  # type: ignore[arg-type]


def brute_force(
    robot: oc.Robot,
    world: oc.Scene,
    state: np.ndarray,
    accuracy: str,
    skipped: set[tuple[str, str]],
    padding: float = 0.0,
) -> set[tuple[str, str]]:
    """Return the colliding pairs of links and objects, by a scene that has all of them."""
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


def rigid_pairs(robot: oc.Robot) -> set[tuple[str, str]]:
    """Return pairs of links between which no joint moves."""
    group = list(range(len(robot.link_names)))
    for row, parent in enumerate(robot.tree.parents.tolist()):
        if parent >= 0 and robot.tree.kinds[row] == 0:
            group[row] = group[parent]
    names = robot.link_names
    count = range(len(names))
    return {
        (min(names[i], names[j]), max(names[i], names[j]))
        for i in count
        for j in count
        if i != j and group[i] == group[j]
    }


@pytest.mark.parametrize("accuracy", ["obb", "hull"])
@settings(deadline=None, max_examples=12)
@given(seed=st.integers(0, 10**6), links=st.integers(2, 7), things=st.integers(0, 12))
def test_all_pairs_are_those_of_brute_force(
    accuracy: str, seed: int, links: int, things: int
) -> None:
    rng = np.random.default_rng(seed)
    robot = oc.Robot.from_urdf(random_arm(rng, links))
    world = random_world(rng, things)
    states = random_states(rng, robot, 4)
    report = oc.RobotScene([robot], world, accuracy).check(states, all_pairs=True)
    first = oc.RobotScene([robot], world, accuracy).check(states)
    assert np.array_equal(first.first_pairs, report.first_pairs)
    skipped = set(robot.disabled_pairs | robot.adjacent_pairs) | rigid_pairs(robot)
    for number, state in enumerate(states):
        wanted = brute_force(robot, world, state, accuracy, skipped)
        found = {(min(pair), max(pair)) for pair in report.pairs_of(number)}
        if accuracy == "hull":
            assert found == wanted
        else:  # spheres around the shapes' own points cull some pairs of boxes
            assert found <= wanted
        assert bool(report.valid[number]) == (not found)
        pair = report.pairs[number]
        assert (pair is None) == (not found)
        assert pair is None or (min(pair), max(pair)) in found


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10**6))
def test_a_cheaper_level_never_misses_what_a_dearer_one_reports(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = oc.Robot.from_urdf(random_arm(rng, 5))
    checker = oc.RobotScene([robot], random_world(rng, 8))
    states = random_states(rng, robot, 30)
    before = np.zeros(len(states), np.bool_)
    for level in ("mesh", "hull", "obb", "aabb", "sphere"):
        checker.accuracy = level
        now = checker.check(states).colliding
        assert not (before & ~now).any(), level
        before = now


def test_limits_are_reported_by_joint() -> None:
    report = lift().check([[1.0, 0.0], [-0.1, 2.0], [0.5, -1.0]])
    assert report.out_of_limits.tolist() == [[False, False], [True, True], [False, False]]
    assert report.valid.tolist() == [True, False, True]
    assert report.pairs == [None, None, None]


def test_self_collision_names_the_links() -> None:
    report = lift().check([[0.0, -0.5], [0.5, 0.0]])
    assert report.pairs == [("base", "hand"), None]
    assert repr(report) == "StateReport(1 of 2 states valid)"


def test_the_world_may_change_between_checks() -> None:
    scene = oc.Scene()
    checker = lift(scene)
    state = [[1.0, 0.5]]
    assert checker.check(state).valid[0]
    scene.add("shelf", oc.shapes.Box([0.2, 0.2, 0.2]), [1.0, 0, 1.0, 0, 0, 0, 1])
    assert checker.check(state).pairs == [("hand", "shelf")]
    scene.move("shelf", [1.0, 0, 3.0, 0, 0, 0, 1])
    assert checker.check(state).valid[0]
    scene.move("shelf", [1.0, 0, 1.0, 0, 0, 0, 1])
    assert not checker.check(state).valid[0]
    scene.allow("hand", "shelf")
    assert checker.check(state).valid[0]
    scene.allow("hand", "shelf", allowed=False)
    assert not checker.check(state).valid[0]
    scene.remove("shelf")
    assert checker.check(state).valid[0]


def test_rules_of_the_scene_count_for_links_among_themselves() -> None:
    scene = oc.Scene()
    scene.allow("hand", "base")
    assert lift(scene).check([[0.0, -0.5]]).valid[0]


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
    with pytest.raises(ValueError, match="link_objects must name links"):
        checker.link_objects = {"foot": ["hand/0"]}


def test_the_padding_of_objects_that_are_links_counts_for_them() -> None:
    scene = oc.Scene()
    checker, state = lift(scene), [[0.0, 0.5]]
    for name, x in (("hand/0", 1.0), ("crate", 2.0)):
        scene.add(name, oc.shapes.Box([0.1, 0.1, 0.1]), [x, 0, 0.5, 0, 0, 0, 1])
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
    scene = oc.Scene()
    scene.add("crate", oc.shapes.Box([0.2, 0.2, 0.2]), [3.0, 0, 0, 0, 0, 0, 1])
    checker = lift(scene)
    assert checker.distances([[0.0, 0.0]]).pairs == [("base", "hand")]
    found = checker.distances([[0.0, 0.0]], self_pairs=False)
    assert found.pairs == [("hand", "crate")]
    assert found.distances[0] == pytest.approx(2.3, abs=1e-6)


def test_padding_is_a_distance() -> None:
    scene = oc.Scene()
    scene.add("shelf", oc.shapes.Box([0.2, 0.2, 0.2]), [1.0, 0, 1.0, 0, 0, 0, 1])
    checker = lift(scene)
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
    scene = oc.Scene()
    scene.add("shelf", oc.shapes.Box([0.2, 0.2, 0.2]), [1.5, 0, 1.0, 0, 0, 0, 1])
    checker = lift(scene)
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
    bases = np.array([IDENTITY, [1.7, 0, 0, 0, 0, 1, 0]])  # the second one faces the first
    checker = oc.RobotScene({"a": robot, "b": robot}, bases=bases)
    assert checker.joint_names == ("a/lift", "a/out", "b/lift", "b/out")
    report = checker.check([[1, 0.2, 1, 0.2], [1, 0.3, 1.5, 0.3], [1, 0.3, 1, 0.3]])
    assert report.pairs == [None, None, ("a/hand", "b/hand")]


def test_robots_with_links_of_the_same_name_need_names() -> None:
    robot = oc.Robot.from_urdf(LIFT)
    with pytest.raises(ValueError, match="distinct names"):
        oc.RobotScene([robot, robot])


def test_far_from_the_origin_nothing_is_lost() -> None:
    scene = oc.Scene()
    x = 1e6
    scene.add("shelf", oc.shapes.Box([0.2, 0.2, 0.2]), [x + 1.0, 0, 1.0, 0, 0, 0, 1])
    checker = lift(scene, bases=[[x, 0, 0, 0, 0, 0, 1]])
    report = checker.check([[1.0, 0.3 + 1e-8], [1.0, 0.3 - 1e-8]])
    assert report.valid.tolist() == [False, True]


def test_far_from_the_origin_a_base_may_move() -> None:
    scene = oc.Scene()
    x = 1e6
    scene.add("shelf", oc.shapes.Box([0.2, 0.2, 0.2]), [x + 1.0, 0, 1.0, 0, 0, 0, 1])
    checker = lift(scene, bases=[[x, 0, 0, 0, 0, 0, 1]])
    for step in (0.0, 0.25, -0.5, 1.75, 2.5, 3.0, -40.0, -41.5):
        checker.bases = [[x + step, 0, 0, 0, 0, 0, 1]]
        out = 0.3 - step
        report = checker.check([[1.0, out + 1e-8], [1.0, out - 1e-8]])
        assert report.colliding.tolist() == [True, False], step
        distance = checker.distances([[1.0, out - 0.0625]], self_pairs=False).distances
        np.testing.assert_allclose(distance, [0.0625], atol=1e-9)


def test_threads_do_not_change_the_answer() -> None:
    rng = np.random.default_rng(5)
    robot = oc.Robot.from_urdf(random_arm(rng, 6))
    checker = oc.RobotScene([robot], random_world(rng, 10))
    states = random_states(rng, robot, 500)
    before = oc.threads()
    try:
        reports = [(oc.set_threads(n), checker.check(states, all_pairs=True))[1] for n in (1, 2, 3)]
    finally:
        oc.set_threads(before)
    for report in reports[1:]:
        assert np.array_equal(report.first_pairs, reports[0].first_pairs)
        assert report.all_pairs is not None
        assert reports[0].all_pairs is not None
        assert np.array_equal(report.all_pairs.pairs, reports[0].all_pairs.pairs)
        assert np.array_equal(report.all_pairs.states, reports[0].all_pairs.states)


@pytest.mark.parametrize("accuracy", ["obb", "hull"])
@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10**6), padding=st.floats(0.0, 0.3))
def test_padding_of_a_link_is_that_of_an_object(accuracy: str, seed: int, padding: float) -> None:
    # Boxes, which become larger boxes, and balls: what is the same in both to rounding.
    rng = np.random.default_rng(seed)
    robot, world = oc.Robot.from_urdf(random_arm(rng, 4, shapes=SHAPES[:2])), random_world(rng, 2)
    skipped = set(robot.disabled_pairs | robot.adjacent_pairs) | rigid_pairs(robot)
    states = random_states(rng, robot, 4)
    checker = oc.RobotScene([robot], world, accuracy, padding=padding)
    report, distances = checker.check(states, all_pairs=True), checker.distances(states).distances
    for number, state in enumerate(states):
        wanted = brute_force(robot, world, state, accuracy, skipped, padding)
        found = {(min(pair), max(pair)) for pair in report.pairs_of(number)}
        if accuracy == "hull":
            assert found == wanted
            assert (distances[number] <= 0.0) == bool(wanted)
        else:
            assert found <= wanted


@given(st.floats(-1.0, 1.0), st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))
def test_a_joint_that_mimics_another_has_limits_of_its_own(
    value: float, multiplier: float, offset: float, limit: float
) -> None:
    mimic = f'<mimic joint="lift" multiplier="{multiplier}" offset="{offset}"/>'
    ends = f'<limit lower="{min(limit, 0.0)}" upper="{max(limit, 0.0)}"'
    text = LIFT.replace('<limit lower="-1" upper="1"', mimic + ends).replace(
        '"0" upper', '"-1" upper'
    )
    robot = oc.Robot.from_urdf(text)
    out = oc.RobotScene([robot]).check([[value]]).out_of_limits
    exact = Fraction(multiplier) * Fraction(value) + Fraction(offset)
    beyond = max(exact - Fraction(max(limit, 0.0)), Fraction(min(limit, 0.0)) - exact)
    if not 0 < beyond <= 1e-14:  # else off by rounding
        assert out.tolist() == [[beyond > 0]]


def test_a_single_state_and_none_at_all() -> None:
    assert lift().check([1.0, 0.0]).valid.tolist() == [True]
    empty = lift().check(np.zeros((0, 2)), all_pairs=True)
    assert len(empty) == 0
    assert empty.pairs == []


def test_bad_states_and_unknown_links_are_refused_by_name() -> None:
    checker = lift()
    for states, words in (
        ([[0.0, np.nan]], "states"),
        ([[0.0, 0.0], [np.inf, 0.0]], "states.*1"),
        ([[0.0]], r"states must have shape \(n, 2\)"),
        ([[[0.0, 0.0]]], "states"),
        ("ab", "states"),
    ):
        with pytest.raises(ValueError, match=words):
            checker.check(states)
    with pytest.raises(ValueError, match="padding must name links, got 'hund'; did you mean hand"):
        checker.padding = {"hund": 0.1}
    with pytest.raises(ValueError, match="link must name links"):
        checker.attach("rod", oc.shapes.Sphere(0.1), "nowhere")
    with pytest.raises(ValueError, match="touch_links must name links"):
        checker.attach("rod", oc.shapes.Sphere(0.1), "hand", touch_links=["nowhere"])
    with pytest.raises(ValueError, match="padding must not be negative"):
        checker.padding = -1.0
    with pytest.raises(ValueError, match="accuracy"):
        checker.accuracy = "best"
    with pytest.raises(TypeError, match="robots"):
        oc.RobotScene(["no robot"])  # type: ignore[list-item]
    with pytest.raises(TypeError, match="shape"):
        checker.attach("rod", "a rod", "hand")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="not asked for all pairs"):
        checker.check([[0.0, 0.0]]).pairs_of(0)


CUP = """<robot name="cup">
  <link name="world"/>
  <link name="cup"><collision><geometry><mesh filename="cup.obj"/></geometry></collision></link>
  <joint name="x" type="prismatic"><parent link="world"/><child link="cup"/>
    <axis xyz="1 0 0"/><limit lower="-9" upper="9" velocity="1" effort="1"/></joint>
</robot>"""


def test_what_is_within_a_hull_may_be_outside_of_its_mesh(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.2, 1.0, 0.2))
    arms = [box.copy(), box.copy()]
    for arm, x in zip(arms, (-0.5, 0.5), strict=True):
        arm.apply_translation((x, 0.0, 0.0))
    trimesh.util.concatenate(arms).export(tmp_path / "cup.obj")
    (tmp_path / "cup.urdf").write_text(CUP)
    scene = oc.Scene()
    scene.add("ball", oc.shapes.Sphere(0.2), [10.0, 0, 0, 0, 0, 0, 1])
    scene.add("pole", oc.shapes.Box([0.2, 0.2, 2.0]), [-10.0, 0, 0, 0, 0, 0, 1])
    robot = oc.Robot.from_urdf(tmp_path / "cup.urdf")
    checker = oc.RobotScene([robot], scene, "mesh", bases=[[1.0, 0, 0, 0, 0, 0, 1]])
    states = [[9.0], [8.7], [-11.0], [-10.6], [0.0]]
    report = checker.check(states, all_pairs=True)
    assert report.pairs == [None, ("cup", "ball"), None, ("cup", "pole"), None]
    assert [report.pairs_of(n) for n in range(2)] == [[], [("cup", "ball")]]
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
    hand = matrix(base[0]) @ matrix(robot.link_poses(state)[-1])
    for name in scene.names:
        scene.move(name, from_matrix(hand @ matrix(random_poses(1, rng, 1.0)[0])))
        on_link = from_matrix(np.linalg.inv(hand) @ matrix(scene.pose(name)))
        checker.attach_object(name, link, state=state)
        expected.attach_object(name, link, on_link)
    assert checker.check(others, all_pairs=True).pairs == expected.check(others).pairs
    for both in ({}, {"pose": on_link, "state": state}):
        with pytest.raises(ValueError, match="pose, on the link, or state"):
            checker.attach_object(name, link, **both)


def matrix(pose: Floats) -> Floats:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
    return found


def from_matrix(given: Floats) -> Floats:
    return np.append(given[:3, 3], Rotation.from_matrix(given[:3, :3]).as_quat())


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
    with pytest.raises(ValueError, match="bases"):
        checker.bases = np.zeros((count, 6))


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
    for step in range(40):
        name = f"thing{rng.integers(15)}"
        pose = [*rng.normal(0, 0.5, 3), 0.0, 0.0, 0.6, 0.8]
        if step % 4 == 0:
            shapes = oc.shapes.Sphere(0.2), oc.shapes.Capsule(0.1, 0.3), oc.shapes.Cone(0.2, 0.2)
            scene.add(name, shapes[step // 4 % 3], pose)
        elif step % 4 == 1 and name in scene.names:
            scene.remove(name)
        elif name in scene.names:
            scene.move(name, pose)
            scene.set_padding(name, float(rng.uniform(0.0, 0.1)))
        found = checker.check(states).pairs
        assert found == oc.RobotScene([robot], scene).check(states).pairs
        seen.add(str(found))
    assert len(seen) > 10


def test_a_scene_with_obstacle_points_raises_until_they_are_none() -> None:
    scene = oc.Scene()
    checker = lift(scene)
    states = [[0.0, 0.0]]
    scene.obstacle_points = np.zeros((0, 3))
    assert checker.check(states).valid.all()
    scene.obstacle_points = [[0.5, 0.0, 0.0]]
    for ask in (
        lambda: lift(scene),
        lambda: checker.check(states),
        lambda: checker.distances(states),
        lambda: checker.check_motions(states, states),
        lambda: checker.check_path(states),
    ):
        with pytest.raises(ValueError, match=r"set scene\.obstacle_points = None"):
            ask()
    scene.obstacle_points = None
    assert checker.check(states).valid.all()
