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

"""Robots in the node: links are objects, and what is not known is named and never free."""

from __future__ import annotations

import pickle
from functools import partial
from itertools import permutations
from pathlib import Path
from threading import Event
from threading import enumerate as enumerate_threads
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import trimesh
from each import each
from objects_rig import Gate, ObjectsRig
from rig import LATCHED, OUTPUTS, STATUS, FakeFrames, Patch, Rig, cube, pose, spy
from robot_rig import CRATE, EDGES, HAND, HERE, SRDF, URDF, AskingRig, RobotRig, box, joint
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

import obb_collision as oc
from obb_collision import Robot
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.node import named_clearances, named_predictions
from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.table import COLUMNS
from obb_collision.node.robots import AttachedObjects, LinkObjects
from obb_collision.node.robots import links as links_module
from obb_collision.robots.checks.arrays import allowed_links, rigid_groups
from obb_collision.scene.store import allowed
from obb_collision.scene.store.allowed import AllowedMatrix


def pairs(rig: Rig) -> set[tuple[str, ...]]:
    """Return the names of the pairs in the answer to the last state, each sorted."""
    return {tuple(sorted(pair)) for pair in rig.pairs()}


def test_links_are_objects_that_joints_move(arm: AskingRig) -> None:
    arm.known()
    np.testing.assert_allclose(arm.pose_of(HAND), pose(1.0, 0.0, 0.5), atol=1e-12)
    arm.send(cube(CRATE, (0.0, 1.0, 0.7), EDGES))
    assert pairs(arm) == set()
    arm.send_joints(lift=0.2, turn=np.pi / 2)
    assert pairs(arm) == {("arm/hand/1", "crate/1")}
    arm.says(COLLIDING)
    arm.send_joints(turn=0.0)  # the other joint stays where it was
    assert pairs(arm) == set()
    np.testing.assert_allclose(arm.pose_of(HAND), pose(1.0, 0.0, 0.7), atol=1e-12)


def test_adjacent_links_and_those_of_the_srdf_are_not_checked(arm: AskingRig) -> None:
    bulky = URDF.replace("</link>", f"{box(0.9)}</link>", 1)
    arm.start_robot(bulky, lift=-0.5)
    arm.send_joints(lift=-0.5)
    assert pairs(arm) == {("arm/base/1", "arm/hand/0")}
    arm.semantics.publish(String(data=SRDF))
    arm.until(lambda: arm.robot.links.robot.disabled_pairs, "the SRDF")
    arm.send_joints(lift=-0.5, turn=0.0)
    assert pairs(arm) == set()


def test_a_base_is_fixed_by_a_frame_or_by_a_topic() -> None:
    with RobotRig({"robot_bases": ["arm: 1 2 3 0 0 0 1"]}) as rig:
        rig.start_robot()
        np.testing.assert_allclose(rig.pose_of(HAND), pose(2.0, 2.0, 3.5), atol=1e-12)
    with RobotRig({"robot_bases": ["arm: object_transform"]}) as rig:
        rig.describe()
        rig.known("joint_unknown", "arm (joints without a state: lift, turn)")
        rig.send_joints(lift=0.0, turn=0.0)
        rig.known("base_unknown", "arm (no base by object_transform)")
        rig.send_transform("arm", pose(5.0))
        rig.move()
        rig.known()
        np.testing.assert_allclose(rig.pose_of(HAND), pose(6.0, 0.0, 0.5), atol=1e-12)
        rig.send_transform("arm", pose(7.0)).answer()
        np.testing.assert_allclose(rig.pose_of(HAND), pose(8.0, 0.0, 0.5), atol=1e-12)


@each("base", [[""], ["arm: base"]])
def test_a_base_by_tf_is_not_known_without_its_transform(base: list[str]) -> None:
    frames = FakeFrames()
    with RobotRig({"robot_bases": base}, frames=frames, transform_timeout=0.0) as rig:
        rig.describe()
        rig.until(lambda: rig.robot.links is not None, "the robot")
        rig.send_joints(lift=0.0, turn=0.0)
        rig.known("base_unknown", "arm (")
        frames.known["base"] = pose(3.0)
        rig.move()
        rig.known()
        np.testing.assert_allclose(rig.pose_of(HAND), pose(4.0, 0.0, 0.5), atol=1e-12)


