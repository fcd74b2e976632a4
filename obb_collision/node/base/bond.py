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


"""The bond with a lifecycle manager of nav2: a heartbeat, by which it notices that a node died."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from uuid import uuid4

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from obb_collision.node.messages.optional import optional

Status: Any = optional("bond.msg", "Status")
"""None where bond cannot be used: then the manager needs ``bond_timeout: 0.0``."""
TIMEOUT = 4.0
"""Seconds after which the manager takes a silent node for dead, as nodes of nav2 tell it."""


class Bond:
    """Sends a heartbeat while the node is active; period: seconds."""

    def __init__(self, node: Node, period: float) -> None:
        self._node, self._period = node, period
        self._number = str(uuid4())
        self._publisher = node.create_publisher(Status, "bond", 10)
        self._stop: Callable[[], object] = lambda: None

    def begin(self) -> None:
        """Send heartbeats from now on."""
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self._node.create_timer(self._period, lambda: self._send(True), clock=clock)
        self._stop = lambda: self._node.destroy_timer(timer)
        self._send(True)

    def end(self) -> None:
        """Break the bond, and send no more."""
        self._stop()
        self._stop = lambda: None
        self._send(False)

    def _send(self, active: bool) -> None:
        status = Status(id=self._node.get_name(), instance_id=self._number, active=active)
        status.header.stamp = self._node.get_clock().now().to_msg()
        status.heartbeat_timeout, status.heartbeat_period = TIMEOUT, self._period
        self._publisher.publish(status)
