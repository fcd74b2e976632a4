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

"""Depth of the overlap of two convex bodies: the least translation that parts them.

The expanding polytope of van den Bergen 2001: within the difference of both cores a polytope grows
at its face nearest to the origin, until that face is one of the difference. Exact for polytopes;
with curved cores the polytope grows until it is close. What counts is the reach along the face's
normal, which is at least the depth however the search went: a translation by it parts the bodies.

The origin may also lie outside of the polytope, as it does at first and where bodies nearly touch:
then the nearest face is the one farthest on the wrong side.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.simplex import no_simplex
from obb_collision.numerics.vec3 import (
    ZERO,
    cross,
    dot,
    minus,
    negated,
    norm,
    replaced,
    scaled,
    vector_at,
)
from obb_collision.queries.convex.distance import CLOSE, GapSearch, PlaneGap, core_gap, corner_of
from obb_collision.queries.convex.simplex import NO_CORNER, Corner, careful_plane
from obb_collision.queries.convex.support import Core
from obb_collision.queries.meshes.placed import PairPose, moved
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.typing import Floats, Vector

#: Maximum number of corners of the polytope: hulls take 10 to 40, pairs of ellipsoids up to 150.
MOST_CORNERS = 256
MOST_FACES = 2 * MOST_CORNERS
#: A corner beyond a face by at most this is on it; sizes are near one.
ON_FACE = 1e-15
#: A face of which two edges enclose an angle with a sine below this is computed with twice the
#: digits.
NEEDLE_SINE = 1e-4


class DepthRoom(NamedTuple):
    """Work space for the polytope of one pair."""

    w: Floats  #: (MOST_CORNERS, 3)
    p: Floats
    q: Floats
    faces: np.ndarray  #: (MOST_FACES, 3) corners, counterclockwise from outside
    planes: Floats  #: (MOST_FACES, 4) outer unit normals, and distances from the origin
    edges: np.ndarray  #: (3 MOST_FACES, 2) of the hole that a new corner makes


@njit
def room_for_depth() -> DepthRoom:
    """Return work space for one pair after another."""
    return DepthRoom(
        np.empty((MOST_CORNERS, 3)),
        np.empty((MOST_CORNERS, 3)),
        np.empty((MOST_CORNERS, 3)),
        np.empty((MOST_FACES, 3), np.int64),
        np.empty((MOST_FACES, 4)),
        np.empty((3 * MOST_FACES, 2), np.int64),
    )


@njit(refcount=False)
def deepest(a: Core, b: Core, pose: PairPose, apart: GapSearch, room: DepthRoom) -> GapSearch:
    """Return the direction along which two cores overlap least, and points that touch then.

    apart: the search for their distance.
    """
    unit = unit_scale(pose.size)[0]
    close = CLOSE * unit * pose.size
    best, normal, p, q = apart.gap, apart.normal, apart.p, apart.q
    faces = _start(a, b, pose, unit, apart.normal, room)
    corners = 4
    while faces > 0:
        nearest = 0
        for k in range(1, faces):
            if room.planes[k, 3] < room.planes[nearest, 3]:
                nearest = k
        n = vector_at(room.planes, nearest)
        gap = core_gap(a, b, pose, n)
        if gap.value >= best:
            best, normal = gap.value, n
        beyond = -gap.value * unit - room.planes[nearest, 3]
        if beyond <= close or corners == MOST_CORNERS:
            p, q = _touching(room, faces, nearest, close, gap)
            if norm(minus(p, moved(pose, q))) > close / unit - best:  # needles: it has no plane
                p, q = apart.p, apart.q
            break
        _put(room, corners, corner_of(gap, pose, unit))
        faces = _grown(room, faces, corners, pose, unit)
        corners += 1
    if faces == 0:
        best, normal = _flat(a, b, pose, best, normal, room)
    return GapSearch(best, normal, 0.0, p, q, no_simplex(NO_CORNER))


@njit(refcount=False)
def _put(room: DepthRoom, row: int, corner: Corner) -> None:
    for k in range(3):
        room.w[row, k], room.p[row, k], room.q[row, k] = corner.w[k], corner.p[k], corner.q[k]


@njit(refcount=False)
def _corner_at(room: DepthRoom, row: int) -> Corner:
    return Corner(vector_at(room.w, row), vector_at(room.p, row), vector_at(room.q, row))


@njit(refcount=False)
def _swap(room: DepthRoom, i: int, j: int) -> None:
    first, second = _corner_at(room, i), _corner_at(room, j)
    _put(room, i, second)
    _put(room, j, first)


@njit(refcount=False)
def _start(a: Core, b: Core, pose: PairPose, unit: float, normal: Vector, room: DepthRoom) -> int:
    """Write a tetrahedron of foremost corners along some directions; return its faces or 0."""
    n = 0
    for k in range(4):
        axis = normal if k == 3 else replaced(ZERO, k, 1.0)
        for way in (axis, negated(axis)):
            _put(room, n, corner_of(core_gap(a, b, pose, way), pose, unit))
            n += 1
    for k in range(1, 4):
        far = _farthest_from(room, k, n)
        if k == 2 and not _height(room, k, far) > ON_FACE:
            # not yet flat: of a box, opposite directions may all have given the same two corners
            line = _unit(_edge(room, 0, 1))
            first = _across(line)
            for way in (first, cross(line, first)):
                for side in (way, negated(way)):
                    _put(room, n, corner_of(core_gap(a, b, pose, side), pose, unit))
                    n += 1
            far = _farthest_from(room, k, n)
        if k == 3:
            height = _height(room, k, far)
            face = cross(_edge(room, 0, 1), _edge(room, 0, 2))
            for way in (face, negated(face)):
                _put(room, n, corner_of(core_gap(a, b, pose, _unit(way)), pose, unit))
                if _height(room, 3, n) > height:
                    height, far = _height(room, 3, n), n
                n += 1
        if not _height(room, k, far) > ON_FACE:
            return 0
        _swap(room, k, far)
    inward = dot(cross(_edge(room, 0, 1), _edge(room, 0, 2)), _edge(room, 0, 3)) > 0.0
    if inward:
        _swap(room, 1, 2)
    faces = 0
    for i, j, k in ((0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)):
        _put_face(room, faces, i, j, k, pose, unit)
        faces += 1
    return faces


@njit(refcount=False)
def _unit(v: Vector) -> Vector:
    length = norm(v)
    return scaled(v, 1.0 / length) if length > 0.0 else (1.0, 0.0, 0.0)


@njit(refcount=False)
def _across(u: Vector) -> Vector:
    """Return a unit vector orthogonal to a unit vector."""
    return _unit((0.0, -u[2], u[1]) if abs(u[0]) < 0.5 else (-u[1], u[0], 0.0))


@njit(refcount=False)
def _edge(room: DepthRoom, i: int, j: int) -> Vector:
    return minus(vector_at(room.w, j), vector_at(room.w, i))


@njit(refcount=False)
def _farthest_from(room: DepthRoom, k: int, n: int) -> int:
    """Return which of corners k to n - 1 is farthest from the span of the first k."""
    far = k
    for row in range(k + 1, n):
        if _height(room, k, row) > _height(room, k, far):
            far = row
    return far


@njit(refcount=False)
def _height(room: DepthRoom, k: int, row: int) -> float:
    """Return how far a corner is from the span of the first k corners."""
    v = _edge(room, 0, row)
    if k == 1:
        return norm(v)
    u = _unit(_edge(room, 0, 1))
    if k == 2:
        return norm(cross(u, v))
    return abs(dot(_unit(cross(u, _edge(room, 0, 2))), v))


@njit(refcount=False)
def _put_face(
    room: DepthRoom, row: int, i: int, j: int, k: int, pose: PairPose, unit: float
) -> None:
    """Write a face and its plane; a face without a plane is infinitely far."""
    room.faces[row, 0], room.faces[row, 1], room.faces[row, 2] = i, j, k
    u, v = _edge(room, i, j), _edge(room, i, k)
    n = cross(u, v)
    square = dot(n, n)
    far = 0.0
    if square > NEEDLE_SINE * NEEDLE_SINE * dot(u, u) * dot(v, v):
        n = scaled(n, 1.0 / math.sqrt(square))
        far = dot(n, vector_at(room.w, i))
    else:
        corners = _corner_at(room, i), _corner_at(room, j), _corner_at(room, k)
        n, far = careful_plane(corners[0], corners[1], corners[2], pose, unit)
    for x in range(3):
        room.planes[row, x] = n[x]
    room.planes[row, 3] = far


@njit(refcount=False)
def _grown(room: DepthRoom, faces: int, corner: int, pose: PairPose, unit: float) -> int:
    """Replace the faces that a corner is beyond by new ones; return the number of faces.

    -1 if rounding prevents it.
    """
    w, edges, row = vector_at(room.w, corner), 0, 0
    while row < faces:
        if dot(vector_at(room.planes, row), w) - room.planes[row, 3] > ON_FACE:
            for k in range(3):
                edges = _toggled(room, edges, room.faces[row, k], room.faces[row, (k + 1) % 3])
            faces -= 1
            for k in range(3):  # one by one: rows take long to compile
                room.faces[row, k] = room.faces[faces, k]
            for k in range(4):
                room.planes[row, k] = room.planes[faces, k]
        else:
            row += 1
    if edges < 3 or faces + edges > MOST_FACES:
        return -1
    for e in range(edges):
        _put_face(room, faces, room.edges[e, 0], room.edges[e, 1], corner, pose, unit)
        faces += 1
    return faces


@njit(refcount=False)
def _toggled(room: DepthRoom, edges: int, i: int, j: int) -> int:
    """Add an edge to those of the hole; remove it if the face on its other side goes, too."""
    for e in range(edges):
        if room.edges[e, 0] == j and room.edges[e, 1] == i:
            for k in range(2):
                room.edges[e, k] = room.edges[edges - 1, k]
            return edges - 1
    room.edges[edges, 0], room.edges[edges, 1] = i, j
    return edges + 1


@njit(refcount=False)
def _touching(
    room: DepthRoom, faces: int, nearest: int, close: float, gap: PlaneGap
) -> tuple[Vector, Vector]:
    """Return the points of both cores where the polytope is nearest to the origin.

    Of faces in one plane: in the face that contains the foot of the origin.
    """
    best, least, y, z = -1, np.inf, 0.0, 0.0
    for k in range(faces):
        if room.planes[k, 3] <= room.planes[nearest, 3] + close:
            u, v = _foot(room, k)
            outside = max(-u, -v, u + v - 1.0)
            if outside < least:
                best, least, y, z = k, outside, u, v
    if best < 0:
        return gap.p, gap.q
    y = min(max(y, 0.0), 1.0)
    z = min(max(z, 0.0), 1.0 - y)
    i, j, k = room.faces[best, 0], room.faces[best, 1], room.faces[best, 2]
    return _mixed(room.p, i, j, k, y, z), _mixed(room.q, i, j, k, y, z)


@njit(refcount=False)
def _foot(room: DepthRoom, face: int) -> tuple[float, float]:
    """Return the foot of the origin on a face, by its two edges; NaN for a face without a plane."""
    i, j, k = room.faces[face, 0], room.faces[face, 1], room.faces[face, 2]
    u, v, start = _edge(room, i, j), _edge(room, i, k), vector_at(room.w, i)
    n = cross(u, v)
    square = dot(n, n)
    return dot(n, cross(v, start)) / square, dot(n, cross(start, u)) / square


@njit(refcount=False)
def _mixed(points: Floats, i: int, j: int, k: int, y: float, z: float) -> Vector:
    x = 1.0 - y - z
    return (
        x * points[i, 0] + y * points[j, 0] + z * points[k, 0],
        x * points[i, 1] + y * points[j, 1] + z * points[k, 1],
        x * points[i, 2] + y * points[j, 2] + z * points[k, 2],
    )


@njit(refcount=False)
def _flat(
    a: Core, b: Core, pose: PairPose, best: float, normal: Vector, room: DepthRoom
) -> tuple[float, Vector]:
    """Return the best gap of a flat difference: along its normals."""
    u, v = _edge(room, 0, 1), _edge(room, 0, 2)
    first = _unit(cross(u, v))
    if norm(cross(u, v)) <= ON_FACE * norm(u):  # a line, or a point
        first = _across(_unit(u))
    for n in (first, cross(_unit(u), first)):
        for way in (n, negated(n)):
            gap = core_gap(a, b, pose, _unit(way))
            if gap.value > best:
                best, normal = gap.value, _unit(way)
    return best, normal
