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

"""Broad phase: find the pairs of axis-aligned bounds that overlap, without looking at all pairs.

Eight bounds are a leaf of a tree (see ``bounds_tree``). A search through the tree finds the leaves
that overlap a leaf; it skips those before this leaf in the order. Bounds are never rounded, so no
overlapping pair can be missed. Cost is O(n log n) for boxes of similar size spread in space. Where
everything overlaps everything there are n^2 / 2 pairs, or a limit (see ``ordered_candidates``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision import _threads
from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.trees.bounds_tree import (
    LANE_BITS,
    STACK,
    BoundsTree,
    lowest,
    move_kernel,
    overlapping,
    overlaps,
)
from obb_collision.numerics.intrinsics import LANES, fetch
from obb_collision.numerics.sorting import bits_of, sort_numbers
from obb_collision.numerics.vec3 import vector_at
from obb_collision.queries.verdict.coarse import bounds_kernel
from obb_collision.typing import Columns, Floats, Mask, Rows

Pairs = NDArray[np.int64]
#: Writes the pairs of rows ``start`` to ``stop`` while there is room; returns their number and the
#: first row not done.
Search = Callable[[Pairs, int, int], tuple[int, int]]
#: Turns pairs, in the thread that has found them, into an array with a row for each pair kept.
Convert = Callable[[Pairs], NDArray[np.int64]]

#: More pairs than there can be.
UNLIMITED = 2**62
NO_PAIRS: Pairs = np.empty((0, 2), np.int64)
#: Rows, and leaves, of a search below which a second thread does not pay: with 1,000 boxes, 125
#: leaves, it gains a tenth at best.
FEWEST_ROWS, FEWEST_LEAVES = 256, 96
#: Room for pairs: at first for each row, and at most (16 MB), unless a row needs more.
ROOM_PER_ROW, ROOM = 4, 1 << 20
#: Leaves, and rows, that are searched together.
NEAR, TOGETHER = 64, 64
#: Doubles in a cache line.
LINE = 8


def find_candidates(minimum: Floats, maximum: Floats, convert: Convert | None = None) -> Pairs:
    """Return (m, 2) all row pairs i < j whose closed bounds overlap, in no special order.

    minimum, maximum (n, 3): the corners of the bounds. convert: applied to the pairs found.
    """
    if len(minimum) < 2:
        return NO_PAIRS if convert is None else convert(NO_PAIRS)
    pairs = find_some_candidates(BoundsTree.build(minimum, maximum), UNLIMITED, convert)
    assert pairs is not None
    return pairs


def find_some_candidates(
    tree: BoundsTree, most: int, convert: Convert | None = None
) -> Pairs | None:
    """Return the pairs of `find_candidates`, None above ``most`` pairs: the search stops early."""
    search = partial(_self_overlaps, tuple(tree), most)
    return _collect(search, tree.leaves, FEWEST_LEAVES, LANES * ROOM_PER_ROW, most, convert)


def find_candidates_of(minimum: Floats, maximum: Floats, row: int) -> Pairs:
    """Return (m, 2) all pairs of one row with another whose bounds overlap, the lower one first."""
    overlap = ((minimum <= maximum[row]) & (minimum[row] <= maximum)).all(axis=1)
    overlap[row] = False
    others = np.flatnonzero(overlap)
    return np.column_stack([np.minimum(others, row), np.maximum(others, row)])


def find_some_candidates_of(tree: BoundsTree, rows: Rows, most: int) -> Pairs | None:
    """Return (m, 2) all row pairs i < j whose bounds overlap, with i or j in ``rows``.

    They are in no special order. None above ``most`` pairs.
    """
    wanted = np.zeros(len(tree.order), np.bool_)
    wanted[rows] = True
    search = partial(row_overlaps, tree, rows, wanted, most)
    return _collect(search, len(rows), FEWEST_ROWS, 4 * ROOM_PER_ROW, most)


def find_candidates_between(
    minimum: Floats, maximum: Floats, other_minimum: Floats, other_maximum: Floats
) -> Pairs:
    """Return (m, 2) the rows i, j of two sets of bounds (n, 3) that overlap, in no special order.

    The second set goes into a tree, in which each row of the first set is looked up.
    """
    if len(minimum) == 0 or len(other_minimum) == 0:
        return NO_PAIRS
    tree = BoundsTree.build(other_minimum, other_maximum)
    search = partial(_overlaps_between, minimum, maximum, tree)
    pairs = _collect(search, len(minimum), FEWEST_ROWS, 2 * ROOM_PER_ROW, UNLIMITED)
    assert pairs is not None
    return pairs


def _collect(
    search: Search,
    count: int,
    least: int,
    room_per_row: int,
    most: int,
    convert: Convert | None = None,
) -> Pairs | None:
    """Return the pairs of a search of ``count`` rows, None for more than ``most``."""
    parts = _threads.ranges(count, least)
    totals = [0] * len(parts)

    def collect(part: int) -> list[Pairs]:
        start, stop = parts[part]
        arrays: list[Pairs] = []
        room = min(room_per_row * (stop - start), ROOM) + LANES**2
        while start < stop and sum(totals) <= most:
            pairs = np.empty((room, 2), np.int64)
            number, reached = search(pairs, start, stop)
            if reached == start:  # the pairs of one row are too many
                room *= 4
                continue
            arrays.append(pairs[:number] if convert is None else convert(pairs[:number]))
            totals[part] += number
            start = reached
        return arrays

    if len(parts) == 1:
        chunks = collect(0)
    else:
        search(NO_PAIRS, 0, 0)  # see ``_threads.run``
        if convert is not None:
            convert(NO_PAIRS)
        chunks = [chunk for part in _threads.run_parts(collect, len(parts)) for chunk in part]
    if sum(totals) > most:
        return None
    return chunks[0] if len(chunks) == 1 else np.concatenate(chunks or [NO_PAIRS])


class Room(NamedTuple):
    """Room for the search of one leaf's pairs."""

    levels: Rows  #: (STACK,) of the blocks to visit ...
    waiting: Rows  #: (STACK,) ... and their numbers
    near: Rows  #: (NEAR, 3) a leaf, which boxes of the searched leaf overlap it, and vice versa
    hits: Rows  #: (NEAR * LANES, 3) a box of the searched leaf, a leaf, which boxes of it


