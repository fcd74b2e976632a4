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

"""Plays a user: subscribes to a node's topics and stores the latest message of each, by name.

A narrator per topic makes the lines that the demo prints: ``update`` takes the named rows of a
message and yields lines, ``summary`` yields those at the end. ``rows`` are the latest rows.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision import node
from obb_collision.accuracy import Accuracy
from obb_collision.demo.status import Status
from obb_collision.node import collisions_from_ros, named_pairs
from obb_collision.node.messages.box_markers import COLLIDING, COLORS, DOUBTFUL
from obb_collision.node.messages.cdr import markers_from_bytes
from obb_collision.node.messages.clouds import points_from_ros
from obb_collision.node.messages.conversions import NANOSECONDS, name_from_key, stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_shapes import shape_from_ros
from obb_collision.node.topics.cloud import LATCHED
from obb_collision.node.topics.topics import TOPICS
from obb_collision.shapes import Shape
from obb_collision.typing import Floats

#: The quality with which sensors send points.
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

#: Seconds without a prediction after which the next one of the same pair is printed again.
FORGET = 0.5
#: Fields of a marker that determine its shape.
SHAPE_FIELDS = ("type", "scale", "points", "mesh_resource", "mesh_file")
#: Depth below which objects touch, m: far above rounding, far below what can be seen.
TOUCH_DEPTH = 1e-6


def pair_of(row: Any) -> str:
    """Return the names of a row's objects as text."""
    return f"{row.a} – {row.b}"  # noqa: RUF001 - an en dash, as in print


def is_touching(row: node.NamedPair) -> bool:
    """Return whether objects touch without overlapping; False if the depth is unknown."""
    return row.depth < TOUCH_DEPTH


