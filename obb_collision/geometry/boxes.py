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

"""Boxes: one axis-aligned box, and many oriented ones as a structure of arrays.

The questions of an ``AABB`` are comparisons, so they are exact. Geometry and queries
take ``Boxes``; the public class of that name adds what gives and takes an ``OBB``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision.geometry.poses import as_poses, quaternions_from_matrices
from obb_collision.geometry.validation import (
    as_any_array,
    as_array,
    as_half_extents,
    as_rotations,
    check_kind,
    check_last_rows,
    check_lengths,
    is_single,
    refuse_where,
    select_rows,
)
from obb_collision.geometry.values import ArrayValue, ForKernels
from obb_collision.numerics.constants import BOUND_SLACK, BOUND_UNDERFLOW
from obb_collision.numerics.exact import two_sum_error
from obb_collision.numerics.vec3 import dot_abs, rows_at, vector_at
from obb_collision.typing import Axes, Floats, Vector
from obb_collision.words import shown

#: Signs of the corners along the box axes: on the +z face left-top, left-bottom, right-bottom,
#: right-top; then on the -z face right-top, right-bottom, left-bottom, left-top.
_RING = [[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]]
CORNER_SIGNS: Floats = np.array(
    [[*xy, 1.0] for xy in _RING] + [[*xy, -1.0] for xy in reversed(_RING)]
)


@dataclass(frozen=True, eq=False, repr=False)
class AABB(ArrayValue):
    """The closed axis-aligned box between two corners. Boxes with equal corners are equal.

    Parameters
    ----------
    minimum, maximum : (3,) array_like
        Metres.

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

        Examples
        --------
        >>> oc.AABB([0, 0, 0], [1, 1, 1]).intersects(oc.AABB([2, 0, 0], [3, 1, 1]))
        False
        """
        check_kind(other, AABB, "other")
        apart = (self.minimum > other.maximum) | (other.minimum > self.maximum)
        return not bool(apart.any())

    def contains(self, points: ArrayLike) -> bool | NDArray[np.bool_]:
        """Return whether a point, or which points (n,), lie inside; the surface counts.

        Parameters
        ----------
        points : (3,) or (n, 3) array_like
            Metres.

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
        """Return the corners (8, 3), metres, in the order of ``OBB.corners``."""
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
    """Return outer axis-aligned bounds of a box, metres; rows: the rows of its rotation matrix."""
    x0, x1 = _bounds_along(center[0], rows[0], half_extents)
    y0, y1 = _bounds_along(center[1], rows[1], half_extents)
    z0, z1 = _bounds_along(center[2], rows[2], half_extents)
    return (x0, y0, z0), (x1, y1, z1)


@njit
def _bounds_along(center: float, row: Vector, half_extents: Vector) -> tuple[float, float]:
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
    """Return whether every product with this weight is exact."""
    return (weight == 0.0) | (abs(weight) == 1.0)


Kind = TypeVar("Kind", bound="Boxes")


class BoxArrays(NamedTuple):
    """Boxes for kernels: centers (n, 3), rotations (n, 3, 3), half extents (n, 3)."""

    centers: Floats
    rotations: Floats
    half_extents: Floats


