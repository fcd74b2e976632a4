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

"""A limit on colliding pairs: the first ones in order are kept, and of the others who collides.

Where no more pairs collide than the limit, or than there is room for candidates, nothing differs
from a check without a limit. Else the candidates are decided in lexicographic order, piece by
piece, until there are more colliding ones than the limit: these are kept. For objects not yet seen
to collide one partner each is searched then. So memory grows with the limit and the number of
objects, and time does where objects collide with most of their candidates, as they do in one place.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from obb_collision.scene.broad_phase.bounds_tree import BoundsTree
from obb_collision.scene.broad_phase.broad_phase import Pairs, find_some_candidates
from obb_collision.scene.broad_phase.crowds import (
    FIRST_PARTNERS,
    GROWTH,
    ordered_candidates,
    partners,
)
from obb_collision.scene.refinement.ladder import NONE, Decided, joined
from obb_collision.typing import Mask, Rows

#: Decides pairs (m, 2) of slots; the first call may use a budget.
Decide = Callable[[Pairs], Decided]

#: Candidates held at once: as many for each pair of the limit ...
PER_PAIR = 8
#: ... or for each object, where that is more.
PER_OBJECT = 32
#: Candidates of a piece, where there are more: 2 MB, so that pieces take milliseconds.
PIECE = 1 << 17


def most_candidates(limit: int, count: int) -> int:
    """Return how many candidates of ``count`` objects are held at once."""
    return max(PER_PAIR * limit, PER_OBJECT * count)


def find_limited(
    tree: BoundsTree, slots: Rows, names: int, limit: int, decide: Decide
) -> tuple[Decided, int | None, Mask | None]:
    """Return the first ``limit`` pairs that collide, how many do at least, and which slots.

    Both are None where all pairs are there. tree: over slots (n,), ascending; names: how many slots
    there are.
    """
    candidates = find_some_candidates(tree, most_candidates(limit, len(slots)))
    if candidates is not None:
        found = decide(slots[candidates])
        if len(found.pairs) <= limit:
            return found, None, None
        return _first(found, limit), len(found.pairs), _mask(found.pairs, names)
    parts, total, marked = [NONE], 0, np.zeros(names, np.bool_)
    for pairs, row in ordered_candidates(tree, min(PIECE, 2 * limit)):
        parts.append(decide(slots[pairs]))
        total += len(parts[-1].pairs)
        marked |= _mask(parts[-1].pairs, names)
        if total > limit:
            _mark_others(tree, slots, row, decide, marked)
            return _first(joined(parts), limit), total, marked
    return joined(parts), None, None


def _mark_others(tree: BoundsTree, slots: Rows, row: int, decide: Decide, marked: Mask) -> None:
    """Mark all that collide; all pairs with a row before ``row`` are decided and marked."""
    rows = np.arange(row, len(slots))
    skip, most = 0, FIRST_PARTNERS
    while True:
        rows = rows[~marked[slots[rows]]]
        if len(rows) == 0:
            return
        left = []
        step = max(1, PIECE // most)
        for k in range(0, len(rows), step):
            some = rows[k : k + step]
            some = some[~marked[slots[some]]]
            pairs, counts = partners(tree, some, row, skip, most)
            marked |= _mask(decide(slots[pairs]).pairs, len(marked))
            left.append(some[counts == most])
        rows = np.concatenate(left)
        skip, most = skip + most, most * GROWTH


def _mask(pairs: Pairs, names: int) -> Mask:
    mask = np.zeros(names, np.bool_)
    mask[pairs.ravel()] = True
    return mask


def _first(found: Decided, limit: int) -> Decided:
    return found.take(np.arange(limit))  # a copy: what is left out need not stay in memory
