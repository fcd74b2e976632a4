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
    before, new, count = 0, 0, 0
    while before < len(pairs) or new < len(new_pairs):
        if before < len(pairs):
            i, j = pairs[before, 0], pairs[before, 1]
            if changed[i] | changed[j] or (len(again) > 0 and again[before]):
                before += 1
                continue
            take_old = new == len(new_pairs) or (
                i < new_pairs[new, 0] or (i == new_pairs[new, 0] and j < new_pairs[new, 1])
            )
        else:
            take_old = False
        if take_old:
            out_pairs[count, 0], out_pairs[count, 1] = i, j
            out_verdicts[count], out_levels[count] = verdicts[before], levels[before]
            old[count] = before
            before += 1
        else:
            out_pairs[count, 0], out_pairs[count, 1] = new_pairs[new, 0], new_pairs[new, 1]
            out_verdicts[count], out_levels[count] = new_verdicts[new], new_levels[new]
            old[count] = -1
            new += 1
        count += 1
    return count
