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

"""Sensors as objects: each message gives the object of its source a new cloud.

A message waits for the next cycle and for its transform. The newest one that can be used replaces
those before it, whose clouds are never built. Points stay in the frame of the sensor: the object is
placed where the sensor is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import LaserScan, PointCloud2, Range

from obb_collision.geometry.poses import (
    IDENTITY_POSE,
    compose_poses,
    inverse_poses,
    rotate_vectors,
)
from obb_collision.node.inputs.clouds import Obstacles, QueuedCloud
from obb_collision.node.inputs.cuts import INVALID, Limits, Points, placed_points, select, thin_out
from obb_collision.node.inputs.inputs import Inputs
from obb_collision.node.inputs.leave_out import LeftOut, RobotParts
from obb_collision.node.inputs.newest import NewestInput
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.cdr import CloudMessage, cloud_from_bytes
from obb_collision.node.messages.clouds import points_from_ros
from obb_collision.node.messages.conversions import NANOSECONDS, stamp_from_ros, unusable_poses
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.scans import (
    NOTHING_VALID,
    RangeMessage,
    ScanMessage,
    points_of_range,
    points_of_scan,
    range_from_bytes,
    scan_from_bytes,
)
from obb_collision.node.objects.conditions import POSE_OVERTAKEN, POSE_REFUSED, TIMED_OUT
from obb_collision.node.objects.frames import LATER, FrameSource
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.states import OLDER, State
from obb_collision.node.objects.table import OF_SOURCE
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.parameters.sources import (
    CLOUD,
    FAR,
    RANGE,
    SCAN,
    WATCH,
    SourceSettings,
)
from obb_collision.shapes import Cloud
from obb_collision.typing import Floats, Mask

DEPTH = 5
"""Messages that wait in the queue of a source, as drivers of sensors send."""
KINDS = {
    CLOUD: (PointCloud2, cloud_from_bytes),
    SCAN: (LaserScan, scan_from_bytes),
    RANGE: (Range, range_from_bytes),
}
"""By type: the message, and how its bytes are read."""


class Measurement(NamedTuple):
    """Points (k, 3) in the frame of a sensor, and their radius (m).

    invalid: number of rays that are not among the points. times (k,): of the points of a scan, from
    0 at the first ray to 1 at the last.
    """

    points: Points
    radius: float = 0.0
    invalid: int = 0
    times: Floats | None = None


def source_inputs(settings: list[SourceSettings]) -> dict[str, Input]:
    """Return the input topics of sources."""
    best_effort = ReliabilityPolicy.BEST_EFFORT
    return {
        source.topic: Input(KINDS[source.type][0], DEPTH, best_effort, meaning=source.name)
        for source in settings
    }


class Source(NewestInput):
    """A sensor; its messages are the shapes of an object.

    settings: returns its parameters; left_out: finds the points of robots and objects.
    """

    def __init__(
        self,
        objects: Objects,
        frames: FrameSource,
        clock: Callable[[], int],
        settings: Callable[[], SourceSettings],
        left_out: LeftOut,
    ) -> None:
        first = settings()
        super().__init__(objects, frames, clock, first.topic, self._read_message)
        self._settings, self._frames, self._left_out = settings, frames, left_out
        self._type, self.key = first.type, first.key

    def add(self) -> None:
        """Add the object; it has no place until the first message."""
        slot = self._objects.shapes.put(self.key, Cloud(np.empty((0, 3))))
        self._table.of_set[slot] = OF_SOURCE

    def _read_message(self, data: bytes, _: int) -> QueuedCloud:
        message: Any = KINDS[self._type][1](data)
        stamp = stamp_from_ros(message.header.stamp)
        self.waiting.is_patient = bool(self._settings().leave_out)
        return QueuedCloud(message, message.header.frame_id, stamp, len(data))

    @property
    def _own(self) -> Mask:
        own = np.zeros(len(self._table.condition), np.bool_)
        slot = self._table.slots.get(self.key)
        own[[] if slot is None else slot] = True
        return own

    def _use(self, cloud: QueuedCloud, frame: Floats | None) -> None:
        settings = self._settings()
        self._check_order(cloud)
        sensor = IDENTITY_POSE if frame is None else frame
        points, radius = self._cut(self._measure(cloud), cloud, sensor, settings)
        self._take(points, radius, cloud, sensor)

    def _check_order(self, cloud: QueuedCloud) -> None:
        slot = np.flatnonzero(self._own)
        if self._objects.states.find_late(slot, cloud.stamp, cloud.received).any():
            raise RefusedError(OLDER, "a newer message was used")

    def _take(self, points: Floats, radius: float, cloud: QueuedCloud, sensor: Floats) -> None:
        """Give the object points in the frame of a sensor at a pose (7,)."""
        try:
            shape = Cloud(points, radius)
        except ValueError as error:
            raise RefusedError("bad shape", str(error)) from error
        slot = self._objects.shapes.put(self.key, shape)
        self._table.of_set[slot] = OF_SOURCE
        of_cloud = cloud.stamp, cloud.received, self.topic, cloud.carried, cloud.sender
        self._objects.states.store(np.array([slot]), sensor[None], State("", *of_cloud))

    def _measure(self, cloud: QueuedCloud) -> Measurement:
        """Return the points of a message."""
        message, most = cloud.content, self._objects.max_points
        if isinstance(message, CloudMessage):
            return Measurement(points_from_ros(message, most))
        if isinstance(message, RangeMessage):
            return Measurement(*points_of_range(message))
        assert isinstance(message, ScanMessage)
        points, hit, invalid = points_of_scan(message, most)
        return Measurement(points, 0.0, invalid, np.flatnonzero(hit) / max(len(hit) - 1, 1))

    def _cut(
        self, measured: Measurement, cloud: QueuedCloud, sensor: Floats, settings: SourceSettings
    ) -> tuple[Floats, float]:
        """Return the points that stay, and their radius (m); count the others."""
        points, radius = measured.points, measured.radius + settings.radius
        if measured.times is not None:
            points = self._deskewed(points, measured.times, cloud, sensor)
        counts = {"points": len(points) + measured.invalid}
        points, cut = select(points, self._limits(cloud, sensor, settings))
        counts |= zip(("invalid", "out of range", "out of height"), cut[1:], strict=True)
        counts["invalid"] += measured.invalid
        if 0 < len(measured.points) == cut[INVALID] and measured.invalid == 0:
            raise RefusedError(NOTHING_VALID, f"none of {len(measured.points)} points is finite")
        if settings.leave_out:
            words, padding = settings.leave_out, settings.leave_out_padding
            placed = placed_points(points, sensor)
            inside = self._left_out.inside(placed, words, cloud.stamp, padding)
            rows = np.flatnonzero(~inside)
            counts["left out"] = len(points) - len(rows)
            if settings.shadows:
                rest = placed.take(rows, axis=0)
                hidden = self._left_out.behind(rest, words, cloud.stamp, padding, sensor[:3])
                rows = rows[~hidden]
                counts["in a shadow"] = len(points) - counts["left out"] - len(rows)
            points = points.take(rows, axis=0)
        if settings.voxel > 0.0:
            kept, moved = thin_out(points, settings.voxel)
            counts["thinned out"] = len(points) - len(kept)
            points, radius = points.take(kept, axis=0), radius + moved
        self._monitor.last_cloud = counts | {"used": len(points)}
        return points, radius

    def _limits(self, cloud: QueuedCloud, sensor: Floats, settings: SourceSettings) -> Limits:
        """Return the limits of points; RefusedError if the frame of heights is not known."""
        farthest = settings.max_range if settings.max_range < FAR else np.inf
        limits = Limits(settings.min_range, farthest)
        low, high, name = settings.min_height, settings.max_height, settings.height_frame
        if low == -FAR and high == FAR:
            return limits
        limits = limits._replace(
            min_height=low if low > -FAR else -np.inf, max_height=high if high < FAR else np.inf
        )
        is_fixed = self._objects.placement.frame_table.is_fixed(name)
        frame = IDENTITY_POSE if is_fixed else self._pose_of(name, cloud.stamp)
        return limits.seen_from(sensor, frame)

    def _pose_of(self, frame: str, stamp: int) -> Floats:
        pose, _ = self._frames.lookup(frame, stamp)
        if unusable_poses(pose[None]).any():
            raise RefusedError("bad transform", f"{frame!r}: {pose.tolist()}")
        return pose

    def _deskewed(
        self, points: Points, times: Floats, cloud: QueuedCloud, sensor: Floats
    ) -> Points:
        """Return the points of a scan of a moving sensor, in its frame at the first ray."""
        scan: ScanMessage = cloud.content
        last = int(scan.time_increment * (len(scan.ranges) - 1) * NANOSECONDS)
        is_fixed = self._objects.placement.frame_table.is_fixed(cloud.frame)
        if last == 0 or cloud.stamp == 0 or is_fixed:
            return points
        end = self._pose_of(cloud.frame, cloud.stamp + last)
        moved = compose_poses(inverse_poses(sensor[None]), end[None])[0]
        turn = moved[3:] if moved[6] >= 0.0 else -moved[3:]
        sine = float(np.linalg.norm(turn[:3]))
        half = times * np.arctan2(sine, turn[3])
        axis = turn[:3] / sine if sine > 0.0 else np.zeros(3)
        turns = np.column_stack([np.sin(half)[:, None] * axis, np.cos(half)])
        return rotate_vectors(turns, points.astype(np.float64)) + times[:, None] * moved[:3]

    def _refuse(self, cloud: QueuedCloud, error: RefusedError) -> None:
        self._doubt(error.reason)

    def _doubt(self, reason: str) -> None:
        late = TIMED_OUT if reason in LATER else POSE_REFUSED
        event = POSE_OVERTAKEN if reason == OLDER else late
        self._table.mark(np.flatnonzero(self._own), event)


class WatchedSource(Source):
    """A sensor whose points cannot collide; ``points_inside`` counts them."""

    def __init__(self, obstacles: Obstacles, *parts: Any) -> None:
        super().__init__(*parts)
        self._obstacles = obstacles

    def add(self) -> None:
        """Add nothing: there is no object."""

    def _check_order(self, cloud: QueuedCloud) -> None:
        """Accept every message."""

    def _take(self, points: Floats, radius: float, cloud: QueuedCloud, sensor: Floats) -> None:
        self._obstacles.watch(self._settings().name, placed_points(points, sensor), cloud)

    def _doubt(self, reason: str) -> None:
        """Mark nothing: no object depends on it."""


class Sources:
    """The sensors that the parameters of a node name."""

    def __init__(
        self,
        objects: Objects,
        frames: FrameSource,
        clock: Callable[[], int],
        parameters: Parameters,
        robots: RobotParts,
        obstacles: Obstacles,
    ) -> None:
        self._parameters, self._clock = parameters, clock
        self.left_out = LeftOut(objects, parameters, robots, self._words)
        self.obstacles: list[Source] = []
        self.watched: list[Source] = []
        for row, settings in enumerate(parameters.source_settings):
            parts = objects, frames, clock, self._settings_of(row), self.left_out
            if settings.use == WATCH:
                self.watched.append(WatchedSource(obstacles, *parts))
            else:
                self.obstacles.append(Source(*parts))
        self.all = [*self.obstacles, *self.watched]

    def _settings_of(self, row: int) -> Callable[[], SourceSettings]:
        return lambda: self._parameters.source_settings[row]

    def _words(self) -> list[list[str]]:
        """Return the parameter ``leave_out`` of each source."""
        return [source.leave_out for source in self._parameters.source_settings]

    def callbacks(self, inputs: Inputs) -> Mapping[str, Callable[[bytes], None]]:
        """Return the callback per topic; failures are counted."""
        watched = {source.topic for source in self.watched}
        return {
            source.topic: inputs.guarded(
                source.topic, source.queue, changes=source.topic not in watched
            )
            for source in self.all
        }

    def add(self) -> None:
        """Add the objects of all sources: at the start, and after all objects were removed."""
        for source in self.obstacles:
            source.add()

    def apply(self) -> None:
        """Give the objects of sources the points of their newest messages."""
        if self.all:
            self.left_out.record()
            self._apply(self.obstacles)

    def apply_watched(self) -> None:
        """Use the newest messages of watched sources."""
        self._apply(self.watched)

    def forget_watched(self) -> None:
        """Drop the messages of watched sources, whose points nothing needs."""
        for source in self.watched:
            source.cleared()

    def _apply(self, sources: list[Source]) -> None:
        waiting = [source for source in sources if source.waiting.clouds]
        if waiting:
            self.left_out.place(self._clock())
        for source in waiting:
            source.apply()
