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

"""Parsing serialised MarkerArrays without Python message objects.

rclpy takes 75 us and more to make one Marker of a message, before any callback: 20,000 would stop
the cycles for seconds. Here the bytes (plain little-endian CDR, OMG DDS-RTPS, 10.5) are walked once
by a kernel that writes where everything is. A message that is cut short or contradicts itself is
refused whole, whatever stood before the fault: where one length is wrong, the rest can't be trusted
either.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import MarkerArray

from obb_collision._jit import njit
from obb_collision.node.messages.cdr import (
    LONGEST_TAIL,
    MALFORMED,
    ORIGIN,
    Bytes,
    aligned,
    as_plain,
    doubles,
    equal,
    items,
    signed,
    text,
    whole,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.typing import Floats

INTEGERS = (
    "id",
    "type",
    "action",
    "locked",
    "stamp_sec",
    "stamp_nanosec",
    "lifetime_sec",
    "lifetime_nanosec",
    "frame",
    "frame_size",
    "ns",
    "ns_size",
    "points",
    "point_count",
    "mesh",
    "mesh_size",
    "file",
    "file_size",
    "content",
    "content_size",
    "same_frame",
    "same_ns",
)
"""Columns of whole numbers of a marker: for texts and lists, where they begin and their length."""
(ID, TYPE, ACTION, LOCKED, STAMP_SEC, STAMP_NANOSEC, LIFETIME_SEC, LIFETIME_NANOSEC) = range(8)
FRAME, NS, POINTS, MESH, FILE, CONTENT = range(8, 20, 2)
SAME_FRAME, SAME_NS = 20, 21
"""Whether frame and namespace are those of the marker before."""
FLOATS = 10
"""Position, quaternion x y z w and scale."""


@njit
def _head(data: Bytes, at: int, row: npt.NDArray[np.int64]) -> int:
    """Read header, namespace, id, type and action; return where they end, or -1."""
    at = aligned(at, 4)
    if at + 8 > len(data):
        return -1
    row[STAMP_SEC] = signed(data, at)
    row[STAMP_NANOSEC] = whole(data, at + 4)
    row[FRAME], row[FRAME + 1], at = text(data, at + 8)
    if at < 0:
        return -1
    row[NS], row[NS + 1], at = text(data, at)
    if at < 0:
        return -1
    at = aligned(at, 4)
    if at + 12 > len(data):
        return -1
    row[ID] = signed(data, at)
    row[TYPE] = signed(data, at + 4)
    row[ACTION] = signed(data, at + 8)
    return at + 12


@njit
def _body(data: Bytes, at: int, row: npt.NDArray[np.int64], bits: npt.NDArray[np.uint64]) -> int:
    """Read pose, scale, lifetime and frame_locked; return where they end, or -1."""
    at = aligned(at, 8)
    if at + 8 * FLOATS + 16 + 8 + 1 > len(data):
        return -1
    doubles(data, at, bits)
    at += 8 * FLOATS + 16  # color
    row[LIFETIME_SEC] = signed(data, at)
    row[LIFETIME_NANOSEC] = whole(data, at + 4)
    row[LOCKED] = data[at + 8]
    return at + 9 if data[at + 8] <= 1 else -1


@njit
def _skip_texture(data: Bytes, at: int) -> int:
    """Return where texture_resource, texture and uv_coordinates end, or -1."""
    _, _, at = text(data, at)
    if at < 0:
        return -1
    at = aligned(at, 4) + 8  # stamp
    if at > len(data):
        return -1
    for _ in range(2):  # frame_id and format
        _, _, at = text(data, at)
        if at < 0:
            return -1
    _, _, at = items(data, at, 1, 1)
    if at < 0:
        return -1
    _, _, at = items(data, at, 8, 4)
    return at


@njit
def _tail(data: Bytes, at: int, row: npt.NDArray[np.int64]) -> int:
    """Read lists, texts and mesh; return where the marker ends, or -1."""
    row[POINTS], row[POINTS + 1], at = items(data, at, 24, 8)
    if at < 0:
        return -1
    _, _, at = items(data, at, 16, 4)  # colors
    if at < 0:
        return -1
    at = _skip_texture(data, at)
    if at < 0:
        return -1
    _, _, at = text(data, at)
    if at < 0:
        return -1
    row[MESH], row[MESH + 1], at = text(data, at)
    if at < 0:
        return -1
    row[FILE], row[FILE + 1], at = text(data, at)
    if at < 0:
        return -1
    row[CONTENT], row[CONTENT + 1], at = items(data, at, 1, 1)
    if at < 0 or at + 1 > len(data) or data[at] > 1:  # mesh_use_embedded_materials
        return -1
    return at + 1


@njit
def scan(
    data: Bytes, integers: npt.NDArray[np.int64], bits: npt.NDArray[np.uint64]
) -> tuple[int, int]:
    """Fill one row per marker; return how many are sound, and where the last of them ends."""
    at = ORIGIN + 4
    for n in range(len(integers)):
        row = integers[n]
        end = _head(data, at, row)
        if end >= 0:
            end = _body(data, end, row, bits[n])
        if end >= 0:
            end = _tail(data, end, row)
        if end < 0:
            return n, at
        at = end
        if n > 0:
            last = integers[n - 1]
            for column, same in ((FRAME, SAME_FRAME), (NS, SAME_NS)):
                size = row[column + 1]
                row[same] = size == last[column + 1] and equal(
                    data, row[column], last[column], size
                )
    return len(integers), at


SMALLEST_MARKER = 180
"""Bytes of a marker whose texts and lists are all empty, at least."""


class Scanned(NamedTuple):
    """A message: its bytes, whole numbers (n, ...) by the columns above, and pose and scale."""

    data: bytes
    integers: npt.NDArray[np.int64]
    floats: Floats

    def __len__(self) -> int:
        return len(self.integers)

    def text(self, row: int, column: int) -> bytes:
        """Return the raw bytes of a text of a marker."""
        at, size = self.integers[row, column : column + 2].tolist()
        return self.data[at : at + size]

    def points(self, row: int) -> Floats:
        """Return the points (k, 3) of a marker, as a view of the message."""
        at, count = self.integers[row, POINTS : POINTS + 2].tolist()
        return np.frombuffer(self.data, "<f8", 3 * count, at if count else 0).reshape(-1, 3)

    def alone(self, row: int) -> Scanned:
        """Return the shape of one marker, without the rest of its message."""
        integers, data = self.integers[row : row + 1].copy(), b""
        for column, item in ((POINTS, 24), (MESH, 1), (FILE, 1), (CONTENT, 1)):
            at, count = self.integers[row, column : column + 2].tolist()
            integers[0, column] = len(data)
            data += self.data[at : at + item * count]
        return Scanned(data, integers, self.floats[row : row + 1].copy())

    @property
    def nbytes(self) -> int:
        """Memory that this takes."""
        return len(self.data) + self.integers.nbytes + self.floats.nbytes

    def content(self, row: int) -> memoryview:
        """Return the bytes of an embedded mesh."""
        at, size = self.integers[row, CONTENT : CONTENT + 2].tolist()
        return memoryview(self.data)[at : at + size]


def scan_markers(data: bytes) -> Scanned:
    """Return the parsed layout of a serialised MarkerArray; RefusedError ("malformed message")."""
    data = as_plain(data, MarkerArray)
    if len(data) < ORIGIN + 4:
        raise RefusedError(MALFORMED, f"{len(data)} bytes")
    count = int.from_bytes(data[ORIGIN : ORIGIN + 4], "little")
    if count * SMALLEST_MARKER > len(data):
        raise RefusedError(MALFORMED, f"{count} markers in {len(data)} bytes")
    integers = np.zeros((count, len(INTEGERS)), np.int64)
    bits = np.empty((count, FLOATS), np.uint64)
    sound, end = scan(np.frombuffer(data, np.uint8), integers, bits)
    if sound < count:
        raise RefusedError(MALFORMED, f"marker {sound} of {count} is cut short or no marker")
    if len(data) - end > LONGEST_TAIL:
        raise RefusedError(MALFORMED, f"{len(data) - end} bytes behind the last of {count} markers")
    return Scanned(data, integers, bits.view(np.float64))
