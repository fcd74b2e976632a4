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

"""Clouds: shapes made of balls of one radius, about the points that a sensor measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision.geometry.shapes.primitives import NO_SCALE, LocalBox, Shape, Triple, read_only
from obb_collision.geometry.trees.bounds_tree import BoundsTree
from obb_collision.geometry.validation import as_array, as_points, check_magnitude
from obb_collision.geometry.values import read_only_view
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.typing import Floats


@dataclass(frozen=True, init=False, eq=False)
class Cloud(Shape):
    """The closed balls of one radius about points: a cloud of a depth camera or a lidar.

    A cloud has no inside, and collides with no other cloud. Below the level "obb" its bounds stand
    for it. From "obb" on its balls are tested against the box, hull or triangles of the other
    object.

    Parameters
    ----------
    points : (n, 3) array_like
        Metres, float32 or float64; rows that are not finite are left out, and counted in
        ``ignored``. A cloud without points collides with nothing.
    radius : float
        Metres, not negative.

    Examples
    --------
    >>> cloud = oc.shapes.Cloud([[1, 0, 0], [3, 0, 0], [np.nan, 0, 0]], radius=0.5)
    >>> len(cloud.points), cloud.ignored, cloud.local_box[2].round(9).tolist()
    (2, 1, [1.5, 0.5, 0.5])
    """

    points: Floats
    radius: float
    ignored: int
    scale: Triple
    _bounds: Floats

    def __init__(self, points: ArrayLike, radius: float = 0.0) -> None:
        rows = as_points(points, "points")
        reach = float(as_array(radius, "radius", ()))
        if reach < 0.0:
            raise ValueError(f"radius must not be negative, got {reach!r}")
        kept, bounds = np.empty((len(rows), 3)), np.empty((2, 3))
        count = _take_finite(read_only_view(np.ascontiguousarray(rows)), kept, bounds)
        if np.abs(bounds).max() > MAX_MAGNITUDE:
            check_magnitude(kept[:count], "points", by_row=True)
        points = kept if count == len(rows) else kept[:count].copy()
        for array in (points, bounds):
            array.setflags(write=False)
        ignored = len(rows) - count
        self._store(points=points, radius=reach, ignored=ignored, scale=NO_SCALE, _bounds=bounds)

    @cached_property
    def local_box(self) -> LocalBox:
        """Centre (3,), rotation (3, 3), half extents (3,): the bounds of the balls."""
        low, high = self._bounds
        center = 0.5 * low + 0.5 * high
        half = np.maximum(high - center, center - low) + self.radius
        half = np.nextafter(np.nextafter(half, np.inf), np.inf) if len(self.points) else 0.0 * half
        check_magnitude(half, "points and radius", by_row=False)
        return read_only(center, np.eye(3), half)

    @cached_property
    def tree(self) -> BoundsTree:
        """The tree over the points, built when first needed."""
        return BoundsTree.build(self.points, self.points)


@njit
def _take_finite(rows: np.ndarray, out: Floats, bounds: Floats) -> int:
    """Copy the rows (n, 3) that are finite; return their number, write their bounds (2, 3)."""
    count, low, high = 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for n in range(len(rows)):
        x, y, z = float(rows[n, 0]), float(rows[n, 1]), float(rows[n, 2])
        if not math.isfinite((x - x) + (y - y) + (z - z)):
            continue
        if count == 0:
            low = high = x, y, z
        low = min(low[0], x), min(low[1], y), min(low[2], z)
        high = max(high[0], x), max(high[1], y), max(high[2], z)
        out[count, 0], out[count, 1], out[count, 2] = x, y, z
        count += 1
    for k in range(3):
        bounds[0, k], bounds[1, k] = low[k], high[k]
    return count
