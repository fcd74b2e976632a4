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

"""The checker: composes one check of a store, and keeps what the next one can use again."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.coarse import meeting_bounds, sphere_bounds
from obb_collision.queries.verdict.verdict import Verdicts
from obb_collision.scene.broad_phase.bounds_tree import BoundsTree
from obb_collision.scene.broad_phase.broad_phase import (
    NO_PAIRS,
    UNLIMITED,
    Pairs,
    find_candidates,
    find_some_candidates,
)
from obb_collision.scene.broad_phase.find_pairs import colliding_pairs, columns
from obb_collision.scene.broad_phase.kept_tree import KeptTree
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.effects.base import Outcome
from obb_collision.scene.limit import find_limited, most_candidates
from obb_collision.scene.refinement.budget import Budget
from obb_collision.scene.refinement.ladder import (
    NONE,
    Found,
    decide_pairs,
    is_plain,
    needs_spheres,
    pair_levels,
)
from obb_collision.scene.refinement.refine import Levels
from obb_collision.scene.store.allowed import AllowedPairs, PairFilter
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Rows

#: With fewer than one object in this many changed, only pairs of the changed ones are looked at.
INCREMENTAL_SHARE = 32


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
    colliding: NDArray[np.bool_] | None = None
    outcomes: dict[str, Outcome] = field(default_factory=dict)


class Checker:
    """Finds the pairs of a store that collide, from scratch or by what changed.

    limit: how many pairs are kept, None for all.
    """

    def __init__(self, store: ObjectStore, cache: ShapeCache, allowed: AllowedPairs) -> None:
        self._store = store
        self._cache = cache
        self._allowed = allowed
        self._bounds: tuple[Floats, Floats] | None = None
        self._tree: KeptTree | None = None  # over the bounds
        self._spheres = False  # whether the bounds hold the spheres, too
        self.limit: int | None = None
        self.last: Findings | None = None
        self.pair_filter: PairFilter | None = None

    @property
    def behind(self) -> bool:
        """Whether the next check may get further though nothing changes."""
        return self.last is not None and self.last.behind

    def find(self, depth: int, exact: bool, budget: Budget | None = None) -> Findings:
        """Return what collides. depth: of the boxes on the level "obb_tree"."""
        store, last = self._store, self.last
        self.pair_filter = self._allowed.pair_filter(store.names, store.version)
        found = None
        if last is not None and last.total is None and not store.changed[store.active].all():
            found = self._find_changed(last, depth, exact, budget)
        if found is None:
            found = self._find_all(depth, exact, budget)
        found.cap = None if budget is None else budget.cap
        store.changed[:] = False
        self.last = found
        return found

    def _find_all(self, depth: int, exact: bool, budget: Budget | None) -> Findings:
        """Decide all pairs, or as many as the limit leaves."""
        active, minimum, maximum = self._all_bounds()
        if self.limit is None or len(active) < 2:
            candidates = active[find_candidates(minimum, maximum)]
            found, behind = self._decide(candidates, depth, exact, budget)
            return Findings(*found, behind)
        behinds: list[bool] = []

        def decide(candidates: Pairs) -> Found:
            # A budget is for one round of decisions; OBB, which misses nothing, has to do after it.
            later = bool(behinds) and budget is not None
            highest = Accuracy.OBB if later else Accuracy.MESH
            given = None if later else budget
            found, behind = self._decide(candidates, depth, exact, given, highest=highest)
            behinds.append(behind or later)
            return found

        tree = BoundsTree.build(minimum, maximum)
        limited = find_limited(tree, active, len(self._store.names), self.limit, decide)
        if limited.colliding is None:
            return Findings(*limited.found, any(behinds))
        # Never behind: pairs that are left out can't be kept for the next check.
        return Findings(*limited.found, total=limited.total, colliding=limited.colliding)

    def _find_changed(
        self, last: Findings, depth: int, exact: bool, budget: Budget | None
    ) -> Findings | None:
        """Decide pairs with a change to them, and those left behind; None: too many for that."""
        store = self._store
        candidates = self._candidates()
        if candidates is None:
            return None
        same = ~store.changed[last.pairs].any(axis=1)
        waits = same & (last.accuracies < pair_levels(store, *columns(last.pairs))) & last.behind
        waiting = last.pairs[waits], last.verdicts[waits], last.accuracies[waits]
        (new, verdicts, levels), behind = self._decide(candidates, depth, exact, budget, waiting)
        kept = np.flatnonzero(same & ~waits)
        pairs = np.concatenate([last.pairs[kept], new])
        if self.limit is not None and len(pairs) > self.limit:
            return None
        order = np.lexsort((pairs[:, 1], pairs[:, 0]))
        old = np.concatenate([kept, np.full(len(new), -1)])[order]
        verdicts = np.concatenate([last.verdicts[kept], verdicts])[order]
        levels = np.concatenate([last.accuracies[kept], levels])[order]
        return Findings(pairs[order], verdicts, levels, behind, old=old)

    def _decide(
        self, candidates: Pairs, depth: int, exact: bool, budget: Budget | None,
        waiting: Found = NONE, highest: Accuracy = Accuracy.MESH,
    ) -> tuple[Found, bool]:  # fmt: skip
        store = self._store
        if self.pair_filter is not None:
            candidates = candidates[self.pair_filter(*candidates.T)]  # may not touch
        if is_plain(store):
            pairs, verdicts = colliding_pairs(store.all_boxes(), candidates, exact)
            return (pairs, verdicts, np.full(len(pairs), Accuracy.OBB, np.int8)), False
        return decide_pairs(store, self._cache, candidates, depth, exact, budget, waiting, highest)

    def _candidates(self) -> Pairs | None:
        """Return pairs (m, 2) of changed slots whose bounds overlap; None: too many."""
        store = self._store
        changed = np.flatnonzero(store.changed)
        bounds = self._bounds
        most = UNLIMITED if self.limit is None else most_candidates(self.limit, len(store.names))
        if (
            bounds is None
            or len(bounds[0]) < len(store.names)  # the store has grown
            or len(changed) * INCREMENTAL_SHARE >= len(store.names)
            or needs_spheres(store) != self._spheres  # the bounds are of another kind
        ):
            active, minimum, maximum = self._all_bounds()
            if len(active) < 2:
                return NO_PAIRS
            candidates = find_some_candidates(BoundsTree.build(minimum, maximum), most)
            if candidates is None:
                return None
            candidates = active[candidates]
            return candidates[store.changed[candidates].any(axis=1)]
        active = changed[store.active[changed]]
        bounds[0][changed] = np.inf  # empty: overlaps nothing
        bounds[1][changed] = -np.inf
        bounds[0][active], bounds[1][active] = self._bounds_of(store.boxes(active))
        if self._tree is None or not self._tree.update(changed):
            self._tree = KeptTree(*bounds)
        return self._tree.pairs_of(active, most)

    def _all_bounds(self) -> tuple[Rows, Floats, Floats]:
        """Return the active slots (k,) and their bounds (k, 3), (k, 3), and keep these by slot."""
        store = self._store
        self._spheres = needs_spheres(store)
        active = np.flatnonzero(store.active)
        minimum, maximum = self._bounds_of(store.boxes(active))
        shape = store.centers.shape
        self._tree = None
        self._bounds = np.full(shape, np.inf), np.full(shape, -np.inf)
        self._bounds[0][active], self._bounds[1][active] = minimum, maximum
        return active, minimum, maximum

    def _bounds_of(self, boxes: Boxes) -> tuple[Floats, Floats]:
        return sphere_bounds(boxes) if self._spheres else meeting_bounds(boxes)
