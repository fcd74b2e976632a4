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

"""Measures the time from the publication of objects to the collisions received, in one process.

``python -m tools.latency``: boxes that move, by each input for many objects, and
frames of boxes with other ids each time. Real topics; every sample is the time from just before
``publish`` to the callback that has the pairs of exactly that state. Markers are serialised before.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.benchmarks.measuring import as_text
from obb_collision.cli import SEED, Parser, interruptible, option, real, whole
from obb_collision.node.messages.box_markers import MarkerArrayWriter
from obb_collision.node.messages.clouds import boxes_to_ros, poses_to_ros
from obb_collision.node.messages.conversions import NANOSECONDS, stamp_from_ros, stamp_to_ros
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.node import CollisionNode
from obb_collision.typing import Floats
from tools.fuzz.process import own_domain
from tools.pages import table_of

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
GLANCE = 0.002
"""Seconds that an executor waits before the other one gets its turn."""
FRAME_PERIOD = 0.05
"""Seconds between two frames of perception; markers with a lifetime live for two."""


class Measured(NamedTuple):
    """Latencies of an input: samples (n,) in seconds, and the mean number of pairs."""

    way: str
    objects: int
    samples: Floats
    pairs: float

    @property
    def row(self) -> dict[str, Any]:
        """The figures, times in milliseconds."""
        median, p95, p99 = np.percentile(1e3 * self.samples, (50, 95, 99)).round(3).tolist()
        figures = {"median": median, "95 %": p95, "99 %": p99}
        longest = round(1e3 * float(self.samples.max()), 3)
        named = {"way": self.way, "objects": self.objects, "pairs": round(self.pairs)}
        return named | figures | {"longest": longest, "samples": len(self.samples)}


class Hall:
    """Boxes that move in a hall. length: how many times longer than wide and high it is."""

    def __init__(self, objects: int, seed: int, length: float = 1.0) -> None:
        self._random = np.random.default_rng(seed)
        side = (ROOM_PER_OBJECT * objects / length) ** (1.0 / 3.0)
        self.size = np.array([length * side, side, side])
        self.sizes = 2.0 * self._random.uniform(*HALF_EXTENTS, (objects, 3))
        self.poses = self._random.normal(size=(objects, 7))
        self.poses[:, :3] = self._random.uniform(0.0, 1.0, (objects, 3)) * self.size
        self.poses[:, 3:] /= np.linalg.norm(self.poses[:, 3:], axis=1, keepdims=True)

    def move(self) -> Floats:
        """Move all boxes a little; return their poses (n, 7)."""
        self.poses[:, :3] += self._random.uniform(-STEP, STEP, (len(self.poses), 3))
        return self.poses

    def message(self, number: int, first: int = 0, sized: bool = True) -> PointCloud2:
        """Return the poses of all boxes, with sizes or without. number: seconds of the stamp."""
        header = Header(stamp=stamp_to_ros(number * NANOSECONDS), frame_id=FRAME)
        ids = np.arange(first, first + len(self.poses))
        numbers = np.full(len(ids), namespace_number(BOXES))
        if sized:
            return boxes_to_ros(ids, self.poses, self.sizes, numbers, header)
        return poses_to_ros(ids, self.poses, numbers, header)


class Latency:
    """A collision node and a client in one context, each on an executor of its own."""

    def __init__(self, seed: int = 1) -> None:
        self._seed = seed
        self._context = Context()
        self._context.init(domain_id=own_domain())
        overrides = [
            Parameter("fixed_frame", value=FRAME),
            Parameter("trigger", value="arrival"),
            Parameter("min_period", value=0.0),
            Parameter("rate", value=1.0),
        ]
        self._checker = CollisionNode(context=self._context, parameter_overrides=overrides)
        self._client = Node("latency", context=self._context)
        kinds = {"objects": MarkerArray, "object_poses": PointCloud2, "object_boxes": PointCloud2}
        self._publishers = {
            topic: self._client.create_publisher(kind, topic, 10) for topic, kind in kinds.items()
        }
        self._client.create_subscription(PointCloud2, "collisions", self._take, 10)
        # one each, as in processes of their own: an executor looks at all that its nodes have
        nodes = (self._checker, self._client)
        self._executors = [SingleThreadedExecutor(context=self._context) for _ in nodes]
        for executor, node in zip(self._executors, nodes, strict=True):
            executor.add_node(node)
        self._number, self._answered, self._pairs, self._time = 0, 0, 0, 0.0
        self._first = 0  # id of the first box
        self._hall = Hall(0, seed)

    def _take(self, message: PointCloud2) -> None:
        self._time = perf_counter()
        self._answered = stamp_from_ros(message.header.stamp)
        self._pairs = message.width

    def _spin_until(self, reached: Callable[[], object]) -> None:
        limit = perf_counter() + PATIENCE
        while not reached():
            if perf_counter() > limit:
                raise TimeoutError("no answer from the collision node")
            for executor in self._executors:
                executor.spin_once(timeout_sec=GLANCE)

    @property
    def _ids(self) -> range:
        return range(self._first, self._first + len(self._hall.poses))

    def _markers(self, deleted: Iterable[tuple[int, int]] = (), lifetime: float = 0.0) -> bytes:
        """Return all boxes as markers; deleted: ids and actions that come before them."""
        writer = MarkerArrayWriter(FRAME, self._number * NANOSECONDS, lifetime)
        for number, action in deleted:
            writer.add((BOXES, number), Marker.CUBE, action)
        poses, sizes = self._hall.poses.tolist(), self._hall.sizes.tolist()
        for number, pose, size in zip(self._ids, poses, sizes, strict=True):
            writer.add((BOXES, number), Marker.CUBE, Marker.ADD, pose, size)
        return writer.message()

    def _message(self, way: str) -> Any:
        """Return the next message."""
        if not way.startswith("objects"):
            return self._hall.message(self._number, self._first, way.startswith("object_boxes"))
        if way == "objects, other ids by DELETEALL":
            return self._markers([(0, Marker.DELETEALL)])
        if way == "objects, other ids by differences":
            gone = range(self._first - len(self._hall.poses), self._first)
            return self._markers([(number, Marker.DELETE) for number in gone])
        return self._markers(lifetime=2.0 * FRAME_PERIOD if "lifetime" in way else 0.0)

    def sample(self, way: str) -> float:
        """Move the boxes once; returns the seconds until their collisions came."""
        self._number += 1
        if OTHER_IDS in way:
            self._first += len(self._hall.poses)
        self._hall.move()
        message, publisher = self._message(way), self._publishers[way.partition(",")[0]]
        stamp = self._number * NANOSECONDS
        start = perf_counter()
        publisher.publish(message)
        node, client = self._executors
        while self._answered != stamp:
            cycles = self._checker.cycle.monitor.total
            node.spin_once()  # a timer wakes it every second
            if self._checker.cycle.monitor.total > cycles:
                client.spin_once(timeout_sec=PATIENCE)
            if perf_counter() - start > PATIENCE:
                raise TimeoutError("no answer from the collision node")
        return self._time - start

    def measure(self, way: str, objects: int, seconds: float) -> Measured:
        """Send boxes by an input of WAYS for seconds; TimeoutError without an answer."""
        publishers = self._publishers.values()
        self._spin_until(lambda: all(p.get_subscription_count() for p in publishers))
        self._spin_until(lambda: self._client.count_publishers("collisions"))
        self._checker.objects.clear()
        self._hall, self._first = Hall(objects, self._seed), 0
        if way == "object_poses":
            self.sample("objects")
        samples: list[float] = []
        pairs: list[int] = []
        limit = perf_counter() + seconds
        while perf_counter() < limit or len(samples) <= WARM_SAMPLES:
            due = perf_counter() + (FRAME_PERIOD if OTHER_IDS in way else 0.0)
            samples.append(self.sample(way))
            pairs.append(self._pairs)
            while perf_counter() < due:
                self._executors[0].spin_once(timeout_sec=max(0.0, due - perf_counter()))
        warm = np.array(samples[WARM_SAMPLES:])
        return Measured(way, objects, warm, float(np.mean(pairs[WARM_SAMPLES:])))

    def close(self) -> None:
        """Take the nodes down."""
        for executor in self._executors:
            executor.shutdown()
        self._client.destroy_node()
        self._checker.destroy_node()
        self._context.try_shutdown()


OTHER_IDS = "other ids"
MOVING = ("object_poses", "object_boxes", "objects")
"""Inputs, by each of which the same boxes move."""
NEW = (
    "object_boxes, other ids",
    "objects, other ids by DELETEALL",
    "objects, other ids by differences",
    "objects, other ids by lifetime",
)
"""Ways to send other boxes in every frame, at 20 Hz."""
WAYS = (*MOVING, *NEW)
SIZES, OTHERS = (100, 1_000, 10_000), 500
"""Numbers of objects that move by each input, and that are others in every frame."""
ALL = (*((way, count) for way in MOVING for count in SIZES), *((way, OTHERS) for way in NEW))
SECONDS = 4.0
"""Seconds of each measurement."""


def measure_all(
    show: Callable[[str], None],
    ways: Sequence[tuple[str, int]] = ALL,
    seconds: float = SECONDS,
    seed: int = 1,
) -> list[dict[str, Any]]:
    """Return a row per way of sending; one in which a frame has no answer has no times."""
    rows: list[dict[str, Any]] = []
    for way, objects in ways:
        show(f"node: {objects:,} by {way}")
        latency = Latency(seed)
        try:
            rows.append(latency.measure(way, objects, seconds).row)
        except TimeoutError:
            rows.append({"way": way, "objects": objects})
        finally:
            latency.close()
    return rows


@interruptible("python -m tools.latency")
def main(args: Sequence[str] | None = None) -> int:
    """Run the measurements of the command line."""
    parser = Parser(
        prog="python -m tools.latency",
        description=__doc__.splitlines()[0] if __doc__ else None,
    )
    text = "numbers of moving boxes"
    parser.add_argument("--objects", type=whole(1, 20000), nargs="+", default=SIZES, help=text)
    option(parser, "--seconds", real(0.1, 86400.0), 5.0, "duration of each measurement")
    option(parser, "--seed", SEED, 1, "seed of the random scene")
    options = parser.parse_args(args)
    ways = [(way, objects) for way in MOVING for objects in options.objects]
    ways += [(way, OTHERS) for way in NEW]
    print("from publish to collisions received, one process, one thread of Python (ms)")
    figures = measure_all(partial(print, file=sys.stderr), ways, options.seconds, options.seed)
    print(as_text(table_of(figures)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
