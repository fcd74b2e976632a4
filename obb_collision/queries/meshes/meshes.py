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

"""Do two meshes collide? Triangles through their OBB trees, and what lies inside a solid.

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
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._threads import run
from obb_collision.geometry.kinds import as_flag, check_kind
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.validation import (
    as_array,
    as_rotations,
    as_rows,
    as_whole,
    check_lengths,
)
from obb_collision.queries.meshes.inside import inside_exactly
from obb_collision.queries.meshes.kernels import find_kernel, tree_kernel
from obb_collision.queries.meshes.tree_descent import Bodies
from obb_collision.queries.meshes.triangle_exact import exact_corners, exact_triangle_verdict
from obb_collision.queries.verdict.pair_rows import as_sides
from obb_collision.queries.verdict.verdict import OVERLAP, SEPARATE, TOUCHING
from obb_collision.typing import Floats, Integers

#: A verdict that none reaches: look at all triangles.
NEVER = OVERLAP + 1
#: More pairs of nodes than any two meshes have.
UNLIMITED = 2**62
#: Pairs below which a second thread does not pay: 0.2 ms.
FEWEST_PAIRS = 64
#: Contacts that there is room for at first, whatever the capacity: 2 MB.
FIRST_ROOM = 1 << 16


@dataclass(frozen=True, eq=False)
class PlacedMeshes:
    """n bodies: body i is mesh ``meshes[i]`` of the trees at centers (n, 3), rotations (n, 3, 3).

    Metres; raises ValueError naming the argument and the row for anything else.

    Parameters
    ----------
    trees : MeshTrees
    meshes : (n,) array_like of int
        Rows of trees.
    centers : (n, 3) array_like
        Metres.
    rotations : (n, 3, 3) array_like
        Orthonormal.

    Raises
    ------
    ValueError
        Naming the argument and the row.

    Examples
    --------
    >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> len(oc.PlacedMeshes(tree, [0, 0], np.zeros((2, 3)), [np.eye(3)] * 2))
    2
    """

    trees: MeshTrees
    meshes: Integers
    centers: Floats
    rotations: Floats
    arrays: Bodies = field(init=False, repr=False)
    """All of it, for kernels."""

    def __init__(
        self, trees: MeshTrees, meshes: ArrayLike, centers: ArrayLike, rotations: ArrayLike
    ) -> None:
        if not isinstance(trees, MeshTrees):
            raise ValueError(f"trees must be MeshTrees, got {type(trees).__name__}")
        rows = as_rows(meshes, "meshes", len(trees))
        c = as_array(centers, "centers", (None, 3))
        r = as_rotations(rotations, "rotations", (None, 3, 3))
        check_lengths(meshes=rows, centers=c, rotations=r)
        self._store(trees, rows, c.copy(), r.copy())

    def _store(
        self, trees: MeshTrees, meshes: Integers, centers: Floats, rotations: Floats
    ) -> None:
        """Store arrays for kernels, which follow the rows in them, and a view to look at those."""
        shown = meshes.view()
        shown.setflags(write=False)
        vars(self).update(trees=trees, meshes=shown, centers=centers, rotations=rotations)
        vars(self)["arrays"] = Bodies(trees.arrays, meshes, centers, rotations)

    @classmethod
    def from_poses(cls, trees: MeshTrees, meshes: ArrayLike, poses: ArrayLike) -> PlacedMeshes:
        """Return bodies at poses (n, 7), x y z qx qy qz qw.

        Parameters
        ----------
        trees : MeshTrees
        meshes : (n,) array_like of int
            Rows of trees.
        poses : (n, 7) array_like
            x y z (metres) qx qy qz qw.

        Raises
        ------
        ValueError
            Naming the argument and the row.

        Examples
        --------
        >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> len(oc.PlacedMeshes.from_poses(tree, [0], [[0, 0, 0, 0, 0, 0, 1]]))
        1
        """
        return cls(trees, meshes, *as_poses(poses))

    @classmethod
    def trusted(
        cls, trees: MeshTrees, meshes: Integers, centers: Floats, rotations: Floats
    ) -> PlacedMeshes:
        """Return bodies of arrays that are valid, unchecked and not copied."""
        bodies = object.__new__(cls)
        bodies._store(trees, meshes, centers, rotations)
        return bodies

    def __len__(self) -> int:
        return len(self.meshes)

    def place(self, row: int) -> tuple[Floats, Floats]:
        """Return centre (3,) and rotation (3, 3) of a body."""
        return self.centers[row], self.rotations[row]


def mesh_verdicts(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    exact: bool = False,
    effort: int = UNLIMITED,
) -> NDArray[np.int8]:
    """Return whether meshes collide, with certainty.

    Parameters
    ----------
    a, b : PlacedMeshes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    exact : bool
        Decide by integers what doubles can't tell from touching (0.1 ms per pair of triangles in
        contact).
    effort : int
        Pairs of nodes to look at once triangles touch; then the verdict stays TOUCHING, though
        others may overlap. Meshes that rest face to face take 0.1 s to rule that out.

    Returns
    -------
    (m,) array of int8
        Of ``Verdict``.

    Raises
    ------
    ValueError
        For pairs that are no rows, and without pairs for different lengths.
    TypeError
        For anything but placed meshes.

    Examples
    --------
    >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> crossing = [[0, 0, 0, 0, 0, 0, 1], [0.25, 0.25, -0.25, 0.5, 0.5, 0.5, 0.5]]
    >>> bodies = oc.PlacedMeshes.from_poses(tree, [0, 0], crossing)
    >>> oc.mesh_verdicts(bodies, bodies, [[0, 1]]).tolist()
    [2]
    """
    as_flag(exact, "exact")
    i, j = mesh_rows(a, b, pairs)
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


def mesh_collisions(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    depth: int | None = None,
) -> NDArray[np.bool_]:
    """Return which meshes collide; quicker than verdicts, since touching ends the search.

    Parameters
    ----------
    a, b : PlacedMeshes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    depth : int, optional
        Look at boxes of that depth (2^depth of them per mesh) instead of triangles: never misses
        what triangles report. A pair whose boxes of a lesser depth are apart is not reported, even
        where boxes below stick out of those above.

    Returns
    -------
    (m,) array of bool
        Whether they have a common point or a piece lies inside a solid.

    Raises
    ------
    ValueError
        For pairs that are no rows, and without pairs for different lengths.
    TypeError
        For anything but placed meshes.

    References
    ----------
    Gottschalk, Lin, Manocha, OBBTree (SIGGRAPH 1996).

    Examples
    --------
    >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> poses = [[0, 0, 0, 0, 0, 0, 1], [2, 0, 0, 0, 0, 0, 1]]
    >>> bodies = oc.PlacedMeshes.from_poses(tree, [0, 0], poses)
    >>> oc.mesh_collisions(bodies, bodies, [[0, 0], [0, 1]]).tolist()
    [True, False]
    """
    i, j = mesh_rows(a, b, pairs)
    if depth is None:
        return _find(a, b, i, j, TOUCHING, 0)[0] != SEPARATE
    result = np.empty(len(i), np.bool_)
    level = as_whole(depth, "depth")
    run(tree_kernel, len(i), FEWEST_PAIRS, a.arrays, i, b.arrays, j, level, result)
    return result


def mesh_contacts(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    capacity: int | None = None,
) -> tuple[Integers, int]:
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
    faces : (c, 4) array of int64
        Number of the pair, face of a, face of b, verdict.
    count : int
        How many there are.

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
    >>> faces, count = oc.mesh_contacts(body, body)
    >>> faces.tolist(), count
    ([[0, 0, 0, 1]], 1)
    """
    i, j = mesh_rows(a, b, pairs)
    if capacity is None:
        contacts = _all_contacts(a, b, i, j)
        count = len(contacts)
    else:
        room = as_whole(capacity, "capacity")
        _, contacts, count = _find(a, b, i, j, NEVER, min(room, FIRST_ROOM))
        if count > len(contacts) and room > FIRST_ROOM:  # no room is made that nothing fills
            _, contacts, count = _find(a, b, i, j, NEVER, min(room, count))
    faces = contacts.copy()
    faces[:, 1] = a.trees.faces[contacts[:, 1]]
    faces[:, 2] = b.trees.faces[contacts[:, 2]]
    return faces, count


def mesh_rows(
    a: PlacedMeshes, b: PlacedMeshes, pairs: ArrayLike | None
) -> tuple[Integers, Integers]:
    """Return rows (m,) of a and of b that are asked about."""
    check_kind(a, PlacedMeshes, "a")
    check_kind(b, PlacedMeshes, "b")
    return as_sides(a, b, pairs)


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
    given = a.arrays, i, b.arrays, j, stop, effort, result, contacts
    least = len(i) + 1 if capacity else FEWEST_PAIRS  # contacts are written one after another
    found = sum(run(find_kernel, len(i), least, *given))
    return result, contacts[:found], found


def _all_contacts(a: PlacedMeshes, b: PlacedMeshes, i: Integers, j: Integers) -> Integers:
    capacity = 64 * len(i)
    while True:
        _, contacts, found = _find(a, b, i, j, NEVER, capacity)
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
