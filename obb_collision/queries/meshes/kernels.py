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
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.queries.meshes.inside import INSIDE, UNKNOWN, point_side
from obb_collision.queries.meshes.tree_boxes import (
    BOX_BOUND,
    POINT_BOUND,
    box_gap,
    relative_pose,
)
from obb_collision.queries.meshes.tree_descent import STACK, Placement, boxes_meet, descend
from obb_collision.queries.meshes.triangle_signs import OVERLAP, SEPARATE, TOUCHING, moved
from obb_collision.typing import Floats


@njit
def find_kernel(
    a: TreeArrays, meshes_a: np.ndarray, placed_a: Placement, rows_a: np.ndarray,
    b: TreeArrays, meshes_b: np.ndarray, placed_b: Placement, rows_b: np.ndarray,
    stop: int, effort: int, out: np.ndarray, contacts: np.ndarray,
) -> int:  # fmt: skip
    """Write the verdict of each pair of rows, and contacts while there is room; return how many.

    contacts (c, 4): pair, triangle of a, triangle of b, verdict. The search within a pair ends at
    the first triangles of a verdict of at least ``stop``, or ``effort`` pairs of nodes after the
    first that touch.
    """
    pose = np.empty(12)
    stack = np.empty((STACK, 2), np.int64)
    found = 0
    for n in range(len(rows_a)):
        i, j = rows_a[n], rows_b[n]
        mesh_a, mesh_b = meshes_a[i], meshes_b[j]
        root_a, root_b = a.roots[mesh_a], b.roots[mesh_b]
        size = relative_pose(
            placed_a.centers, placed_a.rotations, i, placed_b.centers, placed_b.rotations, j,
            a.radii[mesh_a] + b.radii[mesh_b], pose,
        )  # fmt: skip
        bound = BOX_BOUND * size + MESH_UNDERFLOW
        out[n] = SEPARATE
        if box_gap(a.nodes, root_a, b.nodes, root_b, pose, bound) == np.inf:
            continue
        error = POINT_BOUND * size + MESH_UNDERFLOW
        verdict, found = descend(
            a, root_a, placed_a, i, b, root_b, placed_b, j,
            pose, bound, error, stop, effort, stack, n, contacts, found,
        )  # fmt: skip
        if verdict == SEPARATE:
            verdict = _nesting(a, mesh_a, b, mesh_b, pose, error, stack)
        out[n] = verdict
    return found


@njit
def tree_kernel(
    a: TreeArrays, meshes_a: np.ndarray, placed_a: Placement, rows_a: np.ndarray,
    b: TreeArrays, meshes_b: np.ndarray, placed_b: Placement, rows_b: np.ndarray,
    depth: int, out: np.ndarray,
) -> None:  # fmt: skip
    """Write for each pair of rows whether boxes of a depth meet, or a piece lies inside."""
    pose = np.empty(12)
    stack = np.empty((STACK, 2), np.int64)
    for n in range(len(rows_a)):
        i, j = rows_a[n], rows_b[n]
        mesh_a, mesh_b = meshes_a[i], meshes_b[j]
        root_a, root_b = a.roots[mesh_a], b.roots[mesh_b]
        size = relative_pose(
            placed_a.centers, placed_a.rotations, i, placed_b.centers, placed_b.rotations, j,
            a.radii[mesh_a] + b.radii[mesh_b], pose,
        )  # fmt: skip
        bound = BOX_BOUND * size + MESH_UNDERFLOW
        out[n] = False
        if box_gap(a.nodes, root_a, b.nodes, root_b, pose, bound) == np.inf:
            continue
        if boxes_meet(a, root_a, b, root_b, pose, bound, depth, stack):
            out[n] = True
            continue
        error = POINT_BOUND * size + MESH_UNDERFLOW
        out[n] = _nesting(a, mesh_a, b, mesh_b, pose, error, stack) != SEPARATE


@njit
def _nesting(
    a: TreeArrays, mesh_a: int, b: TreeArrays, mesh_b: int,
    pose: Floats, error: float, stack: np.ndarray,
) -> int:  # fmt: skip
    """Return OVERLAP where a piece of one is inside the other, TOUCHING where that is unknown.

    For meshes whose surfaces are apart: then a piece is inside or outside as a whole.
    """
    unknown = False
    if a.solid[mesh_a]:
        for k in range(b.piece_starts[mesh_b], b.piece_starts[mesh_b + 1]):
            side = _piece_side(a, mesh_a, b.pieces, k, pose, False, error, stack)
            if side == INSIDE:
                return OVERLAP
            unknown = unknown or side == UNKNOWN
    if b.solid[mesh_b]:
        for k in range(a.piece_starts[mesh_a], a.piece_starts[mesh_a + 1]):
            side = _piece_side(b, mesh_b, a.pieces, k, pose, True, error, stack)
            if side == INSIDE:
                return OVERLAP
            unknown = unknown or side == UNKNOWN
    return TOUCHING if unknown else SEPARATE


@njit
def _piece_side(
    trees: TreeArrays, mesh: int, pieces: Floats, k: int,
    pose: Floats, back: bool, error: float, stack: np.ndarray,
) -> int:  # fmt: skip
    """Return the side of piece k (p, 6, 3) of the one mesh in the other: of its first sure corner.

    ``back``: the pose takes the solid to the piece's frame, not the piece to the solid's.
    """
    for n in range(pieces.shape[1]):
        point = (pieces[k, n, 0], pieces[k, n, 1], pieces[k, n, 2])
        point = _moved_back(pose, point) if back else moved(pose, point)
        side = point_side(trees, mesh, point, error, stack)
        if side != UNKNOWN:
            return side
    return UNKNOWN


@njit
def _moved_back(pose: Floats, p: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a point of the frame of a in that of b: the transposed rotation.

    Off by at most ``POINT_BOUND``, like ``moved``: the pose's rotation is orthonormal to 160 u.
    """
    x, y, z = p[0] - pose[9], p[1] - pose[10], p[2] - pose[11]
    return (
        pose[0] * x + pose[3] * y + pose[6] * z,
        pose[1] * x + pose[4] * y + pose[7] * z,
        pose[2] * x + pose[5] * y + pose[8] * z,
    )
