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

"""The demo's robot side: publishes the scene. It knows topics and messages, not who listens."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped, Twist, Vector3
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.geometry.shapes import Shape
from obb_collision.node.clouds import cloud_to_ros, poses_to_ros
from obb_collision.node.conversions import (
    pose_to_ros,
    stamp_to_ros,
    states_to_ros,
    transform_to_ros,
)
from obb_collision.node.demo.file_scene import FileScene
from obb_collision.node.demo.scene import DemoScene
from obb_collision.node.marker_shapes import shape_to_ros
from obb_collision.node.names import namespace_number

FRAME = "map"
#: Topics that carry motion, in the order in which a step publishes them.
CHANNELS = ("objects", "object_states", "object_transform", "object_poses")
#: Turns of the lidar per second, Hz.
SCAN_RATE = 10.0
#: A point of ``points``.
POINT_DTYPE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ScenePublisher(Node):
    """Publishes a scene: all objects as markers, then their motion on four topics, then points.

    node_options go to ``rclpy.node.Node`` (context, namespace...).
    """

    def __init__(self, scene: DemoScene | FileScene, **node_options: Any) -> None:
        super().__init__("scene", **node_options)
        self.scene = scene
        self._published: dict[int, tuple[Shape, bytes]] = {}  # shape and pose, by row
        kinds = (MarkerArray, MultiDOFJointState, TransformStamped, PointCloud2)
        # twice the objects may wait: one transform is published for each
        self._topics = {
            topic: self.create_publisher(kind, topic, QoSProfile(depth=10))
            for topic, kind in zip(CHANNELS, kinds, strict=True)
        }
        self._senders = {
            "objects": self._send_changed,
            "object_states": self._send_states,
            "object_transform": self._send_transforms,
            "object_poses": self._send_cloud,
        }
        self._points: Any = None
        self._next_scan = 0.0
        if scene.points(0.0) is not None:
            self._points = self.create_publisher(PointCloud2, "points", QoSProfile(depth=2))

    @property
    def topics(self) -> dict[str, str]:
        """The resolved name of each topic."""
        return {topic: publisher.topic_name for topic, publisher in self._topics.items()}

    @property
    def matched(self) -> bool:
        """Whether every topic has somebody who listens."""
        return all(p.get_subscription_count() > 0 for p in self._topics.values())

    def publish_all(self, time: float) -> int:
        """Publish all objects as they are at a time; returns the stamp (ns).

        Of a scene file only where they are: what they are the checker reads there itself.
        """
        if isinstance(self.scene, FileScene):
            return self._send_states(list(range(len(self.scene.items))), time)
        return self._send_markers(range(len(self.scene.items)), time)

    def publish_step(self, time: float) -> None:
        """Publish all that moves as it is at a time."""
        for channel in CHANNELS:
            self.publish_channel(channel, time)
        if time >= self._next_scan:
            self._next_scan = time + 1.0 / SCAN_RATE
            self.publish_points(time)

    def publish_points(self, time: float) -> int | None:
        """Publish what the scene's sensor sees; returns the stamp (ns), None without a sensor."""
        points = self.scene.points(time)
        if points is None:
            return None
        stamp, header = self._header()
        rows = points.astype("<f4").view(POINT_DTYPE)[:, 0]
        self._points.publish(cloud_to_ros(rows, header))
        return stamp

    def publish_channel(self, channel: str, time: float) -> int | None:
        """Publish what moves by one of CHANNELS; returns its stamp (ns), None if nothing does."""
        rows = self.scene.channel(channel)
        return self._senders[channel](rows, time) if rows else None

    def _header(self) -> tuple[int, Header]:
        now = self.get_clock().now().nanoseconds
        return now, Header(stamp=stamp_to_ros(now), frame_id=FRAME)

    def _send_markers(self, rows: Any, time: float) -> int:
        shapes, poses = self.scene.shapes(time), self.scene.poses(time)
        markers: list[Marker] = []
        for row in rows:
            item = self.scene.items[row]
            self._published[row] = shapes[row], poses[row].tobytes()
            marker = shape_to_ros(shapes[row])
            marker.ns, marker.id, marker.pose = item.namespace, item.id, pose_to_ros(poses[row])
            marker.color.r, marker.color.g, marker.color.b = item.color
            marker.color.a = 1.0
            markers.append(marker)
        stamp, header = self._header()
        for marker in markers:
            marker.header = header
        self._topics["objects"].publish(MarkerArray(markers=markers))
        return stamp

    def _send_changed(self, rows: list[int], time: float) -> int | None:
        """Publish markers of those whose shape or pose is another than last time."""
        shapes, poses = self.scene.shapes(time), self.scene.poses(time)
        new = {row: (shapes[row], poses[row].tobytes()) for row in rows}
        changed = [row for row in rows if new[row] != self._published.get(row)]
        return self._send_markers(changed, time) if changed else None

    def _send_states(self, rows: list[int], time: float) -> int:
        poses = self.scene.poses(time)[rows]
        stamp, header = self._header()
        names = [self.scene.items[row].name for row in rows]
        message = states_to_ros(names, poses, header)
        twists = self.scene.twists(time)
        if twists is not None:
            message.twist = [_twist_to_ros(twist) for twist in twists[rows].tolist()]
        self._topics["object_states"].publish(message)
        return stamp

    def _send_transforms(self, rows: list[int], time: float) -> int:
        poses = self.scene.poses(time)
        for row in rows:
            stamp, header = self._header()
            message = TransformStamped(
                header=header,
                child_frame_id=self.scene.items[row].name,
                transform=transform_to_ros(poses[row]),
            )
            self._topics["object_transform"].publish(message)
        return stamp

    def _send_cloud(self, rows: list[int], time: float) -> int:
        items = [self.scene.items[row] for row in rows]
        poses = self.scene.poses(time)[rows]
        namespaces = np.array([namespace_number(item.namespace) for item in items])
        stamp, header = self._header()
        ids = np.array([item.id for item in items])
        self._topics["object_poses"].publish(poses_to_ros(ids, poses, namespaces, header))
        return stamp


def _twist_to_ros(twist: list[float]) -> Twist:
    linear, angular = (Vector3(x=x, y=y, z=z) for x, y, z in (twist[:3], twist[3:]))
    return Twist(linear=linear, angular=angular)
