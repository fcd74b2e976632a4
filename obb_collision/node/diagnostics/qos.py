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

"""QoS overrides by parameters, and incompatible publishers and subscribers with the reason.

They are polled: rclpy's event handlers, one per endpoint, would be waited for at every message,
which takes a third of a cycle of 1,000 boxes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSPolicyKind, QoSProfile, qos_check_compatible
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

LARGEST_DEPTH = 100_000
"""Maximum depth of a queue: more messages than a node can use, fewer than fit into memory."""


def overridable() -> QoSOverridingOptions:
    """Return options by which parameters change depth, durability and reliability of an endpoint.

    They are named ``qos_overrides.TOPIC.KIND.POLICY``, as everywhere in ROS: TOPIC is the full
    name, with namespace and after remapping, KIND is ``publisher`` or ``subscription``.
    """
    policies = (QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY, QoSPolicyKind.RELIABILITY)
    return QoSOverridingOptions(policies, callback=_check)


def _check(profile: QoSProfile) -> SetParametersResult:
    """Accept an overridden profile, or refuse it with the reason."""
    reason = ""
    if not 1 <= profile.depth <= LARGEST_DEPTH:
        reason = f"depth must be 1 to {LARGEST_DEPTH}, not {profile.depth}"
    for policy in (profile.durability, profile.reliability):
        if policy.name == "UNKNOWN":
            reason = f"unknown is no {type(policy).__name__}"
    return SetParametersResult(successful=not reason, reason=reason)


class QosWatch:
    """Counts mismatches by topic and warns of new ones."""

    def __init__(self, node: Node, warn: Callable[[str], None]) -> None:
        self._node, self._warn = node, warn
        self.reasons: dict[str, list[str]] = {}
        """Why other ends are incompatible, one per end, by topic."""

    def look(self, ends: Mapping[str, Publisher | Subscription]) -> None:
        """Compare endpoints, by the node's names of their topics, with the other ends."""
        found = {topic: self._reasons(end) for topic, end in ends.items()}
        for topic, reasons in found.items():
            if len(reasons) > len(self.reasons.get(topic, ())):
                self._warn(
                    f"{topic}: incompatible QoS or message type, no data exchanged: {reasons[-1]}"
                )
        self.reasons = found

    def _reasons(self, end: Publisher | Subscription) -> list[str]:
        """Return the reason per other end that is incompatible."""
        topic = end.topic_name
        if isinstance(end, Publisher):
            known, matched = self._node.count_subscribers(topic), end.get_subscription_count()
        else:
            known, matched = self._node.count_publishers(topic), end.get_publisher_count()
        if known <= matched:  # typical, and cheaper than comparing each
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
