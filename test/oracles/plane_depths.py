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

"""How far points lie behind the planes of triangles, with exact normals where doubles fail.

The normal of a sliver in doubles is off by a rounding times its length over its height: for one of
1e-11 it can point anywhere, which of its corners comes first decides.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.typing import Floats

#: Triangles with less height than this times their longest side get an exact normal.
SLIVER = 1e-2


def least_depth(corners: Floats, points: ArrayLike) -> float:
    """Return how far points (n, 3) are behind the planes of triangles (m, 3, 3), at least.

    Outward normals by the right hand; negative where a point sticks out.
    """
    where = np.asarray(points, np.float64)
    power = -int(np.frexp(max(np.abs(corners).max(), np.abs(where).max()))[1])
    triangles, where = np.ldexp(corners, power), np.ldexp(where, power)  # without any rounding
    a, b, c = triangles.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
    normals /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    for row in np.flatnonzero(lengths < SLIVER * sides**2):
        normals[row] = _exact_normal(triangles[row])
    offsets = np.einsum("ij,ij->i", normals, a)
    return float(np.ldexp((offsets - (normals @ where.T).max(axis=1)).min(), -power))


def _exact_normal(triangle: Floats) -> list[float]:
    a, b, c = ([Fraction(float(x)) for x in corner] for corner in triangle)
    u, v = [x - y for x, y in zip(b, a, strict=True)], [x - y for x, y in zip(c, a, strict=True)]
    normal = [u[k - 2] * v[k - 1] - u[k - 1] * v[k - 2] for k in range(3)]
    largest = max(abs(x) for x in normal)
    assert largest > 0, "a triangle without area has no plane"
    parts = [float(x / largest) for x in normal]
    return [part / math.hypot(*parts) for part in parts]
