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

"""Points inside of one box. Closed boxes: the surface belongs to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.numerics.constants import CAREFUL_BOUND, ROUNDOFF, UNDERFLOW
from obb_collision.numerics.exact import contains_exactly
from obb_collision.numerics.vec3 import (
    absolute,
    careful_cross,
    components,
    dot,
    max_of,
    minus,
    norm,
    sum_abs,
    vector_at,
)
from obb_collision.queries.verdict.sat import box_of
from obb_collision.typing import Axes, Floats, Vector

OUTSIDE = 0
DOUBTFUL = 1
INSIDE = 2

#: Bound of the fast stage, relative to abs(p - c) + sum h: rounding gives 6 units of 2^-53, and
#: taking a_i for the face normal, with axes orthonormal to 64 units, 2 x 96 more.
INSIDE_BOUND = 256 * ROUNDOFF


def contains(
    center: Floats, rotation: Floats, half_extents: Floats, points: Floats, exact: bool = False
) -> NDArray[np.bool_]:
    """Return (n,) whether each point (n, 3) lies in the closed box.

    Points that doubles can't distinguish from the surface count as inside (within 4e-15 of their
    distance from the centre and the half extent); with ``exact=True`` they are decided by integer
    arithmetic.
    """
    places = np.empty(len(points), np.int8)
    containment_kernel(center, rotation, half_extents, points, places)
    inside: NDArray[np.bool_] = places != OUTSIDE
    if exact:
        doubtful = np.flatnonzero(places == DOUBTFUL)
        inside[doubtful] = contains_exactly(center, rotation, half_extents, points[doubtful])
    return inside


@njit
def containment_kernel(
    center: Floats, axes: Floats, extents: Floats, points: Floats, out: np.ndarray
) -> None:
    """Write INSIDE, OUTSIDE or DOUBTFUL for each point."""
    box = box_of(center, axes, extents)
    for n in range(len(points)):
        out[n] = place_of(minus(vector_at(points, n), box.center), box.axes, box.half_extents)


@njit
def place_of(offset: Vector, axes: Axes, extents: Vector) -> int:
    """Return INSIDE, OUTSIDE or DOUBTFUL for an offset from the centre of a box."""
    excess = max_of(minus(absolute(components(axes, offset)), extents))
    size = extents[0] + extents[1] + extents[2]
    bound = INSIDE_BOUND * (sum_abs(offset) + size) + UNDERFLOW
    if excess > bound:
        return OUTSIDE
    if excess < -bound:
        return INSIDE
    return place_carefully(offset, axes, extents)


@njit
def place_carefully(offset: Vector, axes: Axes, extents: Vector) -> int:
    """Return the place of an offset from the centre, by the face normals taken without error.

    Same bound as ``witness.careful_gap``, whose error analysis covers a
    point as a box. Tuples: slices of arrays, even in a branch hardly taken, slow loops down.
    """
    place = INSIDE
    x, y, z = axes
    normals = (careful_cross(y, z), careful_cross(z, x), careful_cross(x, y))
    distance = norm(offset)
    for i in range(3):
        n = normals[i]
        along = abs(dot(n, offset))
        reach = abs(dot(n, axes[i])) * extents[i]
        bound = CAREFUL_BOUND * (distance + extents[i]) * norm(n) + UNDERFLOW
        if along - reach > bound:
            return OUTSIDE
        if along - reach >= -bound:
            place = DOUBTFUL
    return place
