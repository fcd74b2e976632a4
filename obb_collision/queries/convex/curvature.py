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


"""Which direction shows a larger gap of two curved bodies: Newton's step, by their curvature.

With the foremost points of both fixed, the largest gap is along the line that joins them. Those of
curved cores move with the direction, by the second derivatives of their reach. What a direction
shows is proved by it alone, however it was found.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit, njit_reading
from obb_collision.numerics.vec3 import components, cross, dot, negated, norm, plus, scaled
from obb_collision.queries.convex.support import CONE, CYLINDER, ROUND, Core
from obb_collision.queries.meshes.tree_boxes import Pose
from obb_collision.typing import Vector

Bend = tuple[Vector, Vector, float]
"""Half axes, the foremost point and the length that divides: second derivatives of a reach."""


@njit_reading
def is_curved(core: Core) -> bool:
    """Return whether a core has foremost points that move with the direction."""
    return core.kind == ROUND or core.kind == CYLINDER or core.kind == CONE


@njit_reading
def steeper(a: Core, b: Core, pose: Pose, n: Vector, w: Vector, unit: float, gap: float) -> Vector:
    """Return a unit vector along which the gap is probably larger, or n.

    w: from the foremost point of a along n to that of b, times unit; gap: along n, clearly
    positive.
    """
    first, second = _bend(a, n), _bend(b, negated(components(pose.axes, n)))
    u = (0.0, -n[2], n[1]) if abs(n[0]) < 0.5 else (-n[1], n[0], 0.0)
    u = scaled(u, 1.0 / norm(u))
    v = cross(n, u)
    s, t = components(pose.axes, u), components(pose.axes, v)
    x = _along(first, u, u) + _along(second, s, s) + gap
    y = _along(first, v, v) + _along(second, t, t) + gap
    z = _along(first, u, v) + _along(second, s, t)
    x, y, z, far = x / gap, y / gap, z / gap, unit * gap
    g, h = dot(w, u) / far, dot(w, v) / far
    square = x * y - z * z
    if not 0.0 < square < np.inf:
        return n
    step = plus(scaled(u, (y * g - z * h) / square), scaled(v, (x * h - z * g) / square))
    n = plus(n, step)
    return scaled(n, 1.0 / math.sqrt(dot(n, n)))


@njit_reading
def _bend(core: Core, n: Vector) -> Bend:
    (x, y, z), zero = core.size, (0.0, 0.0, 0.0)
    if not is_curved(core):
        return zero, zero, 1.0
    if core.kind != ROUND:
        z = 0.0
    u = x * n[0], y * n[1], z * n[2]
    length = norm(u)
    apex = core.kind == CONE and length - core.half * n[2] < core.half * n[2]
    if apex or not length > 0.0:
        return zero, zero, 1.0
    return (x, y, z), (x * (u[0] / length), y * (u[1] / length), z * (u[2] / length)), length


@njit
def _along(bend: Bend, u: Vector, v: Vector) -> float:
    """Return the second derivative along u and v."""
    (x, y, z), foremost, length = bend
    whole = dot((x * u[0], y * u[1], z * u[2]), (x * v[0], y * v[1], z * v[2]))
    return (whole - dot(foremost, u) * dot(foremost, v)) / length
