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

"""A convex polytope of few corners about a hull of many, as close to it as greedy cuts make it.

It begins as the box of the points. Where it is farthest from them it is cut by a plane that touches
them, again and again: so corners that would be far out, as those of needles and wedges, are cut
first, and smooth parts get planes as their curvature needs them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision.geometry.fitting.convex_hull import convex_hull
from obb_collision.geometry.trees.circumscribed import geodesic_sphere
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

    inner: (n, 3) points, the corners of whose hull are those of its faces (m, 3); cuts are chosen
    by them.
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
    found = _corners(normals[chosen], reach, half)
    while found is not None and len(found) > most:  # where they touch others than those of inner
        chosen = chosen[: -(len(found) - most)]
        found = _corners(normals[chosen], reach[: len(chosen)], half)
    return None if found is None else middle + found


def _chosen_cuts(cuts: Directions, half: Floats, most: int) -> Integers:
    """Return the rows of the directions to cut in, so that there are at most so many corners."""
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
    """Return the corners (k, 3) of what planes leave, which have the origin inside.

    Polar duality: the plane n.x = d maps to the point n / d, so the corners are the planes of the
    hull of those points; in a frame in which the box of the points is a cube.
    """
    if not (reach > THINNEST * half.min()).all():
        return None
    planes = convex_hull(normals * half / reach[:, None])
    if planes is None:
        return None
    # Of the triangles: Qhull's equations are those of points that it has scaled.
    triangles = planes.points[planes.simplices]
    outward = _normals(triangles)
    offsets = np.einsum("ij,ij->i", outward, triangles[:, 0])
    sound = offsets != 0.0
    corners = outward[sound] / offsets[sound, None]
    return np.unique(np.round(corners / SAME_CORNER) * SAME_CORNER, axis=0) * half


def _middle_and_normals(corners: Floats, faces: Integers, half: Floats) -> tuple[Floats, Floats]:
    """Return the centroid (3,) of a hull and directions (n, 3) to cut in: those of its box first.

    Then some all around, normals of faces, and the means of normals around corners.
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
