"""May two boxes collide? Cheaper answers than the certified test, which never miss what it finds.

Spheres: around each box, radius the length of its half extents. Apart if the distance of the
centres exceeds the sum of the radii by SPHERE_SLACK. That is 2^9 times the bound up to which
``separation`` gives TOUCHING, and axes orthonormal to 64 roundoffs only add 2^-47 to a radius.
Faces: the first 6 of the 15 axes, with the bound of the fast stage, so that what is apart here is
apart there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.error_free import length
from obb_collision.geometry.validation import Floats
from obb_collision.queries.separation import FAST_BOUND, UNDERFLOW

Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Slack of the sphere test relative to the distance and the radii (see above).
SPHERE_SLACK = 2.0**-40


def sphere_bounds(boxes: Boxes) -> tuple[Floats, Floats]:
    """Return minimum and maximum (n, 3) of bounds that hold each box's world AABB and its sphere.

    Of two spheres that ``spheres_meet`` reports these bounds certainly overlap.
    """
    minimum, maximum = boxes.world_bounds()
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
    """Return (m,) whether the world AABBs of two boxes have a common point."""
    low_a, high_a = boxes.take(rows_a).world_bounds()
    low_b, high_b = boxes.take(rows_b).world_bounds()
    return np.asarray(((low_a <= high_b) & (low_b <= high_a)).all(axis=1))


def faces_meet(boxes: Boxes, rows_a: Integers, rows_b: Integers) -> Mask:
    """Return (m,) whether none of the six face normals separates two boxes certainly."""
    out = np.empty(len(rows_a), np.bool_)
    _faces_kernel(boxes.centers, boxes.rotations, boxes.half_extents, rows_a, rows_b, out)
    return out


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
        i, j = rows_a[n], rows_b[n]
        x = centers[j, 0] - centers[i, 0]
        y = centers[j, 1] - centers[i, 1]
        z = centers[j, 2] - centers[i, 2]
        total = abs(x) + abs(y) + abs(z)
        for k in range(3):
            total += half_extents[i, k] + half_extents[j, k]
        bound = FAST_BOUND * total + UNDERFLOW
        out[n] = not (
            _face_separates(axes, half_extents, i, j, x, y, z, bound)
            or _face_separates(axes, half_extents, j, i, x, y, z, bound)
        )


@njit
def _face_separates(
    axes: Floats, half_extents: Floats, i: int, j: int, x: float, y: float, z: float, bound: float
) -> bool:
    """Return whether a face normal of box i separates it from box j, offset by x, y, z."""
    for k in range(3):
        u, v, w = axes[i, 0, k], axes[i, 1, k], axes[i, 2, k]
        reach = half_extents[i, k]
        for m in range(3):
            along = u * axes[j, 0, m] + v * axes[j, 1, m] + w * axes[j, 2, m]
            reach += half_extents[j, m] * abs(along)
        if abs(u * x + v * y + w * z) - reach > bound:
            return True
    return False
