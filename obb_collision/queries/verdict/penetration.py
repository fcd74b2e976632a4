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

"""How far apart or how deep, and along which axis: the witness of a verdict."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.queries.verdict.careful import Axes, careful_gap, columns
from obb_collision.queries.verdict.gap_bounds import bound_gaps
from obb_collision.queries.verdict.sat import (
    Pair,
    Vector,
    along_b,
    clamped,
    column,
    dot,
    minus,
    plus,
    scaled,
    vector,
)
from obb_collision.typing import Floats

AXES = 15

#: Signed gap, unit axis, number of the axis.
Witness = tuple[float, float, float, float, int]


@njit
def witness(
    ca: Floats, a: Floats, h: Floats, cb: Floats, b: Floats, f: Floats, most: Floats
) -> tuple[float, float, float, float, int]:
    """Return the signed gap, its unit axis from a towards b, and the number of the axis.

    ``most`` (15,) is work space.

    The largest of the 15 gaps along normalised axes: positive, it proves that the boxes are
    apart (by at least that much); negative, it is the least translation along any of the 15 that
    separates them. Equal gaps are decided by the axes themselves, so that swapping the boxes only
    reverses the axis. Where the centres agree along the axis, its sign carries no meaning.

    Only axes that may have the largest gap, by a rough calculation with its error bound, are
    computed carefully: one or two of the 15, as a rule. The result is that of all 15.
    """
    p, u = (ca[0], ca[1], ca[2]), (h[0], h[1], h[2])
    q, v = (cb[0], cb[1], cb[2]), (f[0], f[1], f[2])
    return _witness(p, columns(a), u, q, columns(b), v, most)[0]


@njit
def _witness(
    ca: Vector, a: Axes, h: Vector, cb: Vector, b: Axes, f: Vector, most: Floats
) -> tuple[Witness, Pair]:
    """Return the witness, and the boxes in the frame of a."""
    d = minus(cb, ca)
    size = (abs(d[0]) + abs(d[1]) + abs(d[2])) + (h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2])
    pair = Pair(along(a, d), (along(a, b[0]), along(a, b[1]), along(a, b[2])), h, f)
    least = bound_gaps(pair, size, most)
    best = -np.inf
    n = 0.0, 0.0, 0.0
    number = -1
    for axis in range(AXES):
        if not most[axis] >= least:
            continue
        gap, m = careful_gap(ca, a, h, cb, b, f, axis)
        if gap > best or (gap == best and _before(m, n)):
            best, n, number = gap, m, axis
    return (best, n[0], n[1], n[2], number), pair


@njit
def along(axes: Axes, v: Vector) -> Vector:
    """Return the components of a vector along the axes."""
    return dot(axes[0], v), dot(axes[1], v), dot(axes[2], v)


@njit
def _before(u: Vector, v: Vector) -> bool:
    """Order axes by magnitudes, then by relative signs: the same for both axes reversed."""
    for k in range(3):
        if abs(u[k]) != abs(v[k]):
            return abs(u[k]) > abs(v[k])
    if u[0] * u[1] != v[0] * v[1]:
        return u[0] * u[1] > v[0] * v[1]
    if u[1] * u[2] != v[1] * v[2]:
        return u[1] * u[2] > v[1] * v[2]
    return u[0] * u[2] > v[0] * v[2]


@njit
def witness_kernel(
    centers: Floats,
    rotations: Floats,
    half_extents: Floats,
    pairs: np.ndarray,
    gaps: Floats,
    axes: Floats,
    points: Floats,
) -> None:
    """Write gap (m,), axis (m, 3) and a point (m, 3) of the contact of each pair (m, 2)."""
    most = np.empty(AXES)
    for n in range(len(pairs)):
        i, j = pairs[n, 0], pairs[n, 1]
        ca, a, h = vector(centers, i), _axes(rotations, i), vector(half_extents, i)
        cb, b, f = vector(centers, j), _axes(rotations, j), vector(half_extents, j)
        (gaps[n], axes[n, 0], axes[n, 1], axes[n, 2], _), pair = _witness(ca, a, h, cb, b, f, most)
        s = _common(pair)
        x, y, z = a
        for k in range(3):
            points[n, k] = ca[k] + (s[0] * x[k] + s[1] * y[k] + s[2] * z[k])


@njit
def _axes(rotations: Floats, i: int) -> Axes:
    """Return the axes of box i."""
    return column(rotations, i, 0), column(rotations, i, 1), column(rotations, i, 2)


#: Rounds of alternating projections: each moves the point into one box, then into the other.
#: A few are enough, but for thin wedges.
PROJECTION_ROUNDS = 32
#: They end when the point moves less than this, relative to the sum of the half extents: what
#: is drawn needs no more.
DRAWN_SETTLED = 1e-4


@njit
def common_point(
    ca: Floats, a: Floats, h: Floats, cb: Floats, b: Floats, f: Floats, out: Floats
) -> None:
    """Write a point (3,) near both boxes: inside both, or nearly, where they overlap.

    Alternating projections onto convex sets (von Neumann; Bregman 1965), from between the
    centres, in the frame of a. A place to draw the contact at, not a contact manifold: unlike the
    witness it is not the same to the last bit when the boxes are swapped or relabelled.
    """
    x, y, z = columns(a)
    axes = x, y, z
    d = along(axes, (cb[0] - ca[0], cb[1] - ca[1], cb[2] - ca[2]))
    u, v, w = columns(b)
    r = along(axes, u), along(axes, v), along(axes, w)
    s = _common(Pair(d, r, (h[0], h[1], h[2]), (f[0], f[1], f[2])))
    for k in range(3):
        out[k] = ca[k] + (s[0] * x[k] + s[1] * y[k] + s[2] * z[k])


@njit
def _common(pair: Pair) -> Vector:
    """Return the point of ``common_point`` in the frame of a."""
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    settled = DRAWN_SETTLED * (h[0] + h[1] + h[2] + f[0] + f[1] + f[2])
    s = scaled(d, 0.5)
    for _ in range(PROJECTION_ROUNDS):
        s = clamped(s, h)
        t = along_b(pair, minus(s, d))
        t = minus(t, clamped(t, f))
        s = minus(s, plus(plus(scaled(x, t[0]), scaled(y, t[1])), scaled(z, t[2])))
        if max(abs(t[0]), abs(t[1]), abs(t[2])) <= settled:
            break
    return s


@njit
def clamp_to_box(point: Floats, center: Floats, axes: Floats, extents: Floats) -> float:
    """Move the point to the nearest one of the box; return the largest step along an axis."""
    moved = 0.0
    dx = point[0] - center[0]
    dy = point[1] - center[1]
    dz = point[2] - center[2]
    for i in range(3):
        along = dx * axes[0, i] + dy * axes[1, i] + dz * axes[2, i]
        excess = along - min(max(along, -extents[i]), extents[i])
        if excess == 0.0:
            continue
        moved = max(moved, abs(excess))
        point[0] -= excess * axes[0, i]
        point[1] -= excess * axes[1, i]
        point[2] -= excess * axes[2, i]
    return moved
