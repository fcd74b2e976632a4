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

"""Vectors of three numbers, as tuples: compiled, they live in registers.

Small arrays and loops over them take five to ten times as long: kernels that spend their time on
one pair at a time are written with these. Each sum is taken from the first component to the last,
so that rewriting a kernel with these functions does not move a bit of its results.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.exact import determinant, length
from obb_collision.typing import Axes, Floats, Vector

#: Squares of a length below this may have lost digits.
LEAST_SQUARE = 1e-280
ZERO: Vector = (0.0, 0.0, 0.0)


@njit
def dot(u: Vector, v: Vector) -> float:
    """Return the scalar product."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@njit
def dot_abs(u: Vector, v: Vector) -> float:
    """Return sum_i u_i abs(v_i): for u half extents, half the length of a box along v."""
    return u[0] * abs(v[0]) + u[1] * abs(v[1]) + u[2] * abs(v[2])


@njit
def cross(u: Vector, v: Vector) -> Vector:
    """Return the cross product."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@njit
def careful_cross(u: Vector, v: Vector) -> Vector:
    """Return the cross product without cancellation: see ``exact.determinant``."""
    return (
        determinant(u[1], u[2], v[1], v[2]),
        determinant(u[2], u[0], v[2], v[0]),
        determinant(u[0], u[1], v[0], v[1]),
    )


@njit
def plus(u: Vector, v: Vector) -> Vector:
    """Return u + v."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@njit
def minus(u: Vector, v: Vector) -> Vector:
    """Return u - v."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@njit
def scaled(v: Vector, scale: float) -> Vector:
    """Return v times a number."""
    return v[0] * scale, v[1] * scale, v[2] * scale


@njit
def negated(v: Vector) -> Vector:
    """Return -v."""
    return -v[0], -v[1], -v[2]


@njit
def absolute(v: Vector) -> Vector:
    """Return the magnitudes of the components."""
    return abs(v[0]), abs(v[1]), abs(v[2])


@njit
def norm(v: Vector) -> float:
    """Return the Euclidean length, without under- or overflow on the way."""
    return length(v[0], v[1], v[2])


def lengths(vectors: Floats) -> Floats:
    """Return the Euclidean lengths (n,) of vectors (n, 3)."""
    out = np.empty(len(vectors))
    fill_lengths(np.ascontiguousarray(vectors), out)
    return out


@njit
def fill_lengths(vectors: Floats, out: Floats) -> None:
    """Write the lengths (n,) of vectors (n, 3)."""
    for n in range(len(vectors)):
        out[n] = norm(vector_at(vectors, n))


@njit
def fast_norm(v: Vector) -> float:
    """Return the Euclidean length, without quotients where its square can be trusted.

    Its last digit may differ from that of ``norm``.
    """
    square = dot(v, v)
    return math.sqrt(square) if LEAST_SQUARE < square < math.inf else norm(v)


@njit
def max_abs(v: Vector) -> float:
    """Return the largest magnitude of a component."""
    return max(abs(v[0]), abs(v[1]), abs(v[2]))


@njit
def max_of(v: Vector) -> float:
    """Return the largest component."""
    return max(v[0], v[1], v[2])


@njit
def sum_abs(v: Vector) -> float:
    """Return the sum of the magnitudes of the components."""
    return abs(v[0]) + abs(v[1]) + abs(v[2])


@njit
def clamp(x: float, limit: float) -> float:
    """Return the number from -limit to limit that is closest to x."""
    return min(max(x, -limit), limit)


@njit
def clamped(v: Vector, limits: Vector) -> Vector:
    """Return the point of a centred box closest to v."""
    return clamp(v[0], limits[0]), clamp(v[1], limits[1]), clamp(v[2], limits[2])


@njit
def pick(v: Vector, i: int) -> float:
    """Return component i, an index that is known at run time only."""
    return v[0] if i == 0 else v[1] if i == 1 else v[2]


@njit
def pick_axis(axes: Axes, i: int) -> Vector:
    """Return axis i, an index that is known at run time only."""
    return axes[0] if i == 0 else axes[1] if i == 1 else axes[2]


@njit
def replaced(v: Vector, i: int, x: float) -> Vector:
    """Return v with x for component i."""
    return x if i == 0 else v[0], x if i == 1 else v[1], x if i == 2 else v[2]


@njit
def components(axes: Axes, v: Vector) -> Vector:
    """Return the components of a vector along three axes."""
    return dot(axes[0], v), dot(axes[1], v), dot(axes[2], v)


@njit
def combined(axes: Axes, v: Vector) -> Vector:
    """Return the sum of three axes, each times a component of v."""
    x, y, z = axes
    return plus(plus(scaled(x, v[0]), scaled(y, v[1])), scaled(z, v[2]))


@njit
def write_at(rows: Floats, n: int, v: Vector) -> None:
    """Write row n of an array (m, 3)."""
    rows[n, 0], rows[n, 1], rows[n, 2] = v


@njit
def vector_at(array: Floats, i: int) -> Vector:
    """Return row i of an array (n, 3)."""
    return array[i, 0], array[i, 1], array[i, 2]


@njit
def axis_of(rotations: Floats, i: int, k: int) -> Vector:
    """Return column k of matrix i of (n, 3, 3)."""
    return rotations[i, 0, k], rotations[i, 1, k], rotations[i, 2, k]


@njit
def axes_of(rotations: Floats, i: int) -> Axes:
    """Return the columns of matrix i of (n, 3, 3)."""
    return axis_of(rotations, i, 0), axis_of(rotations, i, 1), axis_of(rotations, i, 2)


@njit
def rows_at(matrices: Floats, i: int) -> Axes:
    """Return the rows of matrix i of (n, 3, 3)."""
    return (
        (matrices[i, 0, 0], matrices[i, 0, 1], matrices[i, 0, 2]),
        (matrices[i, 1, 0], matrices[i, 1, 1], matrices[i, 1, 2]),
        (matrices[i, 2, 0], matrices[i, 2, 1], matrices[i, 2, 2]),
    )


@njit
def vector(array: Floats) -> Vector:
    """Return an array (3,) as a vector."""
    return array[0], array[1], array[2]


@njit
def columns(matrix: Floats) -> Axes:
    """Return the columns of a matrix (3, 3)."""
    return (
        (matrix[0, 0], matrix[1, 0], matrix[2, 0]),
        (matrix[0, 1], matrix[1, 1], matrix[2, 1]),
        (matrix[0, 2], matrix[1, 2], matrix[2, 2]),
    )
