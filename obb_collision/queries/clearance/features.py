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

"""Candidates for the closest points of two boxes: face, edge and vertex of either.

Every function returns a point of each box, s and t of ``Pair``, with the vector between them:
what rounding does to a choice can make points less close, never wrong.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import clamp, dot, minus, pick, pick_axis, replaced
from obb_collision.queries.verdict.pair_frame import (
    Pair,
    along_b,
    closest_on_a,
    closest_on_b,
    point_of_b,
)
from obb_collision.typing import Vector

#: An extent counts as level with a face if it rises by no more than this on its way: 32 unit
#: roundoffs. Either of its ends is then as close, up to a quarter of ``closest_points.PROVEN``.
LEVEL = 32 * ROUNDOFF


class Points(NamedTuple):
    """A point of each box, and the square of their distance."""

    s: Vector
    t: Vector
    square: float


@njit
def points_at(pair: Pair, s: Vector, t: Vector) -> Points:
    """Return points with their squared distance."""
    v = minus(point_of_b(pair, t), s)
    return Points(s, t, dot(v, v))


@njit
def foremost(n: Vector, extents: Vector, level: Vector) -> Vector:
    """Return the corner of a centred box farthest along n; ``level`` where an extent is level."""
    return (
        math.copysign(extents[0], n[0]) if abs(n[0]) > LEVEL else level[0],
        math.copysign(extents[1], n[1]) if abs(n[1]) > LEVEL else level[1],
        math.copysign(extents[2], n[2]) if abs(n[2]) > LEVEL else level[2],
    )


@njit
def face_points(pair: Pair, n: Vector, of_a: bool) -> Points:
    """Face with normal n, from a to b, against the foremost vertex of the other box.

    Where an extent is level with the face, anywhere along it: about where the boxes face.
    """
    if of_a:
        t = closest_on_b(pair, closest_on_a(pair, (0.0, 0.0, 0.0)))
        t = foremost(along_b(pair, (-n[0], -n[1], -n[2])), pair.f, t)
        return points_at(pair, closest_on_a(pair, t), t)
    s = closest_on_a(pair, closest_on_b(pair, (0.0, 0.0, 0.0)))
    s = foremost(n, pair.h, s)
    return points_at(pair, s, closest_on_b(pair, s))


@njit
def edge_points(pair: Pair, i: int, j: int, n: Vector) -> Points:
    """Those edges i of a and j of b that are foremost along n, the unit vector normal to both."""
    m = along_b(pair, n)
    h, f = pair.h, pair.f
    s = math.copysign(h[0], n[0]), math.copysign(h[1], n[1]), math.copysign(h[2], n[2])
    t = math.copysign(f[0], -m[0]), math.copysign(f[1], -m[1]), math.copysign(f[2], -m[2])
    return _cross_edges(pair, i, j, s, t)


@njit
def _cross_edges(pair: Pair, i: int, j: int, s: Vector, t: Vector) -> Points:
    """Edge i of a through s and edge j of b through t, where the lines are closest.

    Seen along edge i (only the components of u across it count) t[j] is a projection on a line:
    no determinant near zero however parallel the edges. Where the lines are closest beyond an end,
    a vertex is closer (``vertex_points``).
    """
    s, t = replaced(s, i, 0.0), replaced(t, j, 0.0)
    u = pick_axis(pair.r, j)
    across = replaced(u, i, 0.0)
    v = minus(point_of_b(pair, t), s)
    square = dot(across, across)
    y = clamp(-dot(v, across) / square, pick(pair.f, j)) if square > 0.0 else 0.0
    x = clamp(pick(v, i) + y * pick(u, i), pick(pair.h, i))
    return points_at(pair, replaced(s, i, x), replaced(t, j, y))


@njit
def vertex_points(pair: Pair, best: Points) -> Points:
    """Each vertex against the other box; ``best`` where none is closer."""
    of_a, vertex, least = False, -1, best.square
    for code in range(8):
        square = _excess(point_of_b(pair, _corner(pair.f, code)), pair.h)
        if square < least:
            least, vertex = square, code
    for code in range(8):
        square = _excess(along_b(pair, minus(_corner(pair.h, code), pair.d)), pair.f)
        if square < least:
            least, vertex, of_a = square, code, True
    if vertex < 0:
        return best
    if of_a:
        s = _corner(pair.h, vertex)
        return points_at(pair, s, closest_on_b(pair, s))
    t = _corner(pair.f, vertex)
    return points_at(pair, closest_on_a(pair, t), t)


@njit
def _excess(v: Vector, extents: Vector) -> float:
    """Return the squared distance of v from a centred box."""
    x = max(abs(v[0]) - extents[0], 0.0)
    y = max(abs(v[1]) - extents[1], 0.0)
    z = max(abs(v[2]) - extents[2], 0.0)
    return x * x + y * y + z * z


@njit
def all_edge_points(pair: Pair, best: Points) -> Points:
    """Each of the 144 pairs of edges; ``best`` where none is closer."""
    for i in range(3):
        for j in range(3):
            for code in range(64):
                # Bits 0 to 2 a corner of a, 3 to 5 one of b: one corner is enough for an edge.
                if code >> i & 1 or code >> (3 + j) & 1:
                    continue
                s, t = _corner(pair.h, code), _corner(pair.f, code >> 3)
                points = _cross_edges(pair, i, j, s, t)
                if points.square < best.square:
                    best = points
    return best


@njit
def _corner(extents: Vector, code: int) -> Vector:
    """Return one of the eight corners: bit k of the code set means the positive end."""
    return (
        extents[0] if code & 1 else -extents[0],
        extents[1] if code & 2 else -extents[1],
        extents[2] if code & 4 else -extents[2],
    )
