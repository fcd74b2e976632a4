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

"""Stamps that make no sense: said, marked, and recovered from by rule."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Time
from each import each
from effect_topics import listening
from objects_rig import MILLISECOND, SECOND, START, ObjectsRig, place
from rig import FRAME, Rig, cube, pose, sync
from std_msgs.msg import Header

from obb_collision.node.messages.conversions import stamp_from_ros, stamp_to_ros, states_to_ros
from obb_collision.node.objects.states import AHEAD, ANEW

A1, A2 = ("a", 1), ("a", 2)
TOPIC = "object_states"
HOUR = 3600 * SECOND


def test_a_stamp_from_the_future_is_used_marked_and_neither_order_nor_output() -> None:
    rig = ObjectsRig(A1, A2)
    rig.send(START)
    rig.send(START + HOUR, row=0)
    rig.cycle()
    assert rig.x() == place(START + HOUR), "it is the latest word"
    assert (rig.is_doubtful(0), rig.is_doubtful(1)) == (True, False)
    assert rig.doubted == {(TOPIC, AHEAD): 1}
    assert rig.objects.newest_stamp(rig.now) == START
    rig.now += SECOND // 50
    assert rig.send(rig.now) == 0
    rig.cycle()
    assert rig.x() == place(rig.now), "the next good one counts at once"
    assert not rig.is_doubtful()
    assert rig.objects.newest_stamp(rig.now) == rig.now


def test_within_the_tolerance_a_clock_that_is_ahead_is_no_fault() -> None:
    rig = ObjectsRig(A1)
    rig.send(START + SECOND // 2)
    rig.cycle()
    assert not rig.is_doubtful()
    assert rig.objects.newest_stamp(rig.now) == START + SECOND // 2
    assert not rig.doubted


def test_senders_far_ahead_of_the_node_move_their_objects_all_the_same() -> None:
    rig = ObjectsRig(A1)  # as on a robot that begins in 1970
    for _ in range(10):
        rig.now += 20 * MILLISECOND
        assert rig.send(rig.now + HOUR) == 0
        rig.cycle()
        assert rig.x() == place(rig.now + HOUR)
        assert rig.is_doubtful()
        assert rig.objects.newest_stamp(rig.now) == rig.now, "time of receipt"
    assert rig.doubted[TOPIC, AHEAD] == 10
    rig.now += HOUR
    rig.objects.clock_jumped(HOUR)
    rig.cycle()
    assert not rig.is_doubtful(), "once the clock is right"


def test_senders_far_behind_the_node_are_no_fault() -> None:
    rig = ObjectsRig(A1)
    for step in range(1, 10):
        rig.now += 20 * MILLISECOND
        rig.send(step)
        rig.cycle()
        assert rig.objects.newest_stamp(rig.now) == step
    assert not rig.is_doubtful()
    assert not rig.doubted


def test_stamps_that_begin_anew_are_refused_for_a_moment_marked_and_then_taken() -> None:
    rig = ObjectsRig(A1)
    loop, end = START - 100 * SECOND, START + SECOND
    while rig.now < end:
        rig.now += 20 * MILLISECOND
        rig.send(rig.now)
        rig.cycle()
    held = [False]
    refused = 0
    while rig.now < end + 2 * SECOND:
        rig.now += 20 * MILLISECOND
        stamp = loop + rig.now - end
        refused += rig.send(stamp)
        rig.cycle()
        held.append(rig.is_doubtful())
    assert refused == 50, "one second of fifty a second"
    assert rig.x() == place(loop + rig.now - end)
    assert rig.doubted == {(TOPIC, ANEW): 1}
    assert held.index(True) == 26, "grey after half a second"
    assert held[50:] == [True] + [False] * (len(held) - 51)
    assert rig.objects.newest_stamp(rig.now) == loop + rig.now - end


def test_a_slow_sender_that_begins_anew_is_taken_at_once() -> None:
    rig = ObjectsRig(A1)
    rig.send(START)
    rig.now += 2 * SECOND
    assert rig.send(START - HOUR) == 0
    rig.cycle()
    assert rig.x() == place(START - HOUR)
    assert rig.doubted == {(TOPIC, ANEW): 1}


def test_messages_that_overtake_each_other_do_not_move_an_object_back() -> None:
    rig = ObjectsRig(A1)
    for step in range(20):
        rig.now += 20 * MILLISECOND
        rig.send(rig.now)
        assert rig.send(rig.now - 10 * MILLISECOND) == 1
        rig.cycle()
        assert rig.x() == place(rig.now), step
        assert not rig.is_doubtful(), "a newer one is there"
    assert not rig.doubted


def test_a_straggler_without_anything_after_it_marks_nothing_for_good() -> None:
    rig = ObjectsRig(A1)
    rig.send(START)
    assert rig.send(START - MILLISECOND) == 1
    for _ in range(3):
        rig.now += 700 * MILLISECOND
        rig.cycle()
    assert not rig.is_doubtful()
    assert rig.x() == place(START)


def test_a_state_without_a_stamp_is_always_taken_and_orders_nothing() -> None:
    rig = ObjectsRig(A1)
    rig.send(START)
    assert rig.send(0) == 0
    assert rig.send(START + 1) == 0
    rig.cycle()
    assert rig.objects.newest_stamp(rig.now) == START + 1


@each("newest", [START - 5, START + HOUR])
def test_markers_follow_the_same_rule(newest: int) -> None:
    rig = ObjectsRig(A1)
    rig.send(newest)
    slots, stamps = np.array([rig.slots[0], -1]), np.array([START - 10, 1])

    def late(received: int) -> list[bool]:
        found: list[bool] = rig.objects.states.find_late(
            slots, stamps, np.full(2, received)
        ).tolist()
        return found

    assert late(rig.now) == [newest < START, False], "-1 is a new object"
    assert late(rig.now + 2 * SECOND) == [False, False]


def test_by_topics_a_marker_of_the_future_among_others_does_not_outlast_them(rig: Rig) -> None:
    rig.send(cube(A2))
    rig.answer()
    markers = [cube(A1, (x, 0, 0)) for x in (5.0, 0.5, 0.25)]
    rig.stamp += 1
    for marker, stamp in zip(markers, (rig.now() + HOUR, rig.stamp, rig.stamp + 1), strict=True):
        marker.header.stamp = stamp_to_ros(stamp)
    rig.stamp += 1
    rig.send(*markers, stamped=False)
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.pose_of(A1)[0] == 0.25


BAD = [Time(sec=2**31 - 1, nanosec=2**32 - 1), Time(sec=-1), Time(sec=1, nanosec=10**9)]


def send_marker(rig: Rig, stamp: Time) -> None:
    marker = cube(A1, (9, 0, 0))
    marker.header.stamp = stamp
    rig.send(marker, stamped=False)


def with_stamp(method: str) -> Callable[[Rig, Time], None]:
    """Return what sends a pose of a/1 or points with a stamp of its own."""

    def send(rig: Rig, stamp: Time) -> None:
        header = rig.header

        def stamped(frame: str = FRAME) -> Header:
            made = header(frame)
            made.stamp = stamp
            return made

        rig.header = stamped  # type: ignore[method-assign]
        try:
            if method == "object_transform":
                rig.send_transform("a/1", pose(9.0))
            elif method == "object_states":
                rig.send_states(["a/1"], [pose(9.0)])
            elif method == "object_poses":
                rig.send_poses([1], [pose(9.0)])
            else:
                rig.send_points([[0.0, 0.0, 0.0]])
        finally:
            del rig.header

    return send


POSE_TOPICS = ("object_transform", "object_states", "object_poses", "points")
SENDERS = {"objects": send_marker} | {topic: with_stamp(topic) for topic in POSE_TOPICS}


@each("topic", SENDERS)
def test_stamps_that_no_clock_gives_are_refused_by_topic(rig: Rig, topic: str) -> None:
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)))
    assert rig.pairs() == {("a/1", "a/2")}
    for stamp in BAD:
        SENDERS[topic](rig, stamp)
        expected = {"bad stamp": BAD.index(stamp) + 1}
        rig.until(lambda e=expected: rig.refused(topic) == e, "refusal")  # type: ignore[misc]
    assert sync(rig) == {("a/1", "a/2")}
    assert rig.node.objects.table.doubtful[rig.node.objects.table.slots[A1]] == (topic != "points")
    assert rig.node.guard.total == 0


def test_by_topics_a_future_stamp_is_counted_and_never_published(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    rig.answer()
    ahead = stamp_to_ros(rig.now() + HOUR)
    message = states_to_ros(["a/2"], np.array([pose(0.5)]), rig.header())
    message.header.stamp = ahead
    rig.pubs["object_states"].publish(message)
    rig.until(lambda: rig.last["in_collision"].data, "used")
    status = rig.status("input object_states")
    assert status[f"doubtful: {AHEAD}"] == "1"
    objects = rig.status(": objects")
    assert objects["names doubtful stamp"] == "a/2"
    assert (objects["message"], objects["level"]) == ("1 with a doubtful stamp", "01")
    for topic in ("collisions",):
        stamp = stamp_from_ros(rig.next(topic).header.stamp)
        assert stamp <= rig.now() + SECOND // 2
    rig.send_transform("a/2", pose(3.0))
    assert rig.pairs() == set()


def test_by_topics_the_points_of_the_future_carry_their_time_of_receipt(rig: Rig) -> None:
    listening(rig, "points_inside")
    rig.send(cube(A1))
    rig.answer()
    SENDERS["points"](rig, stamp_to_ros(rig.now() + HOUR))
    message = rig.until(lambda: (m := rig.last.get("points_inside")) and m.width and m, "inside")
    assert stamp_from_ros(message.header.stamp) <= rig.now()
    assert dict(rig.monitor("points").doubted) == {AHEAD: 1}


def test_a_bad_stamp_of_a_new_object_leaves_it_unplaceable_and_counted(rig: Rig) -> None:
    send_marker(rig, Time(sec=-1))
    rig.until(lambda: rig.refused("objects") == {"bad stamp": 1}, "refusal")
    assert rig.node.objects.unplaceable == {A1: "bad stamp"}
