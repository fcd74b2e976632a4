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

"""A flat square frame with nothing in its middle: its box meets what its triangles do not."""

from __future__ import annotations

from geometry_msgs.msg import Point
from rig import Rig, cube
from visualization_msgs.msg import Marker

from obb_collision import Accuracy
from obb_collision.node import collisions_from_ros

RING, ROD, CRATE = ("mesh", 1), ("mesh", 2), ("box", 1)
SQUARE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
"""Corners of a frame, around whose middle nothing is."""


def frame_points(half: float = 1.0, width: float = 0.25) -> list[Point]:
    """Triangles of a flat square frame: what is in its middle is in its box, and meets no part."""
    points = []
    for (x, y), (u, v) in zip(SQUARE, (*SQUARE[1:], SQUARE[0]), strict=True):
        inner = 1.0 - width / half
        quad = [(x, y), (u, v), (inner * u, inner * v), (inner * x, inner * y)]
        for corner in (0, 1, 2, 0, 2, 3):
            a, b = quad[corner]
            points.append(Point(x=half * a, y=half * b, z=0.0))
    return points


def ring(key: tuple[str, int] = RING) -> Marker:
    return cube(key, type=Marker.TRIANGLE_LIST, points=frame_points())


def crate(key: tuple[str, int] = CRATE, x: float = 0.0) -> Marker:
    return cube(key, (x, 0.0, 0.0), (0.5, 0.5, 0.5))


def levels(rig: Rig) -> list[str]:
    """Names of the levels of the pairs in the next message."""
    rows = collisions_from_ros(rig.next("collisions"))
    return [Accuracy(level).name.lower() for level in rows["accuracy"].tolist()]
