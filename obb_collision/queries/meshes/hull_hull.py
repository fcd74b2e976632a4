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

"""Verdicts of two convex hulls: a direction that separates them, searched and then proved.

The search is that of Gilbert, Johnson and Keerthi 1988: the nearest point of a simplex within the
difference of the two bodies gives the next direction. A direction counts only if the corners of one
are certainly beyond those of the other along it. So errors of the search never make a wrong
SEPARATE; bodies without such a direction are TOUCHING.

Error analysis, with u, S and the errors of poses as in ``placed``: both reaches along a
direction w are off by at most 200 u S |w|. GAP_BOUND is 8192 u, so that pairs found apart here
are apart by more than ``mesh_mesh`` can leave undecided.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.intrinsics import farthest
from obb_collision.numerics.simplex import BARE_CORNER, no_simplex, with_corner
from obb_collision.numerics.vec3 import components, dot, max_abs, minus, negated, scaled, sum_abs
from obb_collision.queries.meshes.placed import PairPose, moved, place_at, relative_pose
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.typing import Floats, Integers, Vector

#: Least gap that counts, relative to S (derivation above).
GAP_BOUND = 8192 * ROUNDOFF
#: Directions tried: separate pairs take 3 to 6 of them, and 20 where they nearly touch.
HULL_DIRECTIONS = 40
#: The search ends when the next corner brings it nearer by less than this fraction.
HULL_CONVERGED = 1e-12
#: Pairs below which a second thread does not pay: 0.1 ms.
FEWEST_HULL_VERDICTS = 256


class PlacedHulls(NamedTuple):
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
    run(_meet_kernel, len(i), FEWEST_HULL_VERDICTS, RowPairs(a, i, b, j), out)
    return out


class HullCorners(NamedTuple):
    """The corners of one hull: blocks (m, 3, LANES) first to last - 1."""

    blocks: Floats
    first: int
    last: int


@njit
def _meet_kernel(pairs: RowPairs, out: np.ndarray, start: int, stop: int) -> None:
    a, rows_a, b, rows_b = pairs
    for n in range(start, stop):
        i, j = rows_a[n], rows_b[n]
        place, other = place_at(a.centers, a.rotations, i), place_at(b.centers, b.rotations, j)
        reach = a.hulls.radii[a.rows[i]] + b.hulls.radii[b.rows[j]]
        pose = relative_pose(place, other, reach)
        # the direction between the centres separates most pairs that are apart
        out[n] = not apart(_corners_of(a, i), _corners_of(b, j), pose, negated(pose.offset), 0.0)


@njit
def _corners_of(bodies: PlacedHulls, i: int) -> HullCorners:
    hulls, row = bodies.hulls, bodies.rows[i]
    return HullCorners(hulls.blocks, hulls.starts[row], hulls.starts[row + 1])


@njit
def apart(a: HullCorners, b: HullCorners, pose: PairPose, first: Vector, reach: float) -> bool:
    """Return True if the corners of a are certainly farther than ``reach`` from those of b.

    first: the direction tried first, from b to a in the frame of a. The simplex is scaled by a
    power of two that brings sizes near one, so that products of lengths stay within doubles.
    """
    bound, unit = GAP_BOUND * pose.size + MESH_UNDERFLOW, unit_scale(pose.size)[0]
    near = (unit * reach) * (unit * reach)
    n, simplex = first, no_simplex(BARE_CORNER)
    for _ in range(HULL_DIRECTIONS):
        largest = max_abs(n)
        if not largest > 0.0:
            n, largest = (1.0, n[1], n[2]), 1.0
        n = n[0] / largest, n[1] / largest, n[2] / largest
        p = farthest(a.blocks, a.first, a.last, negated(n))
        m = components(pose.axes, n)  # the direction in the frame of b
        q = farthest(b.blocks, b.first, b.last, m)
        gap = dot(n, p) - dot(m, q) - dot(n, pose.offset)
        if gap > bound * sum_abs(n) and (reach == 0.0 or gap > beyond(n, bound, reach)):
            return True
        if simplex.size > 0:
            reached = dot(n, simplex.nearest)
            if not reached - unit * gap > HULL_CONVERGED * reached:
                return False
        simplex = with_corner(simplex, (scaled(minus(p, moved(pose, q)), unit),))
        n = simplex.nearest
        if simplex.size == 4 or not dot(n, n) > near:
            return False
    return False


@njit
def beyond(n: Vector, bound: float, reach: float) -> float:
    """Return the gap along n above which bodies are certainly farther apart than ``reach``."""
    return bound * sum_abs(n) + reach * (1.0 + 4.0 * ROUNDOFF) * math.sqrt(dot(n, n))
