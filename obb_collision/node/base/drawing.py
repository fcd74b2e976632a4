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


"""What the gate of a base shows: points of sources, points in zones, and the zones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Point32, PolygonStamped
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.typing import Floats
from obb_collision.zones.gate import Decision
from obb_collision.zones.zones import APPROACH, LIMIT, SLOWDOWN, STOP, Zone

COLORS = {
    STOP: (1.0, 0.0, 0.0),
    SLOWDOWN: (1.0, 1.0, 0.0),
    APPROACH: (0.0, 0.5, 1.0),
    LIMIT: (1.0, 0.5, 0.0),
}
"""Of the points in a zone, by its action."""
PLAIN = 1.0, 0.0, 0.0
SIZE = 0.02
"""Metres."""
CORNERS = 32
"""Of the polygon that stands for a circle."""


class Drawing:
    """Publishes markers and polygons; nothing that nobody has subscribed to."""

    def __init__(self, node: Node, frame: str) -> None:
        self._node, self._frame = node, frame
        self._points = node.create_publisher(MarkerArray, "~/collision_points_marker", 1)
        self._triggers = node.create_publisher(MarkerArray, "~/triggering_points", 1)
        self._zones: dict[str, Any] = {}
        """By name of a zone, the publisher of its polygon."""

    def show(self, zone: str, topic: str) -> Any:
        """Return a publisher of a zone, used from now on."""
        self._zones[zone] = self._node.create_publisher(PolygonStamped, topic, 1)
        return self._zones[zone]

    def draw_points(self, points: Mapping[str, Floats], now: int) -> None:
        """Publish the points of sources."""
        if self._points.get_subscription_count():
            markers = [
                self._marker(f"collision_points_{name}", rows * (1.0, 1.0, 0.0), PLAIN, now)
                for name, rows in points.items()
            ]
            self._points.publish(MarkerArray(markers=markers))

    def draw_zones(self, zones: Iterable[Zone], decision: Decision, now: int) -> None:
        """Publish zones, and the points that made one act."""
        for zone in zones:
            if zone.name in self._zones and zone.outline is not None:
                corners, radius = zone.outline
                if len(corners) == 0:
                    angles = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
                    corners = radius * np.column_stack([np.cos(angles), np.sin(angles)])
                message = PolygonStamped()
                message.header.frame_id, message.header.stamp = self._frame, stamp_to_ros(now)
                message.polygon.points = [Point32(x=x, y=y) for x, y in corners.tolist()]
                self._zones[zone.name].publish(message)
        if self._triggers.get_subscription_count():
            markers = [Marker(action=Marker.DELETEALL)]
            color = COLORS.get(decision.action, PLAIN)
            for name in decision.finding.who:
                rows = decision.finding.points[name]
                markers.append(self._marker(f"{decision.zone}/{name}", rows, color, now))
            self._triggers.publish(MarkerArray(markers=markers))

    def _marker(self, name: str, points: Floats, color: tuple[float, ...], now: int) -> Marker:
        marker = Marker(ns=name, id=0, type=Marker.POINTS, action=Marker.ADD, frame_locked=True)
        marker.header.frame_id, marker.header.stamp = self._frame, stamp_to_ros(now)
        marker.pose.orientation.w, marker.scale.x, marker.scale.y = 1.0, SIZE, SIZE
        red, green, blue = color
        marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
        return marker
