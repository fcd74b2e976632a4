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

"""Boxes: many oriented boxes as a structure of arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision.geometry.kinds import taken
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.validation import as_array, as_half_extents, as_rotations
from obb_collision.numerics.constants import BOUND_SLACK, BOUND_UNDERFLOW
from obb_collision.numerics.error_free import two_sum_error
from obb_collision.typing import Floats


@dataclass(frozen=True, eq=False)
class Boxes:
    """n oriented boxes: box k is centers[k] + sum_i t_i half_extents[k, i] rotations[k, :, i].

    centers (n, 3) metres; rotations (n, 3, 3), columns are the box axes; half extents (n, 3)
    metres, zero allowed. All float64. Raises ValueError naming the argument and the row for
    anything else; rotations within 1e-6 of orthonormal are made orthonormal.
    """

    centers: Floats
    rotations: Floats
    half_extents: Floats

    def __init__(self, centers: ArrayLike, rotations: ArrayLike, half_extents: ArrayLike) -> None:
        c = as_array(centers, "centers", (None, 3))
        r = as_rotations(rotations, "rotations", (None, 3, 3))
        h = as_half_extents(half_extents, "half_extents", (None, 3))
        if not len(c) == len(r) == len(h):
            raise ValueError(
                "centers, rotations and half_extents must have the same length, "
                f"got {len(c)}, {len(r)} and {len(h)}"
            )
        self._set(c.copy(), r.copy(), h)  # what is checked must not change behind our back

    def _set(self, centers: Floats, rotations: Floats, half_extents: Floats) -> None:
        # past the guard of a frozen value, at a third of what object.__setattr__ takes
        vars(self).update(centers=centers, rotations=rotations, half_extents=half_extents)

    @classmethod
    def trusted(cls, centers: Floats, rotations: Floats, half_extents: Floats) -> Boxes:
        """Return boxes over arrays known to be valid, neither checked nor copied."""
        boxes = cls.__new__(cls)
        boxes._set(centers, rotations, half_extents)
        return boxes

    @classmethod
    def from_poses(cls, poses: ArrayLike, half_extents: ArrayLike) -> Boxes:
        """Return boxes from poses (n, 7), x y z qx qy qz qw; quaternions are normalised."""
        centers, rotations = as_poses(poses)
        h = as_half_extents(half_extents, "half_extents", (None, 3))
        if len(h) != len(centers):
            raise ValueError(
                f"poses and half_extents must have the same length, got {len(centers)} and {len(h)}"
            )
        return cls.trusted(centers, rotations, h)

    def __len__(self) -> int:
        return len(self.centers)

    def row(self, index: int | np.integer) -> tuple[Floats, Floats, Floats]:
        """Return centre (3,), rotation (3, 3) and half extents (3,) of one box, as views."""
        center = taken(self.centers, index, "index", 1)
        return center, self.rotations[index], self.half_extents[index]

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Boxes:
        """Return the boxes of an index array or mask, in that order."""
        centers = taken(self.centers, rows, "rows", 2)
        return Boxes.trusted(centers, self.rotations[rows], self.half_extents[rows])

    def padded(self, margin: float) -> Boxes:
        """Return boxes grown by ``margin`` metres on every side, rounded outwards."""
        pad = as_array(margin, "margin", ())
        if pad < 0.0:
            raise ValueError("margin must not be negative")
        if pad == 0.0:
            return self
        return Boxes.trusted(self.centers, self.rotations, add_outwards(self.half_extents, pad))

    def world_bounds(self) -> tuple[Floats, Floats]:
        """Return minimum and maximum (n, 3) of axis-aligned boxes that certainly contain these.

        Exact where that is representable and the box is axis-aligned, else rounded outwards.
        """
        minimum = np.empty((len(self), 3))
        maximum = np.empty((len(self), 3))
        world_bounds_kernel(self.centers, self.rotations, self.half_extents, minimum, maximum)
        return minimum, maximum


def add_outwards(extents: Floats, margin: Floats) -> Floats:
    """Return extents + margin, rounded up where the sum is not exact (two-sum, Knuth)."""
    total = extents + margin
    back = total - extents
    error = (extents - (total - back)) + (margin - back)
    result: Floats = np.where(error > 0.0, np.nextafter(total, np.inf), total)
    return result


@njit
def world_bounds_kernel(
    centers: Floats, rotations: Floats, half_extents: Floats, minimum: Floats, maximum: Floats
) -> None:
    """Write axis-aligned bounds (n, 3) that certainly contain each box."""
    for n in range(len(centers)):
        for k in range(3):
            radius = 0.0
            aligned = 0
            for i in range(3):
                weight = abs(rotations[n, k, i])
                radius += weight * half_extents[n, i]
                if weight == 0.0 or weight == 1.0:
                    aligned += 1
            center = centers[n, k]
            low = center - radius
            high = center + radius
            slack = BOUND_SLACK * (abs(center) + radius) + BOUND_UNDERFLOW
            if aligned < 3 or two_sum_error(center, -radius) < 0.0:
                low -= slack
            if aligned < 3 or two_sum_error(center, radius) > 0.0:
                high += slack
            minimum[n, k] = low
            maximum[n, k] = high
