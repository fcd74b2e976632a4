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

The hull is that of the shape's points, grown by HULL_MARGIN. A hull of more than MAX_HULL_CORNERS
corners is replaced by a polytope of as many at most. The polytope begins as the box of the points.
Again and again, a plane that touches the points cuts it where it is farthest from them. So the far
corners of needles and wedges are cut first, and smooth parts get as many planes as their curvature
needs. Points in one plane, on one line or in one place are thickened first.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from obb_collision.geometry.fitting.convex_hull import convex_hull
from obb_collision.geometry.fitting.fit import fit_points
from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.shapes.primitives import (
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Shape,
    Sphere,
)
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.typing import Floats, Integers

#: A shape thinner than this fraction of its length gets no simpler polytope.
THINNEST = 2.0**-20
#: Products per block in the search for the farthest points: 1 MB, which fits into the cache.
BLOCK = 1 << 17
#: Directions of cuts are normals of that many faces, the largest, and corners, the sharpest.
MOST_NORMALS = 2000
#: Rounds of cuts: each makes up to a third more planes, so that 16 make 500 with 1000 corners.
ROUNDS = 30
#: The least of these cuts, relative to the deepest of the same round.
LEAST_CUT = 0.4
#: Corners nearer to each other than this, relative to the size of the box, are one.
SAME_CORNER = 2.0**-36


class Directions(NamedTuple):
    """Directions in which a polytope may be cut."""

    normals: Floats  #: (n, 3) unit
    reach: Floats  #: (n,) how far the points reach along them


def outer_corners(inner: Floats, faces: Integers, points: Floats, most: int) -> Floats | None:
    """Return approximate corners (k, 3), k <= most, of a polytope about points; None if flat.

    inner: (n, 3) points; faces: (m, 3) of their hull, whose corners choose the cuts.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * (high - low)
    if not half.min() > THINNEST * half.max():
        return None
    used, faces = np.unique(faces, return_inverse=True)
    middle, normals = _middle_and_normals(inner[used], faces.reshape(-1, 3), half)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    corners = inner[used] - middle
    reach = farthest_reach(corners, normals)
    chosen = _chosen_cuts(Directions(normals, reach), half, most)
    reach = farthest_reach(points - middle, normals[chosen])
    outer = _corners(normals[chosen], reach, half)
    while outer is not None and len(outer) > most:  # where cuts touch points that inner lacks
        chosen = chosen[: -(len(outer) - most)]
        outer = _corners(normals[chosen], reach[: len(chosen)], half)
    return None if outer is None else middle + outer


def _chosen_cuts(cuts: Directions, half: Floats, most: int) -> Integers:
    """Return the rows of directions to cut in, for at most ``most`` corners."""
    chosen = np.arange(6)
    for _ in range(ROUNDS):
        corners = _corners(cuts.normals[chosen], cuts.reach[chosen], half)
        if corners is None:
            break
        room = (most - len(corners)) // 2  # each cut makes two more corners, as a rule
        if room <= 0:
            break
        rows = extreme_rows(corners, cuts.normals)
        depths = np.einsum("ij,ij->i", corners[rows], cuts.normals) - cuts.reach
        deepest = depths.argsort()[::-1]
        _, firsts = np.unique(rows[deepest], return_index=True)  # one cut for each corner
        firsts.sort()
        news = deepest[firsts]
        news = news[depths[news] > max(LEAST_CUT * depths.max(), SAME_CORNER * half.max())]
        news = news[: min(room, max(6, len(chosen) // 3))]
        if len(news) == 0:
            break
        chosen = np.concatenate([chosen, news])
    return chosen


def _corners(normals: Floats, reach: Floats, half: Floats) -> Floats | None:
    """Return the corners (k, 3) of the polytope inside planes, which has the origin inside.

    Polar duality: the plane n.x = d maps to the point n / d, so the corners are the planes of the
    hull of those points; in a frame in which the box of the points is a cube.
    """
    if not (reach > THINNEST * half.min()).all():
        return None
    planes = convex_hull(normals * half / reach[:, None])
    if planes is None:
        return None
    # From the triangles: the equations of Qhull are those of scaled points.
    triangles = planes.points[planes.simplices]
    outward = _normals(triangles)
    offsets = np.einsum("ij,ij->i", outward, triangles[:, 0])
    sound = offsets != 0.0
    corners = outward[sound] / offsets[sound, None]
    return np.unique(np.round(corners / SAME_CORNER) * SAME_CORNER, axis=0) * half


def _middle_and_normals(corners: Floats, faces: Integers, half: Floats) -> tuple[Floats, Floats]:
    """Return the centroid (3,) of a hull and directions (n, 3) of cuts.

    They are first those of its box, then directions all around, normals of faces, and means of the
    normals around corners.
    """
    start = corners.mean(axis=0)
    triangles = (corners - start)[faces]
    normals = _normals(triangles)
    heights = np.einsum("ij,ij->i", normals, triangles[:, 0])
    normals[heights < 0.0] *= -1.0
    volumes = np.abs(heights)
    middle = start + volumes @ triangles.sum(axis=1) / (4.0 * volumes.sum())
    areas = np.linalg.norm(normals, axis=1)
    flat = areas == 0.0
    normals[~flat] /= areas[~flat, None]
    largest = (-areas).argsort()[: min(MOST_NORMALS, int((~flat).sum()))]
    means = np.zeros_like(corners)
    np.add.at(means, faces.ravel(), normals.repeat(3, axis=0))
    means /= np.bincount(faces.ravel(), minlength=len(corners))[:, None]
    lengths = np.linalg.norm(means, axis=1)  # the less, the sharper the corner
    means = means[lengths > 0.0]
    sharpest = lengths[lengths > 0.0].argsort()[:MOST_NORMALS]
    around = geodesic_sphere(3) / half
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    return middle, np.concatenate([axes, around, normals[largest], means[sharpest]])


def _normals(triangles: Floats) -> Floats:
    """Return normals (m, 3) of triangles (m, 3, 3), as long as their doubled areas."""
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def extreme_rows(points: Floats, normals: Floats) -> Integers:
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


def farthest_reach(points: Floats, normals: Floats) -> Floats:
    """Return (m,) how far points (n, 3) reach along each normal (m, 3)."""
    reach = np.full(len(normals), -np.inf)
    step = max(1, BLOCK // len(normals))
    for k in range(0, len(points), step):
        np.maximum(reach, (points[k : k + step] @ normals.T).max(axis=0), out=reach)
    return reach


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
#: Rounds of the geodesic sphere whose 162 directions find the farthest points.
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
    for limit in GROWTHS if margin > 0.0 else ():  # else all points are the origin
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
    inner = points if len(points) <= MAX_HULL_POINTS else _outer_points(points)
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
    """Return the ``_bounded_hull`` of points that may be flat, on a line, or equal.

    It is computed in the frame of their box, thickened where the box is thin, and scaled to a cube.
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
    hull = _bounded_hull(thick, np.where(thin, HULL_MARGIN, margin / stretch), limit)
    return None if hull is None else (center + (hull[0] * stretch) @ rotation.T, hull[1])


