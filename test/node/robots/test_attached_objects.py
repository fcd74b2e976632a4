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
import pytest
from each import each

pytest.importorskip("rclpy")
pytest.importorskip("lxml")
from fake_frames import FakeFrames
from geometry_msgs.msg import TransformStamped
from rclpy.serialization import serialize_message
from rig import cube
from robot_rig import SRDF, URDF, ValidityRig
from std_msgs.msg import String
from test_trajectories import QUARTER, TrajectoryRig
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.objects.conditions import UNPLACED
from obb_collision.node.robots.validity import COLLIDES, NOT_KNOWN, VALID

TOOL, CRATE = ("tool", 1), ("crate", 1)
NAME, HAND = "tool/1", "arm/hand"
EDGES = (0.1, 0.1, 0.1)


def held(
    place: Any = (1.3, 0.0, 0.0), size: Any = EDGES, frame: str = HAND, **fields: Any
) -> Marker:
    """Return a cube beyond the boxes of the hand, attached to it."""
    marker = cube(TOOL, place, size, frame_locked=True, **fields)
    marker.header.frame_id = frame
    return marker


def quarter(rig: Any, turn: float = np.pi / 2) -> None:
    """Turn the hand."""
    rig.send_joints(turn=turn, lift=0.0)
    rig.answer()


def put(rig: Any, *markers: Marker, stamped: bool = True) -> None:
    """Send markers, and the joints after them: what is locked to a frame has no stamp."""
    rig.send(*markers, stamped=stamped)
    rig.cycles(2)
    quarter(rig, 0.0)


def test_it_moves_with_its_link(arm: ValidityRig) -> None:
    put(arm, held())
    np.testing.assert_allclose(arm.pose_of(TOOL)[:3], (1.3, 0.0, 0.5), atol=1e-12)
    quarter(arm)
    np.testing.assert_allclose(arm.pose_of(TOOL)[:3], (0.0, 1.3, 0.5), atol=1e-12)
    arm.send_joints({"turn": 2.0, "lift": 0.5}, turn=np.pi / 2, lift=0.0)
    arm.answer()
    slot = arm.node.objects.table.find_named([NAME])[0]
    twist = arm.node.objects.scene.objects.store.twists[slot]
    np.testing.assert_allclose(twist, (-2.6, 0.0, 0.5, 0.0, 0.0, 2.0), atol=1e-8)


def test_it_collides_with_all_but_its_link_and_what_it_may_touch(arm: ValidityRig) -> None:
    put(arm, held((0.5, 0.0, 0.0), (1.1, 0.1, 0.1)))  # from the column to the end of the hand
    assert arm.pairs() == {("arm/column/0", NAME)}
    arm.send(cube(CRATE, (0.0, 1.1, 0.5), EDGES))
    quarter(arm)
    assert (CRATE[0] + "/1", NAME) in arm.pairs()
    assert arm.reasons([[0.0, 0.0]]) == [COLLIDES]
    arm.set(robot_touch_links=["arm/hand: arm/col*"])
    arm.send_joints(turn=0.0, lift=0.0)
    arm.until(lambda: not arm.pairs(), "no pair")
    assert arm.reasons([[0.0, 0.0]]) == [VALID]


def test_it_may_touch_the_end_effector_of_the_srdf() -> None:
    end = (
        '<group name="gripper"><link name="column"/><link name="hand"/></group>'
        '<end_effector name="tool" parent_link="base" group="gripper"/></robot>'
    )
    with ValidityRig() as rig:
        rig.semantics.publish(String(data=SRDF.replace("</robot>", end)))
        rig.until(lambda: rig.robot._srdf, "the SRDF")
        rig.start_robot()
        put(rig, held((0.5, 0.0, 0.0), (1.1, 0.1, 0.1)))
        assert rig.pairs() == set()
        assert rig.reasons([[0.0, 0.0]]) == [VALID]


@each("kind", [Marker.CUBE, Marker.SPHERE, Marker.CYLINDER, Marker.ARROW])
def test_states_are_checked_with_it_as_a_part_of_the_robot(kind: int, arm: ValidityRig) -> None:
    arm.send(cube(CRATE, (0.0, 1.3, 0.5), EDGES), held(type=kind))
    arm.built(TOOL, CRATE)
    rows = arm.ask([[0.0, 0.0], [0.0, np.pi / 2], [0.0, -0.3]])
    assert rows["reason"].tolist() == [VALID, COLLIDES, VALID]  # where it is now is no obstacle
    table = arm.node.objects.table
    slots = table.find_named([NAME, "crate/1"])
    ids = list(zip(table.ns[slots].tolist(), table.id[slots].tolist(), strict=True))
    pairs = [tuple(rows[name][1] for name in ("ns_a", "id_a", "ns_b", "id_b"))]
    assert pairs == [(*ids[0], *ids[1])]


