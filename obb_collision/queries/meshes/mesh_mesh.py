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

"""Verdicts of two placed meshes, and the certified distance of their surfaces.

A watertight mesh is a solid, an open one a surface. Two meshes collide if their surfaces have a
common point, or if a piece of one lies inside the other, which must be a solid. Verdicts:
SEPARATE, certainly no common point; OVERLAP, two triangles certainly pierce each other or a piece
lies certainly inside; TOUCHING, all others: surfaces that touch (also those of solids that
overlap with nothing but coplanar faces and shared edges, such as a mesh and its copy in the same
place), or too near to decide: triangles within 1e-26 of the size of the pair, or a piece of which
six corners all lie within 1e-13 of the other's surface. They hold for the points
centre + rotation x corner for the doubles as stored.

A box is a mesh too (``MeshTrees.from_half_extents``), exactly.

The distance is 0 where they collide. Else it has two bounds: no points of the two are closer than
the lower one, and the two positions are no farther apart than the upper one. Both differ by less
than 1e-9 of the size of the pair, the components of the offset of their origins plus their reach
from these; where meshes are nearer than 1e-10 of it the lower bound may be 0.

A body may have a radius: it is then everything within that distance of its mesh, exactly. So a
sphere is a point and a capsule a segment, as triangles whose corners are equal, and a padded mesh
is one with round edges.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.geometry.validation import as_whole, check_kind, refuse_where
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.vec3 import ZERO, combined, minus, norm, plus, scaled
from obb_collision.queries.clearance.clearance import Clearances, as_limit
from obb_collision.queries.meshes.inside import (
    INSIDE_MESH,
    OUTSIDE_MESH,
    UNKNOWN_SIDE,
    inside_exactly,
    outside_box,
    point_side,
)
from obb_collision.queries.meshes.placed import (
    MeshPair,
    PairPose,
    PlacedMeshes,
    mesh_pair_at,
    moved,
    moved_back,
    node_gap,
)
from obb_collision.queries.meshes.trees import (
    DISTANCE_BOUND,
    SAME_DISTANCE,
    ContactSearch,
    NodePair,
    NodeStack,
    TreeRoom,
    find_contacts,
    nearest_triangles,
    node_stack,
    points_of,
    tree_room,
)
from obb_collision.queries.meshes.triangles import exact_corners, exact_triangle_verdict
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.pair_rows import RowPairs, as_each, as_sides
from obb_collision.queries.verdict.verdict import OVERLAP, SEPARATE, TOUCHING
from obb_collision.typing import Floats, Integers, Mask, Vector

#: Above all verdicts: the search ends only after all triangles.
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
) -> NDArray[np.int8]:
    """Return the verdicts of meshes (m,); effort: pairs of nodes after the first contact."""
    i, j = as_sides(a, b, pairs)
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

    pairs (c,): the row of the pair of meshes; faces (c, 2): of a and of b; verdicts (c,) int8.
    count: their true number, which may exceed the capacity.
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
        Maximum number of pairs of triangles; ``count`` is the true one. By default all.

    Returns
    -------
    TrianglePairs
        pairs (c,) rows of the pairs; faces (c, 2) of a and b; verdicts (c,); count.

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
        if count > len(contacts) and room > FIRST_ROOM:  # only as much room as is needed
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
    arguments = RowPairs(a.arrays, i, b.arrays, j), (stop, effort), result, contacts
    # contacts are written by one thread
    least = len(i) + 1 if capacity else FEWEST_MESH_VERDICTS
    count = sum(run(find_kernel, len(i), least, *arguments))
    return result, contacts[:count], count


def _all_contacts(a: PlacedMeshes, b: PlacedMeshes, i: Integers, j: Integers) -> Integers:
    capacity = 64 * len(i)
    while True:
        _, contacts, count = _find(a, b, i, j, NO_VERDICT, capacity)
        if count <= capacity:
            return contacts
        capacity = count


def _decide_exactly(a: PlacedMeshes, i: int, b: PlacedMeshes, j: int, pairs: Integers) -> int:
    """Return the verdict of two bodies; only these pairs of triangles may collide."""
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
    pairs: RowPairs, ends: NodePair, out: np.ndarray, contacts: np.ndarray, start: int, stop: int
) -> int:
    """Write the verdict of a range of pairs, and contacts while there is room; return their number.

    contacts (c, 4): pair, triangle of a, triangle of b, verdict. The search within a pair ends at
    triangles with a verdict of at least ``ends[0]``, or ``ends[1]`` pairs of nodes after the first
    contact.
    """
    search = ContactSearch(ends[0], ends[1], contacts, node_stack())
    return _find_range(pairs, search, out, start, stop)


@njit(refcount=False)
def _find_range(
    pairs: RowPairs, search: ContactSearch, out: np.ndarray, start: int, stop: int
) -> int:
    count = 0
    for n in range(start, stop):
        bodies = mesh_pair_at(pairs, n)
        out[n] = SEPARATE
        if roots_apart(bodies):
            continue
        verdict, count = find_contacts(bodies, search, n, count)
        if verdict == SEPARATE:
            verdict = nesting(bodies, search.waiting)[0]
        out[n] = verdict
    return count


@njit(refcount=False)
def roots_apart(bodies: MeshPair) -> bool:
    """Return whether the root boxes of two bodies are certainly apart."""
    trees_a, a, trees_b, b, pose = bodies
    root_a, root_b = trees_a.roots[a.mesh], trees_b.roots[b.mesh]
    return node_gap(trees_a.nodes, root_a, trees_b.nodes, root_b, pose) == np.inf


@njit(refcount=False)
def nesting(bodies: MeshPair, waiting: NodeStack) -> tuple[int, int, bool]:
    """Return OVERLAP if a piece of one mesh is inside the other, TOUCHING if that is unknown.

    And that piece, and whether it belongs to a. Surfaces must be apart: then each piece is inside
    or outside as a whole.
    """
    trees_a, a, trees_b, b, pose = bodies
    unknown, of_a = -1, False
    if trees_a.solid[a.mesh]:
        for k in range(trees_b.piece_starts[b.mesh], trees_b.piece_starts[b.mesh + 1]):
            side = _piece_side(trees_a, a.mesh, trees_b.pieces, k, pose, False, waiting)
            if side == INSIDE_MESH:
                return OVERLAP, k, False
            unknown = k if side == UNKNOWN_SIDE else unknown
    if trees_b.solid[b.mesh]:
        for k in range(trees_a.piece_starts[a.mesh], trees_a.piece_starts[a.mesh + 1]):
            side = _piece_side(trees_b, b.mesh, trees_a.pieces, k, pose, True, waiting)
            if side == INSIDE_MESH:
                return OVERLAP, k, True
            if side == UNKNOWN_SIDE:
                unknown, of_a = k, True
    return TOUCHING if unknown >= 0 else SEPARATE, unknown, of_a


@njit(refcount=False)
def _piece_side(
    trees: TreeArrays,
    mesh: int,
    parts: Floats,
    k: int,
    pose: PairPose,
    back: bool,
    room: NodeStack,
) -> int:
    """Return on which side of a solid mesh a piece of another is, by its first certain corner.

    parts (p, 6, 3): corners of pieces; k: the piece. back: whether the pose takes the solid to the
    frame of the piece, not the piece to the frame of the solid. A corner outside of the solid's box
    needs no ray.
    """
    count, root = parts.shape[1], trees.roots[mesh]
    for n in range(2 * count):
        row = n % count
        point = parts[k, row, 0], parts[k, row, 1], parts[k, row, 2]
        point = moved_back(pose, point) if back else moved(pose, point)
        if n >= count:
            side = point_side(trees, mesh, point, pose.point_bound, room)
            if side != UNKNOWN_SIDE:
                return side
        elif outside_box(trees.nodes, root, point, pose.point_bound):
            return OUTSIDE_MESH
    return UNKNOWN_SIDE


#: Pairs below which a second thread does not pay: 0.2 ms.
FEWEST_MESH_CLEARANCES = 16
#: Of the bodies of both sides.
Radii = tuple[Floats, Floats]
#: Of m pairs: whether they are near (m,), bounds (2, m), points and normal (3, m, 3), faces (m, 2).
ClearanceArrays = tuple[np.ndarray, Floats, Floats, np.ndarray]


@dataclass(frozen=True, eq=False)
class MeshClearances(Clearances):
    """Clearances of placed meshes: distances are lower bounds, 0 where meshes collide.

    Then both positions are one common point, and the normal is zero.
    """

    upper: Floats
    """(m,) the positions are no farther apart, up to the rounding of world coordinates."""
    faces: Integers
    """(m, 2) the closest faces of a and of b; -1 where a piece lies inside the other."""


def mesh_clearances(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    max_distance: float = np.inf,
    radii_a: ArrayLike = 0.0,
    radii_b: ArrayLike = 0.0,
) -> MeshClearances:
    """Return the clearances of meshes, with radii, that are within a distance, in metres."""
    i, j = as_sides(a, b, pairs)
    limit = as_limit(max_distance)
    first, second = as_radii(radii_a, "radii_a", len(a)), as_radii(radii_b, "radii_b", len(b))
    result, near = clearances_of(a, first, b, second, i, j, limit)
    return result if near.all() else MeshClearances(*(x[near] for x in vars(result).values()))


def clearances_of(
    a: PlacedMeshes,
    radii_a: Floats,
    b: PlacedMeshes,
    radii_b: Floats,
    i: Integers,
    j: Integers,
    limit: float,
) -> tuple[MeshClearances, Mask]:
    """Return the clearances of pairs i (m,) of a and j (m,) of b, and which are within a limit.

    Rows of the others are not written.
    """
    bounds, vectors = np.empty((2, len(i))), np.empty((3, len(i), 3))
    out = np.empty(len(i), np.bool_), bounds, vectors, np.empty((len(i), 2), np.int64)
    pairs = RowPairs(a.arrays, np.ascontiguousarray(i), b.arrays, np.ascontiguousarray(j))
    radii = radii_a, radii_b
    run(mesh_clearance_kernel, len(i), FEWEST_MESH_CLEARANCES, pairs, radii, limit, out)
    x, y, normals = vectors
    rows = np.stack([i, j], axis=1)
    return MeshClearances(rows, bounds[0], x, y, normals, bounds[1], out[3]), out[0]


def as_radii(values: ArrayLike, name: str, count: int) -> Floats:
    """Return the radius (n,) of each body."""
    radii = as_each(values, name, "a number, or a number per body", (count,))
    refuse_where(~((radii >= 0.0) & (radii < np.inf)), f"{name} must be finite and not negative")
    return radii


class SurfaceDistance(NamedTuple):
    """The distance of two meshes: bounds, points and direction, in the frame of a, metres."""

    collide: bool
    lower: float
    upper: float
    x: Vector  #: of a
    y: Vector  #: of b
    n: Vector  #: unit, from a to b; zero where they collide
    s: int  #: triangle of a, -1 if unknown
    t: int  #: triangle of b


@njit
def mesh_clearance_kernel(
    pairs: RowPairs, radii: Radii, limit: float, out: ClearanceArrays, start: int, stop: int
) -> None:
    """Write whether pairs are within the limit, and the clearance of those that are."""
    near, bounds, vectors, faces = out
    room = tree_room(1)
    for row in range(start, stop):
        bodies = mesh_pair_at(pairs, row)
        radius, other = radii[0][pairs.rows_a[row]], radii[1][pairs.rows_b[row]]
        place, reach = bodies.a.place, radius + other
        apart = surfaces_apart(bodies, limit + reach, room)
        bound = DISTANCE_BOUND * (bodies.pose.size + reach) + MESH_UNDERFLOW
        least = max(apart.lower - reach - bound, 0.0)
        most = 0.0 if apart.collide else max(apart.upper - reach + bound, 0.0)
        near[row] = least <= limit and apart.upper < np.inf
        if not near[row]:
            continue
        share = 1.0 if apart.upper >= reach else apart.upper / reach
        x = plus(apart.x, scaled(apart.n, share * radius))
        y = minus(apart.y, scaled(apart.n, share * other))
        p = plus(place.center, combined(place.axes, x))
        q = plus(place.center, combined(place.axes, y))
        n = combined(place.axes, apart.n) if most > 0.0 else ZERO
        bounds[0, row], bounds[1, row] = least, most
        for k in range(3):
            vectors[0, row, k], vectors[1, row, k], vectors[2, row, k] = p[k], q[k], n[k]
        faces[row, 0] = bodies.trees_a.faces[apart.s] if apart.s >= 0 else -1
        faces[row, 1] = bodies.trees_b.faces[apart.t] if apart.s >= 0 else -1


@njit(refcount=False)
def surfaces_apart(bodies: MeshPair, limit: float, room: TreeRoom) -> SurfaceDistance:
    """Return the distance of two meshes, with bounds up to rounding; infinite past a limit."""
    zero = ZERO
    unit, back = unit_scale(bodies.pose.size)
    if not roots_apart(bodies):
        search = ContactSearch(TOUCHING, UNLIMITED, room.contacts, room.waiting)
        if find_contacts(bodies, search, 0, 0)[0] != SEPARATE:
            s, t = room.contacts[0, 1], room.contacts[0, 2]
            _, x, y = points_of(bodies, s, t, unit)
            return SurfaceDistance(True, 0.0, 0.0, scaled(x, back), scaled(y, back), zero, s, t)
        verdict, k, of_a = nesting(bodies, room.waiting)
        if verdict != SEPARATE:
            own, other = bodies.trees_a, bodies.trees_b
            point = _piece(own, k) if of_a else moved(bodies.pose, _piece(other, k))
            return SurfaceDistance(True, 0.0, 0.0, point, point, zero, -1, -1)
    nearest = nearest_triangles(bodies, unit, limit * unit + 2.0 * SAME_DISTANCE, room)
    s, t, n = nearest.s, nearest.t, nearest.direction
    if s < 0:
        return SurfaceDistance(False, nearest.lower * back, np.inf, zero, zero, zero, s, t)
    distance, x, y = points_of(bodies, s, t, unit)
    if nearest.lower <= DISTANCE_BOUND and distance > 0.0:  # along no direction a gap is certain
        n = scaled(minus(x, y), 1.0 / norm(minus(x, y)))
    x, y = scaled(x, back), scaled(y, back)
    lower, upper = nearest.lower * back, distance * back
    return SurfaceDistance(False, lower, upper, x, y, scaled(n, -1.0), s, t)


@njit(refcount=False)
def _piece(trees: TreeArrays, k: int) -> Vector:
    return trees.pieces[k, 0, 0], trees.pieces[k, 0, 1], trees.pieces[k, 0, 2]
