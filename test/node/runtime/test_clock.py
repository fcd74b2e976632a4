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

"""Jumps of the node's clock: ages and lifetimes go on from the new time, and it is said."""

from __future__ import annotations

import time

import numpy as np
import pytest
from each import each

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Duration, Time
from objects_rig import SECOND, START, ObjectsRig
from rclpy.qos import QoSProfile
from rig import Rig, cube
from rosgraph_msgs.msg import Clock

from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.objects.conditions import STALE
from obb_collision.node.runtime.clock import LARGEST_SLEW, NodeClock, boot_time
from obb_collision.shapes import Box

A1, A2 = ("a", 1), ("a", 2)


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
def test_jumps_are_steps_of_the_systems_clock_and_of_a_simulation_those_back(
    steps: list[tuple[int, float, int, int]],
) -> None:
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


def test_by_topics_the_time_may_change_to_a_simulations_and_back(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with Rig() as rig:
        rig.send(cube(A1), cube(A2, (0.5, 0, 0), lifetime=Duration(sec=3600)))
        assert rig.pairs() == {("a/1", "a/2")}
        rig.set(use_sim_time=True)
        assert rig.now() == 0, "no message of /clock so far"
        assert "the clock jumped by -" in capfd.readouterr().err
        rig.cycles(2)
        clock = rig.client.create_publisher(Clock, "/clock", QoSProfile(depth=10))
        rig.until(lambda: clock.get_subscription_count() > 0, "match")
        clock.publish(Clock(clock=stamp_to_ros(7 * SECOND)))
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


@each("sec, nanosec", [(-5, 0), (-(2**31), 2**32 - 1), (3, 10**9)])
@each("from_start", [False, True])
def test_times_that_no_clock_gives_are_refused(
    capfd: pytest.CaptureFixture[str], from_start: bool, sec: int, nanosec: int
) -> None:
    with Rig(use_sim_time=from_start) as rig:
        if not from_start:
            rig.set(use_sim_time=True)
        clock = rig.client.create_publisher(Clock, "/clock", QoSProfile(depth=10))
        rig.until(lambda: clock.get_subscription_count() > 0, "match")
        clock.publish(Clock(clock=Time(sec=sec, nanosec=nanosec)))
        warning = f"/clock: refused bad stamp: sec {sec}"
        rig.until(lambda: rig.node.guard.total or warning in capfd.readouterr().err, "warning")
        assert rig.node.guard.total == 0
        assert rig.now() == 0
        clock.publish(Clock(clock=stamp_to_ros(7 * SECOND)))
        rig.until(lambda: rig.now() == 7 * SECOND, "time")
