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

"""Capsules: many capsules as a structure of arrays; a sphere is a capsule without length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.validation import as_array, as_half_extents, check_lengths, select_rows
from obb_collision.geometry.values import ArrayValue, ForKernels
from obb_collision.typing import Floats


class CapsuleArrays(NamedTuple):
    """Capsules for kernels: starts (n, 3), ends (n, 3), radii (n,)."""

    starts: Floats
    ends: Floats
    radii: Floats


@dataclass(frozen=True, eq=False, repr=False)
class Capsules(ArrayValue, ForKernels):
    """n capsules: all points within radii[k] of the segment from starts[k] to ends[k].

    ``capsules[rows]`` gives the capsules of a slice, an index array or a mask. Capsules with
    equal numbers are equal.

    Parameters
    ----------
    starts, ends : (n, 3) array_like
        Metres; a capsule with equal start and end is a sphere.
    radii : (n,) array_like
        Metres, not negative; zero makes a segment.

    Examples
    --------
    >>> arm = oc.Capsules([[0, 0, 0]], [[0, 0, 1]], [0.1])
    >>> box = oc.Boxes([[0.5, 0, 0.5]], [np.eye(3)], [[0.25, 0.25, 0.25]])
    >>> oc.clearances(arm, box).distances.round(9).tolist()
    [0.15]
    """

    starts: Floats
    ends: Floats
    radii: Floats
    arrays: CapsuleArrays = field(init=False, repr=False, compare=False)
    """The arrays, for kernels."""

    def __init__(self, starts: ArrayLike, ends: ArrayLike, radii: ArrayLike) -> None:
        p = as_array(starts, "starts", (None, 3))
        q = as_array(ends, "ends", (None, 3))
        r = as_half_extents(radii, "radii", (None,))
        check_lengths(starts=p, ends=q, radii=r)
        self._set(p.copy(), q.copy(), r)  # copies: checked numbers must not change later

    def _set(self, starts: Floats, ends: Floats, radii: Floats) -> None:
        vars(self)["arrays"] = CapsuleArrays(starts, ends, radii)

    @classmethod
    def trusted(cls, starts: Floats, ends: Floats, radii: Floats) -> Capsules:
        """Return capsules over valid arrays, neither checked nor copied."""
        capsules = cls.__new__(cls)
        capsules._set(starts, ends, radii)
        return capsules

    @classmethod
    def spheres(cls, centers: ArrayLike, radii: ArrayLike) -> Capsules:
        """Return spheres, which are capsules without length.

        Parameters
        ----------
        centers : (n, 3) array_like
            Metres.
        radii : (n,) array_like
            Metres, not negative.

        Examples
        --------
        >>> oc.Capsules.spheres([[0, 0, 0]], [0.5])
        Capsules(1 capsule)
        """
        c = as_array(centers, "centers", (None, 3)).copy()
        r = as_half_extents(radii, "radii", (None,))
        check_lengths(centers=c, radii=r)
        return cls.trusted(c, c, r)

    def __len__(self) -> int:
        return len(self.arrays.starts)

    def __getitem__(self, rows: slice | Sequence[int] | NDArray[Any]) -> Capsules:
        starts, ends, radii = self.arrays
        return Capsules.trusted(select_rows(starts, rows, "rows", 2), ends[rows], radii[rows])

    def __repr__(self) -> str:
        return f"Capsules({len(self)} {'capsule' if len(self) == 1 else 'capsules'})"
