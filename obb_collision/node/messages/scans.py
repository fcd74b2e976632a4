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

"""LaserScan and Range -> points in the frame of the sensor, by REP 117.

A range that is infinite or beyond ``range_max`` means that nothing is within range. One that is not
a number or below ``range_min`` is invalid: it says nothing.
"""

from __future__ import annotations

from struct import Struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import LaserScan, Range

from obb_collision.node.messages.cdr import TOO_MANY_POINTS, Header, Reader
from obb_collision.node.messages.errors import RefusedError
from obb_collision.typing import Floats, Mask

BAD_SCAN, BAD_RANGE = "bad scan", "bad range"
NOTHING_VALID = "no valid measurement"
"""Reason: all ranges or points of a message are invalid, as those of a covered sensor."""
LONGEST_SCAN = 60.0
"""Seconds from the first ray of a scan to the last, at most."""
HEAD, ECHO, KIND = Struct("<7f"), Struct("<4f"), Struct("<B")
RINGS = 4
"""Circles of balls by which the cap of a cone is covered, besides the one at its centre."""


class ScanMessage(NamedTuple):
    """A sensor_msgs/LaserScan: angles (rad), time_increment (s), limits and ranges (n,) (m)."""

    header: Header
    angle_min: float
    angle_increment: float
    time_increment: float
    range_min: float
    range_max: float
    ranges: npt.NDArray[np.float32]


class RangeMessage(NamedTuple):
    """A sensor_msgs/Range: the angle of its cone (rad), and ranges (m)."""

    header: Header
    field_of_view: float
    min_range: float
    max_range: float
    range: float


def scan_from_bytes(data: bytes) -> ScanMessage:
    """Return the scan in a LaserScan; RefusedError ("malformed message", "bad scan")."""
    reader = Reader(data, LaserScan)
    header = reader.header()
    first, _, step, delay, _, least, most = reader.numbers(HEAD)
    ranges, _ = (reader.singles(reader.count(4)) for _ in range(2))
    reader.end()
    scan = ScanMessage(header, first, step, delay, least, most, ranges)
    if not np.isfinite(scan[1:4]).all() or np.isnan(scan[4:6]).any():
        names = ", ".join(scan._fields[1:6])
        raise RefusedError(BAD_SCAN, f"not finite: {names} = {scan[1:6]}")
    duration = abs(scan.time_increment) * len(ranges)
    if duration > LONGEST_SCAN:
        raise RefusedError(BAD_SCAN, f"it takes {duration:g} s, {LONGEST_SCAN:g} is the limit")
    return scan


def range_from_bytes(data: bytes) -> RangeMessage:
    """Return the range in a Range; RefusedError ("malformed message", "bad range").

    Messages from before ROS 2 Jazzy have no variance.
    """
    reader = Reader(data, Range)
    header = reader.header()
    reader.numbers(KIND, 1)
    angle, least, most, distance = reader.numbers(ECHO)
    reader.end()
    if not 0.0 <= angle <= 2.0 * np.pi or np.isnan((least, most)).any():
        limits = f"min_range {least}, max_range {most}"
        raise RefusedError(BAD_RANGE, f"field_of_view {angle}, {limits}")
    return RangeMessage(header, angle, least, most, distance)


def points_of_scan(scan: ScanMessage, most: int) -> tuple[Floats, Mask, int]:
    """Return the points (k, 3) of a scan, which rays (n,) hit them, and how many rays are invalid.

    RefusedError ("too many points") for more rays than ``most``, ("no valid measurement") if all
    are invalid.
    """
    ranges = scan.ranges.astype(np.float64)
    if len(ranges) > most:
        raise RefusedError(TOO_MANY_POINTS, f"{len(ranges)}, {most} is the limit")
    invalid = ~(ranges >= scan.range_min)
    if invalid.all():
        raise RefusedError(NOTHING_VALID, f"none of {len(ranges)} ranges is valid")
    hit = ~invalid & (ranges <= scan.range_max) & np.isfinite(ranges)
    angles = scan.angle_min + scan.angle_increment * np.flatnonzero(hit)
    points = np.zeros((len(angles), 3))
    points[:, 0], points[:, 1] = ranges[hit] * np.cos(angles), ranges[hit] * np.sin(angles)
    return points, hit, int(np.count_nonzero(invalid))


def points_of_range(message: RangeMessage) -> tuple[Floats, float]:
    """Return points (k, 3) on the cap of a cone about x, and the radius (m) of balls that cover it.

    There are no points if nothing is within range. RefusedError ("no valid measurement").
    """
    distance = message.range
    if not distance >= message.min_range:
        raise RefusedError(NOTHING_VALID, f"range {distance}, min_range {message.min_range}")
    if distance > message.max_range or np.isinf(distance):
        return np.empty((0, 3)), 0.0
    step = 0.5 * message.field_of_view / RINGS
    off = np.concatenate([[0.0], *(np.full(6 * k, k * step) for k in range(1, RINGS + 1))])
    turns = [np.arange(6 * k) * (np.pi / (3 * k)) for k in range(1, RINGS + 1)]
    around = np.concatenate([[0.0], *turns])
    side = np.sin(off)
    cap = np.column_stack([np.cos(off), side * np.cos(around), side * np.sin(around)])
    # of the cap no point is farther than half a step from a circle, and half the distance of two
    # neighbours, which is at most a sixth of pi in steps, along it
    return distance * cap, distance * step * (0.5 + np.pi / 6.0) * (1.0 + 1e-9)
