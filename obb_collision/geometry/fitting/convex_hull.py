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

"""Convex hulls by Qhull, and the rotating calipers on their outline."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from obb_collision.typing import Floats

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

#: With more points, Qhull moves them by roundoffs (QJ) instead of merging flat faces (Qt).
MANY_HULL_POINTS = 1000


def convex_hull(points: Floats) -> ConvexHull | None:
    """Return the convex hull of points (n, 2) or (n, 3); None where they are too flat for it.

    Scaled to a cube (QbB), so that thin sets work. Qhull takes quadratic time on faces with
    thousands of corners (2.3 s for a cylinder of 10,000 points) unless it moves them by roundoffs
    (QJ, 0.1 s); either is good enough for choosing axes.
    """
    from scipy.spatial import ConvexHull, QhullError  # here, as it takes 0.2 s

    options = "QbB Qt" if len(points) <= MANY_HULL_POINTS or points.shape[1] == 2 else "QbB QJ"
    try:
        return ConvexHull(points, qhull_options=options)
    except (QhullError, ValueError):
        return None


def hull_volume(points: Floats) -> float:
    """Return the volume of the convex hull, 0 where it is flat. No box is smaller."""
    hull = convex_hull(points)
    if hull is None:
        return 0.0
    # From the triangles: Qhull reports the volume of the scaled points.
    return float(np.abs(np.linalg.det(points[hull.simplices] - points.mean(axis=0))).sum() / 6.0)


def hull_polygon(points: Floats) -> Floats | None:
    """Return the hull (m, 2) of points (n, 2), counter-clockwise; None where they are a line."""
    hull = convex_hull(points)
    return None if hull is None else points[hull.vertices]


def minimum_rectangle_direction(polygon: Floats) -> Floats:
    """Return the direction (2,) of a side of the minimum-area rectangle about a convex polygon.

    Rotating calipers (Toussaint 1983): a side of the rectangle lies on an edge of the polygon
    (Freeman and Shapira 1975), and the extreme corners for an edge are found by its angle.
    """
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    polygon, edges = polygon[lengths > 0.0], edges[lengths > 0.0] / lengths[lengths > 0.0, None]
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    start = int(angles.argmin())
    order = np.r_[start : len(angles), 0:start]
    polygon, edges = polygon[order], edges[order]
    angles = np.maximum.accumulate(angles[order])

    def farthest(directions: Floats) -> Floats:
        # Corner k is extreme between the outward normals of the edges before and after it.
        turned = np.arctan2(directions[:, 0], -directions[:, 1])  # + 90 degrees: along the edge
        corner = np.searchsorted(angles, turned) % len(polygon)
        return np.einsum("ij,ij->i", polygon[corner], directions)

    across = np.column_stack([edges[:, 1], -edges[:, 0]])
    length = farthest(edges) + farthest(-edges)
    width = farthest(across) + farthest(-across)
    return edges[int((length * width).argmin())]
