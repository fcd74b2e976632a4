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

"""Is a point inside a box? Closed boxes: the surface belongs to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.numerics.constants import CAREFUL_BOUND, ROUNDOFF, UNDERFLOW
from obb_collision.numerics.error_free import length
from obb_collision.numerics.exact import contains_exactly
from obb_collision.queries.primitives.segments import Vector, cross, dot
from obb_collision.typing import Floats

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

    Points that doubles can't tell from the surface count as inside (within 4e-15 of their
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
    size = extents[0] + extents[1] + extents[2]
    for n in range(len(points)):
        dx = points[n, 0] - center[0]
        dy = points[n, 1] - center[1]
        dz = points[n, 2] - center[2]
        excess = max(
            abs(axes[0, 0] * dx + axes[1, 0] * dy + axes[2, 0] * dz) - extents[0],
            abs(axes[0, 1] * dx + axes[1, 1] * dy + axes[2, 1] * dz) - extents[1],
            abs(axes[0, 2] * dx + axes[1, 2] * dy + axes[2, 2] * dz) - extents[2],
        )
        bound = INSIDE_BOUND * (abs(dx) + abs(dy) + abs(dz) + size) + UNDERFLOW
        if excess > bound:
            out[n] = OUTSIDE
        elif excess < -bound:
            out[n] = INSIDE
        else:
            out[n] = place_carefully(
                (dx, dy, dz),
                (axes[0, 0], axes[1, 0], axes[2, 0]),
                (axes[0, 1], axes[1, 1], axes[2, 1]),
                (axes[0, 2], axes[1, 2], axes[2, 2]),
                (extents[0], extents[1], extents[2]),
            )


@njit
def place_carefully(offset: Vector, x: Vector, y: Vector, z: Vector, extents: Vector) -> int:
    """Return the place of an offset from the centre, by the face normals taken without error.

    x, y, z: the axes. Same bound as ``separation.careful_axis``, whose error analysis covers a
    point as a box. Tuples: slices of arrays, even in a branch hardly taken, slow loops down.
    """
    place = INSIDE
    normals = (cross(y, z), cross(z, x), cross(x, y))
    axes = (x, y, z)
    distance = length(offset[0], offset[1], offset[2])
    for i in range(3):
        n = normals[i]
        along = abs(dot(n, offset))
        reach = abs(dot(n, axes[i])) * extents[i]
        bound = CAREFUL_BOUND * (distance + extents[i]) * length(n[0], n[1], n[2]) + UNDERFLOW
        if along - reach > bound:
            return OUTSIDE
        if along - reach >= -bound:
            place = DOUBTFUL
    return place
