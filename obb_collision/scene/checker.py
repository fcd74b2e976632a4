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

"""The checker: composes a check of a store, and keeps bounds, trees and pairs for the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision._threads import run
from obb_collision.geometry.trees.bounds_tree import BoundsTree
from obb_collision.queries.verdict.coarse import bounds_kernel, sphere_bounds
from obb_collision.queries.verdict.verdict import SEPARATE, Verdicts, decide_exactly
from obb_collision.scene.broad_phase.broad_phase import (
    NO_PAIRS,
    UNLIMITED,
    KeptTree,
    Pairs,
    find_candidates,
    find_some_candidates,
    ordered_candidates,
)
from obb_collision.scene.broad_phase.find_pairs import (
    FEW_BOXES,
    OBB,
    all_colliding_keys,
    colliding_keys,
    colliding_pairs,
    columns,
    few_pairs,
    merge_keys,
    merge_pairs,
    pairs_of_keys,
)
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.effects.base import Outcome
from obb_collision.scene.refinement.budget import Budget
from obb_collision.scene.refinement.ladder import (
    NONE,
    Decided,
    decide_pairs,
    is_plain,
    joined,
    needs_spheres,
    pair_levels,
)
from obb_collision.scene.store.allowed import PairFilter, PairRules
from obb_collision.scene.store.region import Region, balls_near, owns_pairs
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Mask, Rows


class Layout(NamedTuple):
    """Properties of all objects that a check needs and that no move changes."""

    revision: int  #: of the store
    active: Rows  #: slots, ascending
    whole: bool  #: whether these are the first ones, with no gap
    plain: bool  #: whether every pair is decided on OBB
    spheres: bool  #: whether the broad phase must look for spheres, too

    @classmethod
    def of(cls, store: ObjectStore) -> Layout:
        """Return the layout of a store as it is now."""
        active = np.flatnonzero(store.active)
        whole = len(active) == 0 or int(active[-1]) == len(active) - 1
        return cls(store.revision, active, whole, is_plain(store), needs_spheres(store))


@dataclass(eq=False)
class Findings:
    """The pairs of a check, and the outcomes of its effects so far.

    behind: whether pairs, late: whether rows of effects are left on a lower level than requested;
    the next check may get further.
    old (m,): the row of each pair in the findings before, -1 if it was decided anew; None if all
    were.
    total: a lower bound of how many pairs collide, where a limit has left some out, else None.
    before: the outcomes of effects for the findings before.
    """

    decided: Decided
    behind: bool = False
    late: bool = False
    old: Rows | None = None
    total: int | None = None
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    before: Mapping[str, Outcome] = field(default_factory=dict)


NO_BOUNDS: tuple[Floats, Floats] = np.empty((0, 3)), np.empty((0, 3))
NO_ROWS, NO_KEYS = np.empty(0, np.bool_), np.empty(0, np.int64)
#: If fewer than one object in this many has changed, only pairs of changed objects are decided.
INCREMENTAL_SHARE = 8
#: Changed slots up to which one call of a kernel does all, by one thread.
FEW_CHANGES = 512
#: Rows below which a second thread doesn't pay: 20 us of bounds.
LEAST_BOUNDS = 2048
#: Pairs that a few boxes can make.
FEW_PAIRS = FEW_BOXES * (FEW_BOXES - 1) // 2
#: Candidates held at once where pairs are limited: for each pair of the limit, or for each object,
#: whichever is more.
PER_PAIR, PER_OBJECT = 8, 32
#: Candidates of a piece, where there are more: 2 MB, so that pieces take milliseconds.
PIECE = 1 << 17


class Checker:
    """Finds the colliding pairs of a store: all of them, or those of changed objects.

    limit: maximum number of pairs kept, None for all; the search stops beyond it.
    """

    def __init__(self, store: ObjectStore, cache: ShapeCache, allowed: PairRules) -> None:
        self._store = store
        self._cache = cache
        self._allowed = allowed
        self._bounds = NO_BOUNDS
        self._spheres = False  # whether the bounds hold the spheres, too
        self._tree: KeptTree | None = None  # over the bounds
        self._layout = Layout(-1, np.empty(0, np.int64), False, True, False)
        self._room = np.empty((FEW_PAIRS, 2), np.int64), np.empty(FEW_PAIRS, np.int8)
        self._old = np.empty(FEW_PAIRS, np.int64)
        self.limit: int | None = None
        self.last: Findings | None = None
        self.pair_filter: PairFilter | None = None
        self.region: Region | None = None
        self._near = NO_ROWS  # by slot: near the region at the last check

    def set_region(self, region: Region | None) -> None:
        """Find only the pairs of a region from now on, None: all."""
        store = self._store
        self.last = None
        store.mark(store.live())
        store.set_near(np.arange(len(store.near)), np.ones(len(store.near), np.bool_))
        self.region = region

    def settle_region(self) -> None:
        """Leave out objects that have left the region, and take in those that have come near.

        Objects that stay away count as unchanged: nothing is computed for them.
        """
        store = self._store
        if self.region is None or not store.touched:
            return
        rows = np.flatnonzero(store.changed & store.used)
        before = rows < len(self._near)
        before[before] = self._near[rows[before]]
        radii = np.linalg.norm(store.half_extents[rows], axis=1)
        near = balls_near(self.region, store.centers[rows], radii)
        store.set_near(rows, near)
        store.changed[rows[~(before | near)]] = False
        store.touched = bool(store.changed.any())

    @property
    def plain(self) -> bool:
        """Whether every pair was decided on OBB."""
        return self._layout.plain

    @property
    def behind(self) -> bool:
        """Whether the next check may get further though nothing changes."""
        return self.last is not None and (self.last.behind or self.last.late)

    def find(self, exact: bool, budget: Budget | None = None) -> Findings:
        """Find the colliding pairs; call `settle_region` first where there is a region."""
        store, last = self._store, self.last
        self.pair_filter = self._allowed.pair_filter(store.names, store.version)
        if last is not None and last.total is not None:
            last = None  # not all of its pairs are known
        if last is not None and not (store.touched or last.behind):
            findings = Findings(last.decided, old=np.arange(len(last.decided.pairs)))
        else:
            findings = self._find_anew(last, exact, budget)
            count = len(findings.decided.pairs)
            if self.limit is not None and count > self.limit:
                kept = np.arange(self.limit)  # a copy: the other pairs need not stay in memory
                old = None if findings.old is None else findings.old[kept]
                findings = replace(
                    findings, decided=findings.decided.take(kept), old=old, total=count
                )
        findings.before = {} if self.last is None else self.last.outcomes
        near = NO_ROWS if self.region is None else store.near.copy()
        self.last, self._near = findings, near
        store.settle()
        return findings

    def _find_anew(self, last: Findings | None, exact: bool, budget: Budget | None) -> Findings:
        """Decide pairs by whichever way is quickest."""
        store = self._store
        if self._layout.revision != store.revision:
            self._layout = Layout.of(store)
        active = self._layout.active
        if self._layout.plain and len(active) <= FEW_BOXES:
            return self._find_few(last, exact)
        if last is not None:
            slots = store.changed.nonzero()[0]
            if len(slots) < len(active) or np.count_nonzero(store.active[slots]) < len(active):
                findings = self._find_changed(last, slots, exact, budget)
                if findings is not None:
                    return findings
        return self._find_all(exact, budget)

    def _find_few(self, last: Findings | None, exact: bool) -> Findings:
        """Decide all pairs of a few boxes."""
        store = self._store
        self._bounds, self._tree = NO_BOUNDS, None
        (pairs, verdicts), old = self._room, self._old
        boxes = store.centers, store.rotations, store.half_extents
        before = NO_PAIRS if last is None else last.decided.pairs
        count, unchanged = few_pairs(
            boxes, self._layout.active, store.changed, before, pairs, verdicts, old
        )
        pairs, verdicts, old = pairs[:count].copy(), verdicts[:count].copy(), old[:count].copy()
        if exact or self.pair_filter is not None or self.region is not None:
            kept = self._own(pairs)
            if exact:
                stored = store.all_boxes()
                decide_exactly(stored, pairs[:, 0], stored, pairs[:, 1], verdicts)
                kept &= verdicts != SEPARATE
            if self.pair_filter is not None:
                kept &= self.pair_filter(*pairs.T)
            pairs, verdicts, old = pairs[kept], verdicts[kept], old[kept]
        return Findings(self._on_obb(pairs, verdicts), old=old if unchanged else None)

    def _find_all(self, exact: bool, budget: Budget | None) -> Findings:
        """Decide all pairs; with a limit piece by piece until it is exceeded, if there are many."""
        self._tree = None
        self._update_bounds()
        active, minimum, maximum = self._active_bounds()
        if self.limit is None and self._layout.plain:
            boxes = self._store.all_boxes()

            def decide(rows: Pairs) -> NDArray[np.int64]:
                return colliding_keys(boxes, self._counted(self._slots(rows)))

            keys = find_candidates(minimum, maximum, decide)
            return Findings(self._on_obb(*pairs_of_keys(boxes, keys, exact)))
        if len(active) < 2:
            return Findings(NONE)
        tree = BoundsTree.build(minimum, maximum)
        candidates = find_some_candidates(tree, self._most_candidates())
        if candidates is not None:
            return Findings(*self._decide(self._slots(candidates), exact, budget))
        assert self.limit is not None
        parts, total, behind = [NONE], 0, False
        for piece, _ in ordered_candidates(tree, min(PIECE, 2 * self.limit)):
            decided, is_left = self._decide(self._slots(piece), exact, budget)
            parts, total, behind = [*parts, decided], total + len(decided.pairs), behind or is_left
            if total > self.limit:
                break
        return Findings(joined(parts), behind)

    def _find_changed(
        self, last: Findings, slots: Rows, exact: bool, budget: Budget | None
    ) -> Findings | None:
        """Decide the pairs of changed slots (k,), and those left behind; None for too many."""
        store = self._store
        candidates = self._few_candidates(slots)
        if candidates is None:
            candidates = self._candidates(self._update_bounds())
            if candidates is None:
                return None
        keys, behind, before = NO_KEYS, False, last.decided
        again, waiting, new = NO_ROWS, NONE, NONE
        simple = self._layout.plain and not (exact or last.behind)
        if simple:
            keys = all_colliding_keys(store.all_boxes(), self._counted(candidates))
        else:
            if last.behind:
                again = before.levels < pair_levels(store, *columns(before.pairs))
                again &= ~store.changed[before.pairs].any(axis=1)
                waiting = before.take(again)
            new, behind = self._decide(candidates, exact, budget, waiting)
        most = len(before.pairs) + len(keys) + len(new.pairs)
        pairs, old = np.empty((most, 2), np.int64), np.empty(most, np.int64)
        verdicts, levels = np.empty(most, np.int8), np.empty(most, np.int8)
        outputs = pairs, verdicts, levels, old
        if simple:
            count = merge_keys(*before, store.changed, keys, *outputs)
        else:
            count = merge_pairs(*before, store.changed, again, *new, *outputs)
        decided = Decided(pairs, verdicts, levels).take(slice(count))
        return Findings(decided, behind, old=old[:count])

    def _few_candidates(self, slots: Rows) -> Pairs | None:
        """Return the candidates of few changed slots (k,) from the kept tree, None without one."""
        store, tree, active = self._store, self._tree, self._layout.active
        if (
            tree is None
            or self.limit is not None
            or self._spheres
            or self._layout.spheres
            or len(slots) >= min(FEW_CHANGES, len(active) / INCREMENTAL_SHARE)
            or tree.size < len(store.names)
        ):
            return None
        return tree.pairs_of_changes(slots, store.changed, store.active, store.all_boxes())

    def _decide(
        self, candidates: Pairs, exact: bool, budget: Budget | None, waiting: Decided = NONE
    ) -> tuple[Decided, bool]:
        store = self._store
        candidates = self._counted(candidates)
        if self._layout.plain:
            return self._on_obb(*colliding_pairs(store.all_boxes(), candidates, exact)), False
        return decide_pairs(store, self._cache, candidates, exact, budget, waiting)

    def _counted(self, pairs: Pairs) -> Pairs:
        """Return the pairs (m, 2) of slots that count: not allowed to touch, and in the region."""
        if self.pair_filter is not None:
            pairs = pairs[self.pair_filter(*pairs.T)]
        return pairs if self.region is None else pairs[self._own(pairs)]

    @staticmethod
    def _on_obb(pairs: Pairs, verdicts: Verdicts) -> Decided:
        return Decided(pairs, verdicts, np.full(len(pairs), OBB, np.int8))

    def _own(self, pairs: Pairs) -> Mask:
        """Return which pairs (m, 2) of slots belong to the region."""
        if self.region is None:
            return np.ones(len(pairs), np.bool_)
        if self._bounds is NO_BOUNDS:
            self._update_bounds()
        return owns_pairs(self.region, self._bounds[0], pairs)

    def _candidates(self, changed: Rows) -> Pairs | None:
        """Return pairs (m, 2) of changed slots (k,) whose bounds overlap; None: too many."""
        store = self._store
        most = self._most_candidates()
        active, minimum, maximum = self._active_bounds()
        if len(active) < 2:
            return NO_PAIRS
        if len(changed) * INCREMENTAL_SHARE >= len(active):
            self._tree = None
            candidates = find_some_candidates(BoundsTree.build(minimum, maximum), most)
            if candidates is None:
                return None
            candidates = self._slots(candidates)
            return candidates[store.changed[candidates].any(axis=1)]
        if self._tree is None:
            self._tree = KeptTree(*self._bounds)
        return self._tree.pairs_of(changed, most)

    def _most_candidates(self) -> int:
        if self.limit is None:
            return UNLIMITED
        return max(PER_PAIR * self.limit, PER_OBJECT * len(self._layout.active))

    def _slots(self, rows: Pairs) -> Pairs:
        """Return slots from rows of active slots."""
        return rows if self._layout.whole else self._layout.active[rows]

    def _active_bounds(self) -> tuple[Rows, Floats, Floats]:
        """Return the active slots (k,) and their bounds (k, 3), (k, 3)."""
        active = self._layout.active
        minimum, maximum = self._bounds
        if self._layout.whole:
            return active, minimum[: len(active)], maximum[: len(active)]
        return active, minimum[active], maximum[active]

    def _update_bounds(self) -> Rows:
        """Bound changed slots, those not active by empty bounds; return the active ones."""
        store, layout = self._store, self._layout
        changed = np.flatnonzero(store.changed)
        rows = changed[store.active[changed]]
        anew = rows
        kept = self._bounds
        if len(kept[0]) < len(store.names) or self._spheres != layout.spheres:
            shape = store.centers.shape
            kept = np.full(shape, np.inf), np.full(shape, -np.inf)
            self._bounds, self._tree = NO_BOUNDS, None  # in case memory ends before all are there
            self._spheres, anew = layout.spheres, layout.active
        elif len(rows) < len(changed):
            kept[0][changed], kept[1][changed] = np.inf, -np.inf  # empty: overlaps nothing
        if layout.spheres:
            kept[0][anew], kept[1][anew] = sphere_bounds(store.boxes(anew))
        else:
            boxes = store.centers, store.rotations, store.half_extents
            run(bounds_kernel, len(anew), LEAST_BOUNDS, boxes, anew, *kept)
        self._bounds = kept
        if self._tree is not None and not self._tree.update(changed):
            self._tree = None
        return rows
