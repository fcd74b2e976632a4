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

"""Messages of ``objects`` that wait: what they come to, in what order, and within which bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Duration
from each import each
from rclpy.serialization import serialize_message
from rig import Rig, cube, pose, sync
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node import collisions_from_ros
from obb_collision.node.inputs import markers as marker_input
from obb_collision.node.messages.conversions import Key, stamp_to_ros

SECOND = 1_000_000_000
A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
CLEAR = Marker(action=Marker.DELETEALL)


def serialized(*markers: Marker) -> bytes:
    data: bytes = serialize_message(MarkerArray(markers=list(markers)))
    return data


def keys(rig: Rig) -> set[Key]:
    return set(rig.node.objects.table.slots)


def wait(rig: Rig, *messages: bytes) -> None:
    """Let messages wait as if they had just come, without a cycle in between."""
    for message in messages:
        rig.node.inputs.markers.take(message)


def test_of_a_backlog_only_the_last_state_of_each_object_is_looked_at(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    shapes, put = rig.node.objects.shapes, list[int]()
    given = shapes.put_primitives

    def count(keys: Any, *more: Any) -> Any:
        put.append(len(keys[0]))
        return given(keys, *more)

    monkeypatch.setattr(shapes, "put_primitives", count)
    wait(rig, *(serialized(cube(A1, (x, 0, 0)), cube(A2, (x + 0.5, 0, 0))) for x in range(50)))
    assert sync(rig) == {("a/1", "a/2")}
    assert sum(put) == 3, "two of the backlog and one of sync"
    assert rig.pose_of(A1)[0] == 49.0
    wait(rig, *(serialized(cube(A1, (x, 0, 0))) for x in range(50)))
    sync(rig)
    assert sum(put) == 3, "an unchanged shape is a pose update"


def test_no_add_and_no_delete_of_a_backlog_is_lost(rig: Rig) -> None:
    wait(
        rig,
        serialized(cube(A1), cube(A2), cube(B1)),
        serialized(Marker(ns="a", id=1, action=Marker.DELETE)),
        serialized(cube(("c", 1))),
        serialized(Marker(ns="b", action=Marker.DELETEALL), cube(("b", 2))),
        serialized(cube(A1, (9, 0, 0)), Marker(ns="c", id=1, action=Marker.DELETE)),
    )
    sync(rig)
    assert keys(rig) == {A1, A2, ("b", 2), ("sync", 0)}


def test_deleteall_drops_what_waits(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    messages: list[int] = []
    given: Any = marker_input
    gather = given.gather

    def count(parts: Any, *more: Any) -> Any:
        messages.append(len(parts))
        return gather(parts, *more)

    monkeypatch.setattr(marker_input, "gather", count)
    for n in range(20):
        wait(rig, serialized(CLEAR, *(cube(("c", 10 * n + k)) for k in range(9))))
    rig.until(lambda: len(keys(rig)) == 9, "the last frame")
    assert messages == [1]
    assert keys(rig) == {("c", 190 + k) for k in range(9)}


def test_what_waits_is_bounded(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(marker_input, "MAX_WAITING_BYTES", 100_000)
    markers, peak = rig.node.inputs.markers, 0
    triangles = cube(("t", 1), type=Marker.TRIANGLE_LIST)
    for number in range(300):
        message = serialized(
            triangles,
            *(cube(("c", k), (number, 3 * k, 0)) for k in range(20)),
            Marker(ns="d", id=number, action=Marker.DELETE),
        )
        markers.take(message)
        peak = max(peak, markers.size)
        assert markers.size <= 100_000 + 3 * len(message)
    assert peak > 50_000
    sync(rig)
    assert {key for key in keys(rig) if key[0] == "c"} == {("c", k) for k in range(20)}
    assert {rig.pose_of(("c", k))[0] for k in range(20)} == {299.0}
    assert rig.refused("objects").keys() == {"no points"}


def test_many_new_objects_without_end_are_refused_within_bounds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(marker_input, "MAX_WAITING_BYTES", 100_000)
    with Rig(max_objects=100) as rig:
        for number in range(100):
            wait(rig, serialized(*(cube(("c", 50 * number + k)) for k in range(50))))
            assert rig.node.inputs.markers.size <= 150_000
        rig.until(lambda: rig.refused("objects"), "refusals")
        rig.cycles(2)
        assert rig.refused("objects") == {"too many objects": 4900}
        assert len(keys(rig)) == 100


def test_a_message_that_is_cut_short_is_refused_whole_and_the_next_one_used(rig: Rig) -> None:
    message = serialized(cube(A1), cube(A2))
    wait(rig, message[:-20])
    rig.until(lambda: rig.refused("objects"), "refusal")
    assert rig.refused("objects") == {"malformed message": 1}
    assert keys(rig) == set()
    wait(rig, message)
    rig.until(lambda: keys(rig) == {A1, A2}, "the next one")


def test_where_the_last_state_cannot_be_built_the_one_before_counts(rig: Rig) -> None:
    broken = cube(A1, (5, 0, 0), type=Marker.TRIANGLE_LIST)
    wait(rig, serialized(cube(A1)), serialized(broken))
    assert sync(rig) == set()
    slot = rig.node.objects.table.slots[A1]
    assert rig.node.objects.table.doubtful[slot]
    assert rig.pose_of(A1)[0] == 0.0
    assert rig.refused("objects") == {"no points": 1}


def test_other_topics_come_after_the_markers_before_them(rig: Rig) -> None:
    wait(rig, serialized(cube(A1), cube(A2, (3, 0, 0))))
    rig.send_transform("a/2", pose(0.5))
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.refused("object_transform") == {}


def test_an_object_whose_lifetime_is_over_before_a_cycle_is_seen_once() -> None:
    with Rig(rate=1.0) as rig:
        brief = Duration(nanosec=1_000_000)
        rig.send(cube(A1, lifetime=brief), cube(A2, lifetime=brief))
        assert rig.pairs() == {("a/1", "a/2")}
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 0, "expiry")
        assert keys(rig) == set()


def test_of_frames_that_ended_while_they_waited_only_the_last_is_seen(rig: Rig) -> None:
    markers, clock = rig.node.inputs.markers, [rig.now() - 10 * SECOND]
    markers._clock = lambda: clock[0]
    for number in range(5):
        clock[0] += SECOND
        life = Duration(nanosec=100_000_000)
        wait(rig, serialized(*(cube(("c", 10 * number + k), lifetime=life) for k in range(3))))
        wait(rig, serialized(cube(("other", number), lifetime=life if number < 3 else Duration())))
    clock[0] += 5 * SECOND
    markers.apply()
    assert keys(rig) == {("c", 40), ("c", 41), ("c", 42), ("other", 3), ("other", 4)}


def test_what_is_deleted_and_comes_again_is_a_new_object(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (5, 0, 0)))
    rig.answer()
    objects, stamp = rig.node.objects, rig.stamp
    slot, born = objects.table.slots[A1], objects.scene.objects.store.born.copy()
    rig.stamp -= 900_000_000
    rig.send(CLEAR, cube(A1, (1, 0, 0)))
    assert rig.pairs() == set()
    assert keys(rig) == {A1}
    assert objects.table.slots[A1] == slot
    assert objects.scene.objects.store.born[slot] > born[slot]
    assert rig.refused("objects") == {}, "its stamps begin anew"
    assert rig.stamp < stamp


@each("seconds", [0, 7])
def test_overload_is_said_with_the_age_of_the_newest_state(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, seconds: int
) -> None:
    rig.listen("/diagnostics")
    subscribed = rig.subscribed
    taken = subscribed.take_wait
    monkeypatch.setattr(subscribed, "take_wait", lambda: (wait := taken()) and wait + seconds)
    stamp = stamp_to_ros(rig.now() - 3 * SECOND)

    def said() -> bool:
        marker = cube(A1)
        marker.header.stamp = stamp
        rig.send(marker, stamped=False)
        status = rig.status(": cycle")
        key = "age of the newest state evaluated (s)"
        if key not in status or ("overload" in status["message"]) != bool(seconds):
            return False
        assert float(status["longest delay (s)"]) >= seconds
        assert float(status[key]) >= 3.0, "by its stamp"
        return status["level"] == "01" if seconds else True

    rig.until(said, "a report on this state")


def test_no_message_has_no_delay(rig: Rig) -> None:
    rig.send(cube(A1))
    rig.answer()
    rig.cycles(1)
    assert rig.subscribed.take_wait() == 0.0
    rig.listen("/diagnostics")
    rig.next("/diagnostics")
    assert "longest delay (s)" not in rig.status(": cycle")


def test_all_that_waits_is_taken_before_one_cycle() -> None:
    with Rig() as rig:
        rig.set(rate=0.1)  # no cycle for 10 s
        for x in range(30):
            rig.send(cube(A1, (x, 0, 0)))
            rig.send_transform("a/1", pose(x + 0.5))
        sent = rig.stamp
        total = rig.node.cycle.monitor.total
        rig.until(lambda: rig.monitor("objects").messages > 0, "the first message")
        rig.node.collect()
        assert rig.monitor("objects").messages == 30
        assert rig.monitor("object_transform").messages == 30
        assert rig.node.cycle.monitor.total == total
        table = rig.node.objects.table
        assert table.stamp[table.slots[A1]] == sent


def test_states_with_stamps_of_their_own_are_stored_together(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored: list[int] = []
    objects = rig.node.objects
    given = objects.states.store

    def store(slots: Any, *more: Any) -> Any:
        stored.append(len(slots))
        return given(slots, *more)

    monkeypatch.setattr(objects.states, "store", store)
    markers = [cube(("c", number), (3.0 * number, 0, 0)) for number in range(50)]
    for number, marker in enumerate(markers):
        marker.header.stamp = stamp_to_ros(SECOND + number)
        marker.type = (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER)[number % 3]
    wait(rig, serialized(*markers))
    rig.until(lambda: len(keys(rig)) == 50, "objects")
    assert stored == [50]
    table = objects.table
    slots = [table.slots["c", number] for number in range(50)]
    assert (table.stamp[slots] == SECOND + np.arange(50)).all()
    assert objects.table.signature(("c", 1)) == (Marker.SPHERE, 1.0, 1.0, 1.0)
