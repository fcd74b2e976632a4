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

"""Euclidean distance of two boxes and their closest points.

Verdict and distance go together: the distance is positive exactly for pairs that
``verdict.verdicts`` calls SEPARATE, 0 for TOUCHING, and negative for OVERLAP: minus the depth,
the least translation along any of the 15 axes that parts them (``witness``).

Accuracy: distances of separate pairs are within 1e-12 of the size of the pair, the sum of its six
half extents or the distance itself, whichever is larger; so is the distance between the points
given, but for the rounding of world coordinates. The proof is in ``closest_points``. Where many
points are equally close (parallel faces) the ones given are some of them; where they are so up to
that accuracy (nearly parallel), the ones given may lie anywhere among those.

The answer for b and a is that for a and b, bit for bit, points exchanged and normal reversed
(boxes identical in every bit have no order: theirs is the same both ways). Only the offset of the
centres counts, not where they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.numerics.vec3 import components, minus, negated, scaled
from obb_collision.queries.clearance.closest_points import NEAR, Points, points_apart, points_near
from obb_collision.queries.verdict.pair_rows import as_pairs, one_set
from obb_collision.queries.verdict.sat import (
    BoxAt,
    Pair,
    best_face,
    box_at,
    enter_frame,
    leave_frame,
)
from obb_collision.queries.verdict.verdict import SEPARATE, TOUCHING, box_verdict
from obb_collision.queries.verdict.witness import box_witness
from obb_collision.typing import Floats, Integers, Mask, Vector
from obb_collision.words import shown

#: Pairs below which a second thread does not pay: 30 us.
FEWEST_CLEARANCES = 64
#: Of m pairs: whether they are near (m,), distances (m,), points and normals (3, m, 3).
NearArrays = tuple[np.ndarray, Floats, Floats]
#: Kinds of real numbers.
REAL = (int, float, np.integer, np.floating)


@dataclass(frozen=True, eq=False)
class Clearances:
    """Distance and closest points of m pairs of boxes a, b; metres, world frame."""

    pairs: Integers
    """(m, 2) rows of a and b; in a report, indices of objects."""
    distances: Floats
    """(m,) positive apart, minus the depth where they overlap, 0 where they touch."""
    positions_a: Floats
    """(m, 3) the point of a closest to b; overlapping, the deepest in b along the normal."""
    positions_b: Floats
    """(m, 3) the same of b."""
    normals: Floats
    """(m, 3) unit vector from a to b along which the distance is; within 1e-12 of touching, and
    where boxes overlap, the axis of the largest gap."""

    def __len__(self) -> int:
        return len(self.distances)


def box_clearances(
    a: Boxes, b: Boxes, pairs: ArrayLike | None = None, *, max_distance: float = np.inf
) -> Clearances:
    """Return the clearances of boxes that are within a distance, in metres."""
    given = as_pairs(a, b, pairs)
    boxes, checked = one_set(a, b, given)
    found, near = near_pairs(boxes, checked, as_limit(max_distance))
    return replace(found, pairs=given[near])


def as_limit(max_distance: float) -> float:
    """Return a distance in metres, infinite for none."""
    if not (isinstance(max_distance, REAL) and max_distance >= 0.0):  # NaN too
        raise ValueError(f"max_distance must be a number, at least 0, got {shown(max_distance)}")
    return float(max_distance) if max_distance <= MAX_MAGNITUDE else np.inf


def near_pairs(boxes: Boxes, pairs: Integers, limit: float) -> tuple[Clearances, Mask]:
    """Return the clearances of pairs (m, 2) of rows within a limit, and which these are (m,)."""
    near = np.empty(len(pairs), np.bool_)
    distances, vectors = np.empty(len(pairs)), np.empty((3, len(pairs), 3))
    out = near, distances, vectors
    run(clearance_kernel, len(pairs), FEWEST_CLEARANCES, boxes.arrays, pairs, limit, out)
    return Clearances(pairs[near], distances[near], *vectors[:, near]), near


@njit
def clearance_kernel(
    boxes: BoxArrays, pairs: np.ndarray, limit: float, out: NearArrays, start: int, stop: int
) -> None:
    """Write whether pairs ``start`` to ``stop`` of (m, 2) are within the limit.

    And the distance, points and normal of those that are.
    """
    near, distances, vectors = out
    for row in range(start, stop):
        near[row] = False
        a, b = box_at(boxes, pairs[row, 0]), box_at(boxes, pairs[row, 1])
        swapped = _comes_before(b, a)
        if swapped:
            a, b = b, a
        pair, size, scale = enter_frame(a, b)
        face = best_face(pair)
        if (face[0] - NEAR * size) / scale > limit:
            continue
        apart, points, n = points_apart(pair, size, face)
        verdict, gap = SEPARATE, 0.0
        if not apart:
            verdict, gap, points, n = _near_points(a, b, pair, size, scale)
        distance, p, q, n = leave_frame(a, b, points.s, points.t, n, scale)
        if swapped:
            p, q, n = q, p, negated(n)
        if verdict == TOUCHING:
            gap = 0.0
        distance = max(distance, gap) if verdict == SEPARATE else gap
        if distance <= limit:
            near[row], distances[row] = True, distance
            for k in range(3):
                vectors[0, row, k], vectors[1, row, k], vectors[2, row, k] = p[k], q[k], n[k]


@njit
def _comes_before(a: BoxAt, b: BoxAt) -> bool:
    """Order boxes by their numbers: one box is always the first, however a pair is given."""
    for k in range(3):
        if a.center[k] != b.center[k]:
            return a.center[k] < b.center[k]
    for k in range(3):
        if a.half_extents[k] != b.half_extents[k]:
            return a.half_extents[k] < b.half_extents[k]
    for k in range(3):
        for m in range(3):
            if a.axes[m][k] != b.axes[m][k]:
                return a.axes[m][k] < b.axes[m][k]
    return False


@njit
def _near_points(
    a: BoxAt, b: BoxAt, pair: Pair, size: float, scale: float
) -> tuple[int, float, Points, Vector]:
    """Return verdict, gap (metres), points and axis of boxes that overlap, or do so nearly.

    Points of boxes that overlap are those that touch when the depth has been taken back.
    """
    verdict = box_verdict(a, b)
    (gap, axis, number), _ = box_witness(a, b)
    n = components(a.axes, axis)
    back = 0.0 if verdict == SEPARATE else gap * scale
    touching = Pair(minus(pair.d, scaled(n, back)), pair.r, pair.h, pair.f)
    return verdict, gap, points_near(touching, size, gap * scale - back, number, n), n
