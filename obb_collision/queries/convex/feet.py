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

"""Feet: the point of a box, a cylinder or a cone that is nearest to a foremost point of another.

Where that point is a corner, the line to its foot is the shortest one, which corners of the
difference come near to only by and by: a face, a side or an end has no foremost points inside.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit_borrowing, njit_reading
from obb_collision.numerics.vec3 import clamp, components, dot, minus
from obb_collision.queries.convex.support import BOX, CONE, CYLINDER, SEGMENT, Core
from obb_collision.queries.meshes.tree_boxes import Pose, moved
from obb_collision.typing import Vector


class Feet(NamedTuple):
    """Two points, and how far they are apart."""

    v: Vector  #: from the one of a to that of b, in the frame of a
    square: float  #: of its length
    p: Vector  #: of a, in its frame
    q: Vector  #: of b, in its own


@njit_borrowing
def no_feet(p: Vector, q: Vector) -> Feet:
    """Return what bodies without feet have."""
    return Feet(p, np.inf, p, q)


@njit_borrowing
def feet(a: Core, b: Core, pose: Pose, p: Vector, q: Vector) -> Feet:
    """Return the nearer of p with its foot on b, and q with its foot on a.

    p, q: of a and b, in their frames; infinitely far apart where neither has feet.
    """
    best = no_feet(p, q)
    if has_feet(b):
        foot = _foot(b.kind, b.size, b.half, components(pose.axes, minus(p, pose.offset)))
        v = minus(moved(pose, foot), p)
        best = Feet(v, dot(v, v), p, foot)
    if has_feet(a):
        far = moved(pose, q)
        foot = _foot(a.kind, a.size, a.half, far)
        v = minus(far, foot)
        square = dot(v, v)
        if square < best.square:
            return Feet(v, square, foot, q)
    return best


@njit_borrowing
def has_feet(core: Core) -> bool:
    """Return whether a core is one of those that feet are known of."""
    return core.kind == BOX or core.kind == CYLINDER or core.kind == CONE or core.kind == SEGMENT


@njit_reading
def _foot(kind: int, size: Vector, half: float, p: Vector) -> Vector:
    """Return the point of a core nearest to p; of ellipses one that is near."""
    x, y, z = size
    if kind == BOX:
        return clamp(p[0], x), clamp(p[1], y), clamp(p[2], z)
    if kind == SEGMENT:
        return 0.0, 0.0, clamp(p[2], half)
    far = math.sqrt(p[0] * p[0] + p[1] * p[1])
    if not far > 0.0:
        return 0.0, 0.0, clamp(p[2], half)
    u, v = p[0] / far, p[1] / far
    rim = x if x == y else x * y / math.sqrt(y * y * u * u + x * x * v * v)
    if kind == CYLINDER or p[2] <= -half:
        r, height = min(far, rim), clamp(p[2], half)
    else:
        along = (rim * (rim - far) + 2.0 * half * (p[2] + half)) / (rim * rim + 4.0 * half * half)
        along = min(max(along, 0.0), 1.0)
        r, height = min(far, rim * (1.0 - along)), min(p[2], half * (2.0 * along - 1.0))
    return u * r, v * r, height


@njit_reading
def across(kind: int, size: Vector, half: float, p: Vector, foot: Vector) -> Vector:
    """Return the other end of the edge, side or face that has p, a foremost point, and its foot."""
    if foot == p:
        return p
    x, y, z = size
    if kind == BOX:
        return (
            -p[0] if abs(foot[0]) < x else p[0],
            -p[1] if abs(foot[1]) < y else p[1],
            -p[2] if abs(foot[2]) < z else p[2],
        )
    if not abs(foot[2]) < half:
        return p
    if kind != CONE:
        return p[0], p[1], -p[2]
    if p[2] < 0.0:
        return 0.0, 0.0, half
    wider = 2.0 * half / (half - foot[2])
    return foot[0] * wider, foot[1] * wider, -half
