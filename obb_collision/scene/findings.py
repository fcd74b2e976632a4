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

"""Findings of a check, and what it needs to know of objects that moves do not change."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.queries.verdict.verdict import Verdicts
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.effects.base import Outcome
from obb_collision.scene.refinement.ladder import Found, is_plain, needs_spheres
from obb_collision.scene.refinement.refine import Levels
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Mask, Rows


class Layout(NamedTuple):
    """What a check needs to know of the objects that doesn't change when they move."""

    revision: int  #: of the store
    active: Rows  #: slots, ascending
    whole: bool  #: whether these are the first ones, with no gap
    plain: bool  #: whether every pair is decided on OBB
    spheres: bool  #: whether the broad phase must look for spheres, too

    @classmethod
    def of(cls, store: ObjectStore) -> Layout:
        """Return what there is to know of a store now."""
        active = np.flatnonzero(store.active)
        whole = len(active) == 0 or int(active[-1]) == len(active) - 1
        return cls(store.revision, active, whole, is_plain(store), needs_spheres(store))


@dataclass(eq=False)
class Findings:
    """What a check found, and what its effects gave so far.

    behind: whether a budget left pairs on a lower level than they ask for; cap: the highest level
    it allowed, None without a budget.
    old (m,): the row of each pair in the findings before, -1 if it was decided anew; None if all
    were.
    total: how many pairs collide, at least, where a limit has left some out, else None; colliding
    (n,): then which slots do, in whatever pair.
    """

    pairs: Pairs
    verdicts: Verdicts
    accuracies: Levels
    behind: bool = False
    cap: Accuracy | None = None
    old: Rows | None = None
    total: int | None = None
    colliding: Mask | None = None
    outcomes: dict[str, Outcome] = field(default_factory=dict)

    @property
    def found(self) -> Found:
        """Pairs, verdicts and levels."""
        return self.pairs, self.verdicts, self.accuracies
