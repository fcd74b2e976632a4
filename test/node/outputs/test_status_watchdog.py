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

"""The watchdog of ``collision_status``: what is published when, also where no cycle ends."""

from __future__ import annotations

from typing import Any

import pytest
from objects_rig import START
from rclpy.duration import Duration

from obb_collision.node.diagnostics.answer import Answer, Reason
from obb_collision.node.outputs import PERIOD, CollisionStatus
from obb_collision.node.runtime.guard import Guard

STATUS = "collision_status"


class Recorder:
    """Stands for publishers, parameters and effects of CollisionStatus."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.now = 0.0
        self.modes = {"collision_status": "auto", "in_collision": "auto"}
        self.subscribed = True
        self.rate, self.cycle_timeout, self.unknown_is_collision = 50.0, 0.5, True
        stands_for: Any = self
        self.status = CollisionStatus(
            "node",
            {STATUS: stands_for, "in_collision": stands_for},
            stands_for,
            stands_for,
            lambda: START,
            Guard(pytest.fail, lambda: True),
            lambda: self.now,
        )

    def publish(self, message: Any) -> None:
        self.sent.append(message)

    def mode(self, name: str) -> str:
        return self.modes[name]

    def is_requested(self, name: str) -> bool:
        return self.modes[name] == "on" or (self.modes[name] == "auto" and self.subscribed)

    def wait_for_all_acked(self, timeout: Duration) -> bool:
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


def test_the_watchdog_knows_slow_rates() -> None:
    recorder = Recorder()
    recorder.rate = 0.5
    recorder.status.update(OK, cycle=True)
    recorder.take()
    recorder.now = 2.4
    recorder.status.look()
    assert recorder.take()[0] == [""]
    recorder.now = 2.6
    recorder.status.look()
    assert recorder.take()[0] == ["blocked"]


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
