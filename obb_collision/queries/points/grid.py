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

"""Which boxes may hold a point? A tree of grids over boxes that stand anywhere, in any size.

A cell with several boxes gets a grid of its own, so that a crowd of small boxes in one corner of
a hall, or thin rods across it, leave few boxes to a cell. Cells are appended in the order they
are split, those of one grid in one row: the array of cells is its own queue, breadth first, and
the effort is spent where it pays most.

No box can be missed. Along each axis a cell number is a monotone function of the coordinate, and
boxes are entered by the numbers of their bounds, by the same function. A cell that a box's faces
certainly keep out of is left out, by CELL_SLACK more than rounding can move a cell.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.typing import Floats

#: A cell with so few boxes is not worth a grid: testing a box takes less than finding the cell.
FEW = 3
#: Cells of a grid for each box in it: more give few boxes a cell, fewer stay in the cache.
CELLS_PER_BOX = 64
MOST_CELLS = 32768
#: A grid must leave at most this share of a cell's boxes to its cells on average.
WORTH = 0.6
#: Relative slack of a cell's place: far more than the few roundoffs in it.
CELL_SLACK = 8192 * ROUNDOFF

#: Columns of a cell: first box in the items, number of boxes, its grid or -1, the grid it is of.
START, COUNT, GRID, PARENT = 0, 1, 2, 3
#: Columns of a grid's numbers: its first cell, and the steps from cell to cell along x and y.
FIRST, STEP_X, STEP_Y = 0, 1, 2


@njit
def find_cell(frames: Floats, numbers: np.ndarray, g: int, x: float, y: float, z: float) -> int:
    """Return the cell of grid g that the point is in, or nearest to."""
    i = int(min(max((x - frames[g, 0]) * frames[g, 3], 0.0), frames[g, 6]))
    j = int(min(max((y - frames[g, 1]) * frames[g, 4], 0.0), frames[g, 7]))
    k = int(min(max((z - frames[g, 2]) * frames[g, 5], 0.0), frames[g, 8]))
    return numbers[g, FIRST] + i * numbers[g, STEP_X] + j * numbers[g, STEP_Y] + k


@njit
def build_grid(
    bounds: Floats, centers: Floats, axes: Floats, extents: Floats, effort: int
) -> tuple[np.ndarray, np.ndarray, Floats, np.ndarray]:
    """Return cells (m, 4), items, frames (k, 9) and numbers (k, 3) of a tree of grids over boxes.

    bounds (n, 6): the least and largest corner of what must be found of a box; extents (n, 3):
    half extents of a box with the same axes that holds it. effort: how many pairs of box and cell
    to look at, more or less. Cell 0 is the root. A frame is the least corner, cells per metre,
    and the last cell number along each axis.
    """
    n = len(bounds)
    cells = np.empty((64, 4), np.int32)
    cells[0] = 0, n, -1, -1
    items = np.arange(max(2 * n, 16)).astype(np.int32)
    frames, numbers = np.empty((1, 9)), np.empty((1, 3), np.int32)
    pairs = np.empty((64, 2), np.int32)
    used_cells, used_items, grids = 1, n, 0
    cell = 0
    while cell < used_cells and effort > 0:
        start, count = cells[cell, START], cells[cell, COUNT]
        effort -= 1
        if count > FEW:
            if grids == len(frames):
                frames, numbers = _doubled(frames), _doubled(numbers)
            size = _lay_out(frames, numbers, grids, cells, cell, bounds, items, effort)
            numbers[grids, FIRST] = used_cells
            found = 0
            for m in range(start, start + count):
                while found + size > len(pairs):
                    pairs = _doubled(pairs)
                found, looked = _enter(
                    frames, numbers, grids, bounds, centers, axes, extents, items[m], pairs, found
                )
                effort -= looked
            if found <= WORTH * size * count:
                while used_cells + size > len(cells):
                    cells = _doubled(cells)
                while used_items + found > len(items):
                    items = _doubled(items)
                cells[cell, GRID] = grids
                _sort(cells[used_cells : used_cells + size], items, used_items, pairs[:found])
                cells[used_cells : used_cells + size, PARENT] = grids
                used_cells, used_items, grids = used_cells + size, used_items + found, grids + 1
        cell += 1
    return cells[:used_cells], items[:used_items], frames, numbers


@njit
def _doubled(array: np.ndarray) -> np.ndarray:
    """Return a copy with room for twice as many rows."""
    larger = np.empty((2 * len(array), *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


@njit
def _sort(cells: np.ndarray, items: np.ndarray, start: int, pairs: np.ndarray) -> None:
    """Write the items of new cells from start on, from pairs (m, 2) of cell number and box."""
    cells[:, COUNT] = 0
    cells[:, GRID] = -1
    for m in range(len(pairs)):
        cells[pairs[m, 0], COUNT] += 1
    for k in range(len(cells)):
        cells[k, START] = start
        start += cells[k, COUNT]
        cells[k, COUNT] = 0
    for m in range(len(pairs)):
        k = pairs[m, 0]
        items[cells[k, START] + cells[k, COUNT]] = pairs[m, 1]
        cells[k, COUNT] += 1


@njit
def _lay_out(
    frames: Floats, numbers: np.ndarray, g: int, cells: np.ndarray, cell: int,
    bounds: Floats, items: np.ndarray, effort: int,
) -> int:  # fmt: skip
    """Write the frame of grid g and its steps; return its size, a power of two.

    It spans the cell's boxes, as far as they are in the cell. Cells are as cubic as can be, and
    as many as CELLS_PER_BOX and half of the effort allow for.
    """
    start, count = cells[cell, START], cells[cell, COUNT]
    sides, steps = np.empty(3), np.ones(3)
    for k in range(3):
        least, most = np.inf, -np.inf
        for row in items[start : start + count]:
            least, most = min(least, bounds[row, k]), max(most, bounds[row, 3 + k])
        if cell > 0:
            near, width, slack = _row(frames, cells[cell, PARENT], k)
            place = _place(numbers, cells[cell, PARENT], cell, k)
            least = max(least, near + place * width - slack)
            most = min(most, near + (place + 1) * width + slack)
        frames[g, k] = least
        sides[k] = max(most - least, 0.0)
    size = 1
    while size < MOST_CELLS and size < CELLS_PER_BOX * count:
        longest = np.argmax(sides / steps)
        steps[longest] *= 2.0
        pairs = 0.0
        for row in items[start : start + count]:
            entered = 1.0
            for k in range(3):
                if sides[k] > 0.0:
                    length = min((bounds[row, 3 + k] - bounds[row, k]) / sides[k], 1.0)
                    entered *= min(length * steps[k] + 1.0, steps[k])
            pairs += entered
        if pairs > 0.5 * effort and size >= 8:
            steps[longest] *= 0.5
            break
        size *= 2
    for k in range(3):
        inverse = steps[k] / sides[k] if sides[k] > 0.0 else 0.0
        frames[g, 3 + k] = inverse if inverse < np.inf else 0.0
        frames[g, 6 + k] = steps[k] - 1.0
    numbers[g, STEP_X], numbers[g, STEP_Y] = int(steps[1] * steps[2]), int(steps[2])
    return size


@njit
def _place(numbers: np.ndarray, g: int, cell: int, k: int) -> int:
    """Return the place along axis k of a cell of grid g."""
    number = cell - numbers[g, FIRST]
    if k == 0:
        return number // numbers[g, STEP_X]
    if k == 1:
        return number % numbers[g, STEP_X] // numbers[g, STEP_Y]
    return number % numbers[g, STEP_Y]


@njit
def _row(frames: Floats, g: int, k: int) -> tuple[float, float, float]:
    """Return where the cells along an axis of grid g begin, their width, and its slack.

    Only where something can be found: what is beyond the grid falls into its outer cells, too.
    """
    low, inverse, last = frames[g, k], frames[g, 3 + k], frames[g, 6 + k]
    if inverse == 0.0:
        return low, np.inf, 0.0
    width = 1.0 / inverse
    return low, width, CELL_SLACK * ((last + 1.0) * width + abs(low))


@njit
def _enter(
    frames: Floats, numbers: np.ndarray, g: int,
    bounds: Floats, centers: Floats, axes: Floats, extents: Floats, row: int,
    pairs: np.ndarray, found: int,
) -> tuple[int, int]:  # fmt: skip
    """Append the cells of grid g that a box may reach into; return pairs found and looked at."""
    x0, y0, z0 = bounds[row, 0], bounds[row, 1], bounds[row, 2]
    x1, y1, z1 = bounds[row, 3], bounds[row, 4], bounds[row, 5]
    first = find_cell(frames, numbers, g, x0, y0, z0)
    last = find_cell(frames, numbers, g, x1, y1, z1)
    looked = 0
    low_x, wide_x, slack_x = _row(frames, g, 0)
    low_y, wide_y, slack_y = _row(frames, g, 1)
    low_z, wide_z, slack_z = _row(frames, g, 2)
    hx, hy, hz = 0.5 * wide_x + slack_x, 0.5 * wide_y + slack_y, 0.5 * wide_z + slack_z
    certain = first != last and math.isfinite(hx + hy + hz)
    for i in range(_place(numbers, g, first, 0), _place(numbers, g, last, 0) + 1):
        dx = low_x + (i + 0.5) * wide_x - centers[row, 0]
        for j in range(_place(numbers, g, first, 1), _place(numbers, g, last, 1) + 1):
            dy = low_y + (j + 0.5) * wide_y - centers[row, 1]
            for k in range(_place(numbers, g, first, 2), _place(numbers, g, last, 2) + 1):
                dz = low_z + (k + 0.5) * wide_z - centers[row, 2]
                looked += 1
                if certain and _apart(axes, extents, row, dx, dy, dz, hx, hy, hz):
                    continue
                pairs[found, 0] = i * numbers[g, STEP_X] + j * numbers[g, STEP_Y] + k
                pairs[found, 1] = row
                found += 1
    return found, looked


@njit
def _apart(
    axes: Floats, extents: Floats, row: int,
    dx: float, dy: float, dz: float, hx: float, hy: float, hz: float,
) -> bool:  # fmt: skip
    """Return whether a face normal of a box certainly separates it from a cell.

    The cell at dx, dy, dz from the centre of the box, with half extents hx, hy, hz.
    """
    slack = CELL_SLACK * (abs(dx) + abs(dy) + abs(dz) + hx + hy + hz)
    for i in range(3):
        ax, ay, az = axes[row, 0, i], axes[row, 1, i], axes[row, 2, i]
        reach = hx * abs(ax) + hy * abs(ay) + hz * abs(az) + extents[row, i]
        if abs(ax * dx + ay * dy + az * dz) > reach + slack:
            return True
    return False
