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

"""Which points of a sensor are left out: by range, by height, and by the cells of a grid."""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import IDENTITY_POSE, as_poses
from obb_collision.geometry.values import read_only_view
from obb_collision.node.messages.errors import RefusedError
from obb_collision.queries.rays.hidden import add_hidden
from obb_collision.scene.refinement.bodies import box_bodies
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Box, Cloud
from obb_collision.typing import Floats, Rows

Points = npt.NDArray[np.floating]
"""(n, 3) float32 or float64, metres, in the frame of the sensor."""
MOST_CELLS = 2.0**62
VOXEL_TOO_SMALL = "voxel too small"
"""Reason: points are too far apart for cells of this size."""
SPREAD = np.uint64(0x9E3779B97F4A7C15)
"""2^64 by the golden ratio: a product with it spreads keys over its high bits (Knuth)."""
KEPT, INVALID, OUT_OF_RANGE, OUT_OF_HEIGHTS = range(4)
"""Counts of ``select``: points that stay, are not finite, and are beyond a limit."""


class Limits(NamedTuple):
    """Limits of distances from the sensor, and of heights (m): points within them stay.

    up: unit vector upwards in the frame of the sensor; sensor: the height of the sensor (m).
    """

    min_range: float = 0.0
    max_range: float = inf
    min_height: float = -inf
    max_height: float = inf
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    sensor: float = 0.0

    def seen_from(self, sensor: Floats, frame: Floats) -> Limits:
        """Return these limits with heights along z of a frame; poses (7,) of sensor and frame."""
        (at, zero), (turn, axes) = as_poses(np.stack([sensor, frame]), warn=False)
        x, y, z = (turn.T @ axes[:, 2]).tolist()
        return self._replace(up=(x, y, z), sensor=float(axes[:, 2] @ (at - zero)))


def select(points: Points, limits: Limits) -> tuple[Floats, list[int]]:
    """Return the finite points (k, 3) within limits, and four counts of points.

    They count what stays, what is not finite, what is out of range, and what is out of height.
    """
    kept = np.empty((len(points), 3))
    whole = np.require(points, requirements=["C", "ALIGNED"])
    counts = select_kernel(read_only_view(whole), limits, kept)
    return kept[: counts[KEPT]], list(counts)


@njit
def select_kernel(points: Points, limits: Limits, out: Floats) -> tuple[int, int, int, int]:
    """Write the points (n, 3) that stay; return the four counts of ``select``."""
    kept, unknown, far, off = 0, 0, 0, 0
    near_square = limits.min_range * limits.min_range
    far_square = limits.max_range * limits.max_range
    a, b, c = limits.up
    for n in range(len(points)):
        x, y, z = float(points[n, 0]), float(points[n, 1]), float(points[n, 2])
        if (x - x) + (y - y) + (z - z) != 0.0:
            unknown += 1
            continue
        square = x * x + y * y + z * z
        if square < near_square or square > far_square:
            far += 1
            continue
        height = a * x + b * y + c * z + limits.sensor
        if height < limits.min_height or height > limits.max_height:
            off += 1
            continue
        out[kept, 0], out[kept, 1], out[kept, 2] = x, y, z
        kept += 1
    return kept, unknown, far, off


def placed_points(points: Floats, pose: Floats) -> Floats:
    """Return points (n, 3) in the fixed frame; pose (7,): of the frame that they are in."""
    position, rotation = as_poses(pose[None], warn=False)
    out = np.empty_like(points)
    place_kernel(points, position[0], rotation[0], out)
    return out


@njit
def place_kernel(points: Floats, at: Floats, turn: Floats, out: Floats) -> None:
    """Write points (n, 3) turned and moved: a product of matrices waits for other threads."""
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        for k in range(3):
            out[n, k] = turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * z + at[k]


