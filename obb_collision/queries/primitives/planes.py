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

"""Planes and half-spaces against boxes: certain verdicts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import as_array, check_kind, check_lengths, refuse_where
from obb_collision.numerics.constants import CAREFUL_BOUND, UNDERFLOW
from obb_collision.numerics.vec3 import components, dot, dot_abs, minus, norm, vector_at
from obb_collision.queries.verdict.pair_frame import Box, box_at
from obb_collision.queries.verdict.pair_rows import as_sides
from obb_collision.queries.verdict.verdict import OVERLAP, SEPARATE, TOUCHING, Verdicts
from obb_collision.typing import Floats, Vector


@dataclass(frozen=True, eq=False)
class PlaneDistances:
    """Where boxes are along the normals of planes.

    lowest and highest (n,) metres: signed distance from the plane of the lowest and the highest
    point of the box. sides (n,) int8: 1 certainly above, -1 certainly below, 0 on the plane,
    across it, or too near to tell.
    """

    lowest: Floats
    highest: Floats
    sides: NDArray[np.int8]
    #: Verdicts (n,) of the box against the plane.
    plane_verdicts: Verdicts
    #: Verdicts (n,) of the box against the solid half-space below the plane; ``lowest`` is the
    #: signed separation.
    half_space_verdicts: Verdicts


def plane_distances(
    boxes: Boxes, points: ArrayLike, normals: ArrayLike, pairs: ArrayLike | None = None
) -> PlaneDistances:
    """Return where boxes are along the normals of planes.

    Parameters
    ----------
    boxes : Boxes
    points : (k, 3) array_like
        One on each plane, metres; one near the box gives the sharpest result.
    normals : (k, 3) array_like
        Of the planes, of any length but zero.
    pairs : (m, 2) array_like of int, optional
        Rows of boxes and of planes; without, each box and the plane of the same row.

    Returns
    -------
    PlaneDistances
        lowest and highest (m,) metres above the plane; sides (m,), 1 certainly above, -1 certainly
        below, else 0; plane_verdicts and half_space_verdicts (m,) int8.

    Raises
    ------
    ValueError
        Naming the argument and the row.
    TypeError
        For anything but boxes.

    References
    ----------
    Ericson, Real-Time Collision Detection (2005), 5.2.3.

    Examples
    --------
    >>> crates = oc.Boxes([[0, 0, 0.5], [0, 0, 3]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
    >>> above = oc.plane_distances(crates, [[0, 0, 0]], [[0, 0, 1]], [[0, 0], [1, 0]])
    >>> above.lowest.tolist(), above.sides.tolist()
    ([-0.5, 2.0], [0, 1])
    """
    check_kind(boxes, Boxes, "boxes")
    p = as_array(points, "points", (None, 3))
    n = as_array(normals, "normals", (None, 3))
    check_lengths(**({"boxes": boxes} if pairs is None else {}), points=p, normals=n)
    refuse_where((n == 0.0).all(axis=1), "normals must not be zero")
    first, second = as_sides(boxes, p, pairs)
    boxes, p, n = boxes[first], p[second], n[second]
    lowest, highest, bounds = np.empty((3, len(p)))
    _plane_kernel(
        *(p, n, boxes.centers, boxes.rotations, boxes.half_extents, lowest, highest, bounds)
    )
    above, below = lowest > bounds, highest < -bounds
    under, over = lowest < -bounds, highest > bounds
    return PlaneDistances(
        *(lowest, highest, above.astype(np.int8) - below.astype(np.int8)),
        _verdicts(above | below, under & over),
        _verdicts(above, under),
    )


@njit
def _plane_kernel(
    points: Floats, normals: Floats, centers: Floats, axes: Floats, half_extents: Floats,
    lowest: Floats, highest: Floats, bounds: Floats,
) -> None:  # fmt: skip
    """Write the range of each box along the unit normal, and the error bound of its ends (n,).

    The error analysis is that of ``witness.careful_gap``; the plane's normal is exact here.
    """
    for n in range(len(points)):
        box = box_at(centers, axes, half_extents, n)
        found = _range_of(vector_at(points, n), vector_at(normals, n), box)
        lowest[n], highest[n], bounds[n] = found


@njit
def _range_of(point: Vector, normal: Vector, box: Box) -> Vector:
    """Return the least and the largest height of a box over a plane, and their error bound."""
    size = norm(normal)
    n = normal[0] / size, normal[1] / size, normal[2] / size
    d, h = minus(box.center, point), box.half_extents
    middle, reach = dot(n, d), dot_abs(h, components(box.axes, n))
    bound = CAREFUL_BOUND * (norm(d) + h[0] + h[1] + h[2]) + UNDERFLOW
    return middle - reach, middle + reach, bound


def _verdicts(apart: NDArray[np.bool_], overlap: NDArray[np.bool_]) -> Verdicts:
    return np.select([apart, overlap], [SEPARATE, OVERLAP], TOUCHING).astype(np.int8)
