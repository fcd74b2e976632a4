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


"""Observation sources: the newest message of each sensor, and its points about the base now."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import PolygonInstanceStamped
from sensor_msgs.msg import LaserScan, PointCloud2, Range

from obb_collision.geometry.poses import as_poses, compose_poses, inverse_poses
from obb_collision.node.messages.cdr import TOO_MANY_POINTS, Header, Reader, cloud_from_bytes
from obb_collision.node.messages.clouds import cloud_from_ros, points_from_ros
from obb_collision.node.messages.conversions import NANOSECONDS, stamp_from_ros, unusable_poses
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.scans import (
    NOTHING_VALID,
    points_of_scan,
    range_from_bytes,
    scan_from_bytes,
)
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.typing import Floats
from obb_collision.zones.outlines import Twist, count_inside, seen_at
from obb_collision.zones.sources import CLOUD, POLYGON, RANGE, SCAN, Observed, arc, border
from obb_collision.zones.zones import Exclusion

MESSAGES = {SCAN: LaserScan, CLOUD: PointCloud2, RANGE: Range, POLYGON: PolygonInstanceStamped}
Lookup = Callable[[str, int], tuple[Floats, int]]
"""Returns the pose (7,) of a frame at a stamp (ns, 0: the latest), and the stamp of that."""
OUT_OF_RANGE, NO_FIELD = "out of range", "no field"
"""Reasons: of a range beyond its limits, and of a cloud without heights."""
AHEAD = "stamp ahead"
"""Reason: of a message from the future."""
FOREVER = 1 << 62
"""Nanoseconds."""
MOST_AHEAD = NANOSECONDS // 10
"""Nanoseconds by which a stamp may be ahead of the clock of the node."""
CORNER_BYTES, NUMBER = 12, Struct("<q")
"""Of a corner of a polygon in a message, and the layout of its id."""
MOST_POLYGONS = 1000
"""Polygons of a source that are stored, those that came last."""


class InvalidError(Exception):
    """What a source says is not known: a code of the state of the gate, and details."""

    def __init__(self, code: str, detail: str = "") -> None:
        super().__init__(f"{code}: {detail}")
        self.code, self.detail = code, detail


class BaseFrames:
    """Where frames are in the frame of the base, at moments of one decision.

    odom, base: look frames up in the frame of odometry, and in that of the base.
    """

    def __init__(self, parameters: Parameters, odom: Lookup, base: Lookup) -> None:
        self._base_frame, self._odom, self._base = parameters.base_frame_id, odom, base
        self._parameters = parameters
        self.twist: Twist = (0.0, 0.0, 0.0)
        """Of the base: how it goes on where there is no transform yet."""
        self._own: tuple[int, Floats] = (-1, np.empty(0))

    def base_pose(self, now: int) -> Floats:
        """Return the pose (7,) of the base in the frame of odometry; InvalidError."""
        if self._own[0] != now:
            self._own = now, self._carried(self._base_frame, now)
        return self._own[1]

    def place(self, frame: str, stamp: int, now: int, moves: bool = False) -> Floats:
        """Return the pose (7,) of a frame at a stamp in that of the base now; InvalidError.

        moves: whether the frame moves with the base.
        """
        if not self._parameters.base_shift_correction:
            return self._near(self._base, frame, 0)[0]
        pose = self._carried(frame, stamp) if moves else self._near(self._odom, frame, stamp)[0]
        return compose_poses(inverse_poses(self.base_pose(now)[None]), pose[None])[0]

    def at_once(self, frame: str, stamp: int) -> Floats:
        """Return the pose (7,) of a frame in that of the base, both at a stamp; InvalidError."""
        base, pose = (self._near(self._odom, name, stamp)[0] for name in (self._base_frame, frame))
        return compose_poses(inverse_poses(base[None]), pose[None])[0]

    def _carried(self, frame: str, stamp: int) -> Floats:
        """Return the pose of a frame on the base, which goes on from its latest transform."""
        pose, lag = self._near(self._odom, frame, stamp)
        if lag <= 0:
            return pose
        x, y, turn = self.twist
        time = lag / NANOSECONDS
        way = seen_at(0.0, 0.0, (-x, -y, -turn), time)
        half = 0.5 * turn * time
        moved = np.array([[*way, 0.0, 0.0, 0.0, math.sin(half), math.cos(half)]])
        base = self._near(self._odom, self._base_frame, 0)[0][None]
        on_base = compose_poses(inverse_poses(base), pose[None])
        return compose_poses(compose_poses(base, moved), on_base)[0]

    def _near(self, lookup: Lookup, frame: str, stamp: int) -> tuple[Floats, int]:
        """Return a pose at a stamp, or the latest one if that is not too old; and its age (ns)."""
        lag, limit = 0, self._parameters.transform_tolerance * NANOSECONDS
        try:
            try:
                pose, _ = lookup(frame, stamp)
            except RefusedError:
                pose, at = lookup(frame, 0)
                lag = stamp - at if at else 0
                if abs(lag) > limit:
                    raise
        except RefusedError as error:
            raise InvalidError("late_frame", f"{error.reason}: {error.detail}") from error
        if unusable_poses(pose[None]).any():
            raise InvalidError("late_frame", f"bad transform of {frame!r}")
        return pose, lag


class Part(NamedTuple):
    """What a source stores: points (n, 3) or with heights (n, 4), header, time of receipt (ns)."""

    points: Floats
    header: Header
    received: int


class Observation:
    """A sensor: its newest message, read but not placed.

    most: points of a message; strict: whether what says nothing makes it invalid.
    """

    def __init__(self, settings: Observed, most: Callable[[], int], strict: bool) -> None:
        self.settings, self._most, self.strict = settings, most, strict
        self._parts: dict[Any, Part] = {}
        """Of polygons by their ids, of other sensors one."""
        self._unread = ""

    def take(self, data: bytes, now: int) -> None:
        """Store a serialised message; RefusedError for one that cannot be used."""
        try:
            key, points, header = self._read(data)
            ahead = stamp_from_ros(header.stamp) - now
            if self.strict and ahead > MOST_AHEAD:
                raise RefusedError(AHEAD, f"by {ahead / NANOSECONDS:.1f} s")
        except Exception as error:  # also one that was not foreseen
            self._unread = repr(error)
            if isinstance(error, RefusedError):
                self._unread = f"{error.reason}: {error.detail}"
            raise
        self._unread = ""
        self._parts.pop(key, None)
        self._parts[key] = Part(points, header, now)
        if len(self._parts) > MOST_POLYGONS:
            del self._parts[next(iter(self._parts))]

    def _read(self, data: bytes) -> tuple[Any, Floats, Header]:
        settings = self.settings
        if settings.type == SCAN:
            scan = scan_from_bytes(data)
            try:
                points, _, _ = points_of_scan(scan, self._most())
            except RefusedError:
                if self.strict or len(scan.ranges) > self._most():
                    raise
                points = np.empty((0, 3))
            return None, points, scan.header
        if settings.type == CLOUD:
            message: Any = cloud_from_bytes(data)
            rows = points_from_ros(message, self._most()).astype(np.float64)
            if settings.use_global_height:
                heights = cloud_from_ros(message, ("height",), self._most())
                if "height" not in (heights.dtype.names or ()):
                    raise RefusedError(NO_FIELD, "no field 'height'")
                rows = np.column_stack([rows, heights["height"].astype(np.float64)])
            return None, rows[np.isfinite(rows).all(axis=1)], message.header
        if settings.type == RANGE:
            found = range_from_bytes(data)
            if not found.min_range <= found.range <= found.max_range:
                raise RefusedError(OUT_OF_RANGE, f"{found.range}")
            view = found.field_of_view
            self._check_count(view / settings.obstacles_angle)
            return None, arc(found.range, view, settings.obstacles_angle), found.header
        number, corners, header = polygon_from_bytes(data)
        if not np.isfinite(corners).all():
            raise RefusedError("bad polygon", "not finite")
        sides = np.roll(corners, -1, axis=0) - corners
        self._check_count(np.sqrt((sides**2).sum(axis=1)).sum() / settings.sampling_distance)
        return number, border(corners, settings.sampling_distance), header

    def _check_count(self, points: float) -> None:
        """Raise RefusedError for more points than a message may have."""
        if not points <= self._most():
            raise RefusedError(TOO_MANY_POINTS, f"{points:g}, {self._most()} is the limit")

    def points(self, frames: BaseFrames, now: int) -> Floats:
        """Return the points (n, 3) about the base now; InvalidError where they are not known."""
        settings, limit = self.settings, int(self.settings.source_timeout * NANOSECONDS)
        reason = self._unread.partition(":")[0]
        if reason and (self.strict or reason in (OUT_OF_RANGE, NO_FIELD)):
            is_read = reason in (OUT_OF_RANGE, NOTHING_VALID, AHEAD)
            code = "refused" if is_read else "input_unreadable"
            raise InvalidError(code, self._unread)
        if not self._parts:
            raise InvalidError("input_silent", "no message")
        if settings.type == POLYGON or limit:
            fresh = {key: p for key, p in self._parts.items() if self._age(p, now) <= limit}
            if not fresh:
                raise InvalidError("stale", f"older than {settings.source_timeout:g} s")
            self._parts = fresh
        return np.concatenate([self._placed(part, frames, now) for part in self._parts.values()])

    def _age(self, part: Part, now: int) -> int:
        """Return the age (ns) by the stamp, and where it is strict by receipt if that is longer."""
        stamp = stamp_from_ros(part.header.stamp)
        if not self.strict:
            return now - stamp
        if stamp - now > MOST_AHEAD:  # the clock of the node was set back
            return FOREVER
        return max(now - stamp, now - part.received)

    def _placed(self, part: Part, frames: BaseFrames, now: int) -> Floats:
        points, settings = part.points, self.settings
        pose = frames.place(part.header.frame_id, stamp_from_ros(part.header.stamp), now, True)
        if settings.type != CLOUD:
            return placed(pose, points)
        if settings.min_range > 0.0:
            points = points[np.einsum("ni,ni->n", *[points[:, :3]] * 2) >= settings.min_range**2]
        there = placed(pose, points[:, :3])
        heights = points[:, 3] if settings.use_global_height else there[:, 2]
        return there[(heights >= settings.min_height) & (heights <= settings.max_height)]


def polygon_from_bytes(data: bytes) -> tuple[int, Floats, Header]:
    """Return id, corners (n, 3) and header of a PolygonInstanceStamped; RefusedError."""
    reader = Reader(data, PolygonInstanceStamped)
    header = reader.header()
    corners = reader.singles(3 * reader.count(CORNER_BYTES)).reshape(-1, 3).astype(np.float64)
    (number,) = reader.numbers(NUMBER, 8)
    reader.end()
    return int(number), corners, header


def placed(pose: Floats, points: Floats) -> Floats:
    """Return points (n, 3) in the frame in which their own frame has a pose (7,)."""
    (position,), (rotation,) = as_poses(pose[None], warn=False)
    return np.einsum("ij,nj->ni", rotation, points) + position


def without(points: Floats, regions: Iterable[Exclusion], frames: BaseFrames, now: int) -> Floats:
    """Return points (n, 3) without those in regions; one that cannot be placed masks nothing."""
    for region in regions:
        try:
            pose = frames.place(region.frame, now, now)
        except InvalidError:
            continue
        there = placed(inverse_poses(pose[None])[0], points)
        inside = np.empty(len(points), np.bool_)
        count_inside(there, region.corners, 0.0, inside)
        inside &= (there[:, 2] >= region.min_height) & (there[:, 2] <= region.max_height)
        points = points[~inside]
    return points
