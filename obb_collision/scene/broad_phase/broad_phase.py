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

"""Broad phase: which axis-aligned bounds overlap, without looking at all pairs.

By a bounding volume hierarchy over the boxes (see ``bounds_tree``): every leaf looks for the leaves
that it overlaps. Bounds are never rounded, so no overlapping pair can be missed. Cost is O(n log n)
for boxes of similar size spread in space; where everything overlaps everything there are n^2 / 2
pairs to report, unless there is a limit (see ``limit``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.scene.broad_phase.bounds_tree import FANOUT, LEAF, STACK, BoundsTree
from obb_collision.typing import Floats

Pairs = NDArray[np.int64]

#: More pairs than there can be.
UNLIMITED = 2**62
NO_PAIRS: Pairs = np.empty((0, 2), np.int64)


def find_candidates(minimum: Floats, maximum: Floats) -> Pairs:
    """Return (m, 2) all i < j whose closed bounds (n, 3) to (n, 3) overlap, in no special order."""
    if len(minimum) < 2:
        return NO_PAIRS
    pairs = find_some_candidates(BoundsTree.build(minimum, maximum), UNLIMITED)
    assert pairs is not None
    return pairs


def find_some_candidates(tree: BoundsTree, most: int) -> Pairs | None:
    """Return what ``find_candidates`` does, or None for more than ``most`` pairs.

    Whatever there are, memory and time are those of ``most`` pairs at the most.
    """
    capacity = min(8 * len(tree.order), most)
    while True:
        pairs = np.empty((capacity, 2), np.int64)
        found = _self_overlaps(tree.nodes, tree.starts, tree.order, most, pairs)
        if found > most:
            return None
        if found <= capacity:
            return pairs[:found]
        capacity = found


def find_candidates_of(minimum: Floats, maximum: Floats, rows: NDArray[np.int64]) -> Pairs:
    """Return (m, 2) all i < j with i or j in ``rows`` whose bounds overlap: for few moved boxes."""
    pairs = find_some_candidates_of(minimum, maximum, rows, UNLIMITED)
    assert pairs is not None
    return pairs


def find_some_candidates_of(
    minimum: Floats, maximum: Floats, rows: NDArray[np.int64], most: int
) -> Pairs | None:
    """Return what ``find_candidates_of`` does, or None for more than ``most`` pairs."""
    wanted = np.zeros(len(minimum), np.bool_)
    wanted[rows] = True
    capacity = min(16 * (len(rows) + 1), most)
    while True:
        pairs = np.empty((capacity, 2), np.int64)
        found = _row_overlaps(minimum, maximum, rows, wanted, most, pairs)
        if found > most:
            return None
        if found <= capacity:
            return pairs[:found]
        capacity = found


def find_candidates_between(
    minimum: Floats, maximum: Floats, other_minimum: Floats, other_maximum: Floats
) -> Pairs:
    """Return (m, 2) all rows i, j of two sets of bounds (n, 3) that overlap, in no special order.

    The others go into a tree, in which each of the first is looked up.
    """
    if len(minimum) == 0 or len(other_minimum) == 0:
        return NO_PAIRS
    tree = BoundsTree.build(other_minimum, other_maximum)
    capacity = 8 * len(minimum)
    while True:
        pairs = np.empty((capacity, 2), np.int64)
        found = _overlaps_between(minimum, maximum, tree.order, tree.nodes, tree.starts, pairs)
        if found <= capacity:
            return pairs[:found]
        capacity = found


@njit
def _overlaps_between(
    minimum: Floats, maximum: Floats, order: np.ndarray, nodes: Floats, starts: np.ndarray,
    pairs: np.ndarray,
) -> int:  # fmt: skip
    """Write the pairs of ``find_candidates_between`` as far as there is room; return how many."""
    levels = np.empty(STACK, np.int64)
    waiting = np.empty(STACK, np.int64)
    found = 0
    for row in range(len(minimum)):
        levels[0], waiting[0] = len(starts) - 2, 0
        depth = 1
        while depth > 0:
            depth -= 1
            level, node = levels[depth], waiting[depth]
            group = LEAF if level == 1 else FANOUT
            below = starts[level - 1]
            first = node * group
            for child in range(first, min(first + group, starts[level] - below)):
                if not overlaps_node(minimum, maximum, row, nodes, below + child):
                    continue
                if level > 1:
                    levels[depth], waiting[depth] = level - 1, child
                    depth += 1
                else:
                    if found < len(pairs):
                        pairs[found, 0], pairs[found, 1] = row, order[child]
                    found += 1
    return found


@njit
def overlaps_node(minimum: Floats, maximum: Floats, row: int, nodes: Floats, n: int) -> bool:
    """Return whether bounds of a row and of node n of a tree have a common point."""
    return (
        (minimum[row, 0] <= nodes[n, 3]) & (nodes[n, 0] <= maximum[row, 0])
        & (minimum[row, 1] <= nodes[n, 4]) & (nodes[n, 1] <= maximum[row, 1])
        & (minimum[row, 2] <= nodes[n, 5]) & (nodes[n, 2] <= maximum[row, 2])
    )  # fmt: skip


@njit
def _overlap(a: Floats, i: int, b: Floats, j: int) -> bool:
    """Return whether bounds i of a and j of b, six numbers each, have a common point."""
    return (
        (a[i, 0] <= b[j, 3]) & (b[j, 0] <= a[i, 3])
        & (a[i, 1] <= b[j, 4]) & (b[j, 1] <= a[i, 4])
        & (a[i, 2] <= b[j, 5]) & (b[j, 2] <= a[i, 5])
    )  # fmt: skip


@njit
def _self_overlaps(
    nodes: Floats, starts: np.ndarray, order: np.ndarray, most: int, pairs: np.ndarray
) -> int:
    """Write the overlapping pairs of boxes, as far as there is room; return how many there are.

    Ends soon after ``most`` are found. Every leaf looks for the leaves at or after it that it
    overlaps; nodes all before it are skipped.
    """
    root = len(starts) - 2
    level_stack = np.empty(STACK, np.int64)
    node_stack = np.empty(STACK, np.int64)
    found = 0
    for leaf in range(starts[2] - starts[1]):
        query = starts[1] + leaf
        level_stack[0] = root
        node_stack[0] = 0
        depth = 1
        while depth > 0:
            if found > most:
                return found
            depth -= 1
            level = level_stack[depth]
            node = node_stack[depth]
            if level == 1:
                found = _leaf_pairs(nodes, order, starts[1], leaf, node, pairs, found)
                continue
            below = starts[level - 1]
            first = node * FANOUT
            last = min(first + FANOUT, starts[level] - below)
            reach = FANOUT ** (level - 2)  # leaves under a child
            for child in range(first, last):
                if (child + 1) * reach > leaf and _overlap(nodes, query, nodes, below + child):
                    level_stack[depth] = level - 1
                    node_stack[depth] = child
                    depth += 1
    return found


@njit
def _leaf_pairs(
    nodes: Floats,
    order: np.ndarray,
    count: int,
    leaf: int,
    other: int,
    pairs: np.ndarray,
    found: int,
) -> int:
    """Append the overlapping pairs between the boxes of two leaves; return the new count.

    count: number of boxes, after which the leaves are.
    """
    for i in range(leaf * LEAF, min((leaf + 1) * LEAF, count)):
        if not _overlap(nodes, i, nodes, count + other):
            continue
        start = i + 1 if other == leaf else other * LEAF
        for j in range(start, min((other + 1) * LEAF, count)):
            if _overlap(nodes, i, nodes, j):
                if found < len(pairs):
                    pairs[found, 0] = min(order[i], order[j])
                    pairs[found, 1] = max(order[i], order[j])
                found += 1
    return found


@njit
def _row_overlaps(
    minimum: Floats,
    maximum: Floats,
    rows: np.ndarray,
    wanted: np.ndarray,
    most: int,
    pairs: np.ndarray,
) -> int:
    """Write the pairs of each wanted row with all others; between two wanted ones only once.

    Ends soon after ``most`` are found.
    """
    found = 0
    for i in rows:
        if found > most:
            return found
        for j in range(len(minimum)):
            if j == i or (wanted[j] and j < i):
                continue
            if (
                (minimum[i, 0] <= maximum[j, 0]) & (minimum[j, 0] <= maximum[i, 0])
                & (minimum[i, 1] <= maximum[j, 1]) & (minimum[j, 1] <= maximum[i, 1])
                & (minimum[i, 2] <= maximum[j, 2]) & (minimum[j, 2] <= maximum[i, 2])
            ):  # fmt: skip
                if found < len(pairs):
                    pairs[found, 0] = min(i, j)
                    pairs[found, 1] = max(i, j)
                found += 1
    return found
