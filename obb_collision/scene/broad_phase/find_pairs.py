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

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import ranges, run_parts
from obb_collision.accuracy import Accuracy, as_box_accuracy
from obb_collision.geometry.boxes import BoxArrays, Boxes
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
from obb_collision.queries.verdict.blocks import BLOCK, ROWS
from obb_collision.queries.verdict.coarse import bounds_of, meeting_bounds, spheres_may_collide
from obb_collision.queries.verdict.overlap import iou
from obb_collision.queries.verdict.pair_rows import RowPairs, one_set
from obb_collision.queries.verdict.verdict import (
    FEWEST_VERDICTS,
    SEPARATE,
    TOUCHING,
    Verdicts,
    decide_block,
    decide_exactly,
)
from obb_collision.scene.broad_phase.bounds_tree import BoundsTree
from obb_collision.scene.broad_phase.broad_phase import (
    NO_PAIRS,
    Pairs,
    find_candidates,
    find_candidates_between,
)
from obb_collision.scene.broad_phase.crowds import growing_candidates
from obb_collision.typing import Columns, Rows
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
        Without, the pairs among a; with it those of one box of a and one of b.
    exact : bool
        Decide by integer arithmetic what doubles can't tell from touching.
    accuracy : Accuracy or str
        "sphere" or "aabb" look less closely and never miss what "obb" reports.

    Returns
    -------
    (m, 2) array of int64
        Every pair that ``verdicts`` does not call SEPARATE, in lexicographic order. Of one set:
        rows i < j; of two: rows into a and b.

    Raises
    ------
    ValueError
        For another accuracy.
    TypeError
        For anything but boxes.

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
    if b is None:
        return find_pairs_and_verdicts(a, as_flag(exact, "exact"), accuracy)[0]
    check_kind(b, Boxes, "b")
    return _find_between(a, b, as_flag(exact, "exact"), as_box_accuracy(accuracy))


def any_collision(a: Boxes, b: Boxes | None = None, *, exact: bool = False) -> bool:
    """Return whether any two boxes collide, of one set or between two; stops at the first pair.

    Parameters
    ----------
    a : Boxes
    b : Boxes, optional
        Without, any two of a; with it, one of a and one of b.
    exact : bool
        Decide by integer arithmetic what doubles can't tell from touching, which else counts.

    Returns
    -------
    bool
        Whether ``find_pairs`` with the same arguments finds a pair.

    Raises
    ------
    TypeError
        For anything but boxes.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.any_collision(boxes), oc.any_collision(boxes[:2], boxes[2:])
    (True, False)
    """
    check_kind(a, Boxes, "a")
    if b is not None:
        check_kind(b, Boxes, "b")
    certain, others = as_flag(exact, "exact"), a if b is None else b
    if len(a) == 0 or len(others) == 0:
        return False
    tree = BoundsTree.build(*meeting_bounds(others))
    for pairs in growing_candidates(tree, None if b is None else meeting_bounds(a)):
        both, candidates = (a, pairs) if b is None else one_set(a, b, pairs)
        if len(colliding_pairs(both, candidates, certain)[0]):
            return True
    return False


def find_pairs_and_verdicts(
    boxes: Boxes, exact: bool = False, accuracy: Accuracy | str = "obb"
) -> tuple[Pairs, Verdicts]:
    """Return the pairs of ``find_pairs`` and the verdict (m,) int8 of each.

    Below "obb" that is TOUCHING, for pairs not proven separate.
    """
    level = as_box_accuracy(accuracy)
    bounds = bounds_of(boxes, level == Accuracy.SPHERE)
    if level == Accuracy.OBB:
        keys = find_candidates(*bounds, lambda pairs: colliding_keys(boxes, pairs))
        return pairs_of_keys(boxes, keys, exact)
    return _decided(boxes, find_candidates(*bounds), exact, level)


def _find_between(a: Boxes, b: Boxes, exact: bool, level: Accuracy) -> Pairs:
    spheres = level == Accuracy.SPHERE
    candidates = find_candidates_between(*bounds_of(a, spheres), *bounds_of(b, spheres))
    # of two sets in any case: a box of b that is one of a is still another box
    both, candidates = one_set(a, Boxes.trusted(*b.arrays), candidates)
    return _decided(both, candidates, exact, level)[0] - np.array([0, len(a)])


def _decided(
    boxes: Boxes, candidates: Pairs, exact: bool, level: Accuracy
) -> tuple[Pairs, Verdicts]:
    """Return the candidates (m, 2) that collide on a level, sorted, and their verdicts."""
    if level == Accuracy.OBB:
        return colliding_pairs(boxes, candidates, exact)
    bits, (first, second) = bits_of(len(boxes)), columns(candidates)
    if level == Accuracy.SPHERE:
        first, second = columns(candidates[spheres_may_collide(boxes, first, second)])
    return pairs_of_keys(boxes, (((first << bits) | second) << VERDICT_BITS) | TOUCHING, False)


