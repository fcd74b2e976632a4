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

By a tree of blocks of eight bounds (see ``bounds_tree``): every leaf looks for the leaves from it
on that it overlaps. Bounds are never rounded, so no overlapping pair can be missed. Cost is
O(n log n) for boxes of similar size spread in space; where everything overlaps everything there are
n^2 / 2 pairs to report, unless there is a limit (see ``crowds``).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision import _threads
from obb_collision._jit import njit
from obb_collision.numerics.intrinsics import fetch
from obb_collision.numerics.vec3 import vector_at
from obb_collision.scene.broad_phase.bounds_tree import (
    LANE_BITS,
    LANES,
    STACK,
    BoundsTree,
    lowest,
    overlapping,
    overlaps,
)
from obb_collision.typing import Columns, Floats, Rows

Pairs = NDArray[np.int64]
#: Writes pairs of rows from one to another as long as there is room; returns how many there are,
#: and the first row that is not done.
Search = Callable[[Pairs, int, int], tuple[int, int]]
#: What becomes of some of the pairs, in the thread that has found them: an array of a row for each
#: pair that is kept.
Each = Callable[[Pairs], NDArray[np.int64]]

#: More pairs than there can be.
UNLIMITED = 2**62
NO_PAIRS: Pairs = np.empty((0, 2), np.int64)
#: Rows of a search, here and of leaves, below which a second thread does not pay: with 1,000 boxes,
#: 125 leaves, it gains a tenth at best.
FEWEST_ROWS, FEWEST_LEAVES = 256, 96
#: Room for pairs: for each row at first, and at most, but for a row with more (16 MB).
ROOM_PER_ROW, ROOM = 4, 1 << 20
#: Leaves near one, and rows, that are looked at together.
NEAR, TOGETHER = 64, 64
#: Doubles in what memory gives at once.
LINE = 8


def find_candidates(minimum: Floats, maximum: Floats, each: Each | None = None) -> Pairs:
    """Return (m, 2) all i < j whose closed bounds (n, 3) to (n, 3) overlap, in no special order.

    each: what is returned of them instead.
    """
    if len(minimum) < 2:
        return NO_PAIRS if each is None else each(NO_PAIRS)
    pairs = find_some_candidates(BoundsTree.build(minimum, maximum), UNLIMITED, each)
    assert pairs is not None
    return pairs


def find_some_candidates(tree: BoundsTree, most: int, each: Each | None = None) -> Pairs | None:
    """Return the pairs of `find_candidates`, or None if there are more than ``most``.

    Whatever there are, memory and time are those of ``most`` pairs at the most.
    """
    search = partial(_self_overlaps, tuple(tree), most)
    return _collect(search, tree.leaves, FEWEST_LEAVES, LANES * ROOM_PER_ROW, most, each)


def find_candidates_of(minimum: Floats, maximum: Floats, row: int) -> Pairs:
    """Return (m, 2) all pairs of one row with another whose bounds overlap, the lower one first."""
    found = ((minimum <= maximum[row]) & (minimum[row] <= maximum)).all(axis=1)
    found[row] = False
    others = np.flatnonzero(found)
    return np.column_stack([np.minimum(others, row), np.maximum(others, row)])


def find_some_candidates_of(tree: BoundsTree, rows: Rows, most: int) -> Pairs | None:
    """Return (m, 2) all i < j with i or j in ``rows`` whose bounds overlap, in no special order.

    None for more than ``most`` pairs.
    """
    wanted = np.zeros(len(tree.order), np.bool_)
    wanted[rows] = True
    search = partial(row_overlaps, tree, rows, wanted, most)
    return _collect(search, len(rows), FEWEST_ROWS, 4 * ROOM_PER_ROW, most)


def find_candidates_between(
    minimum: Floats, maximum: Floats, other_minimum: Floats, other_maximum: Floats
) -> Pairs:
    """Return (m, 2) all rows i, j of two sets of bounds (n, 3) that overlap, in no special order.

    The others go into a tree, in which each of the first is looked up.
    """
    if len(minimum) == 0 or len(other_minimum) == 0:
        return NO_PAIRS
    tree = BoundsTree.build(other_minimum, other_maximum)
    search = partial(_overlaps_between, minimum, maximum, tree)
    pairs = _collect(search, len(minimum), FEWEST_ROWS, 2 * ROOM_PER_ROW, UNLIMITED)
    assert pairs is not None
    return pairs


