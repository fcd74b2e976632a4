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

"""How far a triangle must go along a direction until it no longer touches another.

Seen along the direction both are flat, with a height at each point. The way out is the largest
difference of heights where the two lie over each other, which is at a corner of the one over the
other, or where two edges cross (a linear function over a convex polygon). It is never more than the
way past all corners, which is what is left where triangles are seen edge-on.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import dot
from obb_collision.queries.convex.patch import Frame
from obb_collision.queries.meshes.triangle_signs import Triangle
from obb_collision.typing import Vector

#: Places this little outside of an edge or a face, relative to it, are on it.
OUTSIDE = 1e-12


@njit
def way_out(p: Triangle, q: Triangle, frame: Frame, enough: float) -> float:
    """Return how far q must go along the normal of a frame until it no longer touches p.

    Not too little but for rounding; minus infinity where they do not lie over each other, or where
    it certainly is not more than enough.
    """
    p, q = _seen(p, frame), _seen(q, frame)
    most = max(p[0][2], p[1][2], p[2][2]) - min(q[0][2], q[1][2], q[2][2])
    best = -np.inf
    if not most > enough:
        return best
    for _ in range(3):
        for _ in range(3):
            best = max(best, _edges_apart(p[0], p[1], q[0], q[1]))
            q = q[1], q[2], q[0]
        best = max(best, _height(p, q[0]) - q[0][2], p[0][2] + _height(_turned(q), p[0]))
        q = q[1], q[2], q[0]
        p = p[1], p[2], p[0]
    return min(best, most)


@njit
def _seen(t: Triangle, frame: Frame) -> Triangle:
    """Return the corners along the axes of a frame."""
    return _along(t[0], frame), _along(t[1], frame), _along(t[2], frame)


@njit
def _along(v: Vector, frame: Frame) -> Vector:
    return dot(frame.x, v), dot(frame.y, v), dot(frame.n, v)


@njit
def _turned(t: Triangle) -> Triangle:
    """Return a triangle with its heights reversed: the highest is then minus the lowest."""
    (a, b, c), (d, e, f), (g, h, i) = t
    return (a, b, -c), (d, e, -f), (g, h, -i)


@njit
def _area(a: Vector, b: Vector, c: Vector) -> float:
    """Return twice the area of a flat triangle, positive counterclockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@njit
def _height(t: Triangle, v: Vector) -> float:
    """Return the height of a triangle over a point, minus infinity beside it."""
    a, b, c = t
    area = _area(a, b, c)
    if area == 0.0:
        return -np.inf
    y, z = _area(a, v, c) / area, _area(a, b, v) / area
    if min(y, z, 1.0 - y - z) < -OUTSIDE:
        return -np.inf
    y, z = min(max(y, 0.0), 1.0), min(max(z, 0.0), 1.0)
    x = max(1.0 - y - z, 0.0)
    return x * a[2] + y * b[2] + z * c[2]


@njit
def _edges_apart(a: Vector, b: Vector, c: Vector, d: Vector) -> float:
    """Return how far the edge from a to b is above that from c to d where they cross."""
    ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    turn = ux * vy - uy * vx
    if turn == 0.0:
        return -np.inf
    wx, wy = c[0] - a[0], c[1] - a[1]
    s, t = (wx * vy - wy * vx) / turn, (wx * uy - wy * ux) / turn
    if min(s, t) < -OUTSIDE or max(s, t) > 1.0 + OUTSIDE:
        return -np.inf
    s, t = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)
    return a[2] + s * (b[2] - a[2]) - c[2] - t * (d[2] - c[2])