def thin_out(points: Floats, edge: float) -> tuple[Rows, float]:
    """Return the row (k,) of one point of each cell of a grid: the nearest to the cell's centre.

    Also return the longest distance (m) from a point to the one that its cell keeps. RefusedError
    ("voxel too small").
    """
    if len(points) == 0:
        return np.empty(0, np.int64), 0.0
    least, most = np.full(3, inf), np.full(3, -inf)
    bounds_kernel(points, least, most)
    low = np.floor(least / edge)
    sizes = np.floor(most / edge) - low + 1.0
    if not np.prod(sizes) <= MOST_CELLS:
        spans = " x ".join(f"{span:g}" for span in (sizes * edge).tolist())
        raise RefusedError(VOXEL_TOO_SMALL, f"{edge:g} m for points that span {spans} m")
    table = np.zeros(1 << int(2 * len(points)).bit_length(), np.int32)
    owners, places = np.empty(len(points), np.int64), np.empty(len(points), np.int32)
    count, moved = thin_kernel(points, edge, low, sizes, table, owners, places)
    rows = np.sort(owners[:count])
    return rows, float(np.nextafter(moved * (1.0 + 1e-12), inf)) if moved > 0.0 else 0.0


@njit
def bounds_kernel(points: Floats, least: Floats, most: Floats) -> None:
    """Write the bounds of points (n, 3): numpy takes ten times as long along rows."""
    for n in range(len(points)):
        for k in range(3):
            least[k] = min(least[k], points[n, k])
            most[k] = max(most[k], points[n, k])


@njit
def thin_kernel(
    points: Floats,
    edge: float,
    low: Floats,
    sizes: Floats,
    table: np.ndarray,
    owners: Rows,
    places: np.ndarray,
) -> tuple[int, float]:
    """Write the rows of the points that are kept; return their number, and the distance.

    table: a hash table of a power of two, zeros: cells by their numbers, from 1 on. owners (n,): of
    each cell. places (n,): the cell of each point. Neighbours in a picture are often in one cell.
    """
    mask, bits = len(table) - 1, 0
    while (1 << bits) < len(table):
        bits += 1
    shift = np.uint64(64 - bits)
    keys, squares = np.empty(len(points), np.int64), np.empty(len(points))
    count, last, cell = 0, np.int64(-1), 0
    for n in range(len(points)):
        i = np.floor(points[n, 0] / edge)  # no integers, which end at 2^63
        j = np.floor(points[n, 1] / edge)
        k = np.floor(points[n, 2] / edge)
        key = np.int64(i - low[0]) * np.int64(sizes[1]) + np.int64(j - low[1])
        key = key * np.int64(sizes[2]) + np.int64(k - low[2])
        square = 0.0
        for axis in range(3):
            square += (points[n, axis] - ((i, j, k)[axis] + 0.5) * edge) ** 2
        if key != last:
            last = key
            at = np.int64((np.uint64(key) * SPREAD) >> shift)
            while table[at] > 0 and keys[table[at] - 1] != key:
                at = (at + 1) & mask
            if table[at] == 0:
                keys[count], squares[count], owners[count] = key, square, n
                count += 1
                table[at] = count
            cell = table[at] - 1
        places[n] = cell
        if square < squares[cell]:
            squares[cell], owners[cell] = square, n
    longest = 0.0
    for n in range(len(points)):
        m, square = owners[places[n]], 0.0
        for axis in range(3):
            square += (points[n, axis] - points[m, axis]) ** 2
        longest = max(longest, square)
    return count, sqrt(longest)


def compile_kernels() -> None:
    """Compile the kernels of sources: cut points of both types, shadows, and check a cloud."""
    scene = Scene()
    scene.add("box", Box((1.0, 1.0, 1.0)))
    for kind in (np.float32, np.float64):
        here = np.array(IDENTITY_POSE)
        points, _ = select(np.zeros((2, 3), kind), Limits().seen_from(here, here))
        thin_out(placed_points(points, here), 0.1)
    boxes = Boxes(np.zeros((1, 3)), [np.eye(3)], np.ones((1, 3)))
    bodies = box_bodies(boxes, np.arange(1))
    add_hidden(np.zeros(2, np.bool_), np.full(3, 2.0), points, boxes, bodies, 0.1)
    for number in range(3):  # two clouds are no pair, and a change merges pairs
        scene.add(str(number % 2), Cloud(points, 0.1 + number))
        scene.check("separations")
    scene.move("box", (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    scene.check("separations")
