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

"""Colliding pairs of boxes: all, any, and which boxes non-maximum suppression keeps.

The broad phase finds candidates, the certified test decides.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import ranges, run_parts
from obb_collision.accuracy import Accuracy, as_box_accuracy
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.geometry.trees.bounds_tree import BoundsTree
from obb_collision.geometry.validation import as_array, as_flag, check_kind, check_lengths
from obb_collision.numerics.intrinsics import fetch_pairs
from obb_collision.numerics.sorting import (
    BUCKET_BITS,
    bits_of,
    deal,
    is_dealt,
    run_buckets,
    sort_numbers,
)
from obb_collision.queries.verdict.coarse import (
    bounds_kernel,
    bounds_of,
    meeting_bounds,
    spheres_may_collide,
)
from obb_collision.queries.verdict.overlap import iou
from obb_collision.queries.verdict.pair_rows import RowPairs, one_set
from obb_collision.queries.verdict.sat import box_at
from obb_collision.queries.verdict.verdict import (
    FEWEST_VERDICTS,
    SEPARATE,
    TOUCHING,
    Verdicts,
    box_verdict,
    decide_block,
    decide_exactly,
)
from obb_collision.queries.verdict.witness import BLOCK_ROWS, PAIR_BLOCK
from obb_collision.scene.broad_phase.broad_phase import (
    NO_PAIRS,
    Pairs,
    find_candidates,
    find_candidates_between,
    growing_candidates,
)
from obb_collision.typing import Columns, Floats, Rows
from obb_collision.words import shown

#: Bits of a pair's key, below those of its rows, that are its verdict.
VERDICT_BITS = 2


def find_pairs(
    a: Boxes, b: Boxes | None = None, *, exact: bool = False, accuracy: Accuracy | str = "obb"
) -> Pairs:
    """Return every colliding pair of one set of boxes, or between two sets.

    Touching counts as colliding, and so does what doubles can't tell from touching. Boxes far from
    each other cost nothing: time grows with n log n and the pairs found.

    Parameters
    ----------
    a : Boxes
    b : Boxes, optional
        Without b, pairs within a are found; with b, pairs of one box of a and one box of b.
    exact : bool
        Decide by integer arithmetic what doubles can't tell from touching.
    accuracy : Accuracy or str
        "sphere" or "aabb" look less closely and never miss what "obb" reports.

    Returns
    -------
    (m, 2) array of int64
        Every pair that ``verdicts`` does not call SEPARATE, in lexicographic order. Of one set:
        rows i < j; of two: rows into a and b.

    References
    ----------
    Karras, Maximizing Parallelism in the Construction of BVHs (HPG 2012); Ericson 2005, 7.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.find_pairs(boxes).tolist()
    [[0, 1]]
    >>> oc.find_pairs(boxes, boxes[2:]).tolist()
    [[2, 0]]
    """
    check_kind(a, Boxes, "a")
    if b is not None:
        check_kind(b, Boxes, "b")
    exactly, level = as_flag(exact, "exact"), as_box_accuracy(accuracy)
    bounds = bounds_of(a, level == Accuracy.SPHERE)
    if b is None and level == Accuracy.OBB:
        keys = find_candidates(*bounds, lambda pairs: colliding_keys(a, pairs))
        return pairs_of_keys(a, keys, exactly)[0]
    if b is None:
        return _decided(a, find_candidates(*bounds), exactly, level)
    candidates = find_candidates_between(*bounds, *bounds_of(b, level == Accuracy.SPHERE))
    # a copy, as ``one_set`` goes by identity: a box of b that is one of a is still another box
    both, candidates = one_set(a, Boxes.trusted(*b.arrays), candidates)
    return _decided(both, candidates, exactly, level) - np.array([0, len(a)])


def any_collision(a: Boxes, b: Boxes | None = None, *, exact: bool = False) -> bool:
    """Return whether any two boxes collide, of one set or between two; stops at the first pair.

    Parameters
    ----------
    a : Boxes
    b : Boxes, optional
        Without b, pairs within a are tested; with b, pairs of one box of a and one box of b.
    exact : bool
        Decide by integer arithmetic what doubles can't tell from touching; else it collides.

    Returns
    -------
    bool
        Whether ``find_pairs`` with the same arguments finds a pair.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.any_collision(boxes), oc.any_collision(boxes[:2], boxes[2:])
    (True, False)
    """
    check_kind(a, Boxes, "a")
    if b is not None:
        check_kind(b, Boxes, "b")
    exactly, others = as_flag(exact, "exact"), a if b is None else b
    if len(a) == 0 or len(others) == 0:
        return False
    tree = BoundsTree.build(*meeting_bounds(others))
    for pairs in growing_candidates(tree, None if b is None else meeting_bounds(a)):
        both, candidates = (a, pairs) if b is None else one_set(a, b, pairs)
        if len(colliding_pairs(both, candidates, exactly)[0]):
            return True
    return False


def _decided(boxes: Boxes, candidates: Pairs, exact: bool, level: Accuracy) -> Pairs:
    """Return the candidates (m, 2) that collide on a level, sorted."""
    if level == Accuracy.OBB:
        return colliding_pairs(boxes, candidates, exact)[0]
    bits, (first, second) = bits_of(len(boxes)), columns(candidates)
    if level == Accuracy.SPHERE:
        first, second = columns(candidates[spheres_may_collide(boxes, first, second)])
    keys = (((first << bits) | second) << VERDICT_BITS) | TOUCHING
    return pairs_of_keys(boxes, keys, False)[0]


def columns(pairs: Pairs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the two columns of pairs (m, 2) as contiguous arrays, for kernels."""
    return np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1])


