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

"""Questions about pairs of bodies: each a table from the kinds of both to a function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.capsules import Capsules
from obb_collision.geometry.validation import as_flag, check_kind
from obb_collision.queries.clearance.clearance import Clearances, box_clearances
from obb_collision.queries.contacts.contacts import Contacts, box_contacts
from obb_collision.queries.mesh_contacts.surfaces import mesh_contacts, mesh_separations
from obb_collision.queries.meshes.mesh_mesh import MeshClearances, mesh_clearances, mesh_verdicts
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.primitives.capsules import (
    capsule_clearances,
    capsule_separations,
    capsule_verdicts,
)
from obb_collision.queries.primitives.planes import (
    HalfSpaces,
    half_space_separations,
    half_space_verdicts,
)
from obb_collision.queries.sweep.mesh_body import mesh_sweeps
from obb_collision.queries.sweep.motion import MovingBoxes
from obb_collision.queries.sweep.sweep import TOLERANCE, Sweeps, box_sweeps
from obb_collision.queries.verdict.verdict import (
    CertifiedSeparations,
    Separations,
    Verdicts,
    box_separations,
    box_verdicts,
)

AnyBody = Boxes | Capsules | PlacedMeshes
KindTable = dict[tuple[type, type], Callable[..., Any]]

VERDICT_TABLE: KindTable = {
    (Boxes, Boxes): box_verdicts,
    (Boxes, HalfSpaces): half_space_verdicts,
    (Capsules, Boxes): capsule_verdicts,
    (Capsules, Capsules): capsule_verdicts,
    (PlacedMeshes, PlacedMeshes): mesh_verdicts,
}
SEPARATION_TABLE: KindTable = {
    (Boxes, Boxes): box_separations,
    (Boxes, HalfSpaces): half_space_separations,
    (Capsules, Boxes): capsule_separations,
    (Capsules, Capsules): capsule_separations,
    (PlacedMeshes, PlacedMeshes): mesh_separations,
}
CLEARANCE_TABLE: KindTable = {
    (Boxes, Boxes): box_clearances,
    (Capsules, Boxes): capsule_clearances,
    (Capsules, Capsules): capsule_clearances,
    (PlacedMeshes, PlacedMeshes): mesh_clearances,
}
CONTACT_TABLE: KindTable = {
    (Boxes, Boxes): box_contacts,
    (PlacedMeshes, PlacedMeshes): mesh_contacts,
}
SWEEP_TABLE: KindTable = {
    **{(a, b): box_sweeps for a in (MovingBoxes, Boxes) for b in (MovingBoxes, Boxes)},
    (PlacedMeshes, PlacedMeshes): mesh_sweeps,
}


def _answer(
    table: KindTable, a: Any, b: Any, pairs: ArrayLike | None, shared: dict[str, Any], **own: Any
) -> Any:
    """Return the answer of the function that a question's table has for both kinds.

    shared: options of all kinds; own: options of some kinds, left out if None. Raises TypeError
    naming the argument for other kinds.
    """
    for (first, second), answer in table.items():
        if isinstance(a, first) and isinstance(b, second):
            options = {name: value for name, value in own.items() if value is not None}
            return answer(a, b, pairs, **shared, **options)
    firsts = dict.fromkeys(first for first, _ in table)
    seconds = [second for first, second in table if isinstance(a, first)]
    for value, name, kinds in ((a, "a", firsts), (b, "b", seconds)):
        kind, *others = kinds
        check_kind(value, kind, name, *others)


def verdicts(
    a: AnyBody,
    b: AnyBody | HalfSpaces,
    pairs: ArrayLike | None = None,
    *,
    exact: bool = False,
    effort: int | None = None,
) -> Verdicts:
    """Return whether bodies collide, with certainty.

    Parameters
    ----------
    a, b : Boxes or PlacedMeshes, Capsules and Capsules or Boxes, Boxes and HalfSpaces
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    exact : bool
        Of boxes and meshes: decide by integer arithmetic what doubles can't (0.1 ms per pair of
        triangles in contact). TOUCHING then means touching exactly.
    effort : int, optional
        Of meshes: maximum number of pairs of nodes examined once triangles touch. Beyond it the
        verdict stays TOUCHING, though other triangles may overlap. Without, meshes that rest face
        to face take 0.1 s.

    Returns
    -------
    (m,) array of int8
        Of ``Verdict``; SEPARATE and OVERLAP are certain, for the doubles as stored.

    References
    ----------
    Gottschalk, Lin, Manocha, OBBTree (SIGGRAPH 1996); Ericson 2005, 4.4.1.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [2, 0, 0], [4.5, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.verdicts(boxes, boxes, [[0, 1], [1, 2]], exact=True).tolist()  # touching, separate
    [1, 0]
    >>> ground = oc.HalfSpaces([[0, 0, 2]], [[0, 0, 1]])
    >>> oc.verdicts(boxes, ground, [[0, 0]]).tolist()
    [2]
    """
    exactly = as_flag(exact, "exact") or None
    return _answer(VERDICT_TABLE, a, b, pairs, {}, exact=exactly, effort=effort)


@overload
def separations(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    radii_a: ArrayLike | None = None,
    radii_b: ArrayLike | None = None,
) -> Separations: ...


@overload
def separations(
    a: Boxes | Capsules, b: Boxes | Capsules | HalfSpaces, pairs: ArrayLike | None = None
) -> CertifiedSeparations: ...


def separations(
    a: AnyBody,
    b: AnyBody | HalfSpaces,
    pairs: ArrayLike | None = None,
    *,
    radii_a: ArrayLike | None = None,
    radii_b: ArrayLike | None = None,
) -> Separations:
    """Return how far apart bodies are or how deep they overlap, along which direction.

    Of boxes that is the largest gap along an axis; of capsules the distance or the depth, right to
    2^-45 of the size of the pair; of half-spaces the height of the lowest point of a box. Of meshes
    that are apart it is the distance of ``clearances``, else minus a depth: moving b along the
    normal by the depth certainly parts them. No push along the normal of their hulls is shorter;
    the depth of their hulls is shorter by at most 1e-9 of the size of the pair. For convex meshes
    it is the least of all; for others a shorter one may exist along a direction that was not tried.

    Parameters
    ----------
    a, b : Boxes or PlacedMeshes, Capsules and Capsules or Boxes, Boxes and HalfSpaces
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    radii_a, radii_b : float or (n,) array_like, optional
        Of meshes, metres; a body is everything within its radius of its mesh.

    Returns
    -------
    Separations
        pairs (m, 2); separations (m,) metres, positive apart, negative overlapping; normals (m, 3)
        unit, from a to b; positions (m, 3) metres, a place near both; verdicts (m,) int8, except of
        meshes.

    References
    ----------
    Gottschalk, Lin, Manocha, OBBTree (SIGGRAPH 1996); Ericson 2005, 4.4.1, 4.5.1, 5.1.9 and 5.2.3;
    Je, Tang, Lee, Lin, Kim, PolyDepth: real-time penetration depth computation (2012).

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1.5, 0, 0], [4, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> found = oc.separations(boxes, boxes, [[0, 1], [0, 2]])
    >>> found.separations.tolist(), found.normals[1].tolist()
    ([-0.5, 2.0], [1.0, 0.0, 0.0])
    """
    return _answer(SEPARATION_TABLE, a, b, pairs, {}, radii_a=radii_a, radii_b=radii_b)


def contacts(
    a: Boxes | PlacedMeshes,
    b: Boxes | PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    max_points: int = 4,
    radii_a: ArrayLike | None = None,
    radii_b: ArrayLike | None = None,
) -> Contacts:
    """Return where bodies touch: normal, depth, and a few points that stand for the patch.

    Every pair of boxes that is not certainly separate has a point at least, touching ones included.
    Depths and normals of meshes are those of ``separations``. Their points are on the curve where
    the surfaces cross, to 1e-12 of the size of the pair, the deepest first (to 2^-24 of it), the
    others as far from those before as possible. The depth at a point is how far b must move along
    the normal until the two triangles that cross there no longer touch. Where no surfaces cross, as
    one body is within the other or only their radii overlap, there is one point, halfway between
    those that part last.

    Parameters
    ----------
    a, b : Boxes or PlacedMeshes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    max_points : int
        Maximum number of points per pair, 4 or 8.
    radii_a, radii_b : float or (n,) array_like, optional
        Of meshes, metres; a body is everything within its radius of its mesh.

    Returns
    -------
    Contacts
        normals (m, 3) unit, from a to b; depths (m,) metres; counts (m,), 0 where apart; positions
        (m, max_points, 3) metres and position_depths (m, max_points), NaN past the count; axes
        (m,), -1 of meshes.

    References
    ----------
    Ericson, Real-Time Collision Detection (2005), 5.5; Gregorius, Robust Contact Creation for
    Physics Simulations (GDC 2015).

    Examples
    --------
    >>> floor, crate = oc.OBB(half_extents=[9, 9, 1]), oc.OBB([0, 0, 2], np.eye(3), [1, 1, 1.25])
    >>> found = oc.contacts(oc.Boxes.from_obbs([floor]), oc.Boxes.from_obbs([crate]))
    >>> found.depths.tolist(), found.normals.tolist(), found.counts.tolist()
    ([0.25], [[0.0, 0.0, 1.0]], [4])
    """
    shared = {"max_points": max_points}
    return _answer(CONTACT_TABLE, a, b, pairs, shared, radii_a=radii_a, radii_b=radii_b)


@overload
def clearances(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    max_distance: float = np.inf,
    radii_a: ArrayLike | None = None,
    radii_b: ArrayLike | None = None,
) -> MeshClearances: ...


@overload
def clearances(
    a: Boxes | Capsules,
    b: Boxes | Capsules,
    pairs: ArrayLike | None = None,
    *,
    max_distance: float = np.inf,
) -> Clearances: ...


def clearances(
    a: AnyBody,
    b: AnyBody,
    pairs: ArrayLike | None = None,
    *,
    max_distance: float = np.inf,
    radii_a: ArrayLike | None = None,
    radii_b: ArrayLike | None = None,
) -> Clearances:
    """Return how far apart bodies are, and the closest points.

    Parameters
    ----------
    a, b : Boxes or PlacedMeshes, Capsules and Capsules or Boxes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    max_distance : float
        Metres; pairs farther apart are left out, and cost little.
    radii_a, radii_b : float or (n,) array_like, optional
        Of meshes, metres; a body is everything within its radius of its mesh.

    Returns
    -------
    Clearances
        pairs (k, 2), in their order; distances (k,) metres, positive apart; positions_a and
        positions_b (k, 3) metres; normals (k, 3) unit, from a to b. Of boxes that overlap the
        distance is minus the depth, of those that touch 0; of capsules that overlap it is minus the
        depth; of meshes it is never above the truth, 0 where they collide, with upper (k,) metres
        and faces (k, 2).

    References
    ----------
    Ericson, Real-Time Collision Detection (2005), 4.5.1, 5.1 and 9; Larsen, Gottschalk, Lin,
    Manocha, Fast Proximity Queries with Swept Sphere Volumes (1999).

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1.5, 0, 0], [4, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> found = oc.clearances(boxes, boxes, [[0, 1], [0, 2]])
    >>> found.distances.tolist(), found.normals[1].tolist()
    ([-0.5, 2.0], [1.0, 0.0, 0.0])
    >>> balls = oc.Capsules.spheres([[0, 0, 0], [3, 0, 0]], [1, 0.5])
    >>> oc.clearances(balls, balls, [[0, 1]]).distances.tolist()
    [1.5]
    """
    shared = {"max_distance": max_distance}
    return _answer(CLEARANCE_TABLE, a, b, pairs, shared, radii_a=radii_a, radii_b=radii_b)


def sweeps(
    a: MovingBoxes | Boxes | PlacedMeshes, b: MovingBoxes | Boxes | PlacedMeshes,
    pairs: ArrayLike | None = None, *, tolerance: float = TOLERANCE, contacts: bool = True,
    duration: float | None = None,
    twists_a: ArrayLike | None = None, twists_b: ArrayLike | None = None,
    radii_a: ArrayLike | None = None, radii_b: ArrayLike | None = None,
) -> Sweeps:  # fmt: skip
    """Return when moving bodies first touch.

    Bodies that collide at the start hit at time 0; touching counts.
    Where neither of two boxes turns (rotations equal bit for bit), the time is exact up to
    rounding: never late, and at that time they are less than 4e-15 T apart (see ``linear``).
    Where one does, and of meshes, time and hit are conservative: never late, none missed, and at
    that time the bodies are nearer than ``tolerance`` times the bounding radius of the smaller box
    (or 2e-6 of the larger one's where that is more). A turning pair that passes by that near may
    hit. What takes more than 2000 steps (meshes 1000), or where rounding leaves less than the
    tolerance (after a way of more than 1e9 times the size of the boxes or 1e5 turns), is undecided,
    with the time until which it is certainly apart.

    Parameters
    ----------
    a, b : MovingBoxes or Boxes, or PlacedMeshes
        Boxes stand still; meshes are where they are at time 0.
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    tolerance : float
        From 2e-6 to 1.
    contacts : bool
        Whether to compute positions and normals of boxes, too; else they have no rows.
    duration : float, optional
        Of meshes: seconds, positive.
    twists_a, twists_b : (n, 6) array_like, optional
        Of meshes: linear velocity x y z of the origin of each (m/s), angular velocity x y z
        (rad/s), in the common frame. One row, or a number, holds for all; by default they rest.
    radii_a, radii_b : float or (n,) array_like, optional
        Of meshes, metres; a body is everything within its radius of its mesh.

    Returns
    -------
    Sweeps
        hits and undecided (m,) bool; times and free_until (m,), from 0 to 1 or in seconds;
        positions (m, 3) metres; normals (m, 3) unit, from a to b, zero where meshes collide at the
        start.

    References
    ----------
    Ericson, Real-Time Collision Detection (2005), 5.5; Mirtich, Timewarp Rigid AnyBody Simulation
    (SIGGRAPH 2000).

    Examples
    --------
    >>> wall = oc.Boxes([[5, 0, 0]], [np.eye(3)], [[1, 9, 9]])
    >>> robot = oc.Boxes([[0, 0, 0]], [np.eye(3)], [[1, 1, 1]])
    >>> driving = oc.MovingBoxes.from_twists(robot, [[0.5, 0, 0, 0, 0, 0]], 10.0)
    >>> found = oc.sweeps(driving, wall)
    >>> found.times.round(9).tolist(), found.normals.tolist()
    ([6.0], [[1.0, 0.0, 0.0]])
    >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> poses = [[0, 0, 0, 0, 0, 0, 1], [0, 0, 2, 0, 0, 0, 1]]
    >>> bodies = oc.PlacedMeshes.from_poses(tree, [0, 0], poses)
    >>> twists = [[0, 0, 0.5, 0, 0, 0], [0, 0, 0, 0, 0, 1]]
    >>> oc.sweeps(bodies, bodies, [[0, 1]], duration=10, twists_a=twists).times.round(3).tolist()
    [4.0]
    """
    return _answer(
        SWEEP_TABLE, a, b, pairs, {"tolerance": tolerance},
        contacts=None if as_flag(contacts, "contacts") else False, duration=duration,
        twists_a=twists_a, twists_b=twists_b, radii_a=radii_a, radii_b=radii_b,
    )  # fmt: skip
