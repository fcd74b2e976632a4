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

"""Publishers and subscribers that can't be matched with the node's: which, how many and why.

Looked for now and then: an event handler an endpoint, as rclpy has them for this, would be waited
for at every message, which is a third of what a cycle of 1,000 boxes takes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription


class QosWatch:
    """Counts mismatches by topic and warns of new ones."""

    def __init__(self, node: Node, warn: Callable[[str], None]) -> None:
        self._node, self._warn = node, warn
        self.mismatches: dict[str, int] = {}

    def look(self, ends: Mapping[str, Publisher | Subscription]) -> None:
        """Look at the other ends of endpoints, by topic as the node names it."""
        found = {topic: self._reasons(end) for topic, end in ends.items()}
        for topic, reasons in found.items():
            if len(reasons) > self.mismatches.get(topic, 0):
                self._warn(f"{topic}: no data flows, for QoS or type differ: {reasons[-1]}")
        self.mismatches = {topic: len(reasons) for topic, reasons in found.items()}

    def _reasons(self, end: Publisher | Subscription) -> list[str]:
        """Return why other ends can't be matched, one an end."""
        topic = end.topic_name
        if isinstance(end, Publisher):
            known, matched = self._node.count_subscribers(topic), end.get_subscription_count()
        else:
            known, matched = self._node.count_publishers(topic), end.get_publisher_count()
        if known <= matched:  # as a rule, and cheaper than to look at each
            return []
        return list(self._faults(end, topic))

    def _faults(self, end: Publisher | Subscription, topic: str) -> Iterable[str]:
        kind = _type_name(end.msg_type)
        outgoing = isinstance(end, Publisher)
        list_others = (
            self._node.get_subscriptions_info_by_topic
            if outgoing
            else self._node.get_publishers_info_by_topic
        )
        for other in list_others(topic):
            if other.topic_type != kind:
                yield f"type {other.topic_type} of {other.node_name}"
                continue
            pair = end.qos_profile, other.qos_profile
            level, reason = qos_check_compatible(*(pair if outgoing else pair[::-1]))
            if level == QoSCompatibility.ERROR:
                yield f"{reason.strip().rstrip(';')} ({other.node_name})"


def _type_name(kind: Any) -> str:
    package, folder = kind.__module__.split(".")[:2]
    return f"{package}/{folder}/{kind.__name__}"
