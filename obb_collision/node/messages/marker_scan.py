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
by a kernel that writes where everything is (``marker_kernels``). A message that is cut short or
contradicts itself is refused whole, whatever stood before the fault: where one length is wrong, the
rest can't be trusted either.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import MarkerArray

from obb_collision.node.messages.cdr import LONGEST_TAIL, MALFORMED, as_plain
from obb_collision.node.messages.cdr_kernels import ORIGIN
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_kernels import (
    CONTENT,
    FILE,
    FLOATS,
    INTEGERS,
    MESH,
    POINTS,
    scan,
)
from obb_collision.typing import Floats

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
