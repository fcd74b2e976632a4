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
are replaced by a polytope of as many at most, whose planes touch the points (``outer_polytope``).
Points that are flat, on a line or all one are made thicker by that margin first.
"""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.fitting.convex_hull import convex_hull
from obb_collision.geometry.fitting.fit import fit_points
from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.shapes.primitives import Shape
from obb_collision.geometry.trees.circumscribed import geodesic_sphere, outer_points
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
from obb_collision.geometry.trees.outer_polytope import (
    THINNEST,
    extreme_rows,
    farthest_reach,
    outer_corners,
)
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.typing import Floats, Integers

#: Margin of hulls about their points, relative to the largest coordinate: more than the rounding
#: of Qhull, and more than the gap up to which two meshes count as touching.
HULL_MARGIN = 2**17 * ROUNDOFF
#: A body that must grow by more to get that margin is thin, and is made thicker along its thin axes
#: first. The second is for slivers among faces, which make both grow by more.
GROWTHS = (2.0**-20, 2.0**-10)
#: Axes of a body are thin below so many margins: then making them thicker has less error than
#: growing, and steps that are more than the roundings of Qhull, 1e-11.
THIN = 2.0**26
#: Points of thin bodies are rounded to this fraction of the margin: coplanar ones become so.
SNAP = 2.0**-4
#: A facet whose height is below this times its longest side may have a needless corner there.
SLIVER = 2.0**-20
#: Rounds of removing such corners; real meshes needed at most three.
CORNER_ROUNDS = 8
#: Maximum number of corners of a hull: a search for the farthest one takes 0.2 us. Of 114 meshes of
#: robots and things the hulls of 105 have fewer.
MAX_HULL_CORNERS = 1000
#: Number of points up to which the hull of all is made: 0.3 s at most; and of how many of more.
MAX_HULL_POINTS = 20_000
#: Directions in which the farthest points are found are those of so fine a geodesic sphere: 162.
EXTREMES = 2
#: Points that are inside a hull by less than this share are kept.
WELL_INSIDE = 2.0**-20


Polytope = tuple[Floats, Integers]
"""Corners (v, 3) and outward faces (m, 3)."""


def hull_mesh(shape: Shape) -> Polytope:
    """Return corners (v, 3) and outward faces (m, 3) of a convex mesh that contains a shape."""
    if isinstance(shape, (Mesh, Hull)):
        points = shape._points() * np.array(shape.scale)
    else:
        points = outer_points(shape)
    largest = float(np.abs(points).max())
    margin = HULL_MARGIN * largest
    # Scaled by a power of two, exactly, so that products neither over- nor underflow.
    power = int(np.frexp(largest)[1])
    points, margin = np.ldexp(points, -power), float(np.ldexp(margin, -power))
    for limit in GROWTHS if margin > 0.0 else ():  # else all of it is the origin
        grown = _bounded_hull(points, np.full(3, margin), limit)
        grown = grown or _thick_hull(points, margin, limit)
        if grown is not None:
            return np.ldexp(grown[0], power), grown[1]
    center, rotation, half_extents = shape.local_box
    grown_box = half_extents + np.ldexp(margin, power)
    return center + (BOX_CORNERS * grown_box) @ rotation.T, BOX_FACES


def box_corners(half_extents: Floats) -> Floats:
    """Return the corners (8, 3) of a box about the origin, with the margin of a hull."""
    return BOX_CORNERS * (half_extents + HULL_MARGIN * half_extents.max())


def _bounded_hull(points: Floats, margin: Floats, limit: float) -> Polytope | None:
    # Each corner once: files of single triangles repeat them, Qhull makes facets of copies.
    points = np.unique(points, axis=0)
    inner = points if len(points) <= MAX_HULL_POINTS else _outer_ones(points)
    hull = convex_hull(inner)
    if hull is None:
        return None
    if len(hull.vertices) <= MAX_HULL_CORNERS:
        grown = _grown_hull(inner, points, margin, limit)
        if grown is not None:
            return grown
    corners = outer_corners(inner, hull.simplices, points, MAX_HULL_CORNERS)
    return None if corners is None else _grown_hull(corners, points, margin, limit)


def _thick_hull(points: Floats, margin: float, limit: float) -> Polytope | None:
    """Return what ``_bounded_hull`` does of points that may be flat, a line, or one.

    In the frame of their box, made thicker where that is thin, and stretched to a cube.
    """
    center, rotation, half_extents = fit_points(points)
    step = SNAP * margin
    local = step * np.unique(np.round((points - center) @ rotation / step), axis=0)
    flat = int(half_extents.argmin())
    outline = None if local[:, flat].any() else convex_hull(np.delete(local, flat, axis=1))
    local = local if outline is None else local[outline.vertices]
    thin = half_extents < THIN * margin
    thicker = BOX_CORNERS * np.where(thin, margin + 2.0 * step, 0.0)
    stretch = np.exp2(np.frexp(half_extents + thicker.max(axis=0))[1])
    thick = (local[:, None] + thicker).reshape(-1, 3) / stretch
    found = _bounded_hull(thick, np.where(thin, HULL_MARGIN, margin / stretch), limit)
    return None if found is None else (center + (found[0] * stretch) @ rotation.T, found[1])


def _outer_ones(points: Floats) -> Floats:
    """Return points (k, 3) without those within the hull of a few, which are no corners of theirs.

    At most some MAX_HULL_POINTS: of more the extreme ones and as many of the others.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    stretched = geodesic_sphere(EXTREMES) / np.maximum(high - low, THINNEST * (high - low).max())
    extreme = points[np.unique(extreme_rows(points, stretched))]
    first = convex_hull(extreme)
    if first is not None:
        corners = first.points[first.simplices]
        middle = first.points[first.vertices].mean(axis=0)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        offsets = np.einsum("ij,ij->i", normals, corners[:, 0] - middle)
        sound = offsets != 0.0
        ways = normals[sound] / offsets[sound, None]  # a point p is inside where ways.p is below 1
        points = points[farthest_reach(ways, points - middle) > 1.0 - WELL_INSIDE]
    if len(points) > MAX_HULL_POINTS:
        points = np.concatenate([extreme, points[:: -(-len(points) // MAX_HULL_POINTS)]])
    return points


def _grown_hull(corners: Floats, points: Floats, margin: Floats, limit: float) -> Polytope | None:
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
        grown = _grown(corners, faces, points, margin, limit)
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
    vertices: Floats, faces: Integers, points: Floats, margin: Floats, limit: float
) -> Polytope | None:
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
    margins = np.linalg.norm(normals * margin, axis=1)
    reach = farthest_reach(points - middle, normals)
    offsets = np.abs(offsets)
    if not (offsets > 0.0).all():
        return None
    growth = float(((reach - offsets + 2.0 * margins) / offsets).max())
    if not growth <= limit:
        return None
    return middle + (vertices - middle) * (1.0 + growth), faces
