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

"""The subscriptions of the node: types, depths, QoS that a parameter can change."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import count
from time import monotonic, time_ns
from typing import Any, NamedTuple

from geometry_msgs.msg import TransformStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from visualization_msgs.msg import MarkerArray

from obb_collision.node.diagnostics.monitors import InputMonitor, overridable
from obb_collision.node.inputs.senders import ALONE, Senders
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.node.runtime.inner import with_publishers


class Input(NamedTuple):
    """An input topic: type and depth of its queue, and whether it is reliable."""

    kind: type
    depth: int
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
    is_query: bool = False
    """Whether its messages ask for something, and say nothing about objects."""
    is_change: bool = False
    """Whether messages are changes, which are not sent again: a lost one leaves objects unknown."""
    meaning: str = ""
    """Its description in docs/topics.md."""


INPUTS = {
    # Markers and single poses are for different objects, so more of them wait; the bulk messages
    # overtake themselves.
    "objects": Input(
        MarkerArray,
        2000,
        is_change=True,
        meaning="Adds, changes and deletes objects. A marker with an unchanged shape updates the "
        "pose.",
    ),
    "object_transform": Input(
        TransformStamped,
        1000,
        is_change=True,
        meaning="Pose of one object; child_frame_id is its name.",
    ),
    "object_states": Input(
        MultiDOFJointState,
        10,
        meaning="Poses and optional twists of many objects; joint_names are their names.",
    ),
    "object_poses": Input(
        PointCloud2,
        10,
        meaning="Poses of many objects: fields id, ns (optional with one namespace), x y z (m), "
        "qx qy qz qw.",
    ),
    "object_boxes": Input(
        PointCloud2,
        10,
        meaning="Complete set of boxes of this topic: the fields of object_poses, and size_x "
        "size_y size_z (edge lengths, m).",
    ),
    # As drivers of sensors send: a reliable subscription would receive nothing from them.
    "points": Input(
        PointCloud2,
        1,
        ReliabilityPolicy.BEST_EFFORT,
        meaning="Watched points for points_inside: x y z (m). The newest cloud counts.",
    ),
}


LONGEST = 0.5
"""Time (s) after which no more messages of a topic are taken before a cycle."""


class Subscriptions:
    """Subscribes to inputs, and unsubscribes from those that are not needed.

    Messages are received serialised: see ``messages/cdr``.

    callbacks, monitors: of each topic; arrived: called with a topic once a message is stored; now:
    time of the node's clock (ns).
    """

    def __init__(
        self,
        node: Node,
        topics: Mapping[str, Input],
        callbacks: Mapping[str, Callable[[bytes], None]],
        monitors: Mapping[str, InputMonitor],
        arrived: Callable[[str], None],
        now: Callable[[], int],
    ) -> None:
        self._node, self._topics, self._callbacks = node, topics, callbacks
        self._monitors, self._arrived, self._now = monitors, arrived, now
        self.reports = {t: m for t, m in monitors.items() if not topics[t].is_query}
        """The monitors of inputs that can change what collides, by topic."""
        self._oldest = 0
        self.senders: dict[str, Senders] = {}
        """Of each topic that was subscribed to."""
        self._numbers = count(1)
        self._closed: set[str] = set()  # to be subscribed to again
        self.open: dict[str, Subscription] = {}
        """By topic, as the node names it."""

    def keep(self, topic: str, wanted: bool) -> None:
        """Subscribe to a topic if it is wanted, else unsubscribe."""
        if wanted and topic not in self.open:
            self.open[topic] = self._subscribe(topic)
        elif not wanted and topic in self.open:
            self._node.destroy_subscription(self.open.pop(topic))
        elif not wanted:
            self._closed.discard(topic)

    def close(self) -> None:
        """Unsubscribe from all."""
        for topic in [*self.open, *self._closed]:
            self.keep(topic, False)

    def drain(self) -> None:
        """Take all messages that wait, up to the depth of each topic.

        The executor takes one of each topic in a round, with a cycle in between where cycles take
        long: a backlog would grow until messages are lost. Of a topic whose messages take long
        themselves, what still waits after LONGEST comes behind the next cycle.
        """
        failures = []
        for topic in (*self.open, *self._closed):
            try:
                self._closed.discard(topic)
                self.keep(topic, True)
                self._drain(topic, self.open[topic])
            except Exception as error:
                failures.append(error)
                self._monitors[topic].mark_unreadable(INTERNAL_ERROR, ALONE)
                self._give_up(topic)
        if failures:
            raise failures[0]

    def _drain(self, topic: str, subscription: Subscription) -> None:
        end = monotonic() + LONGEST
        with subscription.handle:
            for _ in range(subscription.qos_profile.depth):
                taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                if taken is None:
                    self.senders[topic].emptied()
                    break
                message, info = taken
                self._store(topic, message, info, is_awaited=False)
                if monotonic() > end:
                    break

    def _give_up(self, topic: str) -> None:
        """Drop the messages in a queue, and subscribe anew next time.

        A message that cannot be taken, for which there is no memory, stays at the head of its queue
        and would hide all after it.
        """
        if self._node.context.ok():
            self.keep(topic, False)
            self._closed.add(topic)

    def take_wait(self) -> float:
        """Return for how long (s) the oldest message has waited that was taken since the last time.

        From its receipt by the middleware on; 0 if there was none.
        """
        oldest, self._oldest = self._oldest, 0
        return max(1, time_ns() - oldest) * 1e-9 if oldest else 0.0

    def _store(
        self, topic: str, message: bytes, info: Mapping[str, Any], is_awaited: bool = True
    ) -> None:
        """Store a message; is_awaited: whether a cycle may begin for it."""
        monitor = self._monitors[topic]
        if ALONE in monitor.unreadable and self.open[topic].get_publisher_count() <= 1:
            del monitor.unreadable[ALONE]  # of a queue that could not be read: it is this sender's
        monitor.sender, lost = self.senders[topic].note_message(info)
        if lost:
            monitor.lose(lost, self._now() if self._topics[topic].is_change else None)
        received = info.get("received_timestamp") or 0  # not given by some middlewares
        if received and (received < self._oldest or not self._oldest):
            self._oldest = received
        self._callbacks[topic](message)
        if is_awaited:
            self._arrived(topic)

    def _subscribe(self, topic: str) -> Subscription:
        kind, depth, reliability, durability = self._topics[topic][:4]
        qos = QoSProfile(depth=depth, reliability=reliability, durability=durability)
        with with_publishers():
            subscription = self._node.create_subscription(
                kind,
                topic,
                partial(self._store, topic),
                qos,
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),  # QosWatch
                qos_overriding_options=overridable(),
                raw=True,
            )
        self._monitors[topic].topic = subscription.topic_name
        if topic not in self.senders:
            self.senders[topic] = Senders(
                subscription.qos_profile.depth,
                lambda: self.open[topic].get_publisher_count(),
                lambda: self._gids(self.open[topic].topic_name),
                self._numbers,
            )
        return subscription

    def _gids(self, topic: str) -> Iterator[bytes]:
        """Yield the gids of the publishers of a topic."""
        for info in self._node.get_publishers_info_by_topic(topic):
            yield bytes(info.endpoint_gid)
