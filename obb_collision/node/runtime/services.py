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

"""Services that are called now and then, waited for as one.

rclpy's executors prepare every entity of a node, one by one, before every wait: a managed node has
twelve services of rclpy's own, which took a quarter of the time of a wait.
"""

from __future__ import annotations

from typing import Any

from rclpy.executors import await_or_execute
from rclpy.node import Node
from rclpy.waitable import NumberOfEntities, Waitable


class RareServices(Waitable):
    """Takes over the services that a node has so far."""

    def __init__(self, node: Node) -> None:
        super().__init__(node.default_callback_group)
        self._node = node
        self._services: list[Any] = [*node._services]
        self._handles = [service.handle for service in self._services]
        for handle in self._handles:  # not for every wait: nobody else destroys them
            handle.__enter__()
        node._services.clear()
        node.add_waitable(self)

    def close(self) -> None:
        """Leave the services to the node again, which destroys them."""
        services, self._services = self._services, []
        if services:
            self._node.remove_waitable(self)
            for handle in self._handles:
                handle.__exit__(None, None, None)
            self._node._services.extend(services)

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
        for service in self._services:
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
