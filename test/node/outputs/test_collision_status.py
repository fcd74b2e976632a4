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

"""What is known of collisions: free, colliding, or not known and why, over topics."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from objects_rig import SECOND, START, ObjectsRig
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rig import FRAME, OUTPUTS, STATUS, FakeFrames, Rig, cube, pose
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool, Header
from std_srvs.srv import SetBool
from visualization_msgs.msg import Marker

from obb_collision.node import boxes_to_ros, namespace_number, poses_to_ros
from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN, Answer, Reason
from obb_collision.node.inputs import detections
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.node.messages.conversions import stamp_from_ros
from obb_collision.node.node import CollisionNode
from obb_collision.node.objects import MAX_NAMES, MAX_READ, MEMORY, UnknownObjects
from obb_collision.node.runtime import warm_up
from obb_collision.scene.store import Overrides

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
PAIR = (cube(A1), cube(A2, (0.5, 0, 0)))
A = namespace_number("a")
APART = cube(A1), cube(A2, (3, 0, 0))
MOST = 3
"""Rows that a cloud may have."""


def test_free_and_colliding_are_told_with_stamp_and_age() -> None:
    with Rig() as rig:
        rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
        before = rig.now()
        rig.until(lambda: rig.says(FREE, flag=False)["objects"] == "2", "both")
        values = rig.says(FREE, flag=False)
        assert stamp_from_ros(rig.last[STATUS].header.stamp) >= before - SECOND
        assert values["objects"] == "2"
        assert values["colliding pairs"] == "0"
        age = (rig.now() - rig.stamp) / SECOND
        assert float(values["age of the newest state (s)"]) == pytest.approx(age, abs=60.0)
        rig.send_transform("a/2", pose(0.5))
        values = rig.says(COLLIDING, flag=True)
        assert values["colliding pairs"] == "1"


def test_the_radius_of_clearances_holds_for_all_pairs_or_is_said_of_selected_objects_only() -> None:
    radii = "clearance radius (m)", "clearance radius of selected objects (m)"
    with Rig(given={"effects.clearance_max_distance": 0.7}) as rig:
        rig.send(cube(A1), cube(A2, (1.5, 0, 0)), cube(B1, (3, 0, 0))).answer()
        for objects, radius in ((["*"], "0.7"), (["b/*"], "0.0"), (["b/*", "*"], "0.7")):
            rig.set(**{"effects.clearance_objects": objects})

            def is_said(radius: str = radius) -> bool:
                return [rig.says(FREE)[key] for key in radii] == [radius, "0.7"]

            rig.until(is_said, f"{objects}")
        rig.set(**{"effects.clearance": "off"})
        rig.until(lambda: not rig.says(FREE).keys() & set(radii), "no radius")


def test_with_unknown_is_collision_off_the_flag_tells_of_collisions_only() -> None:
    with Rig(unknown_is_collision=False) as rig:
        rig.send(*PAIR).answer()
        rig.says(COLLIDING, flag=True)
        rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=False))
        rig.says(UNKNOWN, "disabled", False)
        rig.set(unknown_is_collision=True)
        rig.says(UNKNOWN, "disabled", True)


def test_a_cycle_that_does_not_end_is_told_by_another_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with Rig(cycle_timeout=0.1) as rig:
        rig.listen(STATUS)
        rig.send(cube(A1)).answer()
        rig.says(FREE, flag=False)
        publisher = rig.publisher(STATUS)
        publish, told = publisher.publish, threading.Event()

        def noted(message: Any) -> None:
            publish(message)
            if "blocked" in message.status[0].message:
                told.set()

        monkeypatch.setattr(publisher, "publish", noted)
        update = rig.node.objects.update
        blocked: list[bool] = []

        def block(now: int) -> None:
            update(now)
            if not blocked:
                blocked.append(told.wait(30.0))

        monkeypatch.setattr(rig.node.objects, "update", block)
        rig.until(lambda: blocked, "a blocked cycle")
        assert blocked == [True], "told while it was blocked"
        rig.says(FREE, flag=False)


def test_before_the_first_check_nothing_is_known() -> None:
    with Rig() as rig:
        status: list[Any] = []
        flags: list[Any] = []
        qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        rig.client.create_subscription(
            OUTPUTS[STATUS].message, f"/cell/{STATUS}", status.append, qos
        )
        rig.client.create_subscription(Bool, "/cell/in_collision", flags.append, qos)
        empty = [Parameter("expect_empty", value=True)]
        other = CollisionNode(context=rig.context, namespace="cell", parameter_overrides=empty)
        try:
            rig.until(lambda: status and flags, "status of a node that nobody spins")
            assert (status[0].status[0].level, flags[0].data) == (UNKNOWN, True)
            assert {message.status[0].message for message in status} == {"starting"}
            rig.executor.add_node(other)
            rig.until(lambda: status[-1].status[0].level == FREE, "first check")
        finally:
            rig.executor.remove_node(other)
            other.destroy_node()


def test_a_start_that_compiles_says_so_in_the_status(monkeypatch: pytest.MonkeyPatch) -> None:
    with Rig() as rig:
        status: list[Any] = []
        qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        topic, kind = f"/cell/{STATUS}", OUTPUTS[STATUS].message
        rig.client.create_subscription(kind, topic, status.append, qos)
        start = warm_up.WarmUp.start

        def compiling(warm: warm_up.WarmUp, things: Any, report: Callable[[str], None]) -> None:
            report("compiling: 3 kernels")
            reason = "starting, compiling: 3 kernels"
            rig.until(lambda: status and status[-1].status[0].message == reason, "the reason")
            assert {message.status[0].level for message in status} == {UNKNOWN}
            start(warm, things, report)

        monkeypatch.setattr(warm_up.WarmUp, "start", compiling)
        CollisionNode(context=rig.context, namespace="cell").destroy_node()
        assert status


def test_a_stop_of_input_is_stale_while_the_clock_of_the_simulation_stands_still() -> None:
    with Rig(given={"input_timeout": 0.4, "use_sim_time": True}) as rig:
        rig.send(cube(A1), cube(A2, (3, 0, 0)), stamped=False)
        rig.says(UNKNOWN, "input_silent", True)
        assert rig.now() == 0, "no message of /clock"

        def heard() -> bool:
            rig.send_transform("a/1", pose(0))
            return rig.node.status.answer.level == FREE

        rig.until(heard, "free")
        rig.says(UNKNOWN, "input_silent", True)


@contextmanager
def told(*markers: Marker, **options: Any) -> Iterator[Rig]:
    """Yield a rig with some objects."""
    with Rig(**options) as rig:
        if markers:
            rig.send(*markers).answer()
        yield rig


def delete(*keys: tuple[str, int], action: int = Marker.DELETE) -> list[Marker]:
    return [Marker(ns=ns, id=ident, action=action) for ns, ident in keys]


def test_a_scene_file_says_what_there_is_even_if_that_is_nothing(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    for objects in ("[]", "[{name: part/1, shape: box, size: [1, 1, 1], position: [0, 0, 0]}]"):
        file.write_text(f"padding: 0.01\nobjects: {objects}\n")
        with told(scene_file=str(file)) as rig:
            rig.known()


def no_name(full: PointCloud2) -> PointCloud2:
    """Return a cloud with an id that no object can have."""
    rows = cloud_from_ros(full, [field.name for field in full.fields])
    kinds = [
        (name, "<f8" if kind.kind == "f" else "<u4")
        for name, (kind, *_) in (rows.dtype.fields or {}).items()
    ]
    rows = rows.astype(kinds)
    rows["id"] = 0xFFFFFFFF
    return cloud_to_ros(rows, full.header)


Step = Callable[[Rig], Any]
TABLE: dict[str, tuple[dict[str, Any], Step, tuple[str, str], Step]] = {
    "required objects": (
        {"groups": ["these: a/1 c/*"], "required_objects": ["these", "a/?"]},
        lambda rig: None,
        ("required_missing", "c/*"),
        lambda rig: rig.send(cube(("c", 7), (9, 0, 0))),
    ),
    "input_timeout": (
        {},
        lambda rig: rig.set(input_timeout=0.1),
        ("input_silent", "all"),
        lambda rig: rig.set(input_timeout=1000.0),
    ),
    "unknown objects": (
        {"ignored_objects": ["dust/*"]},
        lambda rig: rig.send_states(["dust/1", "a/1", "c/3"], [pose(0)] * 3),
        ("unknown_objects", "c/3"),
        lambda rig: None,
    ),
    "late_frame": (
        {"transform_timeout": 0.05},
        lambda rig: rig.send_transform("a/1", pose(0), "arm"),
        ("late_frame", "a/1"),
        lambda rig: rig.send_transform("a/1", pose(0)),
    ),
    "deleted and added with each message": (
        {"object_timeout": 0.2},
        lambda rig: rig.send(Marker(action=Marker.DELETEALL), *APART),
        ("stale", "a/1, a/2"),
        lambda rig: rig.set(object_timeout=0.0),
    ),
}


@each("name", TABLE)
def test_a_code_is_reached_and_left_again(name: str) -> None:
    """Beside what ``test_evidence_model`` reaches: who is named, over topics."""
    parameters, enter, (code, who), leave = TABLE[name]
    with told(*APART, frames=FakeFrames(), given=parameters) as rig:
        enter(rig)
        rig.known(code, who)
        leave(rig)
        rig.known()


def test_neither_lifetimes_nor_text_nor_deletions_of_others_say_that_there_is_nothing() -> None:
    with told() as rig:
        rig.known("no_objects")
        marker = cube(B1)
        marker.lifetime.nanosec = 20_000_000
        text = cube(B1, type=Marker.TEXT_VIEW_FACING, text="hello")
        for sent in ([marker], [*delete(B1, ("b", 2)), text, *delete(("b", 2), action=3)]):
            rig.send(*sent)
            rig.cycles(3)
            rig.known("no_objects")
        rig.send(cube(A1, size=(0, 1, 1)))
        rig.known("refused", "a/1 (bad scale)")
        rig.send(*delete(A1))
        rig.known()


def test_what_cannot_be_read_marks_its_input_until_that_is_read_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside what ``test_evidence_model`` sends: detections, too many rows, keys of no object."""
    # bytes are read as what they are, whatever type is said of the topic: vision_msgs are rare
    monkeypatch.setattr(detections, "INPUTS", {"detections": Input(PointCloud2, 10)})
    header, many = Header(frame_id=FRAME), list(range(MOST + 1))
    boxes = boxes_to_ros([7], [pose(9)], np.ones((1, 3)), None, header)
    none_detected = serialize_message(header) + bytes(4)
    good = {
        "object_poses": poses_to_ros([1, 2], [pose(0), pose(3)], [A, A], header),
        "object_boxes": boxes,
        "detections": none_detected,
    }
    broken: list[tuple[str, Any]] = [
        ("object_poses", poses_to_ros(many, [pose(0)] * len(many), None, header)),
        ("object_boxes", boxes_to_ros(many, [pose(0)] * len(many), np.ones((len(many), 3)))),
        ("object_boxes", no_name(boxes)),
        *(("detections", none_detected[:end]) for end in (7, -4, -1)),
        ("detections", none_detected[:-4] + (MOST + 1).to_bytes(4, "little")),
    ]
    with told(*APART, max_cloud_points=MOST) as rig:
        rig.pubs["detections"] = rig.client.create_publisher(PointCloud2, "detections", 10)
        rig.wait_inputs()
        for topic, message in broken:
            rig.pubs[topic].publish(message)
            rig.known("input_unreadable", topic)
            rig.pubs[topic].publish(good[topic])
            rig.known()
        rig.pubs["points"].publish(serialize_message(boxes)[:-9])
        rig.until(lambda: rig.refused("points"), "points that cannot be read")
        rig.cycles(2)
        rig.known()


