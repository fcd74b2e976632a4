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

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import cross, dot, minus, vector_at
from obb_collision.typing import Floats


@njit
def nearest_to_origin(corners: Floats, count: int, point: Floats) -> int:
    """Write the nearest point (3,) of a simplex of 1 to 4 corners (4, 3); return how many it needs.

    Those come to stand first. 4 means that the origin lies inside.
    """
    if count == 1:
        point[:] = corners[0]
        return 1
    if count == 2:
        return _on_segment(corners, 0, 1, point)
    if count == 3:
        return _on_triangle(corners, 0, 1, 2, point)
    return _in_tetrahedron(corners, point)


@njit
def _keep(corners: Floats, i: int, j: int, k: int) -> None:
    """Move corners i, j and k, which may repeat, to the front."""
    for n in range(3):
        a, b, c = corners[i, n], corners[j, n], corners[k, n]
        corners[0, n], corners[1, n], corners[2, n] = a, b, c


@njit
def _towards_origin(corners: Floats, i: int, j: int, k: int) -> float:
    """Return the product of the edge from i to j and the vector from k to the origin."""
    edge = minus(vector_at(corners, j), vector_at(corners, i))
    return -dot(edge, vector_at(corners, k))


@njit
def _on_segment(corners: Floats, i: int, j: int, point: Floats) -> int:
    along, back = _towards_origin(corners, i, j, i), -_towards_origin(corners, i, j, j)
    if along <= 0.0 or back <= 0.0:
        k = i if along <= 0.0 else j
        point[:] = corners[k]
        _keep(corners, k, k, k)
        return 1
    share = along / (along + back)
    for n in range(3):
        point[n] = corners[i, n] + share * (corners[j, n] - corners[i, n])
    _keep(corners, i, j, j)
    return 2


@njit
def _on_triangle(corners: Floats, i: int, j: int, k: int, point: Floats) -> int:
    d1, d2 = _towards_origin(corners, i, j, i), _towards_origin(corners, i, k, i)
    d3, d4 = _towards_origin(corners, i, j, j), _towards_origin(corners, i, k, j)
    d5, d6 = _towards_origin(corners, i, j, k), _towards_origin(corners, i, k, k)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        return _on_segment(corners, i, i, point)
    if d3 >= 0.0 and d4 <= d3:
        return _on_segment(corners, j, j, point)
    if d6 >= 0.0 and d5 <= d6:
        return _on_segment(corners, k, k, point)
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return _on_segment(corners, i, j, point)
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return _on_segment(corners, i, k, point)
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        return _on_segment(corners, j, k, point)
    total = va + vb + vc
    for n in range(3):
        u, v = corners[j, n] - corners[i, n], corners[k, n] - corners[i, n]
        point[n] = corners[i, n] + (vb / total) * u + (vc / total) * v
    _keep(corners, i, j, k)
    return 3


@njit
def _in_tetrahedron(corners: Floats, point: Floats) -> int:
    """Take the nearest of the faces that have the origin on their outer side."""
    best, face = np.inf, -1
    saved = corners.copy()
    for n in range(4):
        i, j, k = (n + 1) % 4, (n + 2) % 4, (n + 3) % 4
        if not _outside(corners, i, j, k, n):
            continue
        _on_triangle(corners, i, j, k, point)
        square = point[0] ** 2 + point[1] ** 2 + point[2] ** 2
        corners[:] = saved
        if square < best:
            best, face = square, n
    if face < 0:
        return 4
    return _on_triangle(corners, (face + 1) % 4, (face + 2) % 4, (face + 3) % 4, point)


@njit
def _outside(corners: Floats, i: int, j: int, k: int, other: int) -> bool:
    """Return whether the plane of i, j and k has the origin and the other corner on two sides."""
    corner = vector_at(corners, i)
    u, v = minus(vector_at(corners, j), corner), minus(vector_at(corners, k), corner)
    normal = cross(u, v)
    side = dot(normal, minus(vector_at(corners, other), corner))
    return -dot(normal, corner) * side <= 0.0
