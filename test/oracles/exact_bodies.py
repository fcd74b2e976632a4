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

"""Exact truths about boxes and bodies: points inside, rays that hit, and planes beside them.

A box is {c + sum t_i h_i a_i, abs(t_i) <= 1} for its doubles as stored, a_i the columns of the
rotation. The coordinates y = R^-1 (p - c) come from Cramer's rule; abs(y_i) <= h_i decides.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction

import numpy as np
from convex_bodies import Pair, corners_of
from exact_vectors import Box, Vector, along, cross, determinant, dot, exact, minus, whole
from numpy.typing import ArrayLike, NDArray

from obb_collision.queries.convex.support import (
    BOX_CORE,
    CONE_CORE,
    CYLINDER_CORE,
    HULL_CORE,
    ROUND_CORE,
    SEGMENT_CORE,
    ConvexBodies,
)
from obb_collision.typing import Floats, Mask


def outside(box: Box, points: Iterable[Vector]) -> list[Fraction]:
    """How far each point is outside along the worst axis (metres, <= 0 inside), exactly."""
    center, rotation, half = box
    c, h = exact(center), exact(half)
    a, b, d = (exact(column) for column in rotation.T)
    volume = determinant(a, b, d)
    found = []
    for point in points:
        v = minus(point, c)
        y = (determinant(v, b, d), determinant(a, v, d), determinant(a, b, v))
        found.append(max(abs(y_i / volume) - h_i for y_i, h_i in zip(y, h, strict=True)))
    return found


def inside(box: Box, points: Floats) -> Mask:
    """Which of points (n, 3) the box contains, exactly: by doubles where rounding can't matter."""
    center, rotation, half = box
    with np.errstate(all="ignore"):
        size = np.abs(points).sum(axis=1) + np.abs(center).sum() + half.sum()
        gaps = (np.abs((points - center) @ rotation) - half).max(axis=1)
        certain = (np.abs(gaps) > 1e-12 * size) & (size > 1e-100) & (size < 1e100)
    found = np.asarray(gaps < 0.0)
    found[~certain] = _inside(box, points[~certain])
    return found


def _inside(box: Box, points: Floats) -> Mask:
    """Decide as ``outside``, in integers."""
    lengths, _ = whole(np.vstack([box[0], box[2], points]))
    axes, exponent = whole(box[1])
    normals = np.cross(axes.T[[1, 2, 0]], axes.T[[2, 0, 1]])
    reach = abs(lengths[1] * (axes[:, 0] @ normals[0]))
    along = abs((lengths[2:] - lengths[0]) @ normals.T)
    return np.asarray((along << -exponent <= reach).all(axis=1), np.bool_)


def holds(box: Box, points: Floats) -> bool:
    """Whether the box contains all points (n, 3), exactly."""
    return bool(inside(box, points).all())


def assert_proper(box: Box) -> None:
    """Right-handed, orthonormal to 16 unit roundoffs, half extents finite and not negative."""
    center, rotation, half = box
    assert center.shape == half.shape == (3,)
    assert rotation.shape == (3, 3)
    assert np.isfinite(center).all()
    assert all(value >= 0.0 for value in half.tolist())
    assert np.isfinite(half).all()
    axes, exponent = whole(rotation)
    unit = 1 << -2 * exponent
    assert (abs(axes.T @ axes - unit * np.eye(3, dtype=object)) << 49 <= unit).all()
    # of rows: numpy 1.26 crosses no two single vectors of integers of Python
    assert axes[:, 0] @ np.cross(axes.T[[1]], axes.T[[2]])[0] > 0


def first_hit(origin: Vector, direction: Vector, triangle: Sequence[Vector]) -> Fraction | None:
    """Return the least t >= 0 at which origin + t direction is in the triangle, None if never."""
    u, v = minus(triangle[1], triangle[0]), minus(triangle[2], triangle[0])
    w = minus(origin, triangle[0])
    whole = determinant(u, v, direction)
    if whole == 0:
        times = [_on_edge(origin, direction, triangle[k - 1], triangle[k]) for k in range(3)]
        return min((t for t in times if t is not None), default=None)
    r, s, t = (determinant(*m) / whole for m in ((w, v, direction), (u, w, direction), (v, u, w)))
    return t if min(r, s, 1 - r - s, t) >= 0 else None


