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

"""A check of few boxes in one call of a kernel: of these a call costs more than the boxes do."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.queries.verdict.coarse import bounds_kernel
from obb_collision.queries.verdict.sat import box_at
from obb_collision.queries.verdict.verdict import SEPARATE, box_verdict
from obb_collision.typing import Floats

#: Up to so many boxes all pairs of bounds are compared: 2,016 take 3 us, a tree and its calls 40.
FEW = 64


@njit
def few_pairs(
    boxes: BoxArrays, slots: np.ndarray, changed: np.ndarray, last: np.ndarray,
    pairs: np.ndarray, verdicts: np.ndarray, old: np.ndarray,
) -> tuple[int, int]:  # fmt: skip
    """Write the colliding pairs of slots (n,), ascending, their verdicts, and where they were.

    last (k, 2): the pairs before, sorted. old: the row there of each pair of which neither is
    changed, -1 for the others. All outputs have room for all pairs; returns how many there are, and
    how many of them were there before.
    """
    count = len(slots)
    minimum, maximum = np.empty_like(boxes.centers), np.empty_like(boxes.centers)
    bounds_kernel(boxes, slots, minimum, maximum, 0, count)
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
        (minimum[i, 0] <= maximum[j, 0]) & (minimum[j, 0] <= maximum[i, 0])
        & (minimum[i, 1] <= maximum[j, 1]) & (minimum[j, 1] <= maximum[i, 1])
        & (minimum[i, 2] <= maximum[j, 2]) & (minimum[j, 2] <= maximum[i, 2])
    )  # fmt: skip
