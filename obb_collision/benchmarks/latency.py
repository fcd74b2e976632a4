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


"""Measures the time from the publication of poses to the collisions received, in one process.

The console script ``obb_collision_latency``: moving boxes, real topics, every sample the time from
just before ``publish`` to the callback that has the pairs of exactly that state.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from time import perf_counter

import numpy as np
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.cli import MAX_SEED, Parser, interruptible, option, real, whole
from obb_collision.node.messages.bulk_clouds import poses_to_ros
from obb_collision.node.messages.conversions import (
    NANOSECONDS,
    pose_to_ros,
    stamp_from_ros,
    stamp_to_ros,
)
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.node import CollisionNode
from obb_collision.typing import Floats

FRAME = "map"
BOXES = "box"
"""Namespace of the boxes."""
HALF_EXTENTS = (0.05, 0.5)
"""Smallest and largest half extent of the random boxes (m)."""
ROOM_PER_OBJECT = 1.6
"""Cubic metres of space per object: gives about half a colliding pair per object."""
STEP = 0.02
"""Maximum displacement of a box between two samples (m)."""
WARM_SAMPLES = 20
"""Samples not counted: the first cycles load code and grow buffers."""
PATIENCE = 10.0
"""Seconds to wait for discovery or for an answer before giving up."""
LARGEST_DOMAIN = 100


class Latency:
    """A collision node and a client in one context on one executor."""

    def __init__(self, objects: int, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._context = Context()
        # a domain of its own: another node on this machine must not answer
        self._context.init(domain_id=1 + os.getpid() % LARGEST_DOMAIN)
        overrides = [
            Parameter("fixed_frame", value=FRAME),
            Parameter("trigger", value="arrival"),
            Parameter("min_period", value=0.0),
            Parameter("rate", value=1.0),
        ]
        self._checker = CollisionNode(context=self._context, parameter_overrides=overrides)
        self._client = Node("latency", context=self._context)
        self._objects = self._client.create_publisher(MarkerArray, "objects", 10)
        self._poses = self._client.create_publisher(PointCloud2, "object_poses", 10)
        self._client.create_subscription(PointCloud2, "collisions", self._take, 10)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._checker)
        self._executor.add_node(self._client)
        self._answered, self._pairs, self._time = 0, 0, 0.0
        self._half_extents = self._random.uniform(*HALF_EXTENTS, (objects, 3))
        side = (ROOM_PER_OBJECT * objects) ** (1.0 / 3.0)
        self._given = self._random.normal(size=(objects, 7))
        self._given[:, :3] = self._random.uniform(0.0, side, (objects, 3))

    def _take(self, message: PointCloud2) -> None:
        self._time = perf_counter()
        self._answered = stamp_from_ros(message.header.stamp)
        self._pairs = message.width

    def _spin_until(self, reached: object) -> None:
        limit = perf_counter() + PATIENCE
        while not reached():  # type: ignore[operator]
            if perf_counter() > limit:
                raise TimeoutError("no answer from the collision node")
            self._executor.spin_once(timeout_sec=0.1)

    def _add_objects(self) -> None:
        message = MarkerArray()
        for number, (pose, half) in enumerate(zip(self._given, self._half_extents, strict=True)):
            marker = Marker(ns=BOXES, id=number, type=Marker.CUBE, pose=pose_to_ros(pose))
            marker.header.frame_id = FRAME
            marker.scale.x, marker.scale.y, marker.scale.z = (2.0 * half).tolist()
            message.markers.append(marker)
        self._objects.publish(message)

    def _sample(self, number: int) -> float:
        self._given[:, :3] += self._random.uniform(-STEP, STEP, (len(self._given), 3))
        stamp = number * NANOSECONDS
        header = Header(stamp=stamp_to_ros(stamp), frame_id=FRAME)
        ids = np.arange(len(self._given))
        namespaces = np.full_like(ids, namespace_number(BOXES))
        message = poses_to_ros(ids, self._given, namespaces, header)
        start = perf_counter()
        self._poses.publish(message)
        self._spin_until(lambda: self._answered == stamp)
        return self._time - start

    def measure(self, seconds: float) -> tuple[Floats, float]:
        """Sample for ``seconds``; returns the samples (n,) in seconds and the mean of pairs."""
        self._spin_until(
            lambda: (
                self._client.count_subscribers("object_poses") > 0
                and self._poses.get_subscription_count() > 0
                and self._objects.get_subscription_count() > 0
                and self._client.count_publishers("collisions") > 0
            )
        )
        self._add_objects()
        self._spin_until(lambda: len(self._checker.objects.table) == len(self._given))
        samples, pairs, number = [], [], 0
        limit = perf_counter() + seconds
        while perf_counter() < limit or number <= WARM_SAMPLES:
            number += 1
            samples.append(self._sample(number))
            pairs.append(self._pairs)
        return np.array(samples[WARM_SAMPLES:]), float(np.mean(pairs[WARM_SAMPLES:]))

    def close(self) -> None:
        """Take the nodes down."""
        self._executor.shutdown()
        self._client.destroy_node()
        self._checker.destroy_node()
        self._context.try_shutdown()


@interruptible("obb_collision_latency")
def main(args: Sequence[str] | None = None) -> int:
    """Run the console script ``obb_collision_latency``."""
    parser = Parser(
        prog="obb_collision_latency", description=__doc__.splitlines()[0] if __doc__ else None
    )
    option(parser, "--objects", whole(1, 20000), 1000, "number of moving boxes")
    option(parser, "--seconds", real(0.1, 86400.0), 10.0, "duration of the measurement")
    option(parser, "--seed", whole(0, MAX_SEED), 1, "seed of the random scene")
    options = parser.parse_args(args)
    latency = Latency(options.objects, options.seed)
    try:
        samples, pairs = latency.measure(options.seconds)
    finally:
        latency.close()
    median, p95, p99 = np.percentile(1e3 * samples, (50, 95, 99))
    print(
        f"{options.objects} boxes, all moving, {pairs:.0f} colliding pairs, {len(samples)} cycles"
    )
    print("publish object_poses to collisions received, one process (ms):")
    print(f"  median {median:.2f}  p95 {p95:.2f}  p99 {p99:.2f}  max {1e3 * samples.max():.2f}")
    return 0
