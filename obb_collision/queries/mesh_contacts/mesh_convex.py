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

"""Depth of the overlap of a mesh and a convex body with a formula, such as a cylinder.

As in ``mesh_mesh``, but for the body itself. It begins with the depth of a shape around the body,
such as a mesh: that push is shortened until the body is just free. Then, as long as it gets better,
the body is pushed along the direction across which they touch at the end. The way out of a triangle
is found from beyond it: a plane between the two tells how far the body may certainly go back. Radii
need no other treatment, as a convex body with a radius about it is convex.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.vec3 import (
    ZERO,
    combined,
    dot,
    minus,
    plus,
    scaled,
    vector_at,
    write_at,
)
from obb_collision.queries.convex.distance import CLOSE, core_gap, search
from obb_collision.queries.convex.distances import (
    CoreRoom,
    CoreSeen,
    core_apart,
    core_room,
    mesh_body_distances,
    nearest_triangle,
    seen_core,
    triangle_core,
    turned_back,
)
from obb_collision.queries.convex.support import ConvexBodies, Core, body_place, core_at
from obb_collision.queries.mesh_contacts.mesh_mesh import (
    CERTAIN_GAP,
    MOST_CHANGES,
    MOST_PLACES,
    PUSH_MARGIN,
    SAME_DIRECTION,
    WORTHWHILE_GAIN,
    DepthArrays,
    Push,
    moved_by,
    replace_outer,
)
from obb_collision.queries.meshes.inside import OUTSIDE_MESH, point_side
from obb_collision.queries.meshes.placed import (
    PairPose,
    PlacedMeshes,
    body_at,
    moved,
    relative_pose,
)
from obb_collision.queries.meshes.trees import descend_nearest
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.queries.verdict.verdict import Separations
from obb_collision.typing import Floats, Integers, Vector

#: Pairs below which a second thread does not pay: 1 ms.
FEWEST_BODY_DEPTHS = 4
#: Maximum number of steps back to a triangle; most pairs take 2 to 6.
MOST_STEPS_BACK = 40


class MeshAndCore(NamedTuple):
    """A mesh, and a core seen from it."""

    mesh: int
    core: Core
    pose: PairPose
    radii: float  #: of both


def within_bodies(
    outer: Separations, meshes: PlacedMeshes, radii: Floats, bodies: ConvexBodies
) -> Separations:
    """Return the separations of meshes, with radii (m,), and bodies in the same rows (m,).

    outer: those of anything that contains them. Its arrays are written to.
    """
    rows = np.arange(len(radii))
    near, _ = mesh_body_distances(meshes, radii, bodies, rows, rows)

    def shorten(deep: Integers, depths: DepthArrays) -> None:
        pairs = RowPairs(meshes.arrays, deep, bodies.arrays, deep)
        run(_kernel, len(deep), FEWEST_BODY_DEPTHS, pairs, radii, depths)

    return replace_outer(outer, near.lower, near, shorten)


@njit
def _kernel(pairs: RowPairs, radii: Floats, out: DepthArrays, start: int, stop: int) -> None:
    """Replace depths (k,), normals and positions (k, 3) of rows (k,) where a push is shorter."""
    a, rows, b, _ = pairs
    depths, normals, positions = out
    room = core_room()
    for k in range(start, stop):
        row = rows[k]
        mesh, core, place = body_at(a, row), core_at(b, row), body_place(b, row)
        reach = 2.0 * (a.trees.radii[mesh.mesh] + radii[row]) + core.reach + depths[k]
        pose = relative_pose(mesh.place, place, reach)
        pair = MeshAndCore(mesh.mesh, core, pose, radii[row] + core.radius)
        n = turned_back(mesh.place, vector_at(normals, k))
        best, n = _shortened(a.trees, pair, n, depths[k], room)
        if not best.length < depths[k]:
            continue
        p = plus(best.p, scaled(best.across, radii[row]))
        q = minus(best.q, scaled(best.across, core.radius))
        middle = plus(combined(mesh.place.axes, scaled(plus(p, q), 0.5)), mesh.place.center)
        n = combined(mesh.place.axes, n)
        depths[k] = best.length
        write_at(normals, k, n)
        write_at(positions, k, middle)


@njit(merge=True)
def _shortened(
    trees: TreeArrays, pair: MeshAndCore, n: Vector, most: float, room: CoreRoom
) -> tuple[Push, Vector]:
    """Return the shortest push below ``most``, and its direction; the first to try is n."""
    best, way, length = Push(np.inf, n, n, n), n, most
    for k in range(1 + MOST_CHANGES):
        push = push_body_out(trees, pair, way, length, room)
        if not push.length < length:
            break
        small = k > 0 and push.length > (1.0 - WORTHWHILE_GAIN) * length
        best, n, length, way = push, way, push.length, push.across
        if small or dot(way, n) > SAME_DIRECTION:
            break
    return best, n


@njit(merge=True)
def push_body_out(
    trees: TreeArrays, pair: MeshAndCore, n: Vector, most: float, room: CoreRoom
) -> Push:
    """Return the shortest push of a body along n, unit, after which it is certainly free.

    Ends past ``most``. A body within a solid is pushed as far as the surface, and then by half of
    its least thickness: at both places it has points in common with the surface, so it cannot have
    passed it. Needles take longer steps there, and may pass.
    """
    size, needed = pair.pose.size, pair.radii + CERTAIN_GAP * pair.pose.size
    margin = PUSH_MARGIN * size + MESH_UNDERFLOW
    x, y, z = pair.core.size
    thinnest, length = min(x, y, z + pair.core.half), 0.0
    for _ in range(MOST_PLACES):
        if not length <= most:
            break
        here = moved_by(pair.pose, n, length)
        near = nearest_triangle(trees, pair.mesh, pair.core, here, np.inf, room)
        if not near.lower > needed:
            way = _farthest_way_out(trees, pair, here, n, needed, room)
            length += max(way, 0.0) + margin
        elif trees.solid[pair.mesh] and _is_inside(trees, pair.mesh, here, room):
            length += near.lower + max(0.5 * thinnest, 0.25 * near.lower)
        else:
            q = minus(moved(here, near.q), scaled(n, length))
            return Push(length, near.p, q, near.normal)
    return Push(np.inf, ZERO, ZERO, n)


@njit(merge=True)
def _is_inside(trees: TreeArrays, mesh: int, pose: PairPose, room: CoreRoom) -> bool:
    return point_side(trees, mesh, pose.offset, pose.point_bound, room.waiting) != OUTSIDE_MESH


class WayOutSearch(NamedTuple):
    """A core pushed along n until it is farther than ``needed`` from triangles."""

    seen: CoreSeen
    n: Vector
    needed: float


class LongestWay(NamedTuple):
    """The longest way out so far, metres."""

    limit: float
    longest: float


@njit(refcount=False)
def _farthest_way_out(
    trees: TreeArrays, pair: MeshAndCore, pose: PairPose, n: Vector, enough: float, room: CoreRoom
) -> float:
    """Return the longest way out of the triangles that are too near to a core, metres."""
    question = WayOutSearch(seen_core(pair.core, pose, room), n, enough)
    start = LongestWay(enough + CLOSE * pose.size, -np.inf)
    root, waiting = trees.roots[pair.mesh], room.waiting
    way, _ = descend_nearest(trees, root, question, _push_apart, _with_way, start, waiting)
    return way.longest


@njit(merge=True)
def _push_apart(out: WayOutSearch, nodes: Floats, n: int) -> float:
    return core_apart(out.seen, nodes, n)


@njit(merge=True)
def _with_way(
    out: WayOutSearch, trees: TreeArrays, k: int, _: float, way: LongestWay
) -> LongestWay:
    seen = out.seen
    triangle = triangle_core(trees, k, seen.corners)
    longest = _way_out(triangle, seen.core, seen.pose, out.n, out.needed, way.longest)
    return LongestWay(way.limit, longest)


@njit(merge=True)
def _way_out(
    triangle: Core, core: Core, pose: PairPose, n: Vector, needed: float, best: float
) -> float:
    """Return how far a core must go along n to leave a triangle, or ``best`` if that is more."""
    length = needed - core_gap(triangle, core, pose, n).value  # from there on n parts them
    if not length > best or search(triangle, core, pose, ZERO, needed).gap > needed:
        return best
    across = n
    for _ in range(MOST_STEPS_BACK):
        touching = search(triangle, core, moved_by(pose, n, length), across, np.inf)
        across = touching.normal
        gap, speed = touching.gap - needed, dot(n, across)
        if not (gap > CLOSE * pose.size and speed > 0.0):
            break
        length -= gap / speed
        if not length > best:
            return best
    return length
