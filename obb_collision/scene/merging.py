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

"""Pairs of the check before that nothing has changed about, merged with those decided anew."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.typing import Mask


@njit
def unchanged_pairs(pairs: np.ndarray, changed: np.ndarray) -> Mask:
    """Return (m,) whether neither of the slots of pairs (m, 2) is changed."""
    same = np.empty(len(pairs), np.bool_)
    for n in range(len(pairs)):
        same[n] = not (changed[pairs[n, 0]] or changed[pairs[n, 1]])
    return same


@njit
def merge_pairs(
    pairs: np.ndarray, verdicts: np.ndarray, levels: np.ndarray, kept: np.ndarray,
    new_pairs: np.ndarray, new_verdicts: np.ndarray, new_levels: np.ndarray,
    out_pairs: np.ndarray, out_verdicts: np.ndarray, out_levels: np.ndarray, old: np.ndarray,
) -> None:  # fmt: skip
    """Write the rows that are kept and the new ones in order, both sorted, with no pair in both.

    old: the row each pair had, -1 for a new one.
    """
    before, new = 0, 0
    for n in range(len(old)):
        while before < len(pairs) and not kept[before]:
            before += 1
        take_old = before < len(pairs)
        if take_old and new < len(new_pairs):
            i, j = pairs[before, 0], pairs[before, 1]
            take_old = i < new_pairs[new, 0] or (i == new_pairs[new, 0] and j < new_pairs[new, 1])
        if take_old:
            out_pairs[n, 0], out_pairs[n, 1] = pairs[before, 0], pairs[before, 1]
            out_verdicts[n], out_levels[n], old[n] = verdicts[before], levels[before], before
            before += 1
        else:
            out_pairs[n, 0], out_pairs[n, 1] = new_pairs[new, 0], new_pairs[new, 1]
            out_verdicts[n], out_levels[n], old[n] = new_verdicts[new], new_levels[new], -1
            new += 1
