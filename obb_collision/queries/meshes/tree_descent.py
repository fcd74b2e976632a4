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

"""Two trees at once: which triangles, or boxes of a depth, of two placed meshes meet.

Of a pair of nodes that may meet the larger is replaced by its children, and the pair that
overlaps more is looked at first, so that a collision is found soon (Gottschalk, Lin, Manocha
1996, section 5). A pair is dropped only if the boxes are certainly apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.node_fit import SIZE
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.queries.meshes.tree_boxes import box_gap
from obb_collision.queries.meshes.triangle_axes import classify_by_axes
from obb_collision.queries.meshes.triangle_signs import (
    SEPARATE,
    TOUCHING,
    UNDECIDED,
    classify_by_signs,
)
from obb_collision.typing import Floats


class Placement(NamedTuple):
    """Where bodies are: centres (n, 3), rotations (n, 3, 3), for kernels."""

    centers: Floats
    rotations: Floats


#: Rows of the stack: one is left behind at each level of either tree, at most 2 x 75 of them
#: (``mesh_tree.LEAST_SHARE``).
STACK = 256


@njit
def descend(
    a: TreeArrays, root_a: int, placed_a: Placement, row_a: int,
    b: TreeArrays, root_b: int, placed_b: Placement, row_b: int,
    pose: Floats, box_bound: float, error: float, stop: int, effort: int,
    stack: np.ndarray, row: int, contacts: np.ndarray, found: int,
) -> tuple[int, int]:  # fmt: skip
    """Return the highest verdict of two triangles, and the number of contacts so far.

    pose (12,), box_bound and error: see ``tree_boxes``; stack (STACK, 2). Ends at the first
    verdict of at least ``stop``, or ``effort`` pairs of nodes after the first TOUCHING. Every pair
    of triangles that is not SEPARATE is written to contacts (c, 4) as (row, triangle of a,
    triangle of b, verdict), as far as there is room.
    """
    nodes_a, children_a, starts_a, triangles_a = a.nodes, a.children, a.starts, a.triangles
    nodes_b, children_b, starts_b, triangles_b = b.nodes, b.children, b.starts, b.triangles
    verdict = SEPARATE
    stack[0, 0], stack[0, 1] = root_a, root_b
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
                    met = classify_by_signs(triangles_a, s, triangles_b, t, pose, error)
                    if met == UNDECIDED:
                        met = classify_by_axes(
                            triangles_a, s, placed_a.centers, placed_a.rotations, row_a,
                            triangles_b, t, placed_b.centers, placed_b.rotations, row_b,
                        )  # fmt: skip
                    if met == SEPARATE:
                        continue
                    if found < len(contacts):
                        contacts[found, 0], contacts[found, 1] = row, s
                        contacts[found, 2], contacts[found, 3] = t, met
                    found += 1
                    verdict = max(verdict, met)
                    if verdict >= stop:
                        return verdict, found
            continue
        split_a = child_b < 0 or (child_a >= 0 and nodes_a[i, SIZE] >= nodes_b[j, SIZE])
        child = child_a if split_a else child_b
        waiting = _push(nodes_a, i, nodes_b, j, split_a, child, pose, box_bound, stack, waiting)
    return verdict, found


@njit
def _push(
    nodes_a: Floats, i: int, nodes_b: Floats, j: int, split_a: bool, child: int,
    pose: Floats, bound: float, stack: np.ndarray, waiting: int,
) -> int:  # fmt: skip
    """Put the pairs with the two children of i or j that may meet on the stack; return its size.

    child: the first of two adjacent rows. The more overlapping pair comes last, is next.
    """
    i1 = i2 = i
    j1 = j2 = j
    if split_a:
        i1, i2 = child, child + 1
    else:
        j1, j2 = child, child + 1
    first = box_gap(nodes_a, i1, nodes_b, j1, pose, bound)
    second = box_gap(nodes_a, i2, nodes_b, j2, pose, bound)
    if first < second:
        i1, i2, j1, j2 = i2, i1, j2, j1
        first, second = second, first
    if first < np.inf:
        stack[waiting, 0], stack[waiting, 1] = i1, j1
        waiting += 1
    if second < np.inf:
        stack[waiting, 0], stack[waiting, 1] = i2, j2
        waiting += 1
    return waiting


@njit
def boxes_meet(
    a: TreeArrays, root_a: int, b: TreeArrays, root_b: int,
    pose: Floats, box_bound: float, depth: int, stack: np.ndarray,
) -> bool:  # fmt: skip
    """Return whether boxes of a depth are not certainly apart, nor those above them.

    A greater depth never reports what a lesser one doesn't.
    """
    nodes_a, children_a, levels_a = a.nodes, a.children, a.levels
    nodes_b, children_b, levels_b = b.nodes, b.children, b.levels
    stack[0, 0], stack[0, 1] = root_a, root_b
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
        child = child_a if split_a else child_b
        waiting = _push(nodes_a, i, nodes_b, j, split_a, child, pose, box_bound, stack, waiting)
    return False
