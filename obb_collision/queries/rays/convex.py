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

"""Rays against convex bodies: round shapes, hulls, and what is within a radius of them.

A plane between a body and the point where the ray is (``convex.distance``) says how far the ray may
certainly go on; Newton's method on the distance along the ray, which is convex (van den Bergen
2004). A ray is missed only where it goes away from such a plane or is beyond its end, and the
distance is never later than the true one: at the hit, the ray is within 1e-9 of S of the body, S as
in ``convex.distance`` where it comes near.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import (
    combined,
    components,
    dot,
    plus,
    scaled,
    sum_abs,
)
from obb_collision.queries.convex.distance import CLOSE, rounding, search
from obb_collision.queries.convex.support import Cores, body_place, core_at
from obb_collision.queries.points.bodies import (
    NOWHERE,
    convex_holds,
    point_core,
    point_pose,
)
from obb_collision.queries.rays.boxes import (
    COUNT,
    START,
    HitArrays,
    Ray,
    Rays,
    RayTree,
    TreeNodes,
    moved_ahead,
    next_leaf,
    ray_at,
    ray_tree,
    start_walk,
    write_hit,
)
from obb_collision.typing import Vector

#: Steps at most: those that hit take 2 to 6, those that pass near an edge halve the way each time.
STEPS = 80
#: The speed towards a plane is off by 4 roundoffs, so that steps are shorter by twice that.
SPEED_ROUNDING = 8 * ROUNDOFF
MISS = np.inf, NOWHERE


@njit
def convex_rays_kernel(
    rays: Rays, bodies: Cores, nodes: TreeNodes, out: HitArrays, start: int, stop: int
) -> None:
    """Write what rays ``start`` to ``stop`` hit."""
    tree = ray_tree(nodes)
    for n in range(start, stop):
        ray = ray_at(rays, n)
        row, distance, normal = _nearest(ray, bodies, tree)
        write_hit(out, n, ray, row, distance, normal)


@njit(refcount=False)
def _nearest(ray: Ray, bodies: Cores, tree: RayTree) -> tuple[int, float, Vector]:
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
