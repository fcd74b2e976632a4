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

"""May two boxes collide? Cheaper answers than the certified test, which never miss what it finds.

Spheres: around each box, radius the length of its half extents. Apart if the distance of the
centres exceeds the sum of the radii by SPHERE_SLACK. That is 2^9 times the bound up to which
``separation`` gives TOUCHING, and axes orthonormal to 64 roundoffs only add 2^-47 to a radius.
Faces: the first 6 of the 15 axes, with the bound of the fast stage, so that what is apart here is
apart there.
Bounds: world AABBs, grown so that boxes whose bounds are apart are SEPARATE for ``separation``,
too, not merely apart. Boxes that are a distance d apart have a gap of at least d / sqrt(3) along
one of the 15 axes: the direction of the distance lies among at most three of these, no two of them
more than a right angle apart. So MEETING_SLACK makes that gap certain, twice the bound there.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.numerics.constants import FAST_BOUND, ROUNDOFF, UNDERFLOW
from obb_collision.numerics.error_free import length
from obb_collision.typing import Floats, Integers, Mask

#: Slack of the sphere test relative to the distance and the radii (see above).
SPHERE_SLACK = 8192 * ROUNDOFF
#: Growth of bounds relative to abs(c_x) + abs(c_y) + abs(c_z) + the half extents (see above).
MEETING_SLACK = 64 * ROUNDOFF
#: Added to it: more than what ``separation`` adds for underflow.
MEETING_UNDERFLOW = 4 * UNDERFLOW


def meeting_bounds(boxes: Boxes) -> tuple[Floats, Floats]:
    """Return minimum and maximum (n, 3) of bounds which overlap for all boxes not SEPARATE."""
    minimum, maximum = boxes.world_bounds()
    _grow_kernel(boxes.centers, boxes.half_extents, minimum, maximum)
    return minimum, maximum


def sphere_bounds(boxes: Boxes) -> tuple[Floats, Floats]:
    """Return minimum and maximum (n, 3) that hold each box's ``meeting_bounds`` and its sphere.

    Of two spheres that ``spheres_meet`` reports these bounds certainly overlap.
    """
    minimum, maximum = meeting_bounds(boxes)
    radii = np.empty(len(boxes))
    _radius_kernel(boxes.half_extents, radii)
    reach = radii[:, None] + 4.0 * SPHERE_SLACK * (np.abs(boxes.centers) + radii[:, None])
    return (
        np.minimum(minimum, boxes.centers - reach),
        np.maximum(maximum, boxes.centers + reach),
    )


def spheres_meet(boxes: Boxes, rows_a: Integers, rows_b: Integers) -> Mask:
    """Return (m,) whether the spheres around two boxes may have a common point."""
    out = np.empty(len(rows_a), np.bool_)
    _sphere_kernel(boxes.centers, boxes.half_extents, rows_a, rows_b, out)
    return out


def bounds_meet(boxes: Boxes, rows_a: Integers, rows_b: Integers) -> Mask:
    """Return (m,) whether the ``meeting_bounds`` of two boxes have a common point."""
    low_a, high_a = meeting_bounds(boxes.take(rows_a))
    low_b, high_b = meeting_bounds(boxes.take(rows_b))
    return np.asarray(((low_a <= high_b) & (low_b <= high_a)).all(axis=1))


def faces_meet(boxes: Boxes, rows_a: Integers, rows_b: Integers) -> Mask:
    """Return (m,) whether none of the six face normals separates two boxes certainly."""
    out = np.empty(len(rows_a), np.bool_)
    _faces_kernel(boxes.centers, boxes.rotations, boxes.half_extents, rows_a, rows_b, out)
    return out


@njit
def _grow_kernel(centers: Floats, half_extents: Floats, minimum: Floats, maximum: Floats) -> None:
    for n in range(len(centers)):
        size = abs(centers[n, 0]) + abs(centers[n, 1]) + abs(centers[n, 2])
        size += half_extents[n, 0] + half_extents[n, 1] + half_extents[n, 2]
        slack = MEETING_SLACK * size + MEETING_UNDERFLOW
        for k in range(3):
            minimum[n, k] -= slack
            maximum[n, k] += slack


@njit
def _radius_kernel(half_extents: Floats, out: Floats) -> None:
    for n in range(len(half_extents)):
        out[n] = length(half_extents[n, 0], half_extents[n, 1], half_extents[n, 2])


@njit
def _sphere_kernel(
    centers: Floats, half_extents: Floats, rows_a: np.ndarray, rows_b: np.ndarray, out: np.ndarray
) -> None:
    for n in range(len(rows_a)):
        i, j = rows_a[n], rows_b[n]
        distance = length(
            centers[j, 0] - centers[i, 0],
            centers[j, 1] - centers[i, 1],
            centers[j, 2] - centers[i, 2],
        )
        radii = length(half_extents[i, 0], half_extents[i, 1], half_extents[i, 2]) + length(
            half_extents[j, 0], half_extents[j, 1], half_extents[j, 2]
        )
        out[n] = distance - radii <= SPHERE_SLACK * (distance + radii) + UNDERFLOW


@njit
def _faces_kernel(
    centers: Floats, axes: Floats, half_extents: Floats,
    rows_a: np.ndarray, rows_b: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    for n in range(len(rows_a)):
        out[n] = not _faces_separate(centers, axes, half_extents, rows_a[n], rows_b[n])


@njit
def _faces_separate(c: Floats, a: Floats, h: Floats, i: int, j: int) -> bool:
    """Return whether a face normal of box i or j separates the two; as in ``classify_fast``.

    c: centres (n, 3); a: axes (n, 3, 3); h: half extents (n, 3). Written out, as there: loops
    over the axes take longer than all 15 of them written out (50 against 35 ns a pair).
    """
    x, y, z = c[j, 0] - c[i, 0], c[j, 1] - c[i, 1], c[j, 2] - c[i, 2]
    h0, h1, h2 = h[i, 0], h[i, 1], h[i, 2]
    f0, f1, f2 = h[j, 0], h[j, 1], h[j, 2]
    bound = abs(x) + abs(y) + abs(z) + (h0 + h1 + h2) + (f0 + f1 + f2)
    bound = FAST_BOUND * bound + UNDERFLOW
    r00 = a[i, 0, 0] * a[j, 0, 0] + a[i, 1, 0] * a[j, 1, 0] + a[i, 2, 0] * a[j, 2, 0]
    r01 = a[i, 0, 0] * a[j, 0, 1] + a[i, 1, 0] * a[j, 1, 1] + a[i, 2, 0] * a[j, 2, 1]
    r02 = a[i, 0, 0] * a[j, 0, 2] + a[i, 1, 0] * a[j, 1, 2] + a[i, 2, 0] * a[j, 2, 2]
    r10 = a[i, 0, 1] * a[j, 0, 0] + a[i, 1, 1] * a[j, 1, 0] + a[i, 2, 1] * a[j, 2, 0]
    r11 = a[i, 0, 1] * a[j, 0, 1] + a[i, 1, 1] * a[j, 1, 1] + a[i, 2, 1] * a[j, 2, 1]
    r12 = a[i, 0, 1] * a[j, 0, 2] + a[i, 1, 1] * a[j, 1, 2] + a[i, 2, 1] * a[j, 2, 2]
    r20 = a[i, 0, 2] * a[j, 0, 0] + a[i, 1, 2] * a[j, 1, 0] + a[i, 2, 2] * a[j, 2, 0]
    r21 = a[i, 0, 2] * a[j, 0, 1] + a[i, 1, 2] * a[j, 1, 1] + a[i, 2, 2] * a[j, 2, 1]
    r22 = a[i, 0, 2] * a[j, 0, 2] + a[i, 1, 2] * a[j, 1, 2] + a[i, 2, 2] * a[j, 2, 2]
    t0 = a[i, 0, 0] * x + a[i, 1, 0] * y + a[i, 2, 0] * z
    t1 = a[i, 0, 1] * x + a[i, 1, 1] * y + a[i, 2, 1] * z
    t2 = a[i, 0, 2] * x + a[i, 1, 2] * y + a[i, 2, 2] * z
    faces = max(
        abs(t0) - (h0 + (f0 * abs(r00) + f1 * abs(r01) + f2 * abs(r02))),
        abs(t1) - (h1 + (f0 * abs(r10) + f1 * abs(r11) + f2 * abs(r12))),
        abs(t2) - (h2 + (f0 * abs(r20) + f1 * abs(r21) + f2 * abs(r22))),
    )
    if faces > bound:
        return True
    faces = max(
        abs(t0 * r00 + t1 * r10 + t2 * r20)
        - (f0 + (h0 * abs(r00) + h1 * abs(r10) + h2 * abs(r20))),
        abs(t0 * r01 + t1 * r11 + t2 * r21)
        - (f1 + (h0 * abs(r01) + h1 * abs(r11) + h2 * abs(r21))),
        abs(t0 * r02 + t1 * r12 + t2 * r22)
        - (f2 + (h0 * abs(r02) + h1 * abs(r12) + h2 * abs(r22))),
    )
    return faces > bound