def _collect(
    search: Search, count: int, least: int, room_per_row: int, most: int, each: Each | None = None
) -> Pairs | None:
    """Return the pairs of a search of ``count`` rows, None for more than ``most``."""
    parts = _threads.ranges(count, least)
    totals = [0] * len(parts)

    def collect(part: int) -> list[Pairs]:
        start, stop = parts[part]
        found: list[Pairs] = []
        room = min(room_per_row * (stop - start), ROOM) + LANES**2
        while start < stop and sum(totals) <= most:
            pairs = np.empty((room, 2), np.int64)
            number, reached = search(pairs, start, stop)
            if reached == start:  # the pairs of one row are too many
                room *= 4
                continue
            found.append(pairs[:number] if each is None else each(pairs[:number]))
            totals[part] += number
            start = reached
        return found

    if len(parts) == 1:
        chunks = collect(0)
    else:
        search(NO_PAIRS, 0, 0)  # see ``_threads.run``
        if each is not None:
            each(NO_PAIRS)
        chunks = [pairs for found in _threads.run_parts(collect, len(parts)) for pairs in found]
    if sum(totals) > most:
        return None
    return chunks[0] if len(chunks) == 1 else np.concatenate(chunks or [NO_PAIRS])


class Room(NamedTuple):
    """Room for the search of one leaf's pairs."""

    levels: Rows  #: (STACK,) of the blocks to visit ...
    waiting: Rows  #: (STACK,) ... and their numbers
    near: Rows  #: (NEAR, 3) a leaf, which boxes of the searched one overlap it, which of it that
    hits: Rows  #: (NEAR * LANES, 3) a box of the searched leaf, a leaf, which boxes of it


@njit
def _self_overlaps(
    given: Columns, most: int, pairs: np.ndarray, start: int, stop: int
) -> tuple[int, int]:
    """Write the overlapping pairs of leaves ``start`` to ``stop``, each with those from it on.

    Ends soon after ``most`` are found. See ``Search``.
    """
    tree = BoundsTree(*given)
    levels, waiting = np.empty(STACK, np.int64), np.empty(STACK, np.int64)
    near, hits = np.empty((NEAR, 3), np.int64), np.empty((NEAR * LANES, 3), np.int64)
    room, found = Room(levels, waiting, near, hits), 0
    for leaf in range(start, stop):
        more = _leaf_overlaps(tree, leaf, room, pairs, found)
        if more < 0:
            return found, leaf
        found = more
        if found > most:
            return found, leaf + 1
    return found, stop


@njit(refcount=False)
def _leaf_overlaps(tree: BoundsTree, leaf: int, room: Room, pairs: np.ndarray, found: int) -> int:
    """Append the pairs of a leaf with those from it on; return the new number, -1 for no room.

    Leaves that overlap it are found first, then boxes, then pairs, all of a kind
    together: so a processor guesses well what comes next, and memory is asked for in time.
    """
    nodes, starts = tree.nodes, tree.starts
    levels, waiting, near = room.levels, room.waiting, room.near
    x0, y0, z0, x1, y1, z1 = _leaf_bounds(nodes, starts, leaf)
    levels[0], waiting[0] = len(starts) - 2, 0
    depth, count = 1, 0
    if len(starts) == 2:  # it is the root
        near[0, 0], depth, count = leaf, 0, 1
    while True:
        if depth == 0 or count > NEAR - LANES:
            for k in range(count):
                child = near[k, 0]
                near[k, 1] = overlaps(nodes, leaf, *_leaf_bounds(nodes, starts, child))
                near[k, 2] = overlaps(nodes, child, x0, y0, z0, x1, y1, z1)
            found = _box_overlaps(tree, leaf, room, count, pairs, found)
            count = 0
            if depth == 0 or found < 0:
                return found
        depth -= 1
        level, block = levels[depth], waiting[depth]
        mask = overlaps(nodes, starts[level] + block, x0, y0, z0, x1, y1, z1)
        # nodes that are all before the leaf have found it, or will
        first = max((leaf >> (LANE_BITS * (level - 1))) - LANES * block, 0)
        mask = (mask >> first) << first
        while mask != 0:
            child = LANES * block + lowest(mask)
            mask &= mask - 1
            if level > 1:
                levels[depth], waiting[depth] = level - 1, child
                depth += 1
            else:
                for k in range(0, 6 * LANES, LINE):
                    fetch(nodes, 6 * LANES * child + k)
                near[count, 0] = child
                count += 1


@njit(refcount=False)
def _leaf_bounds(
    nodes: Floats, starts: np.ndarray, leaf: int
) -> tuple[float, float, float, float, float, float]:
    """Return the bounds of a leaf; anything where it is the root."""
    node, lane = starts[1] + (leaf >> LANE_BITS), leaf & (LANES - 1)
    if node == len(nodes):
        return -np.inf, -np.inf, -np.inf, np.inf, np.inf, np.inf
    return (
        nodes[node, 0, lane],
        nodes[node, 1, lane],
        nodes[node, 2, lane],
        nodes[node, 3, lane],
        nodes[node, 4, lane],
        nodes[node, 5, lane],
    )


