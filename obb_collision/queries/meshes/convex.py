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

"""Do two convex hulls collide? A direction that separates them, searched and then proved.

The search is that of Gilbert, Johnson and Keerthi 1988: the nearest point of a simplex within the
difference of the two bodies gives the next direction. What counts is only whether the corners of
one are certainly beyond those of the other along it, so that no error of the search can make a
wrong SEPARATE; bodies for which none is found are TOUCHING, be it by rounding.

Error analysis, with u, S and the errors of poses as in ``tree_boxes``: both reaches along a
direction w are off by at most 200 u S |w|. GAP_BOUND is 8192 u, so that what is told apart here is
apart by more than ``mesh_collision`` can fail to tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.simplex import nearest_to_origin
from obb_collision.queries.meshes.tree_boxes import relative_pose
from obb_collision.queries.meshes.tree_descent import Placement
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.typing import Floats, Integers

#: Least gap that counts, relative to S (derivation above).
GAP_BOUND = 8192 * ROUNDOFF
#: Directions tried: separate pairs take 3 to 6 of them, and 20 where they nearly touch.
HULL_DIRECTIONS = 40
#: The search ends when the next corner brings it nearer by less than this fraction.
HULL_CONVERGED = 1e-12


@dataclass(frozen=True, eq=False)
class PlacedHulls:
    """n bodies: body i is hull ``rows[i]`` at centers (n, 3), rotations (n, 3, 3); not checked."""

    hulls: Hulls
    rows: Integers
    centers: Floats
    rotations: Floats


def hulls_meet(a: PlacedHulls, b: PlacedHulls, i: Integers, j: Integers) -> NDArray[np.bool_]:
    """Return (m,) whether body ``i[n]`` of a and ``j[n]`` of b are not certainly apart."""
    out = np.empty(len(i), np.bool_)
    _meet_kernel(
        a.hulls, a.rows, Placement(a.centers, a.rotations), i,
        b.hulls, b.rows, Placement(b.centers, b.rotations), j, out,
    )  # fmt: skip
    return out


@njit
def _meet_kernel(
    a: Hulls, hulls_a: np.ndarray, placed_a: Placement, rows_a: np.ndarray,
    b: Hulls, hulls_b: np.ndarray, placed_b: Placement, rows_b: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    pose = np.empty(12)
    work = np.empty((5, 3))
    for n in range(len(rows_a)):
        i, j = rows_a[n], rows_b[n]
        hull_a, hull_b = hulls_a[i], hulls_b[j]
        size = relative_pose(
            placed_a.centers, placed_a.rotations, i, placed_b.centers, placed_b.rotations, j,
            a.radii[hull_a] + b.radii[hull_b], pose,
        )  # fmt: skip
        out[n] = not _apart(
            a.corners, a.starts[hull_a], a.starts[hull_a + 1],
            b.corners, b.starts[hull_b], b.starts[hull_b + 1],
            pose, GAP_BOUND * size + MESH_UNDERFLOW, unit_scale(size)[0], work,
        )  # fmt: skip


@njit
def _apart(
    a: Floats, first_a: int, last_a: int, b: Floats, first_b: int, last_b: int,
    m: Floats, bound: float, unit: float, work: Floats,
) -> bool:  # fmt: skip
    """Return True if a direction certainly separates corners of a from those of b.

    m (12,): pose of b in the frame of a; unit: a power of two that brings sizes near one, so that
    products of lengths stay within doubles; work (5, 3): scratch for a simplex, times unit, and its
    nearest point.
    """
    simplex, nearest = work[:4], work[4]
    # from the one centre to the other: it separates most pairs that are apart
    x, y, z = -m[9], -m[10], -m[11]
    count = 0
    for _ in range(HULL_DIRECTIONS):
        largest = max(abs(x), abs(y), abs(z))
        if not largest > 0.0:
            x, largest = 1.0, 1.0
        x, y, z = x / largest, y / largest, z / largest
        k = _farthest(a, first_a, last_a, -x, -y, -z)
        # the direction in the frame of b: by the transposed rotation
        u = m[0] * x + m[3] * y + m[6] * z
        v = m[1] * x + m[4] * y + m[7] * z
        w = m[2] * x + m[5] * y + m[8] * z
        n = _farthest(b, first_b, last_b, u, v, w)
        near = x * a[k, 0] + y * a[k, 1] + z * a[k, 2]
        far = u * b[n, 0] + v * b[n, 1] + w * b[n, 2]
        gap = near - far - (x * m[9] + y * m[10] + z * m[11])
        if gap > bound * (abs(x) + abs(y) + abs(z)):
            return True
        if count > 0:
            reached = x * nearest[0] + y * nearest[1] + z * nearest[2]
            if not reached - unit * gap > HULL_CONVERGED * reached:
                return False
        for i in range(3):
            moved = m[3 * i] * b[n, 0] + m[3 * i + 1] * b[n, 1] + m[3 * i + 2] * b[n, 2]
            simplex[count, i] = unit * (a[k, i] - (moved + m[9 + i]))
        count = nearest_to_origin(simplex, count + 1, nearest)
        if count == 4:
            return False
        x, y, z = nearest[0], nearest[1], nearest[2]
        if not max(abs(x), abs(y), abs(z)) > 0.0:
            return False
    return False


@njit
def _farthest(points: Floats, first: int, last: int, x: float, y: float, z: float) -> int:
    """Return the row of the point that reaches farthest along a direction."""
    row, best = first, -np.inf
    for n in range(first, last):
        reach = x * points[n, 0] + y * points[n, 1] + z * points[n, 2]
        if reach > best:
            row, best = n, reach
    return row
