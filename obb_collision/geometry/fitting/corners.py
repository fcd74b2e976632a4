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

"""The points of which axes are chosen: the corners of the convex hull, or some of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.fitting.convex_hull import convex_hull
from obb_collision.typing import Floats

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

#: Maximum number of hull corners used for choosing axes; above it, those extreme in DIRECTIONS
#: directions: 10,000 take trimesh 0.3 s, a round rim of 20,000 takes gigabytes.
MANY_CORNERS = 2000
#: Maximum number of points of which the hull is made: a million on a sphere take Qhull 10 s.
MANY_POINTS = 100_000
#: Directions spread evenly over a half sphere; two extreme points each.
DIRECTIONS = 256


@dataclass(frozen=True)
class Corners:
    """At most a few thousand points (n, 3) for choosing axes: the corners of the hull, or some.

    hull: theirs, None where they are flat; complete: whether their box is that of all points.
    """

    points: Floats
    hull: ConvexHull | None
    complete: bool

    @property
    def triangles(self) -> Floats:
        """(m, 3, 3) the triangles of the hull."""
        assert self.hull is not None
        return self.points[self.hull.simplices]


def few_corners(points: Floats, frame: Floats, rank: int) -> Corners:
    """Return what stands for points about the origin, of principal axes ``frame``, in a choice."""
    few = len(points) <= MANY_POINTS
    hull = convex_hull(points) if few and rank == 3 else None
    if few and len(points if hull is None else hull.vertices) <= MANY_CORNERS:
        return Corners(points, hull, True)
    along = points @ frame
    widths = np.ptp(along, axis=0)
    along /= np.where(widths > 0.0, widths, 1.0)  # thin sets have two sides too
    chosen = points[_extreme_rows(along, _half_sphere(DIRECTIONS))]
    return Corners(chosen, convex_hull(chosen) if rank == 3 else None, False)


def _half_sphere(count: int) -> Floats:
    """Return unit vectors (3, count) spread evenly over a half sphere (Fibonacci's spiral)."""
    z = (np.arange(count) + 0.5) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z])


def _extreme_rows(points: Floats, directions: Floats, block: int = 16384) -> NDArray[np.intp]:
    """Return the rows of points (n, 3) that are lowest or highest in directions (3, m)."""
    lowest = np.full(directions.shape[1], np.inf)
    highest = -lowest
    rows = np.zeros((2, directions.shape[1]), np.intp)
    for start in range(0, len(points), block):
        heights = directions.T @ points[start : start + block].T
        for extreme, pick, row, sign in (
            (lowest, heights.argmin(axis=1), rows[0], 1.0),
            (highest, heights.argmax(axis=1), rows[1], -1.0),
        ):
            found = np.take_along_axis(heights, pick[:, None], axis=1)[:, 0]
            better = sign * found < sign * extreme
            extreme[better] = found[better]
            row[better] = start + pick[better]
    return np.unique(rows)