@each("base", [["arm: base"], ["arm: object_transform"]])
def test_a_robot_is_as_old_as_its_stamps_and_the_transform_of_its_base(base: list[str]) -> None:
    """Joints and base keep coming; the stamps of the rig, and the transform, are of 1970."""
    frames, given = FakeFrames(), {"robot_bases": base, "judge_ages": "receipt"}
    frames.spans["base"] = 0, 2**62
    with RobotRig(given, frames=frames) as rig:
        rig.describe()
        rig.send_transform("arm", pose(0.0))
        rig.start_robot()
        rig.known()
        rig.set(judge_ages="stamp_and_receipt", joint_timeout=1000.0)
        rig.send_transform("arm", pose(0.0))
        rig.send_joints(lift=0.0, turn=0.0)
        rig.known("joint_unknown", "arm (joints with a stale state: lift, turn)")
        rig.set(joint_timeout=0.0, object_timeout_overrides=["arm: 1000"])
        frames.spans["base"] = 0, rig.stamp
        rig.known("base_unknown", "base")
        assert rig.node.evidence.not_known(), "nor of states to check"
        rig.set(judge_ages="receipt")
        frames.spans["base"] = 0, 2**62
        rig.send_transform("arm", pose(0.0))
        rig.move()
        rig.known()


def test_joints_that_are_missing_or_refused_are_not_free_and_grey() -> None:
    with RobotRig() as rig:
        rig.known("robot_unknown", "arm (no robot_description)")
        rig.describe()
        rig.known("joint_unknown", "arm (joints without a state: lift, turn)")
        rig.send_joints(lift=0.0)
        rig.known("joint_unknown", "arm (joints without a state: turn)")
        rig.send_joints(turn=0.0)
        rig.known()
        rig.send(cube(CRATE, (9.0, 0.0, 0.0))).answer()
        rig.send_joints(lift=float("nan"), turn=0.0)
        rig.known("joint_unknown", "arm (joints whose state was refused: lift)")
        assert rig.refused("arm/joint_states") == {"bad position": 1}
        table = rig.node.objects.table
        doubtful = {key for key, slot in table.slots.items() if table.doubtful[slot]}
        assert doubtful == set(rig.robot.links.keys)
        rig.send_joints(lift=0.0)
        rig.known()
        assert not table.doubtful.any()
        rig.move(turn=0.0, tail=1.0)
        assert dict(rig.monitor("arm/joint_states").doubted) == {"unknown joint": 1}
        rig.known()


def test_velocities_of_joints_predict_collisions_of_links(arm: AskingRig) -> None:
    arm.send(cube(CRATE, (1.0, 0.0, 1.05), EDGES))
    arm.send_joints({"lift": 0.5}, lift=0.0, turn=0.0).answer()

    arm.until(lambda: arm.next("predicted_collisions").width, "a prediction")
    (found,) = named_predictions(arm.last["predicted_collisions"], arm.last["namespaces"])
    assert {found.a, found.b} == {"arm/hand/1", "crate/1"}
    assert found.time == pytest.approx(0.8, abs=1e-3)
    arm.send_joints(lift=0.37, turn=0.0).answer()
    arm.until(lambda: arm.next("clearances").width, "a clearance")
    near = named_clearances(arm.last["clearances"], arm.last["namespaces"])[0]
    assert {near.a, near.b} == {"arm/hand/1", "crate/1"}
    assert near.distance == pytest.approx(0.03, abs=1e-6)


def test_links_are_no_ones_but_the_robots(arm: AskingRig) -> None:
    before = arm.pose_of(HAND)
    arm.send(cube(HAND, (50, 0, 0)), cube(CRATE, (9, 0, 0))).answer()
    arm.send(Marker(action=Marker.DELETEALL))
    arm.send_transform("arm/hand/1", pose(40.0))
    arm.send(cube(CRATE, (9, 0, 0))).answer()
    np.testing.assert_array_equal(arm.pose_of(HAND), before)
    assert arm.refused("objects") == {"object of another input": 1}
    assert arm.refused("object_transform") == {"object of another input": 1}
    arm.call(Trigger, "obb_collision/clear", Trigger.Request())
    arm.known("joint_unknown", "arm (joints without a state")
    arm.send_joints(lift=0.0, turn=0.0)
    arm.known()
    np.testing.assert_array_equal(arm.pose_of(HAND), before)


