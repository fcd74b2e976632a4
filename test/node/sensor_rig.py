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

"""A rig with sensors: what tests of sources share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from rig import FRAME, NAMESPACE, RELIABILITY, Rig
from sensor_msgs.msg import LaserScan, PointCloud2, Range
from std_msgs.msg import Header

from obb_collision.node.messages.clouds import cloud_to_ros

Sensors = Mapping[str, Mapping[str, Any]]
KINDS = {"cloud": PointCloud2, "scan": LaserScan, "range": Range}
FRONT = "sources/front/0"


def cloud_of(points: Any, header: Header, kind: str = "<f4") -> PointCloud2:
    """Return a cloud of points (n, 3)."""
    rows = np.zeros(len(points), [(axis, kind) for axis in "xyz"])
    for column, axis in enumerate("xyz"):
        rows[axis] = np.asarray(points, np.float64).reshape(-1, 3)[:, column]
    return cloud_to_ros(rows, header)


def parameters_of(sensors: Sensors) -> dict[str, Any]:
    """Return the parameters of sensors; they arrive surely, and are never stale."""
    given: dict[str, Any] = {"sources": list(sensors)}
    for name, parameters in sensors.items():
        given |= {f"{name}.timeout": 0.0}
        given |= {f"{name}.{key}": value for key, value in parameters.items()}
        topic = parameters.get("topic", name)
        given[f"qos_overrides.{NAMESPACE}/{topic}.{RELIABILITY}"] = "reliable"
    return given


class Sensing(Rig):
    """A rig with sensors."""

    has_true_stamps = True

    def start_sensors(self, sensors: Sensors) -> None:
        self.sensors = {}
        for name, parameters in sensors.items():
            kind, topic = KINDS[parameters.get("type", "cloud")], parameters.get("topic", name)
            self.sensors[name] = self.client.create_publisher(kind, topic, 10)
        self.until(lambda: all(p.get_subscription_count() for p in self.sensors.values()))

    def see(self, points: Any, name: str = "front", frame: str = FRAME, kind: str = "<f4") -> None:
        """Publish a cloud."""
        self.sensors[name].publish(cloud_of(points, self.header(frame), kind))

    def scan(self, ranges: Any, frame: str = FRAME, name: str = "front", **fields: Any) -> None:
        """Publish a scan of a quarter turn."""
        values = {"range_min": 0.1, "range_max": 10.0, "angle_increment": 0.5 * np.pi} | fields
        message = LaserScan(header=self.header(frame), ranges=list(map(float, ranges)), **values)
        self.sensors[name].publish(message)

    def met(self) -> set[str]:
        """Return the names of what collides with the source, by the last state sent."""
        return {name for pair in self.pairs() if FRONT in pair for name in pair if name != FRONT}

    def cut(self, name: str = "front") -> dict[str, int]:
        """Return what was left out of the last cloud."""
        return dict(self.monitor(name).last_cloud)


class SensorRig(Sensing):
    """A node with sensors, by name their parameters."""

    def __init__(self, sensors: Sensors, **options: Any) -> None:
        super().__init__(given=parameters_of(sensors), **options)
        self.start_sensors(sensors)
