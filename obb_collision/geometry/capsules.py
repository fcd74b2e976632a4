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

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.kinds import taken
from obb_collision.geometry.validation import as_array, as_half_extents
from obb_collision.typing import Floats


@dataclass(frozen=True, eq=False)
class Capsules:
    """n capsules: all points within radii[k] of the segment from starts[k] to ends[k].

    starts and ends (n, 3), radii (n,), metres; equal ends make a sphere, radius zero a segment.
    All float64. Raises ValueError naming the argument and the row for anything else.
    """

    starts: Floats
    ends: Floats
    radii: Floats

    def __init__(self, starts: ArrayLike, ends: ArrayLike, radii: ArrayLike) -> None:
        p = as_array(starts, "starts", (None, 3))
        q = as_array(ends, "ends", (None, 3))
        r = as_half_extents(radii, "radii", (None,))
        if not len(p) == len(q) == len(r):
            raise ValueError(
                "starts, ends and radii must have the same length, "
                f"got {len(p)}, {len(q)} and {len(r)}"
            )
        self._set(p.copy(), q.copy(), r)  # what is checked must not change behind our back

    def _set(self, starts: Floats, ends: Floats, radii: Floats) -> None:
        object.__setattr__(self, "starts", starts)
        object.__setattr__(self, "ends", ends)
        object.__setattr__(self, "radii", radii)

    @classmethod
    def trusted(cls, starts: Floats, ends: Floats, radii: Floats) -> Capsules:
        """Return capsules over arrays known to be valid, neither checked nor copied."""
        capsules = cls.__new__(cls)
        capsules._set(starts, ends, radii)
        return capsules

    @classmethod
    def spheres(cls, centers: ArrayLike, radii: ArrayLike) -> Capsules:
        """Return spheres: centers (n, 3), radii (n,), metres; checked as capsules are."""
        c = as_array(centers, "centers", (None, 3)).copy()
        r = as_half_extents(radii, "radii", (None,))
        if len(c) != len(r):
            raise ValueError(
                f"centers and radii must have the same length, got {len(c)} and {len(r)}"
            )
        return cls.trusted(c, c, r)

    def __len__(self) -> int:
        return len(self.starts)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Capsules:
        """Return the capsules of an index array or mask, in that order."""
        starts = taken(self.starts, rows, "rows", 2)
        return Capsules.trusted(starts, self.ends[rows], self.radii[rows])
