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

"""Rays against meshes, down the tree of their boxes, and against convex bodies.

A triangle is missed only where that is certain, and the distance is never later than the true one:
a ray that passes an edge within rounding hits it. The ray is moved ahead to where it comes near the
mesh, so that far origins cost few digits.

Error analysis: the ray is moved ahead in the world frame, off by 6 u of the components of the
origin from the body's centre; ``AHEAD_BOUND`` is 16 u. With S the components of where it is then
plus the reach of the mesh, a point of the ray near the body is off by at most 256 u S in the frame
of the body, as a corner of another mesh would be. So are all corners seen from the ray, by the same
vector; edges are not. Determinants round as in ``triangles``. The time det(a, u, v) /
det(w, u, v), u and v edges, is off by their errors over the denominator; where that is not
certainly away from zero, as for a ray within the plane, the corners bound it: the ray is not
in the triangle before the first corner. Triangles of which an edge is too near are missed where the
ray passes beyond a corner: with R the reach of the corners from the ray's start, they less their
parts along it are off by the error of a point and 24 u R, for which ``SLAB_SLACK`` is 32 u, three
times.

Convex bodies (round shapes and hulls, with a radius about them): a plane between a body and
the point where the ray is (``convex.distance``) says how far the ray may certainly go on; Newton's
method on the distance along the ray, which is convex (van den Bergen 2004). A ray is missed only
where it goes away from such a plane or is beyond its end, and the distance is never later than the
true one: at the hit, the ray is within 1e-9 of S of the body, S as in ``convex.distance`` where it
comes near.

With a radius about a mesh, balls are swept over its triangles. What is within a radius of one is
convex: rays go on as there, down the tree of boxes that are larger by the radius. At the hit a ray
is within 1e-9 of S of the body, S with the radius. An origin in a solid, or within the radius of a
surface, is inside (``points``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.constants import MESH_UNDERFLOW, PRODUCT_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.vec3 import (
    ZERO,
    combined,
    components,
    cross,
    dot,
    max_abs,
    minus,
    negated,
    norm,
    plus,
    scaled,
    sum_abs,
)
from obb_collision.queries.convex.distance import CLOSE, CONVEX_ROUNDING, rounding, search
from obb_collision.queries.convex.support import Cores, body_place, borrowed_core
from obb_collision.queries.meshes.inside import OUTSIDE_MESH, SLAB_SLACK, entry, point_side
from obb_collision.queries.meshes.placed import POINT_BOUND, MeshAt, Meshes, body_at
from obb_collision.queries.meshes.trees import LOOSE_BOUNDS, NodeStack
from obb_collision.queries.meshes.triangle_distance import careful_triangle_gap, triangle_bounds
from obb_collision.queries.meshes.triangles import DETERMINANT_ROUNDING, Triangle, triangle_at
from obb_collision.queries.points.containment import (
    body_holds,
    convex_holds,
    point_core,
    point_pose,
)
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.rays.boxes import MISSED, NO_FACE, ORIGIN_INSIDE, Hit, Ray, moved_ahead
from obb_collision.typing import Floats, Vector

#: Maximum number of steps: rays that hit take 2 to 6, those near an edge halve the way each time.
MOST_RAY_STEPS = 80
#: The speed towards a plane is off by 4 roundoffs, so that steps are shorter by twice that.
SPEED_ROUNDING = 8 * ROUNDOFF


class LocalRay(NamedTuple):
    """A ray in the frame of a body."""

    origin: Vector
    unit: Vector
    error: float  #: by how much a component of a point of it may be off
    scale: float  #: a power of two that brings the reach of the mesh to about one
    size: float  #: S at its origin
    radius: float  #: about the mesh; negative: without


@njit(merge=True)
def hit_mesh(ray: Ray, bodies: Meshes, i: int, radius: float, best: float, room: NodeStack) -> Hit:
    """Return when a ray first hits body i or comes within a radius of it, at most at ``best``.

    Zero, ORIGIN_INSIDE and no normal for an origin inside; no normal without a radius.
    """
    trees, body, grown = bodies.trees, body_at(bodies, i), max(radius, 0.0)
    reach = trees.radii[body.mesh] + grown
    d, ahead, error = moved_ahead(ray, body.place.center, 2.0 * reach)
    if ahead < 0.0:
        return MISSED
    size = sum_abs(d) + reach
    error += POINT_BOUND * size + MESH_UNDERFLOW
    o, w = components(body.place.axes, d), components(body.place.axes, ray.unit)
    limit = min(best, ray.reach) - ahead
    if radius >= 0.0:
        limit = min(limit, 8.0 * reach)  # by then it is beyond the body
        if ahead == 0.0 and body_holds(bodies, i, ray.origin, radius, room):
            return 0.0, ORIGIN_INSIDE, ZERO
    elif ahead == 0.0 and trees.solid[body.mesh]:  # noqa: SIM102  # a search comes last
        if point_side(trees, body.mesh, o, error, room) != OUTSIDE_MESH:
            return 0.0, ORIGIN_INSIDE, ZERO
    local = LocalRay(o, w, error, unit_scale(reach)[0], size, radius)
    time, triangle, n = _first_triangle(trees, trees.roots[body.mesh], local, limit, room)
    if triangle < 0:
        return MISSED
    return ahead + time, triangle, negated(combined(body.place.axes, n))


@njit(refcount=False)
def _first_triangle(
    trees: TreeArrays, root: int, ray: LocalRay, limit: float, room: NodeStack
) -> Hit:
    """Return the first triangle hit, at most at ``limit``; the normal points inwards.

    Not ``trees.descend_nearest``, which takes 3 % longer, and 8 % with a radius.
    """
    nodes, children, starts = trees.nodes, trees.children, trees.starts
    stack, entries = room.nodes, room.bounds
    p, w, error = ray.origin, ray.unit, ray.error
    if ray.radius >= 0.0:
        error += 0.5 * ray.radius  # boxes grow by twice the error
    best, triangle, normal = limit, NO_FACE, ZERO
    stack[0, 0], entries[0] = root, entry(nodes, root, p, w, error)
    waiting = 1
    while waiting > 0:
        waiting -= 1
        if not entries[waiting] <= best or entries[waiting] == np.inf:
            continue
        node = stack[waiting, 0]
        child = children[node]
        if child < 0:
            for n in range(starts[node, 0], starts[node, 1]):
                if ray.radius >= 0.0:
                    time, way = rounded_time(trees.triangles, n, ray, entries[waiting], best)
                else:
                    time, way = triangle_time(trees.triangles, n, ray), ZERO
                if time < best or (time == best < np.inf and triangle < 0):
                    best, triangle, normal = time, n, way
            continue
        first = entry(nodes, child, p, w, error)
        second = entry(nodes, child + 1, p, w, error)
        far, near = child, child + 1
        if first < second:
            far, near, first, second = near, far, second, first
        stack[waiting, 0], stack[waiting + 1, 0] = far, near
        entries[waiting], entries[waiting + 1] = first, second
        waiting += 2
    return best, triangle, normal


@njit(merge=True)
def triangle_time(triangles: Floats, n: int, ray: LocalRay) -> float:
    """Return a time before which a ray is certainly not in a triangle, infinity if it never is."""
    w, unit, error = ray.unit, ray.scale, ray.scale * ray.error
    p, (a, b, c) = ray.origin, triangle_at(triangles, n)
    u, v, x = scaled(minus(b, a), unit), scaled(minus(c, b), unit), scaled(minus(a, c), unit)
    a, b, c = scaled(minus(a, p), unit), scaled(minus(b, p), unit), scaled(minus(c, p), unit)
    ab, bc, ca = _side(w, a, u, error), _side(w, b, v, error), _side(w, c, x, error)
    if min(ab, bc, ca) < 0 < max(ab, bc, ca):
        return np.inf
    first, second, third = dot(w, a), dot(w, b), dot(w, c)
    reach = max(max_abs(a), max_abs(b), max_abs(c))
    slack = SLAB_SLACK * 3.0 * reach + 4.0 * error
    low, high = min(first, second, third) - slack, max(first, second, third) + slack
    m = cross(u, v)
    slope, height = dot(m, w), dot(m, a)
    edges = max_abs(u) * max_abs(v)
    doubt = DETERMINANT_ROUNDING * edges * max_abs(w) + PRODUCT_UNDERFLOW
    if abs(slope) > 2.0 * doubt:
        time = height / slope
        off = DETERMINANT_ROUNDING * edges * max_abs(a) + 2.0 * error * sum_abs(m)
        off = (off + abs(time) * doubt + PRODUCT_UNDERFLOW) / (abs(slope) - doubt)
        low, high = max(low, time - off), min(high, time + off)
    if low > high or high < 0.0:
        return np.inf
    if (ab == 0 or bc == 0 or ca == 0) and _beyond_a_corner((a, b, c), w, slack):
        return np.inf
    return max(low, 0.0) / unit


@njit(refcount=False)
def _beyond_a_corner(triangle: Triangle, w: Vector, slack: float) -> bool:
    """Return whether a ray from zero along w certainly passes beyond a corner, seen along the ray.

    For triangles without area, whose edges do not tell where they end: beyond the end all corners
    are on one side of the plane across the way to the nearest one. slack: the error of a component
    of a corner, less its part along w.
    """
    a, b, c = triangle
    a = minus(a, scaled(w, dot(a, w)))
    b = minus(b, scaled(w, dot(b, w)))
    c = minus(c, scaled(w, dot(c, w)))
    for v in (a, b, c):
        least = min(dot(v, a), dot(v, b), dot(v, c))
        if least > 2.0 * slack * sum_abs(v) + PRODUCT_UNDERFLOW:
            return True
    return False


@njit
def _side(w: Vector, a: Vector, edge: Vector, error: float) -> int:
    """Return on which side of the line through a along an edge the ray passes; 0 if too near.

    All corners are off by the same vector: the error counts for the edge, not for its distance.
    """
    across = cross(edge, w)
    value = dot(a, across)
    bound = DETERMINANT_ROUNDING * max_abs(a) * max_abs(edge) * max_abs(w) + PRODUCT_UNDERFLOW
    bound += 2.0 * error * sum_abs(across)
    return 1 if value > bound else (-1 if value < -bound else 0)


@njit(refcount=False)
def triangle_normal(ray: Ray, trees: TreeArrays, triangle: int, body: MeshAt) -> Vector:
    """Return the unit normal of a triangle, against the ray; zero for one without area."""
    a, b, c = triangle_at(trees.triangles, triangle)
    n = cross(_direction(minus(b, a)), _direction(minus(c, a)))
    n = _direction(combined(body.place.axes, n))
    side = -1.0 if dot(ray.unit, n) > 0.0 else 1.0
    return side * n[0] + 0.0, side * n[1] + 0.0, side * n[2] + 0.0


@njit
def _direction(v: Vector) -> Vector:
    length = norm(v)
    if not length > 0.0:
        return ZERO
    return v[0] / length, v[1] / length, v[2] / length


@njit(merge=True)
def rounded_time(
    triangles: Floats, k: int, ray: LocalRay, begin: float, limit: float
) -> tuple[float, Vector]:
    """Return a time before which a ray is certainly not near triangle k, and the way to it then.

    Infinity if the ray is never within the radius, or not before ``limit``; begin: a lower bound.
    """
    a, b, c = triangle_at(triangles, k)
    time, n = begin, ZERO
    for _ in range(MOST_RAY_STEPS):
        p = plus(ray.origin, scaled(ray.unit, time))
        size = ray.size + time
        gap, n = _point_apart(minus(a, p), minus(b, p), minus(c, p), n, size)
        gap -= ray.radius + 2.0 * (CONVEX_ROUNDING * size + ray.error)
        speed = dot(n, ray.unit)
        if gap > 0.0 and speed <= -SPEED_ROUNDING:
            return np.inf, n
        if gap <= CLOSE * size:
            break
        time += gap / max(speed + SPEED_ROUNDING, SPEED_ROUNDING)
        if time > limit:
            return np.inf, n
    return time, n


@njit(refcount=False)
def _point_apart(
    a: Vector, b: Vector, c: Vector, start: Vector, size: float
) -> tuple[float, Vector]:
    """Return a lower bound of the distance of a triangle from the origin, and its unit direction.

    start: the direction to try first, unless zero.
    """
    unit, back = unit_scale(size)
    corners = scaled(a, unit), scaled(b, unit), scaled(c, unit)
    origin = ZERO, ZERO, ZERO
    n = start if max_abs(start) > 0.0 else corners[0]
    lower, upper, n = triangle_bounds(corners, origin, n, np.inf)
    if upper - lower > LOOSE_BOUNDS:
        gap, direction = careful_triangle_gap(corners, origin)
        if gap > lower:
            lower, n = gap, direction
    return lower * back, n


@njit(merge=True)
def hit_convex(ray: Ray, bodies: Cores, i: int, best: float) -> Hit:
    """Return when a ray first hits body i, at most at ``best``; zero for an origin inside."""
    core, place = borrowed_core(bodies, i), body_place(bodies, i)
    d, ahead, error = moved_ahead(ray, place.center, 2.0 * core.reach)
    if ahead < 0.0:
        return MISSED
    if ahead == 0.0 and convex_holds(bodies, i, ray.origin, 0.0):
        return 0.0, NO_FACE, ZERO
    o, w = components(place.axes, d), components(place.axes, ray.unit)
    limit = min(min(best, ray.reach) - ahead, 8.0 * core.reach)  # by then it is beyond the body
    point = point_core(core)
    time, n = 0.0, ZERO
    for _ in range(MOST_RAY_STEPS):
        pose = point_pose(plus(o, scaled(w, time)), sum_abs(d) + time, core.reach)
        apart = search(core, point, pose, n, np.inf)
        n = apart.normal
        slack = 2.0 * rounding(pose) + 3.0 * error
        gap, speed = apart.gap - core.radius - slack, -dot(n, w)
        if gap > 0.0 and speed <= -SPEED_ROUNDING:
            return MISSED
        if gap <= CLOSE * pose.size:
            break
        time += gap / max(speed + SPEED_ROUNDING, SPEED_ROUNDING)
        if time > limit:
            return MISSED
    return ahead + time, NO_FACE, combined(place.axes, n)
