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

"""Two boxes in the frame of one, as tuples of numbers: compiled, they live in registers.

Small arrays and loops over them cost five to ten times as much: kernels that spend their time on
one pair at a time are written with these.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from obb_collision._jit import njit
from obb_collision.numerics.error_free import length
from obb_collision.typing import Floats

Vector = tuple[float, float, float]

#: Sizes between these powers of two are taken as they are: their squares are far from the ends.
SCALED_BELOW = 2.0**-300
SCALED_ABOVE = 2.0**300


class Pair(NamedTuple):
    """Boxes a, b in the frame of a. A point of a is s, abs(s) <= h; of b d + r t, abs(t) <= f."""

    d: Vector  #: centre of b
    r: tuple[Vector, Vector, Vector]  #: axes of b
    h: Vector  #: half extents of a
    f: Vector  #: half extents of b


@njit
def dot(u: Vector, v: Vector) -> float:
    """Return the scalar product."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@njit
def dot_abs(u: Vector, v: Vector) -> float:
    """Return sum_i u_i abs(v_i): for u half extents, half the length of a box along v."""
    return u[0] * abs(v[0]) + u[1] * abs(v[1]) + u[2] * abs(v[2])


@njit
def plus(u: Vector, v: Vector) -> Vector:
    """Return u + v."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@njit
def minus(u: Vector, v: Vector) -> Vector:
    """Return u - v."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


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
    """Return component i, not known when compiling."""
    return v[0] if i == 0 else v[1] if i == 1 else v[2]


@njit
def replaced(v: Vector, i: int, x: float) -> Vector:
    """Return v with x for component i."""
    return x if i == 0 else v[0], x if i == 1 else v[1], x if i == 2 else v[2]


@njit
def axis_of_b(pair: Pair, j: int) -> Vector:
    """Return axis j of b, not known when compiling."""
    return pair.r[0] if j == 0 else pair.r[1] if j == 1 else pair.r[2]


@njit
def along_b(pair: Pair, v: Vector) -> Vector:
    """Return the components of a vector along the axes of b."""
    return dot(pair.r[0], v), dot(pair.r[1], v), dot(pair.r[2], v)


@njit
def point_of_b(pair: Pair, t: Vector) -> Vector:
    """Return d + r t."""
    d, (x, y, z) = pair.d, pair.r
    return (
        d[0] + (x[0] * t[0] + y[0] * t[1] + z[0] * t[2]),
        d[1] + (x[1] * t[0] + y[1] * t[1] + z[1] * t[2]),
        d[2] + (x[2] * t[0] + y[2] * t[1] + z[2] * t[2]),
    )


@njit
def closest_on_a(pair: Pair, t: Vector) -> Vector:
    """Return s of the point of a closest to that of b."""
    return clamped(point_of_b(pair, t), pair.h)


@njit
def closest_on_b(pair: Pair, s: Vector) -> Vector:
    """Return t of the point of b closest to that of a."""
    return clamped(along_b(pair, minus(s, pair.d)), pair.f)


@njit
def gap_along(pair: Pair, n: Vector) -> float:
    """Return the gap along a unit vector from a to b: at most the distance."""
    return dot(n, pair.d) - dot_abs(pair.h, n) - dot_abs(pair.f, along_b(pair, n))


@njit
def vector(array: Floats, i: int) -> Vector:
    """Return row i of an array (n, 3)."""
    return array[i, 0], array[i, 1], array[i, 2]


@njit
def column(rotations: Floats, i: int, k: int) -> Vector:
    """Return axis k of box i."""
    return rotations[i, 0, k], rotations[i, 1, k], rotations[i, 2, k]


@njit
def scaled(v: Vector, scale: float) -> Vector:
    """Return v times a number."""
    return v[0] * scale, v[1] * scale, v[2] * scale


@njit
def turned(rotations: Floats, i: int, v: Vector) -> Vector:
    """Return a vector along the axes of a box in the world frame."""
    x, y, z = column(rotations, i, 0), column(rotations, i, 1), column(rotations, i, 2)
    return plus(plus(scaled(x, v[0]), scaled(y, v[1])), scaled(z, v[2]))


@njit
def enter_frame(
    centers: Floats, rotations: Floats, extents: Floats, i: int, j: int
) -> tuple[Pair, float, float]:
    """Return both boxes in the frame of i, scaled; their size in it, and the scale.

    The size is that of ``separation``: offset of the centres and half extents of both, summed.
    """
    d = minus(vector(centers, j), vector(centers, i))
    h, f = vector(extents, i), vector(extents, j)
    size = (abs(d[0]) + abs(d[1]) + abs(d[2])) + (h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2])
    scale = 1.0
    if not SCALED_BELOW < size < SCALED_ABOVE and size != 0.0:
        scale = math.ldexp(1.0, min(max(-math.frexp(size)[1], -1022), 1022))
        d, h, f = scaled(d, scale), scaled(h, scale), scaled(f, scale)
    x, y, z = column(rotations, i, 0), column(rotations, i, 1), column(rotations, i, 2)
    u, v, w = column(rotations, j, 0), column(rotations, j, 1), column(rotations, j, 2)
    d = dot(x, d), dot(y, d), dot(z, d)
    u = dot(x, u), dot(y, u), dot(z, u)
    v = dot(x, v), dot(y, v), dot(z, v)
    w = dot(x, w), dot(y, w), dot(z, w)
    return Pair(d, (u, v, w), h, f), size * scale, scale


@njit
def leave_frame(
    centers: Floats, rotations: Floats, extents: Floats, i: int, j: int,
    s: Vector, t: Vector, n: Vector, scale: float,
) -> tuple[float, Vector, Vector, Vector]:  # fmt: skip
    """Return the distance of the points, the points and the normal in the world frame."""
    s = clamped(scaled(s, 1.0 / scale), vector(extents, i))
    t = clamped(scaled(t, 1.0 / scale), vector(extents, j))
    s, t, n = turned(rotations, i, s), turned(rotations, j, t), turned(rotations, i, n)
    n = scaled(n, 1.0 / math.sqrt(dot(n, n)))
    p, q = vector(centers, i), vector(centers, j)
    v = plus(minus(q, p), minus(t, s))
    return length(v[0], v[1], v[2]), plus(p, s), plus(q, t), n
