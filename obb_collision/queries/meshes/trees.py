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

"""Descents of mesh trees: of one tree, nearest first, and of two trees at once.

One tree, branch and bound: of the boxes that wait, those too far are passed over, the nearest other
is replaced by its children or, if it has none, by its triangles. A question is three functions and
their arguments: how far a box is, what a triangle adds to the answer, and the limit beyond which
boxes no longer count. All are compiled into the kernel that asks.

Two trees, triangles in contact: of a pair of nodes that may collide the larger is replaced by its
children, and the pair that overlaps more comes first, so that a collision shows soon (Gottschalk,
Lin, Manocha 1996, section 5). A pair is dropped only if the boxes are certainly apart.

Two trees, the distance: a pair of nodes whose boxes are at least as far apart as the two closest
triangles so far is dropped; of the others the larger node is replaced by its children, and the
nearer pair comes first (Larsen, Gottschalk, Lin, Manocha 1999). Two boxes are at least as far apart
as the gaps along the three axes of either say, which are orthogonal: the root of the sum of their
squares. The lower bound is the least of all that was dropped or computed. Pairs that cannot shorten
the distance by more than SAME_DISTANCE are dropped as well: meshes face to face have many that are
equally near.

All is in the frame of the first mesh, scaled by a power of two that brings S of ``placed`` to
0.5 .. 1. Error analysis: a component of a corner is off by 256 u S, that is 444 u S for a point;
axes of bodies that are orthonormal to 64 u change lengths by at most 96 u; projections take 8 u.
``DISTANCE_BOUND`` is 1024 u. A bound of two boxes is off by sqrt(3) times ``BOX_BOUND`` for the
gaps, and by 240 u S for the axes: below twice ``BOX_BOUND``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.build import SIZE
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import dot, max_abs, max_of, scaled
from obb_collision.queries.meshes.placed import (
    BOX_BOUND,
    MeshPair,
    NodeBox,
    PairPose,
    Place,
    back_of,
    faces_gap,
    moved,
    moved_node,
    node_face_gaps,
)
from obb_collision.queries.meshes.triangle_distance import (
    careful_triangle_gap,
    closest_points,
    triangle_bounds,
)
from obb_collision.queries.meshes.triangles import (
    Triangle,
    classify_by_axes,
    classify_by_signs,
    triangle_at,
)
from obb_collision.queries.verdict.verdict import SEPARATE, TOUCHING, UNDECIDED
from obb_collision.typing import Floats, Vector

#: Rows of the stack: one for each level of a tree, at most 75, or of both trees
#: (``trees.build.MIN_SHARE``).
STACK_ROWS = 256
#: A limit below which all boxes are but those that are infinitely far.
LARGEST_LIMIT = float(np.finfo(np.float64).max)


class NodeStack(NamedTuple):
    """Work space: nodes to visit, the next one last."""

    nodes: np.ndarray  #: (STACK_ROWS, 2): nodes of one tree in the first column, or of two trees
    bounds: Floats  #: (STACK_ROWS,) how far they are at least


@njit
def node_stack() -> NodeStack:
    """Return work space for one descent after another."""
    return NodeStack(np.empty((STACK_ROWS, 2), np.int64), np.empty(STACK_ROWS))


class Limited(Protocol):
    """The answer so far."""

    @property
    def limit(self) -> float:
        """Boxes farther than this are passed over; all where it is -inf."""


Q = TypeVar("Q")
A = TypeVar("A", bound=Limited)


@njit(merge=True)
def descend_nearest(
    trees: TreeArrays,
    root: int,
    question: Q,
    box_bound: Callable[[Q, Floats, int], float],
    with_triangle: Callable[[Q, TreeArrays, int, float, A], A],
    answer: A,
    waiting: NodeStack,
) -> tuple[A, float]:
    """Return the answer after all triangles that count, and the least bound passed over.

    box_bound: a lower bound of the distance of the contents of a node, infinite if they cannot
    count; then the limit must be finite.

    with_triangle: returns the answer after a triangle, whose box has the bound passed to it.
    """
    nodes, children, starts = trees.nodes, trees.children, trees.starts
    stack, bounds = waiting
    node, least, count, passed = root, box_bound(question, nodes, root), 0, np.inf
    while True:
        near = children[node]
        if least > answer.limit:
            passed = min(passed, least)
        elif near < 0:
            for k in range(starts[node, 0], starts[node, 1]):
                answer = with_triangle(question, trees, k, least, answer)
        else:
            far = near + 1
            first, second = box_bound(question, nodes, near), box_bound(question, nodes, far)
            if not first < second:
                near, far, first, second = far, near, second, first
            stack[count, 0], bounds[count] = far, second
            node, least, count = near, first, count + 1
            continue
        if count == 0:
            return answer, passed
        count -= 1
        node, least = stack[count, 0], bounds[count]


#: A node of each tree, or two other numbers.
NodePair = tuple[int, int]


class ContactSearch(NamedTuple):
    """When a search for triangles in contact ends, and where it writes."""

    stop: int  #: at the first verdict of at least this,
    effort: int  #: or so many pairs of nodes after the first TOUCHING
    contacts: np.ndarray  #: (c, 4) pair, triangle of a, triangle of b, verdict
    waiting: NodeStack  #: work space


@njit(refcount=False)
def find_contacts(
    bodies: MeshPair, search: ContactSearch, pair: int, count: int
) -> tuple[int, int]:
    """Return the highest verdict of two triangles, and the number of contacts so far.

    Every pair of triangles that is not SEPARATE is written as a contact, as far as there is room;
    count: the number before.
    """
    trees_a, a, trees_b, b, pose = bodies
    starts_a, starts_b = trees_a.starts, trees_b.starts
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
        if trees_a.children[i] < 0 and trees_b.children[j] < 0:
            for s in range(starts_a[i, 0], starts_a[i, 1]):
                for t in range(starts_b[j, 0], starts_b[j, 1]):
                    p, q = triangle_at(triangles_a, s), triangle_at(triangles_b, t)
                    met = _triangles_verdict(p, a.place, q, b.place, pose)
                    if met == SEPARATE:
                        continue
                    if count < len(contacts):
                        contacts[count, 0], contacts[count, 1] = pair, s
                        contacts[count, 2], contacts[count, 3] = t, met
                    count += 1
                    verdict = max(verdict, met)
                    if verdict >= search.stop:
                        return verdict, count
            continue
        nearer, other, gaps = _split(bodies, back, i, j, faces_gap, pose.gap_bound)
        waiting = _push(nearer, other, gaps, stack, waiting)
    return verdict, count


@njit(merge=True)
def _split(
    bodies: MeshPair,
    back: PairPose,
    i: int,
    j: int,
    gap: Callable[[Floats, int, NodeBox, float], float],
    bound: float,
) -> tuple[NodePair, NodePair, tuple[float, float]]:
    """Return the pairs of nodes that replace i and j, the larger of which is split, and their gaps.

    back: body a in the frame of b; bound: the last argument of ``gap``.
    """
    nodes_a, nodes_b = bodies.trees_a.nodes, bodies.trees_b.nodes
    child_a, child_b = bodies.trees_a.children[i], bodies.trees_b.children[j]
    if child_b < 0 or (child_a >= 0 and nodes_a[i, SIZE] >= nodes_b[j, SIZE]):
        box = moved_node(bodies.pose, nodes_b, j)
        gaps = gap(nodes_a, child_a, box, bound), gap(nodes_a, child_a + 1, box, bound)
        return (child_a, j), (child_a + 1, j), gaps
    box = moved_node(back, nodes_a, i)
    gaps = gap(nodes_b, child_b, box, bound), gap(nodes_b, child_b + 1, box, bound)
    return (i, child_b), (i, child_b + 1), gaps


@njit
def _triangles_verdict(p: Triangle, a: Place, q: Triangle, b: Place, pose: PairPose) -> int:
    """Return the verdict of triangle p of a body at a and q of a body at b."""
    placed = moved(pose, q[0]), moved(pose, q[1]), moved(pose, q[2])
    verdict = classify_by_signs(p, placed, pose.point_bound)
    return classify_by_axes(p, a, q, b) if verdict == UNDECIDED else verdict


@njit(refcount=False)
def _push(
    pair: NodePair, other: NodePair, gaps: tuple[float, float], stack: np.ndarray, waiting: int
) -> int:
    """Put two pairs of nodes that may collide on the stack; return its size.

    Gaps are infinite for nodes that are apart. The pair that overlaps more is next.
    """
    first, second = gaps
    if first < second:
        pair, other, first, second = other, pair, second, first
    if first < np.inf:
        stack[waiting, 0], stack[waiting, 1] = pair
        waiting += 1
    if second < np.inf:
        stack[waiting, 0], stack[waiting, 1] = other
        waiting += 1
    return waiting


#: By how much a distance may be off, relative to S (derivation above).
DISTANCE_BOUND = 1024 * ROUNDOFF
#: By how much a bound of two boxes may be off, relative to S (derivation above).
NODE_BOUND = 2.0 * BOX_BOUND
#: Nodes that cannot shorten the distance by more than this, relative to S, are dropped: 1e-11.
SAME_DISTANCE = 2.0**-36
#: Bounds of two triangles that differ by more than this, relative to S, are computed carefully.
LOOSE_BOUNDS = 2.0**-40


class TreeRoom(NamedTuple):
    """Work space."""

    waiting: NodeStack  #: of pairs of nodes
    contacts: np.ndarray  #: (c, 4) as in ``ContactSearch``


@njit
def tree_room(contacts: int) -> TreeRoom:
    """Return work space with room for contacts."""
    return TreeRoom(node_stack(), np.empty((contacts, 4), np.int64))


class NearestTriangles(NamedTuple):
    """The closest triangles, s of a and t of b (-1: none within the limit), scaled."""

    s: int
    t: int
    lower: float  #: no triangles are closer than this,
    upper: float  #: and these are no farther apart
    direction: Vector  #: the unit vector from b to a along which they are apart


@njit(refcount=False)
def nearest_triangles(
    bodies: MeshPair, unit: float, limit: float, room: TreeRoom
) -> NearestTriangles:
    """Return the closest triangles of two bodies; unit: the scale, also of the limit."""
    trees_a, a, trees_b, b, pose = bodies
    starts_a, starts_b = trees_a.starts, trees_b.starts
    triangles_a, triangles_b = trees_a.triangles, trees_b.triangles
    (stack, bounds), back = room.waiting, back_of(pose)
    lower, upper, s, t = limit, limit, -1, -1
    direction = scaled(pose.offset, -unit)
    if not max_abs(direction) > 0.0:
        direction = 1.0, 0.0, 0.0
    stack[0, 0], stack[0, 1] = trees_a.roots[a.mesh], trees_b.roots[b.mesh]
    root_box = moved_node(pose, trees_b.nodes, stack[0, 1])
    bounds[0] = boxes_apart(trees_a.nodes, stack[0, 0], root_box, unit)
    waiting = 1
    while waiting > 0:
        waiting -= 1
        if bounds[waiting] >= upper - SAME_DISTANCE:
            lower = min(lower, bounds[waiting] - NODE_BOUND)
            continue
        i, j, least = stack[waiting, 0], stack[waiting, 1], bounds[waiting]
        if trees_a.children[i] < 0 and trees_b.children[j] < 0:
            for k in range(starts_a[i, 0], starts_a[i, 1]):
                p = _scaled(triangle_at(triangles_a, k), unit)
                for m in range(starts_b[j, 0], starts_b[j, 1]):
                    q = _moved(triangle_at(triangles_b, m), pose, unit)
                    low, high, n = _triangles_apart(p, q, direction, upper - SAME_DISTANCE)
                    lower = min(lower, low)
                    if high < upper:
                        upper, s, t, direction = high, k, m, n
            continue
        far, near, (first, second) = _split(bodies, back, i, j, boxes_apart, unit)
        if first < second:
            far, near, first, second = near, far, second, first
        stack[waiting, 0], stack[waiting, 1] = far
        stack[waiting + 1, 0], stack[waiting + 1, 1] = near
        bounds[waiting], bounds[waiting + 1] = max(first, least), max(second, least)
        waiting += 2
    return NearestTriangles(s, t, min(lower, upper), upper, direction)


@njit
def boxes_apart(nodes: Floats, i: int, other: NodeBox, unit: float) -> float:
    """Return a lower bound of the distance of a node and a moved one, up to rounding.

    If not positive, the largest gap along a face: more negative where they overlap more.
    """
    of_node, of_other = node_face_gaps(nodes, i, other)
    g, k = scaled(of_node, unit), scaled(of_other, unit)
    largest = max(max_of(g), max_of(k))
    if not largest > 0.0:
        return largest
    return math.sqrt(max(_square_of_positive(g), _square_of_positive(k)))


@njit
def _square_of_positive(v: Vector) -> float:
    positive = max(v[0], 0.0), max(v[1], 0.0), max(v[2], 0.0)
    return dot(positive, positive)


@njit
def _scaled(t: Triangle, unit: float) -> Triangle:
    return scaled(t[0], unit), scaled(t[1], unit), scaled(t[2], unit)


@njit
def _moved(t: Triangle, pose: PairPose, unit: float) -> Triangle:
    return _scaled((moved(pose, t[0]), moved(pose, t[1]), moved(pose, t[2])), unit)


@njit
def _triangles_apart(
    p: Triangle, q: Triangle, n: Vector, enough: float
) -> tuple[float, float, Vector]:
    """Return ``triangle_bounds``, with all features if the bounds are loose."""
    lower, upper, n = triangle_bounds(p, q, n, enough)
    if lower < enough and upper - lower > LOOSE_BOUNDS:
        gap, direction = careful_triangle_gap(p, q)
        if gap > lower:
            lower, n = gap, direction
        upper = min(upper, math.sqrt(closest_points(p, q)[0]))
    return lower, upper, n


@njit(refcount=False)
def scaled_triangles(bodies: MeshPair, s: int, t: int, unit: float) -> tuple[Triangle, Triangle]:
    """Return triangles s and t in the frame of a, scaled."""
    p = _scaled(triangle_at(bodies.trees_a.triangles, s), unit)
    return p, _moved(triangle_at(bodies.trees_b.triangles, t), bodies.pose, unit)


@njit(refcount=False)
def points_of(bodies: MeshPair, s: int, t: int, unit: float) -> tuple[float, Vector, Vector]:
    """Return the distance of triangles s and t and their closest points, scaled."""
    p, q = scaled_triangles(bodies, s, t, unit)
    square, x, y = closest_points(p, q)
    return math.sqrt(square), x, y
