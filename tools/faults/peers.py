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

"""Programs beside a node: ``python -m tools.faults.peers KIND NAMESPACE``.

``sender`` adds a row of colliding cubes and moves them as fast as it can, ``reader`` subscribes to
what a node publishes, and ``setter`` sets parameters of a node as fast as it can, right and wrong
ones. ``camera`` sees a point at the origin, ``flood`` a room, as fast as it can. Each prints READY
once it is at work, and goes on until it is killed.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from random import Random
from struct import pack
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.clouds import cloud_to_ros, poses_to_ros
from obb_collision.node.messages.conversions import NANOSECONDS, pose_to_ros, stamp_to_ros
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.topics.topics import TOPICS
from obb_collision.typing import Floats

READY = "at work"
BURST, COUNT = "burst", 500
"""Namespace of the cubes of a sender, and how many there are."""
STEP = 0.75
"""Distance of two cubes (m), whose edges are 1 m."""
FAR = 1000.0
"""Where they are (m, y), so that nothing else collides with them."""
CHOICES: dict[str, tuple[Any, ...]] = {
    "padding": (0.0, -1.0, float("nan"), "x"),
    "object_timeout": (0.0, -1.0, True),
    "rate": (50.0, -1.0, 1e308, "fast"),
    "max_pairs": (10000, 0, -5, 1.5),
    "allowed_pairs": ([""], ["nobody/1 nobody/2"], ["x"], 3),
    "accuracy": ("obb", "exact", 7),
}
"""Values that a setter sets: such as change nothing about the probe, and wrong ones."""


CAMERA = "camera"
SENSOR_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
CAMERA_PERIOD = 0.05
"""Seconds between two clouds."""
PIXELS = 640 * 480


def cloud_at(points: Floats, stamp: float, frame: str = "map") -> PointCloud2:
    """Return a cloud of points (n, 3) as of depth cameras, 16 bytes each; stamp: seconds."""
    rows = np.zeros(len(points), [(name, "<f4") for name in ("x", "y", "z", "rgb")])
    for column, axis in enumerate("xyz"):
        rows[axis] = points[:, column]
    return cloud_to_ros(
        rows, Header(frame_id=frame, stamp=stamp_to_ros(round(stamp * NANOSECONDS)))
    )


def look(node: Node) -> Callable[[], None]:
    """Publish clouds of one point at the origin, 20 a second."""
    publisher = node.create_publisher(PointCloud2, CAMERA, SENSOR_QOS)

    def step() -> None:
        publisher.publish(cloud_at(np.zeros((1, 3)), time.time()))
        time.sleep(CAMERA_PERIOD)

    return step


def flood(node: Node) -> Callable[[], None]:
    """Publish clouds of a room far away, 4.9 MB each."""
    publisher = node.create_publisher(PointCloud2, CAMERA, SENSOR_QOS)
    points = np.random.default_rng(1).uniform(FAR, FAR + 5.0, (PIXELS, 3))
    data = bytearray(serialize_message(cloud_at(points, 0.0)))

    def step() -> None:
        data[4:12] = pack("<iI", *divmod(time.time_ns(), NANOSECONDS))
        publisher.publish(bytes(data))

    return step


def cube(key: tuple[str, int], position: Iterable[float], stamp: float = 0.0) -> Marker:
    """Return a marker of a unit cube."""
    marker = Marker(
        ns=key[0], id=key[1], type=Marker.CUBE, pose=pose_to_ros((*position, 0, 0, 0, 1))
    )
    marker.header.frame_id = "map"
    marker.header.stamp = stamp_to_ros(round(stamp * NANOSECONDS))
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    return marker


def send(node: Node) -> Callable[[], None]:
    """Publish markers, poses in bulk, and poses one by one."""
    markers = node.create_publisher(MarkerArray, "objects", 10)
    poses = node.create_publisher(PointCloud2, "object_poses", 10)
    row = [cube((BURST, number), (STEP * number, FAR, 0.0)) for number in range(COUNT)]
    message, header = MarkerArray(markers=row), Header(frame_id="map")
    rows = np.zeros((COUNT, 7))
    rows[:, 0], rows[:, 1], rows[:, 6] = STEP * np.arange(COUNT), FAR, 1.0
    numbers, random = [namespace_number(BURST)] * COUNT, np.random.default_rng(1)

    def step() -> None:
        markers.publish(message)
        for _ in range(20):
            moved = rows.copy()
            moved[:, 2] = random.uniform(0.0, 0.1)
            poses.publish(poses_to_ros(range(COUNT), moved, numbers, header))

    return step


def read(node: Node) -> Callable[[], None]:
    """Subscribe to all that a node publishes, with queues that are never full."""
    for topic in TOPICS.values():
        name = topic.name.replace("~", "obb_collision")
        node.create_subscription(topic.message, name, lambda message: None, 1000, raw=True)
    return lambda: rclpy.spin_once(node, timeout_sec=0.1)


def set_parameters(node: Node) -> Callable[[], None]:
    """Set parameters, 20 in each request."""
    client = node.create_client(SetParameters, "obb_collision/set_parameters")
    client.wait_for_service()
    random = Random(1)

    def change() -> ParameterMessage:
        name = random.choice(list(CHOICES))
        return Parameter(name, value=random.choice(CHOICES[name])).to_parameter_msg()

    def step() -> None:
        request = SetParameters.Request(parameters=[change() for _ in range(20)])
        done = client.call_async(request)
        rclpy.spin_until_future_complete(node, done, timeout_sec=5.0)

    return step


KINDS = {
    "sender": send, "reader": read, "setter": set_parameters, "camera": look, "flood": flood,
}  # fmt: skip


def main(kind: str, namespace: str) -> None:
    """Work until the process is interrupted.

    By Python, between two calls: rclpy's handler ends the context in the middle of a step, which
    then raises, or not.
    """
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    step = KINDS[kind](rclpy.create_node(kind, namespace=namespace))
    step()
    sys.stdout.write(f"{READY}\n")
    sys.stdout.flush()
    while True:
        step()


if __name__ == "__main__":
    main(*sys.argv[1:])
