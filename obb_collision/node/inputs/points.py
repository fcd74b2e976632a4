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

"""Clouds of obstacle points: converted only when they are used.

The newest cloud that can be placed counts; those that wait for their transform are few and bounded.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import PointCloud2

from obb_collision.geometry.poses import as_poses
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.clouds import points_from_ros
from obb_collision.node.messages.conversions import NANOSECONDS, pose_faults, stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.frames import LATER, FrameSource
from obb_collision.node.objects.states import AHEAD
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard
from obb_collision.queries.points.points import PointsInside
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats

MAX_CLOUDS = 16
MAX_CLOUD_BYTES = 1 << 26
"""Clouds kept while they wait for their transforms: 64 MB; the newest is kept whatever its size."""


class Cloud(NamedTuple):
    """A cloud that waits for its transform: its stamp and when it came (ns)."""

    message: PointCloud2
    stamp: int
    received: int


class Obstacles:
    """Keeps the points of the scene up to date with the topic ``points``."""

    def __init__(
        self,
        scene: Scene,
        frames: FrameSource,
        fixed_frame: str,
        monitor: InputMonitor,
        clock: Callable[[], int],
        guard: Guard,
    ) -> None:
        self._scene, self._frames, self._fixed_frame = scene, frames, fixed_frame
        self._monitor, self._clock, self._guard = monitor, clock, guard
        self._waiting: list[Cloud] = []
        self.stamp = 0
        """Of the points in the scene (ns), 0 for none."""
        self.timeout = 0.0
        """How long a cloud may wait for its frame (s)."""
        self.stamp_tolerance = NANOSECONDS // 2
        """Stamps further than this ahead of the node's clock (ns) are not published."""

    def take(self, message: PointCloud2) -> None:
        """Keep a cloud."""
        now = self._clock()
        self._monitor.received(now)
        try:
            stamp = stamp_from_ros(message.header.stamp)
        except RefusedError as error:
            self._monitor.refuse(now, error.reason, detail=error.detail)
            return
        if stamp > now + self.stamp_tolerance:
            ahead = (stamp - now) / NANOSECONDS
            self._monitor.doubt(now, AHEAD, detail=f"{ahead:.1f} s ahead of the node's clock")
        if not self._is_elsewhere(message) or not self._frames.waits:
            self._waiting.clear()
        self._waiting.append(Cloud(message, stamp, now))
        if self._is_full():
            del self._waiting[-2::-2]  # every other one: the time they reach back stays
        while self._is_full():
            del self._waiting[0]

    def place(self, now: int) -> None:
        """Give the scene the newest cloud that can be placed; the last good one stays otherwise."""
        kept: list[Cloud] = []
        waiting, self._waiting = self._waiting, kept
        while waiting:
            cloud = waiting.pop()
            try:
                self._use(cloud)
                break
            except RefusedError as error:
                if not (error.reason in LATER and self._may_wait(cloud, now)):
                    self._monitor.refuse(now, error.reason, detail=error.detail)
                    continue
                kept.insert(0, cloud)
            except Exception as error:
                self._guard.caught("input points", error)
                self._monitor.refuse(now, INTERNAL_ERROR, "whole message", str(error))

    def _may_wait(self, cloud: Cloud, now: int) -> bool:
        late = now - cloud.received > int(self.timeout * NANOSECONDS)
        return self._frames.waits and not late

    def _use(self, cloud: Cloud) -> None:
        """Give the scene a cloud; RefusedError if it can't be used, or not yet."""
        frame = None
        if self._is_elsewhere(cloud.message):
            frame = self._frames.lookup(cloud.message.header.frame_id, cloud.stamp)
            if any(fault.any() for fault in pose_faults(frame[None])):
                raise RefusedError("bad transform", f"{frame.tolist()}")
        points = points_from_ros(cloud.message)
        self._scene.obstacle_points = points if frame is None else placed_points(points, frame)
        believed = cloud.stamp <= cloud.received + self.stamp_tolerance
        self.stamp = (cloud.stamp if believed else 0) or cloud.received

    def note(self, report: Report) -> None:
        """Take note of what the effect made of the points."""
        found: PointsInside | None = report.results.get("points")
        if found is not None and self.stamp:
            self._monitor.ignored = found.ignored

    def forget(self) -> None:
        """Take all points away."""
        self._scene.obstacle_points = None
        self._waiting.clear()
        self.stamp = 0

    def clock_jumped(self, shift: int) -> None:
        """Take over a jump of the clock (ns)."""
        self._waiting = [c._replace(received=c.received + shift) for c in self._waiting]
        self.stamp = max(1, self.stamp + shift) if self.stamp else 0

    def _is_elsewhere(self, message: PointCloud2) -> bool:
        """Whether a cloud is in another frame than the fixed one."""
        return message.header.frame_id not in ("", self._fixed_frame)

    def _is_full(self) -> bool:
        size = sum(len(cloud.message.data) for cloud in self._waiting)
        count = len(self._waiting)
        return count > 1 and (count > MAX_CLOUDS or size > MAX_CLOUD_BYTES)


def placed_points(points: npt.NDArray[Any], frame: Floats) -> Floats:
    """Points (n, 3) of a frame, seen from where that frame is (7,): in doubles."""
    position, rotation = as_poses(frame[None], warn=False)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is ignored later on
        placed: Floats = points.astype(np.float64) @ rotation[0].T + position[0]
    return placed