def _outer_points(points: Floats) -> Floats:
    """Return the points (k, 3) that may be corners of the hull: not inside that of extreme points.

    If more than MAX_HULL_POINTS are left: the extreme points, and about as many of the others.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    stretched = geodesic_sphere(EXTREMES) / np.maximum(high - low, THINNEST * (high - low).max())
    extreme = points[np.unique(extreme_rows(points, stretched))]
    first = convex_hull(extreme)
    if first is not None:
        corners = first.points[first.simplices]
        middle = first.points[first.vertices].mean(axis=0)
        normals = _normals(corners)
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
        # vertices that nearly lie on the opposite, longest side of a face
        sides = corners[faces][:, [2, 0, 1]] - corners[faces][:, [1, 2, 0]]
        lengths = np.linalg.norm(sides, axis=2)
        doubled = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        thin = doubled <= SLIVER * lengths.max(axis=1) ** 2
        needless = faces[thin, lengths[thin].argmax(axis=1)]
        if len(needless) == 0:
            return None
        corners = np.delete(corners, needless, axis=0)
    return None


def _grown(
    vertices: Floats, faces: Integers, points: Floats, margin: Floats, limit: float
) -> Polytope | None:
    """Return vertices and outward faces of the hull, stretched about an inner point; or None.

    The surface is star-shaped about that point if all faces have it on their inner side. Then it
    contains everything behind all its planes, and each plane is moved past the farthest point.
    """
    middle = vertices.mean(axis=0)
    triangles = (vertices - middle)[faces]
    normals = _normals(triangles)
    lengths = np.linalg.norm(normals, axis=1)
    if not (lengths > 0.0).all():
        return None
    normals /= lengths[:, None]
    offsets = np.einsum("ij,ij->i", normals, triangles[:, 0])
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


# Points whose hull contains a shape with curved faces: prisms, pyramids, geodesic spheres. They are
# those of the shape before scaling, which is linear and so preserves containment.

#: Sides of the polygon about a circle; its corners are 1.9 % farther out.
SIDES = 16
#: Relative excess of all coordinates: far above rounding, far below anything visible.
CIRCUMSCRIBED_SLACK = 8192 * ROUNDOFF


def outer_points(shape: Shape) -> Floats:
    """Return points (n, 3) whose hull contains a sphere, ellipsoid, cylinder, capsule or cone.

    ValueError for other shapes.
    """
    if isinstance(shape, Sphere):
        points = shape.radius * _outer_sphere()
    elif isinstance(shape, Ellipsoid):
        points = np.array(shape.radii) * _outer_sphere()
    elif isinstance(shape, Capsule):
        ends = np.array([[0.0, 0.0, 0.5 * shape.length], [0.0, 0.0, -0.5 * shape.length]])
        points = (shape.radius * _outer_sphere() + ends[:, None]).reshape(-1, 3)
    elif isinstance(shape, (Cylinder, Cone)):
        base = _outer_ring(shape.radius, -0.5 * shape.length)
        top = _outer_ring(0.0 if isinstance(shape, Cone) else shape.radius, 0.5 * shape.length)
        points = np.concatenate([base, top])
    else:
        raise ValueError(f"there is no hull about a {type(shape).__name__}")
    return points * np.array(shape.scale) * (1.0 + CIRCUMSCRIBED_SLACK)


def excess(shape: object, corners: Floats) -> float:
    """Return a bound on how far the hull of corners (k, 3) reaches beyond a shape, in metres.

    Each corner is compared with a point of the shape; shapes that are not curved have 0.
    """
    if not isinstance(shape, (Sphere, Ellipsoid, Capsule, Cylinder, Cone)):
        return 0.0
    scale = np.array(shape.scale)
    points = corners / scale
    if isinstance(shape, (Sphere, Ellipsoid)):
        radii = np.array(shape.radii if isinstance(shape, Ellipsoid) else shape.radius)
        lengths = np.linalg.norm(points / radii, axis=1)
        inner = points / np.maximum(lengths, 1.0)[:, None]
    else:
        inner, half = np.zeros_like(points), 0.5 * shape.length
        inner[:, 2] = np.clip(points[:, 2], -half, half)
        across = points - inner
        radii = np.full(len(points), shape.radius)
        if not isinstance(shape, Capsule):
            across[:, 2] = 0.0
        if isinstance(shape, Cone):
            radii *= (half - inner[:, 2]) / shape.length
        lengths = np.maximum(np.linalg.norm(across, axis=1), np.finfo(float).tiny)
        inner += across * np.minimum(radii / lengths, 1.0)[:, None]
    return float(np.linalg.norm((points - inner) * scale, axis=1).max()) * (1.0 + 64 * ROUNDOFF)


def geodesic_sphere(rounds: int) -> Floats:
    """Return points (n, 3) on the unit sphere: an icosahedron, its edges halved in each round.

    There are 12, 42, 162, ... points after 0, 1, 2, ... rounds.
    """
    a, b = 1.0, 0.5 * (1.0 + math.sqrt(5.0))
    signs = [(p, q) for p in (-1.0, 1.0) for q in (-1.0, 1.0)]
    points = np.array([np.roll((0.0, p * a, q * b), k) for p, q in signs for k in range(3)])
    points /= np.linalg.norm(points, axis=1)[:, None]
    for _ in range(rounds):
        faces = _faces(points)
        edges = np.sort(np.concatenate([faces[:, :2], faces[:, 1:], faces[:, ::2]]), axis=1)
        middles = points[np.unique(edges, axis=0)].sum(axis=1)
        points = np.concatenate([points, middles / np.linalg.norm(middles, axis=1)[:, None]])
    return points


@cache
def _outer_sphere() -> Floats:
    """Return points whose hull contains the unit sphere; they are 3.6 % farther out."""
    points = geodesic_sphere(2)
    a, b, c = points[_faces(points)].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    depths = np.abs(np.einsum("ij,ij->i", normals, a)) / np.linalg.norm(normals, axis=1)
    return points / depths.min()


def _outer_ring(radius: float, height: float) -> Floats:
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    reach = radius / math.cos(math.pi / SIDES)
    heights = np.full(SIDES, height)
    return np.stack([reach * np.cos(angles), reach * np.sin(angles), heights], axis=1)


def _faces(points: Floats) -> Integers:
    hull = convex_hull(points)
    assert hull is not None
    return hull.simplices.astype(np.int64)
