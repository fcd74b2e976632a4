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

"""Find every colliding pair of a set of boxes: broad phase, then the certified test."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy, as_box_accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.kinds import as_flag, check_kind
from obb_collision.queries.verdict.coarse import (
    faces_meet,
    meeting_bounds,
    sphere_bounds,
    spheres_meet,
)
from obb_collision.queries.verdict.verdict import SEPARATE, TOUCHING, Verdicts, pair_verdicts
from obb_collision.scene.broad_phase.broad_phase import Pairs, find_candidates


def find_pairs(boxes: Boxes, exact: bool = False, accuracy: Accuracy | str = "obb") -> Pairs:
    """Return (m, 2) int64, i < j, lexicographic: every pair that is not SEPARATE.

    Touching counts as colliding, and so does what doubles can't tell from touching; with
    ``exact=True`` the latter is decided by integer arithmetic. accuracy: "sphere", "aabb" or
    "obb_faces" look less closely and never miss what "obb" reports; ValueError for others.
    """
    check_kind(boxes, Boxes, "boxes")
    pairs, _ = find_pairs_and_verdicts(boxes, as_flag(exact, "exact"), accuracy)
    return pairs


def find_pairs_and_verdicts(
    boxes: Boxes, exact: bool = False, accuracy: Accuracy | str = "obb"
) -> tuple[Pairs, Verdicts]:
    """Return the pairs of ``find_pairs`` and the verdict (m,) int8 of each.

    Below "obb" that is TOUCHING: not told apart.
    """
    level = as_box_accuracy(accuracy)
    if level == Accuracy.OBB:
        return colliding_pairs(boxes, find_candidates(*meeting_bounds(boxes)), exact)
    bounds = sphere_bounds(boxes) if level == Accuracy.SPHERE else meeting_bounds(boxes)
    candidates = find_candidates(*bounds)
    pairs = candidates[coarse_meet(boxes, *columns(candidates), level)]
    order = np.argsort(pairs[:, 0] * len(boxes) + pairs[:, 1])
    return pairs[order], np.full(len(pairs), TOUCHING, np.int8)


def coarse_meet(
    boxes: Boxes, first: NDArray[np.int64], second: NDArray[np.int64], level: Accuracy
) -> NDArray[np.bool_]:
    """Return (m,) whether a level below OBB tells a pair not apart; its AABBs are known to meet."""
    if level == Accuracy.SPHERE:
        return spheres_meet(boxes, first, second)
    if level == Accuracy.OBB_FACES:
        return faces_meet(boxes, first, second)
    return np.ones(len(first), np.bool_)


def columns(pairs: Pairs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the two sides of pairs (m, 2), each in one run of memory, as kernels like it."""
    return np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1])


def colliding_pairs(boxes: Boxes, candidates: Pairs, exact: bool = False) -> tuple[Pairs, Verdicts]:
    """Return the candidates (m, 2) that are not SEPARATE, sorted, and their verdicts."""
    first, second = columns(candidates)
    verdicts = pair_verdicts(boxes, first, boxes, second, exact)
    colliding = verdicts != SEPARATE
    keys = first[colliding] * len(boxes) + second[colliding]
    order = np.argsort(keys)
    pairs = candidates[colliding][order]
    return pairs, verdicts[colliding][order]
