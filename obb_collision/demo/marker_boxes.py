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

"""The boxes of ``~/markers`` out of the message's bytes: rclpy takes 130 µs to make one marker."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import Marker

from obb_collision.node.messages.box_markers import COLORS, DOUBTFUL
from obb_collision.node.messages.conversions import NANOSECONDS, name_from_key
from obb_collision.node.messages.marker_kernels import (
    ACTION,
    FRAME,
    ID,
    NS,
    POINTS,
    STAMP_NANOSEC,
    STAMP_SEC,
    TYPE,
)
from obb_collision.node.messages.marker_scan import Scanned, scan_markers
from obb_collision.typing import Floats

Color = tuple[float, float, float]

#: Bytes from where a marker's colour begins to where its points do: colour, lifetime, frame_locked,
#: three of alignment, count.
COLOR_TO_POINTS = 32


class MarkerBoxes(NamedTuple):
    """Boxes of n objects: names, poses (n, 7), edge lengths (n, 3), stale or refused ones (n,).

    lines: ends (2 k, 3) and colour, where the node draws edges and not boxes. frame, stamp (ns): of
    the message, "" and -1 before the first one.
    """

    names: list[str]
    poses: Floats
    sizes: Floats
    doubtful: npt.NDArray[np.bool_]
    lines: list[tuple[Floats, Color]]
    frame: str
    stamp: int


NO_BOXES = MarkerBoxes([], np.empty((0, 7)), np.empty((0, 3)), np.empty(0, np.bool_), [], "", -1)


def boxes_from_bytes(data: bytes) -> MarkerBoxes:
    """Return the boxes of a serialised MarkerArray. RefusedError if it is none."""
    scanned = scan_markers(data)
    if not len(scanned):
        return NO_BOXES
    columns = scanned.integers
    starts = columns[:, POINTS] - COLOR_TO_POINTS
    octets = np.frombuffer(scanned.data, np.uint8)[starts[:, None] + np.arange(12)]
    colors = octets.view("<f4").astype(np.float64)
    added = columns[:, ACTION] == Marker.ADD
    cubes = np.flatnonzero(added & (columns[:, TYPE] == Marker.CUBE))
    lines = np.flatnonzero(added & (columns[:, TYPE] == Marker.LINE_LIST)).tolist()
    stamps = columns[:, STAMP_SEC] * NANOSECONDS + columns[:, STAMP_NANOSEC]
    return MarkerBoxes(
        [_name(scanned, row) for row in cubes.tolist()],
        scanned.floats[cubes, :7],
        scanned.floats[cubes, 7:],
        np.abs(colors[cubes] - COLORS[DOUBTFUL][:3]).max(axis=1, initial=0.0) < 1e-3,
        [(scanned.points(row), tuple(colors[row].tolist())) for row in lines],
        scanned.text(0, FRAME).decode(errors="replace"),
        int(stamps.max()),
    )


def _name(scanned: Scanned, row: int) -> str:
    namespace = scanned.text(row, NS).decode(errors="replace")
    return name_from_key((namespace, int(scanned.integers[row, ID])))
