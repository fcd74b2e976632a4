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

"""The points of a cloud near boxes: all within a reach of each box, the nearest one, or any.

The boxes are in the frame of the cloud, and the tree over its points is searched with their bounds.
Distances are from the boxes as given: the caller bounds the errors of their places.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.geometry.trees.bounds_tree import STACK, BoundsTree, lowest, overlaps
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.intrinsics import LANES
from obb_collision.numerics.vec3 import (
    absolute,
    combined,
    components,
    fast_norm,
    max_of,
    minus,
    plus,
    scaled,
    sum_abs,
)
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.typing import Axes, Floats, Rows, Vector

FIRST_ROOM = 256
"""Points for which there is room at first."""


class NearPoints(NamedTuple):
    """Points near boxes, q of them, ascending by box."""

    boxes: Rows  #: (q,) row of the box
    points: Rows  #: (q,) row of the point
    distances: Floats  #: (q,) metres from the box, negative inside of it


def near_points(
    tree: BoundsTree, boxes: BoxArrays, reaches: Floats, only: str = "all"
) -> NearPoints:
    """Return the points of a tree that are at most ``reaches`` (n,) metres from boxes (n,).

    only: for each box "all" such points, the "nearest" one, or "any" one.
    """
    if len(tree.order) == 0:
        return NearPoints(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
    most = {"all": ALL, "nearest": NEAREST, "any": ANY}[only]
    return NearPoints(*_near_kernel(tree, boxes, reaches, most))


ALL, NEAREST, ANY = 0, 1, 2
#: Error of the distance of a block (derivation above).
BLOCK_BOUND = 64 * ROUNDOFF


@njit
def _near_kernel(
    tree: BoundsTree, boxes: BoxArrays, reaches: Floats, most: int
) -> tuple[np.ndarray, np.ndarray, Floats]:
    order, nodes, starts = tree.order, tree.nodes, tree.starts
    owners, numbers = np.empty(FIRST_ROOM, np.int64), np.empty(FIRST_ROOM, np.int64)
    distances = np.empty(FIRST_ROOM)
    levels, waiting = np.empty(STACK, np.int64), np.empty(STACK, np.int64)
    used = 0
    for row in range(len(reaches)):
        box, reach, before = box_at(boxes, row), reaches[row], used
        sides = absolute(box.axes[0]), absolute(box.axes[1]), absolute(box.axes[2])
        half, c = combined(sides, box.half_extents), box.center
        levels[0], waiting[0] = len(starts) - 2, 0
        depth = 1
        while depth > 0:
            depth -= 1
            level, block = levels[depth], waiting[depth]
            node = starts[level] + block
            x, y, z = half[0] + reach, half[1] + reach, half[2] + reach
            mask = overlaps(nodes, node, c[0] - x, c[1] - y, c[2] - z, c[0] + x, c[1] + y, c[2] + z)
            least, nearest = np.inf, -1
            while mask != 0:
                lane = lowest(mask)
                mask &= mask - 1
                child = LANES * block + lane
                if level > 0:
                    gap = block_gap(box, sides, nodes, node, lane)
                    if gap > max(reach, 0.0):
                        continue
                    if gap < least:
                        least, nearest, child = gap, child, nearest
                    if child >= 0:
                        levels[depth], waiting[depth] = level - 1, child
                        depth += 1
                    continue
                point = nodes[node, 0, lane], nodes[node, 1, lane], nodes[node, 2, lane]
                distance = box_distance(box, point)
                if distance > reach:
                    continue
                if used == len(owners):
                    owners, numbers = _doubled(owners), _doubled(numbers)
                    distances = _doubled(distances)
                place = before if most == NEAREST else used
                if place < used and not distance < distances[place]:
                    continue
                owners[place], numbers[place], distances[place] = row, order[child], distance
                used = max(used, place + 1)
                if most == NEAREST:
                    reach = distance
                elif most == ANY:
                    mask = depth = 0
            if nearest >= 0:  # last in, first out
                levels[depth], waiting[depth] = level - 1, nearest
                depth += 1
    return owners[:used].copy(), numbers[:used].copy(), distances[:used].copy()


@njit(inline=True, refcount=False)
def block_gap(box: BoxAt, sides: Axes, nodes: Floats, row: int, lane: int) -> float:
    """Return a lower bound, not negative, of the distance of a box from bounds in a block.

    sides: the magnitudes of the axes of the box.
    """
    low = nodes[row, 0, lane], nodes[row, 1, lane], nodes[row, 2, lane]
    high = nodes[row, 3, lane], nodes[row, 4, lane], nodes[row, 5, lane]
    half = scaled(minus(high, low), 0.5)
    offset = minus(plus(low, half), box.center)
    (x, y, z), (u, v, w) = absolute(components(box.axes, offset)), components(sides, half)
    a, b, c = box.half_extents
    slack = BLOCK_BOUND * (sum_abs(offset) + sum_abs(half) + a + b + c)
    x, y, z = max(x - a - u - slack, 0.0), max(y - b - v - slack, 0.0), max(z - c - w - slack, 0.0)
    return math.sqrt(x * x + y * y + z * z)


@njit(inline=True, refcount=False)
def box_distance(box: BoxAt, point: Vector) -> float:
    """Return the distance of a point from a box, negative inside of it."""
    excess = minus(absolute(components(box.axes, minus(point, box.center))), box.half_extents)
    most = max_of(excess)
    if most <= 0.0:
        return most
    return fast_norm((max(excess[0], 0.0), max(excess[1], 0.0), max(excess[2], 0.0)))


@njit
def _doubled(array: np.ndarray) -> np.ndarray:
    """Return a copy with room for twice as many numbers."""
    larger = np.empty(2 * len(array), array.dtype)
    for k in range(len(array)):
        larger[k] = array[k]
    return larger