def test_it_can_be_exchanged_moved_and_detached(arm: ValidityRig) -> None:
    there = [[0.0, np.pi / 2]]
    put(arm, cube(CRATE, (0.0, 1.3, 0.5), EDGES), held())
    assert arm.reasons(there) == [COLLIDES]
    put(arm, held((1.5, 0.0, 0.0)))
    assert arm.reasons(there) == [VALID]
    put(arm, held((1.5, 0.0, 0.0), (0.5, 0.1, 0.1)))
    assert arm.reasons(there) == [COLLIDES]
    put(arm, held(action=Marker.DELETE))
    assert arm.reasons(there) == [VALID]
    put(arm, held(), cube(TOOL, (0.0, -1.0, 0.5), EDGES))  # put down where the hand may be
    assert arm.reasons([*there, [0.0, -np.pi / 2]]) == [VALID, COLLIDES]


def test_it_is_detached_at_once_by_markers_that_are_applied_between_two_cycles() -> None:
    """A pose applies the markers that came before it; a question may come right behind it."""
    with ValidityRig({"ignored_objects": ["nobody/*"]}) as rig:
        rig.start_robot()
        put(rig, held())
        assert rig.node.robots is not None
        checked = rig.node.robots._validity["arm/states_to_check"]._checked
        assert checked.scene().attached == {NAME: HAND}
        takes = rig.node.inputs.callbacks()
        takes["objects"](serialize_message(MarkerArray(markers=[held(action=Marker.DELETE)])))
        takes["object_transform"](serialize_message(TransformStamped(child_frame_id="nobody/1")))
        assert checked.scene().attached == {}


def test_without_knowing_the_joints_it_is_grey_and_no_state_valid(arm: ValidityRig) -> None:
    put(arm, held())
    slot = arm.node.objects.table.find_named([NAME])[0]
    arm.send_joints(turn=float("nan"))
    arm.until(lambda: arm.node.objects.table.doubtful[slot], "grey")
    assert arm.reasons([[0.0, 0.0]]) == [NOT_KNOWN]
    quarter(arm, 0.0)
    assert not arm.node.objects.table.doubtful[slot]
    assert arm.reasons([[0.0, 0.0]]) == [VALID]


def test_it_may_come_before_its_robot() -> None:
    with ValidityRig() as rig:
        rig.send(held())
        rig.cycles(2)
        table = rig.node.objects.table
        assert table.unplaceable[table.find_named([NAME])[0]]
        rig.start_robot()
        rig.until(lambda: not table.has(UNPLACED, table.find_named([NAME])[0]), "its place")
        assert rig.reasons([[0.0, 0.0]]) == [VALID]
        rig.describe(URDF.replace('"hand"', '"palm"'))
        rig.until(lambda: "palm" in str(rig.robot.links and rig.robot.links.rows), "the robot")
        rig.send_joints(turn=0.0, lift=0.0)
        rig.until(lambda: table.doubtful[table.find_named([NAME])[0]], "grey: it has no such link")
        assert rig.reasons([[0.0, 0.0]]) == [NOT_KNOWN]


def test_the_frame_of_no_link_is_refused_and_states_are_not_valid(arm: ValidityRig) -> None:
    put(arm, held(frame="arm/foot"))
    assert arm.refused("objects") == {"unknown frame": 1}
    assert arm.reasons([[0.0, 0.0]]) == [NOT_KNOWN]


@each("by_tf", [False, True])
def test_the_frame_may_be_that_of_tf(by_tf: bool) -> None:
    frames = FakeFrames()
    options = {"frames": frames, "given": {"robot_bases": [""]}} if by_tf else {}
    frames.known["base"] = [0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0]
    with ValidityRig(**options) as rig:
        rig.start_robot()
        put(rig, held(frame="hand"))
        height = 0.7 if by_tf else 0.5
        np.testing.assert_allclose(rig.pose_of(TOOL)[:3], (1.3, 0.0, height), atol=1e-12)
        put(rig, cube(CRATE, (0.0, 1.3, height), EDGES))
        assert rig.reasons([[0.0, 0.0], [0.0, np.pi / 2]]) == [VALID, COLLIDES]


def test_a_marker_that_is_not_locked_is_an_obstacle(arm: ValidityRig) -> None:
    marker = held()
    marker.frame_locked = False
    put(arm, marker, stamped=False)
    quarter(arm)
    np.testing.assert_allclose(arm.pose_of(TOOL)[:3], (1.3, 0.0, 0.5), atol=1e-12)
    assert not len(arm.robot.attached.slots)


def test_two_that_one_link_holds_may_touch(arm: ValidityRig) -> None:
    other = held((1.35, 0.0, 0.0))
    other.id = 2
    put(arm, held(), other)
    assert arm.pairs() == set()
    assert arm.reasons([[0.0, 0.0]]) == [VALID]


def test_trajectories_are_refused_and_stopped_for_what_is_attached() -> None:
    with TrajectoryRig() as rig:
        put(rig, cube(CRATE, (0.0, 1.3, 0.5), EDGES))
        slow = [QUARTER[0], (1000.0, QUARTER[1][1])]
        assert rig.go(slow)[0].message == "forwarded"
        rig.said.clear()
        rig.send(held())
        assert rig.stopped().startswith(f"stopped: not free: {NAME} and crate/1")
        assert rig.go(slow)[0].message.startswith(f"refused: not free: {NAME} and crate/1")
