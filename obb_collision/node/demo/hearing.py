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

"""The demo's ear for effects: subscribes to those that a scene file calls for."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

from obb_collision.node.conversions import stamp_from_ros
from obb_collision.node.demo.followers import EFFECTS
from obb_collision.node.effects import TOPICS
from obb_collision.node.errors import RefusedError


class Hearing:
    """Subscribes to effects and follows them.

    node: the one that listens; seconds_of: the demo's time of a stamp (ns); tell gets each line;
    namespaces: returns the latest table. stamps: of the latest message (ns) by effect, -1 before
    the first.
    """

    def __init__(
        self,
        node: Node,
        effects: Iterable[str],
        seconds_of: Callable[[int], float],
        tell: Callable[[str], None],
        namespaces: Callable[[], Any],
    ) -> None:
        self._seconds_of, self._tell, self._namespaces = seconds_of, tell, namespaces
        self.followers: dict[str, Any] = {name: EFFECTS[name][1]() for name in effects}
        self.stamps = dict.fromkeys(self.followers, -1)
        for name in self.followers:
            take = partial(self._take, name)
            node.create_subscription(PointCloud2, TOPICS[name], take, QoSProfile(depth=10))

    def _take(self, name: str, message: PointCloud2) -> None:
        stamp = stamp_from_ros(message.header.stamp)
        try:
            rows = EFFECTS[name][0](message, self._namespaces() or [])
        except RefusedError:
            return  # a new namespace, whose message is under way; the next cycle has it
        seconds = self._seconds_of(stamp)
        for line in self.followers[name].take(rows, seconds):
            self._tell(f"{seconds:8.3f} s  {line}")
        self.stamps[name] = max(stamp, self.stamps[name])

    def summary(self) -> list[str]:
        """Return the lines that end the demo."""
        return [line for follower in self.followers.values() for line in follower.ends()]
