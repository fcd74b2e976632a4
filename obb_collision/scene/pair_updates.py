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

"""Kernels of a check: pairs of a few boxes, and new pairs merged with those that stayed."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.queries.verdict.coarse import bounds_kernel
from obb_collision.queries.verdict.sat import box_at
from obb_collision.queries.verdict.verdict import SEPARATE, box_verdict
from obb_collision.scene.broad_phase.find_pairs import pairs_kernel
from obb_collision.typing import Columns, Floats

#: Up to so many boxes all pairs of bounds are compared: 2,016 take 3 us, a tree and its calls 40.
FEW = 64


@njit
def few_pairs(
    columns: Columns, slots: np.ndarray, changed: np.ndarray, last: np.ndarray,
    pairs: np.ndarray, verdicts: np.ndarray, old: np.ndarray,
) -> tuple[int, int]:  # fmt: skip
    """Write the colliding pairs of slots (n,), ascending, their verdicts, and where they were.

    last (k, 2): the pairs before, sorted. old: the row there of each pair of which neither is
    changed, -1 for the others. All outputs have room for all pairs; returns how many there are, and
    how many of them were there before.
    """
    count, boxes = len(slots), BoxArrays(*columns)
    minimum, maximum = np.empty_like(boxes.centers), np.empty_like(boxes.centers)
    bounds_kernel(columns, slots, minimum, maximum, 0, count)
    found, known, before = 0, 0, 0
    for n in range(count):
        i = slots[n]
        for m in range(n + 1, count):
            j = slots[m]
            if not _overlap(minimum, maximum, i, j):
                continue
            verdict = box_verdict(box_at(boxes, i), box_at(boxes, j))
            if verdict == SEPARATE:
                continue
            pairs[found, 0], pairs[found, 1], verdicts[found] = i, j, verdict
            old[found] = -1
            if not (changed[i] or changed[j]):
                while before < len(last) and (
                    last[before, 0] < i or (last[before, 0] == i and last[before, 1] < j)
                ):
                    before += 1
                if before < len(last) and last[before, 0] == i and last[before, 1] == j:
                    old[found] = before
                    known += 1
            found += 1
    return found, known


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
#: A pair as one number, which is less for an earlier one: more bits than a row has, and more than
#: any pair.
ROW_BITS, NEVER = 31, 2**62


@njit
def merge_keys(
    pairs: np.ndarray, verdicts: np.ndarray, levels: np.ndarray, changed: np.ndarray,
    keys: np.ndarray, out_pairs: np.ndarray, out_verdicts: np.ndarray, out_levels: np.ndarray,
    old: np.ndarray,
) -> int:  # fmt: skip
    """Do ``merge_pairs`` with new pairs that ``colliding_keys`` gave, which are changed."""
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
    """Write the pairs that stay and the new ones in order, both sorted; return how many there are.

    Those stay of whose slots neither is changed, and which are not decided again: again (m,), or
    empty for none. old: the row each pair had, -1 for a new one.
    """
    before, count = np.uint64(0), np.uint64(0)  # unsigned: no index is asked whether it is negative
    last = np.uint64(len(pairs))
    for new in range(len(new_pairs) + 1):
        limit = NEVER
        if new < len(new_pairs):
            limit = (new_pairs[new, 0] << ROW_BITS) | new_pairs[new, 1]
        while before < last:
            i, j = pairs[before, 0], pairs[before, 1]
            if ((i << ROW_BITS) | j) >= limit:
                break
            # written in any case, and over it if it goes: a branch would be guessed wrong
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
