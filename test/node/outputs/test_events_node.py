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

"""The topic ``events``: begin and end of collisions as a subscriber gets them."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy")
from rclpy.qos import QoSProfile
from rig import Rig, cube
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

from obb_collision.node import events_from_ros, named_events
from obb_collision.node.messages.conversions import namespace_table, stamp_from_ros
from obb_collision.node.outputs import events as outputs_events

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
BEGIN, APART = ("begin", "a/1", "a/2"), ("end: apart", "a/1", "a/2")


class Listener:
    """Another subscriber of ``events``, with all that came."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.messages: list[PointCloud2] = []
        self.names: dict[int, str] = {}
        take = self.messages.append
        self.end = rig.client.create_subscription(PointCloud2, "events", take, QoSProfile(depth=50))
        rig.until(lambda: self.messages, "what lasts")

    def rows(self) -> list[Any]:
        """Return all named rows but those that last."""
        self.names |= namespace_table(self.rig.last["namespaces"])
        found = [row for m in self.messages for row in named_events(m, self.names)]
        return [row for row in found if row.event != "lasting"]

    def changes(self) -> list[tuple[str, str, str]]:
        """Return all events as (event, a, b), with the reason of an end."""
        return [
            (row.event + (row.reason and f": {row.reason}"), row.a, row.b) for row in self.rows()
        ]

    def lasting(self) -> set[tuple[str, str]]:
        """Return the pairs that last by the newest message."""
        rows = named_events(self.messages[-1], self.names or self.rig.last["namespaces"])
        return {(row.a, row.b) for row in rows if row.event == "lasting"}

    def until(self, changes: list[tuple[str, str, str]]) -> None:
        """Wait for changes: exactly these, in this order."""
        self.rig.until(lambda: len(self.changes()) >= len(changes), f"{changes}")
        assert self.changes() == changes

    def close(self) -> None:
        self.rig.client.destroy_subscription(self.end)


@pytest.fixture
def events(rig: Rig) -> Listener:
    """Return a listener to a node in which two cubes collide, their begin said already."""
    made = Listener(rig)
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)))
    made.until([BEGIN])
    return made


def test_each_pair_begins_and_ends_once(rig: Rig) -> None:
    events = Listener(rig)
    rig.send(cube(A1), cube(A2, (0.75, 0, 0)), cube(B1, (5, 0, 0)))
    rig.answer()
    rig.send(cube(A2, (0.5, 0, 0)))
    deepest = rig.answer()
    rig.send(cube(A2, (0.875, 0, 0)))
    rig.answer()
    rig.send(cube(A2, (5.5, 0, 0)))
    last = rig.answer()
    events.until([BEGIN, APART, ("begin", "a/2", "b/1")])
    begin, end, other = events.rows()
    assert (begin.depth, end.depth, other.depth) == (0.25, 0.5, 0.5)
    assert (begin.duration, other.duration) == (0.0, 0.0)
    assert end.duration > 0.0
    ends = [m for m in events.messages if (events_from_ros(m)["event"] == 0).any()]
    assert [stamp_from_ros(m.header.stamp) for m in ends] == [stamp_from_ros(last.header.stamp)]
    assert stamp_from_ros(deepest.header.stamp) < stamp_from_ros(last.header.stamp)


def test_a_late_subscriber_gets_what_lasts_and_others_no_event_twice(
    rig: Rig, events: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outputs_events, "PERIOD", 1e6)
    late = Listener(rig)
    assert late.lasting() == {("a/1", "a/2")}
    assert late.changes() == []
    rig.send(Marker(ns="a", id=2, action=Marker.DELETE))
    late.until([("end: removed", "a/1", "a/2")])
    events.until([BEGIN, ("end: removed", "a/1", "a/2")])


def test_what_lasts_comes_again_and_again(
    rig: Rig, events: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outputs_events, "PERIOD", 0.05)
    for _ in range(3):
        events.messages.clear()
        rig.until(lambda: events.messages, "another message")
        assert events.lasting() == {("a/1", "a/2")}


def test_without_a_subscriber_nothing_is_counted(rig: Rig, events: Listener) -> None:
    events.close()
    rig.until(lambda: rig.publisher("events").get_subscription_count() == 0, "nobody")
    rig.cycles(2)
    assert len(rig.node.outputs.events.pairs.lasting(0)) == 0
    again = Listener(rig)
    assert again.lasting() == {("a/1", "a/2")}
    assert again.changes() == []


def test_an_end_says_why(rig: Rig) -> None:
    events = Listener(rig)
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)), cube(B1, (0.25, 0, 0)))
    pairs = [("a/1", "a/2"), ("a/1", "b/1"), ("a/2", "b/1")]
    expected = [("begin", *pair) for pair in pairs]
    events.until(expected)
    rig.set(allowed_within=["a"])
    expected.append(("end: not checked", "a/1", "a/2"))
    events.until(expected)
    rig.call(Trigger, f"{rig.node.get_fully_qualified_name()}/clear", Trigger.Request())
    expected += [("end: removed", *pair) for pair in pairs[1:]]
    events.until(expected)


def test_an_object_that_is_replaced_at_once_ends_nothing(rig: Rig, events: Listener) -> None:
    rig.send(Marker(ns="a", id=2, action=Marker.DELETE), cube(A2, (0.75, 0, 0)))
    rig.answer()
    rig.send(cube(A2, (5.0, 0, 0)))
    events.until([BEGIN, APART])


def test_a_pause_of_the_checks_begins_and_ends_nothing(rig: Rig, events: Listener) -> None:
    name = f"{rig.node.get_fully_qualified_name()}/enable"
    rig.call(SetBool, name, SetBool.Request(data=False))
    rig.send(cube(A2, (5.0, 0, 0)))
    rig.cycles(3)
    assert len(events.changes()) == 1
    rig.call(SetBool, name, SetBool.Request(data=True))
    events.until([BEGIN, APART])


def test_distances_keep_a_pair_at_the_border_from_chattering(rig: Rig) -> None:
    rig.set(
        **{"effects.events_begin_distance": 0.0625, "effects.events_clear_distance": 0.0625},
    )
    events = Listener(rig)
    rig.send(cube(A1), cube(A2, (5.0, 0, 0)))
    rig.answer()
    raw = []
    # by x: how deep (positive) or far apart (negative) the two cubes of 1 m are
    for depth in (0.03125, -0.03125, 0.125, -0.03125, 0.03125, -0.0625, 0.03125, -0.125, 0.03125):
        rig.send(cube(A2, (1.0 - depth, 0, 0)))
        raw.append(len(rig.pairs()))
    assert raw == [1, 0, 1, 0, 1, 0, 1, 0, 1], "collisions are certified as ever"
    events.until([BEGIN, APART])
    assert events.rows()[0].depth == 0.125
    rig.set(**{"effects.events_begin_distance": 0.0})
    events.until([BEGIN, APART, BEGIN])


def test_a_pair_that_another_region_answers_for_is_not_said_to_be_apart() -> None:
    with Rig(region=["x: -inf to 5.0"]) as rig:
        events = Listener(rig)
        rig.send(cube(A1, (4.0, 0, 0)), cube(A2, (4.5, 0, 0)))
        events.until([BEGIN])
        rig.send(cube(A1, (5.75, 0, 0)), cube(A2, (6.0, 0, 0)))  # they begin at 5.25 and 5.5
        rig.answer()
        events.until([BEGIN, ("end: not checked", "a/1", "a/2")])
