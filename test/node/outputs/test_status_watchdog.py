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

pytest.importorskip("rclpy")
from objects_rig import START
from rclpy.duration import Duration
from rig import cube

from obb_collision.node.diagnostics.answer import Answer
from obb_collision.node.outputs.collision_status import PERIOD, CollisionStatus
from obb_collision.node.runtime.guard import Guard

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
PAIR = (cube(A1), cube(A2, (0.5, 0, 0)))
STATUS = "collision_status"


class Recorder:
    """Stands for publishers, parameters and effects of CollisionStatus."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.now = 0.0
        self.modes = {"collision_status": "auto", "in_collision": "auto"}
        self.subscribed = True
        self.rate, self.cycle_timeout, self.unknown_is_collision = 50.0, 0.5, True
        self.input_timeout = 0.0
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
        """Messages of the status and flags since the last call."""
        taken, self.sent = self.sent, []
        return (
            [message.status[0].message for message in taken if hasattr(message, "status")],
            [message.data for message in taken if hasattr(message, "data")],
        )


def test_the_watchdog_says_that_the_cycle_is_blocked_and_until_then_repeats() -> None:
    recorder = Recorder()
    status = recorder.status
    status.rest()
    assert recorder.take() == (["starting"], [True])
    status.update(Answer(unknown=""), cycle=True)
    assert recorder.take() == (["free"], [False])
    for step in range(1, 5):
        recorder.now = step * PERIOD
        status.look()
    messages, flags = recorder.take()
    assert set(messages) == {"free"}
    assert len(messages) >= 2
    assert flags == []
    recorder.now = 0.53
    status.look()
    assert recorder.take() == (["cycle blocked for 0.5 s"], [True])
    recorder.now = 0.7
    status.look()
    assert recorder.take() == (["cycle blocked for 0.7 s"], [])
    status.update(Answer(unknown=""), cycle=True)
    assert recorder.take() == (["free"], [False])


def test_the_watchdog_knows_slow_rates() -> None:
    recorder = Recorder()
    recorder.rate = 0.5
    recorder.status.update(Answer(unknown=""), cycle=True)
    recorder.take()
    recorder.now = 2.4
    recorder.status.look()
    assert recorder.take()[0] == ["free"]
    recorder.now = 2.6
    recorder.status.look()
    assert recorder.take()[0] == ["cycle blocked for 2.6 s"]


def test_at_fifty_cycles_a_second_ten_are_told_and_changes_at_once() -> None:
    recorder = Recorder()
    free, colliding = Answer(unknown=""), Answer(unknown="", pairs=1)
    for cycle in range(50):
        recorder.now = cycle * 0.02
        recorder.status.update(free, cycle=True)
        recorder.status.look()
    messages, flags = recorder.take()
    assert 9 <= len(messages) <= 11
    assert flags == [False] * 50, "the flag every cycle while subscribed"
    recorder.now += 0.001
    recorder.status.update(colliding, cycle=True)
    assert recorder.take() == (["1 pair collides"], [True])


def test_unheard_only_changes_are_told_and_off_nothing() -> None:
    recorder = Recorder()
    recorder.subscribed = False
    recorder.status.update(Answer(unknown=""), cycle=True)
    assert recorder.take() == (["free"], [False])
    recorder.now = 0.4
    recorder.status.update(Answer(unknown=""), cycle=True)
    recorder.status.look()
    assert recorder.take() == ([], [])
    recorder.status.update(Answer(unknown="", missing=1), cycle=True)
    assert [len(kind) for kind in recorder.take()] == [1, 1]
    recorder.modes = dict.fromkeys(recorder.modes, "off")
    assert recorder.status.is_off
    recorder.status.update(Answer(unknown=""), cycle=True)
    recorder.now = 99.0
    recorder.status.look()
    assert recorder.take() == ([], [])


def test_the_last_word_is_that_it_ends() -> None:
    recorder = Recorder()
    recorder.status.update(Answer(unknown=""), cycle=True)
    recorder.take()
    recorder.status.close()
    assert recorder.take() == (["shutting down"], [True])
    recorder.status.update(Answer(unknown=""), cycle=True)
    recorder.status.look()
    recorder.status.close()
    assert recorder.take() == ([], [])


def test_the_watchdog_says_that_input_has_stopped_by_its_own_clock() -> None:
    recorder = Recorder()
    status = recorder.status
    recorder.input_timeout = 0.4
    status.update(Answer(unknown=""), cycle=True)
    recorder.take()
    recorder.now = 0.41
    status.look()  # though no cycle has ended since
    assert recorder.take() == (["no input for 0.4 s"], [True])
    recorder.now = 0.6
    status.update(Answer(unknown="", pairs=1), cycle=True)
    messages, flags = recorder.take()
    assert messages == ["no input for 0.6 s; 1 pair collides at the last check"]
    assert flags == [True]
    status.note_input()
    status.update(Answer(unknown=""), cycle=True)
    assert recorder.take() == (["free"], [False])
    recorder.now, recorder.input_timeout = 99.0, 0.0
    status.update(Answer(unknown=""), cycle=True)
    assert recorder.take()[0] == ["free"], "never, by default"


def test_other_reasons_are_not_hidden_by_a_stop_of_input() -> None:
    recorder = Recorder()
    recorder.input_timeout, recorder.now = 0.4, 1.0
    recorder.status.update(Answer(unknown="disabled"), cycle=True)
    assert recorder.take()[0] == ["disabled"]
