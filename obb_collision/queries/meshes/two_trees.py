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

"""Two trees at once: triangles of two placed meshes that collide, and their distance.

Triangles in contact, or boxes of a depth:
Of a pair of nodes that may collide the larger is replaced by its children, and the pair that
overlaps more comes first, so that a collision is found soon (Gottschalk, Lin, Manocha
1996, section 5). A pair is dropped only if the boxes are certainly apart.

The distance: branch and bound.
A pair of nodes whose boxes are at least as far apart as the two closest triangles so far is
dropped; of the others the larger node is replaced by its children, and the nearer pair comes first
(Larsen, Gottschalk, Lin, Manocha 1999). Two boxes are at least as far apart as the gaps along the
three axes of either say, which are orthogonal: the root of the sum of their squares.

The lower bound is the least of all that was dropped or computed. Pairs that cannot shorten the
distance by more than SLACK are dropped as well: meshes face to face have many that are equally
near.

All is in the frame of the first mesh, scaled by a power of two that brings S of ``placed`` to
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
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import components, dot, max_abs, minus, scaled
from obb_collision.queries.meshes.one_tree import Waiting, no_waiting
from obb_collision.queries.meshes.placed import (
    BOX_BOUND,
    MeshPair,
    NodeBox,
    Place,
    Pose,
    back_of,
    box_gap,
    faces_gap,
    moved,
    moved_node,
    node_at,
)
from obb_collision.queries.meshes.triangle_distance import (
    careful_gap,
    closest_points,
    triangle_bounds,
)
from obb_collision.queries.meshes.triangles import (
    SEPARATE,
    TOUCHING,
    UNDECIDED,
    Triangle,
    classify_by_axes,
    classify_by_signs,
    triangle_at,
)
from obb_collision.queries.verdict.sat import face_gap, rows_of
from obb_collision.typing import Floats, Vector

#: Two numbers, such as a node of either tree.
Nodes = tuple[int, int]


class Contacting(NamedTuple):
    """When a search for triangles in contact ends, and where it writes."""

    stop: int  #: at the first verdict of at least this,
    effort: int  #: or so many pairs of nodes after the first TOUCHING
    contacts: np.ndarray  #: (c, 4) pair, triangle of a, triangle of b, verdict
    waiting: Waiting  #: work space


@njit(refcount=False)
def descend(bodies: MeshPair, search: Contacting, pair: int, found: int) -> tuple[int, int]:
    """Return the highest verdict of two triangles, and the number of contacts so far.

    Every pair of triangles that is not SEPARATE is written as a contact, as far as there is room;
    found: how many there were before.
    """
    trees_a, a, trees_b, b, pose = bodies
    nodes_a, children_a, starts_a = trees_a.nodes, trees_a.children, trees_a.starts
    nodes_b, children_b, starts_b = trees_b.nodes, trees_b.children, trees_b.starts
    triangles_a, triangles_b = trees_a.triangles, trees_b.triangles
    contacts, stack, effort = search.contacts, search.waiting.nodes, search.effort
    verdict, back = SEPARATE, back_of(pose)
    stack[0, 0], stack[0, 1] = trees_a.roots[a.mesh], trees_b.roots[b.mesh]
    waiting = 1
    while waiting > 0:
        waiting -= 1
        if verdict == TOUCHING:
            effort -= 1
            if effort < 0:
                break
        i, j = stack[waiting, 0], stack[waiting, 1]
        child_a, child_b = children_a[i], children_b[j]
        if child_a < 0 and child_b < 0:
            for s in range(starts_a[i, 0], starts_a[i, 1]):
                for t in range(starts_b[j, 0], starts_b[j, 1]):
                    p, q = triangle_at(triangles_a, s), triangle_at(triangles_b, t)
                    met = _triangles_verdict(p, a.place, q, b.place, pose)
                    if met == SEPARATE:
                        continue
                    if found < len(contacts):
                        contacts[found, 0], contacts[found, 1] = pair, s
                        contacts[found, 2], contacts[found, 3] = t, met
                    found += 1
                    verdict = max(verdict, met)
                    if verdict >= search.stop:
                        return verdict, found
            continue
        if child_b < 0 or (child_a >= 0 and nodes_a[i, SIZE] >= nodes_b[j, SIZE]):
            other = moved_node(pose, nodes_b, j)
            first = faces_gap(nodes_a, child_a, other, pose.gap_bound)
            second = faces_gap(nodes_a, child_a + 1, other, pose.gap_bound)
            waiting = _push((child_a, j), (child_a + 1, j), (first, second), stack, waiting)
        else:
            other = moved_node(back, nodes_a, i)
            first = faces_gap(nodes_b, child_b, other, pose.gap_bound)
            second = faces_gap(nodes_b, child_b + 1, other, pose.gap_bound)
            waiting = _push((i, child_b), (i, child_b + 1), (first, second), stack, waiting)
    return verdict, found


@njit
def _triangles_verdict(p: Triangle, a: Place, q: Triangle, b: Place, pose: Pose) -> int:
    """Return the verdict of two triangles of bodies at places a and b."""
    placed = moved(pose, q[0]), moved(pose, q[1]), moved(pose, q[2])
    verdict = classify_by_signs(p, placed, pose.point_bound)
    return classify_by_axes(p, a, q, b) if verdict == UNDECIDED else verdict


@njit(refcount=False)
def _push(
    one: Nodes, other: Nodes, gaps: tuple[float, float], stack: np.ndarray, waiting: int
) -> int:
    """Put two pairs of nodes that may collide on the stack; return its size.

    Gaps are infinite where they are apart. What overlaps more comes last and is next.
    """
    first, second = gaps
    if first < second:
        one, other, first, second = other, one, second, first
    if first < np.inf:
        stack[waiting, 0], stack[waiting, 1] = one
        waiting += 1
    if second < np.inf:
        stack[waiting, 0], stack[waiting, 1] = other
        waiting += 1
    return waiting


@njit(refcount=False)
def boxes_may_collide(bodies: MeshPair, depth: int, room: Waiting) -> bool:
    """Return whether boxes of a depth are not certainly apart, nor those above them.

    A greater depth never reports what a lesser one doesn't.
    """
    trees_a, a, trees_b, b, pose = bodies
    nodes_a, children_a, levels_a = trees_a.nodes, trees_a.children, trees_a.levels
    nodes_b, children_b, levels_b = trees_b.nodes, trees_b.children, trees_b.levels
    stack = room.nodes
    stack[0, 0], stack[0, 1] = trees_a.roots[a.mesh], trees_b.roots[b.mesh]
    waiting = 1
    while waiting > 0:
        waiting -= 1
        i, j = stack[waiting, 0], stack[waiting, 1]
        child_a = children_a[i] if levels_a[i] < depth else -1
        child_b = children_b[j] if levels_b[j] < depth else -1
        if child_a < 0 and child_b < 0:
            return True
        # By levels, not by size: every depth then looks at all pairs of the lesser ones.
        split_a = child_b < 0 or (child_a >= 0 and levels_a[i] <= levels_b[j])
        i1, j1 = (child_a, j) if split_a else (i, child_b)
        i2, j2 = (child_a + 1, j) if split_a else (i, child_b + 1)
        first = box_gap(nodes_a, i1, nodes_b, j1, pose)
        second = box_gap(nodes_a, i2, nodes_b, j2, pose)
        waiting = _push((i1, j1), (i2, j2), (first, second), stack, waiting)
    return False


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

    waiting: Waiting  #: of pairs of nodes
    contacts: np.ndarray  #: (c, 4) as in ``Contacting``


@njit
def tree_room(contacts: int) -> TreeRoom:
    """Return work space with room for contacts."""
    return TreeRoom(no_waiting(), np.empty((contacts, 4), np.int64))


class NearestTriangles(NamedTuple):
    """The closest triangles, s of a and t of b (-1: none within the limit), scaled as above."""

    s: int
    t: int
    lower: float  #: no triangles are closer than this,
    upper: float  #: and these are no farther apart
    direction: Vector  #: the unit vector from b to a along which they are apart


@njit(refcount=False)
def nearest_triangles(
    bodies: MeshPair, unit: float, limit: float, room: TreeRoom
) -> NearestTriangles:
    """Return the closest triangles of two bodies; unit: the scale, of the limit as well."""
    trees_a, a, trees_b, b, pose = bodies
    nodes_a, children_a, starts_a = trees_a.nodes, trees_a.children, trees_a.starts
    nodes_b, children_b, starts_b = trees_b.nodes, trees_b.children, trees_b.starts
    triangles_a, triangles_b = trees_a.triangles, trees_b.triangles
    (stack, bounds), back = room.waiting, back_of(pose)
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
    return NearestTriangles(s, t, min(lower, upper), upper, direction)


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


@njit(refcount=False)
def triangles_of(bodies: MeshPair, s: int, t: int, unit: float) -> tuple[Triangle, Triangle]:
    """Return triangles s and t in the frame of a, scaled."""
    p = _scaled(triangle_at(bodies.trees_a.triangles, s), unit)
    return p, _moved(triangle_at(bodies.trees_b.triangles, t), bodies.pose, unit)


@njit(refcount=False)
def points_of(bodies: MeshPair, s: int, t: int, unit: float) -> tuple[float, Vector, Vector]:
    """Return the distance of triangles s and t and their closest points, scaled."""
    p, q = triangles_of(bodies, s, t, unit)
    square, x, y = closest_points(p, q)
    return math.sqrt(square), x, y
