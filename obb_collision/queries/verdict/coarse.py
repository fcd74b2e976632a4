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

"""Cheaper answers than the certified test of two boxes, which never miss a collision.

Spheres: around each box, radius the length of its half extents. Apart if the distance of the
centres exceeds the sum of the radii by SPHERE_SLACK. That is 2^9 times the bound up to which
``verdict`` gives TOUCHING, and axes orthonormal to 64 roundoffs only add 2^-47 to a radius.
Bounds: world AABBs, grown so that boxes whose bounds are apart are SEPARATE for ``verdict``,
too, not merely apart. Boxes that are a distance d apart have a gap of at least d / sqrt(3) along
one of the 15 axes: the direction of the distance lies among at most three of these, no two of them
more than a right angle apart. So MEETING_SLACK makes that gap certain, twice the bound there.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.boxes import Boxes, world_bounds_of
from obb_collision.numerics.constants import ROUNDOFF, UNDERFLOW
from obb_collision.numerics.vec3 import lengths, minus, norm, rows_at, sum_abs, vector_at
from obb_collision.typing import Columns, Floats, Integers, Mask

#: Slack of the sphere test relative to the distance and the radii (see above).
SPHERE_SLACK = 8192 * ROUNDOFF
#: Growth of bounds relative to abs(c_x) + abs(c_y) + abs(c_z) + the half extents (see above).
MEETING_SLACK = 64 * ROUNDOFF
#: Added to the growth: more than ``verdict`` adds for underflow.
MEETING_UNDERFLOW = 4 * UNDERFLOW

#: Boxes below which a second thread does not pay: 30 us of bounds.
FEWEST_BOXES = 2048


def meeting_bounds(boxes: Boxes) -> tuple[Floats, Floats]:
    """Return minimum and maximum (n, 3) of bounds that overlap for all boxes not SEPARATE."""
    minimum, maximum = np.empty((len(boxes), 3)), np.empty((len(boxes), 3))
    rows = np.arange(len(boxes))
    run(bounds_kernel, len(boxes), FEWEST_BOXES, tuple(boxes.arrays), rows, minimum, maximum)
    return minimum, maximum


def sphere_bounds(boxes: Boxes) -> tuple[Floats, Floats]:
    """Return minimum and maximum (n, 3) that hold each box's ``meeting_bounds`` and its sphere.

    If ``spheres_may_collide`` reports a pair, these bounds certainly overlap.
    """
    minimum, maximum = meeting_bounds(boxes)
    radii = lengths(boxes.arrays.half_extents)
    reach = radii[:, None] + 4.0 * SPHERE_SLACK * (np.abs(boxes.centers) + radii[:, None])
    return np.minimum(minimum, boxes.centers - reach), np.maximum(maximum, boxes.centers + reach)


def bounds_of(boxes: Boxes, spheres: bool) -> tuple[Floats, Floats]:
    """Return ``sphere_bounds`` of boxes, or ``meeting_bounds``."""
    return sphere_bounds(boxes) if spheres else meeting_bounds(boxes)


def spheres_may_collide(boxes: Boxes, rows_a: Integers, rows_b: Integers) -> Mask:
    """Return (m,) whether the spheres around two boxes may have a common point."""
    out = np.empty(len(rows_a), np.bool_)
    centers, _, half_extents = boxes.arrays
    _sphere_kernel(centers, half_extents, rows_a, rows_b, out)
    return out


def bounds_may_collide(boxes: Boxes, rows_a: Integers, rows_b: Integers) -> Mask:
    """Return (m,) whether the ``meeting_bounds`` of two boxes have a common point."""
    low_a, high_a = meeting_bounds(boxes[rows_a])
    low_b, high_b = meeting_bounds(boxes[rows_b])
    return np.asarray(((low_a <= high_b) & (low_b <= high_a)).all(axis=1))


@njit
def bounds_kernel(
    boxes: Columns, rows: np.ndarray, minimum: Floats, maximum: Floats, start: int, stop: int
) -> None:
    """Write the ``meeting_bounds`` of rows ``rows[start:stop]`` to the same rows."""
    centers, rotations, half_extents = boxes
    for number in range(start, stop):
        n = rows[number]
        low, high = world_bounds_of(
            vector_at(centers, n), rows_at(rotations, n), vector_at(half_extents, n)
        )
        for k in range(3):
            minimum[n, k], maximum[n, k] = low[k], high[k]
    for number in range(start, stop):  # one loop for both takes three times as long
        n = rows[number]
        size = sum_abs(vector_at(centers, n))
        size += half_extents[n, 0] + half_extents[n, 1] + half_extents[n, 2]
        slack = MEETING_SLACK * size + MEETING_UNDERFLOW
        for k in range(3):
            minimum[n, k] -= slack
            maximum[n, k] += slack


@njit
def _sphere_kernel(
    centers: Floats, half_extents: Floats, rows_a: np.ndarray, rows_b: np.ndarray, out: np.ndarray
) -> None:
    for n in range(len(rows_a)):
        i, j = rows_a[n], rows_b[n]
        distance = norm(minus(vector_at(centers, j), vector_at(centers, i)))
        radii = norm(vector_at(half_extents, i)) + norm(vector_at(half_extents, j))
        out[n] = distance - radii <= SPHERE_SLACK * (distance + radii) + UNDERFLOW
