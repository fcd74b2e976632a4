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

"""Parts of rclpy that it does not document: services waited for as one, and a node without any."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy")
from lifecycle_msgs.srv import GetAvailableTransitions, GetState
from rcl_interfaces.srv import GetParameters, ListParameters
from rig import NAMESPACE, RATE, Rig, cube

from obb_collision.node.runtime import inner


def test_requests_that_come_together_are_all_answered(rig: Rig) -> None:
    node = f"{NAMESPACE}/obb_collision"
    clients: list[tuple[Any, Any]] = [
        (rig.client.create_client(GetState, f"{node}/get_state"), GetState.Request()),
        (
            rig.client.create_client(GetParameters, f"{node}/get_parameters"),
            GetParameters.Request(names=["rate"]),
        ),
        (
            rig.client.create_client(ListParameters, f"{node}/list_parameters"),
            ListParameters.Request(),
        ),
    ]
    rig.until(lambda: all(client.service_is_ready() for client, _ in clients), "services")
    futures = [client.call_async(request) for _ in range(5) for client, request in clients]
    rig.until(lambda: all(future.done() for future in futures), "answers")
    state, parameters, names = (future.result() for future in futures[-3:])
    assert state.current_state.label == "active"
    assert parameters.values[0].double_value == RATE
    assert "rate" in names.result.names


def test_a_request_that_fails_takes_no_other_with_it(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    (broken,) = [s for s in rig.node.rare.services if s.srv_type is GetParameters]

    def fail(*_: object) -> None:
        raise MemoryError("too large")

    monkeypatch.setattr(broken, "callback", fail)
    node = f"{NAMESPACE}/obb_collision"
    first = rig.client.create_client(GetParameters, f"{node}/get_parameters")
    second = rig.client.create_client(GetAvailableTransitions, f"{node}/get_transition_graph")
    rig.until(lambda: first.service_is_ready() and second.service_is_ready(), "services")
    first.call_async(GetParameters.Request(names=["rate"]))
    future = second.call_async(GetAvailableTransitions.Request())
    raised: list[MemoryError] = []

    def answered() -> bool:
        try:
            rig.executor.spin_once(timeout_sec=0.05)
        except MemoryError as error:  # as rclpy does with services of its own
            raised.append(error)
        return bool(raised) and future.done()

    # not rig.until, which would get the error; a turn takes 0.05 s at most
    assert any(answered() for _ in range(400)), "no other answer"
    result: Any = future.result()
    assert result.available_transitions


def test_a_node_that_ends_leaves_no_service() -> None:
    with Rig() as rig:
        rig.node.destroy_node()
        own = f"{NAMESPACE}/obb_collision/"
        rclpys = f"{own}get_type_description"  # it stays as long as the object of the node does

        def left() -> set[str]:
            names = {name for name, _ in rig.client.get_service_names_and_types()}
            return {name for name in names if name.startswith(own)}

        rig.until(lambda: left() <= {rclpys}, "no service")
        assert not [*rig.node.services]


def test_a_node_works_where_rclpy_has_none_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inner, "getattr", lambda _, name, default: default, raising=False)
    with Rig() as rig:
        assert rig.node.rare.services == []
        rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0)))
        assert rig.pairs() == {("a/1", "a/2")}
        assert all(result.successful for result in rig.set(padding=0.01))
        inner.release(rig.executor)
    assert not [*rig.node.services]
