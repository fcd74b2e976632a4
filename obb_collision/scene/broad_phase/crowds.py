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

"""Candidates piece by piece, for where there are too many to hold: objects all in one place.

Pairs come in lexicographic order, so that whoever has enough stops with the first ones.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.sorting import bits_of, sort_numbers
from obb_collision.numerics.vec3 import vector_at
from obb_collision.scene.broad_phase.bounds_tree import BoundsTree, overlapping
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.typing import Floats

#: Candidates decided at first, where one that collides is enough ...
FIRST_PIECE = 16
#: ... and by how much more the next time.
GROWTH = 4
Bounds = tuple[Floats, Floats]


def ordered_candidates(
    tree: BoundsTree, room: int, own: Bounds | None = None, first: int | None = None
) -> Iterator[tuple[Pairs, int]]:
    """Yield all i < j whose bounds overlap, in lexicographic order, and the first row not done.

    Each piece has all pairs of its rows i, at most max(room, n) in all. own: bounds (m, 3), (m, 3)
    of another set, whose rows i are; then with all j of the tree. first: pairs that are enough for
    the first piece, and GROWTH times as many for each later one.
    """
    count, bounds = len(tree.order), own or (tree.minimum, tree.maximum)
    pairs = np.empty((max(room, count), 2), np.int64)
    column, spare = np.empty((2, count), np.int64)
    row, enough = 0, first or len(pairs)
    while row < len(bounds[0]):
        found, row = _rows_kernel(tree, *bounds, own is None, row, enough, column, spare, pairs)
        enough = min(enough * GROWTH, len(pairs))
        yield pairs[:found].copy(), row


def growing_candidates(tree: BoundsTree, own: Bounds | None = None) -> Iterator[Pairs]:
    """Yield ``ordered_candidates`` in pieces that grow, for whoever stops at one that collides."""
    size = FIRST_PIECE
    for pairs, _ in ordered_candidates(tree, len(tree.order), own, FIRST_PIECE):
        while len(pairs):
            yield pairs[:size]
            pairs, size = pairs[size:], size * GROWTH


@njit
def _rows_kernel(
    tree: BoundsTree, minimum: Floats, maximum: Floats, same: bool, row: int, enough: int,
    column: np.ndarray, spare: np.ndarray, pairs: np.ndarray,
) -> tuple[int, int]:  # fmt: skip
    """Write the pairs of rows from ``row`` on while they fit; return their number and the next."""
    found, bits = 0, bits_of(len(tree.order))
    while row < len(minimum) and found < enough:
        low, high = vector_at(minimum, row), vector_at(maximum, row)
        more = overlapping(tree, low, high, row + 1 if same else 0, column)
        if found + more > len(pairs):
            return found, row
        sort_numbers(column[:more], spare[:more], 0, bits)
        for k in range(more):
            pairs[found + k, 0], pairs[found + k, 1] = row, column[k]
        found += more
        row += 1
    return found, row
