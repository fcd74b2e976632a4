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

from obb_collision.geometry.aabb import AABB
from obb_collision.geometry.boxes import Boxes, add_outwards
from obb_collision.geometry.fitting.fit import fit_points
from obb_collision.geometry.fitting.transform import transform_box
from obb_collision.geometry.kinds import as_flag, check_kind
from obb_collision.geometry.poses import matrices_from_quaternions, quaternions_from_matrices
from obb_collision.geometry.representations import corners
from obb_collision.geometry.validation import (
    as_array,
    as_half_extents,
    as_quaternions,
    as_rotations,
    is_single,
)
from obb_collision.queries.points.containment import contains
from obb_collision.queries.verdict.penetration import AXES, witness
from obb_collision.queries.verdict.verdict import SEPARATE, Verdict, verdicts
from obb_collision.typing import Floats
from obb_collision.words import shown


class Separation(NamedTuple):
    """Signed separation of two boxes a and b."""

    gap: float  #: metres; positive apart, negative overlapping (the depth is ``-gap``)
    axis: Floats  #: (3,) unit, from a towards b: the widest gap, or the least translation apart
    verdict: Verdict


class OBB:
    """One oriented box: {center + sum_i t_i half_extents[i] rotation[:, i], abs(t_i) <= 1}.

    center (3,) metres; rotation (3, 3), its columns are the box axes; half_extents (3,) metres,
    zero allowed. Raises ValueError naming the argument for anything else. Without arguments: the
    reset box, a point at the origin with axes x, y, z.
    """

    __slots__ = ("center", "half_extents", "rotation")

    center: Floats
    rotation: Floats
    half_extents: Floats

    def __init__(
        self,
        center: ArrayLike = (0.0, 0.0, 0.0),
        rotation: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        half_extents: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.set(center, rotation, half_extents)

    def set(self, center: ArrayLike, rotation: ArrayLike, half_extents: ArrayLike) -> None:
        """Replace all three; on ValueError the box stays as it was."""
        c = as_array(center, "center", (3,)).copy()
        r = as_rotations(rotation, "rotation", (3, 3)).copy()
        h = as_half_extents(half_extents, "half_extents", (3,))
        self.center, self.rotation, self.half_extents = c, r, h

    def reset(self) -> None:
        """Become the reset box: a point at the origin with axes x, y, z."""
        self.set(np.zeros(3), np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(
        cls, center: ArrayLike, quaternion_xyzw: ArrayLike, half_extents: ArrayLike
    ) -> OBB:
        """Return a box from a quaternion x y z w, which is normalised; zero is refused."""
        quaternion = as_quaternions(quaternion_xyzw, "quaternion_xyzw", (4,))
        return cls(center, matrices_from_quaternions(quaternion[None])[0], half_extents)

    @classmethod
    def from_aabb(cls, aabb: AABB) -> OBB:
        """Return the box with axes x, y, z that certainly contains the AABB."""
        check_kind(aabb, AABB, "aabb")
        center = 0.5 * aabb.minimum + 0.5 * aabb.maximum
        reach = np.maximum(add_outwards(aabb.maximum, -center), add_outwards(center, -aabb.minimum))
        return cls(center, np.eye(3), reach)

    @classmethod
    def from_points(cls, points: ArrayLike, fit: str = "best") -> OBB:
        """Return a box that certainly contains every point (n, 3), n >= 1.

        fit: "aabb", "covariance", "hull_covariance", "min_volume", or "best", the smallest of
        several. Raises ValueError for no points, bad points or an unknown fit.
        """
        return cls(*fit_points(points, fit))

    @property
    def quaternion(self) -> Floats:
        """The orientation as a unit quaternion x y z w, w >= 0."""
        return quaternions_from_matrices(self.rotation[None])[0]

    @property
    def volume(self) -> float:
        """Cubic metres."""
        return float(8.0 * np.prod(self.half_extents))

    def corners(self) -> Floats:
        """Return the corners (8, 3).

        Four on the +z face (of the box's own axes): left-top, left-bottom, right-bottom,
        right-top; then four on the -z face: right-top, right-bottom, left-bottom, left-top.
        Right is +x, top is +y.
        """
        return corners(self._boxes())[0]

    def edge_direction(self, i: int) -> Floats:
        """Return the unit direction (3,) of the four edges along axis i, 0 to 2."""
        if not (isinstance(i, (int, np.integer)) and 0 <= i <= 2):
            raise ValueError(f"edge direction i must be 0, 1 or 2, got {shown(i)}")
        return self.rotation[:, i].copy()

    def face_normal(self, i: int) -> Floats:
        """Return the outward unit normal (3,) of face i: 0 +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z."""
        if not (isinstance(i, (int, np.integer)) and 0 <= i <= 5):
            raise ValueError(f"face i must be 0 to 5, got {shown(i)}")
        sign = 1.0 if i % 2 == 0 else -1.0
        result: Floats = sign * self.rotation[:, i // 2]
        return result

    def aabb(self) -> AABB:
        """Return the axis-aligned box around this one, rounded outwards where inexact."""
        minimum, maximum = self._boxes().world_bounds()
        return AABB(minimum[0], maximum[0])

    def padded(self, margin: float) -> OBB:
        """Return the box grown by ``margin`` metres on every side, rounded outwards."""
        return OBB(self.center, self.rotation, self._boxes().padded(margin).half_extents[0])

    def transformed(self, matrix: ArrayLike) -> OBB:
        """Return a box that certainly contains this one moved by an invertible 4x4 matrix.

        Tight where the result is a box again; under shear or uneven scale the smallest of
        several boxes around the result. Raises ValueError for a singular or projective matrix.
        """
        return OBB(*transform_box(self.center, self.rotation, self.half_extents, matrix))

    def contains(self, points: ArrayLike, exact: bool = False) -> bool | NDArray[np.bool_]:
        """Return whether the point (3,) -> bool, or each point (n, 3) -> (n,), lies inside.

        The surface counts, and so do points that doubles can't tell from it; ``exact=True``
        decides those by integer arithmetic.
        """
        single = is_single(points)
        cloud = as_array(points, "points", (3,) if single else (None, 3)).reshape(-1, 3)
        exactly = as_flag(exact, "exact")
        inside = contains(self.center, self.rotation, self.half_extents, cloud, exactly)
        return bool(inside[0]) if single else inside

    def intersects(self, other: OBB, exact: bool = False) -> bool:
        """Return whether the boxes have a common point; touching counts."""
        check_kind(other, OBB, "other")
        return int(verdicts(self._boxes(), other._boxes(), exact)[0]) != SEPARATE

    def separation(self, other: OBB) -> Separation:
        """Return the signed gap in metres, its unit axis towards ``other``, and the verdict."""
        check_kind(other, OBB, "other")
        gap, x, y, z, _ = witness(
            *(self.center, self.rotation, self.half_extents),
            *(other.center, other.rotation, other.half_extents),
            np.empty(AXES),
        )
        verdict = Verdict(int(verdicts(self._boxes(), other._boxes())[0]))
        return Separation(gap, np.array([x, y, z]), verdict)

    def _boxes(self) -> Boxes:
        return Boxes.trusted(self.center[None], self.rotation[None], self.half_extents[None])

    def __repr__(self) -> str:
        return (
            f"OBB(center={self.center.tolist()}, rotation={self.rotation.tolist()}, "
            f"half_extents={self.half_extents.tolist()})"
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, OBB):
            return NotImplemented
        return all(np.array_equal(getattr(self, k), getattr(other, k)) for k in self.__slots__)

    __hash__ = None  # type: ignore[assignment]
