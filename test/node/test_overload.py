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

"""Overload: messages come faster than cycles run or are lost, one takes long, parameters change."""

from __future__ import annotations

import random
from itertools import count

import pytest
from each import each

pytest.importorskip("rclpy")
from rig import Rig, cube, pose
from shape_markers import triangle

from obb_collision import Accuracy
from obb_collision.node.inputs import subscriptions
from obb_collision.node.inputs.subscriptions import NO_NUMBER, Losses
from obb_collision.node.messages.conversions import stamp_from_ros

A1, A2 = ("a", 1), ("a", 2)
FLOOD = 300
"""Messages of a topic that arrive while nobody reads: more than any queue holds but that of poses
one by one."""


@each("topic", ["objects", "object_transform", "object_states", "object_poses"])
def test_the_first_cycle_after_a_flood_has_the_newest_state(topic: str, rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (9, 0, 0)))
    rig.answer()
    for step in range(FLOOD):  # the executor is at rest: all of them wait, or are lost
        place = pose(0.5 if step == FLOOD - 1 else 9.0 + step)
        if topic == "objects":
            rig.send(cube(A2, place[:3]))
        elif topic == "object_transform":
            rig.send_transform("a/2", place)
        elif topic == "object_states":
            rig.send_states(["a/2"], [place])
        else:
            rig.send_poses([2], [place])
    cycle, seen = rig.node.cycle, list[int]()
    run = cycle.run_stages

    def record(now: int) -> dict[str, float]:
        result = run(now)
        seen.append(rig.node.objects.newest_stamp(now))
        return result

    cycle.run_stages = record  # type: ignore[method-assign]
    rig.until(lambda: rig.stamp in seen, "the newest state")
    assert seen.index(rig.stamp) <= 1, "no cycle for states between, but one that began before"
    assert rig.pairs() == {("a/1", "a/2")}
    assert stamp_from_ros(rig.last["collisions"].header.stamp) == rig.stamp
    monitor = rig.monitor(topic)
    sent = FLOOD + (1 if topic == "objects" else 0)
    assert monitor.messages + monitor.lost <= sent
    assert monitor.superseded >= monitor.messages - 3, "what was taken and not used is counted"


def test_of_messages_that_take_long_no_more_than_one_delays_a_cycle(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.send(cube(A1), cube(A2, (9, 0, 0)))
    rig.answer()
    seconds, monitor = count(), rig.monitor("object_states")
    monkeypatch.setattr(subscriptions, "monotonic", lambda: float(next(seconds)))
    for step in range(3):
        rig.send_states(["a/2"], [pose(9.0 + step)])
    taken = []
    for _ in range(4):
        rig.subscribed.drain()
        taken.append(monitor.messages)
    assert taken == [1, 2, 3, 3]


def test_states_that_come_in_a_long_cycle_are_answered_by_the_next(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (9, 0, 0)))
    rig.answer()
    cycle, sent = rig.node.cycle, list[int]()
    run, stamps = cycle.run_stages, list[int]()

    def flood_and_run(now: int) -> dict[str, float]:
        if not sent:  # as if this cycle took as long as these take to come
            for step in range(50):
                rig.send_transform("a/2", pose(0.5 if step == 49 else 9.0))
            sent.append(rig.stamp)
        result = run(now)
        stamps.append(rig.node.objects.newest_stamp(now))
        return result

    cycle.run_stages = flood_and_run  # type: ignore[method-assign]
    rig.until(lambda: len(stamps) >= 3, "cycles")
    assert stamps[0] < sent[0]
    assert sent[0] in stamps[1:3], "one cycle later, or two where they had not all come yet"