def test_a_new_description_takes_the_place_of_the_last_one(arm: AskingRig) -> None:
    arm.read(f'<robot name="rock"><link name="rock">{box(1.0)}</link></robot>')
    arm.send(cube(CRATE, (0.9, 0, 0)))
    assert pairs(arm) == {("arm/rock/0", "crate/1")}, "it stands where its base is"
    arm.put((9.0, 9.0, 9.0))
    other = f'<robot name="b"><link name="a">{box(1)}</link><link name="c">{box(1)}</link>'
    arm.read(other + joint("slide", "prismatic", "a", "c", "3 0 0") + "</robot>")
    arm.known("joint_unknown", "joints without a state: slide")
    arm.send_joints(slide=0.0)
    arm.known()
    assert set(arm.node.objects.table.slots) == {("arm/a", 0), ("arm/c", 0), CRATE}


def test_several_robots_are_obstacles_to_each_other() -> None:
    bases = [HERE, "leg: 1.15 0 0 0 0 0 1"]
    with RobotRig({"robots": ["arm", "leg"], "robot_bases": bases}) as rig:
        rig.start_robot()
        rig.known("robot_unknown", "leg (no robot_description)")
        create = rig.client.create_publisher
        rock = f'<robot name="leg"><link name="rock">{box(0.2)}</link></robot>'
        create(String, "leg/robot_description", LATCHED).publish(String(data=rock))
        rig.known()
        rig.send_joints(lift=-0.5, turn=0.0)
        assert pairs(rig) == {("arm/hand/1", "leg/rock/0")}


def test_a_quaternion_of_zeros_is_refused(arm: AskingRig) -> None:
    floating = joint("fly", "floating", "world", "base", "0 0 0")
    urdf = URDF.replace("</robot>", f'<link name="world"/>{floating}</robot>')
    parts = ("trans_x", "trans_y", "trans_z", "rot_x", "rot_y", "rot_z", "rot_w")
    values = {"lift": 0.0, "turn": 0.0} | {f"fly/{part}": 0.0 for part in parts}
    arm.describe(urdf)
    arm.known("joint_unknown", "joints without a state")
    arm.send_joints(None, **values)
    arm.known("base_unknown", "links not placed: bad pose")
    arm.send_joints(None, **(values | {"fly/trans_x": 1.0, "fly/rot_w": 1.0}))
    arm.known()
    np.testing.assert_allclose(arm.pose_of(HAND), pose(2.0, 0.0, 0.5), atol=1e-12)
    assert arm.node.guard.total == 0


