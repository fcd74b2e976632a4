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

"""The largest gap of many pairs of boxes along the 15 axes, a block of pairs at a time.

The numbers of a block are gathered first, each kind in one run of memory; then the processor
computes several pairs at once. Each number is that of the formulas in ``sat``, bit for bit.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import FAST_BOUND, UNDERFLOW
from obb_collision.numerics.vec3 import max_of
from obb_collision.queries.verdict.pair_frame import in_frame, pair_size
from obb_collision.queries.verdict.sat import (
    all_edge_axes,
    edge_gaps,
    face_gaps_of_a,
    face_gaps_of_b,
)
from obb_collision.typing import Axes, Floats, Vector

#: Pairs in a block: their numbers (15 kB) stay in the fastest memory.
BLOCK = 64
#: Rows of a block: where its numbers stand. What comes out of it is the largest gap and its bound.
OFFSET, AXES_A, AXES_B, EXTENTS_A, EXTENTS_B, GAP, BOUND, ROWS = 0, 3, 12, 21, 24, 27, 28, 29


@njit
def gather(
    centers_a: Floats, rotations_a: Floats, half_extents_a: Floats, rows_a: np.ndarray,
    centers_b: Floats, rotations_b: Floats, half_extents_b: Floats, rows_b: np.ndarray,
    start: int, count: int, block: Floats,
) -> None:  # fmt: skip
    """Write pairs ``start`` to ``start + count`` of rows into a block (ROWS, BLOCK)."""
    for n in range(count):
        i, j = rows_a[start + n], rows_b[start + n]
        for k in range(3):
            block[OFFSET + k, n] = centers_b[j, k] - centers_a[i, k]
            block[EXTENTS_A + k, n] = half_extents_a[i, k]
            block[EXTENTS_B + k, n] = half_extents_b[j, k]
            for m in range(3):
                block[AXES_A + 3 * k + m, n] = rotations_a[i, m, k]
                block[AXES_B + 3 * k + m, n] = rotations_b[j, m, k]


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
