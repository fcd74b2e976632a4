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

"""Batches of placed mesh pairs: gather, descend both trees, then ask what lies inside."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.queries.meshes.inside import INSIDE, OUTSIDE, UNKNOWN, outside_box, point_side
from obb_collision.queries.meshes.tree_boxes import (
    Pose,
    box_gap,
    moved,
    moved_back,
    relative_pose,
)
from obb_collision.queries.meshes.tree_descent import (
    STACK,
    Bodies,
    Body,
    Search,
    body_at,
    boxes_may_collide,
    descend,
)
from obb_collision.queries.meshes.triangle_signs import OVERLAP, SEPARATE, TOUCHING
from obb_collision.typing import Floats


@njit
def find_kernel(
    a: Bodies, rows_a: np.ndarray, b: Bodies, rows_b: np.ndarray,
    enough: int, effort: int, out: np.ndarray, contacts: np.ndarray, start: int, stop: int,
) -> int:  # fmt: skip
    """Write the verdict of a range of pairs, and contacts while there is room; return how many.

    contacts (c, 4): pair, triangle of a, triangle of b, verdict. The search within a pair ends at
    the first triangles of a verdict of at least ``enough``, or ``effort`` pairs of nodes after the
    first that touch.
    """
    trees_a, trees_b = a.trees, b.trees
    stack = np.empty((STACK, 2), np.int64)
    search = Search(enough, effort, contacts, stack)
    found = 0
    for n in range(start, stop):
        body_a, body_b = body_at(a, rows_a[n]), body_at(b, rows_b[n])
        pose = pose_of(trees_a, body_a, trees_b, body_b)
        out[n] = SEPARATE
        if roots_apart(trees_a, body_a, trees_b, body_b, pose):
            continue
        verdict, found = descend(trees_a, body_a, trees_b, body_b, pose, search, n, found)
        if verdict == SEPARATE:
            verdict = nesting(trees_a, body_a, trees_b, body_b, pose, stack)[0]
        out[n] = verdict
    return found


@njit
def tree_kernel(
    a: Bodies, rows_a: np.ndarray, b: Bodies, rows_b: np.ndarray, depth: int, out: np.ndarray,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Write for a range of pairs whether boxes of a depth may collide, or a piece lies inside."""
    trees_a, trees_b = a.trees, b.trees
    stack = np.empty((STACK, 2), np.int64)
    for n in range(start, stop):
        body_a, body_b = body_at(a, rows_a[n]), body_at(b, rows_b[n])
        pose = pose_of(trees_a, body_a, trees_b, body_b)
        out[n] = False
        if roots_apart(trees_a, body_a, trees_b, body_b, pose):
            continue
        out[n] = boxes_may_collide(trees_a, body_a, trees_b, body_b, pose, depth, stack) or (
            nesting(trees_a, body_a, trees_b, body_b, pose, stack)[0] != SEPARATE
        )


@njit
def pose_of(trees_a: TreeArrays, a: Body, trees_b: TreeArrays, b: Body) -> Pose:
    """Return the pose of b in the frame of a."""
    return relative_pose(a.place, b.place, trees_a.radii[a.mesh] + trees_b.radii[b.mesh])


@njit
def roots_apart(trees_a: TreeArrays, a: Body, trees_b: TreeArrays, b: Body, pose: Pose) -> bool:
    """Return whether the boxes about two bodies are certainly apart."""
    root_a, root_b = trees_a.roots[a.mesh], trees_b.roots[b.mesh]
    return box_gap(trees_a.nodes, root_a, trees_b.nodes, root_b, pose) == np.inf


@njit
def nesting(
    trees_a: TreeArrays, a: Body, trees_b: TreeArrays, b: Body, pose: Pose, stack: np.ndarray
) -> tuple[int, int, bool]:  # fmt: skip
    """Return OVERLAP where a piece of one is inside the other, TOUCHING where that is unknown.

    And that piece, and whether it is one of a. For meshes whose surfaces are apart: then a
    piece is inside or outside as a whole.
    """
    unknown, of_a = -1, False
    if trees_a.solid[a.mesh]:
        for k in range(trees_b.piece_starts[b.mesh], trees_b.piece_starts[b.mesh + 1]):
            side = _piece_side(trees_a, a.mesh, trees_b.pieces, k, pose, False, stack)
            if side == INSIDE:
                return OVERLAP, k, False
            unknown = k if side == UNKNOWN else unknown
    if trees_b.solid[b.mesh]:
        for k in range(trees_a.piece_starts[a.mesh], trees_a.piece_starts[a.mesh + 1]):
            side = _piece_side(trees_b, b.mesh, trees_a.pieces, k, pose, True, stack)
            if side == INSIDE:
                return OVERLAP, k, True
            if side == UNKNOWN:
                unknown, of_a = k, True
    return TOUCHING if unknown >= 0 else SEPARATE, unknown, of_a


@njit
def _piece_side(
    trees: TreeArrays, mesh: int, pieces: Floats, k: int, pose: Pose, back: bool, stack: np.ndarray
) -> int:
    """Return the side of piece k (p, 6, 3) of the one mesh in the other: of its first sure corner.

    back: the pose takes the solid to the piece's frame, not the piece to the solid's. One corner
    outside the solid's box is enough, and found without a ray.
    """
    count, root = pieces.shape[1], trees.roots[mesh]
    for n in range(2 * count):
        row = n % count
        point = pieces[k, row, 0], pieces[k, row, 1], pieces[k, row, 2]
        point = moved_back(pose, point) if back else moved(pose, point)
        if n < count:
            side = OUTSIDE if outside_box(trees.nodes, root, point, pose.point_bound) else UNKNOWN
        else:
            side = point_side(trees, mesh, point, pose.point_bound, stack)
        if side != UNKNOWN:
            return side
    return UNKNOWN