@each("seed", range(5))
def test_links_may_touch_as_in_all_pairs_after_any_attachments(
    seed: int, monkeypatch: Patch
) -> None:
    """Rules by name took 0.6 s of 1,000 links, and 0.1 s whenever something was attached."""
    rng, count = np.random.default_rng(seed), 60
    kinds = rng.choice(["fixed", "revolute"], count, p=[0.8, 0.2])
    links = "".join(f'<link name="[l]{n}">{box(0.1)}</link>' for n in range(count))
    joints = "".join(
        joint(f"j{n}", kinds[n], f"[l]{rng.integers(0, n)}", f"[l]{n}", "1 0 0")
        for n in range(1, count)
    )
    off = rng.integers(0, count, (20, 2)).tolist()
    pairs = (f'link1="[l]{one}" link2="[l]{other}"' for one, other in off if one != other)
    srdf = "".join(f'<disable_collisions {pair} reason="Never"/>' for pair in pairs)
    robot = oc.Robot.from_urdf(
        f'<robot name="arm">{links}{joints}</robot>', f'<robot name="arm">{srdf}</robot>'
    )
    held, touched = [("held", n) for n in range(5)], ("arm/[[]l]3", "arm/[[]l]?")
    rig = ObjectsRig(*held)
    made = LinkObjects("arm", robot, rig.objects)
    made.add()
    groups, scene = rigid_groups(robot.tree), oc.Scene()
    names = [f"arm/{link}/0" for link in robot.link_names] + [f"held/{n}" for n in range(5)]
    matched, listed = (
        spy(monkeypatch, *where)
        for where in ((allowed, "as_patterns"), (links_module, "allowed_links"))
    )
    for _ in range(20):
        some = np.flatnonzero(rng.random(5) < 0.6)
        at = rng.choice([3, 3, *rng.integers(0, count, 3).tolist()], len(some))
        attached = AttachedObjects.of(rig.objects.table, rig.slots[some], at)
        scene.rules.matrix = made.matrix(attached, [touched])
        wanted = np.zeros((count + 5, count + 5), np.bool_)
        wanted[:count, :count] = allowed_links([robot], groups)
        for one, link in zip(count + some, at, strict=True):
            own = groups == groups[link]
            if link == robot.link_names.index("[l]3"):
                own = own | [len(name) == 4 for name in robot.link_names]
            wanted[one, :count] |= own
            wanted[:count, one] |= own
            wanted[one, count + some] = groups[at] == groups[link]
        counted = scene.rules.filter_of(names)
        assert counted is not None
        rows, columns = (each.ravel() for each in np.indices(wanted.shape))
        np.testing.assert_array_equal(counted(rows, columns), ~wanted.ravel())
    assert not matched.called
    assert listed.call_count == 1


@each("fault", ["", "many", "long"])
def test_links_are_added_as_one_by_one_or_none(fault: str) -> None:
    one, all_ = ObjectsRig(), ObjectsRig()
    robot = oc.Robot.from_urdf(URDF)
    made = LinkObjects("arm" if fault != "long" else 300 * "a", robot, all_.objects)
    all_.objects.shapes.max_objects = 3 if fault == "many" else 10
    if fault:
        with pytest.raises(RefusedError, match="too many" if fault == "many" else "bad"):
            made.add()
        assert len(all_.objects.table) == len(all_.objects.scene) == 0
        assert not len(all_.objects.table.namespaces) or fault == "long"
        return
    made.add()
    for key, shape in zip(made.keys, made._shapes, strict=True):
        one.objects.table.of_robot[one.objects.shapes.put(key, shape)] = True
    for column in COLUMNS:
        first, second = (getattr(rig.objects.table, column)[:4] for rig in (one, all_))
        np.testing.assert_array_equal(first, second, column)
    first, second = (rig.objects.scene.objects.store.columns() for rig in (one, all_))
    counters = {"born"}  # the version of the store in which each came
    for name in (name for name, value in first.items() if np.ndim(value) and name not in counters):
        np.testing.assert_array_equal(first[name], second[name], name)
    assert one.objects.table.signatures == all_.objects.table.signatures


def test_robots_may_touch_each_other_only_by_rules() -> None:
    parts = [
        AllowedMatrix({f"{name}/0": 0, f"{name}/1": 0}, np.ones((1, 1), np.bool_)) for name in "ab"
    ]
    scene = oc.Scene()
    for name in ("a/0", "a/1", "b/0", "b/1", "c/0"):
        scene.add(name, oc.shapes.Box(EDGES))
    scene.allow("a/1", "a/0", allowed=False)
    scene.allow("b/1", "a/1")
    scene.rules.matrix = AllowedMatrix.joined(parts)
    counted = {tuple(sorted(pair)) for pair in scene.check().names()}
    others = {(name, "c/0") for name in ("a/0", "a/1", "b/0", "b/1")}
    assert counted == {("a/0", "b/0"), ("a/0", "b/1"), ("a/1", "b/0")} | others
    assert len(pickle.loads(pickle.dumps(scene)).check()) == len(counted)


