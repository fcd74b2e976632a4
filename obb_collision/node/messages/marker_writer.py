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

"""Marker arrays, and the table of namespaces, as bytes written without Python message objects.

rclpy takes 30 us and more to make and serialise one Marker, and a microsecond for every point of
a list: a few thousand boxes would stop the cycle for a tenth of a second. ``publish`` takes
serialised messages too, so the bytes are written here: little-endian plain CDR, every number
aligned to its size, counted from the end of the four bytes of encapsulation (OMG DDS-RTPS, 10.5).
The fields follow visualization_msgs/msg/Marker; a test reads the bytes back with rclpy.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

import numpy as np

from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.typing import Floats

ENCAPSULATION = b"\x00\x01\x00\x00"
NO_POINTS: Floats = np.empty((0, 3))
IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
NO_SIZE = (0.0, 0.0, 0.0)
CLEAR = (0.0, 0.0, 0.0, 0.0)


class MarkerArrayWriter:
    """Serialises a MarkerArray marker by marker; all share frame, stamp and lifetime."""

    def __init__(self, frame: str, stamp: int, lifetime: float) -> None:
        self._count = 0
        self._bytes = bytearray(ENCAPSULATION + bytes(4))
        self._head = struct.pack("<iI", *divmod(stamp, NANOSECONDS)) + _string(frame)
        whole, rest = divmod(round(lifetime * NANOSECONDS), NANOSECONDS)
        self._lifetime = struct.pack("<iI", whole, rest)

    def add(
        self,
        key: tuple[str, int],
        kind: int,
        action: int,
        pose: Sequence[float] = IDENTITY,
        scale: Sequence[float] = NO_SIZE,
        color: Sequence[float] = CLEAR,
        points: Floats = NO_POINTS,
    ) -> None:
        """Append a marker: key (ns, id), type and action; points (n, 3)."""
        self._align(4)
        self._bytes += self._head
        self._align(4)
        self._bytes += _string(key[0])
        self._align(4)
        self._bytes += struct.pack("<iii", key[1], kind, action)
        self._align(8)
        self._bytes += struct.pack("<10d4f", *pose, *scale, *color)
        self._bytes += self._lifetime + b"\x00"  # not frame_locked
        self._align(4)
        self._bytes += struct.pack("<I", len(points))
        if len(points):
            self._align(8)
            self._bytes += np.ascontiguousarray(points, dtype="<f8").tobytes()
        self._finish()
        self._count += 1

    def _finish(self) -> None:
        """Append the fields behind ``points``, all empty."""
        self._bytes += bytes(4)  # colors
        self._string("")  # texture_resource
        self._bytes += bytes(8)  # texture.header.stamp
        self._string("")  # texture.header.frame_id
        self._string("")  # texture.format
        self._bytes += bytes(8)  # texture.data, uv_coordinates
        self._string("")  # text
        self._string("")  # mesh_resource
        self._string("")  # mesh_file.filename
        self._bytes += bytes(5)  # mesh_file.data, mesh_use_embedded_materials

    def _string(self, text: str) -> None:
        self._bytes += _string(text)
        self._align(4)

    def _align(self, size: int) -> None:
        self._bytes += bytes(-(len(self._bytes) - len(ENCAPSULATION)) % size)

    def message(self) -> bytes:
        """Return the serialised MarkerArray."""
        struct.pack_into("<I", self._bytes, len(ENCAPSULATION), self._count)
        return bytes(self._bytes)


def namespace_bytes(names: Mapping[int, str]) -> bytes:
    """Return the serialised table of namespaces by number, as ``namespaces_to_ros`` makes it.

    A table of 20,000 takes rclpy 0.2 s, and this a tenth of it.
    """
    head = b"\x00" + bytes(3)  # level OK
    texts = ["namespaces", f"{len(names)} namespaces", ""]
    parts = [ENCAPSULATION, head, *map(padded, texts), struct.pack("<I", len(names))]
    for number, name in names.items():
        parts += padded(str(number)), padded(name)
    return b"".join(parts)


def padded(text: str) -> bytes:
    """Return a text as it stands where it begins, and the next one does, at a multiple of 4."""
    data = _string(text)
    return data + bytes(-len(data) % 4)


def _string(text: str) -> bytes:
    data = text.encode() + b"\x00"
    return struct.pack("<I", len(data)) + data