@dataclass(frozen=True, eq=False, repr=False)
class Boxes(ArrayValue, ForKernels):
    """Arrays of n boxes; ``oc.Boxes`` adds the methods that return or take an ``OBB``."""

    centers: Floats
    rotations: Floats
    half_extents: Floats
    arrays: BoxArrays = field(init=False, repr=False, compare=False)
    """The arrays, for kernels."""

    def __init__(self, centers: ArrayLike, rotations: ArrayLike, half_extents: ArrayLike) -> None:
        c = as_array(centers, "centers", (None, 3))
        r = as_rotations(rotations, "rotations", (None, 3, 3))
        h = as_half_extents(half_extents, "half_extents", (None, 3))
        check_lengths(centers=c, rotations=r, half_extents=h)
        self._set(c.copy(), r.copy(), h)  # copies: checked numbers must not change later

    def _set(self, centers: Floats, rotations: Floats, half_extents: Floats) -> None:
        # past the guard of a frozen value, in a third of the time of object.__setattr__
        vars(self)["arrays"] = BoxArrays(centers, rotations, half_extents)

    @classmethod
    def trusted(cls: type[Kind], centers: Floats, rotations: Floats, half_extents: Floats) -> Kind:
        """Return boxes over valid arrays, neither checked nor copied."""
        boxes = cls.__new__(cls)
        boxes._set(centers, rotations, half_extents)
        return boxes

    @classmethod
    def from_poses(cls: type[Kind], poses: ArrayLike, half_extents: ArrayLike) -> Kind:
        """Return boxes with the positions of poses as centres and their axes.

        Parameters
        ----------
        poses : (n, 7) array_like
            x y z (metres) qx qy qz qw; quaternions are normalised.
        half_extents : (n, 3) array_like
            Metres.

        Examples
        --------
        >>> boxes = oc.Boxes.from_poses([[1, 2, 3, 0, 0, 0, 1]], [[0.5, 0.5, 0.5]])
        >>> boxes[0].center.tolist()
        [1.0, 2.0, 3.0]
        """
        centers, rotations = as_poses(poses)
        h = as_half_extents(half_extents, "half_extents", (None, 3))
        check_lengths(poses=centers, half_extents=h)
        return cls.trusted(centers, rotations, h)

    @classmethod
    def from_matrices(cls: type[Kind], matrices: ArrayLike, half_extents: ArrayLike) -> Kind:
        """Return boxes placed by rigid transforms.

        Parameters
        ----------
        matrices : (n, 4, 4) array_like
            They act on columns: rotation, position (metres) in the last column, last row 0 0 0 1.
        half_extents : (n, 3) array_like
            Metres.

        Examples
        --------
        >>> oc.Boxes.from_matrices([np.eye(4)], [[0.5, 0.5, 0.5]]).volumes.tolist()
        [1.0]
        """
        moves = as_array(matrices, "matrices", (None, 4, 4))
        check_last_rows(moves, "matrices")
        rotations = as_rotations(moves[:, :3, :3], "matrices", (None, 3, 3))
        h = as_half_extents(half_extents, "half_extents", (None, 3))
        check_lengths(matrices=moves, half_extents=h)
        return cls.trusted(moves[:, :3, 3].copy(), rotations.copy(), h)

    @classmethod
    def from_yaw(cls: type[Kind], centers: ArrayLike, sizes: ArrayLike, yaw: ArrayLike) -> Kind:
        """Return upright boxes, as detectors of vehicles and people have them.

        Parameters
        ----------
        centers : (n, 3) array_like
            Metres.
        sizes : (n, 3) array_like
            Full edge lengths along the box's own x, y and z (length, width, height), metres.
        yaw : (n,) array_like
            Rotation about z, radians, from x towards y.

        Examples
        --------
        >>> car = oc.Boxes.from_yaw([[0, 0, 1]], [[4, 2, 2]], [np.pi / 2])
        >>> car.aabb().maximum.round(9).tolist()
        [1.0, 2.0, 2.0]
        """
        c = as_array(centers, "centers", (None, 3))
        h = 0.5 * as_half_extents(sizes, "sizes", (None, 3))
        angles = as_array(yaw, "yaw", (None,))
        check_lengths(centers=c, sizes=h, yaw=angles)
        rotations = np.zeros((len(c), 3, 3))
        rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(angles)
        rotations[:, 1, 0] = np.sin(angles)
        rotations[:, 0, 1], rotations[:, 2, 2] = -rotations[:, 1, 0], 1.0
        return cls.trusted(c.copy(), rotations, h)

    def __len__(self) -> int:
        return len(self.arrays.centers)

    def __getitem__(self: Kind, index: slice | Sequence[int] | NDArray[Any]) -> Kind:
        """Return the boxes of a slice, an index array or a mask."""
        rows: Any = index
        if not isinstance(index, slice):
            rows = np.asarray(index)
            if rows.size == 0 and rows.ndim == 1:
                rows = np.empty(0, np.int64)
            if rows.ndim != 1 or rows.dtype.kind not in "iub":
                raise TypeError(f"index must be a row, a slice, rows or a mask, got {shown(index)}")
        c, r, h = self.arrays
        return type(self).trusted(select_rows(c, rows, "rows", 2), r[rows], h[rows])

    def __repr__(self) -> str:
        if len(self) == 0:
            return "Boxes(0 boxes)"
        minimum, maximum = self.world_bounds()
        low, high = (np.round(x, 3).tolist() for x in (minimum.min(axis=0), maximum.max(axis=0)))
        return f"Boxes({len(self)} {'box' if len(self) == 1 else 'boxes'} within {low} to {high})"

    @property
    def quaternions(self) -> Floats:
        """(n, 4) the orientations as unit quaternions x y z w, w >= 0."""
        return quaternions_from_matrices(self.arrays.rotations)

    @property
    def volumes(self) -> Floats:
        """(n,) the volume of each box, cubic metres."""
        return box_volumes(self.half_extents)

    def corners(self) -> Floats:
        """Return the corners (n, 8, 3) of each box, metres, in the order of ``OBB.corners``."""
        steps = CORNER_SIGNS * self.half_extents[:, None, :]
        return self.centers[:, None, :] + steps @ self.rotations.transpose(0, 2, 1)

    def aabb(self) -> AABB:
        """Return the axis-aligned box around all boxes, rounded outwards where inexact.

        ``world_bounds`` returns the bounds of each box.

        Examples
        --------
        >>> oc.Boxes([[0, 0, 0], [3, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2).aabb()
        AABB(minimum=[-1.0, -1.0, -1.0], maximum=[4.0, 1.0, 1.0])
        """
        if len(self) == 0:
            raise ValueError("boxes must not be empty")
        minimum, maximum = self.world_bounds()
        return AABB(minimum.min(axis=0), maximum.max(axis=0))

    def padded(self: Kind, margin: ArrayLike) -> Kind:
        """Return boxes grown on every side, rounded outwards.

        Parameters
        ----------
        margin : float or (n,) array_like
            Metres, not negative: for all, or for each.

        Examples
        --------
        >>> boxes = oc.Boxes([[0, 0, 0]] * 2, [np.eye(3)] * 2, [[1, 1, 1]] * 2)
        >>> boxes.padded([0, 0.5]).half_extents.tolist()
        [[1.0, 1.0, 1.0], [1.5, 1.5, 1.5]]
        """
        by_box = as_any_array(margin, "margin", "a number, or a number per box").ndim > 0
        pad = as_array(margin, "margin", (len(self),) if by_box else ())
        refuse_where(pad < 0.0, "margin must not be negative", by_row=False)
        if not pad.any():
            return self
        c, r, h = self.arrays
        return type(self).trusted(c, r, add_outwards(h, pad[:, None] if by_box else pad))

    def footprints(self: Kind) -> Kind:
        """Return upright boxes as seen from above: of height 1 about z = 0.

        Their ``iou``, ``iou_matrix`` and ``nms`` are those of the bird's-eye view. ValueError for a
        box of which no axis is vertical, to 1e-6.

        Examples
        --------
        >>> boxes = oc.Boxes.from_yaw([[0, 0, 0], [1, 0, 5]], [[2, 2, 2]] * 2, [0, 0])
        >>> oc.iou(boxes[:1].footprints(), boxes[1:].footprints()).round(6).tolist()
        [0.333333]
        """
        c, r, h = self.arrays
        rows, up = np.arange(len(c)), np.abs(r[:, 2]).argmax(axis=1)
        tilted = np.abs(r[:, 2]).max(axis=1, initial=0.0) < 1.0 - 1e-12
        refuse_where(tilted, "boxes must have a vertical axis")
        first, second = (up + 1) % 3, (up + 2) % 3
        x, y = r[rows, 0, first], r[rows, 1, first]
        length = np.hypot(x, y)
        rotations = np.zeros_like(r)
        rotations[:, 0, 0] = rotations[:, 1, 1] = x / length
        rotations[:, 1, 0] = y / length
        rotations[:, 0, 1], rotations[:, 2, 2] = -rotations[:, 1, 0], 1.0
        halves = np.column_stack([h[rows, first], h[rows, second], np.full(len(c), 0.5)])
        return type(self).trusted(c * (1.0, 1.0, 0.0), rotations, halves)

    def world_bounds(self) -> tuple[Floats, Floats]:
        """Return the axis-aligned bounds of each box, metres: minima and maxima (n, 3).

        Bounds of an axis-aligned box are exact where they are doubles; others are rounded outwards.

        Examples
        --------
        >>> minimum, _ = oc.Boxes([[0, 0, 0]], [np.eye(3)], [[1, 2, 3]]).world_bounds()
        >>> minimum.tolist()
        [[-1.0, -2.0, -3.0]]
        """
        minimum = np.empty((len(self), 3))
        maximum = np.empty((len(self), 3))
        world_bounds_kernel(*self.arrays, minimum, maximum)
        return minimum, maximum


def box_volumes(half_extents: Floats) -> Floats:
    """Return volumes (...,) of half extents (..., 3), whose order does not change a bit."""
    small, middle, large = np.moveaxis(np.sort(2.0 * half_extents, axis=-1), -1, 0)
    with np.errstate(over="ignore", under="ignore"):
        volumes: Floats = small * middle * large
    return volumes


def add_outwards(extents: Floats, margin: Floats) -> Floats:
    """Return extents + margin, rounded up where the sum is not exact (two-sum, Knuth)."""
    total = extents + margin
    back = total - extents
    error = (extents - (total - back)) + (margin - back)
    return np.where(error > 0.0, np.nextafter(total, np.inf), total)