def test_links_that_an_error_has_removed_take_no_other_object_along() -> None:
    rig = ObjectsRig()
    made = LinkObjects("arm", oc.Robot.from_urdf(URDF), rig.objects)
    made.add()
    rig.objects.shapes.remove(made.slots)
    others = [rig.objects.shapes.put(("crate", n), oc.shapes.Box(EDGES)) for n in range(3)]
    assert {*others} <= {*made.slots.tolist()}
    with pytest.raises(ValueError, match="links removed"):
        made.located(IDENTITY_POSE, np.zeros(2), np.zeros(2))
    made.refuse()
    made.remove()
    assert rig.objects.table.live[others].all()
    assert not rig.objects.table.doubtful.any()


def statuses(rig: RobotRig) -> list[Any]:
    """Return the list that all levels of the status are added to from now on."""
    levels: list[Any] = []

    def take(message: Any) -> None:
        levels.append(message.status[0].level)

    rig.client.create_subscription(OUTPUTS[STATUS].message, STATUS, take, 50)
    return levels


CORNER = cube(("crate", 1), (1.27, 0.17, 0.58), (0.02, 0.02, 0.02))
"""In the box of the ball that is the hand, and not in the ball."""


def ball(folder: Path) -> str:
    """Return the robot with a flat ball of 1280 faces as its hand."""
    found = trimesh.creation.icosphere(3).apply_scale((0.3, 0.2, 0.1))
    found.export(folder / "ball.obj")
    before, end, after = URDF.rpartition('<box size="0.2 0.2 0.2"/>')
    assert end
    return f'{before}<mesh filename="file://{folder}/ball.obj"/>{after}'


def test_links_whose_hulls_are_built_are_unknown_and_collide_with_nothing(tmp_path: Path) -> None:
    with RobotRig({"mesh_folders": [str(tmp_path)]}) as rig:
        gate, levels = Gate(rig, trees=True), statuses(rig)
        rig.send(CORNER)
        rig.describe(ball(tmp_path))
        rig.known("joint_unknown")
        rig.send_joints(lift=0.0, turn=0.0)
        rig.known("shape_building", "arm/hand/1")
        rig.send(cube(("crate", 2), (9.0, 0.0, 0.0)), cube(("crate", 3), (9.0, 0.0, 0.0)))
        rig.until(lambda: COLLIDING in levels, "a pair of others")
        rig.send(cube(("crate", 2), (9.0, 9.0, 9.0)))
        rig.until(lambda: levels[-1] == UNKNOWN, "no pair any more")
        rig.known("shape_building", "arm/hand/1")
        levels.clear()
        gate.open()
        rig.known()
        assert COLLIDING not in levels


def has_text(rig: RobotRig, text: str) -> bool:
    """Return whether a text is the latest of its kind that the node has taken."""
    return text in rig.robot._texts.values()


def test_a_text_that_is_refused_counts_until_the_next_one_of_its_kind(arm: AskingRig) -> None:
    arm.known()
    texts = {arm.descriptions: URDF, arm.semantics: SRDF}
    for refused, other in permutations(texts):
        refused.publish(String(data="none"))
        arm.says(UNKNOWN, "robot_unknown")
        other.publish(String(data=texts[other]))
        arm.until(partial(has_text, arm, texts[other]), "the other text")
        arm.cycles(3)
        arm.says(UNKNOWN, "robot_unknown")
        refused.publish(String(data=texts[refused]))
        arm.until(lambda: arm.robot.fault[:5] in ("", "joint"), "the robot")
        arm.send_joints(lift=0.0, turn=0.0)
        arm.known()


def test_of_many_descriptions_one_is_read_at_a_time_and_the_last_counts(arm: AskingRig) -> None:
    from_urdf, may_go = Robot.from_urdf, Event()
    read: list[str] = []

    def slow(urdf: str, *args: Any, **options: Any) -> Robot:
        read.append(urdf)
        assert may_go.wait(60.0)
        return from_urdf(urdf, *args, **options)

    with patch.object(Robot, "from_urdf", slow):
        texts = [URDF.replace('name="arm"', f'name="arm{n}"', 1) for n in range(9)]
        for text in texts:
            arm.describe(text)
            arm.until(partial(has_text, arm, text), "a text")
        assert [thread.name for thread in enumerate_threads()].count("robot_description") == 1
        may_go.set()
        arm.known("joint_unknown")
        assert read == [texts[0], texts[-1]]