def columns(pairs: Pairs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the two sides of pairs (m, 2), each in one run of memory, as kernels like it."""
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
    """Return a number for each of the candidates (m, 2) that is not SEPARATE: pair and verdict."""
    keys = np.empty(len(candidates), np.int64)
    return keys[: _keys_kernel(tuple(boxes.arrays), candidates, keys)]


def pairs_of_keys(boxes: Boxes, keys: NDArray[np.int64], exact: bool) -> tuple[Pairs, Verdicts]:
    """Return the pairs of all ``colliding_keys``, sorted, and their verdicts; keys are changed."""
    pairs, verdicts = np.empty((len(keys), 2), np.int64), np.empty(len(keys), np.int8)
    spare = np.empty_like(keys)
    if is_dealt(len(keys)):
        bits = bits_of(len(boxes))
        starts = deal(keys, spare, VERDICT_BITS + 2 * bits)
        given = bits, spare, keys, pairs, verdicts, starts
        run_buckets(lambda first, last: _bucket_kernel(*given, first, last), starts)
    else:
        pairs_kernel(len(boxes), keys, spare, pairs, verdicts)
    if exact:
        decide_exactly(boxes, pairs[:, 0], boxes, pairs[:, 1], verdicts)
        pairs, verdicts = pairs[verdicts != SEPARATE], verdicts[verdicts != SEPARATE]
    return pairs, verdicts


@njit
def _keys_kernel(columns: Columns, pairs: np.ndarray, keys: np.ndarray) -> int:
    """Write the keys of pairs (m, 2) of rows that are not SEPARATE; return how many there are."""
    boxes = BoxArrays(*columns)
    bits = bits_of(len(boxes.centers))
    block = np.empty((ROWS, BLOCK))
    first, second = np.empty(BLOCK, np.int64), np.empty(BLOCK, np.int64)
    verdicts, rows = np.empty(BLOCK, np.int8), RowPairs(boxes, first, boxes, second)
    kept = 0
    for start in range(0, len(pairs), BLOCK):
        count = min(BLOCK, len(pairs) - start)
        for n in range(count):
            first[n], second[n] = pairs[start + n, 0], pairs[start + n, 1]
        fetch_pairs(boxes, pairs, start + BLOCK, start + 2 * BLOCK)
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
    """Sort the keys of pairs of ``count`` rows; write what they stand for. spare (m,): room."""
    bits = bits_of(count)
    sort_numbers(keys, spare, VERDICT_BITS, VERDICT_BITS + 2 * bits)
    _part_keys(bits, keys, pairs, verdicts)


@njit
def _part_keys(bits: int, keys: np.ndarray, pairs: np.ndarray, verdicts: np.ndarray) -> None:
    """Write what keys stand for."""
    for n in range(len(keys)):
        pair = keys[n] >> VERDICT_BITS
        pairs[n, 0], pairs[n, 1] = pair >> bits, pair & ((1 << bits) - 1)
        verdicts[n] = keys[n] & ((1 << VERDICT_BITS) - 1)


@njit
def _bucket_kernel(
    bits: int, keys: np.ndarray, spare: np.ndarray, pairs: np.ndarray, verdicts: np.ndarray,
    starts: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Sort buckets ``first`` to ``last`` of keys, and write what they stand for."""
    for bucket in range(first, last):
        start, stop = starts[bucket], starts[bucket + 1]
        part = keys[start:stop]
        sort_numbers(part, spare[start:stop], VERDICT_BITS, VERDICT_BITS + 2 * bits - BUCKET_BITS)
        _part_keys(bits, part, pairs[start:stop], verdicts[start:stop])


def nms(boxes: Boxes, scores: ArrayLike, threshold: float) -> Rows:
    """Return the boxes that greedy non-maximum suppression keeps.

    From the best score down, a box is kept unless its ``iou`` with one that is kept exceeds the
    threshold. Only boxes that overlap are compared.

    Parameters
    ----------
    boxes : Boxes
    scores : (n,) array_like
        Of equal ones the first row is the better one.
    threshold : float
        From 0, which keeps no two boxes that share volume, to 1, which keeps all.

    Returns
    -------
    (m,) array of int64
        Their rows, best first.

    Raises
    ------
    ValueError
        For scores that are not finite, or not one per box, and for another threshold.
    TypeError
        For anything but boxes.

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
    better, worse = np.sort(ranks[pairs[iou(boxes, boxes, pairs) > most]], axis=1).T
    worse = worse[np.argsort(better)]
    counts = np.bincount(better, minlength=len(order))
    ends = np.cumsum(counts)
    kept = np.ones(len(order), np.bool_)
    for rank in np.flatnonzero(counts):
        if kept[rank]:  # all that are better have been asked
            kept[worse[ends[rank] - counts[rank] : ends[rank]]] = False
    return order[kept]
