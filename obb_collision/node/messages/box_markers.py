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

"""The world boxes as markers for RViz: free green, colliding red, stale or refused grey."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import Marker

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import quaternions_from_matrices
from obb_collision.node.messages.conversions import Key
from obb_collision.node.messages.marker_writer import MarkerArrayWriter
from obb_collision.typing import Floats

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
    """(24 n, 3) ends of the 12 edges of each of n boxes."""
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
        for key, kind in self.shown.items():
            if key not in shown:
                writer.add(key, kind, Marker.DELETE)
        self.shown = shown
        if line_width is None:
            _write_cubes(writer, keys, boxes, colors)
        else:
            _write_lines(writer, keys, boxes, colors, line_width)
        return writer.message()

    def clear(self, stamp: int) -> bytes:
        """Return the serialised MarkerArray that deletes all boxes."""
        writer = MarkerArrayWriter(self._frame, stamp, 0.0)
        for key, kind in self.shown.items():
            writer.add(key, kind, Marker.DELETE)
        self.shown = {}
        return writer.message()


def _write_cubes(
    writer: MarkerArrayWriter, keys: list[Key], boxes: Boxes, colors: npt.NDArray[np.int64]
) -> None:
    poses = np.hstack((boxes.centers, quaternions_from_matrices(boxes.rotations))).tolist()
    sizes = np.maximum(2.0 * boxes.half_extents, THINNEST).tolist()
    for key, pose, size, color in zip(keys, poses, sizes, colors.tolist(), strict=True):
        writer.add(key, Marker.CUBE, Marker.ADD, pose, size, COLORS[color])


def _write_lines(
    writer: MarkerArrayWriter,
    keys: list[Key],
    boxes: Boxes,
    colors: npt.NDArray[np.int64],
    width: float,
) -> None:
    points = edge_points(boxes).reshape(-1, 24, 3)
    for key in keys:
        ends = points[colors == key[1]].reshape(-1, 3)
        size = (width, 0.0, 0.0)
        writer.add(
            key, Marker.LINE_LIST, Marker.ADD, (0.0,) * 6 + (1.0,), size, COLORS[key[1]], ends
        )
