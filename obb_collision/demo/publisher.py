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

"""The demo's robot side: publishes the scene's objects, their motion and the lidar's points."""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, MultiDOFJointState, PointCloud2
from std_msgs.msg import Header, String
from visualization_msgs.msg import MarkerArray

from obb_collision.demo.scene import DemoScene
from obb_collision.node.messages.clouds import cloud_to_ros, poses_to_ros
from obb_collision.node.messages.conversions import pose_to_ros, stamp_to_ros, states_to_ros
from obb_collision.node.messages.marker_shapes import shape_to_ros
from obb_collision.node.messages.names import namespace_number
from obb_collision.robots.description.urdf import description_text

FRAME = "map"
#: Scans of the lidar per second, Hz.
SCAN_RATE = 10.0
#: A point of ``points``.
POINT_DTYPE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
DESCRIPTIONS = ("robot_description", "robot_description_semantic")
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ScenePublisher(Node):
    """Publishes a scene in motion.

    The objects of a scene file are read by the node itself: only their states are published, poses
    with twists. Others are published as markers, their motion as a cloud of poses.
    node_options go to ``rclpy.node.Node`` (context, namespace...).
    """

    def __init__(self, scene: DemoScene, **node_options: Any) -> None:
        super().__init__("scene", **node_options)
        self.scene = scene
        self._objects: Any = None
        self._points: Any = None
        self._next_scan = 0.0
        depth = QoSProfile(depth=10)
        if scene.file is not None:
            self._motion = self.create_publisher(MultiDOFJointState, "object_states", depth)
        else:
            self._objects = self.create_publisher(MarkerArray, "objects", LATCHED)
            self._motion = self.create_publisher(PointCloud2, "object_poses", depth)
        self._joints = {
            robot.name: self.create_publisher(JointState, f"{robot.name}/joint_states", depth)
            for robot in scene.robots
        }
        self._descriptions = {
            (robot.name, kind): self.create_publisher(String, f"{robot.name}/{kind}", LATCHED)
            for robot in scene.robots
            for kind in DESCRIPTIONS
        }
        if scene.description.lidar is not None:
            self._points = self.create_publisher(PointCloud2, "points", QoSProfile(depth=2))

    @property
    def matched(self) -> bool:
        """Whether the topics of the objects have subscribers."""
        used: list[Any] = [self._motion, *self._joints.values(), *self._descriptions.values()]
        used += [] if self._objects is None else [self._objects]
        return all(publisher.get_subscription_count() > 0 for publisher in used)

    def publish_all(self, time: float) -> int:
        """Publish all objects as they are at a time; returns the stamp (ns)."""
        rows = list(range(len(self.scene.names)))
        return self._publish_states(rows, time) if self.scene.file else self._publish_markers(time)

    def publish_descriptions(self) -> None:
        """Publish URDF and SRDF of the robots."""
        for robot in self.scene.robots:
            texts = description_text(robot.urdf), robot.srdf and robot.srdf.read_text("utf-8")
            for kind, text in zip(DESCRIPTIONS, texts, strict=True):
                if text is not None:
                    self._descriptions[robot.name, kind].publish(String(data=text))

    def publish_joints(self, time: float) -> int | None:
        """Publish the joints of the robots at a time; returns the stamp (ns), None if none."""
        stamp, header = self._header()
        for robot in self.scene.robots:
            values, velocities = (part.tolist() for part in robot.joints(time))
            names = list(robot.robot.joint_names)
            self._joints[robot.name].publish(
                JointState(header=header, name=names, position=values, velocity=velocities)
            )
        return stamp if self.scene.robots else None

    def publish_objects(self, time: float) -> int | None:
        """Publish objects that move as they are at a time; returns the stamp (ns), or None."""
        rows = self.scene.moving
        if not rows:
            return None
        return self._publish_states(rows, time) if self.scene.file else self._publish_poses(time)

    def publish_step(self, time: float) -> None:
        """Publish what moves, and the lidar's points when a scan is due."""
        self.publish_objects(time)
        self.publish_joints(time)
        if time >= self._next_scan:
            self._next_scan = time + 1.0 / SCAN_RATE
            self.publish_points(time)

    def publish_points(self, time: float) -> int | None:
        """Publish what the lidar measures; returns the stamp (ns), None without a lidar."""
        points = self.scene.points(time)
        if points is None:
            return None
        stamp, header = self._header()
        rows = points.astype("<f4").view(POINT_DTYPE)[:, 0]
        self._points.publish(cloud_to_ros(rows, header))
        return stamp

    def _header(self) -> tuple[int, Header]:
        now = self.get_clock().now().nanoseconds
        return now, Header(stamp=stamp_to_ros(now), frame_id=FRAME)

    def _publish_markers(self, time: float) -> int:
        stamp, header = self._header()
        markers = []
        poses = self.scene.states(time)[0]
        for key, shape, pose in zip(
            self.scene.keys, self.scene.shapes.values(), poses, strict=True
        ):
            marker = shape_to_ros(shape)
            marker.header, marker.pose, marker.color.a = header, pose_to_ros(pose), 1.0
            marker.ns, marker.id = key
            markers.append(marker)
        self._objects.publish(MarkerArray(markers=markers))
        return stamp

    def _publish_states(self, rows: list[int], time: float) -> int:
        poses, twists = self.scene.states(time)
        stamp, header = self._header()
        names = [self.scene.names[row] for row in rows]
        self._motion.publish(states_to_ros(names, poses[rows], header, twists[rows]))
        return stamp

    def _publish_poses(self, time: float) -> int:
        rows = self.scene.moving
        keys = [self.scene.keys[row] for row in rows]
        namespaces = np.array([namespace_number(namespace) for namespace, _ in keys])
        ids = np.array([number for _, number in keys])
        stamp, header = self._header()
        poses = self.scene.states(time)[0][rows]
        self._motion.publish(poses_to_ros(ids, poses, namespaces, header))
        return stamp