def test_accuracy_is_not_lowered_without_a_budget() -> None:
    with Rig(accuracy="mesh", rate=1000.0) as rig:
        rig.send(triangle(A1), triangle(A2, x=0.1))
        rig.built(A1, A2)
        rig.until(lambda: levels(rig) == {Accuracy.MESH}, "meshes compared")
        for step in range(FLOOD):
            rig.send_transform("a/2", pose(0.1 + 1e-6 * step))
        rig.answer()
        assert levels(rig) == {Accuracy.MESH}
        assert rig.node.cycle.report is not None
        assert rig.node.cycle.report.cap is None


def levels(rig: Rig) -> set[int]:
    report = rig.node.cycle.report
    return set() if report is None else set(report.accuracies.tolist())


def test_a_message_after_a_change_of_parameters_is_taken_as_the_change_has_it() -> None:
    with Rig() as rig:
        for n in range(10):
            rig.set(max_objects=1)
            rig.set(max_objects=100)
            rig.send(*(cube((f"b{n}", k), (0.9 * k, 0.0, 10.0 * n)) for k in range(3)))
            assert len(rig.pairs()) == 2 * (n + 1)


def test_a_storm_of_parameters_leaves_the_node_with_the_last_ones(rig: Rig) -> None:
    rig.send(*(cube(("a", n), (0.9 * n, 0.0, 0.0)) for n in range(5)))
    assert len(rig.pairs()) == 4
    for n in range(100):
        assert rig.set(padding=0.001 * (n + 1))[0].successful
        rig.set(accuracy_overrides=[f"a/{n % 5}: aabb"])
    assert rig.node.objects.scene.padding == 0.1
    assert rig.node.objects.shapes.overrides.overrides[0][0] == "a/4"


def total(numbers: list[int], publishers: int = 1) -> int:
    losses = Losses(lambda: publishers)
    return sum(losses.count(number) for number in numbers)


def test_gaps_of_one_publisher_are_counted() -> None:
    assert total([1, 2, 3]) == 0
    assert total([1, 2, 5, 9]) == 2 + 3
    assert total([1000, 1001]) == 0, "it had published before the node came"


def test_a_publisher_that_restarts_has_lost_nothing() -> None:
    assert total([1, 2, 3, 1, 2, 4]) == 1


def test_middlewares_without_numbers_count_nothing() -> None:
    losses = Losses(lambda: 1)
    assert [losses.count(number) for number in (None, 0, NO_NUMBER, NO_NUMBER + 5)] == [0] * 4


@each("seed", range(20))
def test_of_several_publishers_all_losses_are_counted(seed: int) -> None:
    rng = random.Random(seed)
    next_numbers = {"a": 1, "b": 1, "c": 700}
    given, lost = [1, 1, 700], 0
    for _ in range(300):
        name = rng.choice(list(next_numbers))
        next_numbers[name] += 1 + (jump := rng.choice((0, 0, 0, 0, 1, 40)))
        lost += jump
        given.append(next_numbers[name])
    assert total(given, 3) == lost


def test_more_messages_than_a_queue_holds_are_counted_as_lost_and_superseded(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(("a", 1)))
    rig.answer()
    rig.send_states(["a/1"], [pose(-1)])
    rig.answer()
    for step in range(40):  # 10 of them fit into the queue, as nobody reads meanwhile
        rig.send_states(["a/1"], [pose(step)])
    rig.answer()
    assert rig.pose_of(("a", 1))[0] == 39.0, "the latest state wins"
    monitor = rig.monitor("object_states")
    assert monitor.lost + monitor.messages == 41
    assert monitor.lost >= 30 - 1, "but for the first, if that was taken before the others came"
    assert monitor.superseded >= monitor.messages - 3
    status = rig.status("input object_states")
    assert (status["lost"], status["superseded"]) == (str(monitor.lost), str(monitor.superseded))


def test_states_of_markers_that_newer_ones_replace_are_counted(rig: Rig) -> None:
    rig.send(*(cube(("a", 1), (float(x), 0, 0)) for x in range(10)), cube(("a", 2)))
    rig.answer()
    rig.until(lambda: rig.monitor("objects").superseded == 9, "nine replaced")
