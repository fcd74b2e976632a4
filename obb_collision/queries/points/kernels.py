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

"""Kernels of ``points``: each point finds its cell, and is tested against the boxes there."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import UNDERFLOW
from obb_collision.numerics.error_free import length
from obb_collision.queries.convex.points import convex_holds
from obb_collision.queries.convex.support import Bodies as ConvexBodies
from obb_collision.queries.meshes.tree_descent import STACK, Bodies
from obb_collision.queries.points.containment import INSIDE_BOUND, OUTSIDE, place_carefully
from obb_collision.queries.points.grid import COUNT, GRID, START, find_cell
from obb_collision.queries.points.mesh_points import body_holds
from obb_collision.typing import Floats

#: Columns of a box's record: centre (3), rotation (9), half extents (3), then these.
SIZE, SCALE = 15, 16


@njit
def lengths_kernel(offsets: Floats, rows: np.ndarray, out: Floats) -> None:
    """Write the length of each offset (m, 3) to its row."""
    for n in range(len(rows)):
        out[rows[n]] = length(offsets[n, 0], offsets[n, 1], offsets[n, 2])


@njit
def points_kernel(
    points: np.ndarray, start: int, end: int,
    whole: Floats, cells: np.ndarray, items: np.ndarray, frames: Floats, numbers: np.ndarray,
    records: Floats, margin: float,
    meshes: Bodies | None, radii: Floats, convex: ConvexBodies | None,
    found: np.ndarray, squares: Floats, labels: np.ndarray,
) -> int:  # fmt: skip
    """Write what boxes hold of points start to end; return how many are not finite.

    Or the meshes in them, with radii about them, or the convex bodies in them, if there are.

    found (3, n): counts, first and nearest; squares (n,): of the least scaled distance; labels
    (p,) or (0,): the lowest box of each point.
    """
    ignored = 0
    labelled = len(labels) > 0
    stack = np.empty((STACK, 2), np.int64)
    for n in range(start, end):
        x, y, z = float(points[n, 0]), float(points[n, 1]), float(points[n, 2])
        label = -1
        if (
            (x >= whole[0]) & (y >= whole[1]) & (z >= whole[2])
            & (x <= whole[3]) & (y <= whole[4]) & (z <= whole[5])
        ):  # fmt: skip
            cell = 0
            while cells[cell, GRID] >= 0:
                cell = find_cell(frames, numbers, cells[cell, GRID], x, y, z)
            last = cells[cell, START] + cells[cell, COUNT]
            for m in range(cells[cell, START], last):
                b = items[m]
                dx, dy, dz = x - records[b, 0], y - records[b, 1], z - records[b, 2]
                if not _inside(records, b, dx, dy, dz, margin):
                    continue
                if meshes is not None and not body_holds(
                    meshes, b, (x, y, z), margin + radii[b], stack
                ):
                    continue
                if convex is not None and not convex_holds(convex, b, (x, y, z), margin):
                    continue
                scale = records[b, SCALE]
                dx, dy, dz = scale * dx, scale * dy, scale * dz
                square = dx * dx + dy * dy + dz * dz
                if found[0, b] == 0:
                    found[1, b] = n
                if found[0, b] == 0 or square < squares[b]:
                    found[2, b] = n
                    squares[b] = square
                found[0, b] += 1
                label = b if label < 0 else min(label, b)
        elif (x - x) + (y - y) + (z - z) != 0.0:
            ignored += 1
        if labelled:
            labels[n] = label
    return ignored


@njit
def _inside(records: Floats, b: int, dx: float, dy: float, dz: float, margin: float) -> bool:
    """Return whether the point at this offset from the centre of box b counts as inside."""
    x = abs(records[b, 3] * dx + records[b, 6] * dy + records[b, 9] * dz) - records[b, 12]
    y = abs(records[b, 4] * dx + records[b, 7] * dy + records[b, 10] * dz) - records[b, 13]
    z = abs(records[b, 5] * dx + records[b, 8] * dy + records[b, 11] * dz) - records[b, 14]
    bound = INSIDE_BOUND * (abs(dx) + abs(dy) + abs(dz) + records[b, SIZE]) + UNDERFLOW
    excess = max(x, y, z)
    if excess > margin + bound:
        return False
    if excess < -bound:
        return True
    if margin > 0.0:
        return length(max(x, 0.0), max(y, 0.0), max(z, 0.0)) <= margin + bound
    x_axis = records[b, 3], records[b, 6], records[b, 9]
    y_axis = records[b, 4], records[b, 7], records[b, 10]
    z_axis = records[b, 5], records[b, 8], records[b, 11]
    half_extents = records[b, 12], records[b, 13], records[b, 14]
    place = place_carefully((dx, dy, dz), (x_axis, y_axis, z_axis), half_extents)
    return place != OUTSIDE
