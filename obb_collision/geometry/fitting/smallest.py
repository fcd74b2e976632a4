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

"""The smallest boxes about a convex hull: found on its faces, or by turning given ones.

With one axis given, the smallest box has a side on an edge of the outline that the hull shows along
that axis (Freeman and Shapira 1975). The outline is the edges between a face that looks along the
axis and one that does not, so no hull in the plane is made.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import DEPENDENT
from obb_collision.numerics.vec3 import columns, cross, dot, minus, pick_axis, scaled, vector_at
from obb_collision.typing import Axes, Floats, Vector

#: Refining ends when it saves less than this fraction of the volume.
WORTHWHILE = 1e-9
#: Rounds of refining; on all meshes tried it converged in 3 to 6.
MAX_ROUNDS = 20


class HullFaces(NamedTuple):
    """The hull of points (n, 3), for kernels."""

    points: Floats
    vertices: np.ndarray  #: (v,) rows of the corners
    simplices: np.ndarray  #: (f, 3) rows of the corners of each triangle
    neighbors: np.ndarray  #: (f, 3) the triangle opposite each corner


class Surface(NamedTuple):
    """What a search needs of a hull: normals (f, 3), edges (e, 4) of corners and triangles."""

    hull: HullFaces
    normals: Floats
    edges: np.ndarray
    sides: np.ndarray  #: (f,) scratch: whether a triangle looks along an axis
    outline: Floats  #: (2 e, 3) scratch: the ends of the edges of an outline
    floor: float  #: extents below it count as that much


@njit
def face_frames(hull: HullFaces, floor: float) -> tuple[Floats, Floats]:
    """Return (f, 3, 3) axes of the smallest box with a side on each triangle, and volumes (f,).

    Columns are the axes, right-handed, orthonormal to some roundoffs. The volumes of triangles
    without area are infinite.
    """
    surface = _surface(hull, floor)
    count = len(surface.normals)
    frames, volumes = np.empty((count, 3, 3)), np.empty(count)
    for f in range(count):
        w = vector_at(surface.normals, f)
        area, u = _rectangle(surface, w)
        volumes[f] = area * _height(surface, w) if dot(w, w) > 0.0 else np.inf
        _store(frames, f, (u, cross(w, u), w))
    return frames, volumes


@njit
def refined_frames(hull: HullFaces, starts: Floats, floor: float) -> Floats:
    """Return (k, 3, 3) each start turned about its own axes while that makes the box smaller."""
    surface = _surface(hull, floor)
    frames = np.empty(starts.shape)
    for k in range(len(frames)):
        _store(frames, k, _refined(surface, columns(starts[k])))
    return frames


@njit
def _store(frames: Floats, k: int, axes: Axes) -> None:
    for n in range(3):
        frames[k, n, 0], frames[k, n, 1], frames[k, n, 2] = axes[0][n], axes[1][n], axes[2][n]


@njit
def _surface(hull: HullFaces, floor: float) -> Surface:
    points, simplices, neighbors = hull.points, hull.simplices, hull.neighbors
    count = len(simplices)
    inner = (0.0, 0.0, 0.0)
    for row in hull.vertices:
        p = scaled(vector_at(points, row), 1.0 / len(hull.vertices))
        inner = (inner[0] + p[0], inner[1] + p[1], inner[2] + p[2])
    normals, edges = np.empty((count, 3)), np.empty((3 * count, 4), np.int64)
    used = 0
    for f in range(count):
        a = vector_at(points, simplices[f, 0])
        b, c = vector_at(points, simplices[f, 1]), vector_at(points, simplices[f, 2])
        n = cross(minus(b, a), minus(c, a))
        size = np.sqrt(dot(n, n))
        sign = -1.0 if dot(n, minus(a, inner)) < 0.0 else 1.0
        n = scaled(n, sign / size if size > 0.0 else 0.0)  # slivers have none
        normals[f, 0], normals[f, 1], normals[f, 2] = n
        for k in range(3):
            if neighbors[f, k] > f:
                edges[used, 0], edges[used, 1] = simplices[f, k - 1], simplices[f, k - 2]
                edges[used, 2], edges[used, 3] = f, neighbors[f, k]
                used += 1
    sides, outline = np.empty(count, np.bool_), np.empty((2 * used, 3))
    return Surface(hull, normals, edges[:used], sides, outline, floor)


@njit
def _refined(surface: Surface, axes: Axes) -> Axes:
    """Return axes turned about themselves while that makes the box smaller."""
    x, y, z = axes
    volume = _height(surface, x) * _height(surface, y) * _height(surface, z)
    done = -1
    for _ in range(MAX_ROUNDS):
        least, turned, axis = volume * (1.0 - WORTHWHILE), axes, -1
        for k in range(3):
            if k == done:
                continue
            w = pick_axis(axes, k)
            area, u = _rectangle(surface, w)
            size = area * _height(surface, w)
            if size < least:
                least, axis, turned = size, k, (u, cross(w, u), w)
        if axis < 0:
            break
        volume, axes, done = least, turned, 2
    return axes


@njit
def _height(surface: Surface, w: Vector) -> float:
    """Return the extent of the hull along an axis."""
    points, low, high = surface.hull.points, np.inf, -np.inf
    for row in surface.hull.vertices:
        reach = dot(w, vector_at(points, row))
        low, high = min(low, reach), max(high, reach)
    return max(high - low, surface.floor)


@njit
def _rectangle(surface: Surface, w: Vector) -> tuple[float, Vector]:
    """Return the area and a side (unit) of the minimum rectangle about the outline along w."""
    normals, edges, sides, outline = surface.normals, surface.edges, surface.sides, surface.outline
    points = surface.hull.points
    for f in range(len(normals)):
        sides[f] = dot(w, vector_at(normals, f)) > 0.0
    count = 0
    for e in range(len(edges)):
        if sides[edges[e, 2]] != sides[edges[e, 3]]:
            for k in range(2):
                p = vector_at(points, edges[e, k])
                outline[count, 0], outline[count, 1], outline[count, 2] = p
                count += 1
    least, best = np.inf, (1.0, 0.0, 0.0)
    for e in range(0, count, 2):
        edge = minus(vector_at(outline, e), vector_at(outline, e + 1))
        u = _across(_across(edge, w), w)  # twice is enough (Parlett 1980, 6.9)
        if dot(u, u) > 0.0:
            area = _extent(outline, count, u, surface.floor)
            area *= _extent(outline, count, cross(w, u), surface.floor)
            if area < least:
                least, best = area, u
    return least, best


@njit
def _across(v: Vector, w: Vector) -> Vector:
    """Return the unit vector along what v has orthogonal to w; zero where that is rounding."""
    u = minus(v, scaled(w, dot(v, w)))
    square = dot(u, u)
    return scaled(u, 1.0 / np.sqrt(square) if square > DEPENDENT**2 * dot(v, v) else 0.0)


@njit
def _extent(rows: Floats, count: int, u: Vector, floor: float) -> float:
    low, high = np.inf, -np.inf
    for k in range(count):
        reach = dot(u, vector_at(rows, k))
        low, high = min(low, reach), max(high, reach)
    return max(high - low, floor)
