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

"""Kernels that walk the bytes of a MarkerArray and write where everything is, and their columns.

Plain little-endian CDR (OMG DDS-RTPS, 10.5). Every length and count is checked against what is left
of the message before it is used, in 64 bits, where none of them can wrap.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from obb_collision._jit import njit
from obb_collision.node.messages.marker_writer import ENCAPSULATION

ORIGIN = len(ENCAPSULATION)
"""Numbers are aligned to their size, counted from here."""
HALF = 1 << 31
"""Of the numbers that four bytes can be."""

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
                row[same] = size == last[column + 1] and _equal(
                    data, row[column], last[column], size
                )
    return len(integers), at
