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
from itertools import product
from typing import Any

import numpy as np
from convex_bodies import Pair, corners_of
from numpy.typing import ArrayLike, NDArray

from obb_collision.queries.convex.support import (
    BOX,
    CONE,
    CORNERS,
    CYLINDER,
    ROUND,
    SEGMENT,
    ConvexBodies,
)
from obb_collision.typing import Floats, Mask

Box = tuple[Floats, Floats, Floats]
Point = Sequence[Fraction]


def fractions(values: Iterable[float]) -> list[Fraction]:
    """Doubles as fractions."""
    return [Fraction(float(value)) for value in values]


def determinant(a: Point, b: Point, c: Point) -> Fraction:
    """Return the determinant of the matrix with columns a, b, c."""
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


def _minus(u: Point, v: Point) -> list[Fraction]:
    return [x - y for x, y in zip(u, v, strict=True)]


def _dot(u: Point, v: Point) -> Fraction:
    return sum((x * y for x, y in zip(u, v, strict=True)), Fraction(0))


def _cross(u: Point, v: Point) -> list[Fraction]:
    return [u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3] for k in range(3)]


def outside(box: Box, points: Iterable[Point]) -> list[Fraction]:
    """How far each point is outside along the worst axis (metres, <= 0 inside), exactly."""
    center, rotation, half = box
    c, h = fractions(center), fractions(half)
    a, b, d = (fractions(column) for column in rotation.T)
    volume = determinant(a, b, d)
    found = []
    for point in points:
        v = _minus(point, c)
        y = (determinant(v, b, d), determinant(a, v, d), determinant(a, b, v))
        found.append(max(abs(y_i / volume) - h_i for y_i, h_i in zip(y, h, strict=True)))
    return found


def whole(values: Floats) -> tuple[Any, int]:
    """Return doubles as integers of any size (an array), and the exponent of two of their unit."""
    mantissas, exponents = np.frexp(values)
    exponents = np.where(mantissas == 0.0, 0, exponents - 53)
    least = int(exponents.min(initial=0))
    integers = (mantissas * 2.0**53).astype(np.int64).astype(object)
    return integers << (exponents - least).astype(object), least


def inside(box: Box, points: Floats) -> Mask:
    """Which of points (n, 3) the box contains, exactly: as ``outside``, in integers."""
    lengths, _ = whole(np.vstack([box[0], box[2], points]))
    axes, exponent = whole(box[1])
    normals = np.cross(axes.T[[1, 2, 0]], axes.T[[2, 0, 1]])
    reach = abs(lengths[1] * (axes[:, 0] @ normals[0]))
    along = abs((lengths[2:] - lengths[0]) @ normals.T)
    return np.asarray((along << -exponent <= reach).all(axis=1), np.bool_)


def holds(box: Box, points: Floats) -> bool:
    """Whether the box contains all points (n, 3), exactly."""
    return bool(inside(box, points).all())


def corners(box: Box) -> list[list[Fraction]]:
    """Return the eight corners, exactly."""
    center, rotation, half = box
    c, h = fractions(center), fractions(half)
    axes = [fractions(column) for column in rotation.T]
    return [
        [c[k] + sum(s * h[i] * axes[i][k] for i, s in enumerate(signs)) for k in range(3)]
        for signs in product((-1, 1), repeat=3)
    ]


def moved(points: Iterable[Point], matrix: Floats) -> list[list[Fraction]]:
    """Return the points under a matrix (4, 4), exactly."""
    rows = [fractions(row) for row in matrix.tolist()]
    return [[sum(row[i] * p[i] for i in range(3)) + row[3] for row in rows[:3]] for p in points]


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


def first_hit(origin: Point, direction: Point, triangle: Sequence[Point]) -> Fraction | None:
    """Return the least t >= 0 at which origin + t direction is in the triangle, None if never."""
    u, v = _minus(triangle[1], triangle[0]), _minus(triangle[2], triangle[0])
    w = _minus(origin, triangle[0])
    whole = determinant(u, v, direction)
    if whole == 0:
        times = [_on_edge(origin, direction, triangle[k], triangle[(k + 1) % 3]) for k in range(3)]
        return min((t for t in times if t is not None), default=None)
    r = determinant(w, v, direction) / whole
    s = determinant(u, w, direction) / whole
    t = -determinant(u, v, w) / whole
    return t if min(r, s, 1 - r - s, t) >= 0 else None


def _on_edge(origin: Point, direction: Point, start: Point, end: Point) -> Fraction | None:
    """Return when a ray first hits an edge, if it does so and is not parallel to it.

    Where it is parallel, or begins on the edge, other edges are hit as early.
    """
    edge, way = _minus(end, start), _minus(start, origin)
    across = _cross(direction, edge)
    square = sum(x * x for x in across)
    if square == 0:
        return None
    t = _dot(_cross(way, edge), across) / square
    s = _dot(_cross(way, direction), across) / square
    if t < 0 or not 0 <= s <= 1:
        return None
    rest = [w + s * e - t * d for w, e, d in zip(way, edge, direction, strict=True)]
    return t if not any(rest) else None


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
    a, b, c = map(fractions, triangle)
    normal = _cross(_minus(b, a), _minus(c, a))
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
    if kind == CORNERS:
        return np.zeros(len(p))
    if kind == BOX:
        return (np.abs(p) - sizes).max(axis=1)
    if kind == SEGMENT:
        p[:, 2] -= np.clip(p[:, 2], -half, half)
        return np.linalg.norm(p, axis=1) - body.radii
    thin = np.where(sizes > 0.0, 0.0, np.abs(p)).max(axis=1)
    if kind == ROUND:
        return np.maximum(thin, beyond_ellipse(p, sizes))
    along = np.abs(p[:, 2]) - half
    if kind == CYLINDER:
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
    if kind == CORNERS:
        points = np.array([corners_of(body, i) for i in range(len(m))]).astype(np.longdouble)
        core = np.einsum("nkj,nj->nk", points, m).max(axis=1)
    elif kind == BOX:
        core = (np.abs(m) * sizes[:, :3]).sum(axis=1)
    elif kind == CYLINDER:
        core = rim + half * np.abs(m[:, 2])
    elif kind == CONE:
        core = np.maximum(half * m[:, 2], rim - half * m[:, 2])
    else:
        core = np.sqrt(rim**2 + (z * m[:, 2]) ** 2) + half * np.abs(m[:, 2])
    return core + body.radii * np.sqrt((n * n).sum(axis=1))


def exact_gap(pair: Pair, normals: Floats) -> Long:
    a, b = pair
    n = normals.astype(np.longdouble)
    n /= np.sqrt((n * n).sum(axis=1))[:, None]
    offset = b.centers.astype(np.longdouble) - a.centers
    gap: Long = (n * offset).sum(axis=1) - exact_reach(a, n) - exact_reach(b, -n)
    return gap
