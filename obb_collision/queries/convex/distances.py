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

"""Distances of many pairs of convex bodies, with their closest points.

What is promised: no lower bound is above the truth, and the points, which lie in the bodies, are
the upper bound apart; both agree to 1e-9 of S, the offset of both bodies and their reach.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.numerics.vec3 import combined, fast_norm, minus, plus, scaled
from obb_collision.queries.convex.depth import Polytope, deepest, room_for_depth
from obb_collision.queries.convex.distance import CLOSE, overlaps, rounding, search, unit_of
from obb_collision.queries.convex.simplex import is_zero
from obb_collision.queries.convex.support import ConvexBodies, Cores, body_place, borrowed_core
from obb_collision.queries.meshes.tree_boxes import Place, relative_pose
from obb_collision.typing import Floats, Integers, Mask, Vector

#: Pairs below which a second thread does not pay: 0.1 ms.
FEWEST_PAIRS = 64
NO_START = 0.0, 0.0, 0.0


@dataclass(frozen=True, eq=False)
class ConvexDistances:
    """How far m pairs of bodies a, b are apart; metres, world frame."""

    lower: Floats
    """(m,) certainly at most the distance, and minus at least the depth where they overlap."""
    upper: Floats
    """(m,) how far the two points are apart; 0 where they overlap."""
    positions_a: Floats
    """(m, 3) the point of a closest to b."""
    positions_b: Floats
    """(m, 3) the same of b."""
    normals: Floats
    """(m, 3) unit, from a to b."""


class Distance(NamedTuple):
    """The distance of one pair of bodies; as ``ConvexDistances``."""

    lower: float
    upper: float
    a: Vector
    b: Vector
    normal: Vector


def convex_distances(
    a: ConvexBodies, b: ConvexBodies, i: Integers, j: Integers, limit: float = np.inf
) -> tuple[ConvexDistances, Mask]:
    """Return the distances of bodies ``i[n]`` of a and ``j[n]`` of b, and which are within a limit.

    Of pairs that are certainly beyond it the distances are only that.
    """
    near = np.empty(len(i), np.bool_)
    bounds, vectors = np.empty((2, len(i))), np.empty((3, len(i), 3))
    run(
        *(_distance_kernel, len(i), FEWEST_PAIRS, a.arrays, i, b.arrays, j, limit),
        *(near, bounds[0], bounds[1], vectors[0], vectors[1], vectors[2]),
    )
    return ConvexDistances(*bounds, *vectors), near


def convex_may_collide(a: ConvexBodies, b: ConvexBodies, i: Integers, j: Integers) -> Mask:
    """Return (m,) whether body ``i[n]`` of a and ``j[n]`` of b are not certainly apart."""
    out = np.empty(len(i), np.bool_)
    run(_collision_kernel, len(i), FEWEST_PAIRS, a.arrays, i, b.arrays, j, out)
    return out


@njit
def _collision_kernel(
    a: Cores, rows_a: np.ndarray, b: Cores, rows_b: np.ndarray, out: np.ndarray, start: int,
    stop: int,
) -> None:  # fmt: skip
    for n in range(start, stop):
        out[n] = may_collide(a, rows_a[n], b, rows_b[n])


@njit
def _distance_kernel(
    a: Cores, rows_a: np.ndarray, b: Cores, rows_b: np.ndarray, limit: float, near: np.ndarray,
    lower: Floats, upper: Floats, positions_a: Floats, positions_b: Floats, normals: Floats,
    start: int, stop: int,
) -> None:  # fmt: skip
    rows = near, lower, upper, positions_a, positions_b, normals
    _write_distances(a, rows_a, b, rows_b, limit, room_for_depth(), rows, start, stop)


@njit(refcount=False)
def _write_distances(
    a: Cores, rows_a: np.ndarray, b: Cores, rows_b: np.ndarray, limit: float, room: Polytope,
    rows: tuple[np.ndarray, Floats, Floats, Floats, Floats, Floats], start: int, stop: int,
) -> None:  # fmt: skip
    near, lower, upper, positions_a, positions_b, normals = rows
    for n in range(start, stop):
        found = body_distance(a, rows_a[n], b, rows_b[n], NO_START, limit, room)
        near[n] = found.lower <= limit
        lower[n], upper[n] = found.lower, found.upper
        for k in range(3):
            positions_a[n, k], positions_b[n, k] = found.a[k], found.b[k]
            normals[n, k] = found.normal[k]


@njit(refcount=False)
def body_distance(
    a: Cores, i: int, b: Cores, j: int, start: Vector, limit: float, room: Polytope
) -> Distance:
    """Return the distance of body i of a and body j of b; beyond a limit only that it is.

    Minus the depth where they overlap.

    start: unit, world frame: the direction to try first, from a to b; zero for that of the centres.
    """
    core_a, core_b = borrowed_core(a, i), borrowed_core(b, j)
    place_a, place_b = body_place(a, i), body_place(b, j)
    pose = relative_pose(place_a, place_b, core_a.reach + core_b.reach)
    radii, slack = core_a.radius + core_b.radius, rounding(pose)
    found = search(core_a, core_b, pose, turned_back(place_a, start), limit + radii + slack)
    if found.gap <= CLOSE * pose.size and (
        found.distance - found.gap > CLOSE * pose.size or found.gap <= 0.0
    ):
        found = deepest(core_a, core_b, pose, found, room)
    normal = combined(place_a.axes, found.normal)
    p, q = in_world(place_a, found.p), in_world(place_b, found.q)
    if radii > 0.0:
        way = towards(p, q, normal) if found.distance > 0.0 else normal
        p, q = plus(p, scaled(way, core_a.radius)), minus(q, scaled(way, core_b.radius))
    upper = fast_norm(minus(q, p)) if found.distance > radii else 0.0
    return Distance(found.gap - radii - slack, upper, p, q, normal)


@njit(refcount=False)
def may_collide(a: Cores, i: int, b: Cores, j: int) -> bool:
    """Return whether body i of a and body j of b are not certainly apart, as below, but sooner."""
    core_a, core_b = borrowed_core(a, i), borrowed_core(b, j)
    pose = relative_pose(body_place(a, i), body_place(b, j), core_a.reach + core_b.reach)
    radii = core_a.radius + core_b.radius
    needed = radii + rounding(pose)
    known = overlaps(core_a, core_b, pose, NO_START, needed, radii - CLOSE * pose.size)
    if known < 0:
        return not search(core_a, core_b, pose, NO_START, needed).gap > needed
    return known == 1


@njit
def in_world(place: Place, p: Vector) -> Vector:
    """Return a point of a body in the world frame."""
    return plus(combined(place.axes, p), place.center)


@njit
def towards(p: Vector, q: Vector, n: Vector) -> Vector:
    """Return the unit vector from p to q; n where they agree."""
    v = minus(q, p)
    return n if is_zero(v) else unit_of(v)[0]


@njit
def turned_back(place: Place, v: Vector) -> Vector:
    """Return a direction in the frame of a body."""
    x, y, z = place.axes
    return (
        x[0] * v[0] + x[1] * v[1] + x[2] * v[2],
        y[0] * v[0] + y[1] * v[1] + y[2] * v[2],
        z[0] * v[0] + z[1] * v[1] + z[2] * v[2],
    )
