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

"""Directions along which two convex bodies have a larger gap: by feet, and by curvature.

A foot is the point of a box, a cylinder or a cone that is nearest to the other body's foremost
point. Where that foremost point is a corner, the line to its foot is the shortest one. A simplex of
foremost points approaches this line only slowly: a face, a side or an end has no foremost points
inside.

For curved bodies there is Newton's step, by their curvature. With the foremost points of both
fixed, the largest gap is along the line that joins them. Foremost points of curved cores move with
the direction, by the second derivatives of their reach.

A direction proves its gap by itself, however it was found.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.simplex import Simplex
from obb_collision.numerics.vec3 import (
    clamp,
    components,
    cross,
    dot,
    fast_norm,
    minus,
    negated,
    plus,
    scaled,
)
from obb_collision.queries.convex.simplex import Corner
from obb_collision.queries.convex.support import (
    BOX_CORE,
    CONE_CORE,
    CYLINDER_CORE,
    HULL_CORE,
    ROUND_CORE,
    SEGMENT_CORE,
    Core,
)
from obb_collision.queries.meshes.placed import PairPose, moved
from obb_collision.typing import Vector


class Feet(NamedTuple):
    """Two points, and how far they are apart."""

    v: Vector  #: from the point of a to that of b, in the frame of a
    square: float  #: of its length
    p: Vector  #: of a, in its frame
    q: Vector  #: of b, in its own


@njit(inline=True, refcount=False)
def no_feet(p: Vector, q: Vector) -> Feet:
    """Return feet infinitely far apart, for cores without any."""
    return Feet(p, np.inf, p, q)


@njit(inline=True, refcount=False)
def feet(a: Core, b: Core, pose: PairPose, p: Vector, q: Vector) -> Feet:
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


@njit(inline=True, refcount=False)
def has_feet(core: Core) -> bool:
    """Return whether the foot of a point on this kind of core has a formula."""
    return core.kind != HULL_CORE and core.kind != ROUND_CORE


@njit(refcount=False)
def _foot(kind: int, size: Vector, half: float, p: Vector) -> Vector:
    """Return the point of a core nearest to p; near an ellipse only roughly."""
    x, y, z = size
    if kind == BOX_CORE:
        return clamp(p[0], x), clamp(p[1], y), clamp(p[2], z)
    if kind == SEGMENT_CORE:
        return 0.0, 0.0, clamp(p[2], half)
    far = math.sqrt(p[0] * p[0] + p[1] * p[1])
    if not far > 0.0:
        return 0.0, 0.0, clamp(p[2], half)
    u, v = p[0] / far, p[1] / far
    rim = x if x == y else x * y / math.sqrt(y * y * u * u + x * x * v * v)
    if kind == CYLINDER_CORE or p[2] <= -half:
        r, height = min(far, rim), clamp(p[2], half)
    else:
        along = (rim * (rim - far) + 2.0 * half * (p[2] + half)) / (rim * rim + 4.0 * half * half)
        along = min(max(along, 0.0), 1.0)
        r, height = min(far, rim * (1.0 - along)), min(p[2], half * (2.0 * along - 1.0))
    return u * r, v * r, height


@njit(refcount=False)
def opposite_end(kind: int, size: Vector, half: float, p: Vector, foot: Vector) -> Vector:
    """Return the far end of the edge, side or face that has the foremost point p and its foot."""
    if foot == p:
        return p
    x, y, z = size
    if kind == BOX_CORE:
        return (
            -p[0] if abs(foot[0]) < x else p[0],
            -p[1] if abs(foot[1]) < y else p[1],
            -p[2] if abs(foot[2]) < z else p[2],
        )
    if not abs(foot[2]) < half:
        return p
    if kind != CONE_CORE:
        return p[0], p[1], -p[2]
    if p[2] < 0.0:
        return 0.0, 0.0, half
    wider = 2.0 * half / (half - foot[2])
    return foot[0] * wider, foot[1] * wider, -half


#: Scale of second derivatives, half axes, and the foremost point about their centre.
Bend = tuple[float, Vector, Vector]


@njit(refcount=False)
def is_curved(core: Core) -> bool:
    """Return whether the foremost points of a core move with the direction."""
    return core.kind == ROUND_CORE or core.kind == CYLINDER_CORE or core.kind == CONE_CORE


@njit(inline=True, refcount=False)
def turned_to(
    a: Core, b: Core, pose: PairPose, n: Vector, unit: float, simplex: Simplex, new: Corner
) -> Simplex:
    """Return the simplex of the features of ``simplex`` and ``new``, with foremost points along n.

    Features are corners, ends of segments, rims, apexes and smooth surfaces; new: foremost along n.
    """
    m = negated(components(pose.axes, n))
    count, s, t, u = 0, new, new, new
    for k in range(min(simplex.size, 3)):
        old = simplex.a if k == 0 else simplex.b if k == 1 else simplex.c
        p, q = _on_feature(a, old.p, n, new.p), _on_feature(b, old.q, m, new.q)
        if p != new.p or q != new.q:
            corner = Corner(scaled(minus(p, moved(pose, q)), unit), p, q)
            if count == 0:
                s = corner
            elif count == 1:
                t = corner
            else:
                u = corner
            count += 1
    return Simplex(count, s, t, u, u, simplex.weights, simplex.nearest)


@njit(inline=True)
def _on_feature(core: Core, old: Vector, n: Vector, new: Vector) -> Vector:
    """Return the foremost point along n of the feature of ``old``; new: that of the core."""
    if core.kind == ROUND_CORE:
        return new
    if core.kind == CYLINDER_CORE or (core.kind == CONE_CORE and old[2] < 0.0):
        if core.kind == CYLINDER_CORE or new[2] < 0.0:
            return new[0], new[1], old[2]
        x, y, _ = core.size
        u, v = x * n[0], y * n[1]
        length = fast_norm((u, v, 0.0))
        if length > 0.0:
            return x * (u / length), y * (v / length), old[2]
    return old


@njit(inline=True, refcount=False)
def steeper(
    a: Core, b: Core, pose: PairPose, n: Vector, simplex: Simplex, unit: float, gap: float
) -> Vector:
    """Return a unit vector along which the gap is probably larger, or n.

    simplex: one or two features, with their foremost points along n; gap: along n, positive.
    Of two features both have the same gap along it, as nearly as their curvatures say.
    """
    first, second, weights = simplex.a, simplex.b, simplex.weights
    u = (0.0, -n[2], n[1]) if abs(n[0]) < 0.5 else (-n[1], n[0], 0.0)
    u = scaled(u, 1.0 / math.sqrt(dot(u, u)))
    v = cross(n, u)
    x, y, z = 1.0, 1.0, 0.0
    bend = _bend(a, first.p, second.p, weights, n, gap)
    if bend[0] > 0.0:
        x, y, z = _bent(x, y, z, bend, u, v)
    m = negated(components(pose.axes, n))
    bend = _bend(b, first.q, second.q, weights, m, gap)
    if bend[0] > 0.0:
        x, y, z = _bent(x, y, z, bend, components(pose.axes, u), components(pose.axes, v))
    near = 1.0 / (unit * gap)
    g, h = -dot(simplex.nearest, u) * near, -dot(simplex.nearest, v) * near
    square = x * y - z * z
    if simplex.size == 2:
        edge = scaled(minus(first.w, second.w), near)
        c, d = dot(edge, u), dot(edge, v)
        # along the edge the step ends where both gaps agree
        push = dot(edge, n) * square + c * (y * g - z * h) + d * (x * h - z * g)
        push /= y * c * c - 2.0 * z * c * d + x * d * d
        g, h = g - push * c, h - push * d
    if not 0.0 < square < np.inf:
        return n
    square = 1.0 / square
    n = plus(n, plus(scaled(u, (y * g - z * h) * square), scaled(v, (x * h - z * g) * square)))
    return scaled(n, 1.0 / math.sqrt(dot(n, n)))


@njit(inline=True)
def _bend(core: Core, p: Vector, q: Vector, weights: Vector, n: Vector, gap: float) -> Bend:
    """Return the bend of the features of p and q, foremost along n, relative to the gap."""
    (x, y, z), e, weight = core.size, p, 1.0
    if core.kind == ROUND_CORE:
        e = p[0], p[1], p[2] - math.copysign(core.half, n[2])
    elif core.kind == CYLINDER_CORE or core.kind == CONE_CORE:
        if core.kind == CONE_CORE:
            weight = (weights[0] if p[2] < 0.0 else 0.0) + (weights[1] if q[2] < 0.0 else 0.0)
            e = p if p[2] < 0.0 else q
        e, z = (e[0], e[1], 0.0), 0.0
    else:
        weight = 0.0
    length = dot(n, e) * gap
    return weight / length if length > 0.0 else 0.0, (x, y, z), e


@njit(inline=True)
def _bent(x: float, y: float, z: float, bend: Bend, u: Vector, v: Vector) -> Vector:
    """Return second derivatives along u, v and both, with those of a bend added."""
    scale, (a, b, c), e = bend
    s, t = (a * u[0], b * u[1], c * u[2]), (a * v[0], b * v[1], c * v[2])
    k, m = dot(e, u), dot(e, v)
    return (
        x + scale * (dot(s, s) - k * k),
        y + scale * (dot(t, t) - m * m),
        z + scale * (dot(s, t) - k * m),
    )
