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

Ericson, Real-Time Collision Detection, 2005, 5.1.5 and 5.1.6. Plain floating point: who uses it
proves what it finds some other way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import cross, dot, minus, plus, scaled
from obb_collision.typing import Vector


class PointSimplex(NamedTuple):
    """One to four corners, and the point of their hull that is nearest to the origin."""

    size: int  #: how many corners; 4: the origin lies inside, 0: none yet
    a: Vector
    b: Vector
    c: Vector
    nearest: Vector


@njit
def no_simplex() -> PointSimplex:
    """Return a simplex without corners."""
    zero = 0.0, 0.0, 0.0
    return PointSimplex(0, zero, zero, zero, zero)


@njit
def with_corner(simplex: PointSimplex, new: Vector) -> PointSimplex:
    """Return the simplex with another corner, without those that the nearest point needs not."""
    a, b, c = simplex.a, simplex.b, simplex.c
    if simplex.size == 0:
        return _corner(new)
    if simplex.size == 1:
        return _on_segment(a, new)
    if simplex.size == 2:
        return _on_triangle(a, b, new)
    return _in_tetrahedron(a, b, c, new)


@njit
def _corner(a: Vector) -> PointSimplex:
    return PointSimplex(1, a, a, a, a)


@njit
def _on_segment(a: Vector, b: Vector) -> PointSimplex:
    edge = minus(b, a)
    along, back = -dot(edge, a), dot(edge, b)
    if along <= 0.0:
        return _corner(a)
    if back <= 0.0:
        return _corner(b)
    return PointSimplex(2, a, b, b, plus(a, scaled(edge, along / (along + back))))


@njit
def _on_triangle(a: Vector, b: Vector, c: Vector) -> PointSimplex:
    u, v = minus(b, a), minus(c, a)
    d1, d2, d3, d4 = -dot(u, a), -dot(v, a), -dot(u, b), -dot(v, b)
    d5, d6 = -dot(u, c), -dot(v, c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        return _corner(a)
    if d3 >= 0.0 and d4 <= d3:
        return _corner(b)
    if d6 >= 0.0 and d5 <= d6:
        return _corner(c)
    on_ab = vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0
    on_ac = vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0
    if on_ab or on_ac or (va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0):
        return _on_segment(a if on_ab or on_ac else b, b if on_ab else c)
    total = va + vb + vc
    inner = plus(plus(a, scaled(u, vb / total)), scaled(v, vc / total))
    return PointSimplex(3, a, b, c, inner)


@njit
def _in_tetrahedron(a: Vector, b: Vector, c: Vector, d: Vector) -> PointSimplex:
    """Take the nearest of the faces that have the origin on their outer side."""
    best, zero = np.inf, (0.0, 0.0, 0.0)
    part = PointSimplex(4, a, b, c, zero)
    for _ in range(4):
        if outside(b, c, d, a):
            face = _on_triangle(b, c, d)
            square = dot(face.nearest, face.nearest)
            if square < best:
                best, part = square, face
        a, b, c, d = b, c, d, a
    return part


@njit
def outside(a: Vector, b: Vector, c: Vector, other: Vector) -> bool:
    """Return whether the plane of a, b and c has the origin and the other corner on two sides."""
    normal = cross(minus(b, a), minus(c, a))
    return -dot(normal, a) * dot(normal, minus(other, a)) <= 0.0
