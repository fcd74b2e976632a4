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

"""Candidate orientations for the box of a point set.

Every function takes points (n, 3) about the origin and of size about 1 (see ``fit``) and returns
rotations (3, 3), columns are axes, determinant +1, orthonormal to a few roundoffs. They are
compared by volume only: any frame gives a box that contains the points (see ``enclosing``).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.geometry.fitting.convex_hull import hull_polygon, minimum_rectangle_direction
from obb_collision.geometry.poses import matrices_from_quaternions
from obb_collision.numerics.constants import DEPENDENT
from obb_collision.numerics.vec3 import columns, cross, dot, minus, pick_axis, scaled, vector_at
from obb_collision.typing import Axes, Floats, Vector

#: Orientations from which those to refine are chosen. The boxes of 400 random clouds of 4 to 1000
#: points were 0.12 % smaller with the best 8 of these and 8 faces than with 4 and one face, at the
#: most 5 %; with 16 and 8, another 0.05 %.
SPREAD = 256


def complete_frame(first: Floats, second: Floats) -> Floats:
    """Return the rotation whose first column is along ``first``, the second towards ``second``.

    Gram and Schmidt, each step done twice ("twice is enough", Kahan, in Parlett 1980, 6.9). Zero
    components stay exactly zero. A second vector that is parallel or zero is replaced.
    """
    a = _unit(first)
    b = _orthogonal_to(a, second)
    if b is None:
        b = _orthogonal_to(a, np.eye(3)[np.abs(a).argmin()])
        assert b is not None  # at least 54 degrees from the least aligned coordinate axis
    c = _unit(_cross(a, b))
    return np.column_stack([a, b, c]) + 0.0  # no -0.0


def _cross(a: Floats, b: Floats) -> Floats:
    return np.array(cross(tuple(a.tolist()), tuple(b.tolist())))


def _unit(vector: Floats) -> Floats:
    scaled: Floats = vector / np.abs(vector).max()
    return scaled / np.sqrt(scaled @ scaled)


def _orthogonal_to(a: Floats, vector: Floats) -> Floats | None:
    if not vector.any():
        return None
    b = _unit(vector)
    b = b - (a @ b) * a
    if b @ b < DEPENDENT**2:
        return None
    b = _unit(b)
    return _unit(b - (a @ b) * a)


def keep_flat(frame: Floats, flat: NDArray[np.bool_]) -> Floats:
    """Return the frame turned by roundoffs so that flat coordinates stay exactly flat.

    flat (3,): which coordinates are the same for all points. A set in a plane z = const gets an
    axis that is exactly z, hence a half extent that is exactly zero.
    """
    if flat.sum() >= 2:
        return np.eye(3)
    if not flat.any():
        return frame
    normal = np.eye(3)[int(flat.argmax())]
    keep = 1 if np.abs(normal @ frame).argmax() == 0 else 0
    within = np.where(flat, 0.0, frame[:, keep])
    return complete_frame(within, _cross(normal, within))


def covariance_frame(points: Floats) -> Floats:
    """Return the principal axes of the points, the longest spread first.

    Two passes: the mean is subtracted first; the axes come from the singular vectors of the
    centred points, which keep twice the digits of the covariance matrix.
    """
    centered = points - points.mean(axis=0)
    if not centered.any():
        return np.eye(3)
    _, _, axes = np.linalg.svd(centered, full_matrices=False)
    second = axes[1] if len(axes) > 1 else np.zeros(3)
    return complete_frame(axes[0], second)


def hull_covariance_frame(triangles: Floats) -> Floats:
    """Return the principal axes of a surface, the triangles (n, 3, 3) of a hull.

    Weighted by area, so that the density of the points does not matter (Gottschalk, Lin,
    Manocha 1996, section 3): triangle p q r of area A with centroid m adds
    A / 12 (9 m m^T + p p^T + q q^T + r r^T) about the mean.
    """
    edges = triangles[:, 1:] - triangles[:, :1]
    areas = np.sqrt((np.cross(edges[:, 0], edges[:, 1]) ** 2).sum(axis=1))
    weights = areas / areas.sum()
    about = triangles - weights @ triangles.mean(axis=1)
    samples = np.concatenate([3.0 * about.mean(axis=1)[:, None], about], axis=1)
    second_moment = np.einsum("n,nki,nkj->ij", weights / 12.0, samples, samples)
    _, axes = np.linalg.eigh(second_moment)
    return complete_frame(axes[:, 2], axes[:, 1])


def flat_frames(points: Floats, frame: Floats) -> tuple[Floats, Floats]:
    """Return two frames of a flat set, whose plane is normal to the last axis of ``frame``.

    The principal axes of its hull's area, and those of the smallest rectangle.
    """
    polygon = hull_polygon(points @ frame[:, :2])
    if polygon is None:
        return frame, frame
    first = np.broadcast_to(polygon[0], (len(polygon) - 2, 2))
    fan = np.stack([first, polygon[1:-1], polygon[2:]], axis=1)
    inner = hull_covariance_frame(np.concatenate([fan, np.zeros((len(fan), 3, 1))], axis=2))
    x, y = minimum_rectangle_direction(polygon)
    u, v = frame[:, 0], frame[:, 1]
    turned = complete_frame(x * u + y * v, x * v - y * u)
    return complete_frame(frame @ inner[:, 0], frame @ inner[:, 1]), turned


def upright_frame(points: Floats) -> Floats:
    """Return axes with z up, and those of the smallest rectangle of points (n, 3) from above."""
    polygon = hull_polygon(points[:, :2])
    if polygon is None:  # on a line
        x, y, _ = covariance_frame(points * (1.0, 1.0, 0.0))[:, 0]
    else:
        x, y = minimum_rectangle_direction(polygon)
    return np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])


@cache
def spread_frames() -> Floats:
    """Return (n, 3, 3) orientations spread over all rotations, always the same ones.

    Random quaternions from a fixed seed (Shoemake 1992), turned into matrices.
    """
    quaternions = np.random.default_rng(0).normal(size=(SPREAD, 4))
    return matrices_from_quaternions(quaternions / np.linalg.norm(quaternions, axis=1)[:, None])


def box_sizes(points: Floats, frames: Floats, floor: float) -> Floats:
    """Return (m,) volumes of the boxes of points with axes (m, 3, 3).

    Extents below ``floor`` count as that much: flat sets therefore compare by area and lines by
    length, if their boxes are as flat.
    """
    along = points @ frames.transpose(1, 0, 2).reshape(3, -1)
    extents = np.maximum(along.max(axis=0) - along.min(axis=0), floor).reshape(-1, 3)
    return extents.prod(axis=1)


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
    """A hull as searches need it: normals (f, 3), edges (e, 4) of corners and triangles."""

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
    """Return the starts (k, 3, 3), each turned about its axes while that makes the box smaller."""
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
        n = scaled(n, sign / size if size > 0.0 else 0.0)  # slivers have no normal
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
    """Return the direction of the part of v orthogonal to w; zero where it is mere rounding."""
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
