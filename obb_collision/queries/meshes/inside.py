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

"""Points inside of a watertight mesh: crossings of a ray are counted, certified.

A point off the surface is inside if a ray from it leaves the surface another number of times than
it enters it: the surface winds about the point. That holds for solids that overlap, too, and for
cavities whose faces point inwards. Where faces point this way and that, so that in and out mean
nothing, it is inside if the ray crosses the surface an odd number of times.

A crossing counts only if three orientations and the side of the point are certain; if a ray
passes too near to an edge, or the point is too near to the surface, the next direction is tried.
The last ones lead out of the box of the mesh: beside a thin mesh some of these lead away from it.
Triangles are found through the tree: every node that the ray may hit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.exact import Exact, exact_cross, exact_dot
from obb_collision.numerics.vec3 import dot, max_abs, minus, scaled, sum_abs
from obb_collision.queries.meshes.trees import LARGEST_LIMIT, NodeStack, descend_nearest
from obb_collision.queries.meshes.triangles import corner, sign
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.typing import Floats, Vector

OUTSIDE_MESH, INSIDE_MESH, UNKNOWN_SIDE = 0, 1, -1
#: Instead of the sign of a crossing: undecided, as the ray passes too near to an edge.
GRAZES = 2

#: Directions in no special position, tried in order until a ray grazes nothing.
RAY_DIRECTIONS = np.array(
    [
        [1.41421356, 1.73205081, 2.23606798],
        [-2.64575131, 3.31662479, 0.60555127],
        [0.12310563, -0.35889894, 1.79583152],
        [0.38516481, 0.56776436, -1.08276253],
        [-1.40312424, -0.55743852, 0.85565460],
        [1.28010989, -1.68114575, -0.81024968],
        [-0.18535277, 1.42614977, -1.54400375],
        [-1.88819442, -1.11043358, -1.43398113],
    ]
)
#: Relative slack of the slab test: rounding takes 4 roundoffs, axes orthonormal to 16 take 28.
SLAB_SLACK = 32 * ROUNDOFF
#: Below this speed across a slab the times of entering and leaving are not asked for ...
SLOW_SPEED = 1e-9
#: ... above it they are off by less than 1e-6 of their size (20 roundoffs of the speed).
TIME_SLACK = 1e-5


@njit(refcount=False)
def point_side(trees: TreeArrays, mesh: int, point: Vector, error: float, room: NodeStack) -> int:
    """Return INSIDE_MESH or OUTSIDE_MESH of a closed mesh where certain, else UNKNOWN_SIDE.

    point: in the frame of the mesh, each component off by at most ``error``.
    """
    root = trees.roots[mesh]
    if outside_box(trees.nodes, root, point, error):
        return OUTSIDE_MESH
    unit, _ = unit_scale(trees.radii[mesh] + max_abs(point))
    for k in range(len(RAY_DIRECTIONS) + 6):
        ray = _direction(trees.nodes, root, k)
        crossings = _crossings(trees, root, CrossingRay(point, ray, error, unit), room)
        if crossings.limit > 0.0:
            outside = crossings.leaves == 0 if trees.winding[mesh] else crossings.leaves % 2 == 0
            return OUTSIDE_MESH if outside else INSIDE_MESH
    return UNKNOWN_SIDE


@njit(refcount=False)
def _direction(nodes: Floats, root: int, k: int) -> Vector:
    """Return a direction in no special position; the last ones lead out of the box of the mesh."""
    n = k - len(RAY_DIRECTIONS)
    if n < 0:
        return RAY_DIRECTIONS[k, 0], RAY_DIRECTIONS[k, 1], RAY_DIRECTIONS[k, 2]
    turn = 1.0 if n % 2 == 0 else -1.0
    axis = n // 2
    return (
        turn * nodes[root, 3 + axis],
        turn * nodes[root, 6 + axis],
        turn * nodes[root, 9 + axis],
    )


@njit(refcount=False)
def outside_box(nodes: Floats, n: int, p: Vector, error: float) -> bool:
    """Return whether the point is certainly not in the box of a node."""
    dx, dy, dz = p[0] - nodes[n, 0], p[1] - nodes[n, 1], p[2] - nodes[n, 2]
    slack = 2.0 * error + SLAB_SLACK * (abs(dx) + abs(dy) + abs(dz))
    for k in range(3):
        start = nodes[n, 3 + k] * dx + nodes[n, 6 + k] * dy + nodes[n, 9 + k] * dz
        if abs(start) > nodes[n, 12 + k] + slack:
            return True
    return False


class CrossingRay(NamedTuple):
    """A ray against a surface."""

    point: Vector
    ray: Vector
    error: float  #: by how much a component of the point may be off
    unit: float  #: a power of two that scales the mesh to about 1, so that no product overflows


class CrossingCount(NamedTuple):
    """The crossings of a ray so far."""

    limit: float  #: -inf once it has grazed an edge
    leaves: int  #: how often it leaves the surface, less how often it enters


@njit(refcount=False)
def _crossings(trees: TreeArrays, root: int, ray: CrossingRay, waiting: NodeStack) -> CrossingCount:
    start = CrossingCount(LARGEST_LIMIT, 0)
    return descend_nearest(trees, root, ray, _enters, _with_crossing, start, waiting)[0]


@njit(merge=True)
def _enters(ray: CrossingRay, nodes: Floats, n: int) -> float:
    return entry(nodes, n, ray.point, ray.ray, ray.error)


@njit(merge=True)
def _with_crossing(
    ray: CrossingRay, trees: TreeArrays, n: int, _: float, crossings: CrossingCount
) -> CrossingCount:
    side = 0
    if trees.counted[n]:
        side = _crosses(trees.triangles, n, ray.point, ray.ray, ray.error, ray.unit)
    return CrossingCount(-np.inf if side == GRAZES else crossings.limit, crossings.leaves + side)


@njit(refcount=False)
def entry(nodes: Floats, n: int, p: Vector, w: Vector, error: float) -> float:
    """Return a time before the ray from p along w can enter the box of a node; inf if never."""
    dx, dy, dz = p[0] - nodes[n, 0], p[1] - nodes[n, 1], p[2] - nodes[n, 2]
    size = abs(dx) + abs(dy) + abs(dz) + nodes[n, 12] + nodes[n, 13] + nodes[n, 14]
    slack = 2.0 * error + SLAB_SLACK * size
    enter, leave, slow = 0.0, np.inf, False
    for k in range(3):
        x, y, z = nodes[n, 3 + k], nodes[n, 6 + k], nodes[n, 9 + k]
        start = x * dx + y * dy + z * dz
        speed = x * w[0] + y * w[1] + z * w[2]
        half = nodes[n, 12 + k] + slack
        if abs(speed) < SLOW_SPEED:
            slow = slow or abs(start) > half
            continue
        near, far = (-half - start) / speed, (half - start) / speed
        if near > far:
            near, far = far, near
        enter, leave = max(enter, near), min(leave, far)
    latest = leave + TIME_SLACK * abs(leave)
    if not enter <= latest or (slow and _stays_out(nodes, n, (dx, dy, dz), w, slack, latest)):
        return np.inf
    return enter * (1.0 - TIME_SLACK)


@njit(refcount=False)
def _stays_out(nodes: Floats, n: int, d: Vector, w: Vector, slack: float, latest: float) -> bool:
    """Return whether a ray from d, seen from the centre, is outside of a slab until ``latest``.

    Of slabs that it crosses slowly.
    """
    for k in range(3):
        axis = nodes[n, 3 + k], nodes[n, 6 + k], nodes[n, 9 + k]
        speed = abs(dot(axis, w))
        # the speed is off by less than 32 roundoffs of the ray's direction
        way = (speed + SLAB_SLACK * sum_abs(w)) * latest
        if speed < SLOW_SPEED and abs(dot(axis, d)) - nodes[n, 12 + k] > way + slack:
            return True
    return False


@njit(refcount=False)
def _crosses(triangles: Floats, n: int, p: Vector, w: Vector, error: float, unit: float) -> int:
    """Return 1 or -1 if a ray certainly leaves or enters at a triangle, 0 if it misses it."""
    a = scaled(minus(corner(triangles, n, 0), p), unit)
    b = scaled(minus(corner(triangles, n, 3), p), unit)
    c = scaled(minus(corner(triangles, n, 6), p), unit)
    error *= unit
    off = 2.0 * error  # the ray's direction is exact
    ab, bc, ca = sign(w, a, b, off), sign(w, b, c, off), sign(w, c, a, off)
    if min(ab, bc, ca) < 0 < max(ab, bc, ca):
        return 0
    volume = sign(a, b, c, off)
    if ab == bc == ca != 0 and volume != 0:
        return ab if volume == ab else 0
    # All three corners behind the start: no crossing, however near to an edge.
    reach = max(max_abs(a), max_abs(b), max_abs(c)) * 3.0 * max_abs(w)
    ahead = max(dot(w, a), dot(w, b), dot(w, c))
    if ahead < -(SLAB_SLACK * reach + 16.0 * error):
        return 0
    return GRAZES


def inside_exactly(corners: list[Exact], winding: bool) -> bool:
    """Return whether a point is inside a closed mesh, or on its surface, in exact integers.

    corners: the point, then three corners of each counted triangle; winding: see ``MeshTrees``.
    Takes tens of microseconds per triangle. Raises RuntimeError if all rays graze an edge, which
    only a contrived mesh does.
    """
    point, rest = corners[0], corners[1:]
    moved = [(v[0] - point[0], v[1] - point[1], v[2] - point[2]) for v in rest]
    for direction in np.rint(RAY_DIRECTIONS * 1e8).astype(int).tolist():
        ray = (direction[0], direction[1], direction[2])
        hits = [_exact_crossing(ray, *moved[k : k + 3]) for k in range(0, len(moved), 3)]
        if GRAZES not in hits:
            count = sum(hits)
            return count != 0 if winding else count % 2 == 1
    raise RuntimeError("every ray from the point grazes an edge of the mesh")


def _exact_crossing(w: Exact, a: Exact, b: Exact, c: Exact) -> int:
    """Return 1 for leaving, -1 for entering, 0 for no crossing, GRAZES where it touches an edge."""
    sides = [
        exact_dot(w, exact_cross(a, b)),
        exact_dot(w, exact_cross(b, c)),
        exact_dot(w, exact_cross(c, a)),
    ]
    if min(sides) < 0 < max(sides):
        return 0
    if 0 in sides:
        return GRAZES if max(exact_dot(w, a), exact_dot(w, b), exact_dot(w, c)) >= 0 else 0
    side = 1 if sides[0] > 0 else -1
    return side if exact_dot(a, exact_cross(b, c)) * side > 0 else 0
