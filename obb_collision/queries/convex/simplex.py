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

"""Points of the difference of two bodies, and what of their hull is nearest to the origin.

As ``numerics.simplex`` (Ericson 2005, 5.1.5 and 5.1.6), with the points of both bodies that each
corner comes from. Plain floating point: distances are proved by planes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit, njit_inlined
from obb_collision.numerics.simplex import outside
from obb_collision.numerics.vec3 import cross, dot, minus, plus, scaled
from obb_collision.typing import Vector


class Corner(NamedTuple):
    """A point of the difference, w = p - q."""

    w: Vector  #: in the frame of a
    p: Vector  #: of a, in its frame
    q: Vector  #: of b, in its own


class Simplex(NamedTuple):
    """One to four corners, and weights of those nearest to the origin."""

    size: int  #: how many corners; 4: the origin lies inside, 0: none yet
    a: Corner
    b: Corner
    c: Corner
    d: Corner
    weights: Vector  #: of a, b and c; the others have none
    nearest: Vector


@njit_inlined
def no_simplex() -> Simplex:
    """Return a simplex without corners."""
    zero = 0.0, 0.0, 0.0
    none = Corner(zero, zero, zero)
    return Simplex(0, none, none, none, none, zero, zero)


@njit_inlined
def with_corner(simplex: Simplex, new: Corner) -> Simplex:
    """Return the simplex with another corner, without those that the nearest point needs not."""
    if simplex.size == 0:
        return on_corner(new)
    if simplex.size == 1:
        return on_segment(simplex.a, new)
    if simplex.size == 2:
        return on_triangle(simplex.a, simplex.b, new)
    return _in_tetrahedron(simplex.a, simplex.b, simplex.c, new)


@njit_inlined
def on_corner(a: Corner) -> Simplex:
    """Return the simplex of one corner."""
    return Simplex(1, a, a, a, a, (1.0, 0.0, 0.0), a.w)


@njit_inlined
def on_segment(a: Corner, b: Corner) -> Simplex:
    """Return what two corners need."""
    edge = minus(b.w, a.w)
    along, back = -dot(edge, a.w), dot(edge, b.w)
    if along <= 0.0:
        return on_corner(a)
    if back <= 0.0:
        return on_corner(b)
    t = along / (along + back)
    return Simplex(2, a, b, b, b, (1.0 - t, t, 0.0), plus(a.w, scaled(edge, t)))


@njit
def on_triangle(a: Corner, b: Corner, c: Corner) -> Simplex:
    """Return what three corners need."""
    u, v = minus(b.w, a.w), minus(c.w, a.w)
    d1, d2, d3, d4 = -dot(u, a.w), -dot(v, a.w), -dot(u, b.w), -dot(v, b.w)
    d5, d6 = -dot(u, c.w), -dot(v, c.w)
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
    return Simplex(3, a, b, c, c, (1.0 - y - z, y, z), _above(a.w, u, v, y, z))


@njit_inlined
def _above(a: Vector, u: Vector, v: Vector, y: float, z: float) -> Vector:
    """Return the point of a plane nearest to the origin: along its normal, not by weights.

    Two digits better where the plane is close: the sum of weighted corners cancels.
    """
    normal = cross(u, v)
    square = dot(normal, normal)
    if square > 0.0:
        return scaled(normal, dot(normal, a) / square)
    return plus(plus(a, scaled(u, y)), scaled(v, z))


@njit
def _in_tetrahedron(a: Corner, b: Corner, c: Corner, d: Corner) -> Simplex:
    """Take the nearest of the faces that have the origin on their outer side."""
    best, zero = np.inf, (0.0, 0.0, 0.0)
    part = Simplex(4, a, b, c, d, zero, zero)
    for _ in range(4):
        if outside(b.w, c.w, d.w, a.w):
            face = on_triangle(b, c, d)
            square = dot(face.nearest, face.nearest)
            if square < best:
                best, part = square, face
        a, b, c, d = b, c, d, a
    return part
