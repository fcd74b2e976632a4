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

"""Rays against convex bodies, and against meshes with a radius about them.

Of convex bodies: round shapes, hulls, and what is within a radius of them.

A plane between a body and the point where the ray is (``convex.distance``) says how far the ray may
certainly go on; Newton's method on the distance along the ray, which is convex (van den Bergen
2004). A ray is missed only where it goes away from such a plane or is beyond its end, and the
distance is never later than the true one: at the hit, the ray is within 1e-9 of S of the body, S as
in ``convex.distance`` where it comes near.

Of meshes with a radius about them: balls swept over their triangles.

What is within a radius of a triangle is convex: a plane between the triangle and the point where
the ray is says how far the ray may certainly go on, as in ``rounded``. The first of all
triangles counts, down the tree of boxes that are larger by the radius. A ray is never late, and at
the hit it is within 1e-9 of S of the body, S the components of where it comes near, seen from the
mesh, plus the reach of the mesh and the radius. What a solid holds, and what is within the radius
of a surface, is inside (``points.bodies``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.vec3 import (
    combined,
    components,
    dot,
    max_abs,
    minus,
    negated,
    plus,
    scaled,
    sum_abs,
    vector_at,
)
from obb_collision.queries.convex.distance import CLOSE, CONVEX_ROUNDING, rounding, search
from obb_collision.queries.convex.support import Cores, body_place, core_at
from obb_collision.queries.meshes.inside import entry
from obb_collision.queries.meshes.placed import Meshes, body_at
from obb_collision.queries.meshes.tree_boxes import POINT_BOUND
from obb_collision.queries.meshes.tree_descent import STACK as TREE_STACK
from obb_collision.queries.meshes.tree_distance import APART
from obb_collision.queries.meshes.triangle_distance import careful_gap, triangle_bounds
from obb_collision.queries.meshes.triangles import triangle_at
from obb_collision.queries.points.bodies import (
    NOWHERE,
    body_holds,
    convex_holds,
    point_core,
    point_pose,
)
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.rays.boxes import (
    COUNT,
    STACK,
    START,
    BoundsTree,
    Ray,
    next_leaf,
    start_walk,
)
from obb_collision.queries.rays.mesh_rays import NONE, WITHIN, Work, moved_ahead
from obb_collision.typing import Floats, Vector

#: Steps at most: those that hit take 2 to 6, those that pass near an edge halve the way each time.
STEPS = 80
#: The speed towards a plane is off by 4 roundoffs, so that steps are shorter by twice that.
SPEED_ROUNDING = 8 * ROUNDOFF
MISS = np.inf, NOWHERE


@njit
def convex_rays_kernel(
    origins: Floats, units: Floats, reaches: Floats, bodies: Cores,
    limits: Floats, nodes: np.ndarray, order: np.ndarray,
    hits: np.ndarray, distances: Floats, points: Floats, normals: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    """Write the nearest body, distance, point and normal of rays ``start`` to ``stop``."""
    tree = BoundsTree(limits, nodes, order, np.empty(STACK, np.int64), np.empty(STACK))
    for n in range(start, stop):
        ray = Ray(vector_at(origins, n), vector_at(units, n), reaches[n])
        row, distance, normal = _nearest(ray, bodies, tree)
        hits[n], distances[n] = row, distance
        point = plus(ray.origin, scaled(ray.unit, distance))
        for k in range(3):
            points[n, k] = point[k] if row >= 0 else np.nan
            normals[n, k] = normal[k] if row >= 0 else np.nan


@njit
def _nearest(ray: Ray, bodies: Cores, tree: BoundsTree) -> tuple[int, float, Vector]:
    """Return the nearest body, its distance and the normal there; -1, infinity, zero for none."""
    row, best, normal = -1, np.inf, NOWHERE
    leaf, depth = next_leaf(ray, best, tree, start_walk(ray, tree))
    while leaf >= 0:
        start, count = tree.nodes[leaf, START], tree.nodes[leaf, COUNT]
        for m in range(start, start + count):
            b = tree.order[m]
            distance, across = hit_convex(ray, bodies, b, best)
            if distance < best or (distance == best < np.inf and b < row):
                row, best, normal = b, distance, across
        leaf, depth = next_leaf(ray, best, tree, depth)
    return row, best, normal


@njit
def hit_convex(ray: Ray, bodies: Cores, i: int, best: float) -> tuple[float, Vector]:
    """Return when a ray first hits body i, at most at ``best`` and within reach, and the normal.

    Infinity for a miss; zero, and no normal, for an origin inside.
    """
    core, place = core_at(bodies, i), body_place(bodies, i)
    d, ahead, error = moved_ahead(ray, place.center, 2.0 * core.reach)
    if ahead < 0.0:
        return MISS
    if ahead == 0.0 and convex_holds(bodies, i, ray.origin, 0.0):
        return 0.0, NOWHERE
    o, w = components(place.axes, d), components(place.axes, ray.unit)
    limit = min(min(best, ray.reach) - ahead, 8.0 * core.reach)  # by then it is beyond the body
    point = point_core(core)
    time, n = 0.0, NOWHERE
    for _ in range(STEPS):
        pose = point_pose(plus(o, scaled(w, time)), sum_abs(d) + time, core.reach)
        found = search(core, point, pose, n, np.inf)
        n = found.normal
        slack = 2.0 * rounding(pose) + 3.0 * error
        gap, speed = found.gap - core.radius - slack, -dot(n, w)
        if gap > 0.0 and speed <= -SPEED_ROUNDING:
            return MISS
        if gap <= CLOSE * pose.size:
            break
        time += gap / max(speed + SPEED_ROUNDING, SPEED_ROUNDING)
        if time > limit:
            return MISS
    return ahead + time, combined(place.axes, n)


Hit = tuple[float, int, Vector]
"""When, which triangle (NONE, WITHIN), and the outward normal there."""
MISSED: Hit = (np.inf, NONE, NOWHERE)


class PaddedRay(NamedTuple):
    """A ray in the frame of a body."""

    origin: Vector
    unit: Vector
    error: float  #: by how much a component of a point of it may be off
    size: float  #: S at its origin


@njit
def padded_rays_kernel(
    origins: Floats, units: Floats, reaches: Floats, bodies: Meshes, radii: Floats,
    limits: Floats, nodes: np.ndarray, order: np.ndarray,
    hits: np.ndarray, distances: Floats, points: Floats, normals: Floats, faces: np.ndarray,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Write the nearest body, distance, point, normal and face of rays ``start`` to ``stop``."""
    tree = BoundsTree(limits, nodes, order, np.empty(STACK, np.int64), np.empty(STACK))
    work = Work(np.empty((TREE_STACK, 2), np.int64), np.empty(TREE_STACK))
    for n in range(start, stop):
        ray = Ray(vector_at(origins, n), vector_at(units, n), reaches[n])
        row, (distance, triangle, normal) = _nearest_padded(ray, bodies, radii, tree, work)
        hits[n], distances[n], faces[n] = row, distance, -1
        if triangle >= 0:
            faces[n] = bodies.trees.faces[triangle]
        point = plus(ray.origin, scaled(ray.unit, distance))
        for k in range(3):
            points[n, k] = point[k] if row >= 0 else np.nan
            normals[n, k] = normal[k] if row >= 0 else np.nan


