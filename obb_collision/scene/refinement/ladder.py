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

"""Deciding pairs on the levels of ``Accuracy``: which level a pair gets, and its verdict.

A pair is decided on the lower level of its two objects' accuracies. The levels above OBB look only
at what OBB reports. They need a shape that is no box, else the pair stays on OBB. With padding MESH
is HULL for pairs without a mesh, except for spheres, capsules and boxes among themselves.
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
from obb_collision.scene.broad_phase.find_pairs import columns
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.refinement.budget import Budget, Levels, refine
from obb_collision.scene.refinement.mesh_pairs import MeshPairs
from obb_collision.scene.store.kinds import BOX, BOXED, ROUND, TRIANGLES
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Mask, Rows

#: The level of boxes, as kernels compare it.
OBB = int(Accuracy.OBB)
HULL = int(Accuracy.HULL)


class Decided(NamedTuple):
    """Pairs (m, 2) of slots, sorted, their verdicts (m,) and their levels (m,)."""

    pairs: Pairs
    verdicts: Verdicts
    levels: Levels

    def take(self, rows: Rows | Mask | slice) -> Decided:
        """Return some of them."""
        return Decided._make(column[rows] for column in self)


def is_plain(store: ObjectStore) -> bool:
    """Return whether every pair is decided on OBB."""
    levels = store.accuracies[store.active]
    if (levels == Accuracy.OBB).all():
        return True
    meshes = (store.kinds[store.active] > BOX).any()
    return bool((levels >= Accuracy.OBB).all() and not meshes)


def needs_spheres(store: ObjectStore) -> bool:
    """Return whether the broad phase must look for spheres, too, that overlap.

    Also for objects far from a region: all that share a scene find the same bounds.
    """
    return bool((store.accuracies[store.enabled] == Accuracy.SPHERE).any())


def pair_levels(
    store: ObjectStore, first: Rows, second: Rows, accuracies: Levels | None = None
) -> Levels:
    """Return the level (m,) int8 that decides each pair of slots.

    accuracies: by slot, in place of the store's.
    """
    levels = np.empty(len(first), np.int8)
    given = store.accuracies if accuracies is None else accuracies
    _levels_kernel(given, store.kinds, store.paddings, first, second, levels)
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
        if low == BOXED or high == BOX:  # decided by boxes only
            level = min(level, OBB)
        elif padded and high != ROUND and high != TRIANGLES:
            level = min(level, HULL)
        levels[n] = level


NONE = Decided(np.empty((0, 2), np.int64), *np.empty((2, 0), np.int8))


def joined(parts: Sequence[Decided]) -> Decided:
    """Return the pairs of parts, one after another."""
    return Decided._make(map(np.concatenate, zip(*parts, strict=True)))


def decide_pairs(
    store: ObjectStore, cache: ShapeCache, candidates: Pairs, exact: bool,
    budget: Budget | None = None, waiting: Decided = NONE,
) -> tuple[Decided, bool]:  # fmt: skip
    """Return the candidates (m, 2), pairs of slots whose bounds overlap, that are not SEPARATE.

    waiting: pairs that haven't changed, decided on a lower level than they ask for; returned among
    the others if they still collide. budget: its time goes to the nearest ones first. Also returns
    whether any pair has been decided on a lower level than it asks for.
    """
    boxes = store.all_boxes()
    first, second = columns(candidates)
    asked = pair_levels(store, first, second)
    if needs_spheres(store):
        kept = (asked == Accuracy.SPHERE) | bounds_may_collide(boxes, first, second)
        first, second, asked = first[kept], second[kept], asked[kept]
    verdicts = _box_verdicts(boxes, first, second, asked, exact)
    met = np.flatnonzero(verdicts != SEPARATE)
    pairs = np.column_stack([first[met], second[met]])
    verdicts, asked = verdicts[met], asked[met]
    levels = np.minimum(asked, np.int8(Accuracy.OBB))
    if len(waiting.pairs):
        asked = np.append(asked, pair_levels(store, *columns(waiting.pairs)))
        pairs, verdicts, levels = joined([Decided(pairs, verdicts, levels), waiting])
    high = np.flatnonzero(asked > Accuracy.OBB)
    if len(high):
        job = MeshPairs(store, cache, *columns(pairs[high]), exact)
        state = levels[high], verdicts[high]
        order = None if budget is None else nearest_first(boxes, pairs[high])
        refine(job, asked[high], *state, budget, order)
        levels[high], verdicts[high] = state
    found = np.flatnonzero(verdicts != SEPARATE)
    found = found[np.lexsort((pairs[found, 1], pairs[found, 0]))]
    behind = bool((levels[found] < asked[found]).any())
    return Decided(pairs, verdicts, levels).take(found), behind


def nearest_first(boxes: Boxes, pairs: Pairs) -> Rows:
    """Return the rows of pairs (m, 2) in the order of how deep their bounds overlap, or how near.

    That costs little, and that of a small object on a large one is small.
    """
    (low_a, high_a), (low_b, high_b) = (boxes[slots].world_bounds() for slots in pairs.T)
    depths = (np.minimum(high_a, high_b) - np.maximum(low_a, low_b)).min(axis=1)
    return np.argsort(-depths, kind="stable")


def _box_verdicts(boxes: Boxes, first: Rows, second: Rows, levels: Levels, exact: bool) -> Verdicts:
    """Return verdicts (m,) on each pair's level, at most on OBB."""
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
