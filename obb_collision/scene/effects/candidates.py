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

"""Pairs of objects whose bounds overlap, for effects on more than the colliding pairs."""

from __future__ import annotations

import numpy as np

from obb_collision.scene.broad_phase.bounds_tree import BoundsTree
from obb_collision.scene.broad_phase.broad_phase import (
    NO_PAIRS,
    UNLIMITED,
    Pairs,
    find_some_candidates,
    find_some_candidates_of,
)
from obb_collision.scene.broad_phase.crowds import ordered_candidates
from obb_collision.scene.effects.base import Cycle
from obb_collision.typing import Floats, Mask, Rows

#: With fewer selected than one in this many objects, only their pairs are looked for.
FEW = 32
#: Pairs of a piece, where there are too many.
PIECE = 1 << 17


def meeting_pairs(
    cycle: Cycle, slots: Rows, minimum: Floats, maximum: Floats, selected: Mask | None
) -> Pairs:
    """Return pairs (k, 2) of slots, sorted, that may collide and whose bounds overlap.

    At most ``cycle.limit``, the first ones. slots (n,) ascending, with bounds minimum and maximum
    (n, 3); selected (n,): objects of which each pair has at least one, None for all.
    """
    most = UNLIMITED if cycle.limit is None else cycle.limit
    if len(slots) < 2:
        return NO_PAIRS
    some = selected is not None and np.count_nonzero(selected) * FEW < len(slots)
    tree = BoundsTree.build(minimum, maximum)
    if selected is not None and some:
        pairs = find_some_candidates_of(tree, np.flatnonzero(selected), most)
    else:
        pairs = find_some_candidates(tree, most)
    if pairs is None:
        return _first_pairs(cycle, slots, minimum, tree, selected, most)
    if selected is not None and not some:
        pairs = pairs[selected[pairs].any(axis=1)]
    pairs = cycle.counted(slots, minimum, pairs)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _first_pairs(
    cycle: Cycle, slots: Rows, minimum: Floats, tree: BoundsTree, selected: Mask | None, most: int
) -> Pairs:
    """Return the first ``most`` pairs in lexicographic order, and note that there are more."""
    parts, count = [NO_PAIRS], 0
    for pairs, _ in ordered_candidates(tree, min(most, PIECE)):
        if selected is not None:
            pairs = pairs[selected[pairs].any(axis=1)]
        parts.append(cycle.counted(slots, minimum, pairs))
        count += len(parts[-1])
        if count > most:
            cycle.notes.append(f"more than {most} pairs come near each other: the first are done")
            break
    return np.concatenate(parts)[:most]
