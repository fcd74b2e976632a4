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

"""Clouds of obstacle points: the latest one is kept, and converted only when somebody asks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import PointCloud2

from obb_collision.geometry.poses import as_poses
from obb_collision.node.clouds import points_from_ros
from obb_collision.node.conversions import NANOSECONDS, FloatArray, stamp_from_ros
from obb_collision.node.errors import RefusedError
from obb_collision.node.frames import FrameSource
from obb_collision.node.monitors import InputMonitor
from obb_collision.scene.effects.points import ObjectPoints
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene


class Obstacles:
    """Keeps the points of the scene up to date with the topic ``points``."""

    def __init__(
        self,
        scene: Scene,
        frames: FrameSource,
        fixed_frame: str,
        monitor: InputMonitor,
        clock: Callable[[], int],
    ) -> None:
        self._scene, self._frames, self._fixed_frame = scene, frames, fixed_frame
        self._monitor, self._clock = monitor, clock
        self._waiting: tuple[PointCloud2, int] | None = None
        self.stamp = 0
        """Of the points in the scene (ns), 0 for none."""
        self.timeout = 0.0
        """How long a cloud may wait for its frame (s)."""

    def take(self, message: PointCloud2) -> None:
        """Keep a cloud; the one before is dropped."""
        now = self._clock()
        self._monitor.received(now)
        self._waiting = message, now

    def place(self, now: int) -> None:
        """Give the scene the latest cloud. One that is refused leaves it the last good one."""
        if self._waiting is None:
            return
        message, received = self._waiting
        try:
            frame = self._frame_pose(message)
        except RefusedError as error:
            if self._frames.waits and now - received <= int(self.timeout * NANOSECONDS):
                return  # its transform may still come
            self._refuse(now, error)
            return
        try:
            points = points_from_ros(message)
            self._scene.points = points if frame is None else placed_points(points, frame)
            self.stamp = stamp_from_ros(message.header.stamp) or received
            self._waiting = None
        except RefusedError as error:
            self._refuse(now, error)

    def note(self, report: Report) -> None:
        """Take note of what the effect made of the points."""
        found: ObjectPoints | None = report.results.get("points")
        if found is not None and self.stamp:
            self._monitor.ignored = found.ignored

    def forget(self) -> None:
        """Take all points away."""
        self._scene.points = self._waiting = None
        self.stamp = 0

    def _frame_pose(self, message: PointCloud2) -> FloatArray | None:
        """Return the pose (7,) of a cloud's frame, None for the fixed one."""
        frame = message.header.frame_id
        if frame in ("", self._fixed_frame):
            return None
        return self._frames.lookup(frame, stamp_from_ros(message.header.stamp))

    def _refuse(self, now: int, error: RefusedError) -> None:
        self._waiting = None
        self._monitor.refuse(now, error.reason, detail=error.detail)


def placed_points(points: npt.NDArray[Any], frame: FloatArray) -> FloatArray:
    """Points (n, 3) of a frame, seen from where that frame is (7,): in doubles."""
    position, rotation = as_poses(frame[None])
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is ignored later on
        placed: FloatArray = points.astype(np.float64) @ rotation[0].T + position[0]
    return placed
