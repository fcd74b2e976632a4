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

"""The sensors of the demo on topics: what they measure, and where they are."""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header

from obb_collision.demo.motion import Motions
from obb_collision.demo.sensors import Seen, Sensor, World
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.frames import EXTRAPOLATION, UNKNOWN_FRAME
from obb_collision.typing import Floats

#: A point of a cloud.
POINT_DTYPE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
#: Poses of a frame that are remembered: a node asks for those of the latest messages.
KEPT = 100
NOTHING, NOBODY = np.empty((0, 3)), np.empty(0, np.bool_)


class SensorFrames:
    """Where the frames of sensors are: a node without tf is given them."""

    waits = True
    description = "those of the demo's sensors"

    def __init__(self) -> None:
        self._poses: dict[str, dict[int, Floats]] = {}

    def place(self, frame: str, stamp: int, pose: Floats) -> None:
        """Set the pose (7,) of a frame at a stamp (ns)."""
        poses = self._poses.setdefault(frame, {})
        poses[stamp] = pose
        if len(poses) > KEPT:
            del poses[next(iter(poses))]

    def lookup(self, frame: str, stamp: int) -> tuple[Floats, int]:
        """Return the pose (7,) of a frame at a stamp (ns; 0: the latest), and that stamp."""
        if frame not in self._poses:
            raise RefusedError(UNKNOWN_FRAME, f"{frame!r} is not of a sensor")
        poses = self._poses[frame]
        found = stamp or next(reversed(poses))
        if found not in poses:
            raise RefusedError(EXTRAPOLATION, f"{frame!r} at {stamp}")
        return poses[found], found


def message_of(sensor: Sensor, distances: Floats, header: Header) -> PointCloud2 | LaserScan:
    """Return a message of distances (n,) along the rays, m, infinite where nothing is in range."""
    if sensor.is_scan:
        limits = {"angle_min": -0.5 * sensor.angle, "angle_max": 0.5 * sensor.angle}
        limits |= {"angle_increment": sensor.step, "range_max": sensor.range}
        return LaserScan(header=header, ranges=distances.astype("<f4").tolist(), **limits)
    points = np.where(np.isfinite(distances), distances, np.nan)[:, None] * sensor.rays
    cloud = cloud_to_ros(points.astype("<f4").view(POINT_DTYPE)[:, 0], header)
    cloud.width, cloud.height, cloud.is_dense = sensor.width, sensor.height, False
    cloud.row_step = cloud.point_step * cloud.width
    return cloud


class SensorPublishers:
    """Publishes what the sensors of a scene measure.

    frames: are given their places.
    """

    def __init__(self, node: Node, motions: Motions, frames: SensorFrames) -> None:
        self._frames = frames
        self._seen: dict[str, Seen] = {}
        self._due = dict.fromkeys(motions.sensors, 0.0)
        self._world = World(motions) if self._due else None
        self._publishers: dict[str, Any] = {
            sensor.name: node.create_publisher(
                LaserScan if sensor.is_scan else PointCloud2, sensor.name, QoSProfile(depth=2)
            )
            for sensor in self._due
        }

    def publish(self, time: float, stamp: int, all_of_them: bool = False) -> None:
        """Publish the messages that are due at a time (s), or all, with a stamp (ns)."""
        due = [sensor for sensor, at in self._due.items() if all_of_them or time >= at]
        if not due or self._world is None:
            return
        self._world.place(time)
        for sensor in due:
            self._due[sensor] = max(self._due[sensor] + 1.0 / sensor.rate, time)
            seen = self._seen[sensor.name] = self._world.see(sensor, time)
            self._frames.place(sensor.frame, stamp, seen.pose)
            header = Header(stamp=stamp_to_ros(stamp), frame_id=sensor.frame)
            self._publishers[sensor.name].publish(message_of(sensor, seen.distances, header))

    def seen(self) -> tuple[Floats, Floats]:
        """Return the points (n, 3) that sensors saw last, and those (k, 3) of strangers."""
        points = np.concatenate([NOTHING, *(seen.points for seen in self._seen.values())])
        strange = np.concatenate([NOBODY, *(seen.strange for seen in self._seen.values())])
        return points[~strange], points[strange]
