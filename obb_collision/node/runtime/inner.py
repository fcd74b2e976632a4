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

"""Parts of rclpy that it does not document, and what a node does where a version lacks them.

Nothing else in the package uses any. Each function does nothing where they are missing: the node
works, and its docstring says what is worse then.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.executors import Executor, await_or_execute
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.waitable import NumberOfEntities, Waitable
from rosgraph_msgs.msg import Clock


def parameter_overrides(node: Node) -> Mapping[str, Any]:
    """Return parameters given at the start; none where missing: no hint at misspelt ones."""
    found: Mapping[str, Any] = getattr(node, "_parameter_overrides", {})
    return found


def refuse_clocks(node: Node, is_bad: Callable[[Clock], bool]) -> None:
    """Ignore messages of /clock that are bad.

    Where missing, rclpy raises exceptions for times before 1970, which the executor's guard counts.
    """
    source: Any = getattr(node, "_time_source", None)
    take = getattr(source, "clock_callback", None)
    if take is None:
        return

    def checked(message: Clock) -> None:
        if not is_bad(message):
            take(message)

    source.clock_callback = checked
    subscription = getattr(source, "_clock_sub", None)
    if subscription is not None:  # simulated time from the start
        subscription.callback = checked


def destroy_states(node: LifecycleNode) -> None:
    """Destroy a node's life cycle, which holds the handle of the node.

    Where missing, the node's name stays visible until the object is gone.
    """
    machine: Any = getattr(node, "_state_machine", None)
    if hasattr(machine, "destroy_when_not_in_use"):
        machine.destroy_when_not_in_use()


def release(executor: Executor) -> None:
    """Let callbacks run again after a message could not be taken.

    rclpy marks what it takes from, and its group, as busy, and leaves it so where that raises: no
    callback of the node would run any more. Where the marks are missing, none can be left.
    """
    for node in executor.get_nodes():
        ends = (node.subscriptions, node.timers, node.services, node.clients, node.waitables)
        for entity in (entity for some in ends for entity in some):
            if getattr(entity, "_executor_event", False):
                entity._executor_event = False
                group = entity.callback_group
                if getattr(group, "_active_entity", None) is entity:
                    group.ending_execution(entity)


class RareServices(Waitable):
    """Services that are called now and then, waited for as one.

    rclpy's executors prepare every entity of a node, one by one, before every wait: a managed node
    has twelve services of rclpy's own, which took a quarter of the time of a wait. Takes over those
    that a node has so far; where its list of them is missing, none.
    """

    def __init__(self, node: Node) -> None:
        super().__init__(node.default_callback_group)
        self._node = node
        self._of_node: list[Any] = getattr(node, "_services", [])
        self.services: list[Any] = [*self._of_node]
        self._handles = [service.handle for service in self.services]
        for handle in self._handles:  # not for every wait: nobody else destroys them
            handle.__enter__()
        self._of_node.clear()
        node.add_waitable(self)

    def close(self) -> None:
        """Leave the services to the node again, which destroys them."""
        services, self.services = self.services, []
        if services:
            self._node.remove_waitable(self)
            for handle in self._handles:
                handle.__exit__(None, None, None)
            self._of_node.extend(services)

    def get_num_entities(self) -> NumberOfEntities:
        """Return how much room a wait set needs."""
        return NumberOfEntities(num_services=len(self._handles))

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Wait for all of them."""
        for handle in self._handles:
            wait_set.add_service(handle)

    def is_ready(self, wait_set: Any) -> bool:
        """Return whether one of them is called."""
        ready = wait_set.get_ready_entities("service")
        return bool(ready) and any(handle.pointer in ready for handle in self._handles)

    def take_data(self) -> Any:
        """Return one request, with its service; others wait in the middleware."""
        for service in self.services:
            request, header = service.handle.service_take_request(service.srv_type.Request)
            if header is not None:
                return service, request, header
        return None

    async def execute(self, taken: Any) -> None:
        """Answer a request."""
        if taken is not None:
            service, request, header = taken
            answer = await await_or_execute(service.callback, request, service.srv_type.Response())
            service.send_response(answer, header)
