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

from obb_collision.scene.broad_phase.bounds_tree import BoundsTree, move_kernel
from obb_collision.scene.broad_phase.broad_phase import Pairs, find_some_candidates_of
from obb_collision.typing import Floats, Rows

#: A tree is built anew once so many rows have moved, as a part of all: its blocks have grown then.
LIFETIME = 0.5


class KeptTree:
    """A tree over bounds (n, 3) to (n, 3), empty ones included, which the caller changes."""

    def __init__(self, minimum: Floats, maximum: Floats) -> None:
        self._tree = BoundsTree.build(minimum, maximum)
        self._places = np.empty(len(minimum), np.int64)
        self._places[self._tree.order] = np.arange(len(minimum))
        self._left = LIFETIME * len(minimum)

    def update(self, rows: Rows) -> bool:
        """Take over the changed bounds of rows (m,); False where a new tree is better."""
        self._left -= len(rows)
        if self._left < 0.0:
            return False
        move_kernel(*self._tree, self._places[rows])
        return True

    def pairs_of(self, rows: Rows, most: int) -> Pairs | None:
        """Return (k, 2) all i < j with i or j in rows whose bounds overlap, None above ``most``."""
        return find_some_candidates_of(self._tree, rows, most)
