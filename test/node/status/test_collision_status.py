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

"""What is known of collisions: free, colliding, or not known and why; and when that is said."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from each import each
from objects_rig import SECOND, START, ObjectsRig
from rclpy.duration import Duration as Seconds
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rig import A1, A2, B1, FRAME, OUTPUTS, POSES, STATUS, FakeFrames, Patch, Rig, cube, pose
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Bool, Header
from std_srvs.srv import SetBool
from visualization_msgs.msg import Marker

from obb_collision.node import boxes_to_ros, namespace_number, poses_to_ros
from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN, Answer, Reason
from obb_collision.node.inputs import detections
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.conversions import stamp_from_ros, stamp_to_ros
from obb_collision.node.node import CollisionNode
from obb_collision.node.objects import MAX_NAMES, MAX_READ, MEMORY, UnknownObjects
from obb_collision.node.parameters import ready
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.status import PERIOD, CollisionStatus
from obb_collision.scene.store.patterns import Overrides

A = namespace_number("a")
APART = cube(A1), cube(A2, (3, 0, 0))
MOST = 3
"""Rows that a cloud may have."""


def test_free_and_colliding_are_told_with_stamp_and_age(rig: Rig) -> None:
    rig.send(*APART).answer()
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
        rig.send(cube(A1), cube(A2, (0.5, 0, 0))).answer()
        rig.says(COLLIDING, flag=True)
        rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=False))
        rig.says(UNKNOWN, "disabled", False)
        rig.set(unknown_is_collision=True)
        rig.says(UNKNOWN, "disabled", True)


def test_a_cycle_that_does_not_end_is_told_by_another_thread(monkeypatch: Patch) -> None:
    with Rig(cycle_timeout=0.1) as rig:
        rig.send(cube(A1)).answer()
        rig.says(FREE, flag=False)
        publisher = rig.node.outputs.publishers[STATUS]
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


def test_before_the_first_check_nothing_is_known_and_why(rig: Rig, monkeypatch: Patch) -> None:
    said: list[Any] = []
    flags: list[Any] = []
    qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    kind = OUTPUTS[STATUS].message

    def take(message: Any) -> None:
        said.append(message.status[0])

    rig.client.create_subscription(kind, f"/cell/{STATUS}", take, qos)
    rig.client.create_subscription(Bool, "/cell/in_collision", flags.append, qos)
    prepare, reason = ready.Kernels.prepare, "starting, compiling: 3 kernels"

    def compiling(kernels: ready.Kernels, parameters: Any) -> None:
        kernels._report("compiling: 3 kernels")
        rig.until(lambda: said and said[-1].message == reason, "the reason")
        prepare(kernels, parameters)

    monkeypatch.setattr(ready.Kernels, "prepare", compiling)
    empty = [Parameter("expect_empty", value=True)]
    other = CollisionNode(context=rig.context, namespace="cell", parameter_overrides=empty)
    try:
        rig.until(lambda: flags, "the flag of a node that nobody spins")
        assert {status.level for status in said} == {UNKNOWN}
        assert {status.message for status in said} <= {"starting", reason}
        assert {flag.data for flag in flags} == {True}
        rig.executor.add_node(other)
        rig.until(lambda: said[-1].level == FREE, "first check")
    finally:
        rig.executor.remove_node(other)
        other.destroy_node()


def test_without_clock_nothing_is_free_nor_while_it_stands_still_and_messages_come() -> None:
    """A paused simulation that sends nothing is as it was; then only silence is noticed."""
    given = {"use_sim_time": True, "object_timeout_overrides": ["a/1: 0.4"], "cycle_timeout": 30.0}
    with Rig(given=given) as rig:
        clock = rig.client.create_publisher(Clock, "/clock", 10)
        rig.until(lambda: clock.get_subscription_count() > 0, "match")
        monitor, time = rig.monitor("object_transform"), rig.node.time

        def tell(moves: bool) -> None:
            count = monitor.messages
            if moves:
                rig.stamp += SECOND // 10
                clock.publish(Clock(clock=stamp_to_ros(rig.stamp)))
                rig.until(lambda: rig.now() == rig.stamp, "time")
            rig.send_transform("a/1", pose(0))
            rig.until(lambda: monitor.messages > count, "the message")

        rig.send(*APART, stamped=False)
        rig.says(UNKNOWN, "clock_stopped", True, reason="clock_stopped")
        assert "no message on /clock" in rig.node.status.answer.message
        for _ in range(2):
            tell(moves=True)
            rig.known()
            end = time.moved + 0.5
            rig.until(lambda: rig.node.steady() > end, "a while")  # noqa: B023
            rig.cycles(2)
            rig.known()
            tell(moves=False)
            rig.says(UNKNOWN, "clock_stopped", True, reason="clock_stopped")
        rig.set(input_timeout=0.1)
        tell(moves=True)
        rig.known("input_silent")


def test_a_scene_file_says_what_there_is_even_if_that_is_nothing(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    for objects in ("[]", "[{name: part/1, shape: box, size: [1, 1, 1], position: [0, 0, 0]}]"):
        file.write_text(f"padding: 0.01\nobjects: {objects}\n")
        with Rig(scene_file=str(file)) as rig:
            rig.known()


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
    **{
        f"old by its stamp, by {topic}": (
            {"object_timeout_overrides": ["a/1: 1000"]},
            partial(Rig.send_by, topic=topic, poses={A1: pose(0.0)}),
            ("stale", "a/1"),
            lambda rig: rig.set(judge_ages="receipt"),
        )
        for topic in POSES
    },
    "a box that is old by its stamp": (
        {"object_timeout_overrides": ["boxes/*: 1000"]},
        lambda rig: rig.send_boxes([1], [pose(9.0)]),
        ("stale", "boxes/1"),
        lambda rig: rig.set(judge_ages="receipt"),
    ),
    "followed the transform of a frame that has died": (
        {"object_timeout": 1000.0, "object_timeout_overrides": ["boxes/*: 1000"]},
        lambda rig: followers(rig, rig.stamp),
        ("stale", "b/1, boxes/1"),
        lambda rig: followers(rig, rig.now()),
    ),
    "deleted and added with each message": (
        {"object_timeout": 0.2},
        lambda rig: rig.send(Marker(action=Marker.DELETEALL), *APART),
        ("stale", "a/1, a/2"),
        lambda rig: rig.set(object_timeout=0.0),
    ),
}


def followers(rig: Rig, latest: int) -> None:
    """Send what is placed by the latest transform of a frame: once what follows it, and a set."""
    frames: Any = rig.node.frames
    frames.spans["robot"] = 0, latest
    slots = rig.node.objects.table.slots
    if B1 not in slots:
        rig.send(cube(B1, (5, 0, 0), frame="robot", frame_locked=True))
        rig.until(lambda: B1 in slots, "an object")
    message = boxes_to_ros([1], [pose(9.0)], np.ones((1, 3)), header=Header(frame_id="robot"))
    rig.pubs["object_boxes"].publish(message)


@each("name", TABLE)
def test_a_code_is_reached_and_left_again(name: str) -> None:
    """Beside what ``test_evidence_model`` reaches: who is named, over topics."""
    parameters, enter, (code, who), leave = TABLE[name]
    with Rig(frames=FakeFrames(), given=parameters) as rig:
        rig.send(*APART).answer()
        enter(rig)
        rig.known(code, who)
        leave(rig)
        rig.known()


def test_lifetimes_text_and_deletions_of_others_do_not_say_there_is_nothing(rig: Rig) -> None:
    rig.known("no_objects")
    short = cube(B1, lifetime=Duration(nanosec=20_000_000))
    text = cube(B1, type=Marker.TEXT_VIEW_FACING, text="hello")
    gone = [cube(B1, action=Marker.DELETE), text, cube(("b", 2), action=Marker.DELETEALL)]
    for sent in ([short], gone):
        rig.send(*sent)
        rig.cycles(3)
        rig.known("no_objects")
    rig.send(cube(A1, size=(0, 1, 1)))
    rig.known("refused", "a/1 (bad scale)")
    rig.send(cube(A1, action=Marker.DELETE))
    rig.known()


def test_what_cannot_be_read_marks_its_input_until_that_is_read_again(monkeypatch: Patch) -> None:
    """Beside what ``test_evidence_model`` sends: detections, too many rows, keys of no object."""
    # bytes are read as what they are, whatever type is said of the topic: vision_msgs are rare
    monkeypatch.setattr(detections, "INPUTS", {"detections": Input(PointCloud2, 10)})
    header, many = Header(frame_id=FRAME), list(range(MOST + 1))
    boxes, nobody = (boxes_to_ros([n], [pose(9)], np.ones((1, 3)), None, header) for n in (7, -1))
    nobody.fields[-1].datatype = PointField.UINT32  # an id that no object can have
    none_detected = serialize_message(header) + bytes(4)
    good = {
        "object_poses": poses_to_ros([1, 2], [pose(0), pose(3)], [A, A], header),
        "object_boxes": boxes,
        "detections": none_detected,
    }
    broken: list[tuple[str, Any]] = [
        ("object_poses", poses_to_ros(many, [pose(0)] * len(many), None, header)),
        ("object_boxes", boxes_to_ros(many, [pose(0)] * len(many), np.ones((len(many), 3)))),
        ("object_boxes", nobody),
        *(("detections", none_detected[:end]) for end in (7, -4, -1)),
        ("detections", none_detected[:-4] + (MOST + 1).to_bytes(4, "little")),
    ]
    with Rig(max_cloud_points=MOST) as rig:
        rig.send(*APART).answer()
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
    assert found.reasons == (blocked, stale)
    assert (found.level, found.flag(True), found.flag(False)) == (UNKNOWN, True, False)
    status = found.to_ros("node", START, True)
    values = {pair.key: pair.value for pair in status.values}
    assert (values["reason"], values["who"], values["reasons"]) == ("blocked", "", "blocked stale")
    assert "a/1 and 11 more" in status.message
    assert Answer((stale,), pairs=1).level == COLLIDING
    assert Answer((stale,), pairs=1).flag(False)


class Recorder:
    """Stands for the publishers and the topics of CollisionStatus."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.now = 0.0
        self.modes = {"collision_status": "auto", "in_collision": "auto"}
        self.subscribed = True
        self.rate, self.unknown_is_collision = 50.0, True
        stands_for: Any = self
        self.status = CollisionStatus(
            "node",
            {STATUS: stands_for, "in_collision": stands_for},
            self,
            lambda: self.unknown_is_collision,
            lambda: START,
            Guard(pytest.fail, lambda: True),
            lambda: 1.0 / self.rate + 0.5,
            lambda: self.now,
        )

    def publish(self, message: Any) -> None:
        self.sent.append(message)

    def is_off(self, name: str) -> bool:
        return self.modes[name] == "off"

    def is_requested(self, name: str) -> bool:
        return self.modes[name] == "on" or (self.modes[name] == "auto" and self.subscribed)

    def wait_for_all_acked(self, timeout: Seconds) -> bool:
        return True

    def take(self) -> tuple[list[str], list[bool]]:
        """Codes of the status, and flags, since the last call."""
        taken, self.sent = self.sent, []
        told = [message.status[0].values for message in taken if hasattr(message, "status")]
        return (
            [pair.value for values in told for pair in values if pair.key == "reasons"],
            [message.data for message in taken if hasattr(message, "data")],
        )


