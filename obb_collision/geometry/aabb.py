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

"""AABB: one axis-aligned box, two corners. Its questions are comparisons, so they are exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.kinds import check_kind
from obb_collision.geometry.validation import as_array, is_single
from obb_collision.typing import Floats


@dataclass(frozen=True, eq=False)
class AABB:
    """The closed axis-aligned box between ``minimum`` (3,) and ``maximum`` (3,), metres.

    Raises ValueError for anything not finite, or a minimum above the maximum.
    """

    minimum: Floats
    maximum: Floats

    def __init__(self, minimum: ArrayLike, maximum: ArrayLike) -> None:
        low = as_array(minimum, "minimum", (3,)).copy()
        high = as_array(maximum, "maximum", (3,)).copy()
        if (low > high).any():
            raise ValueError("minimum must not exceed maximum")
        object.__setattr__(self, "minimum", low)
        object.__setattr__(self, "maximum", high)

    @classmethod
    def from_points(cls, points: ArrayLike) -> AABB:
        """Return the smallest AABB of points (n, 3); ValueError if there are none."""
        cloud = as_array(points, "points", (None, 3))
        if len(cloud) == 0:
            raise ValueError("points must not be empty")
        return cls(cloud.min(axis=0), cloud.max(axis=0))

    def intersects(self, other: AABB) -> bool:
        """Return whether the two closed boxes have a common point; touching counts."""
        check_kind(other, AABB, "other")
        apart = (self.minimum > other.maximum) | (other.minimum > self.maximum)
        return not bool(apart.any())

    def contains(self, points: ArrayLike) -> bool | NDArray[np.bool_]:
        """Return whether the point (3,) -> bool, or each point (n, 3) -> (n,), lies inside."""
        single = is_single(points)
        cloud = as_array(points, "points", (3,) if single else (None, 3))
        inside = ((cloud >= self.minimum) & (cloud <= self.maximum)).all(axis=-1)
        return bool(inside) if single else np.asarray(inside)

    def corners(self) -> Floats:
        """Return the 8 corners (8, 3), in the documented order of ``OBB.corners``."""
        from_sign = (CORNER_SIGNS + 1.0) / 2.0
        result: Floats = np.where(from_sign == 1.0, self.maximum, self.minimum)
        return result

    def __repr__(self) -> str:
        return f"AABB(minimum={self.minimum.tolist()}, maximum={self.maximum.tolist()})"


#: Signs of the corners along the box axes: on the +z face left-top, left-bottom, right-bottom,
#: right-top; then on the -z face right-top, right-bottom, left-bottom, left-top.
CORNER_SIGNS: Floats = np.array(
    [
        [-1.0, 1.0, 1.0],
        [-1.0, -1.0, 1.0],
        [1.0, -1.0, 1.0],
        [1.0, 1.0, 1.0],
        [1.0, 1.0, -1.0],
        [1.0, -1.0, -1.0],
        [-1.0, -1.0, -1.0],
        [-1.0, 1.0, -1.0],
    ]
)
