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

"""Pairs of objects whose bounds meet, for effects that look at more than what collides."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.validation import Floats
from obb_collision.scene.broad_phase import Pairs, find_candidates, find_candidates_of
from obb_collision.scene.effects.base import Cycle, Mask
from obb_collision.scene.store import Rows

#: With fewer callers than one in this many objects, only their pairs are looked for.
FEW = 32


def meeting_pairs(
    cycle: Cycle, slots: Rows, minimum: Floats, maximum: Floats, callers: Mask | None
) -> Pairs:
    """Return pairs (k, 2) of slots, sorted, that may collide and whose bounds meet.

    slots (n,) ascending, with bounds minimum and maximum (n, 3); callers (n,): one of each pair or
    both are among them, None for all.
    """
    if callers is None:
        pairs = find_candidates(minimum, maximum)
    elif np.count_nonzero(callers) * FEW < len(slots):
        pairs = find_candidates_of(minimum, maximum, np.flatnonzero(callers))
    else:
        pairs = find_candidates(minimum, maximum)
        pairs = pairs[callers[pairs].any(axis=1)]
    pairs = cycle.counted(slots[pairs])
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