OK, PAIRS = Answer(()), Answer((), pairs=1)


def test_the_watchdog_says_that_the_cycle_is_blocked_and_until_then_repeats() -> None:
    recorder = Recorder()
    status = recorder.status
    status.rest()
    assert recorder.take() == (["starting"], [True])
    status.update(OK, cycle=True)
    assert recorder.take() == ([""], [False])
    for step in range(1, 5):
        recorder.now = step * PERIOD
        status.look()
    codes, flags = recorder.take()
    assert set(codes) == {""}
    assert len(codes) >= 2
    assert flags == []
    recorder.now = 0.53
    status.look()
    assert recorder.take() == (["blocked"], [True])
    recorder.now = 0.7
    status.look()
    assert recorder.take() == (["blocked"], [])
    status.update(OK, cycle=True)
    assert recorder.take() == ([""], [False])
    recorder.rate = 0.5  # Hz
    for since, code in ((2.4, ""), (2.6, "blocked")):
        recorder.now = 0.7 + since
        status.look()
        assert recorder.take()[0] == [code]


def test_at_fifty_cycles_a_second_ten_are_told_and_changes_at_once() -> None:
    recorder = Recorder()
    for cycle in range(50):
        recorder.now = cycle * 0.02
        recorder.status.update(OK, cycle=True)
        recorder.status.look()
    codes, flags = recorder.take()
    assert 9 <= len(codes) <= 11
    assert flags == [False] * 50, "the flag every cycle while subscribed"
    stale = Reason("stale", ("a/1",))
    for other in (PAIRS, OK.but(stale), OK.but(Reason("stale", ("a/2",))), OK):
        recorder.now += 0.001
        recorder.status.update(other, cycle=True)
        codes, flags = recorder.take()
        assert (len(codes), flags) == (1, [other is not OK])


def test_unheard_only_changes_are_told_and_off_nothing() -> None:
    recorder = Recorder()
    recorder.subscribed = False
    recorder.status.update(OK, cycle=True)
    assert recorder.take() == ([""], [False])
    recorder.now = 0.4
    recorder.status.update(OK, cycle=True)
    recorder.status.look()
    assert recorder.take() == ([], [])
    recorder.status.update(OK.but(Reason("unplaced")), cycle=True)
    assert recorder.take() == (["unplaced"], [True])
    recorder.modes = dict.fromkeys(recorder.modes, "off")
    assert recorder.status.is_off
    recorder.status.update(OK, cycle=True)
    recorder.now = 99.0
    recorder.status.look()
    assert recorder.take() == ([], [])


def test_the_last_word_is_that_it_ends() -> None:
    recorder = Recorder()
    recorder.status.update(OK, cycle=True)
    recorder.take()
    recorder.status.close()
    assert recorder.take() == (["shutting_down"], [True])
    recorder.status.update(OK, cycle=True)
    recorder.status.look()
    recorder.status.close()
    assert recorder.take() == ([], [])
