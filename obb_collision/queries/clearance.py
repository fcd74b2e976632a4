"""How far apart are two boxes, and where? The Euclidean distance and the closest points.

Verdict and distance go together: the distance is positive exactly for pairs that
``separation.verdicts`` calls SEPARATE, 0 for TOUCHING, and negative for OVERLAP: minus the depth,
the least translation along any of the 15 axes that parts them (``witness``).

Accuracy: distances of separate pairs are within 1e-12 of the size of the pair, the sum of its six
half extents or the distance itself, whichever is larger; so is the distance between the points
given, but for the rounding of world coordinates. How that is known: ``closest_points``.

The answer for b and a is that for a and b, bit for bit, points exchanged and normal reversed
(boxes identical in every bit have no order: theirs is the same both ways). Only the offset of the
centres counts, not where they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.error_free import length
from obb_collision.geometry.validation import Floats
from obb_collision.queries.closest_features import Pair, empty_pair
from obb_collision.queries.closest_points import NEAR, best_face, points_apart, points_near
from obb_collision.queries.pair_rows import as_pairs
from obb_collision.queries.separation import (
    SEPARATE,
    TOUCHING,
    UNDECIDED,
    classify_careful,
    classify_fast,
)
from obb_collision.queries.witness import AXES, witness

#: Sizes between these powers of two are taken as they are: their squares are far from the ends.
SCALED_BELOW = 2.0**-300
SCALED_ABOVE = 2.0**300


@dataclass(frozen=True, eq=False)
class Clearances:
    """Distance and closest points of m pairs of boxes a, b; metres, world frame."""

    distances: Floats
    """(m,) positive apart, minus the depth where they overlap, 0 where they touch."""
    points_a: Floats
    """(m, 3) the point of a closest to b; overlapping, the deepest in b along the normal."""
    points_b: Floats
    """(m, 3) the same of b: ``points_a + distances * normals``, to rounding."""
    normals: Floats
    """(m, 3) unit vector from a to b along which the distance is."""

    def __len__(self) -> int:
        return len(self.distances)


def clearances(boxes: Boxes, pairs: ArrayLike) -> Clearances:
    """Return the clearance of each pair (m, 2) of rows of ``boxes``.

    Raises ValueError naming the argument and the row for pairs that are none.
    """
    return clearances_within(boxes, pairs, np.inf)[1]


def clearances_within(
    boxes: Boxes, pairs: ArrayLike, limit: float
) -> tuple[NDArray[np.int64], Clearances]:
    """Return which pairs are no farther apart than ``limit`` metres, and their clearances.

    The first of both are rows of ``pairs`` (m, 2), ascending. What the six face normals show to
    be farther apart costs no more than that. Raises ValueError naming the argument.
    """
    checked = as_pairs(pairs, len(boxes))
    if not limit >= 0.0:  # NaN too
        raise ValueError(f"limit must be at least 0, got {limit}")
    count = len(checked)
    rows = np.empty(count, np.int64)
    distances, vectors = np.empty(count), np.empty((3, count, 3))
    kept = clearance_kernel(
        *(boxes.centers, boxes.rotations, boxes.half_extents, checked, float(limit)),
        *(rows, distances, vectors[0], vectors[1], vectors[2]),
    )
    points_a, points_b, normals = vectors[:, :kept]
    return rows[:kept], Clearances(distances[:kept], points_a, points_b, normals)


@njit
def clearance_kernel(
    centers: Floats,
    rotations: Floats,
    half_extents: Floats,
    pairs: np.ndarray,
    limit: float,
    rows: np.ndarray,
    distances: Floats,
    points_a: Floats,
    points_b: Floats,
    normals: Floats,
) -> int:
    """Write row, distance, points and normal of each pair (m, 2) within the limit; return how many.

    All outputs have room for m.
    """
    pair = empty_pair()
    most = np.empty(AXES)
    count = 0
    for row in range(len(pairs)):
        i, j = pairs[row]
        first, second = points_a[count], points_b[count]
        swapped = _comes_before(centers, rotations, half_extents, j, i)
        if swapped:
            i, j = j, i
            first, second = second, first
        size, scale = _enter_frame(centers, rotations, half_extents, i, j, pair)
        gap, number = best_face(pair)
        if (gap - NEAR * size) / scale > limit:
            continue
        if points_apart(pair, size, gap, number):
            verdict, gap = SEPARATE, 0.0
        else:
            verdict, gap = _near_points(
                centers, rotations, half_extents, i, j, pair, size, scale, most
            )
        distance = _leave_frame(
            centers, rotations, half_extents, i, j, pair, scale, first, second, normals[count]
        )
        distance = max(distance, gap) if verdict == SEPARATE else min(gap, 0.0)
        if verdict == TOUCHING:
            distance = 0.0
        if distance > limit:
            continue
        if swapped:
            for k in range(3):
                normals[count, k] = -normals[count, k]
        distances[count] = distance
        rows[count] = row
        count += 1
    return count


@njit
def _comes_before(centers: Floats, rotations: Floats, extents: Floats, i: int, j: int) -> bool:
    """Order boxes by their numbers: one box is always the first, however a pair is given."""
    for k in range(3):
        if centers[i, k] != centers[j, k]:
            return bool(centers[i, k] < centers[j, k])
    for k in range(3):
        if extents[i, k] != extents[j, k]:
            return bool(extents[i, k] < extents[j, k])
    for k in range(3):
        for m in range(3):
            if rotations[i, k, m] != rotations[j, k, m]:
                return bool(rotations[i, k, m] < rotations[j, k, m])
    return False


@njit
def _enter_frame(
    centers: Floats, rotations: Floats, extents: Floats, i: int, j: int, pair: Pair
) -> tuple[float, float]:
    """Write both boxes in the frame of i, scaled; return their size in it, and the scale.

    The size is that of ``separation``: offset of the centres and half extents of both, summed.
    """
    x = centers[j, 0] - centers[i, 0]
    y = centers[j, 1] - centers[i, 1]
    z = centers[j, 2] - centers[i, 2]
    size = abs(x) + abs(y) + abs(z)
    for k in range(3):
        size += extents[i, k] + extents[j, k]
    scale = 1.0
    if size != 0.0 and not SCALED_BELOW < size < SCALED_ABOVE:
        scale = math.ldexp(1.0, min(max(-math.frexp(size)[1], -1022), 1022))
    for k in range(3):
        ax, ay, az = rotations[i, 0, k], rotations[i, 1, k], rotations[i, 2, k]
        pair.d[k] = ax * (x * scale) + ay * (y * scale) + az * (z * scale)
        for m in range(3):
            pair.r[k, m] = (
                ax * rotations[j, 0, m] + ay * rotations[j, 1, m] + az * rotations[j, 2, m]
            )
        pair.h[k] = extents[i, k] * scale
        pair.f[k] = extents[j, k] * scale
    return size * scale, scale


@njit
def _near_points(
    centers: Floats, rotations: Floats, extents: Floats, i: int, j: int, pair: Pair,
    size: float, scale: float, most: Floats,
) -> tuple[int, float]:  # fmt: skip
    """Write points and axis of boxes that touch, overlap or are nearly so; verdict, gap (metres).

    Points of boxes that overlap are those that touch when the depth has been taken back.
    """
    ca, a, h = centers[i], rotations[i], extents[i]
    cb, b, f = centers[j], rotations[j], extents[j]
    verdict = classify_fast(centers, rotations, extents, i, centers, rotations, extents, j)
    if verdict == UNDECIDED:
        verdict = classify_careful(ca, a, h, cb, b, f)
    gap, x, y, z, number = witness(ca, a, h, cb, b, f, most)
    back = 0.0 if verdict == SEPARATE else gap * scale
    for k in range(3):
        pair.n[k] = a[0, k] * x + a[1, k] * y + a[2, k] * z
        pair.d[k] -= back * pair.n[k]
    points_near(pair, size, gap * scale - back, number)
    for k in range(3):
        pair.n[k] = a[0, k] * x + a[1, k] * y + a[2, k] * z
    return verdict, gap


@njit
def _leave_frame(
    centers: Floats, rotations: Floats, extents: Floats, i: int, j: int, pair: Pair,
    scale: float, first: Floats, second: Floats, normal: Floats,
) -> float:  # fmt: skip
    """Write points and normal (3,) in the world frame; return the distance of the points."""
    for k in range(3):
        pair.s[k] = min(max(pair.s[k] / scale, -extents[i, k]), extents[i, k])
        pair.t[k] = min(max(pair.t[k] / scale, -extents[j, k]), extents[j, k])
    for k in range(3):
        a0, a1, a2 = rotations[i, k, 0], rotations[i, k, 1], rotations[i, k, 2]
        b0, b1, b2 = rotations[j, k, 0], rotations[j, k, 1], rotations[j, k, 2]
        from_i = a0 * pair.s[0] + a1 * pair.s[1] + a2 * pair.s[2]
        from_j = b0 * pair.t[0] + b1 * pair.t[1] + b2 * pair.t[2]
        first[k] = centers[i, k] + from_i
        second[k] = centers[j, k] + from_j
        normal[k] = a0 * pair.n[0] + a1 * pair.n[1] + a2 * pair.n[2]
        pair.d[k] = (centers[j, k] - centers[i, k]) + (from_j - from_i)
    norm = length(normal[0], normal[1], normal[2])
    for k in range(3):
        normal[k] /= norm
    return length(pair.d[0], pair.d[1], pair.d[2])
