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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.aabb import AABB, CORNER_SIGNS, world_bounds_kernel
from obb_collision.geometry.poses import as_poses, quaternions_from_matrices
from obb_collision.geometry.validation import (
    as_any_array,
    as_array,
    as_half_extents,
    as_rotations,
    check_kind,
    check_lengths,
    is_single,
    refuse_where,
    select_rows,
)
from obb_collision.geometry.values import ArrayValue, ForKernels
from obb_collision.typing import Floats
from obb_collision.words import shown

if TYPE_CHECKING:  # of a layer above: only its name
    from obb_collision.obb import OBB


class BoxArrays(NamedTuple):
    """Boxes for kernels: centers (n, 3), rotations (n, 3, 3), half extents (n, 3)."""

    centers: Floats
    rotations: Floats
    half_extents: Floats


@dataclass(frozen=True, eq=False, repr=False)
class Boxes(ArrayValue, ForKernels):
    """n oriented boxes: box k is centers[k] + sum_i t_i half_extents[k, i] rotations[k, :, i].

    ``boxes[k]`` is an ``OBB``; a slice, an index array or a mask gives ``Boxes``. What an ``OBB``
    can, many can: ``boxes.padded(0.1)[k] == boxes[k].padded(0.1)``. Equal where all numbers are.

    Parameters
    ----------
    centers : (n, 3) array_like
        Metres.
    rotations : (n, 3, 3) array_like
        The columns are the box axes. Within 1e-6 of orthonormal they are made orthonormal.
    half_extents : (n, 3) array_like
        Metres, not negative; zero makes a flat box.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [3, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1], [2, 1, 1]])
    >>> len(boxes), boxes.volumes.tolist()
    (2, [8.0, 16.0])
    >>> boxes[1].center.tolist()
    [3.0, 0.0, 0.0]
    """

    centers: Floats
    rotations: Floats
    half_extents: Floats
    arrays: BoxArrays = field(init=False, repr=False, compare=False)
    """All of it, for kernels."""

    single: ClassVar[type[OBB]]
    """``OBB``, which is of a layer above and sets itself here."""

    def __init__(self, centers: ArrayLike, rotations: ArrayLike, half_extents: ArrayLike) -> None:
        c = as_array(centers, "centers", (None, 3))
        r = as_rotations(rotations, "rotations", (None, 3, 3))
        h = as_half_extents(half_extents, "half_extents", (None, 3))
        check_lengths(centers=c, rotations=r, half_extents=h)
        self._set(c.copy(), r.copy(), h)  # what is checked must not change behind our back

    def _set(self, centers: Floats, rotations: Floats, half_extents: Floats) -> None:
        # past the guard of a frozen value, at a third of what object.__setattr__ takes
        vars(self)["arrays"] = BoxArrays(centers, rotations, half_extents)

    @classmethod
    def trusted(cls, centers: Floats, rotations: Floats, half_extents: Floats) -> Boxes:
        """Return boxes over arrays known to be valid, neither checked nor copied."""
        boxes = cls.__new__(cls)
        boxes._set(centers, rotations, half_extents)
        return boxes

    @classmethod
    def from_poses(cls, poses: ArrayLike, half_extents: ArrayLike) -> Boxes:
        """Return boxes at poses.

        Parameters
        ----------
        poses : (n, 7) array_like
            x y z (metres) qx qy qz qw; quaternions are normalised.
        half_extents : (n, 3) array_like
            Metres.

        Raises
        ------
        ValueError
            As the constructor, and for a zero quaternion.

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
    def from_points(
        cls,
        points: ArrayLike | Iterable[ArrayLike],
        offsets: ArrayLike | None = None,
        fit: str = "best",
    ) -> Boxes:
        """Return for each of k clouds the box that ``OBB.from_points`` gives it, bit for bit.

        Parameters
        ----------
        points : k array_likes (n, 3)
            Metres, at least one point each; with offsets, one (n, 3) with all clouds.
        offsets : (k + 1,) array_like of int, optional
            Cloud i is ``points[offsets[i]:offsets[i + 1]]``.
        fit : str
            As in ``OBB.from_points``.

        Raises
        ------
        ValueError
            For a cloud without points or with bad ones, naming the cloud; for offsets that do not
            rise from 0 to n.

        Examples
        --------
        >>> boxes = oc.Boxes.from_points([[[0, 0, 0], [2, 4, 6]], [[1, 1, 1]]], fit="aabb")
        >>> boxes.half_extents.tolist()
        [[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]
        """
        return cls.trusted(*cls.single._fit_clouds(points, offsets, fit))

    @classmethod
    def from_obbs(cls, obbs: Iterable[OBB]) -> Boxes:
        """Return the boxes of a list.

        Parameters
        ----------
        obbs : iterable of OBB
            May be empty.

        Raises
        ------
        TypeError
            For anything that is no OBB.

        Examples
        --------
        >>> len(oc.Boxes.from_obbs([oc.OBB(), oc.OBB([1, 0, 0])]))
        2
        """
        check_kind(obbs, Iterable, "obbs")
        boxes: list[Any] = [obbs] if isinstance(obbs, np.ndarray) else list(obbs)
        for box in boxes:
            check_kind(box, cls.single, "obbs")
        return cls.trusted(
            np.array([box.center for box in boxes]).reshape(-1, 3),
            np.array([box.rotation for box in boxes]).reshape(-1, 3, 3),
            np.array([box.half_extents for box in boxes]).reshape(-1, 3),
        )

    def __len__(self) -> int:
        return len(self.arrays.centers)

    @overload
    def __getitem__(self, index: int | np.integer) -> OBB: ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[Any]) -> Boxes: ...

    def __getitem__(self, index: Any) -> Any:
        """Return the ``OBB`` of a row, or the ``Boxes`` of a slice, an index array or a mask."""
        if isinstance(index, (int, np.integer)) and not isinstance(index, bool):
            if not -len(self) <= index < len(self):
                raise IndexError(f"index must be a row of {len(self)} boxes, got {index}")
            return self.single(*(array[index] for array in self.arrays))
        rows = index if isinstance(index, slice) else _as_index(index)
        c, r, h = self.arrays
        return Boxes.trusted(select_rows(c, rows, "rows", 2), r[rows], h[rows])

    def __iter__(self) -> Iterator[OBB]:
        return (self[k] for k in range(len(self)))

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
        """(n,) cubic metres."""
        return box_volumes(self.half_extents)

    def corners(self) -> Floats:
        """Return the corners of each box.

        Returns
        -------
        (n, 8, 3) array
            Metres, in the order of ``OBB.corners``.

        Examples
        --------
        >>> oc.Boxes([[0, 0, 0]], [np.eye(3)], [[1, 2, 3]]).corners()[0, 0].tolist()
        [-1.0, 2.0, 3.0]
        """
        steps = CORNER_SIGNS * self.half_extents[:, None, :]
        return self.centers[:, None, :] + steps @ self.rotations.transpose(0, 2, 1)

    def aabb(self) -> AABB:
        """Return the axis-aligned box around all of them, rounded outwards where inexact.

        Those of each are ``world_bounds``.

        Raises
        ------
        ValueError
            If there are no boxes.

        Examples
        --------
        >>> oc.Boxes([[0, 0, 0], [3, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2).aabb()
        AABB(minimum=[-1.0, -1.0, -1.0], maximum=[4.0, 1.0, 1.0])
        """
        if len(self) == 0:
            raise ValueError("boxes must not be empty")
        minimum, maximum = self.world_bounds()
        return AABB(minimum.min(axis=0), maximum.max(axis=0))

    def padded(self, margin: ArrayLike) -> Boxes:
        """Return boxes grown on every side, rounded outwards.

        Parameters
        ----------
        margin : float or (n,) array_like
            Metres, not negative: one for all, or one for each.

        Examples
        --------
        >>> boxes = oc.Boxes([[0, 0, 0]] * 2, [np.eye(3)] * 2, [[1, 1, 1]] * 2)
        >>> boxes.padded([0, 0.5]).half_extents.tolist()
        [[1.0, 1.0, 1.0], [1.5, 1.5, 1.5]]
        """
        each = as_any_array(margin, "margin", "a number, or a number per box").ndim
        pad = as_array(margin, "margin", (len(self),) if each else ())
        refuse_where(pad < 0.0, "margin must not be negative", by_row=False)
        if not pad.any():
            return self
        c, r, h = self.arrays
        return Boxes.trusted(c, r, add_outwards(h, pad[:, None] if each else pad))

    def transformed(self, matrix: ArrayLike) -> Boxes:
        """Return boxes that certainly contain these, moved by an invertible 4x4 matrix.

        Parameters
        ----------
        matrix : (4, 4) or (n, 4, 4) array_like
            One for all boxes, or one for each; it acts on columns.

        Raises
        ------
        ValueError
            For a singular or projective matrix.

        Examples
        --------
        >>> moved = np.eye(4)
        >>> moved[:3, 3] = 1, 2, 3
        >>> oc.Boxes([[0, 0, 0]], [np.eye(3)], [[1, 1, 1]]).transformed(moved).centers.tolist()
        [[1.0, 2.0, 3.0]]
        """
        each = np.ndim(as_any_array(matrix, "matrix", "numbers of shape (4, 4)")) == 3
        matrices = as_array(matrix, "matrix", (len(self), 4, 4) if each else (4, 4))
        moves = np.broadcast_to(matrices, (len(self), 4, 4))
        return self.from_obbs(box.transformed(move) for box, move in zip(self, moves, strict=True))

    def contains(self, points: ArrayLike, exact: bool = False) -> NDArray[np.bool_]:
        """Return which box contains which point; the surface counts.

        Parameters
        ----------
        points : (3,) or (p, 3) array_like
            Metres. Many points in many boxes: ``points_inside`` is made for them.
        exact : bool
            Decide by integer arithmetic what doubles can't tell from the surface, else inside.

        Returns
        -------
        (n,) or (n, p) array of bool

        Raises
        ------
        ValueError
            For points of another shape.

        Examples
        --------
        >>> boxes = oc.Boxes([[0, 0, 0], [3, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
        >>> boxes.contains([[0, 0, 0], [3, 0, 0], [9, 0, 0]]).tolist()
        [[True, False, False], [False, True, False]]
        """
        single = is_single(points)
        cloud = as_array(points, "points", (3,) if single else (None, 3))
        inside = np.array([box.contains(cloud, exact) for box in self], np.bool_)
        return inside.reshape(len(self) if single else (len(self), len(cloud)))

    def world_bounds(self) -> tuple[Floats, Floats]:
        """Return axis-aligned boxes that certainly contain these, one for each.

        Exact where that is representable and the box is axis-aligned, else rounded outwards.

        Returns
        -------
        minimum, maximum : (n, 3) arrays
            Metres.

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


def _as_index(index: Any) -> NDArray[Any]:
    """Return an index array or mask; TypeError for what can't be one."""
    array = np.asarray(index)
    if array.size == 0 and array.ndim == 1:
        return np.empty(0, np.int64)
    if array.ndim != 1 or array.dtype.kind not in "iub":
        raise TypeError(f"index must be a row, a slice, rows or a mask, got {shown(index)}")
    return array


def box_volumes(half_extents: Floats) -> Floats:
    """Return (...,) the volumes of half extents (..., 3), whatever their order bit for bit."""
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
