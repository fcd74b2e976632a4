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

"""Boxes that may hold a point: a tree of grids over boxes that stand anywhere, in any size.

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
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import dot, dot_abs, minus, sum_abs
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.typing import Floats, Vector

#: A cell with so few boxes is not worth a grid: testing a box takes less than finding the cell.
FEW_BOXES = 3
#: Cells of a grid for each box in it: more give few boxes a cell, fewer stay in the cache.
CELLS_PER_BOX = 64
MOST_GRID_CELLS = 32768
#: A grid must leave at most this share of a cell's boxes to its cells on average.
WORTHWHILE_SHARE = 0.6
#: Relative slack of a cell's place: far more than the few roundoffs in it.
CELL_SLACK = 8192 * ROUNDOFF

#: Columns of a cell: first box in the items, number of boxes, its grid or -1, the grid it is of.
CELL_START, CELL_COUNT, CELL_GRID, CELL_PARENT = 0, 1, 2, 3
#: Columns of a grid's numbers: its first cell, and the steps from cell to cell along x and y.
FIRST_CELL, STEP_X, STEP_Y = 0, 1, 2


class Grids(NamedTuple):
    """Frames (k, 9) and numbers (k, 3) of grids (see ``build_grid``)."""

    frames: Floats
    numbers: np.ndarray


class Grid(NamedTuple):
    """A tree of grids over boxes."""

    cells: np.ndarray  #: (m, 4), the root first
    items: np.ndarray  #: rows of boxes
    frames: Floats  #: (k, 9)
    numbers: np.ndarray  #: (k, 3)


class Contents(NamedTuple):
    """The contents of cells: bounds and boxes, the arguments of ``build_grid``."""

    bounds: Floats
    boxes: BoxArrays


@njit
def find_cell(frames: Floats, numbers: np.ndarray, g: int, x: float, y: float, z: float) -> int:
    """Return the cell of grid g that contains a point, or is nearest; the first one for NaN."""
    i = int(min(max(0.0, (x - frames[g, 0]) * frames[g, 3]), frames[g, 6]))
    j = int(min(max(0.0, (y - frames[g, 1]) * frames[g, 4]), frames[g, 7]))
    k = int(min(max(0.0, (z - frames[g, 2]) * frames[g, 5]), frames[g, 8]))
    return numbers[g, FIRST_CELL] + i * numbers[g, STEP_X] + j * numbers[g, STEP_Y] + k


@njit
def build_grid(bounds: Floats, boxes: BoxArrays, effort: int) -> Grid:
    """Return a tree of grids over boxes; cell 0 is the root.

    bounds (n, 6): the least and largest corner of a part of each box; only points in it must find
    the box. effort: about how many pairs of box and cell to examine. A frame is the least corner,
    cells per metre, and the last cell number along each axis.
    """
    n = len(bounds)
    cells = np.empty((64, 4), np.int32)
    cells[0, CELL_START], cells[0, CELL_COUNT] = 0, n
    cells[0, CELL_GRID] = cells[0, CELL_PARENT] = -1
    items = np.arange(max(2 * n, 16)).astype(np.int32)
    frames, numbers = np.empty((1, 9)), np.empty((1, 3), np.int32)
    pairs = np.empty((64, 2), np.int32)
    used_cells, used_items, grids = 1, n, 0
    contents = Contents(bounds, boxes)
    cell = 0
    while cell < used_cells and effort > 0:
        start, count = cells[cell, CELL_START], cells[cell, CELL_COUNT]
        effort -= 1
        if count > FEW_BOXES:
            if grids == len(frames):
                frames, numbers = _doubled(frames), _doubled(numbers)
            size = _lay_out(frames, numbers, grids, cells, cell, bounds, items, effort)
            numbers[grids, FIRST_CELL] = used_cells
            tree = Grids(frames, numbers)
            entered = 0
            for m in range(start, start + count):
                while entered + size > len(pairs):
                    pairs = _doubled(pairs)
                entered, looked = _enter(tree, grids, contents, items[m], pairs, entered)
                effort -= looked
            if entered <= WORTHWHILE_SHARE * size * count:
                while used_cells + size > len(cells):
                    cells = _doubled(cells)
                while used_items + entered > len(items):
                    items = _doubled(items)
                cells[cell, CELL_GRID] = grids
                _sort(cells[used_cells : used_cells + size], items, used_items, pairs[:entered])
                cells[used_cells : used_cells + size, CELL_PARENT] = grids
                used_cells, used_items, grids = used_cells + size, used_items + entered, grids + 1
        cell += 1
    return Grid(cells[:used_cells], items[:used_items], frames, numbers)


@njit
def _doubled(array: np.ndarray) -> np.ndarray:
    """Return a copy with room for twice as many rows."""
    larger = np.empty((2 * len(array), *array.shape[1:]), array.dtype)
    numbers, old = larger.reshape(-1), array.reshape(-1)
    for k in range(len(old)):  # an assignment of arrays takes seconds to compile
        numbers[k] = old[k]
    return larger


@njit
def _sort(cells: np.ndarray, items: np.ndarray, start: int, pairs: np.ndarray) -> None:
    """Write the items of new cells, from pairs (m, 2) of cell number and box; start: first item."""
    cells[:, CELL_COUNT] = 0
    cells[:, CELL_GRID] = -1
    for m in range(len(pairs)):
        cells[pairs[m, 0], CELL_COUNT] += 1
    for k in range(len(cells)):
        cells[k, CELL_START] = start
        start += cells[k, CELL_COUNT]
        cells[k, CELL_COUNT] = 0
    for m in range(len(pairs)):
        k = pairs[m, 0]
        items[cells[k, CELL_START] + cells[k, CELL_COUNT]] = pairs[m, 1]
        cells[k, CELL_COUNT] += 1


@njit
def _lay_out(
    frames: Floats, numbers: np.ndarray, g: int, cells: np.ndarray, cell: int,
    bounds: Floats, items: np.ndarray, effort: int,
) -> int:  # fmt: skip
    """Write the frame of grid g and its steps; return its size, a power of two.

    It spans the cell's boxes, as far as they are in the cell. Cells are as cubic as possible, at
    most CELLS_PER_BOX per box and as many as half of the effort allows.
    """
    start, count = cells[cell, CELL_START], cells[cell, CELL_COUNT]
    sides, steps = np.empty(3), np.ones(3)
    for k in range(3):
        least, most = np.inf, -np.inf
        for row in items[start : start + count]:
            least, most = min(least, bounds[row, k]), max(most, bounds[row, 3 + k])
        if cell > 0:
            near, width, slack = _row(frames, cells[cell, CELL_PARENT], k)
            place = _place(numbers, cells[cell, CELL_PARENT], cell, k)
            least = max(least, near + place * width - slack)
            most = min(most, near + (place + 1) * width + slack)
        frames[g, k] = least
        sides[k] = max(most - least, 0.0)
    size = 1
    while size < MOST_GRID_CELLS and size < CELLS_PER_BOX * count:
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
    number = cell - numbers[g, FIRST_CELL]
    if k == 0:
        return number // numbers[g, STEP_X]
    if k == 1:
        return number % numbers[g, STEP_X] // numbers[g, STEP_Y]
    return number % numbers[g, STEP_Y]


@njit
def _row(frames: Floats, g: int, k: int) -> tuple[float, float, float]:
    """Return where the cells along an axis of grid g begin, their width, and its slack.

    Points beyond the grid fall into its outer cells.
    """
    low, inverse, last = frames[g, k], frames[g, 3 + k], frames[g, 6 + k]
    if inverse == 0.0:
        return low, np.inf, 0.0
    width = 1.0 / inverse
    return low, width, CELL_SLACK * ((last + 1.0) * width + abs(low))


@njit
def _enter(
    grids: Grids, g: int, contents: Contents, item: int, pairs: np.ndarray, entered: int
) -> tuple[int, int]:
    """Append the cells of grid g that a box may reach into; return pairs entered and tested."""
    frames, numbers = grids
    low, high = contents.bounds[item, :3], contents.bounds[item, 3:]
    first = find_cell(frames, numbers, g, low[0], low[1], low[2])
    last = find_cell(frames, numbers, g, high[0], high[1], high[2])
    looked = 0
    low_x, wide_x, slack_x = _row(frames, g, 0)
    low_y, wide_y, slack_y = _row(frames, g, 1)
    low_z, wide_z, slack_z = _row(frames, g, 2)
    half = 0.5 * wide_x + slack_x, 0.5 * wide_y + slack_y, 0.5 * wide_z + slack_z
    certain = first != last and math.isfinite(half[0] + half[1] + half[2])
    box = box_at(contents.boxes, item)
    for i in range(_place(numbers, g, first, 0), _place(numbers, g, last, 0) + 1):
        x = low_x + (i + 0.5) * wide_x
        for j in range(_place(numbers, g, first, 1), _place(numbers, g, last, 1) + 1):
            y = low_y + (j + 0.5) * wide_y
            for k in range(_place(numbers, g, first, 2), _place(numbers, g, last, 2) + 1):
                z = low_z + (k + 0.5) * wide_z
                looked += 1
                if certain and _apart(box, minus((x, y, z), box.center), half):
                    continue
                pairs[entered, 0] = i * numbers[g, STEP_X] + j * numbers[g, STEP_Y] + k
                pairs[entered, 1] = item
                entered += 1
    return entered, looked


@njit
def _apart(box: BoxAt, offset: Vector, half: Vector) -> bool:
    """Return whether a face normal of a box certainly separates it from a cell.

    offset: from the centre of the box to the cell; half: half extents of the cell.
    """
    slack = CELL_SLACK * (sum_abs(offset) + half[0] + half[1] + half[2])
    for i in range(3):
        n = box.axes[i]
        if abs(dot(n, offset)) > dot_abs(half, n) + box.half_extents[i] + slack:
            return True
    return False
