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

"""The level of ``Accuracy`` on which a pair is decided, and its verdict.

It is the lower level of the pair's two objects. Levels above OBB decide only pairs that OBB
reports, and only pairs with a shape that is not a box; others stay on OBB. With padding MESH is
HULL for pairs without a mesh, except for spheres, capsules and boxes among themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.coarse import bounds_may_collide, spheres_may_collide
from obb_collision.queries.verdict.verdict import SEPARATE, TOUCHING, Verdicts, pair_verdicts
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.broad_phase.find_pairs import OBB, columns
from obb_collision.scene.building.shape_cache import (
    BOX,
    BOXED,
    CLOUD,
    ROUND,
    TRIANGLES,
    ShapeCache,
)
from obb_collision.scene.refinement.budget import Budget, Levels, refine
from obb_collision.scene.refinement.clouds import CloudPairs, pairs_that_count
from obb_collision.scene.refinement.mesh_pairs import MeshPairs
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Mask, Rows

#: A level, as kernels compare it.
HULL = int(Accuracy.HULL)


class Decided(NamedTuple):
    """Pairs (m, 2) of slots, sorted, their verdicts (m,) and their levels (m,)."""

    pairs: Pairs
    verdicts: Verdicts
    levels: Levels

    def take(self, rows: Rows | Mask | slice) -> Decided:
        """Return the pairs of some rows."""
        return Decided._make(column[rows] for column in self)


def is_plain(store: ObjectStore) -> bool:
    """Return whether every pair is decided on OBB."""
    levels, kinds = store.accuracies[store.active], store.kinds[store.active]
    if (levels == Accuracy.OBB).all():
        return not (kinds == CLOUD).any()
    return bool((levels >= Accuracy.OBB).all() and not (kinds > BOX).any())


def needs_spheres(store: ObjectStore) -> bool:
    """Return whether bounds must hold the spheres around boxes, too.

    By all objects, also those far from a region: so all regions have the same bounds.
    """
    return bool((store.accuracies[store.enabled] == Accuracy.SPHERE).any())


def pair_levels(
    store: ObjectStore, first: Rows, second: Rows, accuracies: Levels | None = None
) -> Levels:
    """Return the level (m,) int8 of each pair of slots.

    accuracies: by slot, by default those of the store.
    """
    levels = np.empty(len(first), np.int8)
    by_slot = store.accuracies if accuracies is None else accuracies
    _levels_kernel(by_slot, store.kinds, store.paddings, first, second, levels)
    return levels


@njit
def _levels_kernel(
    accuracies: np.ndarray,
    kinds: np.ndarray,
    paddings: Floats,
    first: np.ndarray,
    second: np.ndarray,
    levels: np.ndarray,
) -> None:
    for n in range(len(levels)):
        i, j = first[n], second[n]
        level = min(accuracies[i], accuracies[j])
        low, high = min(kinds[i], kinds[j]), max(kinds[i], kinds[j])
        padded = paddings[i] > 0.0 or paddings[j] > 0.0
        if high == CLOUD:  # its balls, on the level of the other object
            other = j if kinds[i] == CLOUD else i
            if level >= OBB:
                level = accuracies[other]
            if low <= BOX:
                level = min(level, OBB)
            elif low != TRIANGLES:
                level = min(level, HULL)
        elif low == BOXED or high == BOX:  # decided by boxes only
            level = min(level, OBB)
        elif padded and high != ROUND and high != TRIANGLES:
            level = min(level, HULL)
        levels[n] = level


NONE = Decided(np.empty((0, 2), np.int64), *np.empty((2, 0), np.int8))


def joined(parts: Sequence[Decided]) -> Decided:
    """Join the pairs of parts."""
    return Decided._make(map(np.concatenate, zip(*parts, strict=True)))


def decide_pairs(
    store: ObjectStore, cache: ShapeCache, candidates: Pairs, exact: bool,
    budget: Budget | None = None, waiting: Decided = NONE,
) -> tuple[Decided, bool]:  # fmt: skip
    """Return the candidates (m, 2), pairs of slots whose bounds overlap, that are not SEPARATE.

    waiting: unchanged pairs that were decided below their level; returned, too, if they still
    collide. budget: spent on the nearest pairs first. Also returns whether any pair was decided
    below its level.
    """
    boxes = store.all_boxes()
    has_clouds = bool((store.kinds == CLOUD).any())
    if has_clouds:
        candidates = pairs_that_count(store, cache, candidates)
    first, second = columns(candidates)
    wanted = pair_levels(store, first, second)
    if needs_spheres(store):
        kept = (wanted == Accuracy.SPHERE) | bounds_may_collide(boxes, first, second)
        first, second, wanted = first[kept], second[kept], wanted[kept]
    verdicts = _box_verdicts(boxes, first, second, wanted, exact)
    if has_clouds:
        clouds = np.maximum(store.kinds[first], store.kinds[second]) == CLOUD
        rows = np.flatnonzero(clouds & (wanted >= Accuracy.OBB) & (verdicts != SEPARATE))
        if len(rows):
            slots = np.column_stack([first[rows], second[rows]])
            verdicts[rows] = CloudPairs(store, cache, boxes, slots).box_verdicts()
    met = np.flatnonzero(verdicts != SEPARATE)
    pairs = np.column_stack([first[met], second[met]])
    verdicts, wanted = verdicts[met], wanted[met]
    levels = np.minimum(wanted, np.int8(Accuracy.OBB))
    if len(waiting.pairs):
        wanted = np.append(wanted, pair_levels(store, *columns(waiting.pairs)))
        pairs, verdicts, levels = joined([Decided(pairs, verdicts, levels), waiting])
    high = np.flatnonzero(wanted > Accuracy.OBB)
    if len(high):
        job = MeshPairs(store, cache, *columns(pairs[high]), exact)
        state = levels[high], verdicts[high]
        order = None if budget is None else nearest_first(boxes, pairs[high])
        refine(job, wanted[high], *state, budget, order)
        levels[high], verdicts[high] = state
    rows = np.flatnonzero(verdicts != SEPARATE)
    rows = rows[np.lexsort((pairs[rows, 1], pairs[rows, 0]))]
    behind = bool((levels[rows] < wanted[rows]).any())
    return Decided(pairs, verdicts, levels).take(rows), behind


def nearest_first(boxes: Boxes, pairs: Pairs) -> Rows:
    """Return the rows of pairs (m, 2), those whose bounds overlap deepest first.

    That costs little. For a small object on a large one the depth is small.
    """
    (low_a, high_a), (low_b, high_b) = (boxes[slots].world_bounds() for slots in pairs.T)
    depths = (np.minimum(high_a, high_b) - np.maximum(low_a, low_b)).min(axis=1)
    return np.argsort(-depths, kind="stable")


def _box_verdicts(boxes: Boxes, first: Rows, second: Rows, levels: Levels, exact: bool) -> Verdicts:
    """Return verdicts (m,) on the level of each pair, at most on OBB."""
    if len(levels) == 0 or levels.min() >= Accuracy.OBB:
        return pair_verdicts(boxes, first, boxes, second, exact)
    result = np.full(len(first), SEPARATE, np.int8)
    result[levels == Accuracy.AABB] = TOUCHING  # as their bounds overlap
    rows = np.flatnonzero(levels == Accuracy.SPHERE)
    if len(rows):
        result[rows[spheres_may_collide(boxes, first[rows], second[rows])]] = TOUCHING
    rows = np.flatnonzero(levels >= Accuracy.OBB)
    result[rows] = pair_verdicts(boxes, first[rows], boxes, second[rows], exact)
    return result
