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

"""What is known of collisions: free, colliding, or not known and why."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticStatus
from objects_rig import SECOND, START, ObjectsRig
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile
from rig import OUTPUTS, Rig, cube, pose
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

from obb_collision.node.diagnostics import answer as answers
from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN, Answer, answer
from obb_collision.node.messages.conversions import stamp_from_ros
from obb_collision.node.node import CollisionNode
from obb_collision.node.outputs.collision_status import PERIOD, CollisionStatus
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.topics.topics import DEADLINE
from obb_collision.shapes import Box

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
PAIR = (cube(A1), cube(A2, (0.5, 0, 0)))
STATUS = "collision_status"


@contextmanager
def listening(**options: Any) -> Iterator[Rig]:
    """Yield a rig that listens to the status, and runs slowly enough for a loaded machine."""
    with Rig(given={"cycle_timeout": 30.0} | options.pop("given", {}), **options) as rig:
        rig.listen(STATUS)
        yield rig


def said(rig: Rig) -> tuple[bytes, str]:
    """Level and message of the last status; the flag must fit."""
    if STATUS not in rig.last:
        return b"", ""
    (status,) = rig.last[STATUS].status
    return status.level, status.message


def wait(rig: Rig, level: bytes, text: str = "", flag: bool | None = None) -> dict[str, str]:
    """Wait for a level, a text in the message and a flag; returns the values by key."""
    rig.until(lambda: said(rig)[0] == level and text in said(rig)[1], f"{level!r} {text}")
    if flag is not None:
        rig.until(lambda: rig.last["in_collision"].data is flag, f"flag {flag}")
    (status,) = rig.last[STATUS].status
    return {pair.key: pair.value for pair in status.values}


def test_free_and_colliding_are_told_with_stamp_and_age() -> None:
    with listening() as rig:
        rig.send(cube(A1), cube(A2, (3, 0, 0)))
        rig.answer()
        before = rig.node._now()
        rig.until(lambda: wait(rig, FREE, "free", False)["objects"] == "2", "both")
        values = wait(rig, FREE, "free", False)
        assert stamp_from_ros(rig.last[STATUS].header.stamp) >= before - SECOND
        assert values["objects"] == "2"
        assert values["colliding pairs"] == "0"
        age = (rig.node._now() - rig.stamp) / SECOND
        assert float(values["age of the newest state (s)"]) == pytest.approx(age, abs=60.0)
        rig.send_transform("a/2", pose(0.5))
        values = wait(rig, COLLIDING, "1 pair collides", True)
        assert values["colliding pairs"] == "1"


def test_disabled_is_not_known_and_enabled_again_is() -> None:
    with listening() as rig:
        rig.send(cube(A1), cube(A2, (3, 0, 0)))
        rig.answer()
        wait(rig, FREE, flag=False)
        rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=False))
        wait(rig, UNKNOWN, "disabled", True)
        rig.listen("/diagnostics")
        rig.call(Trigger, "obb_collision/clear", Trigger.Request())
        wait(rig, UNKNOWN, "disabled", True)
        assert rig.status(": objects")["colliding"] == "not known"
        rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=True))
        wait(rig, FREE, "free", False)


def test_after_clear_nothing_collides_and_that_is_known() -> None:
    with listening() as rig:
        rig.listen("/diagnostics")
        rig.send(*PAIR)
        rig.answer()
        wait(rig, COLLIDING, flag=True)
        rig.call(Trigger, "obb_collision/clear", Trigger.Request())
        values = wait(rig, FREE, "free", False)
        assert values["objects"] == "0"
        assert rig.status(": objects")["colliding"] == "0"


def test_diagnostics_never_count_collisions_of_objects_that_are_gone(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(*PAIR)
    rig.answer()
    cycle = rig.node.cycle
    rig.until(lambda: rig.status(": objects")["colliding"] == "2", "colliding")
    report = cycle.report
    cycle.enabled = False
    rig.node.objects.clear()
    cycle.report = report
    status = rig.status(": objects")
    assert (status["count"], status["colliding"]) == ("0", "0")


def test_with_unknown_is_collision_off_the_flag_tells_of_collisions_only() -> None:
    with listening(unknown_is_collision=False) as rig:
        rig.send(*PAIR)
        rig.answer()
        wait(rig, COLLIDING, flag=True)
        rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=False))
        wait(rig, UNKNOWN, "disabled", False)
        rig.set(unknown_is_collision=True)
        wait(rig, UNKNOWN, "disabled", True)


def test_an_object_without_a_box_makes_it_unknown_and_is_named() -> None:
    with listening() as rig:
        rig.send(cube(A1), cube(A2, size=(0, 1, 1)), cube(B1, (9, 0, 0)))
        values = wait(rig, UNKNOWN, "1 without a box (not checked): a/2 (bad scale)", True)
        assert values["unplaceable"] == "1"
        rig.send(cube(B1))
        wait(rig, COLLIDING, "1 without a box", True)
        rig.send(Marker(ns="a", id=2, action=Marker.DELETE), cube(B1, (9, 0, 0)))
        wait(rig, FREE, "free", False)


def test_annotations_are_no_objects() -> None:
    with listening() as rig:
        rig.send(cube(A1), cube(A2, type=Marker.TEXT_VIEW_FACING, text="hello"))
        rig.answer()
        wait(rig, FREE, "free", False)


def test_a_refused_newcomer_is_forgotten_when_its_lifetime_ends() -> None:
    rig = ObjectsRig(A1)
    rig.send(START + 1)
    rig.objects.shapes.refuse(A2, "bad scale", shape=True, expiry=START + SECOND)
    rig.objects.shapes.refuse(B1, "bad scale", shape=True)
    rig.cycle()
    assert set(rig.objects.unplaceable) == {A2, B1}
    rig.now += 2 * SECOND
    rig.cycle()
    assert set(rig.objects.unplaceable) == {B1}


def known(rig: ObjectsRig, **options: Any) -> Answer:
    """Return what is known after a cycle, checked as the node does."""
    rig.cycle()
    given = {"enabled": True, "failed": False, "timeout": rig.object_timeout} | options
    report = rig.objects.scene.check()
    return answer(rig.objects, given.pop("report", report), now=rig.now, **given)


def late(policy: str, object_timeout: float = 0.0) -> ObjectsRig:
    """Return an object that was placed, and a state of it that waits in vain for its frame."""
    rig = ObjectsRig(A1, object_timeout=object_timeout)
    rig.objects.set_ignore_stale(policy == "ignore")
    rig.frames.spans["arm"] = (START, START + SECOND)
    rig.send(START + 1, "arm")
    assert known(rig).level == FREE
    rig.now += 2 * SECOND
    rig.send(START + 2 * SECOND, "arm")
    rig.cycle()
    rig.now += SECOND // 10  # less than transform_timeout
    return rig


@pytest.mark.parametrize("policy", ["keep", "ignore"])
def test_an_object_that_is_not_placed_in_time_makes_the_answer_unknown(policy: str) -> None:
    rig = late(policy)
    assert known(rig).level == FREE, "it may still come in time"
    rig.now += SECOND // 5
    found = known(rig)
    assert (found.level, found.flag(True), found.flag(False)) == (UNKNOWN, True, False)
    assert found.message == "1 not placed in time: a/1"
    rig.frames.spans["arm"] = (START, START + 3 * SECOND)
    rig.now += SECOND
    assert known(rig).level == FREE, "placed at last"


def test_a_stale_object_that_is_not_placed_counts_as_far_as_it_takes_part() -> None:
    levels = {}
    for policy in ("keep", "ignore"):
        rig = late(policy, object_timeout=1.5)
        rig.now += SECOND // 5
        rig.cycle()
        assert rig.objects.table.stale[rig.slots[0]]
        rig.objects.shapes.put(B1, Box((1.0, 1.0, 1.0)), (), None)  # a fresh one, elsewhere
        rig.slots = np.array([rig.objects.table.slots[B1]])
        rig.send(rig.now)
        levels[policy] = known(rig).level
    assert levels == {"keep": UNKNOWN, "ignore": FREE}


def test_what_collides_is_said_though_another_object_is_not_placed_in_time() -> None:
    rig = late("keep")
    rig.objects.shapes.put(B1, Box((1.0, 1.0, 1.0)), (), None)
    rig.slots = np.array([rig.objects.table.slots[B1]])
    rig.send(START)
    rig.now += SECOND // 5
    found = known(rig)
    assert found.level == COLLIDING
    assert found.message == "1 pair collides; 1 not placed in time: a/1"


def test_no_state_for_longer_than_the_timeout_is_not_known() -> None:
    rig = ObjectsRig(A1, A2, object_timeout=0.5)
    rig.send(START + 1)
    assert known(rig).level == COLLIDING, "both in one place"
    rig.objects.shapes.remove(rig.slots[1:2])
    rig.slots = rig.slots[:1]
    assert known(rig).level == FREE
    rig.now += SECOND
    blind = known(rig)
    assert (blind.level, blind.unknown) == (UNKNOWN, answers.BLIND)
    assert blind.message.startswith("no state placed for 1.0 s; 1 stale: a/1")
    assert blind.flag(True)
    assert not blind.flag(False)


def test_one_stale_object_among_others_is_named_only() -> None:
    rig = ObjectsRig(A1, A2, object_timeout=0.5)
    rig.send(START + 1, row=0)
    rig.send(START + 9 * SECOND, row=1)
    rig.now += SECOND
    rig.send(rig.now + SECOND // 2, row=1)
    found = known(rig)
    assert (found.level, found.stale, found.names_stale) == (FREE, 1, ("a/1",))
    assert found.message == "free; 1 stale: a/1"


def test_objects_that_wait_for_their_transform_are_without_a_box() -> None:
    rig = ObjectsRig(A1, A2)
    rig.send(START + 1, "robot", 0)
    rig.send(START + 1, "", 1)
    found = known(rig)
    assert (found.level, found.names_missing) == (UNKNOWN, ("a/1",))
    rig.frames.spans["robot"] = START, START + 5 * SECOND
    assert known(rig).level == COLLIDING


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"enabled": False}, answers.DISABLED),
        ({"failed": True}, answers.FAILED),
        ({"report": None}, answers.UNCHECKED),
    ],
)
def test_what_makes_the_whole_unknown(options: dict[str, Any], reason: str) -> None:
    rig = ObjectsRig(A1)
    rig.send(START + 1)
    assert known(rig).level == FREE
    found = known(rig, **options)
    assert (found.level, found.message) == (UNKNOWN, reason)


def test_a_cycle_that_fails_is_not_known_and_the_next_good_one_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with listening() as rig:
        rig.send(cube(A1))
        rig.answer()
        wait(rig, FREE, flag=False)

        def fail(*_: Any) -> None:
            raise ZeroDivisionError

        with monkeypatch.context() as patch:
            patch.setattr(rig.node.objects.scene, "check", fail)
            wait(rig, UNKNOWN, "the last cycle failed", True)
        wait(rig, FREE, "free", False)


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

    def is_called(self, name: str) -> bool:
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
    status.begin()
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


def test_a_cycle_that_does_not_end_is_told_by_another_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with Rig(cycle_timeout=0.1) as rig:
        rig.listen(STATUS)
        rig.send(cube(A1))
        rig.answer()
        wait(rig, FREE, flag=False)
        publisher = rig.node._outputs.publishers[STATUS]
        publish, told = publisher.publish, threading.Event()

        def noted(message: Any) -> None:
            publish(message)
            if message.status[0].message.startswith("cycle blocked"):
                told.set()

        monkeypatch.setattr(publisher, "publish", noted)
        update = rig.node.objects.update
        blocked: list[bool] = []

        def block(now: int, timeout: float) -> None:
            update(now, timeout)
            if not blocked:
                blocked.append(told.wait(30.0))

        monkeypatch.setattr(rig.node.objects, "update", block)
        rig.until(lambda: blocked, "a blocked cycle")
        assert blocked == [True], "told while it was blocked"
        wait(rig, FREE, "free", False)


def test_a_node_that_ends_says_so_last() -> None:
    with Rig() as rig:
        rig.listen(STATUS)
        rig.send(cube(A1))
        rig.answer()
        wait(rig, FREE, flag=False)
        rig.node.destroy_node()
        wait(rig, UNKNOWN, "shutting down", True)
        assert not any(thread.name == STATUS for thread in threading.enumerate())


def test_the_deadline_is_offered_and_told_when_the_node_is_gone() -> None:
    assert PERIOD * 2 < DEADLINE
    with Rig() as rig:
        missed: list[Any] = []
        kept: list[Any] = []
        qos = QoSProfile(
            depth=1,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
            deadline=Duration(seconds=DEADLINE),
        )
        rig.client.create_subscription(
            OUTPUTS[STATUS].message,
            STATUS,
            kept.append,
            qos,
            event_callbacks=SubscriptionEventCallbacks(deadline=missed.append),
        )
        rig.until(lambda: len(kept) > 3, "status with a deadline")
        rig.node.status.close()  # says its last word, and is silent as a dead node is
        count = len(missed)
        rig.until(lambda: len(missed) > count, "deadline missed")
        assert kept[-1].status[0].level == DiagnosticStatus.STALE


def test_before_the_first_check_nothing_is_known() -> None:
    with Rig() as rig:
        status: list[Any] = []
        flags: list[Any] = []
        qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        rig.client.create_subscription(
            OUTPUTS[STATUS].message, f"/cell/{STATUS}", status.append, qos
        )
        rig.client.create_subscription(Bool, "/cell/in_collision", flags.append, qos)
        other = CollisionNode(context=rig.context, namespace="cell")
        try:
            rig.until(lambda: status and flags, "status of a node that nobody spins")
            assert (status[0].status[0].level, flags[0].data) == (UNKNOWN, True)
            assert {message.status[0].message for message in status} == {"starting"}
            rig.executor.add_node(other)
            rig.until(lambda: status[-1].status[0].level == FREE, "first check")
        finally:
            rig.executor.remove_node(other)
            other.destroy_node()
