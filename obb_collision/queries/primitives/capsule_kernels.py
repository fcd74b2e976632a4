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

"""Kernels of ``capsules``: they scale a pair to about 1, call ``segments``, and write."""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import (
    axes_of,
    careful_cross,
    clamped,
    combined,
    components,
    dot,
    max_abs,
    minus,
    plus,
    scaled,
    sum_abs,
    vector_at,
)
from obb_collision.queries.primitives.segments import (
    box_gap,
    nearest_of_segments,
    nearest_to_box,
    segment_gap,
    unit_scale,
    widest_gap,
)
from obb_collision.queries.verdict.verdict import OVERLAP, SEPARATE, TOUCHING
from obb_collision.typing import Floats, Vector

#: Bound of a distance that proves nearness, relative to T: 256 unit roundoffs (see ``capsules``).
NEAR_BOUND = 256 * ROUNDOFF
#: Bound of a gap that proves a distance, relative to T: 32 unit roundoffs (see ``capsules``).
FAR_BOUND = 32 * ROUNDOFF


@njit
def _scaled_box_pair(
    starts: Floats, ends: Floats, radii: Floats, i: int, centers: Floats, half: Floats, j: int
) -> tuple[Vector, Vector, Vector, Vector, float, float]:
    """Return both ends about the box centre, the segment, half extents, radius, all scaled.

    And the number that scales them back.
    """
    d0, d1 = (
        minus(vector_at(starts, i), vector_at(centers, j)),
        minus(vector_at(ends, i), vector_at(centers, j)),
    )
    v = minus(vector_at(ends, i), vector_at(starts, i))
    h = (half[j, 0], half[j, 1], half[j, 2])
    r = radii[i]
    scale, back = unit_scale(max(max_abs(d0), max_abs(d1), max_abs(h), r))
    return scaled(d0, scale), scaled(d1, scale), scaled(v, scale), scaled(h, scale), scale * r, back


