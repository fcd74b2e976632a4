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

"""Largest gaps and witnesses of many pairs of boxes, a block of pairs at a time.

The numbers of a block are gathered first, each kind in one run of memory; then the processor
computes several pairs at once. Each number is that of the formulas in ``sat``, bit for bit.

Of witnesses, bounds of all 15 gaps leave one axis of nearly every pair; its gap is computed
carefully. Pairs with more than one are left to ``largest_gap``.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.numerics.constants import FAST_BOUND, PARALLEL, UNDERFLOW
from obb_collision.numerics.intrinsics import fetch_pairs
from obb_collision.numerics.vec3 import (
    careful_cross,
    clamped,
    combined,
    components,
    dot,
    max_abs,
    max_of,
    minus,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.queries.verdict.sat import (
    AXES,
    FACTORS,
    all_edge_axes,
    box_at,
    edge_gaps,
    face_gaps_of_a,
    face_gaps_of_b,
    in_frame,
    pair_size,
    projected_radius,
)
from obb_collision.queries.verdict.witness import (
    DRAWN_SETTLED,
    PROJECTION_ROUNDS,
    largest_gap,
    possible_axes,
)
from obb_collision.typing import Axes, Floats, Vector

#: Pairs in a block: their numbers (15 kB) stay in the fastest memory.
BLOCK = 64
#: Rows of a block: where its numbers stand. What comes out of it is the largest gap and its bound.
OFFSET, AXES_A, AXES_B, EXTENTS_A, EXTENTS_B, GAP, BOUND, ROWS = 0, 3, 12, 21, 24, 27, 28, 29


@njit(refcount=False)
def gather(pairs: RowPairs, start: int, count: int, block: Floats) -> None:
    """Write pairs ``start`` to ``start + count`` into a block (ROWS, BLOCK)."""
    (a, rows_a, b, rows_b) = pairs
    for n in range(count):
        i, j = rows_a[start + n], rows_b[start + n]
        for k in range(3):
            block[OFFSET + k, n] = b.centers[j, k] - a.centers[i, k]
            block[EXTENTS_A + k, n] = a.half_extents[i, k]
            block[EXTENTS_B + k, n] = b.half_extents[j, k]
            for m in range(3):
                block[AXES_A + 3 * k + m, n] = a.rotations[i, m, k]
                block[AXES_B + 3 * k + m, n] = b.rotations[j, m, k]


@njit
def bound_block(block: Floats, count: int) -> None:
    """Write the largest gap of each pair, not divided by the length of its axis, and its bound."""
    for n in range(count):  # without a branch
        offset, h, f = (
            vector_in(block, OFFSET, n),
            vector_in(block, EXTENTS_A, n),
            vector_in(block, EXTENTS_B, n),
        )
        pair = in_frame(offset, axes_in(block, AXES_A, n), h, axes_in(block, AXES_B, n), f)
        faces = max(max_of(face_gaps_of_a(pair)), max_of(face_gaps_of_b(pair)))
        x, y, z = all_edge_axes(pair)
        edges = max(max_of(edge_gaps(x)), max_of(edge_gaps(y)))
        block[GAP, n] = max(faces, max(edges, max_of(edge_gaps(z))))
        block[BOUND, n] = FAST_BOUND * pair_size(offset, h, f) + UNDERFLOW


@njit
def vector_in(block: Floats, row: int, n: int) -> Vector:
    """Return three rows of column n."""
    return block[row, n], block[row + 1, n], block[row + 2, n]


@njit
def axes_in(block: Floats, row: int, n: int) -> Axes:
    """Return nine rows of column n as axes."""
    return vector_in(block, row, n), vector_in(block, row + 3, n), vector_in(block, row + 6, n)


@njit
def write_in(block: Floats, row: int, n: int, vector: Vector) -> None:
    """Write three rows of column n."""
    block[row, n], block[row + 1, n], block[row + 2, n] = vector


#: Rows beyond those of ``blocks``: the boxes in the frame of a; the two edges whose cross product
#: is the axis, and its number; which axes may have the largest gap; the witness; a common point.
FRAME_OFFSET, FRAME_AXES, FIRST, SECOND, NUMBER, POSSIBLE, LARGEST, NORMAL, POINT, ALL_ROWS = (
    *(27, 30, 39, 42, 45, 46, 47, 48, 51, 54),
)
#: Rows of the search for a common point, once the edges are of no use: the point, when it is
#: settled, and whether it is not. What it goes by is in the rows from EXTENTS_A on.
PLACE, SETTLED, GOING = 39, 42, 43


@njit
def witness_kernel(
    boxes: BoxArrays,
    pairs: np.ndarray,
    gaps: Floats,
    axes: Floats,
    points: Floats,
    start: int,
    stop: int,
) -> None:
    """Write gap (m,), axis (m, 3) and a point (m, 3) of the contact of some pairs of (m, 2)."""
    block = np.empty((ALL_ROWS, BLOCK))
    columns = np.empty(BLOCK, np.int64)
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        witness_block(boxes, pairs, first, count, block)
        _common_points(block, count, columns)
        for n in range(count):
            point = combined(axes_in(block, AXES_A, n), vector_in(block, POINT, n))
            point = plus(vector_at(boxes.centers, pairs[first + n, 0]), point)
            gaps[first + n] = block[LARGEST, n]
            for k in range(3):
                axes[first + n, k], points[first + n, k] = block[NORMAL + k, n], point[k]


@njit(inline=True)
def witness_block(
    boxes: BoxArrays, pairs: np.ndarray, start: int, count: int, block: Floats
) -> None:
    """Write gap, unit axis and its number of some pairs of (m, 2), and the boxes in the frame of a.

    block (ROWS, BLOCK).
    """
    gather(RowPairs(boxes, pairs[:, 0], boxes, pairs[:, 1]), start, count, block)
    fetch_pairs(boxes, pairs, start + count, start + 2 * count)
    _bound_axes(block, count)
    for n in range(count):
        number, axes = 0, int(block[POSSIBLE, n])
        while number < AXES - 1 and not (axes >> number) & 1:
            number += 1
        block[NUMBER, n] = number
        i, j = AXES_A + 3 * FACTORS[number, 0], AXES_A + 3 * FACTORS[number, 1]
        for k in range(3):
            block[FIRST + k, n], block[SECOND + k, n] = block[i + k, n], block[j + k, n]
    _careful_gaps(block, count)
    for n in range(count):
        number, axes = int(block[NUMBER, n]), int(block[POSSIBLE, n])
        if axes == 1 << number and block[LARGEST, n] > -np.inf:
            continue
        a, b = box_at(boxes, pairs[start + n, 0]), box_at(boxes, pairs[start + n, 1])
        block[LARGEST, n], axis, number = largest_gap(a, b, axes)
        write_in(block, NORMAL, n, axis)
        block[NUMBER, n] = number


@njit(inline=True)
def _bound_axes(block: Floats, count: int) -> None:
    """Write the boxes in the frame of a, and which axes may have the largest gap."""
    for n in range(count):  # without a branch
        offset = vector_in(block, OFFSET, n)
        h, f = vector_in(block, EXTENTS_A, n), vector_in(block, EXTENTS_B, n)
        pair = in_frame(offset, axes_in(block, AXES_A, n), h, axes_in(block, AXES_B, n), f)
        write_in(block, FRAME_OFFSET, n, pair.d)
        write_in(block, FRAME_AXES, n, pair.r[0])
        write_in(block, FRAME_AXES + 3, n, pair.r[1])
        write_in(block, FRAME_AXES + 6, n, pair.r[2])
        block[POSSIBLE, n] = possible_axes(pair, pair_size(offset, h, f))


@njit(inline=True)
def _careful_gaps(block: Floats, count: int) -> None:
    """Write what ``careful_gap`` returns for the first possible axis of each pair."""
    for n in range(count):  # without a branch
        offset = vector_in(block, OFFSET, n)
        x, y, z = careful_cross(vector_in(block, FIRST, n), vector_in(block, SECOND, n))
        largest = max_abs((x, y, z))
        largest = largest if largest > 0.0 else 1.0
        s, t, w = x / largest, y / largest, z / largest
        size = largest * math.sqrt((s * s + t * t) + w * w)
        parallel = size < PARALLEL
        size = 1.0 if parallel else size
        m = x / size, y / size, z / size
        along = dot(m, offset)
        a = projected_radius(m, axes_in(block, AXES_A, n), vector_in(block, EXTENTS_A, n))
        b = projected_radius(m, axes_in(block, AXES_B, n), vector_in(block, EXTENTS_B, n))
        gap = abs(along) - (a + b)
        block[LARGEST, n] = -np.inf if parallel else gap
        sign = -1.0 if along < 0.0 else 1.0
        write_in(block, NORMAL, n, (sign * m[0], sign * m[1], sign * m[2]))


@njit(inline=True)
def _common_points(block: Floats, count: int, columns: np.ndarray) -> None:
    """Write what ``common_point`` returns for each pair, all rounds of a block at once.

    columns (BLOCK,) is work space: once half of the pairs are settled, the others move up.
    """
    for n in range(count):
        h, f = vector_in(block, EXTENTS_A, n), vector_in(block, EXTENTS_B, n)
        block[SETTLED, n] = DRAWN_SETTLED * (h[0] + h[1] + h[2] + f[0] + f[1] + f[2])
        write_in(block, PLACE, n, scaled(vector_in(block, FRAME_OFFSET, n), 0.5))
        block[GOING, n] = 1.0
        columns[n] = n
    for _ in range(PROJECTION_ROUNDS):
        going = _project(block, count)
        if going == 0:
            break
        if 2 * going <= count:
            count = _move_up(block, count, columns)
    for n in range(count):
        write_in(block, POINT, columns[n], vector_in(block, PLACE, n))


@njit(inline=True)
def _project(block: Floats, count: int) -> int:
    """Move the points that are not settled into a, then into b; return how many are not yet."""
    going = 0
    for n in range(count):  # without a branch
        d, r = vector_in(block, FRAME_OFFSET, n), axes_in(block, FRAME_AXES, n)
        before = vector_in(block, PLACE, n)
        s = clamped(before, vector_in(block, EXTENTS_A, n))
        t = components(r, minus(s, d))
        t = minus(t, clamped(t, vector_in(block, EXTENTS_B, n)))
        s = minus(s, combined(r, t))
        moves = block[GOING, n] > 0.0
        for k in range(3):
            block[PLACE + k, n] = s[k] if moves else before[k]
        goes = moves and not max_abs(t) <= block[SETTLED, n]
        block[GOING, n] = 1.0 if goes else 0.0
        going += goes
    return going


@njit
def _move_up(block: Floats, count: int, columns: np.ndarray) -> int:
    """Write the points that are settled, move the other pairs up; return their number."""
    kept = 0
    for n in range(count):
        if block[GOING, n] == 0.0:
            write_in(block, POINT, columns[n], vector_in(block, PLACE, n))
            continue
        for row in range(EXTENTS_A, GOING + 1):
            block[row, kept] = block[row, n]
        columns[kept] = columns[n]
        kept += 1
    return kept
