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

"""Find every colliding pair of one or two sets of boxes: broad phase, then the certified test."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.accuracy import Accuracy, as_box_accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.kinds import as_flag, check_kind
from obb_collision.numerics.sorting import bits_of, sort_by_keys
from obb_collision.queries.verdict.coarse import (
    faces_may_collide,
    meeting_bounds,
    sphere_bounds,
    spheres_may_collide,
)
from obb_collision.queries.verdict.pair_rows import one_set
from obb_collision.queries.verdict.verdict import SEPARATE, TOUCHING, Verdicts, pair_verdicts
from obb_collision.scene.broad_phase.broad_phase import (
    Pairs,
    find_candidates,
    find_candidates_between,
)
from obb_collision.typing import Floats


def find_pairs(
    a: Boxes, b: Boxes | None = None, *, exact: bool = False, accuracy: Accuracy | str = "obb"
) -> Pairs:
    """Return every colliding pair of one set of boxes, or between two sets.

    Touching counts as colliding, and so does what doubles can't tell from touching. Boxes far from
    each other cost nothing: time grows with n log n and the pairs found.

    Parameters
    ----------
    a : Boxes
    b : Boxes, optional
        Without, the pairs among a; with it those of one box of a and one of b.
    exact : bool
        Decide by integer arithmetic what doubles can't tell from touching.
    accuracy : Accuracy or str
        "sphere", "aabb" or "obb_faces" look less closely and never miss what "obb" reports.

    Returns
    -------
    (m, 2) array of int64
        Every pair that ``verdicts`` does not call SEPARATE, in lexicographic order. Of one set:
        rows i < j; of two: rows into a and b.

    Raises
    ------
    ValueError
        For another accuracy.
    TypeError
        For anything but boxes.

    References
    ----------
    Karras, Maximizing Parallelism in the Construction of BVHs (HPG 2012); Ericson 2005, 7.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.find_pairs(boxes).tolist()
    [[0, 1]]
    >>> oc.find_pairs(boxes, boxes[2:]).tolist()
    [[2, 0]]
    """
    check_kind(a, Boxes, "a")
    if b is None:
        return find_pairs_and_verdicts(a, as_flag(exact, "exact"), accuracy)[0]
    check_kind(b, Boxes, "b")
    return _find_between(a, b, as_flag(exact, "exact"), as_box_accuracy(accuracy))


def find_pairs_and_verdicts(
    boxes: Boxes, exact: bool = False, accuracy: Accuracy | str = "obb"
) -> tuple[Pairs, Verdicts]:
    """Return the pairs of ``find_pairs`` and the verdict (m,) int8 of each.

    Below "obb" that is TOUCHING, for pairs not proven separate.
    """
    level = as_box_accuracy(accuracy)
    return _decided(boxes, find_candidates(*_bounds(boxes, level)), exact, level)


def _find_between(a: Boxes, b: Boxes, exact: bool, level: Accuracy) -> Pairs:
    candidates = find_candidates_between(*_bounds(a, level), *_bounds(b, level))
    # of two sets in any case: a box of b that is one of a is still another box
    both, candidates = one_set(a, Boxes.trusted(*vars(b).values()), candidates)
    return _decided(both, candidates, exact, level)[0] - np.array([0, len(a)])


def _bounds(boxes: Boxes, level: Accuracy) -> tuple[Floats, Floats]:
    return sphere_bounds(boxes) if level == Accuracy.SPHERE else meeting_bounds(boxes)


def _decided(
    boxes: Boxes, candidates: Pairs, exact: bool, level: Accuracy
) -> tuple[Pairs, Verdicts]:
    """Return the candidates (m, 2) that collide on a level, sorted, and their verdicts."""
    if level == Accuracy.OBB:
        return colliding_pairs(boxes, candidates, exact)
    meet = coarse_meet(boxes, *columns(candidates), level)
    found: tuple[Pairs, Verdicts] = _sorted_kernel(
        candidates, np.where(meet, TOUCHING, SEPARATE).astype(np.int8), len(boxes)
    )
    return found


def coarse_meet(
    boxes: Boxes, first: NDArray[np.int64], second: NDArray[np.int64], level: Accuracy
) -> NDArray[np.bool_]:
    """Return (m,) whether pairs collide on a level below OBB, given that their AABBs overlap."""
    if level == Accuracy.SPHERE:
        return spheres_may_collide(boxes, first, second)
    if level == Accuracy.OBB_FACES:
        return faces_may_collide(boxes, first, second)
    return np.ones(len(first), np.bool_)


def columns(pairs: Pairs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the two sides of pairs (m, 2), each in one run of memory, as kernels like it."""
    return np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1])


def colliding_pairs(boxes: Boxes, candidates: Pairs, exact: bool = False) -> tuple[Pairs, Verdicts]:
    """Return the candidates (m, 2) that are not SEPARATE, sorted, and their verdicts."""
    first, second = columns(candidates)
    verdicts = pair_verdicts(boxes, first, boxes, second, exact)
    return _sorted_kernel(candidates, verdicts, len(boxes))


@njit
def _sorted_kernel(
    pairs: np.ndarray, verdicts: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs (m, 2) of ``count`` rows that are not SEPARATE in order, and verdicts."""
    bits = bits_of(count)
    kept = 0
    for verdict in verdicts:
        kept += verdict != SEPARATE
    keys, rows = np.empty(kept, np.int64), np.empty(kept, np.int64)
    kept = 0
    for n in range(len(pairs)):
        if verdicts[n] != SEPARATE:
            keys[kept], rows[kept] = (pairs[n, 0] << bits) | pairs[n, 1], n
            kept += 1
    sort_by_keys(keys, rows, 2 * bits)
    sorted_pairs, sorted_verdicts = np.empty((kept, 2), np.int64), np.empty(kept, np.int8)
    for n in range(kept):
        sorted_pairs[n, 0], sorted_pairs[n, 1] = pairs[rows[n], 0], pairs[rows[n], 1]
        sorted_verdicts[n] = verdicts[rows[n]]
    return sorted_pairs, sorted_verdicts
