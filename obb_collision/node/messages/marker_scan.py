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

"""Marker arrays out of their serialised bytes, without Python message objects.

rclpy takes 75 us and more to make one Marker of a message, before any callback: 20,000 would stop
the cycles for seconds. Here the bytes (plain little-endian CDR, OMG DDS-RTPS, 10.5) are walked once
by a kernel that writes where everything is. Every length and count is checked against what is left
of the message before it is used, in 64 bits, where none of them can wrap. A message that is cut
short or contradicts itself is refused whole, whatever stood before the fault: where one length is
wrong, the rest can't be trusted either.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import MarkerArray

from obb_collision._jit import njit
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_writer import ENCAPSULATION
from obb_collision.typing import Floats

MALFORMED = "malformed message"
"""Reason: the bytes are no MarkerArray."""
ORIGIN = len(ENCAPSULATION)
"""Numbers are aligned to their size, counted from here."""
SMALLEST_MARKER = 180
"""Bytes of a marker whose texts and lists are all empty, at least."""
HALF = 1 << 31
"""Of the numbers that four bytes can be."""
LONGEST_TAIL = 7
"""Bytes that may follow the last marker: payloads are padded, to four bytes as a rule."""

Bytes = npt.NDArray[np.uint8]

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
def _whole(data: Bytes, at: int) -> int:
    """Return the unsigned number of four bytes."""
    low = np.int64(data[at]) | (np.int64(data[at + 1]) << 8)
    high = np.int64(data[at + 2]) | (np.int64(data[at + 3]) << 8)
    return int(low | (high << 16))


@njit
def _signed(data: Bytes, at: int) -> int:
    number = _whole(data, at)
    return number - 2 * HALF if number >= HALF else number


@njit
def _aligned(at: int, size: int) -> int:
    """Return the next place that is a multiple of ``size``, a power of two."""
    return at + ((ORIGIN - at) & (size - 1))


@njit
def _text(data: Bytes, at: int) -> tuple[int, int, int]:
    """Return where a text begins, its length, and where it ends: -1 if it is none."""
    at = _aligned(at, 4)
    if at + 4 > len(data):
        return 0, 0, -1
    size = _whole(data, at)
    at += 4
    if size == 0:  # not by the standard, but some write it
        return at, 0, at
    if size > len(data) - at or data[at + size - 1] != 0:
        return 0, 0, -1
    return at, size - 1, at + size


@njit
def _list(data: Bytes, at: int, item: int, alignment: int) -> tuple[int, int, int]:
    """Return where a list of items of some bytes begins, its length, and where it ends, or -1."""
    at = _aligned(at, 4)
    if at + 4 > len(data):
        return 0, 0, -1
    count = _whole(data, at)
    at += 4
    if count == 0:
        return at, 0, at
    at = _aligned(at, alignment)
    if at > len(data) or count > (len(data) - at) // item:
        return 0, 0, -1
    return at, count, at + count * item


@njit
def _equal(data: Bytes, a: int, b: int, size: int) -> bool:
    same = True
    for k in range(size):
        same &= data[a + k] == data[b + k]
    return same


@njit
def _head(data: Bytes, at: int, row: npt.NDArray[np.int64]) -> int:
    """Read header, namespace, id, type and action; return where they end, or -1."""
    at = _aligned(at, 4)
    if at + 8 > len(data):
        return -1
    row[STAMP_SEC] = _signed(data, at)
    row[STAMP_NANOSEC] = _whole(data, at + 4)
    row[FRAME], row[FRAME + 1], at = _text(data, at + 8)
    if at < 0:
        return -1
    row[NS], row[NS + 1], at = _text(data, at)
    if at < 0:
        return -1
    at = _aligned(at, 4)
    if at + 12 > len(data):
        return -1
    row[ID] = _signed(data, at)
    row[TYPE] = _signed(data, at + 4)
    row[ACTION] = _signed(data, at + 8)
    return at + 12


@njit
def _body(data: Bytes, at: int, row: npt.NDArray[np.int64], bits: npt.NDArray[np.uint64]) -> int:
    """Read pose, scale, lifetime and frame_locked; return where they end, or -1."""
    at = _aligned(at, 8)
    if at + 8 * FLOATS + 16 + 8 + 1 > len(data):
        return -1
    for k in range(FLOATS):
        value = np.uint64(0)
        for byte in range(8):
            value |= np.uint64(data[at + 8 * k + byte]) << np.uint64(8 * byte)
        bits[k] = value
    at += 8 * FLOATS + 16  # color
    row[LIFETIME_SEC] = _signed(data, at)
    row[LIFETIME_NANOSEC] = _whole(data, at + 4)
    row[LOCKED] = data[at + 8]
    return at + 9 if data[at + 8] <= 1 else -1


@njit
def _skip_texture(data: Bytes, at: int) -> int:
    """Return where texture_resource, texture and uv_coordinates end, or -1."""
    _, _, at = _text(data, at)
    if at < 0:
        return -1
    at = _aligned(at, 4) + 8  # stamp
    if at > len(data):
        return -1
    for _ in range(2):  # frame_id and format
        _, _, at = _text(data, at)
        if at < 0:
            return -1
    _, _, at = _list(data, at, 1, 1)
    if at < 0:
        return -1
    _, _, at = _list(data, at, 8, 4)
    return at


@njit
def _tail(data: Bytes, at: int, row: npt.NDArray[np.int64]) -> int:
    """Read lists, texts and mesh; return where the marker ends, or -1."""
    row[POINTS], row[POINTS + 1], at = _list(data, at, 24, 8)
    if at < 0:
        return -1
    _, _, at = _list(data, at, 16, 4)  # colors
    if at < 0:
        return -1
    at = _skip_texture(data, at)
    if at < 0:
        return -1
    _, _, at = _text(data, at)
    if at < 0:
        return -1
    row[MESH], row[MESH + 1], at = _text(data, at)
    if at < 0:
        return -1
    row[FILE], row[FILE + 1], at = _text(data, at)
    if at < 0:
        return -1
    row[CONTENT], row[CONTENT + 1], at = _list(data, at, 1, 1)
    if at < 0 or at + 1 > len(data) or data[at] > 1:  # mesh_use_embedded_materials
        return -1
    return at + 1


@njit
def _scan(
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
                row[same] = size == last[column + 1] and _equal(
                    data, row[column], last[column], size
                )
    return len(integers), at


class Scanned(NamedTuple):
    """A message: its bytes, whole numbers (n, ...) by the columns above, and pose and scale."""

    data: bytes
    integers: npt.NDArray[np.int64]
    floats: Floats

    def __len__(self) -> int:
        return len(self.integers)

    def text(self, row: int, column: int) -> bytes:
        """Return a text of a marker as it stands in the message."""
        at, size = self.integers[row, column : column + 2].tolist()
        return self.data[at : at + size]

    def points(self, row: int) -> Floats:
        """Return the points (k, 3) of a marker, as a view of the message."""
        at, count = self.integers[row, POINTS : POINTS + 2].tolist()
        return np.frombuffer(self.data, "<f8", 3 * count, at if count else 0).reshape(-1, 3)

    def alone(self, row: int) -> Scanned:
        """Return what one marker says of its shape, without the message it stood in."""
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
    """Return what stands where in a serialised MarkerArray; RefusedError ("malformed message")."""
    if data[:2] != ENCAPSULATION[:2]:
        data = _rewritten(data)
    if len(data) < ORIGIN + 4:
        raise RefusedError(MALFORMED, f"{len(data)} bytes")
    count = int.from_bytes(data[ORIGIN : ORIGIN + 4], "little")
    if count * SMALLEST_MARKER > len(data):
        raise RefusedError(MALFORMED, f"{count} markers in {len(data)} bytes")
    integers = np.zeros((count, len(INTEGERS)), np.int64)
    bits = np.empty((count, FLOATS), np.uint64)
    sound, end = _scan(np.frombuffer(data, np.uint8), integers, bits)
    if sound < count:
        raise RefusedError(MALFORMED, f"marker {sound} of {count} is cut short or no marker")
    if len(data) - end > LONGEST_TAIL:
        raise RefusedError(MALFORMED, f"{len(data) - end} bytes behind the last of {count} markers")
    return Scanned(data, integers, bits.view(np.float64))


def _rewritten(data: bytes) -> bytes:
    """Return a message of another encoding in plain little-endian CDR, by way of rclpy."""
    try:
        message: Any = deserialize_message(data, MarkerArray)
        result: bytes = serialize_message(message)
    except Exception as error:
        raise RefusedError(MALFORMED, f"encoding {data[:2].hex()!r}: {error}") from error
    if result[:2] != ENCAPSULATION[:2]:
        raise RefusedError(MALFORMED, "no little-endian encoding here")
    return result
