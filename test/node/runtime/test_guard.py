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

"""A failure inside the node never ends it, nor does a clock that jumps or rclpy without a part."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from each import each
from objects_rig import SECOND, START, ObjectsRig, UnforeseenError
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rig import A1, A2, NAMESPACE, Patch, Printed, Rig, cube, node_apart, pose, sync
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.objects.conditions import STALE
from obb_collision.node.runtime import inner
from obb_collision.node.runtime.clock import LARGEST_SLEW, NodeClock, boot_time
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard
from obb_collision.node.runtime.running import spin
from obb_collision.shapes import Box

BAD = ("bad", 1)


def test_an_item_that_fails_is_refused_alone(rig: Rig, monkeypatch: Patch) -> None:
    objects = rig.node.objects
    put = objects.shapes.put_primitives

    def fail(keys: Any, *more: Any) -> Any:
        if namespace_number(BAD[0]) in keys[0]:
            raise UnforeseenError("by the test")
        return put(keys, *more)

    monkeypatch.setattr(objects.shapes, "put_primitives", fail)
    rig.send(cube(A1), cube(BAD), cube(A2, (0.5, 0, 0)))
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.refused("objects") == {INTERNAL_ERROR: 1}
    assert "bad/1" in rig.node.guard.last
    assert BAD in objects.unplaceable


def test_an_output_that_fails_stops_no_other(rig: Rig, monkeypatch: Patch) -> None:
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)))
    rig.next("contacts")
    monkeypatch.setattr(rig.node.outputs, "_publish_cloud", Mock(side_effect=UnforeseenError))
    assert sync(rig) == {("a/1", "a/2")}
    assert rig.node.guard.counts["output contacts"] > 0
    assert rig.last["in_collision"].data


def test_services_and_timers_go_on(rig: Rig, monkeypatch: Patch) -> None:
    rig.send(cube(A1)).answer()
    with monkeypatch.context() as patch:
        patch.setattr(rig.node.objects, "clear", Mock(side_effect=UnforeseenError))
        response = rig.call(Trigger, "obb_collision/clear", Trigger.Request())
        assert not response.success
        assert INTERNAL_ERROR in response.message
    found = rig.status("internal errors")
    assert found["level"] == "02"
    assert found["service clear"] == "1"
    assert rig.call(Trigger, "obb_collision/clear", Trigger.Request()).success


def test_what_the_executor_raises_does_not_end_the_spinning_nor_leave_a_callback_waiting() -> None:
    caught, ticks = list[Exception](), list[int]()
    with node_apart("raises") as node:
        context, executor = node.context, SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        take_timer = executor._take_timer

        def fail_once(timer: Any) -> Any:
            if not caught:
                raise MemoryError
            return take_timer(timer)

        executor._take_timer = fail_once  # type: ignore[method-assign]

        def tick() -> None:
            ticks.append(1)
            if len(ticks) == 3:
                context.try_shutdown()
            raise UnforeseenError("by the test")

        def take(error: Exception) -> None:
            if not context.ok():
                raise error
            caught.append(error)

        node.create_timer(0.001, tick)  # all of a node's callbacks are in one group
        with suppress(ExternalShutdownException, UnforeseenError):
            spin(executor, take)
        kinds = [type(error) for error in caught]
        assert (kinds, len(ticks)) == ([MemoryError, UnforeseenError, UnforeseenError], 3)


def test_a_queue_that_cannot_be_read_hides_no_other(rig: Rig, monkeypatch: Patch) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
    subscribed = rig.node.subscribed
    drain, topic, before = subscribed._drain, "object_states", subscribed.open["object_states"]

    def fail_once(name: str, subscription: Any) -> None:
        if name == topic and subscription is before:
            raise MemoryError
        drain(name, subscription)

    monkeypatch.setattr(subscribed, "_drain", fail_once)

    def moved() -> bool:
        rig.send_states(["a/2"], [pose(0.5)])
        return rig.pose_of(A2)[0] == 0.5

    rig.until(lambda: subscribed.open.get(topic) not in (None, before), "a new subscription")
    rig.says(UNKNOWN, reasons="input_unreadable")
    rig.until(moved, "a state")
    rig.says(COLLIDING, reasons="")
    assert rig.node.guard.counts["inputs"] == 1
    rig.send_transform("a/1", pose(5.0))
    assert rig.pairs() == set()


def test_each_failure_is_logged_once_with_its_traceback_and_raised_without_a_context() -> None:
    lines: list[str] = []
    is_there = [True]
    guard = Guard(lines.append, lambda: is_there[0])
    for _ in range(3):
        with guard.catching("cycle", "a/1"):
            raise UnforeseenError("x" * 10_000)
    assert guard.counts == {"cycle": 3}
    assert len(lines) == 1
    assert "Traceback" in lines[0]
    assert "a/1" in lines[0]
    assert len(guard.last) < 1000
    with guard.catching("input objects"):
        raise UnforeseenError("x" * 10_000)
    assert len(lines) == 2
    is_there[0] = False
    with pytest.raises(UnforeseenError), guard.catching("cycle"):
        raise UnforeseenError
    assert guard.total == 3 + 1


def test_a_node_that_ends_leaves_no_service(rig: Rig) -> None:
    rig.node.destroy_node()
    own = f"{NAMESPACE}/obb_collision/"
    rclpys = f"{own}get_type_description"  # it stays as long as the object of the node does

    def left() -> set[str]:
        names = {name for name, _ in rig.client.get_service_names_and_types()}
        return {name for name in names if name.startswith(own)}

    rig.until(lambda: left() <= {rclpys}, "no service")
    assert not [*rig.node.services]


def test_a_node_works_where_rclpy_has_none_of_them(monkeypatch: Patch) -> None:
    monkeypatch.setattr(inner, "getattr", lambda _, name, default: default, raising=False)
    monkeypatch.setattr(inner, "_taking", lambda: None)
    with Rig() as rig:
        rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0)))
        assert rig.pairs() == {("a/1", "a/2")}
        assert all(result.successful for result in rig.set(padding=0.01))
        inner.release(rig.executor)
    assert not [*rig.node.services]


class Times:
    """A node's clock that a test sets."""

    def __init__(self, simulated: bool = False) -> None:
        self.time, self.steady, self.simulated = START, 0, simulated
        self.jumps: list[int] = []
        self.slow = 0
        self.clock = NodeClock(
            lambda: self.time,
            lambda: self.simulated,
            lambda shift, now: self.jumps.append(shift),
            self._steady,
        )

    def _steady(self) -> int:
        self.steady += self.slow
        return self.steady

    def step(self, moved: int, elapsed: int) -> list[int]:
        """Let time pass, and return the jumps that are found."""
        self.time, self.steady, self.jumps[:] = self.time + moved, self.steady + elapsed, []
        assert self.clock.now() == self.time
        return self.jumps


