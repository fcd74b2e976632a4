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
from obb_collision.numerics.vec3 import clamped, combined, max_abs, minus, scaled
from obb_collision.queries.verdict.careful import careful_gap
from obb_collision.queries.verdict.gap_bounds import possible_axes
from obb_collision.queries.verdict.pair_frame import Box, Pair, along_b, pair_of
from obb_collision.queries.verdict.sat import AXES
from obb_collision.typing import Axes, Vector

#: Signed gap, unit axis, number of the axis.
Witness = tuple[float, Vector, int]


@njit
def box_witness(a: Box, b: Box) -> tuple[Witness, Pair]:
    """Return signed gap, unit axis from a towards b, its number; and the boxes in the frame of a.

    The largest of the 15 gaps along normalised axes: positive, it proves that the boxes are
    apart (by at least that much); negative, it is the least translation along any of the 15 that
    separates them. Equal gaps are decided by the axes themselves, so that swapping the boxes only
    reverses the axis. Where the centres agree along the axis, its sign carries no meaning.

    Only axes that may have the largest gap, by a rough calculation with its error bound, are
    computed carefully: typically one or two of the 15.
    """
    pair, size = pair_of(a, b)
    return largest_gap(a, b, int(possible_axes(pair, size))), pair


@njit
def largest_gap(a: Box, b: Box, axes: int) -> Witness:
    """Return the witness, which is on one of some axes: a bit for each.

    If all stored axes of both boxes are equal, only three of the 15 differ, the first ones: all
    products are theirs but for signs, to the last bit.
    """
    best = -np.inf
    n = 0.0, 0.0, 0.0
    number = -1
    different = 3 if _are_equal(a.axes, b.axes) else AXES
    for axis in range(different):
        if not (axes >> axis) & 1:
            continue
        gap, m = careful_gap(a, b, axis)
        if gap > best or (gap == best and _before(m, n)):
            best, n, number = gap, m, axis
    return best, n, number


@njit
def _are_equal(a: Axes, b: Axes) -> bool:
    equal = True
    for k in range(3):
        equal &= (a[k][0] == b[k][0]) & (a[k][1] == b[k][1]) & (a[k][2] == b[k][2])
    return equal


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


#: Rounds of alternating projections: each moves the point into one box, then into the other.
#: A few are enough, but for thin wedges.
PROJECTION_ROUNDS = 32
#: They end when the point moves less than this, relative to the sum of the half extents: what
#: is drawn needs no more.
DRAWN_SETTLED = 1e-4


@njit
def common_point(pair: Pair) -> Vector:
    """Return a point near both boxes: inside both, or nearly, where they overlap.

    Alternating projections onto convex sets (von Neumann; Bregman 1965), from between the
    centres, in the frame of a. A place to draw the contact at, not a contact manifold: unlike the
    witness it is not the same to the last bit when the boxes are swapped or relabelled.
    """
    d, h, f = pair.d, pair.h, pair.f
    settled = DRAWN_SETTLED * (h[0] + h[1] + h[2] + f[0] + f[1] + f[2])
    s = scaled(d, 0.5)
    for _ in range(PROJECTION_ROUNDS):
        s = clamped(s, h)
        t = along_b(pair, minus(s, d))
        t = minus(t, clamped(t, f))
        s = minus(s, combined(pair.r, t))
        if max_abs(t) <= settled:
            break
    return s
