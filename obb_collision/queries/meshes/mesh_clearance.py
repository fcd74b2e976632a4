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

"""Distance of the surfaces of two meshes, certified, and their closest points.

Meshes are solids or surfaces as in ``meshes``, whose verdict decides whether they collide: then
the distance is 0. Else the answer comes with two bounds: no points of the two are closer than the
lower one, and those that are given are no farther apart than the upper one. The two differ by less
than 1e-9 of the size of the pair, the components of the offset of their origins plus their reach
from these; where meshes are nearer than 1e-10 of it the lower bound may be 0.

A body may have a radius: it is then everything within that distance of its mesh, exactly. So a
sphere is a point and a capsule a segment, as triangles whose corners are equal, and a padded mesh
is one with round edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.geometry.validation import refuse_where
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.vec3 import combined, minus, norm, plus, scaled
from obb_collision.queries.clearance.clearance import Clearances, as_limit
from obb_collision.queries.meshes.meshes import UNLIMITED, nesting, roots_apart
from obb_collision.queries.meshes.placed import MeshPair, PlacedMeshes, mesh_pair_at, moved
from obb_collision.queries.meshes.triangles import SEPARATE, TOUCHING
from obb_collision.queries.meshes.two_trees import (
    DISTANCE_BOUND,
    SLACK,
    Contacting,
    TreeRoom,
    descend,
    nearest_triangles,
    points_of,
    tree_room,
)
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.pair_rows import RowPairs, as_each, as_sides
from obb_collision.typing import Floats, Integers, Mask, Vector

#: Pairs below which a second thread does not pay: 0.2 ms.
FEWEST_MESH_CLEARANCES = 16
#: Of the bodies of both sides.
Radii = tuple[Floats, Floats]
#: Of m pairs: whether they are near (m,), bounds (2, m), points and normal (3, m, 3), faces (m, 2).
ClearanceArrays = tuple[np.ndarray, Floats, Floats, np.ndarray]


@dataclass(frozen=True, eq=False)
class MeshClearances(Clearances):
    """The same of placed meshes: no points are closer than the distance, 0 where they collide.

    There both positions are one that they have in common, and the normal is 0.
    """

    upper: Floats
    """(m,) the positions are no farther apart, but for the rounding of world coordinates."""
    faces: Integers
    """(m, 2) the closest faces of a and of b; -1 where a piece lies inside the other."""


def mesh_clearances(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    max_distance: float = np.inf,
    radii_a: ArrayLike = 0.0,
    radii_b: ArrayLike = 0.0,
) -> MeshClearances:
    """Return the clearances of meshes, with radii, that are within a distance, in metres."""
    i, j = as_sides(a, b, pairs)
    limit = as_limit(max_distance)
    first, second = as_radii(radii_a, "radii_a", len(a)), as_radii(radii_b, "radii_b", len(b))
    found, near = clearances_of(a, first, b, second, i, j, limit)
    return found if near.all() else MeshClearances(*(x[near] for x in vars(found).values()))


def clearances_of(
    a: PlacedMeshes,
    radii_a: Floats,
    b: PlacedMeshes,
    radii_b: Floats,
    i: Integers,
    j: Integers,
    limit: float,
) -> tuple[MeshClearances, Mask]:
    """Return the clearances of pairs i (m,) of a and j (m,) of b, and which are within a limit.

    Rows of the others are not written to.
    """
    bounds, vectors = np.empty((2, len(i))), np.empty((3, len(i), 3))
    out = np.empty(len(i), np.bool_), bounds, vectors, np.empty((len(i), 2), np.int64)
    pairs = RowPairs(a.arrays, np.ascontiguousarray(i), b.arrays, np.ascontiguousarray(j))
    run(clearance_kernel, len(i), FEWEST_MESH_CLEARANCES, pairs, (radii_a, radii_b), limit, out)
    x, y, normals = vectors
    rows = np.stack([i, j], axis=1)
    return MeshClearances(rows, bounds[0], x, y, normals, bounds[1], out[3]), out[0]


def as_radii(given: ArrayLike, name: str, count: int) -> Floats:
    """Return the radius (n,) of each body."""
    radii = as_each(given, name, "a number, or a number per body", (count,))
    refuse_where(~((radii >= 0.0) & (radii < np.inf)), f"{name} must be finite and not negative")
    return radii


class Apart(NamedTuple):
    """How far apart two meshes are: bounds, points and direction, in the frame of a, metres."""

    collide: bool
    lower: float
    upper: float
    x: Vector  #: of a
    y: Vector  #: of b
    n: Vector  #: unit, from a to b; zero where they collide
    s: int  #: triangle of a, -1 for none
    t: int  #: triangle of b


@njit
def clearance_kernel(
    pairs: RowPairs, radii: Radii, limit: float, out: ClearanceArrays, start: int, stop: int
) -> None:
    """Write whether pairs are within the limit, and the clearance of those that are."""
    near, bounds, vectors, faces = out
    room = tree_room(1)
    for row in range(start, stop):
        bodies = mesh_pair_at(pairs, row)
        radius, other = radii[0][pairs.rows_a[row]], radii[1][pairs.rows_b[row]]
        place, reach = bodies.a.place, radius + other
        found = surfaces_apart(bodies, limit + reach, room)
        bound = DISTANCE_BOUND * (bodies.pose.size + reach) + MESH_UNDERFLOW
        least = max(found.lower - reach - bound, 0.0)
        most = 0.0 if found.collide else max(found.upper - reach + bound, 0.0)
        near[row] = least <= limit and found.upper < np.inf
        if not near[row]:
            continue
        share = 1.0 if found.upper >= reach else found.upper / reach
        x = plus(found.x, scaled(found.n, share * radius))
        y = minus(found.y, scaled(found.n, share * other))
        p = plus(place.center, combined(place.axes, x))
        q = plus(place.center, combined(place.axes, y))
        n = combined(place.axes, found.n) if most > 0.0 else (0.0, 0.0, 0.0)
        bounds[0, row], bounds[1, row] = least, most
        for k in range(3):
            vectors[0, row, k], vectors[1, row, k], vectors[2, row, k] = p[k], q[k], n[k]
        faces[row, 0] = bodies.trees_a.faces[found.s] if found.s >= 0 else -1
        faces[row, 1] = bodies.trees_b.faces[found.t] if found.s >= 0 else -1


@njit(refcount=False)
def surfaces_apart(bodies: MeshPair, limit: float, room: TreeRoom) -> Apart:
    """Return how far apart two meshes are, the bounds but for rounding; infinite past a limit."""
    zero = 0.0, 0.0, 0.0
    unit, back = unit_scale(bodies.pose.size)
    if not roots_apart(bodies):
        search = Contacting(TOUCHING, UNLIMITED, room.contacts, room.waiting)
        if descend(bodies, search, 0, 0)[0] != SEPARATE:
            s, t = room.contacts[0, 1], room.contacts[0, 2]
            _, x, y = points_of(bodies, s, t, unit)
            return Apart(True, 0.0, 0.0, scaled(x, back), scaled(y, back), zero, s, t)
        verdict, k, of_a = nesting(bodies, room.waiting)
        if verdict != SEPARATE:
            own, other = bodies.trees_a, bodies.trees_b
            point = _piece(own, k) if of_a else moved(bodies.pose, _piece(other, k))
            return Apart(True, 0.0, 0.0, point, point, zero, -1, -1)
    found = nearest_triangles(bodies, unit, limit * unit + 2.0 * SLACK, room)
    s, t, n = found.s, found.t, found.direction
    if s < 0:
        return Apart(False, found.lower * back, np.inf, zero, zero, zero, s, t)
    distance, x, y = points_of(bodies, s, t, unit)
    if found.lower <= DISTANCE_BOUND and distance > 0.0:  # along no direction a gap is certain
        n = scaled(minus(x, y), 1.0 / norm(minus(x, y)))
    x, y = scaled(x, back), scaled(y, back)
    return Apart(False, found.lower * back, distance * back, x, y, scaled(n, -1.0), s, t)


@njit(refcount=False)
def _piece(trees: TreeArrays, k: int) -> Vector:
    return trees.pieces[k, 0, 0], trees.pieces[k, 0, 1], trees.pieces[k, 0, 2]
