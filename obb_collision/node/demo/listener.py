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

"""The demo's user side: hears ``collisions`` and tells which pairs begin and end, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node import collisions_from_ros, named_pairs
from obb_collision.node.conversions import (
    NANOSECONDS,
    FloatArray,
    name_from_key,
    pose_from_ros,
    stamp_from_ros,
)
from obb_collision.node.demo.hearing import Hearing
from obb_collision.node.demo.publisher import LATCHED
from obb_collision.node.errors import RefusedError

Pair = tuple[str, str]

#: Metres: what is less deep rests on the other. Far above rounding, far below what can be seen.
TOUCH_DEPTH = 1e-6


def told(pair: Pair, depth: float) -> str:
    """Return a pair and its depth for people."""
    deep = "touching" if depth < TOUCH_DEPTH else f"{1e3 * depth:.0f} mm"
    return f"{pair[0]} – {pair[1]}  {deep}"  # noqa: RUF001 - an en dash, as in print


class CollisionListener(Node):
    """Follows the pairs. ``tell`` gets a line for each that begins or ends.

    start: stamp (ns) before which nothing counts; epoch: that from which times are told.
    pairs: the last message, depth (m) by pair. seen: every pair ever. latencies: seconds from the
    stamp of a state to its collisions, once for each stamp. cycles: messages received.
    boxes: pose (7,) and edge lengths by name, once they are watched. effects: what is heard of
    those asked for.
    """

    def __init__(
        self, tell: Callable[[str], None], effects: Iterable[str] = (), **node_options: Any
    ) -> None:
        super().__init__("listener", **node_options)
        self._tell = tell
        self._names: DiagnosticStatus | None = None
        self.stamp, self.start, self.epoch = -1, 0, 0
        self.cycles, self.most = 0, 0
        self.pairs: dict[Pair, float] = {}
        self.points: FloatArray = np.empty((0, 3))
        self.seen: set[Pair] = set()
        self.latencies: list[float] = []
        self.boxes: dict[str, tuple[FloatArray, tuple[float, float, float]]] = {}
        self.boxes_stamp = -1
        self.create_subscription(DiagnosticStatus, "namespaces", self._take_names, LATCHED)
        self.create_subscription(PointCloud2, "collisions", self._take, QoSProfile(depth=10))
        self.effects = Hearing(self, effects, self.seconds_of, tell, lambda: self._names)

    @property
    def matched(self) -> bool:
        """Whether somebody publishes what this listens to."""
        return self.count_publishers("collisions") > 0 and self._names is not None

    def seconds_of(self, stamp: int) -> float:
        """Return the demo's time (s) of a stamp (ns)."""
        return max(0, stamp - self.epoch) / NANOSECONDS

    def watch_boxes(self, topic: str) -> None:
        """Take the marker boxes of a topic from now on, into ``boxes`` and ``boxes_stamp``."""
        self.create_subscription(MarkerArray, topic, self._take_boxes, QoSProfile(depth=1))

    def _take_boxes(self, message: MarkerArray) -> None:
        self.boxes = {
            name_from_key((m.ns, m.id)): (pose_from_ros(m.pose), (m.scale.x, m.scale.y, m.scale.z))
            for m in message.markers
            if m.type == Marker.CUBE and m.action == Marker.ADD
        }
        if message.markers:
            self.boxes_stamp = max(stamp_from_ros(m.header.stamp) for m in message.markers)

    def _take_names(self, message: DiagnosticStatus) -> None:
        self._names = message

    def _take(self, message: PointCloud2) -> None:
        now = self.get_clock().now().nanoseconds
        stamp = stamp_from_ros(message.header.stamp)
        if stamp < self.start or self._names is None:
            return
        try:
            pairs = {(a, b): depth for a, b, depth, _ in named_pairs(message, self._names)}
        except RefusedError:
            return  # a new namespace, whose message is under way; the next cycle has it
        if stamp > self.stamp:
            self.latencies.append((now - stamp) / NANOSECONDS)
        rows = collisions_from_ros(message)
        self.points = np.column_stack([rows[axis].astype(np.float64) for axis in "xyz"])
        self.cycles += 1
        self._compare(pairs, self.seconds_of(stamp))
        self.stamp, self.pairs = stamp, pairs
        self.seen.update(pairs)
        self.most = max(self.most, len(pairs))

    def _compare(self, pairs: dict[Pair, float], seconds: float) -> None:
        for pair, depth in pairs.items():
            if pair not in self.pairs:
                self._tell(f"{seconds:8.3f} s  begins  {told(pair, depth)}")
        for pair in self.pairs:
            if pair not in pairs:
                self._tell(f"{seconds:8.3f} s  ends    {pair[0]} – {pair[1]}")  # noqa: RUF001
