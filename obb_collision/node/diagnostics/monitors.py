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

"""Statistics of messages received, refused items by reason, and QoS that does not match."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSPolicyKind, QoSProfile, qos_check_compatible
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from obb_collision.typing import Mask

MAX_REASONS = 64
"""Maximum number of reasons counted separately; reasons are fixed phrases, so this is a guard."""


class Missed(NamedTuple):
    """Where messages were lost: before a message of this number, which came at this time (ns)."""

    number: int
    time: int


@dataclass
class InputMonitor:
    """Statistics of one input topic: messages, age, refused and doubtful items by reason."""

    topic: str
    warn: Callable[[str], None]
    period: float = 5.0
    """Minimum time (s) between two warnings for the same reason; 0 for no limit."""
    messages: int = 0
    last: int | None = None
    """Time of the last message (ns)."""
    heard: float = 0.0
    """Steady time of the last message (s)."""
    refused: Counter[str] = field(default_factory=Counter)
    doubted: Counter[str] = field(default_factory=Counter)
    """Items that are used although something is wrong with them."""
    sender: int = 0
    """The sender of the present message, see ``inputs.senders``."""
    unreadable: dict[int, str] = field(default_factory=dict)
    """By sender, why its last message could not be read: its content is unknown."""
    missed: Missed | None = None
    """Where changes were lost that nothing has made good since."""
    ignored: int | None = None
    """Of the last cloud: points that are not finite; None where it was not used."""
    last_cloud: dict[str, int] = field(default_factory=dict)
    """Of the last cloud of a source: its points, those left out by reason, those used."""
    superseded: int = 0
    """States and complete sets that newer ones replaced before a cycle used them."""
    lost: int = 0
    """Messages that the middleware dropped, because more came than its queue holds."""
    mismatches: int = 0
    """Publishers and subscribers seen with incompatible QoS."""
    steady: Callable[[], float] = time.monotonic
    """The clock of ``heard`` and of warnings, as a simulation clock may pause or jump."""
    _seen: tuple[int, int, int] = (0, 0, 0)
    _unwarned: dict[str, tuple[int, str]] = field(default_factory=dict)
    _warned: dict[str, float] = field(default_factory=dict)  # when

    def received(self, now: int) -> None:
        """Count a message that was received at ``now`` (ns)."""
        self.messages += 1
        self.last, self.heard = now, self.steady()
        if self.sender >= 0:  # else it is one of several
            self.unreadable.pop(self.sender, None)

    def mark_unreadable(self, reason: str, sender: int | None = None) -> None:
        """Note that a message could not be read, by default the one that is being taken."""
        self.unreadable[self.sender if sender is None else sender] = reason

    def lose(self, count: int, now: int | None) -> None:
        """Count messages lost before the next one.

        now: when (ns) changes of objects were lost, None if no change was.
        """
        self.lost += count
        if now is not None:
            self.missed = Missed(self.messages + 1, now)

    def refuse_whole(self, reason: str, detail: str = "", sender: int | None = None) -> None:
        """Count a message that could not be read: its content is unknown."""
        self.mark_unreadable(reason, sender)
        self.refuse(reason, "whole message", detail)

    def refuse(self, reason: str, item: str = "", detail: str = "", count: int = 1) -> None:
        """Count refused items, and warn if there was no warning for this reason lately."""
        self._count(self.refused, "refused", reason, item, detail, count)

    def refuse_rows(
        self, rows: Mask, reason: str, name: Callable[[int], str] | None = None, detail: str = ""
    ) -> None:
        """Count the refused items, True in rows (n,), and name the first one."""
        if rows.any():
            item = "" if name is None else name(int(np.argmax(rows)))
            self.refuse(reason, item, detail, int(np.count_nonzero(rows)))

    def doubt(self, reason: str, item: str = "", detail: str = "", count: int = 1) -> None:
        """Count doubtful items, which are used; warn as for refused ones."""
        self._count(self.doubted, "doubtful", reason, item, detail, count)

    def _count(
        self, counter: Counter[str], verb: str, reason: str, item: str, detail: str, count: int
    ) -> None:
        if reason not in counter and len(counter) >= MAX_REASONS:
            reason = "other"
        counter[reason] += count
        what = f"{verb} {reason}"
        last = " ".join(part for part in (item, f"({detail})" if detail else "") if part)
        held, _ = self._unwarned.get(what, (0, ""))
        self._unwarned[what] = held + count, last
        self._warn(what)

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns): the age of the last message is unchanged."""
        if self.last is not None:
            self.last += shift
        if self.missed is not None:
            self.missed = self.missed._replace(time=self.missed.time + shift)

    def cleared(self) -> None:
        """Forget unreadable and lost messages: all objects were removed."""
        self.unreadable.clear()
        self.missed = None

    def flush(self) -> None:
        """Log the pending warnings that are due."""
        for what in list(self._unwarned):
            self._warn(what)

    def _warn(self, what: str) -> None:
        now = self.steady()
        if now - self._warned.get(what, float("-inf")) >= self.period:
            count, last = self._unwarned.pop(what)
            self._warned[what] = now
            self.warn(f"{self.topic}: {what}: {count}" + (f"; last: {last}" if last else ""))

    def since_last_report(self) -> tuple[int, int, int]:
        """Return the numbers of messages, refused and doubtful items since the last call."""
        counts = self.messages, self.refused.total(), self.doubted.total()
        before, self._seen = self._seen, counts
        messages, refused, doubted = (new - old for new, old in zip(counts, before, strict=True))
        return messages, refused, doubted


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
            reason = f"unknown is not a {type(policy).__name__}"
    return SetParametersResult(successful=not reason, reason=reason)


def make_publisher(
    node: Node, kind: type, topic: str, qos: QoSProfile, *, is_watched: bool = True
) -> Publisher:
    """Return a publisher whose QoS parameters change; is_watched: by QosWatch, else by rclpy."""
    return node.create_publisher(
        kind,
        topic,
        copy(qos),  # overrides are written into it
        event_callbacks=PublisherEventCallbacks(use_default_callbacks=not is_watched),
        qos_overriding_options=overridable(),
    )


class QosWatch:
    """Counts endpoints with incompatible QoS by topic, and warns of new ones."""

    def __init__(self, node: Node, warn: Callable[[str], None]) -> None:
        self._node, self._warn = node, warn
        self.reasons: dict[str, list[str]] = {}
        """Why other ends are incompatible, one per end, by topic."""

    def compare(self, ends: Mapping[str, Publisher | Subscription]) -> None:
        """Compare endpoints, by the node's names of their topics, with the other ends."""
        reasons_now = {topic: self._reasons(end) for topic, end in ends.items()}
        for topic, reasons in reasons_now.items():
            if len(reasons) > len(self.reasons.get(topic, ())):
                self._warn(
                    f"{topic}: incompatible QoS or message type, no data exchanged: {reasons[-1]}"
                )
        self.reasons = reasons_now

    def _reasons(self, end: Publisher | Subscription) -> list[str]:
        """Return the reason per other end that is incompatible."""
        topic = end.topic_name
        if isinstance(end, Publisher):
            visible, matched = self._node.count_subscribers(topic), end.get_subscription_count()
        else:
            visible, matched = self._node.count_publishers(topic), end.get_publisher_count()
        if visible <= matched:  # typical, and cheaper than comparing each
            return []
        return list(self._faults(end, topic))

    def _faults(self, end: Publisher | Subscription, topic: str) -> Iterable[str]:
        message: Any = end.msg_type
        package, folder = message.__module__.split(".")[:2]
        kind = f"{package}/{folder}/{message.__name__}"
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
