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


"""Objects attached to links: markers that are locked to the frame of a link."""

from __future__ import annotations

from typing import Any

import numpy as np
from each import each
from geometry_msgs.msg import TransformStamped
from rclpy.serialization import serialize_message
from rig import FakeFrames, cube
from robot_rig import COLLIDES, CRATE, EDGES, NOT_KNOWN, SRDF, URDF, VALID, AskingRig
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.objects.conditions import UNPLACED

TOOL, NAME, HAND = ("tool", 1), "tool/1", "arm/hand"
HERE, THERE = [0.0, 0.0], [0.0, np.pi / 2]
BEYOND = (0.0, 1.3, 0.5)
"""Where what is held is at a turn of 90 degrees."""
LONG = (0.5, 0.0, 0.0), (1.1, 0.1, 0.1)
"""From the column to the end of the hand."""


def held(
    place: Any = (1.3, 0.0, 0.0), size: Any = EDGES, frame: str = HAND, **fields: Any
) -> Marker:
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
    assert arm.reasons([HERE]) == [COLLIDES]
    arm.set(robot_touch_links=["arm/hand: arm/col*"])
    arm.move()
    arm.until(lambda: not arm.pairs(), "no pair")
    assert arm.reasons([HERE]) == [VALID]
    other = held((1.35, 0.0, 0.0))
    other.id = 2
    put(arm, held(), other)
    assert arm.pairs() == set(), "two that one link holds may touch"
    assert arm.reasons([HERE]) == [VALID]


@each("hand", [True, False])
def test_it_may_touch_the_end_effector_of_the_srdf_whose_link_holds_it(
    arm: AskingRig, hand: bool
) -> None:
    links = '<link name="column"/><link name="hand"/>' if hand else '<link name="column"/>'
    end = (
        f'<group name="gripper">{links}</group>'
        '<end_effector name="tool" parent_link="base" group="gripper"/></robot>'
    )
    arm.semantics.publish(String(data=SRDF.replace("</robot>", end)))
    arm.until(lambda: arm.robot.links.robot.end_effectors, "the SRDF")
    put(arm, held(*LONG))
    assert arm.pairs() == (set() if hand else {("arm/column/0", NAME)})
    assert arm.reasons([HERE]) == [VALID if hand else COLLIDES]


@each("kind", [Marker.CUBE, Marker.SPHERE, Marker.CYLINDER, Marker.ARROW])
def test_states_are_checked_with_it_as_a_part_of_the_robot(arm: AskingRig, kind: int) -> None:
    arm.send(cube(CRATE, BEYOND, EDGES), held(type=kind))
    arm.built(TOOL, CRATE)
    rows = arm.ask([HERE, THERE, [0.0, -0.3]])
    assert rows["reason"].tolist() == [VALID, COLLIDES, VALID]  # where it is now is no obstacle
    table = arm.node.objects.table
    slots = table.find_named([NAME, "crate/1"])
    ids = zip(table.ns[slots].tolist(), table.id[slots].tolist(), strict=True)
    assert [rows[name][1] for name in ("ns_a", "id_a", "ns_b", "id_b")] == [*sum(ids, ())]


def test_it_can_be_exchanged_moved_and_detached(arm: AskingRig) -> None:
    put(arm, cube(CRATE, BEYOND, EDGES))
    for marker, reason in (
        (held(), COLLIDES),
        (held((1.5, 0.0, 0.0)), VALID),
        (held((1.5, 0.0, 0.0), (0.5, 0.1, 0.1)), COLLIDES),
        (held(action=Marker.DELETE), VALID),
    ):
        put(arm, marker)
        assert arm.reasons([THERE]) == [reason]
    put(arm, held(), cube(TOOL, (0.0, -1.0, 0.5), EDGES))  # put down where the hand may be
    assert arm.reasons([THERE, [0.0, -np.pi / 2]]) == [VALID, COLLIDES]


def test_it_is_detached_at_once_by_markers_that_are_applied_between_two_cycles(
    arm: AskingRig,
) -> None:
    """A pose applies the markers that came before it; a question may come right behind it."""
    arm.set(ignored_objects=["nobody/*"])
    put(arm, held())
    scene = arm.ends.checked.scene
    assert scene().attached == {NAME: HAND}
    takes = arm.node.inputs.callbacks()
    takes["objects"](serialize_message(MarkerArray(markers=[held(action=Marker.DELETE)])))
    takes["object_transform"](serialize_message(TransformStamped(child_frame_id="nobody/1")))
    assert scene().attached == {}


def test_it_is_grey_without_its_joints_or_its_link_and_no_state_valid() -> None:
    with AskingRig() as rig:
        rig.send(held())
        rig.cycles(2)
        table = rig.node.objects.table
        slot = table.slots[TOOL]
        assert table.unplaceable[slot], "it may come before its robot"
        rig.start_robot()
        rig.until(lambda: not table.has(UNPLACED, slot), "its place")
        assert rig.reasons([HERE]) == [VALID]
        rig.send_joints(turn=float("nan"))
        rig.until(lambda: table.doubtful[slot], "grey")
        assert rig.reasons([HERE]) == [NOT_KNOWN]
        rig.move()
        assert not table.doubtful[slot]
        assert rig.reasons([HERE]) == [VALID]
        rig.read(URDF.replace('"hand"', '"palm"'))
        rig.send_joints(turn=0.0, lift=0.0)
        rig.until(lambda: table.doubtful[slot], "grey: it has no such link")
        assert rig.reasons([HERE]) == [NOT_KNOWN]


def test_the_frame_of_no_link_is_refused_and_states_are_not_valid(arm: AskingRig) -> None:
    put(arm, held(frame="arm/foot"))
    assert arm.refused("objects") == {"unknown frame": 1}
    assert arm.reasons([HERE]) == [NOT_KNOWN]


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
        assert rig.reasons([HERE, THERE]) == [VALID, COLLIDES]


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
    put(arm, cube(("arm", 5), (0.0, 0.0, 2.0), EDGES, HAND, frame_locked=True))
    text = "refused: scene not known: not attached: name must not be that of a link"
    assert arm.go(slow)[0].message.startswith(text)
