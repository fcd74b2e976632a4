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

"""Half-spaces against boxes: certain verdicts, and signed separations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.geometry.validation import as_array, check_lengths, refuse_where
from obb_collision.geometry.values import ArrayValue, ForKernels
from obb_collision.numerics.constants import CAREFUL_BOUND, UNDERFLOW
from obb_collision.numerics.vec3 import (
    combined,
    components,
    dot,
    dot_abs,
    minus,
    norm,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.verdict.pair_rows import as_pairs
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.queries.verdict.verdict import (
    OVERLAP,
    SEPARATE,
    TOUCHING,
    CertifiedSeparations,
    Verdicts,
)
from obb_collision.typing import Floats, Vector


class HalfSpaceArrays(NamedTuple):
    """Half-spaces for kernels: points (n, 3), normals (n, 3)."""

    points: Floats
    normals: Floats


@dataclass(frozen=True, eq=False)
class HalfSpaces(ArrayValue, ForKernels):
    """n solid half-spaces: all points that are not above a plane.

    Parameters
    ----------
    points : (n, 3) array_like
        A point on each plane, metres; points near the boxes give the sharpest results.
    normals : (n, 3) array_like
        Of the planes, upwards, of any length but zero.

    Examples
    --------
    >>> crates = oc.Boxes([[0, 0, 0.5], [0, 0, 3]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
    >>> ground = oc.HalfSpaces([[0, 0, 0]], [[0, 0, 1]])
    >>> oc.separations(crates, ground, [[0, 0], [1, 0]]).separations.tolist()
    [-0.5, 2.0]
    """

    points: Floats
    normals: Floats
    arrays: HalfSpaceArrays = field(init=False, repr=False, compare=False)
    """All of it, for kernels."""

    def __init__(self, points: ArrayLike, normals: ArrayLike) -> None:
        p = as_array(points, "points", (None, 3))
        n = as_array(normals, "normals", (None, 3))
        check_lengths(points=p, normals=n)
        refuse_where((n == 0.0).all(axis=1), "normals must not be zero")
        vars(self)["arrays"] = HalfSpaceArrays(p.copy(), n.copy())

    def __len__(self) -> int:
        return len(self.arrays.points)


def half_space_verdicts(a: Boxes, b: HalfSpaces, pairs: ArrayLike | None = None) -> Verdicts:
    """Return the verdicts of boxes against half-spaces, (m,) int8."""
    return half_space_separations(a, b, pairs).verdicts


def half_space_separations(
    a: Boxes, b: HalfSpaces, pairs: ArrayLike | None = None
) -> CertifiedSeparations:
    """Return the heights of the lowest points of boxes over planes, with verdicts."""
    rows = as_pairs(a, b, pairs)
    heights, bounds = np.empty((2, len(rows)))
    normals, places = np.empty((2, len(rows), 3))
    _height_kernel(a.arrays, *b.arrays, rows, heights, bounds, normals, places)
    verdicts = np.select([heights > bounds, heights < -bounds], [SEPARATE, OVERLAP], TOUCHING)
    return CertifiedSeparations(rows, heights, normals, places, verdicts.astype(np.int8))


@njit
def _height_kernel(
    boxes: BoxArrays, points: Floats, normals: Floats, pairs: np.ndarray,
    heights: Floats, bounds: Floats, down: Floats, places: Floats,
) -> None:  # fmt: skip
    """Write the least height of each box, its error bound, the way down, and a place near both."""
    for row in range(len(pairs)):
        box = box_at(boxes, pairs[row, 0])
        point, normal = vector_at(points, pairs[row, 1]), vector_at(normals, pairs[row, 1])
        heights[row], bounds[row], n, place = _lowest(point, normal, box)
        for k in range(3):
            down[row, k], places[row, k] = -n[k], place[k]


@njit
def _lowest(point: Vector, normal: Vector, box: BoxAt) -> tuple[float, float, Vector, Vector]:
    """Return the least height of a box over a plane, its error bound, the unit normal, and a place.

    The error analysis is that of ``witness.careful_gap``; the plane's normal is exact here.
    """
    size = norm(normal)
    n = normal[0] / size, normal[1] / size, normal[2] / size
    d, h, up = minus(box.center, point), box.half_extents, components(box.axes, n)
    bound = CAREFUL_BOUND * (norm(d) + h[0] + h[1] + h[2]) + UNDERFLOW
    height = dot(n, d) - dot_abs(h, up)
    # the middle of the lowest face, edge or corner, halfway to the plane
    x, y, z = np.sign(up[0]) * h[0], np.sign(up[1]) * h[1], np.sign(up[2]) * h[2]
    lowest = minus(box.center, combined(box.axes, (x, y, z)))
    return height, bound, n, plus(lowest, scaled(n, -0.5 * height))
