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

"""The distance of a placed mesh and a convex body with a formula, such as a cylinder beside it.

Branch and bound over the tree of the mesh, as in ``meshes.tree_distance``, where the body is its
box; the distance of a triangle is that of its three corners and the core (``distance``). What is
promised is the same as of two convex bodies: no lower bound is above the truth, the points are the
upper bound apart, and both agree to 1e-9 of S, the offset of both and their reach.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.intrinsics import LANES
from obb_collision.numerics.vec3 import combined, minus, plus, scaled
from obb_collision.queries.convex.distance import rounding, search
from obb_collision.queries.convex.distances import ConvexDistances, in_world, towards
from obb_collision.queries.convex.support import (
    CORNERS,
    ConvexBodies,
    Core,
    Cores,
    body_place,
    core_at,
)
from obb_collision.queries.meshes.inside import OUTSIDE, point_side
from obb_collision.queries.meshes.placed import Meshes as MeshBodies
from obb_collision.queries.meshes.placed import PlacedMeshes, body_at
from obb_collision.queries.meshes.tree_boxes import NodeBox, Pose, moved, relative_pose
from obb_collision.queries.meshes.tree_descent import STACK
from obb_collision.queries.meshes.tree_distance import NODE_BOUND, SLACK, boxes_apart
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.typing import Floats, Integers, Mask, Vector

#: Pairs below which a second thread does not pay: 0.2 ms.
FEWEST_PAIRS = 16
NOWHERE = 0.0, 0.0, 0.0


class CoreRoom(NamedTuple):
    """Work space."""

    stack: np.ndarray  #: (STACK, 2) nodes, in the first column
    bounds: Floats  #: (STACK,) how far from the body they are at least, metres
    corners: Floats  #: (1, 3, LANES) of a triangle, as of a hull


class Near(NamedTuple):
    """How far a mesh and a core are apart, metres: bounds, points and direction."""

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

    And (m,) which are within a limit; rows of the others are not written to. Bodies have no
    corners: hulls have trees.
    """
    near = np.empty(len(i), np.bool_)
    bounds, vectors = np.empty((2, len(i))), np.empty((3, len(i), 3))
    run(
        *(_kernel, len(i), FEWEST_PAIRS, meshes.arrays, i, radii, bodies.arrays, j, limit, near),
        *(bounds[0], bounds[1], vectors[0], vectors[1], vectors[2]),
    )
    return ConvexDistances(*bounds, *vectors), near