YEARS = 56 * 365 * 86400
BACK, FURTHER = START // SECOND, 7
"""Seconds that the time falls back without a message of /clock, and of the first one."""


@each(
    "steps",
    [
        # of each step: whether the time is simulated, how far it moves, how long it takes, the jump
        *([(0, 1, 1, 0), (0, n + 1, 1, n), (0, 1, 1, 0)] for n in (-3600, -1, 1, YEARS)),
        [(0, 1.0005, 1, 0)] * 1000,  # slewed
        [(1, 50, 1, 0), (1, 0, 9, 0), (1, -20, 1, -20)],  # as fast as it likes, paused, and back
        [(1, -BACK, 1, -BACK - 1), (1, 0, 1, 0), (1, FURTHER, 1, FURTHER), (0, 2, 1, 1)],
    ],
)
def test_jumps_are_steps_of_the_clock_and_of_simulations_that_go_back(steps: list[Any]) -> None:
    times = Times(simulated=len(steps) == 3 and steps[0][0] == 1)
    for simulated, moved, elapsed, jump in steps:
        times.simulated = bool(simulated)
        found = times.step(int(moved * SECOND), elapsed * SECOND)
        assert found == [jump * SECOND] * (jump != 0)


def test_a_look_that_is_held_up_decides_nothing() -> None:
    times = Times()
    times.slow = LARGEST_SLEW
    assert times.step(SECOND, 2 * SECOND) == []
    times.slow = 0
    steady = times.steady
    times.time = START + steady
    assert times.step(0, 0) == []


