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

"""Signed separations of meshes, and the points where their surfaces cross.

Separations are the distance of meshes that are apart, and minus the depth of others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.intrinsics import in_blocks
from obb_collision.numerics.vec3 import ZERO, combined, dot, minus, plus, scaled, vector_at
from obb_collision.queries.contacts.contacts import NO_AXIS, ContactArrays, Contacts, as_max_points
from obb_collision.queries.convex.contacts import frame_of
from obb_collision.queries.convex.distances import convex_distances, turned_back
from obb_collision.queries.convex.support import HULL_CORE, ConvexBodies
from obb_collision.queries.mesh_contacts.mesh_mesh import (
    CONTACT_ROOM,
    DepthArrays,
    contacts_of,
    depth_kernel,
    replace_outer,
    seen_from_first,
    way_out,
)
from obb_collision.queries.meshes.mesh_mesh import as_radii, clearances_of
from obb_collision.queries.meshes.placed import MeshPair, PlacedMeshes, body_at
from obb_collision.queries.meshes.trees import TreeRoom, scaled_triangles, tree_room
from obb_collision.queries.meshes.triangle_distance import closest_points, crossing, foot
from obb_collision.queries.meshes.triangles import Triangle
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.pair_rows import RowPairs, as_sides
from obb_collision.queries.verdict.verdict import Separations
from obb_collision.typing import Floats, Integers, Vector

#: Pairs below which a second thread does not pay: 1 ms.
FEWEST_MESH_DEPTHS = 4


def mesh_separations(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    radii_a: ArrayLike = 0.0,
    radii_b: ArrayLike = 0.0,
) -> Separations:
    """Return the signed separations (metres) of meshes that grow by radii.

    pairs (m, 2): rows of a and of b; by default each row of a with the same row of b.
    """
    i, j = as_sides(a, b, pairs)
    first, second = as_radii(radii_a, "radii_a", len(a)), as_radii(radii_b, "radii_b", len(b))
    convex_a, convex_b = hulls_of(a, i, first), hulls_of(b, j, second)
    hulls, _ = convex_distances(convex_a, convex_b, i, j)
    middles = 0.5 * (hulls.positions_a + hulls.positions_b)
    outer = Separations(np.stack([i, j], axis=1), hulls.lower, hulls.normals, middles)
    return within(outer, a, first, b, second)


def within(
    outer: Separations, a: PlacedMeshes, radii_a: Floats, b: PlacedMeshes, radii_b: Floats
) -> Separations:
    """Return the separations of meshes, from those (m,) of convex bodies that contain them.

    outer.pairs: rows of a and of b. The arrays of ``outer`` are overwritten.
    """
    i, j = np.ascontiguousarray(outer.pairs.T)
    near, _ = clearances_of(a, radii_a, b, radii_b, i, j, np.inf)

    def shorten(deep: Integers, depths: DepthArrays) -> None:
        pairs = RowPairs(a.arrays, i[deep], b.arrays, j[deep])
        run(depth_kernel, len(deep), FEWEST_MESH_DEPTHS, pairs, (radii_a, radii_b), depths)

    return replace_outer(outer, near.distances, near, shorten)


def hulls_of(bodies: PlacedMeshes, rows: Integers, radii: Floats) -> ConvexBodies:
    """Return the convex hulls of meshes, with radii; only those of rows are built."""
    trees = bodies.trees
    used, where = np.unique(bodies.meshes[rows], return_inverse=True)
    blocks = [np.zeros((1, 3, 8))]
    for mesh in used.tolist():
        first, last = trees.starts[trees.roots[mesh]]
        blocks.append(in_blocks(np.unique(trees.triangles[first:last].reshape(-1, 3), axis=0)))
    starts = np.cumsum([0, *map(len, blocks)])
    reach = [np.abs(block).sum(axis=1).max() for block in blocks]
    own = np.zeros(len(bodies), np.int64)
    own[rows] = where.ravel() + 1
    kinds, sizes = np.full(len(bodies), HULL_CORE, np.int8), np.zeros((len(bodies), 4))
    hulls = Hulls(np.concatenate(blocks), starts, np.array(reach))
    return ConvexBodies(kinds, sizes, radii, hulls, own, *bodies.arrays[2:])


#: Pairs below which a second thread does not pay: 0.2 ms.
FEWEST_PATCHES = 16
#: Points this near to both surfaces, relative to S, are on the curve.
CURVE_SLACK = 1e-13
#: Depths that differ by less than this, relative to S, count as equal.
DEPTH_TIE = 2.0**-24
#: Points of a pair of triangles: three edges of each.
POINTS_PER_CONTACT = 6


class Curve(NamedTuple):
    """Points where both surfaces cross, scaled, in the frame of a, and the depths there, metres."""

    points: Floats  #: (POINTS_PER_CONTACT CONTACT_ROOM, 3)
    depths: Floats  #: (POINTS_PER_CONTACT CONTACT_ROOM,)


def mesh_contacts(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    max_points: int = 4,
    radii_a: ArrayLike = 0.0,
    radii_b: ArrayLike = 0.0,
) -> Contacts:
    """Return the contacts of meshes, with radii: points of the curve where surfaces cross."""
    limit = as_max_points(max_points)
    separations = mesh_separations(a, b, pairs, radii_a=radii_a, radii_b=radii_b)
    return patches_of(separations, a, b, *as_sides(a, b, pairs), limit)


def patches_of(
    outer: Separations, a: PlacedMeshes, b: PlacedMeshes, i: Integers, j: Integers, max_points: int
) -> Contacts:
    """Return the contacts of pairs i (m,) of a and j (m,) of b; outer: their separations (m,)."""
    result = Contacts.blank(outer.pairs, max_points)
    result.normals[:], result.axes[:] = outer.normals, NO_AXIS
    result.depths[:] = np.maximum(-outer.separations, 0.0)
    result.counts[:] = outer.separations <= 0.0
    result.positions[:], result.position_depths[:] = np.nan, np.nan
    touching = result.counts > 0
    result.positions[touching, 0] = outer.positions[touching]
    result.position_depths[touching, 0] = result.depths[touching]
    both = RowPairs(a.arrays, i, b.arrays, j)
    run(_patch_kernel, len(i), FEWEST_PATCHES, both, result.arrays)
    return result


@njit
def _patch_kernel(pairs: RowPairs, out: ContactArrays, start: int, stop: int) -> None:
    """Write the points of pairs whose surfaces cross, in place of the single one before."""
    most = POINTS_PER_CONTACT * CONTACT_ROOM
    curve = Curve(np.empty((most, 3)), np.empty(most))
    room = tree_room(CONTACT_ROOM)
    normals, depths, counts, positions, position_depths, _ = out
    for row in range(start, stop):
        if counts[row] == 0:
            continue
        place = body_at(pairs.a, pairs.rows_a[row]).place
        bodies = seen_from_first(pairs, row, ZERO)
        n = turned_back(place, vector_at(normals, row))
        count = _write_curve(bodies, n, depths[row], room, curve)
        back = unit_scale(bodies.pose.size)[1]
        count = _chosen(curve, count, positions.shape[1], DEPTH_TIE * bodies.pose.size)
        for k in range(count):
            point = scaled(vector_at(curve.points, k), back)
            point = plus(combined(place.axes, point), place.center)
            for c in range(3):
                positions[row, k, c] = point[c]
            position_depths[row, k] = curve.depths[k]
        counts[row] = max(count, 1)


@njit(merge=True)
def _write_curve(bodies: MeshPair, n: Vector, depth: float, room: TreeRoom, curve: Curve) -> int:
    """Write the points where triangles cross; return their number."""
    unit, back = unit_scale(bodies.pose.size)
    frame, count = frame_of(n), 0
    _, contacts = contacts_of(bodies, room)
    for k in range(contacts):
        p, q = scaled_triangles(bodies, room.contacts[k, 1], room.contacts[k, 2], unit)
        first = count
        count = _add_crossings(q, p, curve, _add_crossings(p, q, curve, count))
        if count == first:
            _, x, y = closest_points(p, q)
            count = _add(curve, count, x, y)
        way = min(max(way_out(p, q, frame, -np.inf) * back, 0.0), depth)
        for point in range(first, count):
            curve.depths[point] = way
    return count


@njit
def _add_crossings(p: Triangle, q: Triangle, curve: Curve, count: int) -> int:
    """Add the points where edges of p cross q; return the number of points."""
    for _ in range(3):
        x = crossing(p[0], p[1], q)
        y = foot(x, q)
        d = minus(y, x)
        if dot(d, d) <= CURVE_SLACK * CURVE_SLACK:
            count = _add(curve, count, x, y)
        p = p[1], p[2], p[0]
    return count


@njit
def _add(curve: Curve, count: int, x: Vector, y: Vector) -> int:
    middle = scaled(plus(x, y), 0.5)
    for k in range(3):
        curve.points[count, k] = middle[k]
    return count + 1


@njit
def _chosen(curve: Curve, count: int, limit: int, tie: float) -> int:
    """Move at most ``limit`` of count points to the front; return their number.

    First the deepest (of equal ones that farthest from the middle), then repeatedly the point
    farthest from those before (Gonzalez 1985).
    """
    limit, middle, deepest = min(limit, count), ZERO, 0.0
    for k in range(count):
        middle = plus(middle, scaled(vector_at(curve.points, k), 1.0 / count))
        deepest = max(deepest, curve.depths[k])
    for taken in range(limit):
        best, far = taken, -1.0
        for k in range(taken, count):
            reach = np.inf
            if taken == 0:
                d = minus(vector_at(curve.points, k), middle)
                reach = dot(d, d) if curve.depths[k] >= deepest - tie else -1.0
            for other in range(taken):
                d = minus(vector_at(curve.points, k), vector_at(curve.points, other))
                reach = min(reach, dot(d, d))
            if reach > far:
                best, far = k, reach
        if taken > 0 and not far > CURVE_SLACK * CURVE_SLACK:
            return taken
        for c in range(3):
            here = curve.points[taken, c]
            curve.points[taken, c], curve.points[best, c] = curve.points[best, c], here
        here = curve.depths[taken]
        curve.depths[taken], curve.depths[best] = curve.depths[best], here
    return limit