@njit
def box_verdicts_kernel(
    starts: Floats, ends: Floats, radii: Floats, rows_a: np.ndarray,
    centers: Floats, axes: Floats, half: Floats, rows_b: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Write the verdict (m,) of each capsule rows_a[n] against box rows_b[n]."""
    for n in range(len(rows_a)):
        out[n] = _box_verdict(starts, ends, radii, rows_a[n], centers, axes, half, rows_b[n])


@njit
def _box_verdict(
    starts: Floats, ends: Floats, radii: Floats, i: int,
    centers: Floats, axes: Floats, half: Floats, j: int,
) -> int:  # fmt: skip
    d0, d1, v, h, r, _ = _scaled_box_pair(starts, ends, radii, i, centers, half, j)
    size = sum_abs(d0) + sum_abs(d1) + sum_abs(h) + r
    y, w = components(axes_of(axes, j), d0), components(axes_of(axes, j), v)
    y = plus(y, scaled(w, nearest_to_box(y, w, h)))
    e = minus(y, clamped(y, h))
    near = math.sqrt(dot(e, e))
    if near == 0.0:
        near = -min(h[0] - abs(y[0]), h[1] - abs(y[1]), h[2] - abs(y[2]))
    if near - r < -NEAR_BOUND * size:
        return OVERLAP
    gap, _ = box_gap(combined(axes_of(axes, j), e), d0, d1, axes, j, h)
    if gap - r > FAR_BOUND * size:
        return SEPARATE
    gap, _ = widest_gap(d0, d1, v, axes, j, h)
    return SEPARATE if gap - r > FAR_BOUND * size else TOUCHING


@njit
def box_distances_kernel(
    starts: Floats, ends: Floats, radii: Floats, centers: Floats, axes: Floats, half: Floats,
    separations: Floats, normals: Floats, positions_a: Floats, positions_b: Floats,
) -> None:  # fmt: skip
    """Write separation (n,), normal, points of capsule and box (n, 3) of each row."""
    for n in range(len(starts)):
        d0, d1, v, h, r, back = _scaled_box_pair(starts, ends, radii, n, centers, half, n)
        y, w = components(axes_of(axes, n), d0), components(axes_of(axes, n), v)
        at = plus(y, scaled(w, nearest_to_box(y, w, h)))
        e = minus(at, clamped(at, h))
        near = math.sqrt(dot(e, e))
        if near > 0.0:
            towards = combined(axes_of(axes, n), scaled(e, -1.0 / near))
        else:  # the segment intersects the box: move it out, to where they touch
            near, towards = widest_gap(d0, d1, v, axes, n, h)
            out = plus(y, scaled(components(axes_of(axes, n), towards), near))
            at = plus(out, scaled(w, nearest_to_box(out, w, h)))
            e = minus(at, clamped(at, h))
        gap = near - r
        separations[n] = back * gap
        on_box = combined(axes_of(axes, n), minus(at, e))
        for k in range(3):
            normals[n, k] = towards[k]
            positions_b[n, k] = centers[n, k] + back * on_box[k]
            positions_a[n, k] = centers[n, k] + back * (on_box[k] - gap * towards[k])


@njit
def _scaled_pair(
    p: Floats, q: Floats, radii_a: Floats, i: int, s: Floats, t: Floats, radii_b: Floats, j: int
) -> tuple[Vector, Vector, Vector, float, float, float]:
    """Return first segment, offset of the starts, second segment, both radii, all scaled.

    And the number that scales them back.
    """
    u, d, v = (
        minus(vector_at(q, i), vector_at(p, i)),
        minus(vector_at(s, j), vector_at(p, i)),
        minus(vector_at(t, j), vector_at(s, j)),
    )
    r, f = radii_a[i], radii_b[j]
    scale, back = unit_scale(max(max_abs(u), max_abs(d), max_abs(v), r, f))
    return scaled(u, scale), scaled(d, scale), scaled(v, scale), scale * r, scale * f, back


@njit
def capsule_verdicts_kernel(
    p: Floats, q: Floats, radii_a: Floats, rows_a: np.ndarray,
    s: Floats, t: Floats, radii_b: Floats, rows_b: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Write the verdict (m,) of capsule p q rows_a[n] against capsule s t rows_b[n]."""
    for n in range(len(rows_a)):
        out[n] = _capsule_verdict(p, q, radii_a, rows_a[n], s, t, radii_b, rows_b[n])


@njit
def _capsule_verdict(
    p: Floats, q: Floats, radii_a: Floats, i: int, s: Floats, t: Floats, radii_b: Floats, j: int
) -> int:
    u, d, v, r, f, _ = _scaled_pair(p, q, radii_a, i, s, t, radii_b, j)
    bound = FAR_BOUND * (sum_abs(u) + sum_abs(d) + sum_abs(v) + r + f)
    at_u, at_v = nearest_of_segments(u, d, v)
    between = plus(plus(d, scaled(v, at_v)), scaled(u, -at_u))
    if math.sqrt(dot(between, between)) - (r + f) < -bound:
        return OVERLAP
    if segment_gap(between, u, d, v) - (r + f) > bound:
        return SEPARATE
    return SEPARATE if segment_gap(careful_cross(u, v), u, d, v) - (r + f) > bound else TOUCHING


@njit
def capsule_distances_kernel(
    p: Floats, q: Floats, radii_a: Floats, s: Floats, t: Floats, radii_b: Floats,
    separations: Floats, normals: Floats, positions_a: Floats, positions_b: Floats,
) -> None:  # fmt: skip
    """Write separation (n,), normal and points (n, 3) of capsules p q and s t, row by row."""
    for n in range(len(p)):
        u, d, v, r, f, back = _scaled_pair(p, q, radii_a, n, s, t, radii_b, n)
        at_u, at_v = nearest_of_segments(u, d, v)
        foot = scaled(u, at_u)
        towards = plus(plus(d, scaled(v, at_v)), scaled(foot, -1.0))
        near = math.sqrt(dot(towards, towards))
        if near == 0.0:
            towards = _any_normal(u, v)
        towards = scaled(towards, 1.0 / math.sqrt(dot(towards, towards)))
        separations[n] = back * (near - (r + f))
        for k in range(3):
            normals[n, k] = towards[k]
            positions_a[n, k] = p[n, k] + back * (foot[k] + r * towards[k])
            positions_b[n, k] = p[n, k] + back * (foot[k] + (near - f) * towards[k])


@njit
def _any_normal(u: Vector, v: Vector) -> Vector:
    """Return a vector normal to two segments that cross; to one of them, or any, if they don't."""
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