@njit
def _self_overlaps(
    columns: Columns, most: int, pairs: np.ndarray, start: int, stop: int
) -> tuple[int, int]:
    """Write the overlapping pairs of leaves ``start`` to ``stop`` with themselves and later leaves.

    Ends soon after ``most`` are written. See ``Search``.
    """
    tree = BoundsTree(*columns)
    levels, waiting = np.empty(STACK, np.int64), np.empty(STACK, np.int64)
    near, hits = np.empty((NEAR, 3), np.int64), np.empty((NEAR * LANES, 3), np.int64)
    room, written = Room(levels, waiting, near, hits), 0
    for leaf in range(start, stop):
        more = _leaf_overlaps(tree, leaf, room, pairs, written)
        if more < 0:
            return written, leaf
        written = more
        if written > most:
            return written, leaf + 1
    return written, stop


@njit(refcount=False)
def _leaf_overlaps(tree: BoundsTree, leaf: int, room: Room, pairs: np.ndarray, written: int) -> int:
    """Append the pairs of a leaf and later leaves; return the number written, -1 for no room.

    First it finds leaves that overlap, then boxes, then pairs, each kind together: so branches are
    predicted well, and memory is fetched in time.
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
            written = _box_overlaps(tree, leaf, room, count, pairs, written)
            count = 0
            if depth == 0 or written < 0:
                return written
        depth -= 1
        level, block = levels[depth], waiting[depth]
        mask = overlaps(nodes, starts[level] + block, x0, y0, z0, x1, y1, z1)
        # leaves before this one find the pairs with it
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
    """Return the bounds of a leaf, infinite ones of the root."""
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
    tree: BoundsTree, leaf: int, room: Room, count: int, pairs: np.ndarray, written: int
) -> int:
    """Append the pairs of a leaf with ``count`` near leaves; return as ``_leaf_overlaps`` does."""
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
        if written + LANES > len(pairs):
            return -1
        while mask != 0:
            partner = order[other + lowest(mask)]
            mask &= mask - 1
            pairs[written, 0], pairs[written, 1] = min(row, partner), max(row, partner)
            written += 1
    return written


@njit
def row_overlaps(
    tree: BoundsTree, rows: np.ndarray, wanted: np.ndarray, most: int, pairs: np.ndarray,
    start: int, stop: int,
) -> tuple[int, int]:  # fmt: skip
    """Write the pairs of wanted rows with all others, each once. See ``Search``.

    Ends soon after ``most`` are written. Many rows go down the tree together, level by level, so
    that memory is fetched in time.
    """
    order = tree.order
    here = np.empty((tree.starts[1] + NEAR * LANES, 2), np.int64)  # room for all of one row
    there = np.empty_like(here)
    written, first, batch = 0, start, TOGETHER
    while first < stop:
        last = min(first + batch, stop)
        count = _leaves_of(tree, rows, first, last, here, there)
        if count < 0:
            batch = 1
            continue
        batch = TOGETHER
        done, row_written = first, written
        for k in range(count):
            number, leaf = here[k, 0], here[k, 1]
            if number > done:
                if written > most:
                    return written, number
                done, row_written = number, written
            if written + LANES > len(pairs):
                return row_written, number
            i = rows[number]
            mask = _overlaps_row(tree, leaf, i)
            while mask != 0:
                j = order[LANES * leaf + lowest(mask)]
                mask &= mask - 1
                if j != i and not (wanted[j] and j < i):
                    pairs[written, 0], pairs[written, 1] = min(i, j), max(i, j)
                    written += 1
        if written > most:
            return written, last
        first = last
    return written, stop


@njit(refcount=False)
def _leaves_of(
    tree: BoundsTree, rows: np.ndarray, first: int, last: int, here: np.ndarray, there: np.ndarray
) -> int:
    """Write the leaves that may overlap ``rows[first:last]``: number of the row, and leaf.

    In the order of the rows; returns how many, -1 for no room. there: scratch of the same size.
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
    written = 0
    for row in range(start, stop):
        low, high = vector_at(minimum, row), vector_at(maximum, row)
        reached = overlapping(tree, low, high, 0, column)
        if written + reached > len(pairs):
            return written, row
        for k in range(reached):
            pairs[written + k, 0], pairs[written + k, 1] = row, column[k]
        written += reached
    return written, stop


