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

Pairs come in lexicographic order, so that whoever has enough stops with the first ones; and objects
of which no pair is wanted any more are asked only whether they have any.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from obb_collision._jit import njit
from obb_collision.scene.broad_phase.bounds_tree import FANOUT, LEAF, STACK, BoundsTree
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.typing import Floats, Rows

#: Partners of an object looked at first, where one that collides is enough ...
FIRST_PARTNERS = 8
#: ... and by how much more the next time.
GROWTH = 4


def ordered_candidates(tree: BoundsTree, room: int) -> Iterator[tuple[Pairs, int]]:
    """Yield all i < j whose bounds overlap, in lexicographic order, and the first row not done.

    Each piece has all pairs of its rows i, at most max(room, n) in all.
    """
    count = len(tree.order)
    pairs = np.empty((max(room, count), 2), np.int64)
    column = np.empty(count, np.int64)
    row = 0
    while row < count:
        found, row = _rows_kernel(*tree, row, column, pairs)
        yield pairs[:found].copy(), row


def partners(tree: BoundsTree, rows: Rows, least: int, skip: int, most: int) -> tuple[Pairs, Rows]:
    """Return pairs of rows with others from ``least`` on whose bounds overlap; how many of each.

    Of each row at most ``most``, after the first ``skip`` in an order that stays the same.
    """
    pairs = np.empty((len(rows) * most, 2), np.int64)
    counts = np.empty(len(rows), np.int64)
    found = _partners_kernel(*tree, rows, least, skip, most, pairs, counts)
    return pairs[:found], counts


@njit
def _overlapping(
    minimum: Floats, maximum: Floats, order: np.ndarray, nodes: Floats, starts: np.ndarray,
    row: int, least: int, last: int, out: np.ndarray,
) -> int:  # fmt: skip
    """Write others from ``least`` on whose bounds overlap a row's, at most ``last``; return them.

    The order of the tree.
    """
    x0, y0, z0 = minimum[row, 0], minimum[row, 1], minimum[row, 2]
    x1, y1, z1 = maximum[row, 0], maximum[row, 1], maximum[row, 2]
    levels = np.empty(STACK, np.int64)
    waiting = np.empty(STACK, np.int64)
    levels[0], waiting[0] = len(starts) - 2, 0
    depth, found = 1, 0
    while depth > 0:
        depth -= 1
        level, node = levels[depth], waiting[depth]
        group = LEAF if level == 1 else FANOUT
        below = starts[level - 1]
        first = node * group
        for child in range(first, min(first + group, starts[level] - below)):
            n = below + child
            if not (
                (x0 <= nodes[n, 3]) & (nodes[n, 0] <= x1)
                & (y0 <= nodes[n, 4]) & (nodes[n, 1] <= y1)
                & (z0 <= nodes[n, 5]) & (nodes[n, 2] <= z1)
            ):  # fmt: skip
                continue
            if level > 1:
                levels[depth], waiting[depth] = level - 1, child
                depth += 1
            elif order[child] >= least and order[child] != row:
                out[found] = order[child]
                found += 1
                if found == last:
                    return found
    return found


@njit
def _rows_kernel(
    minimum: Floats, maximum: Floats, order: np.ndarray, nodes: Floats, starts: np.ndarray,
    row: int, column: np.ndarray, pairs: np.ndarray,
) -> tuple[int, int]:  # fmt: skip
    """Write the pairs of rows from ``row`` on while they fit; return their number and the next."""
    found = 0
    while row < len(order):
        more = _overlapping(
            minimum, maximum, order, nodes, starts, row, row + 1, len(order), column
        )
        if found + more > len(pairs):
            return found, row
        column[:more].sort()
        for k in range(more):
            pairs[found + k, 0], pairs[found + k, 1] = row, column[k]
        found += more
        row += 1
    return found, row


@njit
def _partners_kernel(
    minimum: Floats, maximum: Floats, order: np.ndarray, nodes: Floats, starts: np.ndarray,
    rows: np.ndarray, least: int, skip: int, most: int, pairs: np.ndarray, counts: np.ndarray,
) -> int:  # fmt: skip
    column = np.empty(skip + most, np.int64)
    found = 0
    for n in range(len(rows)):
        row = rows[n]
        reached = _overlapping(
            minimum, maximum, order, nodes, starts, row, least, skip + most, column
        )
        counts[n] = max(0, reached - skip)
        for k in range(skip, reached):
            pairs[found, 0], pairs[found, 1] = min(row, column[k]), max(row, column[k])
            found += 1
    return found
