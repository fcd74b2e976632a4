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

"""Begin and end of collisions: by the whole history of pairs, and as subscribers get them."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from objects_rig import SECOND
from rclpy.qos import QoSProfile
from rig import A1, A2, B1, Patch, Rig, cube
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

from obb_collision.node import events_from_ros, named_events
from obb_collision.node.messages.conversions import namespace_table, stamp_from_ros
from obb_collision.node.outputs import EventLimits, PairEvents, Parted
from obb_collision.node.outputs import events as outputs_events
from obb_collision.node.topics.rows import BEGIN, END, LASTING, NOT_CHECKED, REMOVED
from obb_collision.node.topics.topics import COLLISIONS, EVENTS

# numbers of namespaces are any int32, and zeros at the end of a key must count
OBJECTS = [(-(2**31), 0), (-1, -1), (0, 0), (0, 256), (2**31 - 1, 2**31 - 1)]
KEY = ["ns_a", "id_a", "ns_b", "id_b"]
PAIRS: list[Any] = [(*a, *b) for a, b in combinations(OBJECTS, 2)][:6]
DEEP, SHALLOW, NEAR, APART, GONE, UNCHECKED = range(6)


class Step(NamedTuple):
    """One check: the time since the one before, the state of each pair, and what else happens."""

    elapsed: int
    states: dict[int, int]
    whole: bool
    interrupted: bool
    shift: int


second = st.integers(0, 4)
steps = st.lists(
    st.builds(
        Step,
        st.integers(0, 3),
        st.fixed_dictionaries({n: st.integers(DEEP, UNCHECKED) for n in range(len(PAIRS))}),
        st.sampled_from([True, True, True, False]),
        st.sampled_from([False, False, False, True]),
        st.sampled_from([0, 0, 0, -7, 100]),
    ),
    min_size=1,
    max_size=25,
)


class Oracle:
    """What each pair should do, from all that was seen of it since its last event."""

    def __init__(self, limits: EventLimits) -> None:
        self.limits = limits
        self.seen: dict[int, list[tuple[int, str]]] = {n: [] for n in range(len(PAIRS))}
        self.start: dict[int, int] = {}

    def jump(self, shift: int) -> None:
        for n, history in self.seen.items():
            self.seen[n] = [(time + shift, what) for time, what in history]
        self.start = {n: time + shift for n, time in self.start.items()}

    def interrupt(self) -> None:
        for n in self.start:
            self.seen[n].append((0, "unknown"))

    def look(self, now: int, n: int, state: int, whole: bool, first: bool) -> Any:
        """Return (event, reason, duration) or None."""
        history = self.seen[n]
        lasts = n in self.start
        left_out = state > SHALLOW and not whole
        word = "deep" if state == DEEP else "apart" if state == APART else "other"
        history.append((now, "unknown" if left_out else word))
        if lasts and state in (GONE, UNCHECKED):
            return self.end(now, n, REMOVED if state == GONE else NOT_CHECKED)
        if lasts:
            since = self.since(history, "apart", ())
            if since is not None and now - since >= self.limits.clear_time:
                return self.end(now, n, 0)
            return None
        since = self.since(history, "deep", ("unknown",))
        long_enough = since is not None and now - since >= self.limits.begin_time
        if state == DEEP and (first or long_enough):
            self.start[n], self.seen[n] = now, []
            return None if first else (BEGIN, 0, 0)
        return None

    @staticmethod
    def since(history: list[tuple[int, str]], wanted: str, passed: tuple[str, ...]) -> int | None:
        """Return the first time of the run of a state that the history ends with."""
        found = None
        for time, what in reversed(history):
            if what == wanted:
                found = time
            elif what not in passed:
                break
        return found

    def end(self, now: int, n: int, reason: int) -> Any:
        duration = now - self.start.pop(n)
        self.seen[n] = []
        return END, reason, duration


def rows_of(states: dict[int, int]) -> Any:
    """Return the rows of ``collisions`` of the pairs that collide."""
    found = [n for n, state in states.items() if state <= SHALLOW]
    rows = np.zeros(len(found), COLLISIONS.dtype)
    rows[KEY] = np.array([PAIRS[n] for n in found], rows[KEY].dtype)
    rows["depth"] = [0.5 if states[n] == DEEP else 0.05 for n in found]
    return np.sort(rows, order=KEY)


def number(row: Any) -> int:
    return PAIRS.index(row[KEY].tolist())


@given(steps, st.builds(EventLimits, st.just(0.1), st.just(0.1), second, second))
def test_events_are_those_of_all_history(given_steps: list[Step], limits: EventLimits) -> None:
    pairs, oracle = PairEvents(EVENTS.dtype), Oracle(limits)
    now = 1000
    for count, step in enumerate(given_steps):
        now += step.elapsed + step.shift
        if step.shift:
            oracle.jump(step.shift)
            pairs.clock_jumped(step.shift * SECOND)
        if step.interrupted:
            oracle.interrupt()
            pairs.interrupt()

        def part(rows: Any, states: dict[int, int] = step.states) -> Parted:
            found = [states[number(row)] for row in rows]
            reasons = [{GONE: REMOVED, UNCHECKED: NOT_CHECKED}.get(state, 0) for state in found]
            return Parted(np.array(reasons), np.array([state == APART for state in found]))

        events = pairs.update(now * SECOND, rows_of(step.states), limits, part, step.whole)
        expected = {
            n: found
            for n, state in step.states.items()
            if (found := oracle.look(now, n, state, step.whole, first=count == 0))
        }
        told = events[["event", "reason", "duration"]].tolist()
        assert dict(zip(map(number, events), told, strict=True)) == expected
        assert events[KEY].tolist() == sorted(events[KEY].tolist())
        lasting = pairs.lasting(now * SECOND)
        since = {number(row): now - row["duration"] for row in lasting}
        assert since == oracle.start
        assert (lasting["event"] == LASTING).all()


def nothing_parts(rows: Any) -> Parted:
    return Parted(np.zeros(len(rows), np.int64), np.ones(len(rows), np.bool_))


def test_the_greatest_depth_and_the_last_place_are_told() -> None:
    pairs = PairEvents(EVENTS.dtype)
    pairs.update(0, rows_of({}), EventLimits(), nothing_parts)
    for second, (depth, x) in enumerate([(0.25, 1.0), (0.75, 2.0), (np.nan, np.nan), (0.5, 3.0)]):
        rows = rows_of({0: DEEP})
        rows["depth"], rows["x"] = depth, x
        events = pairs.update(second * SECOND, rows, EventLimits(), nothing_parts)
        assert len(events) == (second == 0)
    (event,) = pairs.update(4 * SECOND, rows_of({}), EventLimits(), nothing_parts)
    assert (event["event"], event["depth"], event["x"], event["duration"]) == (END, 0.75, 3.0, 4.0)
    assert len(pairs.lasting(5 * SECOND)) == 0


def test_an_unknown_depth_counts_as_deep_and_no_begin_is_lost_where_parting_fails() -> None:
    pairs, limits = PairEvents(EVENTS.dtype), EventLimits(begin_distance=0.5)
    pairs.update(0, rows_of({}), limits, nothing_parts)
    rows = rows_of({0: SHALLOW, 1: SHALLOW})
    rows["depth"][0] = np.nan
    events = pairs.update(SECOND, rows, limits, nothing_parts)
    assert [number(row) for row in events] == [number(rows[0])] == [0]
    with pytest.raises(RuntimeError):
        pairs.update(2 * SECOND, rows_of({1: DEEP}), limits, Mock(side_effect=RuntimeError))
    events = pairs.update(3 * SECOND, rows_of({1: DEEP}), limits, nothing_parts)
    assert {number(row): row["event"] for row in events} == {0: END, 1: BEGIN}


BEGUN, PARTED = ("begin", "a/1", "a/2"), ("end: apart", "a/1", "a/2")


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
        return [(r.event + (r.reason and f": {r.reason}"), r.a, r.b) for r in self.rows()]

    def lasting(self) -> set[tuple[str, str]]:
        rows = named_events(self.messages[-1], self.names or self.rig.last["namespaces"])
        return {(row.a, row.b) for row in rows if row.event == "lasting"}

    def until(self, changes: list[tuple[str, str, str]]) -> None:
        """Wait for changes: exactly these, in this order."""
        self.rig.until(lambda: len(self.changes()) >= len(changes), f"{changes}")
        assert self.changes() == changes


@pytest.fixture
def events(rig: Rig) -> Listener:
    """Return a listener to a node in which two cubes collide, their begin said already."""
    made = Listener(rig)
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)))
    made.until([BEGUN])
    return made


def test_each_pair_begins_and_ends_once(rig: Rig) -> None:
    events = Listener(rig)
    rig.send(cube(A1), cube(A2, (0.75, 0, 0)), cube(B1, (5, 0, 0))).answer()
    rig.send(cube(A2, (0.5, 0, 0)))
    deepest = rig.answer()
    rig.send(cube(A2, (0.875, 0, 0))).answer()
    rig.send(cube(A2, (5.5, 0, 0)))
    last = rig.answer()
    events.until([BEGUN, PARTED, ("begin", "a/2", "b/1")])
    begin, end, other = events.rows()
    assert (begin.depth, end.depth, other.depth) == (0.25, 0.5, 0.5)
    assert (begin.duration, other.duration) == (0.0, 0.0)
    assert end.duration > 0.0
    ends = [m for m in events.messages if (events_from_ros(m)["event"] == 0).any()]
    assert [stamp_from_ros(m.header.stamp) for m in ends] == [stamp_from_ros(last.header.stamp)]
    assert stamp_from_ros(deepest.header.stamp) < stamp_from_ros(last.header.stamp)


def test_who_comes_late_gets_what_lasts(rig: Rig, events: Listener, monkeypatch: Patch) -> None:
    monkeypatch.setattr(outputs_events, "PERIOD", 1e6)
    late = Listener(rig)
    assert late.lasting() == {("a/1", "a/2")}
    assert late.changes() == []
    rig.send(Marker(ns="a", id=2, action=Marker.DELETE))
    late.until([("end: removed", "a/1", "a/2")])
    events.until([BEGUN, ("end: removed", "a/1", "a/2")])


def test_what_lasts_comes_again_and_again(rig: Rig, events: Listener, monkeypatch: Patch) -> None:
    monkeypatch.setattr(outputs_events, "PERIOD", 0.05)
    for _ in range(3):
        events.messages.clear()
        rig.until(lambda: events.messages, "another message")
        assert events.lasting() == {("a/1", "a/2")}


def test_without_a_subscriber_nothing_is_counted(rig: Rig, events: Listener) -> None:
    rig.client.destroy_subscription(events.end)
    publisher = rig.node.outputs.publishers["events"]
    rig.until(lambda: publisher.get_subscription_count() == 0, "nobody")
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


def test_no_replacement_and_no_pause_of_checks_ends_anything(rig: Rig, events: Listener) -> None:
    rig.send(Marker(ns="a", id=2, action=Marker.DELETE), cube(A2, (0.75, 0, 0))).answer()
    name = f"{rig.node.get_fully_qualified_name()}/enable"
    rig.call(SetBool, name, SetBool.Request(data=False))
    rig.send(cube(A2, (5.0, 0, 0)))
    rig.cycles(3)
    assert len(events.changes()) == 1
    rig.call(SetBool, name, SetBool.Request(data=True))
    events.until([BEGUN, PARTED])


def test_distances_keep_a_pair_at_the_border_from_chattering(rig: Rig) -> None:
    rig.set(**{"effects.events_begin_distance": 0.0625, "effects.events_clear_distance": 0.0625})
    events = Listener(rig)
    rig.send(cube(A1), cube(A2, (5.0, 0, 0))).answer()
    raw = []
    # by x: how deep (positive) or far apart (negative) the two cubes of 1 m are
    for depth in (0.03125, -0.03125, 0.125, -0.03125, 0.03125, -0.0625, 0.03125, -0.125, 0.03125):
        rig.send(cube(A2, (1.0 - depth, 0, 0)))
        raw.append(len(rig.pairs()))
    assert raw == [1, 0, 1, 0, 1, 0, 1, 0, 1], "collisions are certified as ever"
    events.until([BEGUN, PARTED])
    assert events.rows()[0].depth == 0.125
    rig.set(**{"effects.events_begin_distance": 0.0})
    events.until([BEGUN, PARTED, BEGUN])


def test_a_pair_that_another_region_answers_for_is_not_said_to_be_apart() -> None:
    with Rig(region=["x: -inf to 5.0"]) as rig:
        events = Listener(rig)
        rig.send(cube(A1, (4.0, 0, 0)), cube(A2, (4.5, 0, 0)))
        events.until([BEGUN])
        rig.send(cube(A1, (5.75, 0, 0)), cube(A2, (6.0, 0, 0)))  # they begin at 5.25 and 5.5
        rig.answer()
        events.until([BEGUN, ("end: not checked", "a/1", "a/2")])