@njit
def _kernel(
    a: MeshBodies, rows_a: np.ndarray, radii: Floats, b: Cores, rows_b: np.ndarray, limit: float,
    near: np.ndarray, lower: Floats, upper: Floats, positions_a: Floats, positions_b: Floats,
    normals: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    corners = np.empty((1, 3, LANES))
    room = CoreRoom(np.empty((STACK, 2), np.int64), np.empty(STACK), corners)
    for row in range(start, stop):
        mesh, core = body_at(a, rows_a[row]), core_at(b, rows_b[row])
        place = body_place(b, rows_b[row])
        radius = radii[rows_a[row]]
        reach = 2.0 * (a.trees.radii[mesh.mesh] + radius) + core.reach
        pose, both = relative_pose(mesh.place, place, reach), radius + core.radius
        slack = rounding(pose)
        found = mesh_apart(a.trees, mesh.mesh, core, pose, limit + both + slack, room)
        least = max(found.lower - both - slack, 0.0)
        near[row] = least <= limit and found.upper < np.inf
        if not near[row]:
            continue
        p, q = in_world(mesh.place, found.p), in_world(place, found.q)
        way = towards(found.p, moved(pose, found.q), found.normal)
        # where along no direction a gap is certain, that of the points is as good
        n = combined(mesh.place.axes, found.normal if found.lower > slack else way)
        way = combined(mesh.place.axes, way)
        most = max(found.upper - both + slack, 0.0) if found.upper > 0.0 else 0.0
        share = 1.0 if found.upper >= both else found.upper / both
        p, q = plus(p, scaled(way, share * radius)), minus(q, scaled(way, share * core.radius))
        n = n if most > 0.0 else NOWHERE
        lower[row], upper[row] = least, most
        for k in range(3):
            positions_a[row, k], positions_b[row, k], normals[row, k] = p[k], q[k], n[k]


@njit
def mesh_apart(
    trees: TreeArrays, mesh: int, core: Core, pose: Pose, limit: float, room: CoreRoom
) -> Near:
    """Return how far a mesh and a core are apart, but for rounding; infinite past a limit."""
    found = nearest_triangle(trees, mesh, core, pose, limit, room)
    if not (found.lower > 0.0 and trees.solid[mesh]):
        return found
    if point_side(trees, mesh, pose.offset, pose.point_bound, room.stack) == OUTSIDE:
        return found
    return Near(0.0, 0.0, found.normal, pose.offset, NOWHERE)


@njit
def nearest_triangle(
    trees: TreeArrays, mesh: int, core: Core, pose: Pose, limit: float, room: CoreRoom
) -> Near:
    """Return how far the surface of a mesh and a core are apart."""
    nodes, children, starts = trees.nodes, trees.children, trees.starts
    stack, bounds, unit = room.stack, room.bounds, unit_scale(pose.size)[0]
    box = box_of(core, pose)
    best, slack = Near(limit, np.inf, NOWHERE, NOWHERE, NOWHERE), SLACK * pose.size
    lower, enough = limit, limit
    stack[0, 0], waiting = trees.roots[mesh], 1
    bounds[0] = boxes_apart(nodes, stack[0, 0], box, unit) / unit
    while waiting > 0:
        waiting -= 1
        node, least = stack[waiting, 0], bounds[waiting]
        if least >= enough:
            lower = min(lower, least - NODE_BOUND * pose.size)
            continue
        child = children[node]
        if child < 0:
            for k in range(starts[node, 0], starts[node, 1]):
                found = _triangle_apart(trees, k, core, pose, best.normal, enough, room.corners)
                lower = min(lower, found.lower)
                if found.upper < best.upper:
                    best, enough = found, min(enough, found.upper - slack)
            if best.upper == 0.0:
                break
            continue
        first = boxes_apart(nodes, child, box, unit) / unit
        second = boxes_apart(nodes, child + 1, box, unit) / unit
        near, far = (child, child + 1) if first <= second else (child + 1, child)
        stack[waiting, 0], stack[waiting + 1, 0] = far, near
        bounds[waiting], bounds[waiting + 1] = max(first, second, least), min(first, second)
        bounds[waiting + 1] = max(bounds[waiting + 1], least)
        waiting += 2
    return Near(max(lower, 0.0), best.upper, best.normal, best.p, best.q)


@njit
def _triangle_apart(
    trees: TreeArrays, k: int, core: Core, pose: Pose, start: Vector, enough: float, room: Floats
) -> Near:
    """Return how far triangle k and a core are apart; beyond ``enough`` only that they are."""
    triangle = triangle_core(trees, k, room)
    found = search(triangle, core, pose, start, enough)
    if found.gap > enough:
        return Near(found.gap, np.inf, found.normal, NOWHERE, NOWHERE)
    return Near(found.gap, found.distance, found.normal, found.p, found.q)


@njit
def box_of(core: Core, pose: Pose) -> NodeBox:
    """Return the box of a core that has no corners, seen from the mesh."""
    return NodeBox(pose.offset, pose.axes, (core.size[0], core.size[1], core.size[2] + core.half))


@njit
def triangle_core(trees: TreeArrays, k: int, room: Floats) -> Core:
    """Return triangle k as a core, whose corners are written to (1, 3, LANES)."""
    for lane in range(LANES):
        corner = 3 * min(lane, 2)
        for axis in range(3):
            room[0, axis, lane] = trees.triangles[k, corner + axis]
    kind: int = np.int8(CORNERS)  # type: ignore[assignment]
    return Core(kind, NOWHERE, 0.0, room, 0, 1, 0.0, 0.0)
