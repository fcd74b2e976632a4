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

"""``/diagnostics``, once a second, and the warnings that go with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from obb_collision.node.cycle import Cycle
from obb_collision.node.diagnostics import diagnostics
from obb_collision.node.diagnostics.diagnostics import RobotLike
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.diagnostics.qos import QosWatch
from obb_collision.node.inputs.subscriptions import Subscriptions
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.objects.objects import Objects
from obb_collision.node.outputs.effects import Effects
from obb_collision.node.outputs.outputs import Outputs
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.runtime.guard import Guard

PERIOD = 1.0
"""Seconds between two messages."""


class Reporting:
    """Publishes the state of all parts of a node. now: time of its clock (ns)."""

    def __init__(
        self,
        node: Node,
        monitors: dict[str, InputMonitor],
        subscriptions: Subscriptions,
        objects: Objects,
        cycle: Cycle,
        effects: Effects,
        outputs: Outputs,
        parameters: Parameters,
        guard: Guard,
        now: Callable[[], int],
        robots: Sequence[RobotLike] = (),
    ) -> None:
        self._robots = robots
        self._name = node.get_fully_qualified_name().lstrip("/")
        self._monitors, self._subscriptions, self._objects = monitors, subscriptions, objects
        self._cycle, self._effects, self._outputs = cycle, effects, outputs
        self._parameters, self._guard, self._now = parameters, guard, now
        self._qos = QosWatch(node, node.get_logger().warning)
        self._last = perf_counter()

    def publish(self) -> None:
        """Check QoS, log pending warnings, and publish the message if it is requested."""
        elapsed, now = perf_counter() - self._last, self._now()
        self._last += elapsed
        self._qos.look({**self._subscriptions.open, **self._outputs.ends})
        for topic, monitor in self._monitors.items():
            monitor.flush()
            monitor.mismatches = len(self._qos.reasons.get(topic, ()))
        if self._effects.is_requested("diagnostics"):
            self._publish(elapsed, now)
            return
        self._cycle.monitor.take()
        for monitor in self._monitors.values():
            monitor.since_last_report()

    def _publish(self, elapsed: float, now: int) -> None:
        name, cycle, parameters = self._name, self._cycle, self._parameters
        period = 1.0 / parameters.rate
        message = DiagnosticArray()
        message.header.stamp = stamp_to_ros(now)
        message.status = [
            *(
                diagnostics.input_status(name, topic, monitor, now, elapsed)
                for topic, monitor in self._monitors.items()
            ),
            diagnostics.object_status(name, self._objects, parameters.stale_policy, cycle.report),
            *(diagnostics.robot_status(name, robot) for robot in self._robots),
            diagnostics.cycle_status(
                name, cycle.monitor, self._effects.states(), cycle.paused, elapsed, period
            ),
            diagnostics.guard_status(name, self._guard),
            diagnostics.qos_status(name, self._qos.reasons),
        ]
        self._outputs.publishers["diagnostics"].publish(message)