def _on_edge(origin: Vector, direction: Vector, start: Vector, end: Vector) -> Fraction | None:
    """Return when a ray first hits an edge, if it does so and is not parallel to it.

    Where it is parallel, or begins on the edge, other edges are hit as early.
    """
    edge, way = minus(end, start), minus(start, origin)
    across = cross(direction, edge)
    square = dot(across, across)
    if square == 0:
        return None
    t, s = (determinant(way, x, across) / square for x in (edge, direction))
    hit = t >= 0 and 0 <= s <= 1 and along(origin, t, direction) == along(start, s, edge)
    return t if hit else None


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
    a, b, c = map(exact, triangle)
    normal = cross(minus(b, a), minus(c, a))
    largest = max(abs(x) for x in normal)
    assert largest > 0, "a triangle without area has no plane"
    parts = [float(x / largest) for x in normal]
    return [part / math.hypot(*parts) for part in parts]


def beyond(body: ConvexBodies, points: Floats) -> Floats:
    """Return how far points (m, 3) are outside of bodies, to first order; not of hulls.

    That those of hulls are right follows from their distances.
    """
    p = np.einsum("nij,ni->nj", body.rotations, points - body.centers)
    sizes, half = body.sizes[:, :3], body.sizes[:, 3]
    kind = int(body.kinds[0])
    if kind == HULL_CORE:
        return np.zeros(len(p))
    if kind == BOX_CORE:
        return (np.abs(p) - sizes).max(axis=1)
    if kind == SEGMENT_CORE:
        p[:, 2] -= np.clip(p[:, 2], -half, half)
        return np.linalg.norm(p, axis=1) - body.radii
    thin = np.where(sizes > 0.0, 0.0, np.abs(p)).max(axis=1)
    if kind == ROUND_CORE:
        return np.maximum(thin, beyond_ellipse(p, sizes))
    along = np.abs(p[:, 2]) - half
    if kind == CYLINDER_CORE:
        return np.maximum(along, beyond_ellipse(p[:, :2], sizes[:, :2]))
    flat = half == 0.0
    width = np.where(flat, 1.0, (half - p[:, 2]) / np.where(flat, 1.0, 2.0 * half))
    rim = np.linalg.norm(p[:, :2] / sizes[:, :2], axis=1)
    steep = 1.0 / np.hypot(1.0 / sizes.max(axis=1), np.where(flat, 0.0, 0.5 / half.clip(1e-300)))
    return np.maximum(along, (rim - width) * steep)


def beyond_ellipse(p: Floats, sizes: Floats) -> Floats:
    """Return the distance to first order: a function that is 1 on the surface, by its slope."""
    used = sizes > 0.0
    u = np.where(used, p / np.where(used, sizes, 1.0), 0.0)
    length = np.linalg.norm(u, axis=1)
    slope = np.linalg.norm(np.where(used, u / np.where(used, sizes, 1.0), 0.0), axis=1)
    return (length - 1.0) * length / np.where(slope > 0.0, slope, 1.0)


Long = NDArray[np.longdouble]


def exact_reach(body: ConvexBodies, n: Long) -> Long:
    """Return how far bodies reach along directions n (m, 3), of length one to 64 bits."""
    rotations, sizes = body.rotations.astype(np.longdouble), body.sizes.astype(np.longdouble)
    m = np.einsum("nij,ni->nj", rotations, n)
    x, y, z, half = (sizes[:, k] for k in range(4))
    rim = np.sqrt((x * m[:, 0]) ** 2 + (y * m[:, 1]) ** 2)
    kind = int(body.kinds[0])
    if kind == HULL_CORE:
        points = np.array([corners_of(body, i) for i in range(len(m))]).astype(np.longdouble)
        core = np.einsum("nkj,nj->nk", points, m).max(axis=1)
    elif kind == BOX_CORE:
        core = (np.abs(m) * sizes[:, :3]).sum(axis=1)
    elif kind == CYLINDER_CORE:
        core = rim + half * np.abs(m[:, 2])
    elif kind == CONE_CORE:
        core = np.maximum(half * m[:, 2], rim - half * m[:, 2])
    else:
        core = np.sqrt(rim**2 + (z * m[:, 2]) ** 2) + half * np.abs(m[:, 2])
    return core + body.radii * np.sqrt((n * n).sum(axis=1))


def exact_gap(pair: Pair, normals: Floats) -> Long:
    a, b = pair
    n = normals.astype(np.longdouble)
    n /= np.sqrt((n * n).sum(axis=1))[:, None]
    offset = b.centers.astype(np.longdouble) - a.centers
    return np.asarray((n * offset).sum(axis=1) - exact_reach(a, n) - exact_reach(b, -n))
