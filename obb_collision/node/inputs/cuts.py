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

"""What of the points of a sensor is left out: by range, by height, by cells of a grid."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from obb_collision.geometry.poses import as_poses
from obb_collision.node.messages.errors import RefusedError
from obb_collision.numerics.vec3 import lengths
from obb_collision.typing import Floats, Mask, Rows

Points = npt.NDArray[np.floating]
"""(n, 3) float32 or float64, metres, in the frame of the sensor."""
MOST_CELLS = 2**62
VOXEL_TOO_SMALL = "voxel too small"
"""Reason: points are too far apart for cells of this size."""


def finite_rows(points: Points) -> Mask:
    """Return which points (n,) are finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        sums = points[:, 0] + points[:, 1] + points[:, 2]
    rows = np.asarray(np.isfinite(sums))
    if not rows.all():  # large ones may overflow
        rows = np.isfinite(points).all(axis=1)
    return np.asarray(rows)


def in_range(points: Points, low: float, high: float) -> Mask:
    """Return which finite points (n,) have a distance from the origin between two limits."""
    with np.errstate(over="ignore"):
        squares = np.einsum("ij,ij->i", points, points, dtype=np.float64)
    return np.asarray((squares >= low * low) & (squares <= high * high))


def heights(points: Points, sensor: Floats, frame: Floats) -> Floats:
    """Return z (n,) of points in a frame; poses (7,) of the sensor and of the frame."""
    (at, zero), (turn, axes) = as_poses(np.stack([sensor, frame]), warn=False)
    up = axes[:, 2]
    result: Floats = points @ (turn.T @ up) + float(up @ (at - zero))
    return result


def thin_out(points: Points, edge: float) -> tuple[Rows, float]:
    """Return the rows (k,) of the points nearest to the centres of cells of a grid, one of each.

    And the longest distance (m) from any other point to the one that is kept of its cell.
    """
    if len(points) == 0:
        return np.empty(0, np.int64), 0.0
    points = points.astype(np.float64)
    cells = np.floor(points / edge)
    low = cells.min(axis=0)
    sizes = cells.max(axis=0) - low + 1.0
    if np.prod(sizes) > MOST_CELLS:
        raise RefusedError(VOXEL_TOO_SMALL, f"{edge} m for points in {sizes * edge} m")
    x, y, z = (cells - low).T.astype(np.int64)
    keys = (x * int(sizes[1]) + y) * int(sizes[2]) + z
    offsets = points - (cells + 0.5) * edge
    order = np.argsort(keys, kind="stable")
    keys, squares = keys[order], np.einsum("ij,ij->i", offsets, offsets)[order]
    starts = np.flatnonzero(np.append(True, keys[1:] != keys[:-1]))
    cell = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(keys))))
    best = np.flatnonzero(squares == np.minimum.reduceat(squares, starts)[cell])
    kept = order[best[np.append(True, cell[best[1:]] != cell[best[:-1]])]]
    moved = lengths(points[order] - points[kept][cell]).max()
    return np.sort(kept), float(np.nextafter(moved * (1.0 + 1e-12), np.inf)) if moved else 0.0
