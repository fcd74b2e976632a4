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

"""AABB: one axis-aligned box, two corners; and the bounds of boxes in the world.

Its questions are comparisons, so they are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision.geometry.validation import as_array, check_kind, is_single, refuse_where
from obb_collision.geometry.values import ArrayValue
from obb_collision.numerics.constants import BOUND_SLACK, BOUND_UNDERFLOW
from obb_collision.numerics.error_free import two_sum_error
from obb_collision.numerics.vec3 import dot_abs, rows_at, vector_at
from obb_collision.typing import Axes, Floats, Vector

#: Signs of the corners along the box axes: on the +z face left-top, left-bottom, right-bottom,
#: right-top; then on the -z face right-top, right-bottom, left-bottom, left-top.
_RING = [[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]]
CORNER_SIGNS: Floats = np.array(
    [[*xy, 1.0] for xy in _RING] + [[*xy, -1.0] for xy in reversed(_RING)]
)


@dataclass(frozen=True, eq=False, repr=False)
class AABB(ArrayValue):
    """The closed axis-aligned box between two corners. Equal where both corners are.

    Parameters
    ----------
    minimum, maximum : (3,) array_like
        Metres.

    Raises
    ------
    ValueError
        For anything not finite, or a minimum above the maximum.

    Examples
    --------
    >>> box = oc.AABB([0, 0, 0], [1, 1, 1])
    >>> box.intersects(oc.AABB([1, 0, 0], [2, 1, 1]))  # touching counts
    True
    """

    minimum: Floats
    maximum: Floats

    def __init__(self, minimum: ArrayLike, maximum: ArrayLike) -> None:
        low = as_array(minimum, "minimum", (3,)).copy()
        high = as_array(maximum, "maximum", (3,)).copy()
        refuse_where(low > high, "minimum must not exceed maximum", by_row=False)
        for corner in (low, high):
            corner.flags.writeable = False
        vars(self).update(minimum=low, maximum=high)

    @classmethod
    def from_points(cls, points: ArrayLike) -> AABB:
        """Return the smallest box of points.

        Parameters
        ----------
        points : (n, 3) array_like
            Metres, at least one.

        Raises
        ------
        ValueError
            If there are none, or they are no points.

        Examples
        --------
        >>> oc.AABB.from_points([[0, 5, 0], [1, 2, 3]])
        AABB(minimum=[0.0, 2.0, 0.0], maximum=[1.0, 5.0, 3.0])
        """
        cloud = as_array(points, "points", (None, 3))
        if len(cloud) == 0:
            raise ValueError("points must not be empty")
        return cls(cloud.min(axis=0), cloud.max(axis=0))

    def intersects(self, other: AABB) -> bool:
        """Return whether two closed boxes have a common point; touching counts.

        Parameters
        ----------
        other : AABB

        Examples
        --------
        >>> oc.AABB([0, 0, 0], [1, 1, 1]).intersects(oc.AABB([2, 0, 0], [3, 1, 1]))
        False
        """
        check_kind(other, AABB, "other")
        apart = (self.minimum > other.maximum) | (other.minimum > self.maximum)
        return not bool(apart.any())

    def contains(self, points: ArrayLike) -> bool | NDArray[np.bool_]:
        """Return which points lie inside; the surface counts.

        Parameters
        ----------
        points : (3,) or (n, 3) array_like
            Metres.

        Returns
        -------
        bool or (n,) array of bool

        Raises
        ------
        ValueError
            For points of another shape.

        Examples
        --------
        >>> oc.AABB([0, 0, 0], [1, 1, 1]).contains([1, 0.5, 0])
        True
        """
        single = is_single(points)
        cloud = as_array(points, "points", (3,) if single else (None, 3))
        inside = ((cloud >= self.minimum) & (cloud <= self.maximum)).all(axis=-1)
        return bool(inside) if single else np.asarray(inside)

    def corners(self) -> Floats:
        """Return the corners.

        Returns
        -------
        (8, 3) array
            Metres, in the order of ``OBB.corners``.

        Examples
        --------
        >>> oc.AABB([0, 0, 0], [1, 2, 3]).corners()[0].tolist()
        [0.0, 2.0, 3.0]
        """
        return np.where(CORNER_SIGNS > 0.0, self.maximum, self.minimum)

    def __repr__(self) -> str:
        return f"AABB(minimum={self.minimum.tolist()}, maximum={self.maximum.tolist()})"


@njit
def world_bounds_kernel(
    centers: Floats, rotations: Floats, half_extents: Floats, minimum: Floats, maximum: Floats
) -> None:
    """Write axis-aligned bounds (n, 3) that certainly contain each box."""
    for n in range(len(centers)):
        rows, h = rows_at(rotations, n), vector_at(half_extents, n)
        low, high = world_bounds_of(vector_at(centers, n), rows, h)
        for k in range(3):
            minimum[n, k], maximum[n, k] = low[k], high[k]


@njit
def world_bounds_of(center: Vector, rows: Axes, half_extents: Vector) -> tuple[Vector, Vector]:
    """Return axis-aligned bounds that certainly contain a box; rows: of its rotation matrix."""
    x0, x1 = _bounds_along(center[0], rows[0], half_extents)
    y0, y1 = _bounds_along(center[1], rows[1], half_extents)
    z0, z1 = _bounds_along(center[2], rows[2], half_extents)
    return (x0, y0, z0), (x1, y1, z1)


@njit
def _bounds_along(center: float, row: Vector, half_extents: Vector) -> tuple[float, float]:
    """Return the bounds along one axis of the world."""
    radius = dot_abs(half_extents, row)
    low, high = center - radius, center + radius
    slack = BOUND_SLACK * (abs(center) + radius) + BOUND_UNDERFLOW
    if not (_is_plain(row[0]) & _is_plain(row[1]) & _is_plain(row[2])):
        return low - slack, high + slack
    return (
        low - slack if two_sum_error(center, -radius) < 0.0 else low,
        high + slack if two_sum_error(center, radius) > 0.0 else high,
    )


@njit
def _is_plain(weight: float) -> bool:
    """Return whether a product with it is exact."""
    return (weight == 0.0) | (abs(weight) == 1.0)
