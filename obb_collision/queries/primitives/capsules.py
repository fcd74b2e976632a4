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

"""Capsules and spheres against boxes and each other: verdict, signed separation, nearest points.

A sphere is a capsule without length (``Capsules.spheres``). Verdicts are certified as those of
boxes are, for the doubles as stored: OVERLAP by two points, one of each body's core (segment or
box), that are nearer than the radii; SEPARATE by a direction along which the bodies are apart.
The rest is TOUCHING: within NEAR_BOUND of the size of the pair, or a core without radius that
touches a flat box or another such core.

Error analysis: u = 2^-53, T = the distances from the box centre to the segment's ends, or of the
segments' starts, + half extents or lengths + radii. A gap along a computed direction is off by at
most 12 u T, bounded by FAR_BOUND T. A distance from a box, taken in the frame of axes orthonormal
to 64 u, is off by at most 2 x 96 u T for those and 10 u T for rounding, bounded by NEAR_BOUND T.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.capsules import CapsuleArrays, Capsules
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import (
    careful_cross,
    clamped,
    combined,
    components,
    dot,
    max_abs,
    minus,
    negated,
    plus,
    scaled,
    sum_abs,
    vector_at,
)
from obb_collision.queries.clearance.clearance import Clearances, as_limit
from obb_collision.queries.primitives.segments import (
    across,
    nearest_of_segments,
    nearest_to_box,
    segment_box_gap,
    segment_gap,
    unit_scale,
    widest_gap,
)
from obb_collision.queries.verdict.pair_rows import RowPairs, as_pairs, as_sides
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.queries.verdict.verdict import (
    OVERLAP,
    SEPARATE,
    TOUCHING,
    CertifiedSeparations,
    Verdicts,
)
from obb_collision.typing import Floats, Vector

#: Bound of a distance that proves nearness, relative to T: 256 unit roundoffs (see ``capsules``).
NEAR_BOUND = 256 * ROUNDOFF
#: Bound of a gap that proves a distance, relative to T: 32 unit roundoffs (see ``capsules``).
FAR_BOUND = 32 * ROUNDOFF


class CapsuleAt(NamedTuple):
    """A single capsule."""

    start: Vector
    end: Vector
    radius: float


class SegmentAndBox(NamedTuple):
    """A capsule and a box in a frame at the centre of the box, scaled to about 1."""

    first: Vector  #: start of the segment
    last: Vector  #: its end
    way: Vector  #: from start to end
    half_extents: Vector
    radius: float
    back: float  #: scales lengths back


class SegmentPair(NamedTuple):
    """Two capsules in a frame at the start of the first, scaled to about 1."""

    u: Vector  #: the first segment
    offset: Vector  #: of the start of the second
    v: Vector  #: the second segment
    radius_a: float
    radius_b: float
    back: float  #: scales lengths back


#: Separation, unit normal from a to b, and the nearest points of a and b.
SignedDistance = tuple[float, Vector, Vector, Vector]


@njit(refcount=False)
def capsule_at(capsules: CapsuleArrays, i: int) -> CapsuleAt:
    """Return capsule i."""
    return CapsuleAt(vector_at(capsules.starts, i), vector_at(capsules.ends, i), capsules.radii[i])


@njit
def _write(distance: SignedDistance, n: int, distances: Floats, vectors: Floats) -> None:
    """Write a separation (m,), and normal and nearest points (3, m, 3)."""
    distances[n] = distance[0]
    for k in range(3):
        vectors[0, n, k] = distance[1][k]
        vectors[1, n, k], vectors[2, n, k] = distance[2][k], distance[3][k]


@njit
def _about_box(a: CapsuleAt, b: BoxAt) -> SegmentAndBox:
    first, last = minus(a.start, b.center), minus(a.end, b.center)
    h, way = b.half_extents, minus(a.end, a.start)
    scale, back = unit_scale(max(max_abs(first), max_abs(last), max_abs(h), a.radius))
    first, last, way, h = (
        scaled(first, scale),
        scaled(last, scale),
        scaled(way, scale),
        scaled(h, scale),
    )
    return SegmentAndBox(first, last, way, h, scale * a.radius, back)


@njit
def box_verdicts_kernel(pairs: RowPairs, out: np.ndarray) -> None:
    """Write the verdict (m,) of each capsule rows_a[n] against box rows_b[n]."""
    a, rows_a, b, rows_b = pairs
    for n in range(len(rows_a)):
        out[n] = _box_verdict(capsule_at(a, rows_a[n]), box_at(b, rows_b[n]))


@njit
def _box_verdict(a: CapsuleAt, b: BoxAt) -> int:
    pair = _about_box(a, b)
    h, r = pair.half_extents, pair.radius
    size = sum_abs(pair.first) + sum_abs(pair.last) + sum_abs(h) + r
    y, w = components(b.axes, pair.first), components(b.axes, pair.way)
    y = plus(y, scaled(w, nearest_to_box(y, w, h)))
    e = minus(y, clamped(y, h))
    near = math.sqrt(dot(e, e))
    if near == 0.0:
        near = -min(h[0] - abs(y[0]), h[1] - abs(y[1]), h[2] - abs(y[2]))
    if near - r < -NEAR_BOUND * size:
        return OVERLAP
    gap, _ = segment_box_gap(combined(b.axes, e), pair.first, pair.last, b.axes, h)
    if gap - r > FAR_BOUND * size:
        return SEPARATE
    gap, _ = widest_gap(pair.first, pair.last, pair.way, b.axes, h)
    return SEPARATE if gap - r > FAR_BOUND * size else TOUCHING


@njit
def box_distances_kernel(pairs: RowPairs, distances: Floats, vectors: Floats) -> None:
    """Write separation, and normal and points, of capsule rows_a[n] and box rows_b[n]."""
    a, rows_a, b, rows_b = pairs
    for n in range(len(rows_a)):
        distance = _box_distance(capsule_at(a, rows_a[n]), box_at(b, rows_b[n]))
        _write(distance, n, distances, vectors)


@njit
def _box_distance(a: CapsuleAt, b: BoxAt) -> SignedDistance:
    pair = _about_box(a, b)
    h = pair.half_extents
    y, w = components(b.axes, pair.first), components(b.axes, pair.way)
    at = plus(y, scaled(w, nearest_to_box(y, w, h)))
    e = minus(at, clamped(at, h))
    near = math.sqrt(dot(e, e))
    away = combined(b.axes, e)
    shown, side = segment_box_gap(away, pair.first, pair.last, b.axes, h)
    size = sum_abs(pair.first) + sum_abs(pair.last) + sum_abs(h)
    if near - shown > FAR_BOUND * size:  # so near that e is inexact, or it is zero
        away = across(away, pair.way)
        near, side = segment_box_gap(away, pair.first, pair.last, b.axes, h)
        widest, towards = widest_gap(pair.first, pair.last, pair.way, b.axes, h)
        if not near >= widest:  # the segment intersects the box: move it to where they touch
            near, away, side = widest, negated(towards), 1.0
            out = plus(y, scaled(components(b.axes, towards), near))
            at = plus(out, scaled(w, nearest_to_box(out, w, h)))
            e = minus(at, clamped(at, h))
    towards = scaled(away, -side / math.sqrt(dot(away, away)))
    gap = near - pair.radius
    on_box = combined(b.axes, minus(at, e))
    on_capsule = minus(on_box, scaled(towards, gap))
    on_capsule = plus(b.center, scaled(on_capsule, pair.back))
    return pair.back * gap, towards, on_capsule, plus(b.center, scaled(on_box, pair.back))


@njit
def _about_start(a: CapsuleAt, b: CapsuleAt) -> SegmentPair:
    u, v, d = minus(a.end, a.start), minus(b.end, b.start), minus(b.start, a.start)
    scale, back = unit_scale(max(max_abs(u), max_abs(d), max_abs(v), a.radius, b.radius))
    u, d, v = scaled(u, scale), scaled(d, scale), scaled(v, scale)
    return SegmentPair(u, d, v, scale * a.radius, scale * b.radius, back)


@njit
def capsule_verdicts_kernel(pairs: RowPairs, out: np.ndarray) -> None:
    """Write the verdict (m,) of each capsule rows_a[n] of a against rows_b[n] of b."""
    a, rows_a, b, rows_b = pairs
    for n in range(len(rows_a)):
        out[n] = _capsule_verdict(capsule_at(a, rows_a[n]), capsule_at(b, rows_b[n]))


@njit
def _capsule_verdict(a: CapsuleAt, b: CapsuleAt) -> int:
    u, d, v, r, f, _ = _about_start(a, b)
    bound = FAR_BOUND * (sum_abs(u) + sum_abs(d) + sum_abs(v) + r + f)
    at_u, at_v = nearest_of_segments(u, d, v)
    between = plus(plus(d, scaled(v, at_v)), scaled(u, -at_u))
    if math.sqrt(dot(between, between)) - (r + f) < -bound:
        return OVERLAP
    for n in (between, careful_cross(u, v)):
        if segment_gap(n, u, d, v)[0] - (r + f) > bound:
            return SEPARATE
    return TOUCHING


@njit
def capsule_distances_kernel(pairs: RowPairs, distances: Floats, vectors: Floats) -> None:
    """Write separations (m,), and normals and nearest points (3, m, 3), of pairs of capsules."""
    a, rows_a, b, rows_b = pairs
    for n in range(len(rows_a)):
        distance = _capsule_distance(capsule_at(a, rows_a[n]), capsule_at(b, rows_b[n]))
        _write(distance, n, distances, vectors)


@njit
def _capsule_distance(a: CapsuleAt, b: CapsuleAt) -> SignedDistance:
    u, d, v, r, f, back = _about_start(a, b)
    at_u, at_v = nearest_of_segments(u, d, v)
    foot = scaled(u, at_u)
    towards = minus(plus(d, scaled(v, at_v)), foot)
    near = math.sqrt(dot(towards, towards))
    shown, side = segment_gap(towards, u, d, v)
    if near - shown > FAR_BOUND * (sum_abs(u) + sum_abs(d) + sum_abs(v)):  # as for boxes
        for n in (across(towards, u), across(towards, v), _any_normal(u, v)):
            gap, way = segment_gap(n, u, d, v)
            if gap > shown:
                shown, side, towards = gap, way, n
    towards = scaled(towards, side / math.sqrt(dot(towards, towards)))
    on_a, on_b = plus(foot, scaled(towards, r)), plus(foot, scaled(towards, near - f))
    on_a, on_b = plus(a.start, scaled(on_a, back)), plus(a.start, scaled(on_b, back))
    return back * (near - (r + f)), towards, on_a, on_b


@njit
def _any_normal(u: Vector, v: Vector) -> Vector:
    """Return a vector normal to two segments, or to one of them if they are parallel."""
    n = careful_cross(u, v)
    for w in (u, v):
        if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
            if abs(w[0]) <= min(abs(w[1]), abs(w[2])):
                n = (0.0, -w[2], w[1])
            elif abs(w[1]) <= abs(w[2]):
                n = (w[2], 0.0, -w[0])
            else:
                n = (-w[1], w[0], 0.0)
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        return 1.0, 0.0, 0.0
    return n


def capsule_verdicts(a: Capsules, b: Capsules | Boxes, pairs: ArrayLike | None = None) -> Verdicts:
    """Return the verdicts (m,) int8 of capsules against capsules or boxes."""
    first, second = as_sides(a, b, pairs)
    return capsule_pair_verdicts(a, first, b, second)


def capsule_pair_verdicts(
    a: Capsules, rows_a: np.ndarray, b: Capsules | Boxes, rows_b: np.ndarray
) -> Verdicts:
    """Return the verdicts of ``a[rows_a[n]]`` against ``b[rows_b[n]]``, (n,) int8."""
    out = np.empty(len(rows_a), np.int8)
    kernel = box_verdicts_kernel if isinstance(b, Boxes) else capsule_verdicts_kernel
    kernel(RowPairs(a.arrays, rows_a, b.arrays, rows_b), out)
    return out


def capsule_clearances(
    a: Capsules,
    b: Capsules | Boxes,
    pairs: ArrayLike | None = None,
    *,
    max_distance: float = np.inf,
) -> Clearances:
    """Return the signed distances of capsules from capsules or boxes, and nearest points.

    Distances of those that overlap are minus the least translation that separates them; positions
    are then the deepest: positions_b is positions_a + distance x normal.
    """
    limit, rows = as_limit(max_distance), as_pairs(a, b, pairs)
    first, second = np.ascontiguousarray(rows.T)
    distances, vectors = np.empty(len(rows)), np.empty((3, len(rows), 3))
    kernel = box_distances_kernel if isinstance(b, Boxes) else capsule_distances_kernel
    kernel(RowPairs(a.arrays, first, b.arrays, second), distances, vectors)
    near = distances <= limit
    normals, first_positions, second_positions = vectors[:, near]
    return Clearances(rows[near], distances[near], first_positions, second_positions, normals)


def capsule_separations(
    a: Capsules, b: Capsules | Boxes, pairs: ArrayLike | None = None
) -> CertifiedSeparations:
    """Return the signed separations of capsules from capsules or boxes, with their verdicts."""
    near = capsule_clearances(a, b, pairs)
    middles = 0.5 * (near.positions_a + near.positions_b)
    verdicts = capsule_verdicts(a, b, near.pairs)
    return CertifiedSeparations(near.pairs, near.distances, near.normals, middles, verdicts)
