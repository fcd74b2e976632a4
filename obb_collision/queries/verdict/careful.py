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

"""The gap of two boxes along one axis, nearly exact: cross products without cancellation.

Its error analysis is that of ``separation``. The result doesn't depend on the order of the boxes,
or of their axes: sums are sorted. Boxes come as tuples of numbers (see ``box_frame``).
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import PARALLEL
from obb_collision.numerics.error_free import determinant, length, sum_sorted
from obb_collision.queries.verdict.sat import Vector
from obb_collision.typing import Floats

#: The three axes of a box.
Axes = tuple[Vector, Vector, Vector]


@njit
def careful_gap(
    ca: Vector, a: Axes, h: Vector, cb: Vector, b: Axes, f: Vector, axis: int
) -> tuple[float, Vector]:
    """Return the gap along a unit axis, and the axis, from a towards b.

    axis: 0 to 2 the faces of a, 3 to 5 the faces of b, 6 + 3 i + j edge i of a with edge j of b.
    Face normals are cross products too: stored axes are orthonormal to rounding only.

    Edges shorter than PARALLEL in their product are parallel for all that doubles can tell. Such
    an axis can separate only if another one does up to its bound (the argument of
    ``separation._implied_margin``, with a margin below every bound), so its gap is given
    as minus infinity.
    """
    # which two columns: by selection, as branches would be hard to foretell
    k, m = axis % 3, axis // 3
    u = pick_column(b if m == 1 else a, (k + 1) % 3 if m < 2 else m - 2)
    v = pick_column(a if m == 0 else b, (k + 2) % 3 if m < 2 else k)
    nx, ny, nz = cross(u, v)
    norm = length(nx, ny, nz)
    if norm < PARALLEL:
        return -np.inf, (0.0, 0.0, 0.0)
    nx /= norm
    ny /= norm
    nz /= norm
    along = (nx * (cb[0] - ca[0]) + ny * (cb[1] - ca[1])) + nz * (cb[2] - ca[2])
    gap = abs(along) - (projected_radius(nx, ny, nz, a, h) + projected_radius(nx, ny, nz, b, f))
    if along < 0.0:
        return gap, (-nx, -ny, -nz)
    return gap, (nx, ny, nz)


@njit
def columns(matrix: Floats) -> Axes:
    """Return the columns of a matrix (3, 3) as tuples of numbers."""
    return (
        (matrix[0, 0], matrix[1, 0], matrix[2, 0]),
        (matrix[0, 1], matrix[1, 1], matrix[2, 1]),
        (matrix[0, 2], matrix[1, 2], matrix[2, 2]),
    )


@njit
def pick_column(axes: Axes, i: int) -> Vector:
    """Return column i, not known when compiling."""
    return axes[0] if i == 0 else axes[1] if i == 1 else axes[2]


@njit
def cross(u: Vector, v: Vector) -> Vector:
    """Return u crossed with v, each component nearly exact."""
    return (
        determinant(u[1], u[2], v[1], v[2]),
        determinant(u[2], u[0], v[2], v[0]),
        determinant(u[0], u[1], v[0], v[1]),
    )


@njit
def projected_radius(nx: float, ny: float, nz: float, axes: Axes, extents: Vector) -> float:
    """Return half the length of a box projected on n."""
    u, v, w = axes
    return sum_sorted(
        extents[0] * abs((nx * u[0] + ny * u[1]) + nz * u[2]),
        extents[1] * abs((nx * v[0] + ny * v[1]) + nz * v[2]),
        extents[2] * abs((nx * w[0] + ny * w[1]) + nz * w[2]),
    )
