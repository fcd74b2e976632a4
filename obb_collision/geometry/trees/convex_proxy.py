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

"""Closed convex meshes that certainly contain a shape: its hull, or a simpler polytope.

The hull of the shape's points, larger by HULL_MARGIN. Hulls of more than MAX_HULL_CORNERS corners
are replaced by the polytope of PLANES planes that touch the points and are parallel to faces of
the hull in directions as different as possible: on a sphere it is 2 % larger. Of more than
MAX_HULL_POINTS points, whose hull would take seconds, the hull of the extreme ones is used.
"""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.fitting.convex_hull import convex_hull
from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.shapes.primitives import Shape
from obb_collision.geometry.trees.circumscribed import geodesic_sphere, outer_points
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.typing import Floats, Integers

#: Margin of hulls about their points, relative to the largest coordinate: more than the rounding
#: of Qhull, and more than the gap up to which two meshes count as touching.
HULL_MARGIN = 2**17 * ROUNDOFF
#: A body that must grow by more to get that margin is too thin: its box is used instead.
LARGEST_GROWTH = 2.0**-10
#: A facet whose height is below this times its longest side may have a needless corner there.
SLIVER = 2.0**-20
#: Rounds of removing such corners; real meshes needed at most three.
CORNER_ROUNDS = 8
#: Maximum number of corners of a hull: a search for the farthest one takes 0.4 us.
MAX_HULL_CORNERS = 400
#: Maximum number of points whose hull is made: some 0.3 s.
MAX_HULL_POINTS = 4000
#: Products per block in the search for the farthest points: 1 MB, which fits into the cache.
BLOCK = 1 << 17
#: Planes of the simpler polytope, which has twice as many corners.
PLANES = 160
#: Faces count as parallel if the product of their normals is within this of one (8e-4 rad).
PARALLEL_FACES = 1e-7
#: A shape thinner than this fraction of its length gets no simpler polytope.
THINNEST = 2.0**-20


def hull_mesh(shape: Shape) -> tuple[Floats, Integers]:
    """Return corners (v, 3) and outward faces (m, 3) of a convex mesh that contains a shape.

    The local box, if the shape is too flat for Qhull or the margin.
    """
    if isinstance(shape, (Mesh, Hull)):
        points = shape._points() * np.array(shape.scale)
    else:
        points = outer_points(shape)
    largest = float(np.abs(points).max())
    margin = HULL_MARGIN * largest
    # Scaled by a power of two, exactly, so that products neither over- nor underflow.
    power = int(np.frexp(largest)[1])
    grown = _bounded_hull(np.ldexp(points, -power), float(np.ldexp(margin, -power)))
    if grown is not None:
        return np.ldexp(grown[0], power), grown[1]
    center, rotation, half_extents = shape.local_box
    return center + (BOX_CORNERS * (half_extents + margin)) @ rotation.T, BOX_FACES


def box_corners(half_extents: Floats) -> Floats:
    """Return the corners (8, 3) of a box about the origin, with the margin of a hull."""
    return BOX_CORNERS * (half_extents + HULL_MARGIN * half_extents.max())


def _bounded_hull(points: Floats, margin: float) -> tuple[Floats, Integers] | None:
    inner = points
    if len(points) > MAX_HULL_POINTS:
        low, high = points.min(axis=0), points.max(axis=0)
        stretched = geodesic_sphere(3) / np.maximum(high - low, THINNEST * (high - low).max())
        inner = points[np.unique(_extreme(points, stretched))]
    else:
        # Each corner once: files of single triangles repeat them, Qhull makes facets of copies.
        points = inner = np.unique(points, axis=0)
    grown = _grown_hull(inner, points, margin)
    if grown is not None and len(grown[0]) <= MAX_HULL_CORNERS:
        return grown
    corners = _outer_corners(inner, points)
    simple = None if corners is None else _grown_hull(corners, points, margin)
    return grown if simple is None else simple