@njit
def _nearest_padded(
    ray: Ray, bodies: Meshes, radii: Floats, tree: BoundsTree, work: Work
) -> tuple[int, Hit]:
    """Return the nearest body and the hit; -1 for none."""
    row, best = -1, MISSED
    leaf, depth = next_leaf(ray, best[0], tree, start_walk(ray, tree))
    while leaf >= 0:
        start, count = tree.nodes[leaf, START], tree.nodes[leaf, COUNT]
        for m in range(start, start + count):
            b = tree.order[m]
            found = hit_padded(ray, bodies, b, radii[b], best[0], work)
            if found[0] < best[0] or (found[0] == best[0] < np.inf and b < row):
                row, best = b, found
        leaf, depth = next_leaf(ray, best[0], tree, depth)
    return row, best


@njit
def hit_padded(ray: Ray, bodies: Meshes, i: int, radius: float, best: float, work: Work) -> Hit:
    """Return when a ray first hits body i or is within a radius of it, at most at ``best``.

    Zero, WITHIN and no normal for an origin inside.
    """
    trees, body = bodies.trees, body_at(bodies, i)
    reach = trees.radii[body.mesh] + radius
    d, ahead, error = moved_ahead(ray, body.place.center, 2.0 * reach)
    if ahead < 0.0:
        return MISSED
    if ahead == 0.0 and body_holds(bodies, i, ray.origin, radius, work.stack):
        return 0.0, WITHIN, NOWHERE
    error += POINT_BOUND * (sum_abs(d) + reach) + MESH_UNDERFLOW
    o, w = components(body.place.axes, d), components(body.place.axes, ray.unit)
    limit = min(min(best, ray.reach) - ahead, 8.0 * reach)  # by then it is beyond the body
    local = PaddedRay(o, w, error, sum_abs(d) + reach)
    time, triangle, n = _first_triangle(trees, trees.roots[body.mesh], local, radius, limit, work)
    if triangle < 0:
        return MISSED
    return ahead + time, triangle, negated(combined(body.place.axes, n))


