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


"""Objects attached to links; and hostile messages on the topics of a robot, which are refused."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from threading import Thread
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from each import each
from geometry_msgs.msg import TransformStamped
from rclpy.serialization import serialize_message
from rig import FakeFrames, Patch, cube, pose
from robot_rig import BOTH, CRATE, EDGES, HAND, REASONS, ROW, SRDF, URDF, AskingRig, RobotRig
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision import _child
from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN
from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.node.objects.conditions import UNPLACED
from obb_collision.robots.description import MOST_GEOMETRIES

TOOL, NAME, LINK = ("tool", 1), "tool/1", "arm/hand"
HERE, THERE = [0.0, 0.0], [0.0, np.pi / 2]
BEYOND = (0.0, 1.3, 0.5)
"""Where what is held is at a turn of 90 degrees."""
LONG = (0.5, 0.0, 0.0), (1.1, 0.1, 0.1)
"""From the column to the end of the hand."""


def held(place: Any = (1.3, 0, 0), size: Any = EDGES, frame: str = LINK, **fields: Any) -> Marker:
    """Return a cube beyond the boxes of the hand, attached to it."""
    return cube(TOOL, place, size, frame, **({"frame_locked": True} | fields))


def put(rig: Any, *markers: Marker, stamped: bool = True) -> None:
    """Send markers, and the joints after them: what is locked to a frame has no stamp."""
    rig.send(*markers, stamped=stamped)
    rig.cycles(2)
    rig.move()


def at(rig: Any, place: Any) -> None:
    np.testing.assert_allclose(rig.pose_of(TOOL)[:3], place, atol=1e-12)


def test_it_moves_with_its_link_unless_it_is_not_locked(arm: AskingRig) -> None:
    put(arm, held())
    at(arm, (1.3, 0.0, 0.5))
    arm.move(turn=np.pi / 2)
    at(arm, BEYOND)
    arm.move({"turn": 2.0, "lift": 0.5}, turn=np.pi / 2)
    twist = arm.node.objects.scene.objects.store.twists[arm.node.objects.table.slots[TOOL]]
    np.testing.assert_allclose(twist, (-2.6, 0.0, 0.5, 0.0, 0.0, 2.0), atol=1e-8)
    put(arm, held(action=Marker.DELETE))
    put(arm, held(frame_locked=False), stamped=False)
    arm.move(turn=np.pi / 2)
    at(arm, (1.3, 0.0, 0.5))
    assert not len(arm.robot.attached.slots)


def test_it_collides_with_all_but_its_link_and_what_it_may_touch(arm: AskingRig) -> None:
    put(arm, held(*LONG))
    assert arm.pairs() == {("arm/column/0", NAME)}
    arm.send(cube(CRATE, (0.0, 1.1, 0.5), EDGES))
    arm.move(turn=np.pi / 2)
    assert ("crate/1", NAME) in arm.pairs()
    assert arm.reasons([HERE]) == ["collides"]
    arm.set(robot_touch_links=["arm/hand: arm/col*"])
    arm.move()
    arm.until(lambda: not arm.pairs(), "no pair")
    assert arm.reasons([HERE]) == ["valid"]
    other = held((1.35, 0.0, 0.0))
    other.id = 2
    put(arm, held(), other)
    assert arm.pairs() == set(), "two that one link holds may touch"
    assert arm.reasons([HERE]) == ["valid"]


@each("hand", [True, False])
def test_it_may_touch_the_end_effector_whose_link_holds_it(arm: AskingRig, hand: bool) -> None:
    links = '<link name="column"/><link name="hand"/>' if hand else '<link name="column"/>'
    end = f'<group name="gripper">{links}</group>'
    end += '<end_effector name="tool" parent_link="base" group="gripper"/></robot>'
    arm.semantics.publish(String(data=SRDF.replace("</robot>", end)))
    arm.until(lambda: arm.robot.links.robot.end_effectors, "the SRDF")
    put(arm, held(*LONG))
    assert arm.pairs() == (set() if hand else {("arm/column/0", NAME)})
    assert arm.reasons([HERE]) == ["valid" if hand else "collides"]


@each("kind", [Marker.CUBE, Marker.SPHERE, Marker.CYLINDER, Marker.ARROW])
def test_states_are_checked_with_it_as_a_part_of_the_robot(arm: AskingRig, kind: int) -> None:
    arm.send(cube(CRATE, BEYOND, EDGES), held(type=kind))
    arm.built(TOOL, CRATE)
    states = [HERE, THERE, [0.0, -0.3]]
    assert arm.reasons(states) == ["valid", "collides", "valid"], "where it is is no obstacle"
    rows = arm.ask(states)
    table = arm.node.objects.table
    slots = table.find_named([NAME, "crate/1"])
    ids = zip(table.ns[slots].tolist(), table.id[slots].tolist(), strict=True)
    assert [rows[name][1] for name in ("ns_a", "id_a", "ns_b", "id_b")] == [*sum(ids, ())]


def test_it_can_be_exchanged_moved_and_detached(arm: AskingRig) -> None:
    put(arm, cube(CRATE, BEYOND, EDGES))
    for marker, reason in (
        (held(), "collides"),
        (held((1.5, 0.0, 0.0)), "valid"),
        (held((1.5, 0.0, 0.0), (0.5, 0.1, 0.1)), "collides"),
        (held(action=Marker.DELETE), "valid"),
    ):
        put(arm, marker)
        assert arm.reasons([THERE]) == [reason]
    put(arm, held(), cube(TOOL, (0.0, -1.0, 0.5), EDGES))  # put down where the hand may be
    assert arm.reasons([THERE, [0.0, -np.pi / 2]]) == ["valid", "collides"]


def test_it_is_detached_at_once_by_markers_applied_between_two_cycles(arm: AskingRig) -> None:
    """A pose applies the markers that came before it; a question may come right behind it."""
    arm.set(ignored_objects=["nobody/*"])
    put(arm, held())
    scene = arm.ends.checked.scene
    assert scene().attached == {NAME: LINK}
    takes = arm.node.inputs.callbacks()
    takes["objects"](serialize_message(MarkerArray(markers=[held(action=Marker.DELETE)])))
    takes["object_transform"](serialize_message(TransformStamped(child_frame_id="nobody/1")))
    assert scene().attached == {}


INSIDE = (1.0, 0.0, 0.5)
"""Within the box of the hand."""


@each("at_once", [True, False])
def test_what_takes_the_place_of_an_attached_object_leaves_it_no_rights(
    arm: AskingRig, at_once: bool
) -> None:
    """The other one gets its slot, and has its link."""
    put(arm, held(*LONG[:1]))
    slot = arm.node.objects.table.slots[TOOL]
    gone = cube(TOOL, action=Marker.DELETE)
    for markers in ([gone, held(id=2)],) if at_once else ([gone], [held(id=2)]):
        put(arm, *markers)
    assert arm.node.objects.table.slots["tool", 2] == slot
    assert arm.pairs() == set()
    put(arm, cube(TOOL, INSIDE, EDGES))
    assert {frozenset(pair) for pair in arm.pairs()} == {frozenset(("arm/hand/1", NAME))}
    assert arm.reasons([HERE]) == ["collides"]


def test_it_loses_its_rights_at_once_by_markers_applied_between_two_cycles(arm: AskingRig) -> None:
    arm.set(ignored_objects=["nobody/*"])
    put(arm, held())
    takes = arm.node.inputs.callbacks()
    takes["objects"](serialize_message(MarkerArray(markers=[cube(TOOL, INSIDE, EDGES)])))
    takes["object_transform"](serialize_message(TransformStamped(child_frame_id="nobody/1")))
    arm.node.objects.placement.place(arm.now())
    assert arm.ends.checked.scene().check(np.array([HERE])).colliding.tolist() == [True]


def test_it_is_grey_without_its_joints_or_its_link_and_no_state_valid() -> None:
    with AskingRig() as rig:
        rig.send(held())
        rig.cycles(2)
        table = rig.node.objects.table
        slot = table.slots[TOOL]
        assert table.unplaceable[slot], "it may come before its robot"
        rig.start_robot()
        rig.until(lambda: not table.has(UNPLACED, slot), "its place")
        assert rig.reasons([HERE]) == ["valid"]
        rig.send_joints(turn=float("nan"))
        rig.until(lambda: table.doubtful[slot], "grey")
        assert rig.reasons([HERE]) == ["unknown"]
        rig.move()
        assert not table.doubtful[slot]
        assert rig.reasons([HERE]) == ["valid"]
        rig.read(URDF.replace('"hand"', '"palm"'))
        rig.send_joints(turn=0.0, lift=0.0)
        rig.until(lambda: table.doubtful[slot], "grey: it has no such link")
        assert rig.reasons([HERE]) == ["unknown"]


def test_the_frame_of_no_link_is_refused_and_states_are_not_valid(arm: AskingRig) -> None:
    put(arm, held(frame="arm/foot"))
    assert arm.refused("objects") == {"unknown frame": 1}
    assert arm.reasons([HERE]) == ["unknown"]


@each("by_tf", [False, True])
def test_the_frame_may_be_that_of_tf(by_tf: bool) -> None:
    frames = FakeFrames()
    options: dict[str, Any] = {"frames": frames, "given": {"robot_bases": [""]}} if by_tf else {}
    frames.known["base"] = [0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0]
    with AskingRig(**options) as rig:
        rig.start_robot()
        put(rig, held(frame="hand"))
        height = 0.7 if by_tf else 0.5
        at(rig, (1.3, 0.0, height))
        put(rig, cube(CRATE, (0.0, 1.3, height), EDGES))
        assert rig.reasons([HERE, THERE]) == ["valid", "collides"]


def test_trajectories_are_refused_and_stopped_for_what_is_attached(arm: AskingRig) -> None:
    slow = [(0.0, HERE), (1000.0, THERE)]
    put(arm, cube(CRATE, BEYOND, EDGES))
    arm.begin(slow)
    arm.send(held())
    assert arm.stopped().startswith(f"stopped: not free: {NAME} and crate/1")
    assert arm.go(slow)[0].message.startswith(f"refused: not free: {NAME} and crate/1")
    arm.read(URDF.replace('"base"', '"5"'))  # what has the name of a link is not attached
    put(arm, held(action=Marker.DELETE))
    arm.begin(slow)
    put(arm, cube(("arm", 5), (0.0, 0.0, 2.0), EDGES, LINK, frame_locked=True))
    text = "refused: scene not known: not attached: name must not be the name of a link"
    assert arm.go(slow)[0].message.startswith(text)


NAN = float("nan")


def send(rig: RobotRig, names: Any, positions: Sequence[float], *velocities: float) -> None:
    """Send joint states as they are, and wait for what comes of them."""
    message = JointState(header=rig.header(), name=list(names))
    message.position, message.velocity = [float(x) for x in positions], list(velocities)
    before = rig.monitor("arm/joint_states").messages
    rig.joint_states.publish(message)
    rig.until(lambda: rig.monitor("arm/joint_states").messages > before, "the joints")
    rig.cycles(1)


def assert_well(rig: RobotRig) -> None:
    """Good joints are answered as if nothing had been, and nothing failed inside."""
    rig.move(lift=0.25)
    assert rig.robot.fault == ""
    np.testing.assert_allclose(rig.pose_of(("arm/hand", 0)), pose(0.5, 0.0, 0.75), atol=1e-12)
    assert rig.node.guard.total == 0, rig.node.guard.last


@each("speed", [5e-324, 1e-310, 1e-20, 1e300, 1e9, NAN, np.inf, -1e308])
def test_any_velocity_leaves_the_links_where_the_positions_say_and_the_description_read(
    arm: AskingRig, monkeypatch: Patch, speed: float
) -> None:
    robot = arm.robot.links.robot
    monkeypatch.setattr(arm.robot, "read", None)
    send(arm, BOTH, (0.25, 0.0), speed, 0.0)
    np.testing.assert_allclose(arm.pose_of(HAND), pose(1.0, 0.0, 0.75), atol=1e-12)
    assert arm.robot.fault == ""
    assert arm.call(Trigger, "obb_collision/clear", Trigger.Request()).success
    arm.cycles(1)
    assert arm.robot.fault.startswith("joints without a state")
    assert_well(arm)
    assert arm.robot.links.robot is robot


@each("speed", [1e-9, 1e-6, 1e-3, 1.0])
def test_slow_joints_have_twists_in_proportion(arm: AskingRig, speed: float) -> None:
    send(arm, BOTH, (0.0, 0.0), speed, 0.0)
    table = arm.node.objects.table
    twist = table.twist[table.slots["arm/hand", 0]]
    np.testing.assert_allclose(twist, [0, 0, speed, 0, 0, 0], atol=1e-9 * speed + 1e-15)


@each(
    "names, positions, reason",
    [
        (BOTH, (NAN, 0.0), "bad position"),
        (BOTH, (0.0, -np.inf), "bad position"),
        ((*BOTH, "lift"), (0.0, 0.0, 1.0), "repeated joint"),
        (("lift", "lift"), (NAN, 0.0), "repeated joint"),
        (BOTH, (0.0,), "array lengths differ"),
        (["x" * 1_000_000, "", "turn\n"], (0.0, 0.0, 0.0), ""),
        ([f"j{k}" for k in range(20_000)], np.zeros(20_000).tolist(), ""),
    ],
)
def test_joints_that_cannot_be_used_are_refused_with_the_reason(
    arm: AskingRig, names: Sequence[str], positions: Sequence[float], reason: str
) -> None:
    before = arm.refused("arm/joint_states").get(reason, 0)
    send(arm, names, positions)
    fault = "joints whose state was refused" if reason else ""
    assert arm.robot.fault.partition(":")[0] == fault
    assert not reason or arm.refused("arm/joint_states")[reason] > before
    assert_well(arm)


def test_what_fails_unforeseen_leaves_the_robot_unknown_for_now(monkeypatch: Patch) -> None:
    with AskingRig() as arm:
        arm.start_robot()
        with monkeypatch.context() as patch:
            patch.setattr(arm.robot.links, "located", lambda *_: 1 // 0)
            send(arm, BOTH, (1.0, 0.0))
            arm.cycles(2)
            assert "links not placed: internal error" in arm.robot.fault
            assert arm.node.guard.total == 1
        arm.move()
        assert arm.robot.fault == ""


BEFORE, BETWEEN, AFTER = URDF.split("<limit")
SMALL = '<box size="0.1 0.1 0.1"/>'
SPHERE = "<collision><geometry><sphere radius='1'/></geometry></collision>"
ENTITIES = '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;">]>'
BAD_DESCRIPTIONS = [
    (f'{BEFORE}<mimic joint="turn"/><limit{BETWEEN}<mimic joint="lift"/><limit{AFTER}', "mimic"),
    (URDF.replace("0.1 0.1 0.1", "0.1 -1 0.1"), "negative"),
    (URDF.replace(SMALL, '<mesh filename="package://no/a"/>'), "mesh"),
    (URDF.replace(SMALL, '<mesh filename="/etc/passwd"/>'), "mesh"),
    (ENTITIES + URDF.replace('name="arm"', 'name="&b;"'), "document type"),
    (URDF.replace('name="arm"', f'name="{"x" * 1_000_000}"'), "name"),
    (URDF.replace("</link>", SPHERE * MOST_GEOMETRIES + "</link>", 1), f"{MOST_GEOMETRIES} is the"),
    ("/etc/hostname", "not valid XML"),
    ("<robot", "urdf:1"),
]


def test_descriptions_that_cannot_be_used_leave_a_robot_unknown_and_pairs(arm: AskingRig) -> None:
    arm.move(lift=0.25)
    arm.put((1.0, 0.0, 0.75))

    @each("text, reason", BAD_DESCRIPTIONS)
    def check(text: str, reason: str) -> None:
        before = arm.refused("arm/robot_description").get("bad description", 0)
        arm.describe(text)
        arm.until(lambda: "refused" in arm.robot.fault, "the refusal")
        assert reason in arm.robot.fault
        assert len(arm.robot.fault) < 1000
        assert arm.reasons([[0.0, 0.0]]) == ["unknown"]
        arm.put((9.0, 0.0, 0.75))
        assert arm.pairs() == set()
        assert "robot_unknown" in arm.says(UNKNOWN, reason)["reasons"].split()
        arm.put((1.0, 0.0, 0.75))
        assert {frozenset(pair) for pair in arm.pairs()} == {frozenset(("arm/hand/1", "crate/1"))}
        assert reason in arm.says(COLLIDING, "arm (robot_description refused")["message"]
        assert arm.refused("arm/robot_description") == {"bad description": before + 1}
        arm.read()
        assert_well(arm)

    check()


def _cloud(rig: RobotRig, **fields: str) -> PointCloud2:
    return cloud_to_ros(np.zeros(3, list(fields.items())), rig.header())


def test_states_that_cannot_be_read_are_never_valid(arm: AskingRig) -> None:
    twice, short = (_cloud(arm, lift="<f8", turn="<f8") for _ in range(2))
    twice.fields.append(twice.fields[0])
    short.data = short.data[:-1]
    nothing = PointCloud2(header=arm.header(), width=9_000_000, height=1)
    for message, reason, answered in (
        (twice, "field layout", True),
        (_cloud(arm, lift="<f4", turn="<f8"), "field layout", True),
        (_cloud(arm, lift="<i4", turn="<f8"), "field layout", True),
        (_cloud(arm, lift="<f8"), "missing joint", True),
        (_cloud(arm, lift="<f8", turn="<f8", nose="<f8"), "unknown joint", True),
        (short, "field layout", False),
        (nothing, "field layout", False),
    ):
        before = arm.refused("arm/states_to_check").get(reason, 0)
        arm.answers.clear()
        arm.questions.publish(message)
        while arm.refused("arm/states_to_check").get(reason, 0) == before:
            arm.cycles(1)
        if answered:
            arm.until(lambda: arm.answers, "the answer")
            answer = cloud_from_ros(arm.answers[0], ROW)
            assert answer[["valid", "reason"]].tolist() == [(0, REASONS.index("unknown"))] * 3
        states = [[0.25, 0.0], [NAN, 0.0], [9.0, 0.0]]
        assert arm.reasons(states) == ["valid", "bad state", "out of limits"]
        assert_well(arm)


def test_a_base_that_jumps_to_no_pose_leaves_the_robot_unknown() -> None:
    frames = FakeFrames()
    frames.known["stand"] = pose(0.0)
    given: dict[str, Any] = {"robot_bases": ["arm: stand"]}
    with AskingRig(given, frames=frames, transform_timeout=0.0) as rig:
        rig.start_robot()
        assert rig.reasons([[0.0, 0.0]]) == ["valid"]
        for bad in ([NAN] * 7, [1e308] * 7, [0.0] * 7, [0, 0, np.inf, 0, 0, 0, 1]):
            frames.known["stand"] = bad
            assert rig.reasons([[0.0, 0.0]]) == ["unknown"]
            rig.cycles(2)
            frames.known["stand"] = pose(0.0)
            assert_well(rig)
            assert rig.reasons([[0.0, 0.0]]) == ["valid"]


def test_a_reading_that_does_not_begin_is_said(arm: AskingRig, monkeypatch: Patch) -> None:
    fails = Mock(side_effect=RuntimeError("can't start new thread"))
    starts = (f"{URDF} ", Thread, "start"), (f"{URDF}  ", arm.robot, "_meshes")
    for urdf, target, name in starts:
        with monkeypatch.context() as patch:
            patch.setattr(target, name, fails)
            arm.describe(urdf)
            arm.until(lambda: "can't start new thread" in arm.robot.fault, "the fault")
        assert arm.robot.fault.startswith("robot_description refused: internal error")
        arm.start_robot(urdf)  # the same description once more
        assert arm.robot.fault == ""
    assert arm.refused("arm/robot_description") == {"bad description": 2}


def test_what_is_in_the_way_of_links_is_gone_after_clear() -> None:
    with RobotRig() as rig:
        rig.send(cube(HAND)).answer()
        rig.describe()
        rig.until(lambda: "refused" in rig.robot.fault, "the refusal")
        assert rig.call(Trigger, "obb_collision/clear", Trigger.Request()).success
        rig.move()
        assert rig.robot.fault == ""


def test_a_mesh_that_takes_for_ever_gives_way(tmp_path: Path, monkeypatch: Patch) -> None:
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    mesh = f'<mesh filename="file://{tmp_path}/part.obj"/>'
    number = tmp_path / "number"
    code = f"import os, time; os.symlink(str(os.getpid()), {str(number)!r}); time.sleep(1e6)"
    slow = URDF.replace('<box size="0.1 0.1 0.1"/>', mesh)

    def read_for_ever(rig: RobotRig) -> int:
        with monkeypatch.context() as patch:
            patch.setattr(_child, "CODE", code)
            rig.describe(slow)
            rig.until(number.is_symlink, "its process")
            assert "being read" in rig.robot.fault
        found = int(os.readlink(number))
        number.unlink()
        return found

    with RobotRig({"mesh_folders": [str(tmp_path)]}, own_builder=True) as rig:
        readers = [read_for_ever(rig)]
        rig.describe()
        rig.until(lambda: rig.robot.links is not None, "the robot")
        assert "refused" not in rig.robot.fault
        readers.append(read_for_ever(rig))
    for reader in readers:  # the second one gives way to the end of the node
        with pytest.raises(ProcessLookupError):
            os.kill(reader, 0)