def test_the_steady_clock_does_not_go_back() -> None:
    first = boot_time()
    assert boot_time() >= first > 0
    assert first >= time.monotonic_ns() - SECOND, "the time asleep counts"


@each("shift", [-500 * SECOND, 500 * SECOND])
def test_what_is_left_of_lifetimes_and_ages_stays(shift: int) -> None:
    rig = ObjectsRig(A1, object_timeout=3.0)
    slot = rig.objects.shapes.put(A2, Box([1.0, 1.0, 1.0]), expiry=rig.now + 2 * SECOND)
    rig.slots = np.append(rig.slots, slot)
    rig.objects.shapes.refuse(("b", 1), "bad scale", shape=True, expiry=rig.now + 2 * SECOND)
    rig.send(rig.now)
    rig.cycle()
    rig.now += shift
    rig.objects.clock_jumped(shift)
    rig.now += SECOND
    rig.cycle()
    assert set(rig.objects.table.slots) == {A1, A2}
    assert not rig.objects.table.has(STALE).any()
    assert not rig.objects.table.doubtful.any()
    assert len(rig.objects.unplaceable) == 1
    rig.now += SECOND + 1
    rig.cycle()
    assert set(rig.objects.table.slots) == {A1}
    assert rig.objects.unplaceable == {}
    rig.now += SECOND
    rig.cycle()
    assert rig.objects.table.has(STALE, rig.slots[0])


SEVEN = stamp_to_ros(7 * SECOND)


def set_clock(rig: Rig, at: Time) -> None:
    clock = rig.client.create_publisher(Clock, "/clock", QoSProfile(depth=10))
    rig.until(lambda: clock.get_subscription_count() > 0, "match")
    clock.publish(Clock(clock=at))


def test_by_topics_the_time_may_change_to_a_simulations_and_back(rig: Rig, capfd: Printed) -> None:
    rig.send(cube(A1), cube(A2, (0.5, 0, 0), lifetime=Duration(sec=3600)))
    assert rig.pairs() == {("a/1", "a/2")}
    rig.set(use_sim_time=True)
    assert rig.now() == 0, "no message of /clock so far"
    assert "the clock jumped by -" in capfd.readouterr().err
    rig.cycles(2)
    set_clock(rig, SEVEN)
    rig.until(lambda: rig.now() == 7 * SECOND, "time")
    rig.cycles(2)
    assert "the clock jumped by +7.000 s" in capfd.readouterr().err
    rig.set(use_sim_time=False)
    rig.cycles(2)
    assert "the clock jumped by +" in capfd.readouterr().err
    assert set(rig.node.objects.table.slots) == {A1, A2}
    assert not rig.node.objects.table.doubtful.any()
    rig.send(cube(A2, (3, 0, 0)))
    assert rig.pairs() == set()


@each("from_start", [True, False])
@each("at", [Time(sec=-5), Time(sec=-(2**31), nanosec=2**32 - 1), Time(sec=3, nanosec=10**9)])
def test_times_that_no_clock_gives_are_refused(capfd: Printed, from_start: bool, at: Time) -> None:
    with Rig(use_sim_time=from_start) as rig:
        if not from_start:
            rig.set(use_sim_time=True)
        set_clock(rig, at)
        warning = f"/clock: refused bad stamp: sec {at.sec}"
        rig.until(lambda: rig.node.guard.total or warning in capfd.readouterr().err, "warning")
        assert rig.node.guard.total == 0
        assert rig.now() == 0
        set_clock(rig, SEVEN)
        rig.until(lambda: rig.now() == 7 * SECOND, "time")
