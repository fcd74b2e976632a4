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

"""The world boxes as markers for RViz: free green, colliding red, stale or refused grey.

rclpy takes 30 us and more to make and serialise one Marker, and a microsecond for every point of
a list: a few thousand boxes would stop the cycle for a tenth of a second. ``publish`` takes
serialised messages too, so the bytes are written here, see ``cdr``. The fields follow
visualization_msgs/msg/Marker; a test reads the bytes back with rclpy.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import Marker

from obb_collision.boxes import Boxes
from obb_collision.geometry.poses import IDENTITY
from obb_collision.node.messages.cdr import ENCAPSULATION, padded, written_text
from obb_collision.node.messages.conversions import NANOSECONDS, Key
from obb_collision.typing import Floats

NO_POINTS: Floats = np.empty((0, 3))
NO_SIZE = (0.0, 0.0, 0.0)
CLEAR = (0.0, 0.0, 0.0, 0.0)
EMPTY_TAIL = b"".join(
    (
        *(bytes(4), padded("")),  # colors, texture_resource
        *(bytes(8), padded(""), padded(""), bytes(8)),  # texture, uv_coordinates
        *(padded(""), padded(""), padded(""), bytes(5)),  # text, mesh_resource, mesh_file
    )
)
"""The fields behind ``points``, all empty; the last byte is mesh_use_embedded_materials."""


class MarkerArrayWriter:
    """Serialises a MarkerArray marker by marker; all share frame, stamp and lifetime."""

    def __init__(self, frame: str, stamp: int, lifetime: float) -> None:
        self._count = 0
        self._bytes = bytearray(ENCAPSULATION + bytes(4))
        self._head = struct.pack("<iI", *divmod(stamp, NANOSECONDS)) + written_text(frame)
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
        self._bytes += written_text(key[0])
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
        self._bytes += EMPTY_TAIL
        self._count += 1

    def _align(self, size: int) -> None:
        self._bytes += bytes(-(len(self._bytes) - len(ENCAPSULATION)) % size)

    def message(self) -> bytes:
        """Return the serialised MarkerArray."""
        struct.pack_into("<I", self._bytes, len(ENCAPSULATION), self._count)
        return bytes(self._bytes)


FREE, COLLIDING, DOUBTFUL = 0, 1, 2
COLORS = ((0.1, 0.8, 0.2, 0.5), (0.9, 0.1, 0.1, 0.7), (0.5, 0.5, 0.5, 0.6))
"""Red, green, blue, alpha of free, colliding and doubtful (stale or refused) boxes."""
LINES_NAMESPACE = "world_boxes"
"""Namespace of the LINE_LIST markers; their ids are the numbers of the colours."""
THINNEST = 1e-6
"""Least edge length drawn (m): RViz reports an error for a flat CUBE."""

SIGNS = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])
"""(12, 2) corners that an edge joins, numbered as in SIGNS."""


def edge_points(boxes: Boxes) -> Floats:
    """Return the ends (24 n, 3), metres, of the 12 edges of each of n boxes."""
    local = SIGNS * boxes.half_extents[:, None]
    corners = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, local)
    return corners[:, EDGES].reshape(-1, 3)


class Markers:
    """Writes ``~/markers``: complete each time, with a DELETE per object that no longer exists."""

    def __init__(self, frame: str) -> None:
        self._frame = frame
        self.shown: dict[Key, int] = {}
        """The markers that were written last, with their kinds."""

    def write(
        self,
        keys: list[Key],
        boxes: Boxes,
        colors: npt.NDArray[np.int64],
        stamp: int,
        lifetime: float,
        line_width: float | None,
    ) -> bytes:
        """Return the serialised MarkerArray of n keys, boxes and colours (index into COLORS).

        ``line_width`` (m) selects LINE_LIST markers, one per colour; None for one CUBE per box.
        """
        writer = MarkerArrayWriter(self._frame, stamp, lifetime)
        if line_width is None:
            shown = dict.fromkeys(keys, Marker.CUBE)
        else:
            keys = [(LINES_NAMESPACE, int(color)) for color in np.unique(colors)]
            shown = dict.fromkeys(keys, Marker.LINE_LIST)
        self._delete(writer, [key for key in self.shown if key not in shown])
        self.shown = shown
        if line_width is None:
            poses = np.hstack((boxes.centers, boxes.quaternions))
            sizes = np.maximum(2.0 * boxes.half_extents, THINNEST).tolist()
            rows = zip(keys, poses.tolist(), sizes, colors.tolist(), strict=True)
            for key, pose, size, color in rows:
                writer.add(key, Marker.CUBE, Marker.ADD, pose, size, COLORS[color])
            return writer.message()
        points, size = edge_points(boxes).reshape(-1, 24, 3), (line_width, 0.0, 0.0)
        for key in keys:
            ends, look = points[colors == key[1]].reshape(-1, 3), COLORS[key[1]]
            writer.add(key, Marker.LINE_LIST, Marker.ADD, IDENTITY, size, look, ends)
        return writer.message()

    def _delete(self, writer: MarkerArrayWriter, keys: list[Key]) -> None:
        for key in keys:
            writer.add(key, self.shown[key], Marker.DELETE)

    def clear(self, stamp: int) -> bytes:
        """Return the serialised MarkerArray that deletes all boxes."""
        writer = MarkerArrayWriter(self._frame, stamp, 0.0)
        self._delete(writer, list(self.shown))
        self.shown = {}
        return writer.message()
