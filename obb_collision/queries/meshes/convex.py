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
direction w are off by at most 200 u S |w|. GAP_BOUND is 8192 u, so that what is found apart here is
apart by more than ``meshes`` can leave undecided.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.simplex import nearest_to_origin
from obb_collision.numerics.vec3 import (
    components,
    dot,
    max_abs,
    minus,
    negated,
    scaled,
    sum_abs,
    vector,
    vector_at,
)
from obb_collision.queries.meshes.tree_boxes import Pose, moved, place_at, relative_pose
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.typing import Floats, Integers, Vector

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


def hulls_may_collide(
    a: PlacedHulls, b: PlacedHulls, i: Integers, j: Integers
) -> NDArray[np.bool_]:
    """Return (m,) whether body ``i[n]`` of a and ``j[n]`` of b are not certainly apart."""
    out = np.empty(len(i), np.bool_)
    _meet_kernel(
        HullBodies(a.hulls, a.rows, a.centers, a.rotations),
        i,
        HullBodies(b.hulls, b.rows, b.centers, b.rotations),
        j,
        out,
    )
    return out


class HullBodies(NamedTuple):
    """Placed hulls, for kernels: as ``PlacedHulls``."""

    hulls: Hulls
    rows: np.ndarray
    centers: Floats
    rotations: Floats


class Corners(NamedTuple):
    """The corners of one hull: rows first to last - 1 of points (n, 3)."""

    points: Floats
    first: int
    last: int


@njit
def _meet_kernel(
    a: HullBodies, rows_a: np.ndarray, b: HullBodies, rows_b: np.ndarray, out: np.ndarray
) -> None:
    work = np.empty((5, 3))
    for n in range(len(rows_a)):
        i, j = rows_a[n], rows_b[n]
        pose = relative_pose(
            place_at(a.centers, a.rotations, i),
            place_at(b.centers, b.rotations, j),
            a.hulls.radii[a.rows[i]] + b.hulls.radii[b.rows[j]],
        )
        out[n] = not _apart(_corners_of(a, i), _corners_of(b, j), pose, work)


@njit
def _corners_of(bodies: HullBodies, i: int) -> Corners:
    hulls, row = bodies.hulls, bodies.rows[i]
    return Corners(hulls.corners, hulls.starts[row], hulls.starts[row + 1])


@njit
def _apart(a: Corners, b: Corners, pose: Pose, work: Floats) -> bool:
    """Return True if a direction certainly separates corners of a from those of b.

    work (5, 3): scratch for a simplex and its nearest point, both scaled by a power of two that
    brings sizes near one, so that products of lengths stay within doubles.
    """
    simplex, nearest = work[:4], work[4]
    bound, unit = GAP_BOUND * pose.size + MESH_UNDERFLOW, unit_scale(pose.size)[0]
    # from the one centre to the other: it separates most pairs that are apart
    n = negated(pose.offset)
    count = 0
    for _ in range(HULL_DIRECTIONS):
        largest = max_abs(n)
        if not largest > 0.0:
            n, largest = (1.0, n[1], n[2]), 1.0
        n = n[0] / largest, n[1] / largest, n[2] / largest
        p = _farthest(a, negated(n))
        m = components(pose.axes, n)  # the direction in the frame of b
        q = _farthest(b, m)
        gap = dot(n, p) - dot(m, q) - dot(n, pose.offset)
        if gap > bound * sum_abs(n):
            return True
        if count > 0:
            reached = dot(n, vector(nearest))
            if not reached - unit * gap > HULL_CONVERGED * reached:
                return False
        point = scaled(minus(p, moved(pose, q)), unit)
        for k in range(3):
            simplex[count, k] = point[k]
        count = nearest_to_origin(simplex, count + 1, nearest)
        if count == 4:
            return False
        n = vector(nearest)
        if not max_abs(n) > 0.0:
            return False
    return False


@njit
def _farthest(corners: Corners, n: Vector) -> Vector:
    """Return the corner that reaches farthest along a direction."""
    row, best = corners.first, -np.inf
    for k in range(corners.first, corners.last):
        reach = dot(n, vector_at(corners.points, k))
        if reach > best:
            row, best = k, reach
    return vector_at(corners.points, row)