@dataclass
class Narrator:
    """The latest rows of a topic, and their largest number."""

    rows: list[Any] = field(default_factory=list)
    most: int = 0

    def update(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the rows of a message; yield lines to print."""
        self.rows = rows
        self.most = max(self.most, len(rows))
        yield from ()

    def summary(self) -> Iterator[str]:
        """Yield the lines at the end."""
        yield f"contacts: {len(self.rows)} points at the end, at most {self.most} at once"


@dataclass
class PairsNarrator(Narrator):
    """Prints colliding pairs when they begin and end."""

    seen: set[tuple[str, str]] = field(default_factory=set)

    def update(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the pairs; yield a line for each that begins or ends."""
        before = {row[:2]: row for row in self.rows}
        yield from super().update(rows, seconds)
        now = {row[:2]: row for row in rows}
        self.seen |= now.keys()
        for pair, row in now.items():
            if pair not in before:
                depth = "" if np.isnan(row.depth) else f"  {1e3 * row.depth:.0f} mm"
                yield f"begins  {pair_of(row)}" + ("  touching" if is_touching(row) else depth)
        yield from (f"ends    {pair_of(before[pair])}" for pair in before if pair not in now)

    def summary(self) -> Iterator[str]:
        """Yield how many pairs there were."""
        touching = sum(map(is_touching, self.rows))
        yield (
            f"{len(self.seen)} pairs in all, at most {self.most} at once; at the end "
            f"{len(self.rows)}: {len(self.rows) - touching} overlapping, {touching} touching"
        )


@dataclass
class ClearancesNarrator(Narrator):
    """Prints the minimum distance of near pairs, with pair and time."""

    minimum: list[tuple[float, str, float]] = field(default_factory=list)

    def update(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the distances; yields no lines, as they change all the time."""
        yield from super().update([row for row in rows if row.distance > 0], seconds)
        apart = [(row.distance, pair_of(row), seconds) for row in self.rows]
        self.minimum = sorted([*apart, *self.minimum])[:1]

    def summary(self) -> Iterator[str]:
        """Yield the minimum over all time, and at the end."""
        for distance, pair, seconds in self.minimum:
            yield f"clearance: minimum {1e3 * distance:.1f} mm, {pair}, at {seconds:.1f} s"
        for near in sorted(self.rows, key=lambda row: row.distance)[:1]:
            nearest = f"{1e3 * near.distance:.1f} mm, {pair_of(near)}"
            yield f"clearance at the end: {len(self.rows)} pairs, minimum {nearest}"


@dataclass
class Predictions(Narrator):
    """Prints predicted collisions, and those that passed between two states."""

    last: dict[tuple[str, str], float] = field(default_factory=dict)
    predicted: int = 0
    passed: int = 0

    def update(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the predictions; yield a line for each new or passed one."""
        self.rows = [row for row in rows if row.time >= 0.0 and not row.undecided]
        for row in rows:
            pair = pair_of(row)
            if row.undecided:
                yield f"undecided {pair}  may collide from {row.time:.2f} s on"
            elif row.time < 0.0:
                self.passed += 1
                yield f"passed  {pair}  {-1e3 * row.time:.0f} ms ago, between two states"
            else:
                if seconds - self.last.get((row.a, row.b), -np.inf) > FORGET:
                    self.predicted += 1
                    yield f"predicted {pair}  in {row.time:.2f} s"
                self.last[row.a, row.b] = seconds

    def summary(self) -> Iterator[str]:
        """Yield their number, and the next predictions at the end."""
        yield f"sweep: {self.predicted} collisions predicted, {self.passed} between two states"
        for row in sorted(self.rows, key=lambda row: row.time)[:3]:
            yield f"time to collision at the end: {row.time:.2f} s, {pair_of(row)}"


@dataclass
class PointsInsideNarrator(Narrator):
    """Prints when points enter and leave a zone, and their largest number."""

    max_inside: dict[str, int] = field(default_factory=dict)

    def update(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the counts; yield a line for each zone that points enter or leave."""
        before = self._counts()
        self.rows = rows
        now = self._counts()
        for name, count in now.items():
            self.max_inside[name] = max(self.max_inside.get(name, 0), count)
            if name not in before:
                yield f"entered {name}  {count} points inside"
        for name in sorted(before.keys() - now.keys()):
            yield f"left    {name}"

    def summary(self) -> Iterator[str]:
        """Yield the numbers of points by zone."""
        now = self._counts()
        for name, most in sorted(self.max_inside.items()):
            yield f"points in {name}: {now.get(name, 0)} at the end, at most {most}"

    def _counts(self) -> Counter[str]:
        """Return the points of all clouds in each zone that has any."""
        counts = Counter[str]()
        for row in self.rows:
            counts[row.name] += row.points
        return +counts


def _all_predictions(message: Any, namespaces: Any) -> list[node.NamedPrediction]:
    """Return the rows of ``predicted_collisions``: predictions, and passed collisions."""
    return [
        *node.named_predictions(message, namespaces),
        *node.named_passed_collisions(message, namespaces),
    ]


#: By effect: the function that reads named rows from a message, and the narrator.
NARRATORS: dict[str, tuple[Callable[..., list[Any]], type]] = {
    "contacts": (node.named_contacts, Narrator),
    "clearance": (node.named_clearances, ClearancesNarrator),
    "sweep": (_all_predictions, Predictions),
    "points": (node.named_points_inside, PointsInsideNarrator),
}


Color = tuple[float, float, float]


class MarkerBoxes(NamedTuple):
    """Boxes of n objects: names, poses (n, 7), edge lengths (n, 3), and states by colour.

    colliding (n,); doubtful (n,): stale or refused. lines: ends (2 k, 3) and colour, if the node
    draws edges instead of boxes. frame, stamp (ns): of the message, "" and -1 before the first one.
    """

    names: list[str]
    poses: Floats
    sizes: Floats
    colliding: npt.NDArray[np.bool_]
    doubtful: npt.NDArray[np.bool_]
    lines: list[tuple[Floats, Color]]
    frame: str
    stamp: int

    def without(self, prefix: str) -> MarkerBoxes:
        """Return the boxes but those of names that begin so."""
        kept = [row for row, name in enumerate(self.names) if not name.startswith(prefix)]
        arrays = {
            key: getattr(self, key)[kept] for key in ("poses", "sizes", "colliding", "doubtful")
        }
        return self._replace(names=[self.names[row] for row in kept], **arrays)


NONE = np.empty(0, np.bool_)
NO_BOXES = MarkerBoxes([], np.empty((0, 7)), np.empty((0, 3)), NONE, NONE, [], "", -1)


def boxes_from_bytes(data: bytes) -> MarkerBoxes:
    """Return the boxes of a serialised MarkerArray; RefusedError for other bytes."""
    markers = markers_from_bytes(data)
    if not len(markers):
        return NO_BOXES
    numbers = markers.numbers
    head, body, stamps = numbers["head"], numbers["body"], numbers["stamp"]
    colors = body["color"][:, :3].astype(np.float64)
    added = head["action"] == Marker.ADD
    cubes = np.flatnonzero(added & (head["type"] == Marker.CUBE))
    lines = np.flatnonzero(added & (head["type"] == Marker.LINE_LIST)).tolist()
    namespaces = [markers.text("ns", row).decode(errors="replace") for row in cubes.tolist()]
    colliding, doubtful = (
        np.abs(colors[cubes] - COLORS[state][:3]).max(axis=1, initial=0.0) < 1e-3
        for state in (COLLIDING, DOUBTFUL)
    )
    return MarkerBoxes(
        list(map(name_from_key, zip(namespaces, head["id"][cubes].tolist(), strict=True))),
        body["pose"][cubes],
        body["scale"][cubes],
        colliding,
        doubtful,
        [(markers.points("points", row), tuple(colors[row].tolist())) for row in lines],
        markers.text("frame", 0).decode(errors="replace"),
        int((stamps["sec"].astype(np.int64) * NANOSECONDS + stamps["nanosec"]).max()),
    )


#: Messages kept per topic, until those of other topics with the same stamp arrive; and the age (ns)
#: of the last one of a topic that is no longer sent.
KEPT, STILL = 32, NANOSECONDS


class Pairs(NamedTuple):
    """A message of ``collisions``: its rows, and their places (n, 3), m.

    by_box: names of the objects in pairs that were decided by boxes.
    """

    rows: list[node.NamedPair]
    places: Floats
    by_box: frozenset[str]


NO_PAIRS = Pairs([], np.empty((0, 3)), frozenset())


class Cycle(NamedTuple):
    """The messages of one cycle of a node.

    status: its level and number of pairs agree with the pairs. effects: rows by effect. points: the
    cloud that the rows of the effect ``points`` are about. at: time of arrival (s, steady clock).
    """

    boxes: MarkerBoxes
    pairs: Pairs
    effects: Mapping[str, list[Any]]
    robots: set[str]
    points: Floats
    status: Status
    at: float

    @property
    def agrees(self) -> bool:
        """Whether colours, pairs and level agree: messages of two cycles may have equal stamps."""
        boxes, listed = self.boxes, {name for row in self.pairs.rows for name in row[:2]}
        red = {boxes.names[row] for row in np.flatnonzero(boxes.colliding)}
        if boxes.names and self.pairs is not NO_PAIRS:
            listed &= {*boxes.names}
            if not listed <= red or (red and not listed):
                return False
        return not self.status.level or (self.status.level == "ERROR") == bool(listed or red)


class Listener(Node):
    """Follows the collisions and effects of a node.

    report: prints a line; effects: those to subscribe to; node_options go to ``rclpy.node.Node``
    (context, namespace...).
    start: stamp (ns) before which collisions are ignored; epoch: stamp of the demo's time 0.
    stamp: of the latest collisions; effect_stamps: of the latest message by effect; -1 for none.
    pairs, effects: narrators. status: the latest ``collision_status``; heard: its time of arrival
    (s, steady clock). robots: names of robots whose joints the node reads. latencies: seconds from
    the stamp of a state to its collisions. cycles: number of messages of collisions.
    boxes: the latest markers; cycle: the latest complete cycle with markers, None before the first
    one; both after ``watch_boxes``. shapes, points: the node's input, after ``watch_inputs``.
    """

    def __init__(
        self, report: Callable[[str], None], effects: Iterable[str] = (), **node_options: Any
    ) -> None:
        super().__init__("listener", **node_options)
        self._report = report
        self._names: DiagnosticStatus | None = None
        self.stamp, self.start, self.epoch, self.cycles = -1, 0, 0, 0
        self.pairs = PairsNarrator()
        self.status, self.heard, self.robots = Status(), 0.0, set[str]()
        self.latencies: list[float] = []
        self.boxes = NO_BOXES
        self.cycle: Cycle | None = None
        self._kept: dict[str, dict[int, Any]] = defaultdict(dict)  # by topic and stamp
        self.shapes: dict[str, Shape] = {}
        self.points: Floats = np.empty((0, 3))
        self._markers: dict[str, Marker] = {}
        self.create_subscription(DiagnosticStatus, "namespaces", self._take_names, LATCHED)
        self.create_subscription(PointCloud2, "collisions", self._take_pairs, QoSProfile(depth=10))
        self.create_subscription(DiagnosticArray, "collision_status", self._take_status, LATCHED)
        self.effects: dict[str, Any] = {name: NARRATORS[name][1]() for name in effects}
        self.effect_stamps = dict.fromkeys(self.effects, -1)
        for name in self.effects:
            take = partial(self._take_effect, name)
            self.create_subscription(PointCloud2, TOPICS[name].name, take, QoSProfile(depth=10))

    @property
    def matched(self) -> bool:
        """Whether a node publishes collisions and namespaces."""
        return self.count_publishers("collisions") > 0 and self._names is not None

    def watch_boxes(self, topic: str) -> None:
        """Subscribe to a topic of markers."""
        self.create_subscription(
            MarkerArray, topic, self._take_boxes, QoSProfile(depth=1), raw=True
        )

    def watch_inputs(self) -> None:
        """Subscribe to the shapes on ``objects``, latched or not, and the points on ``points``."""
        for quality in (LATCHED, QoSProfile(depth=10)):
            self.create_subscription(MarkerArray, "objects", self._take_shapes, quality)
        self.create_subscription(PointCloud2, "points", self._take_points, BEST_EFFORT)

    def _take_names(self, message: DiagnosticStatus) -> None:
        self._names = message

    def _take_status(self, message: DiagnosticArray) -> None:
        status = Status()  # another thread may draw the last one
        status.take(message)
        self.status, self.heard = status, monotonic()
        base = f"{self.get_namespace().rstrip('/')}/"
        topics = [topic for topic, _ in self.get_topic_names_and_types() if topic.startswith(base)]
        ends = (topic[len(base) :].rpartition("/") for topic in topics)
        self.robots = {robot for robot, _, topic in ends if topic == "joint_states" and robot}
        self._gather()

    def _take_pairs(self, message: PointCloud2) -> None:
        now = self.get_clock().now().nanoseconds
        stamp = stamp_from_ros(message.header.stamp)
        if stamp < self.start or self._names is None:
            return
        try:
            pairs = named_pairs(message, self._names)
        except RefusedError:
            return  # a new namespace, whose message comes later; the next cycle has it
        if stamp > self.stamp:
            self.latencies.append((now - stamp) / NANOSECONDS)
        rows = collisions_from_ros(message)
        places = np.column_stack([rows[axis].astype(np.float64) for axis in "xyz"])
        boxed: list[tuple[str, str]] = []
        if "accuracy" in (rows.dtype.names or ()):
            levels = rows["accuracy"].tolist()
            boxed = [pair[:2] for pair, k in zip(pairs, levels, strict=True) if k <= Accuracy.OBB]
        self.cycles += 1
        self._print(self.pairs, pairs, stamp)
        self.stamp = stamp
        by_box = frozenset(name for names in boxed for name in names)
        self._keep("collisions", stamp, Pairs(pairs, places, by_box))

    def _take_effect(self, name: str, message: PointCloud2) -> None:
        stamp = stamp_from_ros(message.header.stamp)
        try:
            rows = NARRATORS[name][0](message, self._names or [])
        except RefusedError:
            return  # as above
        self._print(self.effects[name], rows, stamp)
        self.effect_stamps[name] = max(stamp, self.effect_stamps[name])
        self._keep(name, stamp, self.effects[name].rows)

    def _print(self, narrator: Any, rows: list[Any], stamp: int) -> None:
        seconds = max(0, stamp - self.epoch) / NANOSECONDS
        for line in narrator.update(rows, seconds):
            self._report(f"{seconds:8.3f} s  {line}")

    def _take_boxes(self, data: bytes) -> None:
        with suppress(RefusedError):
            boxes = boxes_from_bytes(data)
            if boxes is not NO_BOXES:
                self.boxes = boxes
                self._keep("boxes", boxes.stamp, boxes)

    def _keep(self, topic: str, stamp: int, value: Any) -> None:
        kept = self._kept[topic]
        kept.pop(stamp, None)
        kept[stamp] = value  # the newest is the last, even if the clock goes back
        if len(kept) > KEPT:
            del kept[next(iter(kept))]
        self._gather()

    def _gather(self) -> None:
        """Set ``cycle`` to the latest one of which all messages have arrived."""
        for stamp, boxes in reversed(self._kept["boxes"].items()):
            if self.cycle is not None and boxes is self.cycle.boxes:
                return
            parts = self._parts(stamp)
            if parts is None:
                continue
            pairs = parts.pop("collisions", NO_PAIRS)
            points, parts["points"] = self._inside()
            status = self.status.counting(len(pairs.rows))
            cycle = Cycle(boxes, pairs, parts, self.robots, points, status, monotonic())
            if cycle.agrees:
                self.cycle = cycle
                return

    def _parts(self, stamp: int) -> dict[str, Any] | None:
        """Return the messages of a stamp, by topic; None if one is still missing."""
        messages = {}
        for topic in {"collisions", *self.effects} - {"points"}:
            kept = self._kept[topic]
            if stamp in kept:
                messages[topic] = kept[stamp]
            elif stamp - next(reversed(kept), -STILL) < STILL:
                return None  # it comes later, or was lost
        return messages

    def _inside(self) -> tuple[Floats, list[Any]]:
        """Return the latest points, and the rows about them, which have the same stamp."""
        rows, clouds = self._kept["points"], self._kept["cloud"]
        for stamp in reversed(rows):
            if stamp in clouds:
                return clouds[stamp], rows[stamp]
        return self.points, next(reversed(rows.values()), [])

    def _take_shapes(self, message: MarkerArray) -> None:
        for marker in message.markers:
            name = name_from_key((marker.ns, marker.id))
            last = self._markers.get(name)
            if marker.action != Marker.ADD or (
                last and all(getattr(last, f) == getattr(marker, f) for f in SHAPE_FIELDS)
            ):
                continue
            self._markers[name] = marker
            try:
                self.shapes = {**self.shapes, name: shape_from_ros(marker)}
            except RefusedError:
                continue  # its box is drawn instead

    def _take_points(self, message: PointCloud2) -> None:
        if message.header.frame_id == self.boxes.frame:
            points = points_from_ros(message).astype(np.float64)
            self.points = points[np.isfinite(points).all(axis=1)]
            self._keep("cloud", stamp_from_ros(message.header.stamp), self.points)