@njit(refcount=False)
def _box_overlaps(
    tree: BoundsTree, leaf: int, room: Room, count: int, pairs: np.ndarray, found: int
) -> int:
    """Append the pairs of a leaf with ``count`` near ones; return as ``_leaf_overlaps``."""
    order, nodes, near, hits = tree.order, tree.nodes, room.near, room.hits
    number = 0
    for k in range(count):
        other, bits, keep = near[k, 0], near[k, 1], near[k, 2]
        if keep == 0:
            continue
        while bits != 0:
            i = lowest(bits)
            bits &= bits - 1
            x0, y0, z0 = nodes[leaf, 0, i], nodes[leaf, 1, i], nodes[leaf, 2, i]
            x1, y1, z1 = nodes[leaf, 3, i], nodes[leaf, 4, i], nodes[leaf, 5, i]
            mask = keep & overlaps(nodes, other, x0, y0, z0, x1, y1, z1)
            if other == leaf:
                mask = (mask >> (i + 1)) << (i + 1)
            hits[number, 0], hits[number, 1], hits[number, 2] = i, other, mask
            number += mask != 0
    for n in range(number):
        row, other, mask = order[LANES * leaf + hits[n, 0]], LANES * hits[n, 1], hits[n, 2]
        if found + LANES > len(pairs):
            return -1
        while mask != 0:
            partner = order[other + lowest(mask)]
            mask &= mask - 1
            pairs[found, 0], pairs[found, 1] = min(row, partner), max(row, partner)
            found += 1
    return found


@njit
def row_overlaps(
    tree: BoundsTree, rows: np.ndarray, wanted: np.ndarray, most: int, pairs: np.ndarray,
    start: int, stop: int,
) -> tuple[int, int]:  # fmt: skip
    """Write the pairs of wanted rows with all others; between two wanted ones only once.

    Ends soon after ``most`` are found. See ``Search``. Many rows go down the tree together, level
    by level: so memory is asked for in time.
    """
    order = tree.order
    here = np.empty(
        (tree.starts[1] + NEAR * LANES, 2), np.int64
    )  # of one row there is room for all
    there = np.empty_like(here)
    found, first, batch = 0, start, TOGETHER
    while first < stop:
        last = min(first + batch, stop)
        count = _leaves_of(tree, rows, first, last, here, there)
        if count < 0:
            batch = 1
            continue
        batch = TOGETHER
        done, row_found = first, found
        for k in range(count):
            number, leaf = here[k, 0], here[k, 1]
            if number > done:
                if found > most:
                    return found, number
                done, row_found = number, found
            if found + LANES > len(pairs):
                return row_found, number
            i = rows[number]
            mask = _overlaps_row(tree, leaf, i)
            while mask != 0:
                j = order[LANES * leaf + lowest(mask)]
                mask &= mask - 1
                if j != i and not (wanted[j] and j < i):
                    pairs[found, 0], pairs[found, 1] = min(i, j), max(i, j)
                    found += 1
        if found > most:
            return found, last
        first = last
    return found, stop


@njit(refcount=False)
def _leaves_of(
    tree: BoundsTree, rows: np.ndarray, first: int, last: int, here: np.ndarray, there: np.ndarray
) -> int:
    """Write the leaves that may hold what overlaps ``rows[first:last]``: number of row, and leaf.

    In the order of the rows; returns how many, -1 for no room. there: as large.
    """
    nodes, starts = tree.nodes, tree.starts
    count = last - first
    for k in range(count):
        here[k, 0], here[k, 1] = first + k, 0
    for level in range(len(starts) - 2, 0, -1):
        reached = 0
        for k in range(count):
            number, block = here[k, 0], here[k, 1]
            mask = _overlaps_row(tree, starts[level] + block, rows[number])
            if reached + LANES > len(there):
                return -1
            while mask != 0:
                child = LANES * block + lowest(mask)
                mask &= mask - 1
                for n in range(0, 6 * LANES, LINE):
                    fetch(nodes, 6 * LANES * (starts[level - 1] + child) + n)
                there[reached, 0], there[reached, 1] = number, child
                reached += 1
        for k in range(reached):
            here[k, 0], here[k, 1] = there[k, 0], there[k, 1]
        count = reached
    return count


@njit(refcount=False)
def _overlaps_row(tree: BoundsTree, block: int, row: int) -> int:
    """Return which bounds of a block overlap those of a row, a bit for each."""
    x0, y0, z0 = vector_at(tree.minimum, row)
    x1, y1, z1 = vector_at(tree.maximum, row)
    return overlaps(tree.nodes, block, x0, y0, z0, x1, y1, z1)


@njit
def _overlaps_between(
    minimum: Floats, maximum: Floats, tree: BoundsTree, pairs: np.ndarray, start: int, stop: int
) -> tuple[int, int]:
    """Write the pairs of ``find_candidates_between`` of rows of the first set. See ``Search``."""
    column = np.empty(len(tree.order), np.int64)
    found = 0
    for row in range(start, stop):
        low, high = vector_at(minimum, row), vector_at(maximum, row)
        reached = overlapping(tree, low, high, 0, column)
        if found + reached > len(pairs):
            return found, row
        for k in range(reached):
            pairs[found + k, 0], pairs[found + k, 1] = row, column[k]
        found += reached
    return found, stop
