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

"""Two trees at once: which triangles, or boxes of a depth, of two placed meshes collide.

Of a pair of nodes that may collide the larger is replaced by its children, and the pair that
overlaps more comes first, so that a collision is found soon (Gottschalk, Lin, Manocha
1996, section 5). A pair is dropped only if the boxes are certainly apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.build import SIZE
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.queries.meshes.placed import MeshAt
from obb_collision.queries.meshes.tree_boxes import (
    Place,
    Pose,
    back_of,
    box_gap,
    faces_gap,
    moved,
    moved_node,
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

#: Rows of the stack: one is left behind at each level of either tree, at most 2 x 75 of them
#: (``trees.build.LEAST_SHARE``).
STACK = 256


class Contacting(NamedTuple):
    """When a search for triangles in contact ends, and where it writes."""

    stop: int  #: at the first verdict of at least this,
    effort: int  #: or so many pairs of nodes after the first TOUCHING
    contacts: np.ndarray  #: (c, 4) pair, triangle of a, triangle of b, verdict
    stack: np.ndarray  #: (STACK, 2)


@njit
def descend(
    trees_a: TreeArrays, a: MeshAt, trees_b: TreeArrays, b: MeshAt,
    pose: Pose, search: Contacting, pair: int, found: int,
) -> tuple[int, int]:  # fmt: skip
    """Return the highest verdict of two triangles, and the number of contacts so far.

    Every pair of triangles that is not SEPARATE is written as a contact, as far as there is room;
    found: how many there were before.
    """
    nodes_a, children_a, starts_a = trees_a.nodes, trees_a.children, trees_a.starts
    nodes_b, children_b, starts_b = trees_b.nodes, trees_b.children, trees_b.starts
    triangles_a, triangles_b = trees_a.triangles, trees_b.triangles
    contacts, stack, effort = search.contacts, search.stack, search.effort
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
            waiting = _push((child_a, j), (child_a + 1, j), first, second, stack, waiting)
        else:
            other = moved_node(back, nodes_a, i)
            first = faces_gap(nodes_b, child_b, other, pose.gap_bound)
            second = faces_gap(nodes_b, child_b + 1, other, pose.gap_bound)
            waiting = _push((i, child_b), (i, child_b + 1), first, second, stack, waiting)
    return verdict, found


@njit
def _triangles_verdict(p: Triangle, a: Place, q: Triangle, b: Place, pose: Pose) -> int:
    """Return the verdict of two triangles of bodies at places a and b."""
    placed = moved(pose, q[0]), moved(pose, q[1]), moved(pose, q[2])
    verdict = classify_by_signs(p, placed, pose.point_bound)
    return classify_by_axes(p, a, q, b) if verdict == UNDECIDED else verdict


@njit
def _push(
    one: tuple[int, int], other: tuple[int, int], first: float, second: float,
    stack: np.ndarray, waiting: int,
) -> int:  # fmt: skip
    """Put two pairs of nodes that may collide on the stack; return its size.

    first, second: their gaps, infinite where they are apart. What overlaps more comes last and is
    next.
    """
    if first < second:
        one, other, first, second = other, one, second, first
    if first < np.inf:
        stack[waiting, 0], stack[waiting, 1] = one
        waiting += 1
    if second < np.inf:
        stack[waiting, 0], stack[waiting, 1] = other
        waiting += 1
    return waiting


@njit
def boxes_may_collide(
    trees_a: TreeArrays, a: MeshAt, trees_b: TreeArrays, b: MeshAt,
    pose: Pose, depth: int, stack: np.ndarray,
) -> bool:  # fmt: skip
    """Return whether boxes of a depth are not certainly apart, nor those above them.

    A greater depth never reports what a lesser one doesn't.
    """
    nodes_a, children_a, levels_a = trees_a.nodes, trees_a.children, trees_a.levels
    nodes_b, children_b, levels_b = trees_b.nodes, trees_b.children, trees_b.levels
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
        waiting = _push((i1, j1), (i2, j2), first, second, stack, waiting)
    return False
