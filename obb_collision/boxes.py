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

"""Boxes: many oriented boxes as users have them, each of them an ``OBB``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry import boxes
from obb_collision.geometry.fitting.fit import fit_clouds
from obb_collision.geometry.validation import as_any_array, as_array, check_kind, is_single
from obb_collision.obb import OBB


class Boxes(boxes.Boxes):
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
            Cloud i is ``points[offsets[i]:offsets[i + 1]]``; they rise from 0 to n.
        fit : str
            As in ``OBB.from_points``.

        Examples
        --------
        >>> boxes = oc.Boxes.from_points([[[0, 0, 0], [2, 4, 6]], [[1, 1, 1]]], fit="aabb")
        >>> boxes.half_extents.tolist()
        [[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]
        """
        return cls.trusted(*fit_clouds(points, offsets, fit))

    @classmethod
    def from_obbs(cls, obbs: Iterable[OBB]) -> Boxes:
        """Return the boxes of a list.

        Parameters
        ----------
        obbs : iterable of OBB
            May be empty.

        Examples
        --------
        >>> len(oc.Boxes.from_obbs([oc.OBB(), oc.OBB([1, 0, 0])]))
        2
        """
        check_kind(obbs, Iterable, "obbs")
        singles: list[Any] = [obbs] if isinstance(obbs, np.ndarray) else list(obbs)
        for single in singles:
            check_kind(single, OBB, "obbs")
        return cls.trusted(
            np.array([single.center for single in singles]).reshape(-1, 3),
            np.array([single.rotation for single in singles]).reshape(-1, 3, 3),
            np.array([single.half_extents for single in singles]).reshape(-1, 3),
        )

    @overload
    def __getitem__(self, index: int | np.integer) -> OBB: ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[Any]) -> Boxes: ...

    def __getitem__(self, index: Any) -> Any:
        """Return the ``OBB`` of a row, or the ``Boxes`` of a slice, an index array or a mask."""
        if isinstance(index, (int, np.integer)) and not isinstance(index, bool):
            if not -len(self) <= index < len(self):
                raise IndexError(f"index must be a row of {len(self)} boxes, got {index}")
            return OBB(*(array[index] for array in self.arrays))
        return super().__getitem__(index)

    def __iter__(self) -> Iterator[OBB]:
        return (self[k] for k in range(len(self)))

    def transformed(self, matrix: ArrayLike) -> Boxes:
        """Return boxes that certainly contain these, moved by an invertible 4x4 matrix.

        Parameters
        ----------
        matrix : (4, 4) or (n, 4, 4) array_like
            For all boxes, or for each; it acts on columns, and its last row is 0 0 0 1.

        Examples
        --------
        >>> moved = np.eye(4)
        >>> moved[:3, 3] = 1, 2, 3
        >>> oc.Boxes([[0, 0, 0]], [np.eye(3)], [[1, 1, 1]]).transformed(moved).centers.tolist()
        [[1.0, 2.0, 3.0]]
        """
        by_box = np.ndim(as_any_array(matrix, "matrix", "numbers of shape (4, 4)")) == 3
        matrices = as_array(matrix, "matrix", (len(self), 4, 4) if by_box else (4, 4))
        moves = np.broadcast_to(matrices, (len(self), 4, 4))
        return self.from_obbs(box.transformed(move) for box, move in zip(self, moves, strict=True))

    def contains(self, points: ArrayLike, exact: bool = False) -> NDArray[np.bool_]:
        """Return which box contains which point, (n,) or (n, p); the surface counts.

        Parameters
        ----------
        points : (3,) or (p, 3) array_like
            Metres. For many points in many boxes ``points_inside`` is faster.
        exact : bool
            Decide by integer arithmetic what doubles can't tell from the surface, else inside.

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
