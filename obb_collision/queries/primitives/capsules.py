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

"""Capsules and spheres against boxes and each other: verdict, signed separation, nearest points.

A sphere is a capsule without length (``Capsules.spheres``). Verdicts are certified as those of
boxes are, for the doubles as stored: OVERLAP by two points, one of each body's core (segment or
box), that are nearer than the radii; SEPARATE by a direction along which the bodies are apart.
The rest is TOUCHING: within NEAR_BOUND of the size of the pair, or a core without radius that
touches a flat box or another such core.

Error analysis: u = 2^-53, T = the distances from the box centre to the segment's ends, or of the
segments' starts, + half extents or lengths + radii. A gap along a computed direction is off by at
most 12 u T, bounded by FAR_BOUND T. A distance from a box, taken in the frame of axes orthonormal
to 64 u, is off by at most 2 x 96 u T for those and 10 u T for rounding, bounded by NEAR_BOUND T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.capsules import Capsules
from obb_collision.geometry.kinds import check_kind
from obb_collision.queries.primitives.capsule_kernels import (
    box_distances_kernel,
    box_verdicts_kernel,
    capsule_distances_kernel,
    capsule_verdicts_kernel,
)
from obb_collision.queries.verdict.pair_rows import as_sides
from obb_collision.queries.verdict.verdict import Verdicts
from obb_collision.typing import Floats, Rows


@dataclass(frozen=True, eq=False)
class CapsuleDistances:
    """How far apart row k of a and of b are, and where.

    verdicts (n,) int8; separations (n,) metres, positive the distance, negative minus the least
    translation that separates them; normals (n, 3) unit, from a to b; positions_a and positions_b
    (n, 3) the nearest points of the surfaces, or the deepest: positions_b is
    positions_a + separation x normal.
    """

    verdicts: Verdicts
    separations: Floats
    normals: Floats
    positions_a: Floats
    positions_b: Floats


def capsule_verdicts(a: Capsules, b: Capsules | Boxes, pairs: ArrayLike | None = None) -> Verdicts:
    """Return the ``Verdict`` (m,) int8 of capsules against capsules or boxes.

    pairs as in ``capsule_distances``, of which this is the quicker half.
    """
    return capsule_pair_verdicts(a, *_sides(a, b, pairs))


def capsule_pair_verdicts(
    a: Capsules, rows_a: np.ndarray, b: Capsules | Boxes, rows_b: np.ndarray
) -> Verdicts:
    """Return the verdicts of ``a[rows_a[n]]`` against ``b[rows_b[n]]``, (n,) int8."""
    out = np.empty(len(rows_a), np.int8)
    if isinstance(b, Boxes):
        box_verdicts_kernel(
            a.starts, a.ends, a.radii, rows_a,
            b.centers, b.rotations, b.half_extents, rows_b, out,
        )  # fmt: skip
    else:
        capsule_verdicts_kernel(
            a.starts, a.ends, a.radii, rows_a, b.starts, b.ends, b.radii, rows_b, out
        )
    return out


def capsule_distances(
    a: Capsules, b: Capsules | Boxes, pairs: ArrayLike | None = None
) -> CapsuleDistances:
    """Return how far capsules are from capsules or boxes: verdicts, distances, nearest points.

    Parameters
    ----------
    a : Capsules
    b : Capsules or Boxes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.

    Returns
    -------
    CapsuleDistances
        verdicts (m,) int8; separations (m,) metres, right to 2^-45 of the size of the pair,
        negative overlapping; normals (m, 3) unit, from a to b; positions_a, positions_b (m, 3).

    Raises
    ------
    ValueError
        For pairs that are no rows, and without pairs for different lengths.
    TypeError
        For anything but capsules and boxes.

    References
    ----------
    Ericson, Real-Time Collision Detection (2005), 4.5.1 and 5.1.9.

    Examples
    --------
    >>> balls = oc.Capsules.spheres([[0, 0, 0], [3, 0, 0]], [1, 0.5])
    >>> oc.capsule_distances(balls, balls, [[0, 1]]).separations.tolist()
    [1.5]
    """
    first, _, second = sides = _sides(a, b, pairs)
    verdicts = capsule_pair_verdicts(a, *sides)
    n = len(first)
    separations, vectors = np.empty(n), np.empty((3, n, 3))
    if isinstance(b, Boxes):
        box_distances_kernel(
            *(a.starts, a.ends, a.radii, first),
            *(b.centers, b.rotations, b.half_extents, second, separations, *vectors),
        )
    else:
        capsule_distances_kernel(
            *(a.starts, a.ends, a.radii, first),
            *(b.starts, b.ends, b.radii, second, separations, *vectors),
        )
    return CapsuleDistances(verdicts, separations, *vectors)


def _sides(
    a: Capsules, b: Capsules | Boxes, pairs: ArrayLike | None
) -> tuple[Rows, Capsules | Boxes, Rows]:
    check_kind(a, Capsules, "a")
    check_kind(b, Capsules, "b", Boxes)
    first, second = as_sides(a, b, pairs)
    return first, b, second