def test_names_of_unknown_objects_count_for_a_second_and_not_after_their_delete() -> None:
    rig = ObjectsRig(A1)
    unknown = UnknownObjects(rig.objects.table)
    unknown.ignored = Overrides([("dust/*", True)])
    unknown.note(["a/1", "/a/2", "b/1", "dust/7"], START)
    assert unknown.names(START) == ["a/2", "b/1"]
    unknown.deleted([B1], START + 1)
    unknown.note(["b/1"], START + MEMORY)
    assert unknown.names(START + MEMORY - 1) == ["a/2"]
    assert unknown.names(START + MEMORY) == []
    unknown.note(["b/1"], START + MEMORY + 1)
    unknown.clock_jumped(-MEMORY)
    assert unknown.names(START + 1) == ["b/1"]
    dust = [f"dust/{number}" for number in range(MAX_READ)]
    unknown.note([*dust[1:], "a/2"], START + 1)
    assert unknown.names(START + 1) == ["b/1", "a/2"]
    assert not unknown.left_out(START + 1)
    unknown.note([*dust, "dust/unread"], START + 1)
    assert unknown.left_out(START + 1), "whether that is ignored is not known"
    unknown.note((f"c/{number}" for number in range(2 * MAX_NAMES)), START + 1)
    assert len(unknown.names(START + 1)) == MAX_NAMES
    assert unknown.left_out(START + MEMORY), "there are at least so many"
    assert not unknown.left_out(START + MEMORY + 1)


def test_reasons_are_in_the_order_of_the_codes_each_once_and_pairs_come_first() -> None:
    stale, blocked = Reason("stale", ("a/1",), 12), Reason("blocked")
    found = Answer((), stamp=None).but(stale).but(blocked, Reason("stale", ("a/2",)))
    assert [(each.code, each.who) for each in found.reasons] == [
        ("blocked", ()),
        ("stale", ("a/1",)),
    ]
    assert (found.level, found.flag(True), found.flag(False)) == (UNKNOWN, True, False)
    status = found.to_ros("node", START, True)
    values = {pair.key: pair.value for pair in status.values}
    assert (values["reason"], values["who"], values["reasons"]) == ("blocked", "", "blocked stale")
    assert "a/1 and 11 more" in status.message
    assert Answer((stale,), pairs=1).level == COLLIDING
    assert Answer((stale,), pairs=1).flag(False)