def _outer_corners(inner: Floats, points: Floats) -> Floats | None:
    """Return the approximate corners of a polytope about points (n, 3); None if they are flat.

    Each of its planes touches the points. Polar duality: the plane n.x = d maps to the point n / d,
    so the corners are the planes of the hull of those points. inner: the points whose hull gives
    the directions.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if not half.min() > THINNEST * half.max():
        return None
    directions = _plane_directions((inner - middle) / half)
    reach = _farthest((points - middle) / half, directions)
    if not (reach > THINNEST).all():
        return None
    planes = convex_hull(directions / reach[:, None])
    if planes is None:
        return None
    # Of the triangles: Qhull's equations are those of points that it has scaled.
    normals, _ = _normals(planes.points[planes.simplices])
    offsets = np.einsum("ij,ij->i", normals, planes.points[planes.simplices[:, 0]])
    sound = offsets != 0.0
    return middle + half * np.unique(normals[sound] / offsets[sound, None], axis=0)


def _plane_directions(points: Floats) -> Floats:
    """Return at most PLANES normals (k, 3) of the hull's faces, as different as possible.

    That of the largest face, then repeatedly the one farthest from those chosen (Gonzalez 1985).
    """
    hull = convex_hull(points)
    if hull is None:
        return geodesic_sphere(2)
    normals, areas = _normals(points[hull.simplices])
    inward = np.einsum("ij,ij->i", normals, points[hull.simplices[:, 0]] - points.mean(axis=0)) < 0
    normals[inward] *= -1.0
    chosen = [int(areas.argmax())]
    likeness = normals @ normals[chosen[0]]
    likeness[areas == 0.0] = 1.0
    while len(chosen) < PLANES and likeness.min() < 1.0 - PARALLEL_FACES:
        chosen.append(int(likeness.argmin()))
        np.maximum(likeness, normals @ normals[chosen[-1]], out=likeness)
    return normals[chosen]


def _normals(triangles: Floats) -> tuple[Floats, Floats]:
    """Return unit normals (m, 3), zero where there is none, and doubled areas of (m, 3, 3)."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    return normals / np.maximum(areas, np.finfo(float).tiny)[:, None], areas


def _grown_hull(corners: Floats, points: Floats, margin: float) -> tuple[Floats, Integers] | None:
    """Return vertices and faces of a hull of corners that contains points with a margin; or None.

    Facets without height, part of flat faces with many corners, have arbitrary normals; where they
    prevent growing, their needless corners are removed, and the hull grows to contain those, too.
    """
    for _ in range(CORNER_ROUNDS):
        hull = convex_hull(corners)
        if hull is None:
            return None
        used, faces = np.unique(hull.simplices, return_inverse=True)
        faces = faces.reshape(-1, 3).astype(np.int64)
        corners = corners[used]
        grown = _grown(corners, faces, points, margin)
        if grown is not None:
            return grown
        needless = _needless(corners[faces], faces)
        if len(needless) == 0:
            return None
        corners = np.delete(corners, needless, axis=0)
    return None


def _needless(corners: Floats, faces: Integers) -> Integers:
    """Return the vertices that nearly lie on the opposite, longest side of a face (m, 3, 3)."""
    sides = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]  # each opposite its corner
    lengths = np.linalg.norm(sides, axis=2)
    doubled = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    thin = doubled <= SLIVER * lengths.max(axis=1) ** 2
    return faces[thin, lengths[thin].argmax(axis=1)]


def _grown(
    vertices: Floats, faces: Integers, points: Floats, margin: float
) -> tuple[Floats, Integers] | None:
    """Return vertices and outward faces of the hull, stretched about an inner point; or None.

    The surface is star-shaped about that point if all faces have it on their inner side. Then it
    contains everything behind all its planes, and each plane is moved past the farthest point.
    """
    middle = vertices.mean(axis=0)
    a, b, c = (vertices - middle)[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    if not (lengths > 0.0).all():
        return None
    normals /= lengths[:, None]
    offsets = np.einsum("ij,ij->i", normals, a)
    inward = offsets < 0.0
    faces[inward] = faces[inward][:, ::-1]
    normals[inward] *= -1.0
    reach = _farthest(points - middle, normals)
    offsets = np.abs(offsets)
    if not (offsets > 0.0).all():
        return None
    growth = float(((reach - offsets + 2.0 * margin) / offsets).max())
    if not growth <= LARGEST_GROWTH:
        return None
    return middle + (vertices - middle) * (1.0 + growth), faces


def _extreme(points: Floats, normals: Floats) -> Integers:
    """Return (m,) the rows of the points (n, 3) farthest along each normal (m, 3)."""
    best, rows = np.full(len(normals), -np.inf), np.zeros(len(normals), np.int64)
    step = max(1, BLOCK // len(normals))
    for k in range(0, len(points), step):
        reach = points[k : k + step] @ normals.T
        row = reach.argmax(axis=0)
        value = reach[row, np.arange(len(normals))]
        better = value > best
        best[better], rows[better] = value[better], row[better] + k
    return rows


def _farthest(points: Floats, normals: Floats) -> Floats:
    """Return (m,) how far points (n, 3) reach along each normal (m, 3)."""
    reach = np.full(len(normals), -np.inf)
    step = max(1, BLOCK // len(normals))
    for k in range(0, len(points), step):
        np.maximum(reach, (points[k : k + step] @ normals.T).max(axis=0), out=reach)
    return reach
