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

"""The distance of two placed meshes: branch and bound over their trees.

A pair of nodes whose boxes are at least as far apart as the two closest triangles so far is
dropped; of the others the larger node is replaced by its children, and the nearer pair comes first
(Larsen, Gottschalk, Lin, Manocha 1999). Two boxes are at least as far apart as the gaps along the
three axes of either say, which are orthogonal: the root of the sum of their squares.

The lower bound is the least of all that was dropped or computed. Pairs that cannot shorten the
distance by more than SLACK are dropped as well: meshes face to face have many that are equally
near.

All is in the frame of the first mesh, scaled by a power of two that brings S of ``tree_boxes`` to
0.5 .. 1. Error analysis: a component of a corner is off by 256 u S, that is 444 u S for a point;
axes of bodies that are orthonormal to 64 u change lengths by at most 96 u; projections take 8 u.
``DISTANCE_BOUND`` is 1024 u. A bound of two boxes is off by sqrt(3) times ``BOX_BOUND`` for the
gaps, and by 240 u S for the axes: below twice ``BOX_BOUND``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.build import SIZE
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import components, dot, max_abs, minus, scaled
from obb_collision.queries.meshes.placed import MeshAt
from obb_collision.queries.meshes.tree_boxes import (
    BOX_BOUND,
    NodeBox,
    Pose,
    back_of,
    moved,
    moved_node,
    node_at,
)
from obb_collision.queries.meshes.triangle_distance import (
    careful_gap,
    closest_points,
    triangle_bounds,
)
from obb_collision.queries.meshes.triangles import Triangle, triangle_at
from obb_collision.queries.verdict.sat import face_gap, rows_of
from obb_collision.typing import Floats, Vector

#: By how much a distance may be off, relative to S (derivation above).
DISTANCE_BOUND = 1024 * ROUNDOFF
#: By how much a bound of two boxes may be off, relative to S (derivation above).
NODE_BOUND = 2.0 * BOX_BOUND
#: What cannot shorten the distance by more than this, relative to S, is not looked at: 1e-11.
SLACK = 2.0**-36
#: Bounds of two triangles that differ by more than this, relative to S, are computed carefully.
APART = 2.0**-40


class TreeRoom(NamedTuple):
    """Work space."""

    stack: np.ndarray  #: (STACK, 2) pairs of nodes
    bounds: Floats  #: (STACK,) how far apart they are at least
    contacts: np.ndarray  #: (1, 4) as ``tree_descent.Search``


class Nearest(NamedTuple):
    """The closest triangles, s of a and t of b (-1: none within the limit), scaled as above."""

    s: int
    t: int
    lower: float  #: no triangles are closer than this,
    upper: float  #: and these are no farther apart
    direction: Vector  #: the unit vector from b to a along which they are apart


@njit
def nearest_triangles(
    trees_a: TreeArrays, a: MeshAt, trees_b: TreeArrays, b: MeshAt,
    pose: Pose, unit: float, limit: float, room: TreeRoom,
) -> Nearest:  # fmt: skip
    """Return the closest triangles of two bodies; unit: the scale, of the limit as well."""
    nodes_a, children_a, starts_a = trees_a.nodes, trees_a.children, trees_a.starts
    nodes_b, children_b, starts_b = trees_b.nodes, trees_b.children, trees_b.starts
    triangles_a, triangles_b = trees_a.triangles, trees_b.triangles
    stack, bounds, back = room.stack, room.bounds, back_of(pose)
    lower, upper, s, t = limit, limit, -1, -1
    direction = scaled(pose.offset, -unit)
    if not max_abs(direction) > 0.0:
        direction = 1.0, 0.0, 0.0
    root_a, root_b = trees_a.roots[a.mesh], trees_b.roots[b.mesh]
    stack[0, 0], stack[0, 1] = root_a, root_b
    bounds[0] = boxes_apart(nodes_a, root_a, moved_node(pose, nodes_b, root_b), unit)
    waiting = 1
    while waiting > 0:
        waiting -= 1
        if bounds[waiting] >= upper - SLACK:
            lower = min(lower, bounds[waiting] - NODE_BOUND)
            continue
        i, j, least = stack[waiting, 0], stack[waiting, 1], bounds[waiting]
        child_a, child_b = children_a[i], children_b[j]
        if child_a < 0 and child_b < 0:
            for k in range(starts_a[i, 0], starts_a[i, 1]):
                p = _scaled(triangle_at(triangles_a, k), unit)
                for m in range(starts_b[j, 0], starts_b[j, 1]):
                    q = _moved(triangle_at(triangles_b, m), pose, unit)
                    near, far, n = _triangles_apart(p, q, direction, upper - SLACK)
                    lower = min(lower, near)
                    if far < upper:
                        upper, s, t, direction = far, k, m, n
            continue
        if child_b < 0 or (child_a >= 0 and nodes_a[i, SIZE] >= nodes_b[j, SIZE]):
            other = moved_node(pose, nodes_b, j)
            first = boxes_apart(nodes_a, child_a, other, unit)
            second = boxes_apart(nodes_a, child_a + 1, other, unit)
            one, two = (child_a, j), (child_a + 1, j)
        else:
            other = moved_node(back, nodes_a, i)
            first = boxes_apart(nodes_b, child_b, other, unit)
            second = boxes_apart(nodes_b, child_b + 1, other, unit)
            one, two = (i, child_b), (i, child_b + 1)
        if first < second:
            one, two, first, second = two, one, second, first
        stack[waiting, 0], stack[waiting, 1] = one
        stack[waiting + 1, 0], stack[waiting + 1, 1] = two
        bounds[waiting], bounds[waiting + 1] = max(first, least), max(second, least)
        waiting += 2
    return Nearest(s, t, min(lower, upper), upper, direction)


@njit
def boxes_apart(nodes: Floats, i: int, other: NodeBox, unit: float) -> float:
    """Return how far apart a node and a moved one are at least, but for rounding.

    Where it is not positive, the largest gap along a face: more negative where they overlap more.
    """
    center, (a0, a1, a2), h = node_at(nodes, i)
    b, f = other.axes, other.half
    d = minus(other.center, center)
    u, v, w = components(b, a0), components(b, a1), components(b, a2)
    x, y, z = rows_of((u, v, w))
    e = components(b, d)
    g0 = unit * face_gap(dot(a0, d), h[0], f, u)
    g1 = unit * face_gap(dot(a1, d), h[1], f, v)
    g2 = unit * face_gap(dot(a2, d), h[2], f, w)
    k0 = unit * face_gap(e[0], f[0], h, x)
    k1 = unit * face_gap(e[1], f[1], h, y)
    k2 = unit * face_gap(e[2], f[2], h, z)
    largest = max(g0, g1, g2, k0, k1, k2)
    if not largest > 0.0:
        return largest
    square = max(_square(g0) + _square(g1) + _square(g2), _square(k0) + _square(k1) + _square(k2))
    return math.sqrt(square)


@njit
def _square(gap: float) -> float:
    return gap * gap if gap > 0.0 else 0.0


@njit
def _scaled(t: Triangle, unit: float) -> Triangle:
    return scaled(t[0], unit), scaled(t[1], unit), scaled(t[2], unit)


@njit
def _moved(t: Triangle, pose: Pose, unit: float) -> Triangle:
    return _scaled((moved(pose, t[0]), moved(pose, t[1]), moved(pose, t[2])), unit)


@njit
def _triangles_apart(
    p: Triangle, q: Triangle, n: Vector, enough: float
) -> tuple[float, float, Vector]:
    """Return ``triangle_bounds``; where they are not tight enough, by all features."""
    lower, upper, n = triangle_bounds(p, q, n, enough)
    if lower < enough and upper - lower > APART:
        gap, direction = careful_gap(p, q)
        if gap > lower:
            lower, n = gap, direction
        upper = min(upper, math.sqrt(closest_points(p, q)[0]))
    return lower, upper, n


@njit
def points_of(
    trees_a: TreeArrays, s: int, trees_b: TreeArrays, t: int, pose: Pose, unit: float
) -> tuple[float, Vector, Vector]:
    """Return the distance of triangles s and t and their closest points, scaled."""
    p = _scaled(triangle_at(trees_a.triangles, s), unit)
    q = _moved(triangle_at(trees_b.triangles, t), pose, unit)
    square, x, y = closest_points(p, q)
    return math.sqrt(square), x, y
