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

"""A tree of bounds that is kept while few boxes move: only their blocks and those above change."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.coarse import bounds_kernel
from obb_collision.scene.broad_phase.bounds_tree import LANES, BoundsTree, move_kernel
from obb_collision.scene.broad_phase.broad_phase import (
    ROOM_PER_ROW,
    UNLIMITED,
    Pairs,
    find_some_candidates_of,
    row_overlaps,
)
from obb_collision.typing import Columns, Floats, Mask, Rows

#: A tree is built anew once so many rows have moved, as a part of all: its blocks have grown then.
LIFETIME = 0.5


class KeptTree:
    """A tree over bounds (n, 3) to (n, 3), empty ones included, which the caller changes."""

    def __init__(self, minimum: Floats, maximum: Floats) -> None:
        self._tree = BoundsTree.build(minimum, maximum)
        self._places = np.empty(len(minimum), np.int64)
        self._places[self._tree.order] = np.arange(len(minimum))
        self._left = LIFETIME * len(minimum)

    @property
    def size(self) -> int:
        """Number of rows it was made of."""
        return len(self._places)

    def update(self, rows: Rows) -> bool:
        """Take over the changed bounds of rows (m,); False where a new tree is better."""
        self._left -= len(rows)
        if self._left < 0.0:
            return False
        move_kernel(self._tree, self._places[rows])
        return True

    def pairs_of(self, rows: Rows, most: int) -> Pairs | None:
        """Return (k, 2) all i < j with i or j in rows whose bounds overlap, None above ``most``."""
        return find_some_candidates_of(self._tree, rows, most)

    def pairs_of_changes(
        self, slots: Rows, changed: Mask, active: Mask, boxes: Boxes
    ) -> Pairs | None:
        """Do ``update`` and ``pairs_of`` for few slots (m,), and bound them before, in one call.

        changed, active (n,): all that are changed, and take part. None where a new tree is better.
        """
        self._left -= len(slots)
        if self._left < 0.0:
            return None
        pairs = np.empty((4 * ROOM_PER_ROW * len(slots) + LANES**2, 2), np.int64)
        given = slots, changed, active, tuple(boxes.arrays)
        found = _changes_kernel(*given, self._tree, self._places, pairs)
        if found < 0:  # no room
            return find_some_candidates_of(self._tree, slots[active[slots]], UNLIMITED)
        return pairs[:found]


@njit
def _changes_kernel(
    slots: np.ndarray, changed: np.ndarray, active: np.ndarray, boxes: Columns,
    tree: BoundsTree, places: np.ndarray, pairs: np.ndarray,
) -> int:  # fmt: skip
    """Bound slots, write that to the tree, and write their pairs; return how many, -1: no room."""
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
    found, reached = row_overlaps(tree, rows, changed, UNLIMITED, pairs, 0, count)
    return found if reached == count else -1
