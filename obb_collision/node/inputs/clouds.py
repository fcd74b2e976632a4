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

"""Clouds that wait: the newest one that can be placed is used, such as that of watched points.

The clouds that wait for transforms are limited in number and size, and converted only when used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from obb_collision.geometry.poses import as_poses
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.cdr import cloud_from_bytes
from obb_collision.node.messages.clouds import points_from_ros
from obb_collision.node.messages.conversions import (
    NANOSECONDS,
    name_from_key,
    stamp_from_ros,
    unusable_poses,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.objects.frames import LATER, FrameSource
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.states import AHEAD
from obb_collision.node.parameters.sources import POINTS, source_key
from obb_collision.queries.points.points import PointsInside
from obb_collision.scene.report import Report
from obb_collision.typing import Floats

MAX_CLOUDS = 16
MAX_CLOUD_BYTES = 1 << 26
"""Maximum size of clouds that wait for transforms, 64 MB; the newest is always stored."""


class QueuedCloud(NamedTuple):
    """A queued cloud: content, frame, stamp (ns), size in bytes, time of receipt (ns) and sender.

    carried: time (ns) of the transform that places it, if that is the latest transform; else 0.
    """

    content: Any
    frame: str
    stamp: int
    size: int
    received: int = 0
    carried: int = 0
    sender: int = 0


class WaitingClouds:
    """Clouds of one topic in the order of receipt."""

    def __init__(self, objects: Objects, frames: FrameSource, monitor: InputMonitor) -> None:
        self._objects, self._frames, self._monitor = objects, frames, monitor
        self.clouds: list[QueuedCloud] = []
        """The newest one last."""
        self.is_patient = False
        """Whether they wait for more than their transforms: those in the fixed frame, too."""

    def add(self, cloud: QueuedCloud) -> int:
        """Queue a cloud; returns the number of unused clouds that are dropped."""
        before = len(self.clouds)
        if self.is_patient:
            pass
        elif not self._is_elsewhere(cloud):
            self.clouds.clear()
        elif not self._frames.waits:
            self.clouds = [queued for queued in self.clouds if not self._is_elsewhere(queued)]
        self.clouds.append(cloud)
        if self._is_full():
            del self.clouds[-2::-2]  # every other one: the time they reach back stays
        while self._is_full():
            del self.clouds[0]
        return before + 1 - len(self.clouds)

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self.clouds = [c._replace(received=c.received + shift) for c in self.clouds]

    def use_newest(
        self,
        now: int,
        use: Callable[[QueuedCloud, Floats | None], None],
        refuse: Callable[[QueuedCloud, RefusedError], None] = lambda cloud, error: None,
    ) -> int:
        """Use the newest cloud that can be placed; drop earlier ones and return their number.

        use: takes a cloud and where its frame is (7,), None for the fixed frame; it may raise
        RefusedError. refuse: called for each cloud that can't be used.
        """
        kept: list[QueuedCloud] = []
        refused: list[tuple[QueuedCloud, RefusedError]] = []  # newer than the one used
        waiting, self.clouds = self.clouds, kept
        while waiting:
            cloud = waiting.pop()
            try:
                use(*self._place(cloud, now))
                break
            except Exception as error:
                refusal = self._objects.guard.refusal(f"input {self._monitor.topic}", error)
                timeout = int(self._objects.placement.timeout * NANOSECONDS)
                waits = self._frames.waits or self.is_patient
                may_wait = waits and now - cloud.received <= timeout
                # an earlier one than that refused would hide that there is a newer one
                if refusal.reason in LATER and may_wait and not refused:
                    kept.insert(0, cloud)
                    continue
                item = "" if refusal is error else "whole message"
                self._monitor.refuse(refusal.reason, item, refusal.detail)
                refused.append((cloud, refusal))
        for newer, reason in reversed(refused):
            refuse(newer, reason)
        return len(waiting)

    def _place(self, cloud: QueuedCloud, now: int) -> tuple[QueuedCloud, Floats | None]:
        if not self._is_elsewhere(cloud):
            return cloud, None
        frame, at = self._frames.lookup(cloud.frame, cloud.stamp)
        if unusable_poses(frame[None]).any():
            raise RefusedError("bad transform", f"{frame.tolist()}")
        if cloud.stamp == 0:
            latest = self._objects.placement.latest
            cloud = cloud._replace(carried=latest.since(cloud.frame, at, now))
        return cloud, frame

    def _is_elsewhere(self, cloud: QueuedCloud) -> bool:
        """Whether a cloud is in another frame than the fixed one."""
        return not self._objects.placement.frame_table.is_fixed(cloud.frame)

    def _is_full(self) -> bool:
        size, count = sum(cloud.size for cloud in self.clouds), len(self.clouds)
        return count > 1 and (count > MAX_CLOUDS or size > MAX_CLOUD_BYTES)


class Obstacles:
    """Keeps the watched points of the scene up to date: of the topic ``points``, and of sources."""

    def __init__(self, objects: Objects, frames: FrameSource) -> None:
        self._objects, self._monitor = objects, objects.monitors["points"]
        self.waiting = WaitingClouds(objects, frames, self._monitor)
        self.stamp = 0
        """Of the newest points in the scene (ns), 0 for none."""

    def queue(self, data: bytes, now: int) -> None:
        """Keep a serialised cloud."""
        try:
            message = cloud_from_bytes(data)
            stamp = stamp_from_ros(message.header.stamp)
        except RefusedError as error:
            self._monitor.refuse(error.reason, detail=error.detail)
            return
        if stamp > now + self._objects.states.stamp_tolerance:
            ahead = (stamp - now) / NANOSECONDS
            self._monitor.doubt(AHEAD, detail=f"{ahead:.1f} s ahead of the node's clock")
        frame, size = message.header.frame_id, len(message.data)
        self.waiting.add(QueuedCloud(message, frame, stamp, size, now))

    def use_newest(self, now: int) -> None:
        """Give the scene the newest cloud that can be placed; the last good one stays otherwise."""
        self.waiting.use_newest(now, self._use)

    def _use(self, cloud: QueuedCloud, frame: Floats | None) -> None:
        """Give the scene a cloud; RefusedError if it can't be used."""
        points = points_from_ros(cloud.content, self._objects.max_points)
        if frame is not None:
            position, rotation = as_poses(frame[None], warn=False)
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is ignored
                points = points.astype(np.float64) @ rotation[0].T + position[0]
        self.watch(POINTS, points, cloud)

    def watch(self, source: str, points: Floats, cloud: QueuedCloud) -> None:
        """Give the scene the points (n, 3) of a source, in the fixed frame."""
        key = source_key(source)
        scene, namespaces = self._objects.scene, self._objects.table.namespaces
        watched, name = scene.watched, name_from_key(key)
        if name not in watched:
            namespaces.use(namespaces.admit(key[0]))
        scene.watched = {**watched, name: points}
        believed = cloud.stamp <= cloud.received + self._objects.states.stamp_tolerance
        self.stamp = (cloud.stamp if believed else 0) or cloud.received

    def note(self, report: Report) -> None:
        """Record the result of the effect on the points."""
        result: PointsInside | None = report.results.get("points")
        if result is not None and self.stamp:
            self._monitor.ignored = result.ignored

    def forget(self) -> None:
        """Remove all points from the scene."""
        for name in self._objects.scene.watched:
            self._objects.table.namespaces.leave(namespace_number(name.rpartition("/")[0]))
        self._objects.scene.watched = {}
        self.waiting.clouds.clear()
        self.stamp = 0

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self.waiting.clock_jumped(shift)
        self.stamp = max(1, self.stamp + shift) if self.stamp else 0
