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
at what OBB reports. They need a shape that is no box, and no padding, except on spheres, capsules
and boxes among themselves: meshes don't model it. Else the pair stays on OBB.
"""

from __future__ import annotations

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.coarse import bounds_may_collide
from obb_collision.queries.verdict.verdict import SEPARATE, TOUCHING, Verdicts, pair_verdicts
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.broad_phase.find_pairs import coarse_meet, columns
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.refinement.budget import Budget
from obb_collision.scene.refinement.mesh_pairs import MeshPairs
from obb_collision.scene.refinement.refine import Levels, refine
from obb_collision.scene.store.kinds import BOX, BOXED, ROUND
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Rows

#: Pairs (m, 2) of slots, sorted, their verdicts (m,) and their levels (m,).
Found = tuple[Pairs, Verdicts, Levels]


def is_plain(store: ObjectStore) -> bool:
    """Return whether every pair is decided on OBB."""
    levels = store.accuracies[store.active]
    if (levels == Accuracy.OBB).all():
        return True
    meshes = (store.kinds[store.active] > BOX).any()
    return bool((levels >= Accuracy.OBB).all() and not meshes)


def needs_spheres(store: ObjectStore) -> bool:
    """Return whether the broad phase must look for spheres, too, that overlap."""
    return bool((store.accuracies[store.active] == Accuracy.SPHERE).any())


def pair_levels(store: ObjectStore, first: Rows, second: Rows) -> Levels:
    """Return the level (m,) int8 that decides each pair of slots."""
    levels: Levels = np.minimum(store.accuracies[first], store.accuracies[second])
    kinds = np.stack([store.kinds[first], store.kinds[second]])
    padded = (store.paddings[first] > 0.0) | (store.paddings[second] > 0.0)
    boxes_only = (kinds == BOXED).any(axis=0) | (kinds == BOX).all(axis=0)
    boxes_only |= padded & (kinds.max(axis=0) != ROUND)
    return np.where(boxes_only, np.minimum(levels, np.int8(Accuracy.OBB)), levels)


NONE: Found = np.empty((0, 2), np.int64), np.empty(0, np.int8), np.empty(0, np.int8)


def decide_pairs(
    store: ObjectStore, cache: ShapeCache, candidates: Pairs, depth: int, exact: bool,
    budget: Budget | None = None, waiting: Found = NONE, highest: Accuracy = Accuracy.MESH,
) -> tuple[Found, bool]:  # fmt: skip
    """Return the candidates (m, 2), pairs of slots whose bounds overlap, that are not SEPARATE.

    depth: of the boxes on OBB_TREE. waiting: pairs that haven't changed, decided on a lower level
    than they ask for; returned among the others if they still collide. highest: no candidate is
    decided above this level. Also returns whether any
    pair has been decided on a lower level than it asks for, which takes a budget.
    """
    boxes = store.all_boxes()
    first, second = columns(candidates)
    asked = np.minimum(pair_levels(store, first, second), np.int8(highest))
    if needs_spheres(store):
        kept = (asked == Accuracy.SPHERE) | bounds_may_collide(boxes, first, second)
        first, second, asked = first[kept], second[kept], asked[kept]
    verdicts = _box_verdicts(boxes, first, second, asked, exact)
    met = np.flatnonzero(verdicts != SEPARATE)
    pairs = np.concatenate([np.stack([first[met], second[met]], axis=1), waiting[0]])
    verdicts = np.concatenate([verdicts[met], waiting[1]])
    asked = np.concatenate([asked[met], pair_levels(store, *columns(waiting[0]))])
    levels = np.concatenate([np.minimum(asked[: len(met)], np.int8(Accuracy.OBB)), waiting[2]])

    high = np.flatnonzero(asked > Accuracy.OBB)
    if len(high):
        job = MeshPairs(store, cache, *columns(pairs[high]), depth, exact)
        state = levels[high], verdicts[high]
        refine(job, asked[high], high >= len(met), *state, budget)
        levels[high], verdicts[high] = state
    found = np.flatnonzero(verdicts != SEPARATE)
    found = found[np.lexsort((pairs[found, 1], pairs[found, 0]))]
    behind = bool((levels[found] < asked[found]).any())
    return (pairs[found], verdicts[found], levels[found]), behind


def _box_verdicts(boxes: Boxes, first: Rows, second: Rows, levels: Levels, exact: bool) -> Verdicts:
    """Return verdicts (m,) on each pair's level, at most on OBB."""
    result = np.full(len(first), SEPARATE, np.int8)
    for level in (Accuracy.SPHERE, Accuracy.AABB, Accuracy.OBB_FACES):
        rows = np.flatnonzero(levels == level)
        if len(rows):
            meet = coarse_meet(boxes, first[rows], second[rows], level)
            result[rows[meet]] = TOUCHING
    rows = np.flatnonzero(levels >= Accuracy.OBB)
    result[rows] = pair_verdicts(boxes, first[rows], boxes, second[rows], exact)
    return result
