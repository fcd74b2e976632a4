"""The checker: composes one check of a store, and keeps what the next one can use again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import Floats
from obb_collision.queries.accuracy import Accuracy
from obb_collision.queries.coarse import sphere_bounds
from obb_collision.queries.separation import Verdicts
from obb_collision.scene.allowed import AllowedPairs, Counts
from obb_collision.scene.broad_phase import Pairs, find_candidates, find_candidates_of
from obb_collision.scene.ladder import Found, Rungs, decide_pairs, is_plain, needs_spheres
from obb_collision.scene.pairs import colliding_pairs
from obb_collision.scene.store import ObjectStore, Rows
from obb_collision.scene.tree_bank import TreeBank

#: With fewer than one object in this many changed, only pairs of the changed ones are looked at.
INCREMENTAL_SHARE = 32


@dataclass(eq=False)
class Findings:
    """What a check found, and what its effects gave so far.

    old (m,): the row of each pair in the findings before, -1 if it was decided anew; None if all
    were.
    """

    pairs: Pairs
    verdicts: Verdicts
    rungs: Rungs
    old: Rows | None = None
    results: dict[str, Any] = field(default_factory=dict)


class Checker:
    """Finds the pairs of a store that collide, from scratch or by what changed."""

    def __init__(self, store: ObjectStore, bank: TreeBank, allowed: AllowedPairs) -> None:
        self._store = store
        self._bank = bank
        self._allowed = allowed
        self._bounds: tuple[Floats, Floats] | None = None
        self._spheres = False  # whether the bounds hold the spheres, too
        self.last: Findings | None = None
        self.counts: Counts | None = None

    def find(self, depth: int, exact: bool) -> Findings:
        """Return what collides. depth: of the boxes on the rung "obb_tree"."""
        store = self._store
        self.counts = self._allowed.counts(store.names, store.version)
        changed = np.flatnonzero(store.changed)
        spheres = needs_spheres(store)
        bounds = self._bounds
        if (
            self.last is not None
            and bounds is not None
            and len(bounds[0]) == len(store.names)  # else the store has grown
            and len(changed) * INCREMENTAL_SHARE < len(store.names)
            and (self._spheres or not spheres)
        ):
            self.last = self._find_changed(changed, self.last, bounds, depth, exact)
        else:
            self._spheres = spheres
            self.last = Findings(*self._find_all(depth, exact))
        store.changed[:] = False
        return self.last

    def _find_all(self, depth: int, exact: bool) -> Found:
        store = self._store
        active = np.flatnonzero(store.active)
        boxes = store.boxes(active)
        minimum, maximum = self._bounds_of(boxes)
        candidates = find_candidates(minimum, maximum)
        shape = store.centers.shape
        self._bounds = (np.full(shape, np.inf), np.full(shape, -np.inf))
        self._bounds[0][active] = minimum
        self._bounds[1][active] = maximum
        if not is_plain(store):
            return decide_pairs(store, self._bank, self._counted(active[candidates]), depth, exact)
        if self.counts is not None:
            candidates = candidates[self.counts(*active[candidates].T)]
        pairs, verdicts = colliding_pairs(boxes, candidates, exact)
        return active[pairs], verdicts, _on_boxes(len(pairs))

    def _find_changed(
        self, changed: Rows, last: Findings, bounds: tuple[Floats, Floats], depth: int, exact: bool
    ) -> Findings:
        store = self._store
        active = changed[store.active[changed]]
        bounds[0][changed] = np.inf  # empty: overlaps nothing
        bounds[1][changed] = -np.inf
        bounds[0][active], bounds[1][active] = self._bounds_of(store.boxes(active))
        candidates = self._counted(find_candidates_of(*bounds, active))
        if is_plain(store):
            new, verdicts = colliding_pairs(store.all_boxes(), candidates, exact)
            rungs = _on_boxes(len(new))
        else:
            new, verdicts, rungs = decide_pairs(store, self._bank, candidates, depth, exact)
        kept = np.flatnonzero(~store.changed[last.pairs].any(axis=1))
        pairs = np.concatenate([last.pairs[kept], new])
        order = np.lexsort((pairs[:, 1], pairs[:, 0]))
        old = np.concatenate([kept, np.full(len(new), -1)])[order]
        verdicts = np.concatenate([last.verdicts[kept], verdicts])[order]
        rungs = np.concatenate([last.rungs[kept], rungs])[order]
        return Findings(pairs[order], verdicts, rungs, old)

    def _counted(self, candidates: Pairs) -> Pairs:
        """Return those of the candidates (m, 2) that may not touch."""
        return candidates if self.counts is None else candidates[self.counts(*candidates.T)]

    def _bounds_of(self, boxes: Boxes) -> tuple[Floats, Floats]:
        return sphere_bounds(boxes) if self._spheres else boxes.world_bounds()


def _on_boxes(count: int) -> NDArray[np.int8]:
    return np.full(count, Accuracy.OBB, np.int8)
