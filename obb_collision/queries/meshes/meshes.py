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

"""Verdicts of placed meshes: triangles through their OBB trees, and what lies inside a solid.

A watertight mesh is a solid, an open one a surface. Two meshes collide if their surfaces have a
common point, or if a piece of one lies inside the other, which must be a solid. Verdicts:
SEPARATE, certainly no common point; OVERLAP, two triangles certainly pierce each other or a piece
lies certainly inside; TOUCHING, what is left: surfaces that touch (also those of solids that
overlap with nothing but coplanar faces and shared edges, such as a mesh and its copy in the same
place), or too near to decide: triangles within 1e-26 of the size of the pair, or a piece of which
six corners all lie within 1e-13 of the other's surface. They hold for the points
centre + rotation x corner for the doubles as stored.

A box is a mesh too (``MeshTrees.from_half_extents``), exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.geometry.validation import as_whole, check_kind
from obb_collision.queries.meshes.inside import (
    INSIDE,
    OUTSIDE,
    UNKNOWN,
    inside_exactly,
    outside_box,
    point_side,
)
from obb_collision.queries.meshes.one_tree import Waiting, no_waiting
from obb_collision.queries.meshes.placed import (
    MeshPair,
    PlacedMeshes,
    Pose,
    box_gap,
    mesh_pair_at,
    moved,
    moved_back,
)
from obb_collision.queries.meshes.triangles import (
    OVERLAP,
    SEPARATE,
    TOUCHING,
    exact_corners,
    exact_triangle_verdict,
)
from obb_collision.queries.meshes.two_trees import (
    Contacting,
    Nodes,
    boxes_may_collide,
    descend,
)
from obb_collision.queries.verdict.pair_rows import RowPairs, as_sides
from obb_collision.typing import Floats, Integers

#: A verdict that none reaches: look at all triangles.
NO_VERDICT = OVERLAP + 1
#: More pairs of nodes than any two meshes have.
UNLIMITED = 2**62
#: Pairs below which a second thread does not pay: 0.2 ms.
FEWEST_MESH_VERDICTS = 64
#: Contacts that there is room for at first, whatever the capacity: 2 MB.
FIRST_ROOM = 1 << 16


def mesh_verdicts(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    exact: bool = False,
    effort: int = UNLIMITED,
    depth: int | None = None,
) -> NDArray[np.int8]:
    """Return the verdicts of meshes (m,), or of their boxes of a depth: then never OVERLAP.

    effort: pairs of nodes to look at once they touch.
    """
    i, j = as_sides(a, b, pairs)
    if depth is not None:
        met, given = np.empty(len(i), np.bool_), RowPairs(a.arrays, i, b.arrays, j)
        run(tree_kernel, len(i), FEWEST_MESH_VERDICTS, given, as_whole(depth, "depth"), met)
        return np.where(met, np.int8(TOUCHING), np.int8(SEPARATE))
    effort = as_whole(effort, "effort")
    result, _, _ = _find(a, b, i, j, OVERLAP, 0, effort)
    if exact:
        open_rows = np.flatnonzero(result == TOUCHING)
        contacts = _all_contacts(a, b, i[open_rows], j[open_rows])
        starts = np.searchsorted(contacts[:, 0], np.arange(len(open_rows) + 1))
        for k, n in enumerate(open_rows):
            faces = contacts[starts[k] : starts[k + 1], 1:3]
            result[n] = _decide_exactly(a, int(i[n]), b, int(j[n]), faces)
    return result


@dataclass(frozen=True, eq=False)
class TrianglePairs:
    """Pairs of triangles of meshes that are not certainly apart.

    pairs (c,): the row of the pair of meshes that was asked about; faces (c, 2): of a and of b;
    verdicts (c,) int8. count: how many there are, which may be more than there was room for.
    """

    pairs: Integers
    faces: Integers
    verdicts: NDArray[np.int8]
    count: int

    def __len__(self) -> int:
        return len(self.pairs)


def triangle_pairs(
    a: PlacedMeshes, b: PlacedMeshes, pairs: ArrayLike | None = None, *, capacity: int | None = None
) -> TrianglePairs:
    """Return which triangles of meshes are not certainly apart.

    Parameters
    ----------
    a, b : PlacedMeshes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    capacity : int, optional
        Triangles given at most; their number is the true one all the same. Without, all are.

    Returns
    -------
    TrianglePairs
        pairs (c,) rows of the pairs; faces (c, 2) of a and b; verdicts (c,); count.

    Raises
    ------
    ValueError
        For pairs that are no rows, and without pairs for different lengths.
    TypeError
        For anything but placed meshes.

    Examples
    --------
    >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> body = oc.PlacedMeshes.from_poses(tree, [0], [[0, 0, 0, 0, 0, 0, 1]])
    >>> found = oc.triangle_pairs(body, body)
    >>> found.faces.tolist(), found.verdicts.tolist(), found.count
    ([[0, 0]], [1], 1)
    """
    check_kind(a, PlacedMeshes, "a")
    check_kind(b, PlacedMeshes, "b")
    i, j = as_sides(a, b, pairs)
    if capacity is None:
        contacts = _all_contacts(a, b, i, j)
        count = len(contacts)
    else:
        room = as_whole(capacity, "capacity")
        _, contacts, count = _find(a, b, i, j, NO_VERDICT, min(room, FIRST_ROOM))
        if count > len(contacts) and room > FIRST_ROOM:  # no room is made that nothing fills
            _, contacts, count = _find(a, b, i, j, NO_VERDICT, min(room, count))
    faces = np.stack([a.trees.faces[contacts[:, 1]], b.trees.faces[contacts[:, 2]]], axis=1)
    return TrianglePairs(contacts[:, 0].copy(), faces, contacts[:, 3].astype(np.int8), count)


def _find(
    a: PlacedMeshes,
    b: PlacedMeshes,
    i: Integers,
    j: Integers,
    stop: int,
    capacity: int,
    effort: int = UNLIMITED,
) -> tuple[NDArray[np.int8], Integers, int]:
    """Return verdicts (m,), contacts (at most capacity, 4) and their true number."""
    result = np.empty(len(i), np.int8)
    contacts = np.empty((capacity, 4), np.int64)
    given = RowPairs(a.arrays, i, b.arrays, j), (stop, effort), result, contacts
    least = (
        len(i) + 1 if capacity else FEWEST_MESH_VERDICTS
    )  # contacts are written one after another
    found = sum(run(find_kernel, len(i), least, *given))
    return result, contacts[:found], found


def _all_contacts(a: PlacedMeshes, b: PlacedMeshes, i: Integers, j: Integers) -> Integers:
    capacity = 64 * len(i)
    while True:
        _, contacts, found = _find(a, b, i, j, NO_VERDICT, capacity)
        if found <= capacity:
            return contacts
        capacity = found


def _decide_exactly(a: PlacedMeshes, i: int, b: PlacedMeshes, j: int, pairs: Integers) -> int:
    """Return the verdict of two bodies no triangles of which collide but, perhaps, these pairs."""
    verdict = SEPARATE
    for s, t in pairs:
        first, second = a.trees.triangles[s], b.trees.triangles[t]
        verdict = max(verdict, exact_triangle_verdict(first, a.place(i), second, b.place(j)))
        if verdict == OVERLAP:
            return verdict
    if verdict == SEPARATE and any(_inside(a, i, b, j)):
        return OVERLAP
    return OVERLAP if verdict == SEPARATE and any(_inside(b, j, a, i)) else verdict


def _inside(a: PlacedMeshes, i: int, b: PlacedMeshes, j: int) -> Iterator[bool]:
    """Yield for each piece of a whether it lies inside solid b, by exact integers."""
    mesh, other = a.meshes[i], b.meshes[j]
    if not b.trees.solid[other]:
        return
    roots = b.trees.roots
    first, last = b.trees.starts[roots[other]]
    triangles = b.trees.triangles[first:last][b.trees.counted[first:last]].ravel()
    starts = a.trees.piece_starts
    for point in a.trees.pieces[starts[mesh] : starts[mesh + 1], 0]:
        corners = exact_corners((point, triangles), (a.place(i), b.place(j)))
        yield inside_exactly(corners, bool(b.trees.winding[other]))


@njit
def find_kernel(
    pairs: RowPairs, ends: Nodes, out: np.ndarray, contacts: np.ndarray, start: int, stop: int
) -> int:
    """Write the verdict of a range of pairs, and contacts while there is room; return how many.

    contacts (c, 4): pair, triangle of a, triangle of b, verdict. The search within a pair ends at
    the first triangles of a verdict of at least ``ends[0]``, or ``ends[1]`` pairs of nodes after
    the first that touch.
    """
    search = Contacting(ends[0], ends[1], contacts, no_waiting())
    return _find_range(pairs, search, out, start, stop)


@njit(refcount=False)
def _find_range(pairs: RowPairs, search: Contacting, out: np.ndarray, start: int, stop: int) -> int:
    found = 0
    for n in range(start, stop):
        bodies = mesh_pair_at(pairs, n)
        out[n] = SEPARATE
        if roots_apart(bodies):
            continue
        verdict, found = descend(bodies, search, n, found)
        if verdict == SEPARATE:
            verdict = nesting(bodies, search.waiting)[0]
        out[n] = verdict
    return found


@njit
def tree_kernel(pairs: RowPairs, depth: int, out: np.ndarray, start: int, stop: int) -> None:
    """Write for a range of pairs whether boxes of a depth may collide, or a piece lies inside."""
    _tree_range(pairs, depth, out, no_waiting(), start, stop)


@njit(refcount=False)
def _tree_range(
    pairs: RowPairs, depth: int, out: np.ndarray, waiting: Waiting, start: int, stop: int
) -> None:
    for n in range(start, stop):
        bodies = mesh_pair_at(pairs, n)
        out[n] = not roots_apart(bodies) and (
            boxes_may_collide(bodies, depth, waiting) or nesting(bodies, waiting)[0] != SEPARATE
        )


@njit(refcount=False)
def roots_apart(bodies: MeshPair) -> bool:
    """Return whether the boxes about two bodies are certainly apart."""
    trees_a, a, trees_b, b, pose = bodies
    root_a, root_b = trees_a.roots[a.mesh], trees_b.roots[b.mesh]
    return box_gap(trees_a.nodes, root_a, trees_b.nodes, root_b, pose) == np.inf


@njit(refcount=False)
def nesting(bodies: MeshPair, waiting: Waiting) -> tuple[int, int, bool]:
    """Return OVERLAP where a piece of one is inside the other, TOUCHING where that is unknown.

    And that piece, and whether it is one of a. For meshes whose surfaces are apart: then a
    piece is inside or outside as a whole.
    """
    trees_a, a, trees_b, b, pose = bodies
    unknown, of_a = -1, False
    if trees_a.solid[a.mesh]:
        for k in range(trees_b.piece_starts[b.mesh], trees_b.piece_starts[b.mesh + 1]):
            side = _piece_side(trees_a, a.mesh, trees_b.pieces, k, pose, False, waiting)
            if side == INSIDE:
                return OVERLAP, k, False
            unknown = k if side == UNKNOWN else unknown
    if trees_b.solid[b.mesh]:
        for k in range(trees_a.piece_starts[a.mesh], trees_a.piece_starts[a.mesh + 1]):
            side = _piece_side(trees_b, b.mesh, trees_a.pieces, k, pose, True, waiting)
            if side == INSIDE:
                return OVERLAP, k, True
            if side == UNKNOWN:
                unknown, of_a = k, True
    return TOUCHING if unknown >= 0 else SEPARATE, unknown, of_a


@njit(refcount=False)
def _piece_side(
    trees: TreeArrays, mesh: int, pieces: Floats, k: int, pose: Pose, back: bool, waiting: Waiting
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
            side = point_side(trees, mesh, point, pose.point_bound, waiting)
        if side != UNKNOWN:
            return side
    return UNKNOWN
