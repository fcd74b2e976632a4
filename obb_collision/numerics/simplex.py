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

"""The point of a simplex that is nearest to the origin, and the corners it needs.

Ericson, Real-Time Collision Detection, 2005, 5.1.5 and 5.1.6. In plain floating point: callers
prove the result by other means.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import cross, dot, minus, plus, scaled
from obb_collision.typing import Vector

#: A tuple: a point first, then data of the caller.
AnyCorner = Any
BARE_CORNER = ((0.0, 0.0, 0.0),)


class Simplex(NamedTuple):
    """One to four corners, and the weights of the point nearest to the origin."""

    size: int  #: how many corners; 4: the origin lies inside, 0: none yet
    a: AnyCorner
    b: AnyCorner
    c: AnyCorner
    d: AnyCorner
    weights: Vector  #: of a, b and c; that of d is zero
    nearest: Vector


@njit(inline=True)
def no_simplex(filler: AnyCorner) -> Simplex:
    """Return a simplex without corners; filler: any corner, for its type."""
    zero = 0.0, 0.0, 0.0
    return Simplex(0, filler, filler, filler, filler, zero, zero)


@njit(inline=True)
def with_corner(simplex: Simplex, new: AnyCorner) -> Simplex:
    """Add a corner, and drop those that the point nearest to the origin does not need."""
    if simplex.size == 0:
        return on_corner(new)
    if simplex.size == 1:
        return on_segment(simplex.a, new)
    if simplex.size == 2:
        return on_triangle(simplex.a, simplex.b, new)
    return _in_tetrahedron(simplex.a, simplex.b, simplex.c, new)


@njit(inline=True)
def on_corner(a: AnyCorner) -> Simplex:
    """Return the simplex of one corner."""
    return Simplex(1, a, a, a, a, (1.0, 0.0, 0.0), a[0])


@njit(inline=True)
def on_segment(a: AnyCorner, b: AnyCorner) -> Simplex:
    """Return the part of a segment nearest to the origin."""
    edge = minus(b[0], a[0])
    along, back = -dot(edge, a[0]), dot(edge, b[0])
    if along <= 0.0:
        return on_corner(a)
    if back <= 0.0:
        return on_corner(b)
    t = along / (along + back)
    return Simplex(2, a, b, b, b, (1.0 - t, t, 0.0), plus(a[0], scaled(edge, t)))


@njit
def on_triangle(a: AnyCorner, b: AnyCorner, c: AnyCorner) -> Simplex:
    """Return the part of a triangle nearest to the origin."""
    u, v = minus(b[0], a[0]), minus(c[0], a[0])
    d1, d2, d3, d4 = -dot(u, a[0]), -dot(v, a[0]), -dot(u, b[0]), -dot(v, b[0])
    d5, d6 = -dot(u, c[0]), -dot(v, c[0])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        return on_corner(a)
    if d3 >= 0.0 and d4 <= d3:
        return on_corner(b)
    if d6 >= 0.0 and d5 <= d6:
        return on_corner(c)
    on_ab = vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0
    on_ac = vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0
    if on_ab or on_ac or (va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0):
        return on_segment(a if on_ab or on_ac else b, b if on_ab else c)
    total = va + vb + vc
    y, z = vb / total, vc / total
    return Simplex(3, a, b, c, c, (1.0 - y - z, y, z), _above(a[0], u, v, y, z))


@njit(inline=True)
def _above(a: Vector, u: Vector, v: Vector, y: float, z: float) -> Vector:
    """Return the point of a plane nearest to the origin, along its normal instead of by weights.

    Two digits better where the plane is close: the sum of weighted corners cancels.
    """
    normal = cross(u, v)
    square = dot(normal, normal)
    if square > 0.0:
        return scaled(normal, dot(normal, a) / square)
    return plus(plus(a, scaled(u, y)), scaled(v, z))


@njit
def _in_tetrahedron(a: AnyCorner, b: AnyCorner, c: AnyCorner, d: AnyCorner) -> Simplex:
    """Return the nearest of the faces that have the origin on their outer side."""
    best, zero = np.inf, (0.0, 0.0, 0.0)
    part = Simplex(4, a, b, c, d, zero, zero)
    for _ in range(4):
        if outside(b[0], c[0], d[0], a[0]):
            face = on_triangle(b, c, d)
            square = dot(face.nearest, face.nearest)
            if square < best:
                best, part = square, face
        a, b, c, d = b, c, d, a
    return part


@njit
def outside(a: Vector, b: Vector, c: Vector, other: Vector) -> bool:
    """Return whether the plane of a, b and c is between the origin and the other corner."""
    normal = cross(minus(b, a), minus(c, a))
    return -dot(normal, a) * dot(normal, minus(other, a)) <= 0.0