def colliding_pairs(boxes: Boxes, candidates: Pairs, exact: bool = False) -> tuple[Pairs, Verdicts]:
    """Return the candidates (m, 2) that are not SEPARATE, sorted, and their verdicts."""
    return pairs_of_keys(boxes, all_colliding_keys(boxes, candidates), exact)


def all_colliding_keys(boxes: Boxes, candidates: Pairs) -> NDArray[np.int64]:
    """Return the ``colliding_keys`` of candidates (m, 2), by several threads if they are many."""
    parts = ranges(len(candidates), FEWEST_VERDICTS)
    if len(parts) == 1:
        return colliding_keys(boxes, candidates)
    colliding_keys(boxes, NO_PAIRS)  # see ``_threads.run``
    keys = run_parts(lambda k: colliding_keys(boxes, candidates[slice(*parts[k])]), len(parts))
    return np.concatenate(keys)


def colliding_keys(boxes: Boxes, candidates: Pairs) -> NDArray[np.int64]:
    """Return a key for each of the candidates (m, 2) that is not SEPARATE: pair and verdict."""
    keys = np.empty(len(candidates), np.int64)
    return keys[: _keys_kernel(tuple(boxes.arrays), candidates, keys)]


def pairs_of_keys(boxes: Boxes, keys: NDArray[np.int64], exact: bool) -> tuple[Pairs, Verdicts]:
    """Return the pairs and verdicts of ``colliding_keys``, sorted; overwrites the keys."""
    pairs, verdicts = np.empty((len(keys), 2), np.int64), np.empty(len(keys), np.int8)
    spare = np.empty_like(keys)
    if is_dealt(len(keys)):
        bits = bits_of(len(boxes))
        starts = deal(keys, spare, VERDICT_BITS + 2 * bits)
        arrays = bits, spare, keys, pairs, verdicts, starts
        run_buckets(lambda first, last: _bucket_kernel(*arrays, first, last), starts)
    else:
        pairs_kernel(len(boxes), keys, spare, pairs, verdicts)
    if exact:
        decide_exactly(boxes, pairs[:, 0], boxes, pairs[:, 1], verdicts)
        pairs, verdicts = pairs[verdicts != SEPARATE], verdicts[verdicts != SEPARATE]
    return pairs, verdicts


@njit
def _keys_kernel(columns: Columns, pairs: np.ndarray, keys: np.ndarray) -> int:
    """Write the keys of pairs (m, 2) of rows that are not SEPARATE; return their number."""
    boxes = BoxArrays(*columns)
    bits = bits_of(len(boxes.centers))
    block = np.empty((BLOCK_ROWS, PAIR_BLOCK))
    first, second = np.empty(PAIR_BLOCK, np.int64), np.empty(PAIR_BLOCK, np.int64)
    verdicts, rows = np.empty(PAIR_BLOCK, np.int8), RowPairs(boxes, first, boxes, second)
    kept = 0
    for start in range(0, len(pairs), PAIR_BLOCK):
        count = min(PAIR_BLOCK, len(pairs) - start)
        for n in range(count):
            first[n], second[n] = pairs[start + n, 0], pairs[start + n, 1]
        fetch_pairs(boxes, pairs, start + PAIR_BLOCK, start + 2 * PAIR_BLOCK)
        decide_block(rows, 0, count, block, verdicts)
        for n in range(count):
            if verdicts[n] != SEPARATE:
                keys[kept] = (((first[n] << bits) | second[n]) << VERDICT_BITS) | verdicts[n]
                kept += 1
    return kept


@njit
def pairs_kernel(
    count: int, keys: np.ndarray, spare: np.ndarray, pairs: np.ndarray, verdicts: np.ndarray
) -> None:
    """Sort the keys of pairs of ``count`` rows; write pairs and verdicts. spare (m,): scratch."""
    bits = bits_of(count)
    sort_numbers(keys, spare, VERDICT_BITS, VERDICT_BITS + 2 * bits)
    _split_keys(bits, keys, pairs, verdicts)


