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
"""Sensors as objects: clouds, scans and ranges on topics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from each import each
from rig import A1, FRAME, NAMESPACE, RELIABILITY, FakeFrames, Rig, cube, pose
from sensor_msgs.msg import LaserScan, PointCloud2, PointField, Range
from std_msgs.msg import Header

from obb_collision.node.messages.clouds import cloud_to_ros

KINDS = {"cloud": PointCloud2, "scan": LaserScan, "range": Range}
FRONT = "sources/front/0"


class SensorRig(Rig):
    """A rig with sensors: by name their parameters, in short."""

    has_true_stamps = True

    def __init__(self, sensors: Mapping[str, Mapping[str, Any]], **options: Any) -> None:
        given = {"sources": list(sensors)}
        for name, parameters in sensors.items():
            given |= {f"{name}.{key}": value for key, value in parameters.items()}
            given.setdefault(f"{name}.timeout", 0.0)
            topic = parameters.get("topic", name)
            given[f"qos_overrides.{NAMESPACE}/{topic}.{RELIABILITY}"] = "reliable"
        super().__init__(given=given, **options)
        self.sensors = {}
        for name, parameters in sensors.items():
            kind, topic = KINDS[parameters.get("type", "cloud")], parameters.get("topic", name)
            self.sensors[name] = self.client.create_publisher(kind, topic, 10)
        self.until(lambda: all(p.get_subscription_count() for p in self.sensors.values()))

    def see(self, points: Any, name: str = "front", frame: str = FRAME, kind: str = "<f4") -> None:
        """Publish a cloud."""
        rows = np.zeros(len(points), [(axis, kind) for axis in "xyz"])
        for column, axis in enumerate("xyz"):
            rows[axis] = np.asarray(points, np.float64).reshape(-1, 3)[:, column]
        self.sensors[name].publish(cloud_to_ros(rows, self.header(frame)))

    def scan(self, ranges: Any, frame: str = FRAME, **fields: Any) -> None:
        """Publish a scan of a quarter turn."""
        values = {"range_min": 0.1, "range_max": 10.0, "angle_increment": 0.5 * np.pi} | fields
        message = LaserScan(header=self.header(frame), ranges=list(map(float, ranges)), **values)
        self.sensors["front"].publish(message)

    def cut(self, name: str = "front") -> dict[str, int]:
        """Return what was left out of the last cloud."""
        return dict(self.monitor(name).last_cloud)


@pytest.fixture
def front() -> Iterator[SensorRig]:
    """Yield a rig with one cloud, and a cube of one metre."""
    with SensorRig({"front": {}}) as made:
        made.send(cube(A1))
        yield made


def test_a_cloud_collides_by_name_and_is_replaced(front: SensorRig) -> None:
    front.known("unplaced", FRONT)
    front.see([[5, 0, 0], [0.505, 0, 0]])
    assert front.pairs() == {("a/1", FRONT)}
    front.see([[5, 0, 0], [0.52, 0, 0]])
    assert front.pairs() == set(), "the radius is 1 cm"
    front.known()
    front.see([])
    assert front.pairs() == set(), "nothing seen is an answer, too"
    front.known()