# Candidates in lexicographic order, piece by piece: where all objects are in one place, there are
# too many to hold.

#: Candidates of the first piece where one that collides is enough, and growth of later ones.
FIRST_PIECE, GROWTH = 16, 4
Bounds = tuple[Floats, Floats]


def ordered_candidates(
    tree: BoundsTree, room: int, own: Bounds | None = None, first: int | None = None
) -> Iterator[tuple[Pairs, int]]:
    """Yield pieces of all row pairs i < j that overlap, each with the first row that is not done.

    The pairs are in lexicographic order. A piece has all pairs of its rows i, at most max(room, n).
    own: minima and maxima (m, 3) of another set, to which i then belongs. first: how many pairs are
    enough for the first piece; each later piece has GROWTH times as many.
    """
    count, bounds = len(tree.order), own or (tree.minimum, tree.maximum)
    pairs = np.empty((max(room, count), 2), np.int64)
    column, spare = np.empty((2, count), np.int64)
    row, enough = 0, first or len(pairs)
    while row < len(bounds[0]):
        written, row = _rows_kernel(tree, *bounds, own is None, row, enough, column, spare, pairs)
        enough = min(enough * GROWTH, len(pairs))
        yield pairs[:written].copy(), row


def growing_candidates(tree: BoundsTree, own: Bounds | None = None) -> Iterator[Pairs]:
    """Yield ``ordered_candidates`` in growing pieces, for a caller who stops at the first hit."""
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
    written, bits = 0, bits_of(len(tree.order))
    while row < len(minimum) and written < enough:
        low, high = vector_at(minimum, row), vector_at(maximum, row)
        more = overlapping(tree, low, high, row + 1 if same else 0, column)
        if written + more > len(pairs):
            return written, row
        sort_numbers(column[:more], spare[:more], 0, bits)
        for k in range(more):
            pairs[written + k, 0], pairs[written + k, 1] = row, column[k]
        written += more
        row += 1
    return written, row


#: A kept tree is built anew once this part of its rows has moved: by then its blocks have grown.
LIFETIME = 0.5


class KeptTree:
    """A bounds tree that is kept while few boxes move: only their blocks and those above change.

    The caller changes its arrays minimum and maximum (n, 3); bounds may be empty.
    """

    def __init__(self, minimum: Floats, maximum: Floats) -> None:
        self._tree = BoundsTree.build(minimum, maximum)
        self._places = np.empty(len(minimum), np.int64)
        self._places[self._tree.order] = np.arange(len(minimum))
        self._left = LIFETIME * len(minimum)

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self._places)

    def update(self, rows: Rows) -> bool:
        """Take over the changed bounds of rows (m,); False where a new tree is better."""
        self._left -= len(rows)
        if self._left < 0.0:
            return False
        move_kernel(self._tree, self._places[rows])
        return True

    def pairs_of(self, rows: Rows, most: int) -> Pairs | None:
        """Return (k, 2) all overlapping row pairs i < j, i or j in rows; None above ``most``."""
        return find_some_candidates_of(self._tree, rows, most)

    def pairs_of_changes(
        self, slots: Rows, changed: Mask, active: Mask, boxes: Boxes
    ) -> Pairs | None:
        """Bound few changed slots (m,), `update` the tree and return their pairs, in one call.

        changed, active (n,): all changed and all active slots. None where a new tree is better.
        """
        self._left -= len(slots)
        if self._left < 0.0:
            return None
        pairs = np.empty((4 * ROOM_PER_ROW * len(slots) + LANES**2, 2), np.int64)
        slot_columns = slots, changed, active, tuple(boxes.arrays)
        count = _changes_kernel(*slot_columns, self._tree, self._places, pairs)
        if count < 0:  # no room
            return find_some_candidates_of(self._tree, slots[active[slots]], UNLIMITED)
        return pairs[:count]


@njit
def _changes_kernel(
    slots: np.ndarray, changed: np.ndarray, active: np.ndarray, boxes: Columns,
    tree: BoundsTree, places: np.ndarray, pairs: np.ndarray,
) -> int:  # fmt: skip
    """Bound slots, update the tree, and write their pairs; return how many, -1 for no room."""
    rows = np.empty_like(slots)
    moved = np.empty_like(slots)
    count = 0
    for n in range(len(slots)):
        slot = slots[n]
        moved[n] = places[slot]
        if active[slot]:
            rows[count] = slot
            count += 1
        else:
            for k in range(3):
                tree.minimum[slot, k], tree.maximum[slot, k] = np.inf, -np.inf
    bounds_kernel(boxes, rows, tree.minimum, tree.maximum, 0, count)
    move_kernel(tree, moved)
    written, reached = row_overlaps(tree, rows, changed, UNLIMITED, pairs, 0, count)
    return written if reached == count else -1