@njit
def _first_triangle(
    trees: TreeArrays, root: int, ray: PaddedRay, radius: float, limit: float, work: Work
) -> Hit:
    """Return the first rounded triangle hit, at most at ``limit``; the normal points inwards."""
    nodes, children, starts = trees.nodes, trees.children, trees.starts
    stack, entries = work.stack, work.entries
    p, w, grown = ray.origin, ray.unit, ray.error + 0.5 * radius  # boxes grow by twice the error
    best, triangle, normal = limit, NONE, NOWHERE
    stack[0, 0], entries[0] = root, entry(nodes, root, p, w, grown)
    waiting = 1
    while waiting > 0:
        waiting -= 1
        if not entries[waiting] <= best:
            continue
        node = stack[waiting, 0]
        child = children[node]
        if child < 0:
            for k in range(starts[node, 0], starts[node, 1]):
                time, n = rounded_time(trees.triangles, k, ray, radius, entries[waiting], best)
                if time < best or (time == best and triangle < 0):
                    best, triangle, normal = time, k, n
            continue
        first = entry(nodes, child, p, w, grown)
        second = entry(nodes, child + 1, p, w, grown)
        one, two = child, child + 1
        if first < second:
            one, two, first, second = two, one, second, first
        stack[waiting, 0], stack[waiting + 1, 0] = one, two
        entries[waiting], entries[waiting + 1] = first, second
        waiting += 2
    return best, triangle, normal


@njit
def rounded_time(
    triangles: Floats, k: int, ray: PaddedRay, radius: float, begin: float, limit: float
) -> tuple[float, Vector]:
    """Return a time before which a ray is certainly not near triangle k, and the way to it then.

    Infinity if it never is within the radius, or not before a limit; begin: before that it is not.
    """
    a, b, c = triangle_at(triangles, k)
    time, n = begin, NOWHERE
    for _ in range(STEPS):
        p = plus(ray.origin, scaled(ray.unit, time))
        size = ray.size + time
        gap, n = _point_apart(minus(a, p), minus(b, p), minus(c, p), n, size)
        gap -= radius + 2.0 * (CONVEX_ROUNDING * size + ray.error)
        speed = dot(n, ray.unit)
        if gap > 0.0 and speed <= -SPEED_ROUNDING:
            return np.inf, n
        if gap <= CLOSE * size:
            break
        time += gap / max(speed + SPEED_ROUNDING, SPEED_ROUNDING)
        if time > limit:
            return np.inf, n
    return time, n


@njit
def _point_apart(
    a: Vector, b: Vector, c: Vector, start: Vector, size: float
) -> tuple[float, Vector]:
    """Return how far a triangle is from the origin at least, and the unit direction to it.

    start: the direction to try first, unless zero.
    """
    unit, back = unit_scale(size)
    corners = scaled(a, unit), scaled(b, unit), scaled(c, unit)
    origin = NOWHERE, NOWHERE, NOWHERE
    n = start if max_abs(start) > 0.0 else corners[0]
    lower, upper, n = triangle_bounds(corners, origin, n, np.inf)
    if upper - lower > APART:
        gap, direction = careful_gap(corners, origin)
        if gap > lower:
            lower, n = gap, direction
    return lower * back, n
