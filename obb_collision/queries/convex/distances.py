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

"""Distances of convex bodies from each other and from meshes, with their closest points.

What is promised: no lower bound is above the truth, and the points, which lie in the bodies, are
the upper bound apart; both agree to 1e-9 of S, the offset of both bodies and their reach.

Of a mesh and a body: branch and bound over the tree of the mesh, as in ``meshes.trees``, where the
body is its box; the distance of a triangle is that of its three corners and the core.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.intrinsics import LANES
from obb_collision.numerics.vec3 import ZERO, combined, fast_norm, minus, plus, scaled
from obb_collision.queries.convex.depth import DepthRoom, deepest, room_for_depth
from obb_collision.queries.convex.distance import CLOSE, cores_overlap, rounding, search, unit_of
from obb_collision.queries.convex.simplex import is_zero
from obb_collision.queries.convex.support import (
    HULL_CORE,
    ConvexBodies,
    Core,
    Cores,
    body_place,
    borrowed_core,
    core_at,
)
from obb_collision.queries.meshes.inside import OUTSIDE_MESH, point_side
from obb_collision.queries.meshes.placed import (
    NodeBox,
    PairPose,
    Place,
    PlacedMeshes,
    body_at,
    moved,
    relative_pose,
)
from obb_collision.queries.meshes.trees import (
    NODE_BOUND,
    SAME_DISTANCE,
    NodeStack,
    boxes_apart,
    descend_nearest,
    node_stack,
)
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.typing import Floats, Integers, Mask, Vector

#: Pairs below which a second thread does not pay: 0.1 ms.
FEWEST_CONVEX_DISTANCES = 64


@dataclass(frozen=True, eq=False)
class ConvexDistances:
    """Distances of m pairs of bodies a, b; metres, world frame."""

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


#: Of m pairs: whether they are near (m,), bounds (2, m), points and normal (3, m, 3).
DistanceArrays = tuple[np.ndarray, Floats, Floats]


def distance_arrays(count: int) -> DistanceArrays:
    """Return arrays for the distances of pairs."""
    return np.empty(count, np.bool_), np.empty((2, count)), np.empty((3, count, 3))


class BodyDistance(NamedTuple):
    """The distance of a pair of bodies, as in ``ConvexDistances``."""

    lower: float
    upper: float
    a: Vector
    b: Vector
    normal: Vector


def convex_distances(
    a: ConvexBodies, b: ConvexBodies, i: Integers, j: Integers, limit: float = np.inf
) -> tuple[ConvexDistances, Mask]:
    """Return the distances of bodies ``i[n]`` of a and ``j[n]`` of b, and which are within a limit.

    Beyond the limit only the lower bounds count.
    """
    near, bounds, vectors = out = distance_arrays(len(i))
    pairs = RowPairs(a.arrays, i, b.arrays, j)
    run(_distance_kernel, len(i), FEWEST_CONVEX_DISTANCES, pairs, limit, out)
    return ConvexDistances(*bounds, *vectors), near


def convex_may_collide(a: ConvexBodies, b: ConvexBodies, i: Integers, j: Integers) -> Mask:
    """Return (m,) whether body ``i[n]`` of a and ``j[n]`` of b are not certainly apart."""
    out = np.empty(len(i), np.bool_)
    run(_collision_kernel, len(i), FEWEST_CONVEX_DISTANCES, RowPairs(a.arrays, i, b.arrays, j), out)
    return out


@njit
def _collision_kernel(pairs: RowPairs, out: np.ndarray, start: int, stop: int) -> None:
    a, rows_a, b, rows_b = pairs
    for n in range(start, stop):
        out[n] = may_collide(a, rows_a[n], b, rows_b[n])


@njit
def _distance_kernel(
    pairs: RowPairs, limit: float, out: DistanceArrays, start: int, stop: int
) -> None:
    room = room_for_depth()
    a, rows_a, b, rows_b = pairs
    near, bounds, vectors = out
    for n in range(start, stop):
        pair = body_distance(a, rows_a[n], b, rows_b[n], ZERO, limit, room)
        near[n] = pair.lower <= limit
        bounds[0, n], bounds[1, n] = pair.lower, pair.upper
        for k in range(3):
            vectors[0, n, k], vectors[1, n, k] = pair.a[k], pair.b[k]
            vectors[2, n, k] = pair.normal[k]


@njit(refcount=False)
def body_distance(
    a: Cores, i: int, b: Cores, j: int, start: Vector, limit: float, room: DepthRoom
) -> BodyDistance:
    """Return the distance of body i of a and body j of b, minus the depth where they overlap.

    Beyond a limit only the lower bound counts.

    start: unit, world frame: the direction to try first, from a to b; zero for that of the centres.
    """
    core_a, core_b = borrowed_core(a, i), borrowed_core(b, j)
    place_a, place_b = body_place(a, i), body_place(b, j)
    pose = relative_pose(place_a, place_b, core_a.reach + core_b.reach)
    radii, slack = core_a.radius + core_b.radius, rounding(pose)
    search_end = search(core_a, core_b, pose, turned_back(place_a, start), limit + radii + slack)
    if search_end.gap <= CLOSE * pose.size and (
        search_end.distance - search_end.gap > CLOSE * pose.size or search_end.gap <= 0.0
    ):
        search_end = deepest(core_a, core_b, pose, search_end, room)
    normal = combined(place_a.axes, search_end.normal)
    p, q = in_world(place_a, search_end.p), in_world(place_b, search_end.q)
    if radii > 0.0:
        way = towards(p, q, normal) if search_end.distance > 0.0 else normal
        p, q = plus(p, scaled(way, core_a.radius)), minus(q, scaled(way, core_b.radius))
    upper = fast_norm(minus(q, p)) if search_end.distance > radii else 0.0
    return BodyDistance(search_end.gap - radii - slack, upper, p, q, normal)


@njit(refcount=False)
def may_collide(a: Cores, i: int, b: Cores, j: int) -> bool:
    """Return whether body i of a and body j of b are not certainly apart."""
    core_a, core_b = borrowed_core(a, i), borrowed_core(b, j)
    pose = relative_pose(body_place(a, i), body_place(b, j), core_a.reach + core_b.reach)
    radii = core_a.radius + core_b.radius
    needed = radii + rounding(pose)
    overlap = cores_overlap(core_a, core_b, pose, ZERO, needed, radii - CLOSE * pose.size)
    if overlap < 0:
        return not search(core_a, core_b, pose, ZERO, needed).gap > needed
    return overlap == 1


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


#: Pairs below which a second thread does not pay: 0.2 ms.
FEWEST_MESH_DISTANCES = 16


class CoreRoom(NamedTuple):
    """Work space."""

    waiting: NodeStack
    corners: Floats  #: (1, 3, LANES) of a triangle, as of a hull


@njit
def core_room() -> CoreRoom:
    """Return work space for one pair after another."""
    return CoreRoom(node_stack(), np.empty((1, 3, LANES)))


class MeshCoreDistance(NamedTuple):
    """The distance of a mesh and a core, metres: bounds, points and direction."""

    lower: float
    upper: float  #: 0 where they overlap, infinite past the limit
    normal: Vector  #: unit, from the mesh to the core, in the frame of the mesh
    p: Vector  #: of the mesh, in its frame
    q: Vector  #: of the core, in its own


def mesh_body_distances(
    meshes: PlacedMeshes,
    radii: Floats,
    bodies: ConvexBodies,
    i: Integers,
    j: Integers,
    limit: float = np.inf,
) -> tuple[ConvexDistances, Mask]:
    """Return the distances of mesh ``i[n]``, with its radius, and body ``j[n]``; 0 if they collide.

    Also return (m,) which are within a limit; rows of others are not written. Bodies must not be
    hulls, which have trees.
    """
    near, bounds, vectors = out = distance_arrays(len(i))
    i, j = np.ascontiguousarray(i), np.ascontiguousarray(j)
    pairs = RowPairs(meshes.arrays, i, bodies.arrays, j)
    run(_mesh_kernel, len(i), FEWEST_MESH_DISTANCES, pairs, radii, limit, out)
    return ConvexDistances(*bounds, *vectors), near


@njit
def _mesh_kernel(
    pairs: RowPairs, radii: Floats, limit: float, out: DistanceArrays, start: int, stop: int
) -> None:
    a, rows_a, b, rows_b = pairs
    near, bounds, vectors = out
    room = core_room()
    for row in range(start, stop):
        mesh, core = body_at(a, rows_a[row]), core_at(b, rows_b[row])
        place = body_place(b, rows_b[row])
        radius = radii[rows_a[row]]
        reach = 2.0 * (a.trees.radii[mesh.mesh] + radius) + core.reach
        pose, both = relative_pose(mesh.place, place, reach), radius + core.radius
        slack = rounding(pose)
        apart = mesh_apart(a.trees, mesh.mesh, core, pose, limit + both + slack, room)
        least = max(apart.lower - both - slack, 0.0)
        near[row] = least <= limit and apart.upper < np.inf
        if not near[row]:
            continue
        p, q = in_world(mesh.place, apart.p), in_world(place, apart.q)
        way = towards(apart.p, moved(pose, apart.q), apart.normal)
        # where along no direction a gap is certain, that of the points is as good
        n = combined(mesh.place.axes, apart.normal if apart.lower > slack else way)
        way = combined(mesh.place.axes, way)
        most = max(apart.upper - both + slack, 0.0) if apart.upper > 0.0 else 0.0
        share = 1.0 if apart.upper >= both else apart.upper / both
        p, q = plus(p, scaled(way, share * radius)), minus(q, scaled(way, share * core.radius))
        n = n if most > 0.0 else ZERO
        bounds[0, row], bounds[1, row] = least, most
        for k in range(3):
            vectors[0, row, k], vectors[1, row, k], vectors[2, row, k] = p[k], q[k], n[k]


@njit(refcount=False)
def mesh_apart(
    trees: TreeArrays, mesh: int, core: Core, pose: PairPose, limit: float, room: CoreRoom
) -> MeshCoreDistance:
    """Return the distance of a mesh and a core, up to rounding; infinite past a limit."""
    nearest = nearest_triangle(trees, mesh, core, pose, limit, room)
    if not (nearest.lower > 0.0 and trees.solid[mesh]):
        return nearest
    if point_side(trees, mesh, pose.offset, pose.point_bound, room.waiting) == OUTSIDE_MESH:
        return nearest
    return MeshCoreDistance(0.0, 0.0, nearest.normal, pose.offset, ZERO)


class CoreSeen(NamedTuple):
    """A core in the frame of a mesh."""

    core: Core
    pose: PairPose
    box: NodeBox
    unit: float  #: a power of two that scales both to about 1
    corners: Floats  #: work space, as of ``CoreRoom``


class Nearest(NamedTuple):
    """The nearest triangle so far."""

    limit: float
    lower: float  #: lower bound of the distances of the triangles examined
    triangle: MeshCoreDistance


@njit(refcount=False)
def nearest_triangle(
    trees: TreeArrays, mesh: int, core: Core, pose: PairPose, limit: float, room: CoreRoom
) -> MeshCoreDistance:
    """Return the distance of the surface of a mesh and a core."""
    seen = seen_core(core, pose, room)
    start = Nearest(limit, limit, MeshCoreDistance(limit, np.inf, ZERO, ZERO, ZERO))
    nearest, passed = descend_nearest(
        trees, trees.roots[mesh], seen, core_apart, _with_triangle, start, room.waiting
    )
    lower, best = min(nearest.lower, passed - NODE_BOUND * pose.size), nearest.triangle
    return MeshCoreDistance(max(lower, 0.0), best.upper, best.normal, best.p, best.q)


@njit(merge=True)
def seen_core(core: Core, pose: PairPose, room: CoreRoom) -> CoreSeen:
    """Return a core without corners as the question of a descent."""
    box = NodeBox(pose.offset, pose.axes, (core.size[0], core.size[1], core.size[2] + core.half))
    return CoreSeen(core, pose, box, unit_scale(pose.size)[0], room.corners)


@njit(merge=True)
def core_apart(seen: CoreSeen, nodes: Floats, n: int) -> float:
    """Return a lower bound of the distance of the boxes of a node and a core, metres."""
    return boxes_apart(nodes, n, seen.box, seen.unit) / seen.unit


@njit(merge=True)
def _with_triangle(
    seen: CoreSeen, trees: TreeArrays, k: int, _: float, nearest: Nearest
) -> Nearest:
    limit, lower, best = nearest
    triangle = triangle_core(trees, k, seen.corners)
    apart = search(triangle, seen.core, seen.pose, best.normal, limit)
    lower = min(lower, apart.gap)
    if apart.gap > limit or not apart.distance < best.upper:
        return Nearest(limit, lower, best)
    nearer = apart.distance - SAME_DISTANCE * seen.pose.size
    limit = min(limit, nearer) if apart.distance > 0.0 else -np.inf
    best = MeshCoreDistance(apart.gap, apart.distance, apart.normal, apart.p, apart.q)
    return Nearest(limit, lower, best)


@njit(inline=True, refcount=False)
def triangle_core(trees: TreeArrays, k: int, room: Floats) -> Core:
    """Return triangle k as a core, its corners in ``room`` (1, 3, LANES); counts no references."""
    for lane in range(LANES):
        corner = 3 * min(lane, 2)
        for axis in range(3):
            room[0, axis, lane] = trees.triangles[k, corner + axis]
    return Core(HULL_CORE, ZERO, 0.0, room, 0, 1, 0.0, 0.0)
