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

"""OBB: one oriented box, a value over the same kernels as the batches."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.boxes import AABB, Boxes, add_outwards, box_volumes
from obb_collision.geometry.fitting.enclosing import transform_box
from obb_collision.geometry.fitting.fit import fit_points
from obb_collision.geometry.poses import matrices_from_quaternions, quaternions_from_matrices
from obb_collision.geometry.validation import (
    as_array,
    as_flag,
    as_half_extents,
    as_quaternions,
    as_rotations,
    check_kind,
    is_single,
)
from obb_collision.geometry.values import ArrayValue, read_only_view
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.queries.points.containment import contains
from obb_collision.queries.questions import clearances
from obb_collision.queries.verdict.overlap import iou, overlap_volumes
from obb_collision.queries.verdict.verdict import SEPARATE, Verdict, box_separations, box_verdicts
from obb_collision.typing import Floats
from obb_collision.words import shown


class Separation(NamedTuple):
    """Signed separation of two boxes a and b."""

    gap: float  #: metres; positive apart, negative overlapping (the depth is ``-gap``)
    axis: Floats  #: (3,) unit, from a towards b: the widest gap, or the least translation apart
    verdict: Verdict


class OBB(ArrayValue):
    """One oriented box: {center + sum_i t_i half_extents[i] rotation[:, i], abs(t_i) <= 1}.

    Equal where all numbers are. Without arguments: the reset box, a point at the origin.

    Parameters
    ----------
    center : (3,) array_like
        Metres.
    rotation : (3, 3) array_like
        The columns are the box axes. Within 1e-6 of orthonormal they are made orthonormal.
    half_extents : (3,) array_like
        Metres, not negative; zero makes a flat box.

    Examples
    --------
    >>> crate = oc.OBB([0, 0, 1], np.eye(3), [0.5, 0.5, 1])
    >>> crate.volume, crate.contains([0, 0, 2])  # the surface counts
    (2.0, True)
    """

    __slots__ = ("_center", "_half_extents", "_rotation")

    _center: Floats
    _rotation: Floats
    _half_extents: Floats

    def __init__(
        self,
        center: ArrayLike = (0.0, 0.0, 0.0),
        rotation: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        half_extents: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.set(center, rotation, half_extents)

    def set(self, center: ArrayLike, rotation: ArrayLike, half_extents: ArrayLike) -> None:
        """Replace all three.

        Parameters
        ----------
        center, rotation, half_extents : array_like
            As in the constructor.

        Examples
        --------
        >>> box = oc.OBB()
        >>> box.set([1, 0, 0], np.eye(3), [1, 1, 1])
        >>> box.volume
        8.0
        """
        c = as_array(center, "center", (3,)).copy()
        r = as_rotations(rotation, "rotation", (3, 3)).copy()
        h = as_half_extents(half_extents, "half_extents", (3,))
        self._center, self._rotation, self._half_extents = c, r, h

    @property
    def center(self) -> Floats:
        """(3,) metres, read-only; may be set."""
        return read_only_view(self._center)

    @center.setter
    def center(self, value: ArrayLike) -> None:
        self.set(value, self._rotation, self._half_extents)

    @property
    def rotation(self) -> Floats:
        """(3, 3) the columns are the box axes, read-only; may be set."""
        return read_only_view(self._rotation)

    @rotation.setter
    def rotation(self, value: ArrayLike) -> None:
        self.set(self._center, value, self._half_extents)

    @property
    def half_extents(self) -> Floats:
        """(3,) metres, read-only; may be set."""
        return read_only_view(self._half_extents)

    @half_extents.setter
    def half_extents(self, value: ArrayLike) -> None:
        self.set(self._center, self._rotation, value)

    def reset(self) -> None:
        """Become the reset box: a point at the origin with axes x, y, z."""
        self.set(np.zeros(3), np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(
        cls, center: ArrayLike, quaternion_xyzw: ArrayLike, half_extents: ArrayLike
    ) -> OBB:
        """Return a box turned by a quaternion.

        Parameters
        ----------
        center : (3,) array_like
            Metres.
        quaternion_xyzw : (4,) array_like
            x y z w; it is normalised.
        half_extents : (3,) array_like
            Metres.

        Examples
        --------
        >>> turned = oc.OBB.from_quaternion([0, 0, 0], [0, 0, 0.6, 0.8], [1, 1, 1])
        >>> turned.rotation[:, 0].round(9).tolist()
        [0.28, 0.96, 0.0]
        """
        quaternion = as_quaternions(quaternion_xyzw, "quaternion_xyzw", (4,))
        return cls(center, matrices_from_quaternions(quaternion[None])[0], half_extents)

    @classmethod
    def from_aabb(cls, aabb: AABB) -> OBB:
        """Return the box with axes x, y, z that certainly contains an axis-aligned one.

        Parameters
        ----------
        aabb : AABB

        Examples
        --------
        >>> oc.OBB.from_aabb(oc.AABB([0, 0, 0], [2, 4, 6])).half_extents.tolist()
        [1.0, 2.0, 3.0]
        """
        check_kind(aabb, AABB, "aabb")
        center = 0.5 * aabb.minimum + 0.5 * aabb.maximum
        reach = np.maximum(add_outwards(aabb.maximum, -center), add_outwards(center, -aabb.minimum))
        return cls(center, np.eye(3), reach)

    @classmethod
    def from_points(cls, points: ArrayLike, fit: str = "best") -> OBB:
        """Return a box that certainly contains every point.

        Parameters
        ----------
        points : (n, 3) array_like
            Metres, at least one.
        fit : str
            "aabb", "covariance", "hull_covariance", "min_volume", "upright", whose third axis is
            z, or "best", the smallest of several.

        References
        ----------
        Ericson, Real-Time Collision Detection (2005), 4.4.3.

        Examples
        --------
        >>> oc.OBB.from_points([[0, 0, 0], [2, 4, 6]], fit="aabb").half_extents.tolist()
        [1.0, 2.0, 3.0]
        """
        return cls(*fit_points(points, fit))

    @property
    def quaternion(self) -> Floats:
        """(4,) the orientation as a unit quaternion x y z w, w >= 0."""
        return quaternions_from_matrices(self._rotation[None])[0]

    @property
    def volume(self) -> float:
        """Cubic metres."""
        return float(box_volumes(self._half_extents))

    def corners(self) -> Floats:
        """Return the corners (8, 3), metres.

        Four on the +z face (of the box's own axes): left-top, left-bottom, right-bottom, right-top;
        then four on the -z face: right-top, right-bottom, left-bottom, left-top. Right is +x, top
        is +y.

        Examples
        --------
        >>> oc.OBB(half_extents=[1, 2, 3]).corners()[:2].tolist()
        [[-1.0, 2.0, 3.0], [-1.0, -2.0, 3.0]]
        """
        return self._boxes().corners()[0]

    def edge_direction(self, i: int) -> Floats:
        """Return the direction (3,) of the four edges along an axis, of unit length.

        Parameters
        ----------
        i : int
            The axis, 0 to 2.

        Examples
        --------
        >>> oc.OBB().edge_direction(2).tolist()
        [0.0, 0.0, 1.0]
        """
        if not (isinstance(i, (int, np.integer)) and 0 <= i <= 2):
            raise ValueError(f"edge direction i must be 0, 1 or 2, got {shown(i)}")
        return self._rotation[:, i].copy()

    def face_normal(self, i: int) -> Floats:
        """Return the outward normal (3,) of a face.

        Parameters
        ----------
        i : int
            The face: 0 +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z of the box's own axes.

        Examples
        --------
        >>> oc.OBB().face_normal(0).tolist()
        [1.0, 0.0, 0.0]
        """
        if not (isinstance(i, (int, np.integer)) and 0 <= i <= 5):
            raise ValueError(f"face i must be 0 to 5, got {shown(i)}")
        sign = 1.0 if i % 2 == 0 else -1.0
        return sign * self._rotation[:, i // 2]

    def aabb(self) -> AABB:
        """Return the axis-aligned box around this one, rounded outwards where inexact.

        Examples
        --------
        >>> oc.OBB(half_extents=[1, 2, 3]).aabb()
        AABB(minimum=[-1.0, -2.0, -3.0], maximum=[1.0, 2.0, 3.0])
        """
        return self._boxes().aabb()

    def padded(self, margin: float) -> OBB:
        """Return the box grown on every side, rounded outwards.

        Parameters
        ----------
        margin : float
            Metres, not negative.

        Examples
        --------
        >>> oc.OBB(half_extents=[1, 1, 1]).padded(0.5).half_extents.tolist()
        [1.5, 1.5, 1.5]
        """
        pad = as_array(margin, "margin", ())
        return OBB(self._center, self._rotation, self._boxes().padded(pad).half_extents[0])

    def transformed(self, matrix: ArrayLike) -> OBB:
        """Return a box that certainly contains this one, moved by an invertible 4x4 matrix.

        Tight where the result is a box again; under shear or uneven scale the smallest of
        several boxes around the result.

        Parameters
        ----------
        matrix : (4, 4) array_like
            Invertible; acts on columns, and its last row is 0 0 0 1.

        Examples
        --------
        >>> oc.OBB(half_extents=[1, 1, 1]).transformed(np.diag([2, 3, 4, 1])).volume
        192.0
        """
        return OBB(*transform_box(self._center, self._rotation, self._half_extents, matrix))

    def contains(self, points: ArrayLike, exact: bool = False) -> bool | NDArray[np.bool_]:
        """Return whether a point, or which points (n,), lie inside; the surface counts.

        Parameters
        ----------
        points : (3,) or (n, 3) array_like
            Metres.
        exact : bool
            Decide by integer arithmetic what doubles can't tell from the surface, else inside.

        Examples
        --------
        >>> oc.OBB(half_extents=[1, 1, 1]).contains([[0, 0, 1], [0, 0, 1.1]]).tolist()
        [True, False]
        """
        single = is_single(points)
        cloud = as_array(points, "points", (3,) if single else (None, 3)).reshape(-1, 3)
        exactly = as_flag(exact, "exact")
        inside = contains(self._center, self._rotation, self._half_extents, cloud, exactly)
        return bool(inside[0]) if single else inside

    def intersects(self, other: OBB, exact: bool = False) -> bool:
        """Return whether two boxes have a common point; touching counts.

        Parameters
        ----------
        other : OBB
        exact : bool
            Decide by integer arithmetic what doubles can't tell from touching, else it counts.

        Examples
        --------
        >>> box = oc.OBB(half_extents=[1, 1, 1])
        >>> box.intersects(oc.OBB([2, 0, 0], np.eye(3), [1, 1, 1]))
        True
        """
        both = self._with(other)
        return int(box_verdicts(*both, exact=as_flag(exact, "exact"))[0]) != SEPARATE

    def separation(self, other: OBB) -> Separation:
        """Return the signed gap, its axis from this box to another, and the verdict.

        Parameters
        ----------
        other : OBB

        References
        ----------
        Gottschalk, Lin, Manocha, OBBTree (SIGGRAPH 1996); Ericson 2005, 4.4.1.

        Examples
        --------
        >>> gap, axis, verdict = oc.OBB().separation(oc.OBB([3, 0, 0], np.eye(3), [1, 1, 1]))
        >>> gap, axis.tolist(), verdict.name
        (2.0, [1.0, 0.0, 0.0], 'SEPARATE')
        """
        rows = box_separations(*self._with(other))
        verdict = Verdict(int(rows.verdicts[0]))
        return Separation(float(rows.separations[0]), rows.normals[0], verdict)

    def distance(self, other: OBB) -> float:
        """Return the distance to another box, metres; 0 where they have a common point.

        Parameters
        ----------
        other : OBB

        Examples
        --------
        >>> oc.OBB().distance(oc.OBB([3, 0, 0], np.eye(3), [1, 1, 1]))
        2.0
        """
        return max(0.0, float(clearances(*self._with(other)).distances[0]))

    def closest_point(self, point: ArrayLike) -> Floats:
        """Return the point (3,) of the box that is nearest to a point, itself if it is inside.

        Parameters
        ----------
        point : (3,) array_like
            Metres.

        Examples
        --------
        >>> oc.OBB(half_extents=[1, 1, 1]).closest_point([5, 0, 0.5]).tolist()
        [1.0, 0.0, 0.5]
        """
        where = as_array(point, "point", (3,))
        local = (where - self._center) @ self._rotation
        beyond = local - np.clip(local, -self._half_extents, self._half_extents)
        return where - self._rotation @ beyond

    def merge(self, other: OBB) -> OBB:
        """Return a box that certainly contains this one and another, fitted to their corners.

        Parameters
        ----------
        other : OBB

        Examples
        --------
        >>> box = oc.OBB(half_extents=[1, 1, 1])
        >>> box.merge(oc.OBB([2, 0, 0], np.eye(3), [1, 1, 1])).half_extents.round(9).tolist()
        [2.0, 1.0, 1.0]
        """
        boxes = self._with(other)
        corners = np.concatenate([box.corners()[0] for box in boxes])
        error = 16.0 * ROUNDOFF * (np.abs(corners).max() + max(b.half_extents.sum() for b in boxes))
        return OBB.from_points(corners).padded(error)

    def overlap_volume(self, other: OBB) -> float:
        """Return the volume that two boxes share, cubic metres; see ``overlap_volumes``.

        Parameters
        ----------
        other : OBB

        Examples
        --------
        >>> box = oc.OBB(half_extents=[1, 1, 1])
        >>> box.overlap_volume(oc.OBB([1, 0, 0], np.eye(3), [1, 1, 1]))
        4.0
        """
        return float(overlap_volumes(*self._with(other))[0])

    def iou(self, other: OBB) -> float:
        """Return intersection over union, from 0 to 1; see the function ``iou``.

        Parameters
        ----------
        other : OBB

        Examples
        --------
        >>> box = oc.OBB(half_extents=[1, 1, 1])
        >>> box.iou(oc.OBB([0, 0, 0.5], np.eye(3), [1, 1, 0.5]))
        0.5
        """
        return float(iou(*self._with(other))[0])

    def _with(self, other: OBB) -> tuple[Boxes, Boxes]:
        """Return this box and another; TypeError for anything else."""
        check_kind(other, OBB, "other")
        return self._boxes(), other._boxes()

    def _boxes(self) -> Boxes:
        return Boxes.trusted(self._center[None], self._rotation[None], self._half_extents[None])

    def __repr__(self) -> str:
        return (
            f"OBB(center={self._center.tolist()}, rotation={self._rotation.tolist()}, "
            f"half_extents={self._half_extents.tolist()})"
        )
