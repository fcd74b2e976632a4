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

"""Markers whose shapes are built beside the cycles, of a box and two bodies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from geometry_msgs.msg import Point
from rig import Rig, cube
from visualization_msgs.msg import Marker

BOX, BODY, OTHER = ("box", 1), ("body", 1), ("body", 2)
PAIR = {("box/1", "body/1")}


def named(pairs: set[tuple[str, str]]) -> set[frozenset[str]]:
    """Pairs whatever their order."""
    return {frozenset(pair) for pair in pairs}


def triangle(
    key: tuple[str, int] = BODY, size: float = 1.0, x: float = 0.0, **fields: Any
) -> Marker:
    """Return a TRIANGLE_LIST marker: one triangle, from the origin along x and y."""
    corners = ((0.0, 0.0), (size, 0.0), (0.0, size))
    points = [Point(x=u, y=v, z=0.0) for u, v in corners]
    return cube(key, (x, 0.0, 0.0), type=Marker.TRIANGLE_LIST, points=points, **fields)


def mesh_marker(path: Path | str, key: tuple[str, int] = BODY, **fields: Any) -> Marker:
    uri = path if isinstance(path, str) else path.as_uri()
    return cube(key, type=Marker.MESH_RESOURCE, mesh_resource=uri, **fields)


def doubtful(rig: Rig, key: tuple[str, int]) -> bool:
    return bool(rig.node.objects.table.doubtful[rig.node.objects.table.slots[key]])