@njit
def _split_keys(bits: int, keys: np.ndarray, pairs: np.ndarray, verdicts: np.ndarray) -> None:
    for n in range(len(keys)):
        pair = keys[n] >> VERDICT_BITS
        pairs[n, 0], pairs[n, 1] = pair >> bits, pair & ((1 << bits) - 1)
        verdicts[n] = keys[n] & ((1 << VERDICT_BITS) - 1)


@njit
def _bucket_kernel(
    bits: int, keys: np.ndarray, spare: np.ndarray, pairs: np.ndarray, verdicts: np.ndarray,
    starts: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Sort buckets ``first`` to ``last`` of keys; write pairs and verdicts."""
    for bucket in range(first, last):
        start, stop = starts[bucket], starts[bucket + 1]
        part = keys[start:stop]
        sort_numbers(part, spare[start:stop], VERDICT_BITS, VERDICT_BITS + 2 * bits - BUCKET_BITS)
        _split_keys(bits, part, pairs[start:stop], verdicts[start:stop])


def iou_matrix(a: Boxes, b: Boxes, *, generalized: bool = False) -> Floats:
    """Return the ``iou`` of each box of a with each box of b.

    Parameters
    ----------
    a, b : Boxes
    generalized : bool
        As in ``iou``; without, only boxes that overlap are compared.

    Returns
    -------
    (n, m) array

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.iou_matrix(boxes[:1], boxes).round(6).tolist()
    [[1.0, 0.333333, 0.0]]
    """
    check_kind(a, Boxes, "a")
    check_kind(b, Boxes, "b")
    if as_flag(generalized, "generalized"):
        pairs = np.indices((len(a), len(b))).reshape(2, -1).T
    else:
        pairs = find_pairs(a, b)
    result = np.zeros((len(a), len(b)))
    result[tuple(pairs.T)] = iou(a, b, pairs, generalized=generalized)
    return result


def nms(
    boxes: Boxes, scores: ArrayLike, threshold: float, classes: Iterable[Any] | None = None
) -> Rows:
    """Return the rows of the boxes that greedy non-maximum suppression keeps, best first.

    From the best score down, a box is kept unless its ``iou`` with one that is kept exceeds the
    threshold. Only boxes that overlap are compared.

    Parameters
    ----------
    boxes : Boxes
    scores : (n,) array_like
        Of equal scores the first row is the better one.
    threshold : float
        From 0, which keeps no two boxes that share volume, to 1, which keeps all.
    classes : n numbers or strings, optional
        Only boxes of equal classes suppress each other.

    Returns
    -------
    (m,) array of int64
        Rows of the kept boxes, best first.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [0.1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.nms(boxes, [0.7, 0.9, 0.8], threshold=0.5).tolist()
    [1, 2]
    """
    check_kind(boxes, Boxes, "boxes")
    values = as_array(scores, "scores", (None,))
    check_lengths(boxes=boxes, scores=values)
    most = float(as_array(threshold, "threshold", ()))
    if not 0.0 <= most <= 1.0:
        raise ValueError(f"threshold must be from 0 to 1, got {shown(threshold)}")
    order = np.argsort(-values, kind="stable")
    ranks = np.empty_like(order)
    ranks[order] = np.arange(len(order))
    pairs = find_pairs(boxes)
    if classes is not None:
        numbers: dict[Any, int] = {}
        try:
            labels = np.array([numbers.setdefault(k, len(numbers)) for k in classes], np.int64)
        except TypeError:
            raise ValueError("classes must be a number or a string for each box") from None
        check_lengths(boxes=boxes, classes=labels)
        pairs = pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]]]
    better, worse = np.sort(ranks[pairs[iou(boxes, boxes, pairs) > most]], axis=1).T
    worse = worse[np.argsort(better)]
    counts = np.bincount(better, minlength=len(order))
    ends = np.cumsum(counts)
    kept = np.ones(len(order), np.bool_)
    for rank in np.flatnonzero(counts):
        if kept[rank]:  # all better boxes have been asked
            kept[worse[ends[rank] - counts[rank] : ends[rank]]] = False
    return order[kept]


# Kernels of a check: pairs of a few boxes, and new pairs merged with those that stayed.

#: Up to so many boxes all pairs of bounds are compared: 2,016 take 3 us, a tree and its calls 40.
FEW_BOXES = 64


@njit
def few_pairs(
    columns: Columns, slots: np.ndarray, changed: np.ndarray, last: np.ndarray,
    pairs: np.ndarray, verdicts: np.ndarray, old: np.ndarray,
) -> tuple[int, int]:  # fmt: skip
    """Write the colliding pairs of slots (n,), ascending, their verdicts, and their old rows.

    last (k, 2): the pairs before, sorted. old: the row there of each pair without a changed slot,
    -1 for the others. All outputs have room for all pairs; returns the number of pairs, and of
    those that were there before.
    """
    size, boxes = len(slots), BoxArrays(*columns)
    minimum, maximum = np.empty_like(boxes.centers), np.empty_like(boxes.centers)
    bounds_kernel(columns, slots, minimum, maximum, 0, size)
    count, kept, before = 0, 0, 0
    for n in range(size):
        i = slots[n]
        for m in range(n + 1, size):
            j = slots[m]
            if not _overlap(minimum, maximum, i, j):
                continue
            verdict = box_verdict(box_at(boxes, i), box_at(boxes, j))
            if verdict == SEPARATE:
                continue
            pairs[count, 0], pairs[count, 1], verdicts[count] = i, j, verdict
            old[count] = -1
            if not (changed[i] or changed[j]):
                while before < len(last) and (
                    last[before, 0] < i or (last[before, 0] == i and last[before, 1] < j)
                ):
                    before += 1
                if before < len(last) and last[before, 0] == i and last[before, 1] == j:
                    old[count] = before
                    kept += 1
            count += 1
    return count, kept


@njit
def _overlap(minimum: Floats, maximum: Floats, i: int, j: int) -> bool:
    """Return whether bounds i and j have a common point."""
    return (
        (minimum[i, 0] <= maximum[j, 0])
        & (minimum[j, 0] <= maximum[i, 0])
        & (minimum[i, 1] <= maximum[j, 1])
        & (minimum[j, 1] <= maximum[i, 1])
        & (minimum[i, 2] <= maximum[j, 2])
        & (minimum[j, 2] <= maximum[i, 2])
    )


#: The level of pairs that come as keys.
OBB = int(Accuracy.OBB)
#: A pair as one number, in the order of pairs: bits of a row, and a number above all pairs.
ROW_BITS, ABOVE_ALL_PAIRS = 31, 2**62


@njit
def merge_keys(
    pairs: np.ndarray, verdicts: np.ndarray, levels: np.ndarray, changed: np.ndarray,
    keys: np.ndarray, out_pairs: np.ndarray, out_verdicts: np.ndarray, out_levels: np.ndarray,
    old: np.ndarray,
) -> int:  # fmt: skip
    """Merge pairs as `merge_pairs`, with new ones from ``colliding_keys``; overwrites the keys."""
    new_pairs, new_verdicts = np.empty((len(keys), 2), np.int64), np.empty(len(keys), np.int8)
    pairs_kernel(len(changed), keys, np.empty_like(keys), new_pairs, new_verdicts)
    new_levels, again = np.full(len(keys), OBB, np.int8), np.empty(0, np.bool_)
    return merge_pairs(
        pairs, verdicts, levels, changed, again, new_pairs, new_verdicts, new_levels,
        out_pairs, out_verdicts, out_levels, old,
    )  # fmt: skip


@njit
def merge_pairs(
    pairs: np.ndarray, verdicts: np.ndarray, levels: np.ndarray, changed: np.ndarray,
    again: np.ndarray, new_pairs: np.ndarray, new_verdicts: np.ndarray, new_levels: np.ndarray,
    out_pairs: np.ndarray, out_verdicts: np.ndarray, out_levels: np.ndarray, old: np.ndarray,
) -> int:  # fmt: skip
    """Merge the pairs that stay with new ones, both sorted; return their number.

    A pair stays if neither slot is changed and it is not decided again: again (m,), or empty for
    none. old: the row each pair had, -1 for a new one.
    """
    before, count = np.uint64(0), np.uint64(0)  # unsigned: without a test for a negative index
    last = np.uint64(len(pairs))
    for new in range(len(new_pairs) + 1):
        limit = ABOVE_ALL_PAIRS
        if new < len(new_pairs):
            limit = (new_pairs[new, 0] << ROW_BITS) | new_pairs[new, 1]
        while before < last:
            i, j = pairs[before, 0], pairs[before, 1]
            if ((i << ROW_BITS) | j) >= limit:
                break
            # written in any case, and overwritten if it goes: a branch would be predicted badly
            out_pairs[count, 0], out_pairs[count, 1] = i, j
            out_verdicts[count], out_levels[count] = verdicts[before], levels[before]
            old[count] = before
            goes = changed[np.uint64(i)] | changed[np.uint64(j)]
            goes |= len(again) > 0 and again[before]
            count += np.uint64(not goes)
            before += np.uint64(1)
        if new < len(new_pairs):
            out_pairs[count, 0], out_pairs[count, 1] = new_pairs[new, 0], new_pairs[new, 1]
            out_verdicts[count], out_levels[count] = new_verdicts[new], new_levels[new]
            old[count] = -1
            count += np.uint64(1)
    return int(count)
