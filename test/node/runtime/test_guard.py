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

"""A failure inside the node never ends it: at the item, the message, the output and the cycle."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

pytest.importorskip("rclpy")
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rig import DOMAIN, NAMESPACE, Rig, cube, pose, sync
from std_srvs.srv import Trigger

from obb_collision.node.messages.names import namespace_number
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard
from obb_collision.node.runtime.running import spin

A, B, BAD = ("a", 1), ("a", 2), ("bad", 1)


class UnforeseenError(Exception):
    """What nobody thought of."""


def failing(given: Callable[..., Any], fails: Callable[..., bool]) -> Callable[..., Any]:
    """Return a function that raises where ``fails`` says so of its arguments."""

    def call(*args: Any, **kwargs: Any) -> Any:
        if fails(*args):
            raise UnforeseenError("by the test")
        return given(*args, **kwargs)

    return call


def test_an_item_that_fails_is_refused_alone(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    objects = rig.node.objects
    bad = namespace_number(BAD[0])
    fails = failing(objects.shapes.put_primitives, lambda keys, *_: bad in keys[0])
    monkeypatch.setattr(objects.shapes, "put_primitives", fails)
    rig.send(cube(A), cube(BAD), cube(B, (0.5, 0, 0)))
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.refused("objects") == {INTERNAL_ERROR: 1}
    assert "bad/1" in rig.node.guard.last
    assert BAD in objects.unplaceable


def test_an_output_that_fails_stops_no_other(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.listen("contacts")
    rig.send(cube(A), cube(B, (0.5, 0, 0)))
    rig.next("contacts")
    outputs = rig.node.outputs
    monkeypatch.setattr(
        outputs, "_publish_cloud", failing(outputs._publish_cloud, lambda name, *_: True)
    )
    assert sync(rig) == {("a/1", "a/2")}
    assert rig.node.guard.counts["output contacts"] > 0
    assert rig.last["in_collision"].data


def test_services_and_timers_go_on(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.send(cube(A))
    rig.answer()
    with monkeypatch.context() as patch:
        patch.setattr(rig.node.objects, "clear", failing(lambda: 0, lambda *_: True))
        response = rig.call(Trigger, "obb_collision/clear", Trigger.Request())
        assert not response.success
        assert INTERNAL_ERROR in response.message
    rig.listen("/diagnostics")
    found = rig.status("internal errors")
    assert found["level"] == "02"
    assert found["service clear"] == "1"
    assert rig.call(Trigger, "obb_collision/clear", Trigger.Request()).success


def test_what_the_executor_raises_does_not_end_the_spinning() -> None:
    context, caught = Context(), list[Exception]()
    context.init(domain_id=DOMAIN)
    node = Node("raises", context=context, namespace=NAMESPACE)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def tick() -> None:
        if len(caught) == 3:
            context.try_shutdown()
        raise UnforeseenError("by the test")

    def take(error: Exception) -> None:
        if not context.ok():
            raise error
        caught.append(error)

    node.create_timer(0.001, tick)
    with suppress(ExternalShutdownException, UnforeseenError):
        spin(executor, take)
    assert len(caught) == 3
    node.destroy_node()


def test_a_message_that_cannot_be_taken_leaves_no_callback_waiting() -> None:
    context, caught, ticks = Context(), list[Exception](), list[int]()
    context.init(domain_id=DOMAIN)
    node = Node("takes", context=context, namespace=NAMESPACE)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    take = executor._take_timer

    def fail_once(timer: Any) -> Any:
        if not caught:
            raise MemoryError
        return take(timer)

    executor._take_timer = fail_once  # type: ignore[method-assign]

    def tick() -> None:
        ticks.append(1)
        if len(ticks) == 3:
            context.try_shutdown()

    node.create_timer(0.001, tick)  # all of a node's callbacks are in one group
    with suppress(ExternalShutdownException):
        spin(executor, caught.append)
    assert (len(caught), len(ticks)) == (1, 3)
    node.destroy_node()


def test_a_queue_that_cannot_be_read_is_unknown_hides_no_other_and_is_opened_again(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.listen("collision_status")
    rig.send(cube(A), cube(B, (3, 0, 0)))
    rig.answer()
    subscribed = rig.node.subscribed
    drain, topic, before = subscribed._drain, "object_states", subscribed.open["object_states"]

    def fail_once(name: str, subscription: Any) -> None:
        if name == topic and subscription is before:
            raise MemoryError
        drain(name, subscription)

    monkeypatch.setattr(subscribed, "_drain", fail_once)

    def reasons() -> str:
        (status,) = rig.last["collision_status"].status
        return {pair.key: pair.value for pair in status.values}["reasons"]

    def moved() -> bool:
        rig.send_states(["a/2"], [pose(0.5)])
        return rig.pose_of(B)[0] == 0.5

    rig.until(lambda: subscribed.open.get(topic) not in (None, before), "a new subscription")
    rig.until(lambda: reasons() == "input_unreadable", "what is lost is not known")
    rig.until(moved, "a state")
    rig.until(lambda: not reasons(), "all is known again")
    assert rig.node.guard.counts["inputs"] == 1
    rig.send_transform("a/1", pose(5.0))
    assert rig.pairs() == set()


def test_each_failure_is_logged_once_with_its_traceback() -> None:
    lines: list[str] = []
    guard = Guard(lines.append, lambda: True)

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


def test_what_fails_because_the_context_is_gone_is_raised() -> None:
    guard = Guard(print, lambda: False)
    with pytest.raises(UnforeseenError), guard.catching("cycle"):
        raise UnforeseenError
    assert guard.total == 0
