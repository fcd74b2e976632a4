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

"""Pairs of bodies as meshes: whether they collide, how far they are apart, how deep they overlap.

As in ``scene.refinement.mesh_pairs``, this is for pairs with a mesh; hulls decide convex pairs. At
"mesh" a body is all that is within a radius, its padding, of its triangles; a sphere or capsule is
a segment with a radius. Bounds include the roundings of kinematics.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from obb_collision.queries.mesh_contacts.surfaces import within
from obb_collision.queries.meshes.mesh_mesh import clearances_of, mesh_verdicts
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.verdict.verdict import SEPARATE, Separations
from obb_collision.robots.checks.arrays import LINK_PLACING
from obb_collision.robots.checks.model import Prepared
from obb_collision.scene.building.shape_cache import BOXED, ROUND, TRIANGLES
from obb_collision.typing import Floats, Integers, Mask, Rows


class PairDistances(NamedTuple):
    """Bounds of the distances of pairs (m,), with closest points."""

    lower: Floats  #: (m,) at most minus the depth where bodies overlap, infinite beyond a limit
    upper: Floats  #: (m,) 0 where bodies overlap
    vectors: Floats  #: (m, 3, 3) the closest points of both, and the direction


class LinkMeshPairs(NamedTuple):
    """Pairs as meshes: row k of a against row k of b, each with a radius around it."""

    rows: Rows  #: (k,) the number of each pair
    a: PlacedMeshes
    radii_a: Floats
    b: PlacedMeshes
    radii_b: Floats
    slack: Floats  #: (k,) error of both places together, m


def mesh_collisions_of(prepared: Prepared, states: Floats, pairs: Integers) -> Mask:
    """Return (m,) whether pairs (m, 2) of colliding hulls collide as meshes.

    states (m, joints): the state of each pair.
    """
    result = np.ones(len(pairs), np.bool_)
    for placed in _placed_pairs(prepared, states, pairs):
        apart = np.ones(len(placed.rows), np.bool_)
        bare = np.flatnonzero((placed.radii_a == 0.0) & (placed.radii_b == 0.0))
        apart[bare] = mesh_verdicts(placed.a, placed.b, np.column_stack([bare, bare])) == SEPARATE
        rest = np.flatnonzero(apart)
        grown = placed.radii_a + placed.slack
        _, near = clearances_of(placed.a, grown, placed.b, placed.radii_b, rest, rest, 0.0)
        apart[rest] = ~near
        result[placed.rows] = ~apart
    return result


def set_mesh_distances(
    prepared: Prepared,
    states: Floats,
    pairs: Integers,
    distances: PairDistances,
    limit: float,
    depths: bool,
) -> None:
    """Replace the distances of pairs (m, 2) of hulls by those of meshes, for pairs with a mesh.

    depths: whether to find the depth of overlapping meshes; otherwise that of hulls remains.
    """
    for placed in _placed_pairs(prepared, states, pairs):
        k, slack = np.arange(len(placed.rows)), placed.slack
        sides = placed.a, placed.radii_a, placed.b, placed.radii_b
        near, is_near = clearances_of(*sides, k, k, limit)
        apart = is_near & (near.upper > slack)
        far, rows = placed.rows[~is_near], placed.rows[apart]
        lower = np.maximum(near.distances[apart] - slack[apart], distances.lower[rows])
        distances.upper[rows] = near.upper[apart] + slack[apart]
        distances.lower[rows] = np.minimum(np.maximum(lower, 0.0), distances.upper[rows])
        for side, values in enumerate((near.positions_a, near.positions_b, near.normals)):
            distances.vectors[rows, side] = values[apart]
        distances.lower[far] = distances.upper[far] = np.inf
        overlap = k[is_near & ~apart]
        rows = placed.rows[overlap]
        distances.upper[rows] = 0.0
        if depths and len(overlap):
            _set_depths(placed, overlap, distances)
        distances.lower[rows] = np.minimum(distances.lower[rows], 0.0)


def _set_depths(sides: LinkMeshPairs, k: Rows, distances: PairDistances) -> None:
    """Write the depths of the overlapping meshes in rows k, and their places."""
    rows = sides.rows[k]
    from_a, from_b, normals = distances.vectors[rows].transpose(1, 0, 2)
    lower, middles = np.minimum(distances.lower[rows], 0.0), 0.5 * (from_a + from_b)
    outer = Separations(np.column_stack([k, k]), lower, normals.copy(), middles)
    deep = within(outer, sides.a, sides.radii_a, sides.b, sides.radii_b)
    half = 0.5 * deep.separations[:, None] * deep.normals
    distances.lower[rows] = deep.separations - sides.slack[k]
    distances.vectors[rows] = np.stack(
        [deep.positions - half, deep.positions + half, deep.normals], 1
    )


def _placed_pairs(prepared: Prepared, states: Floats, pairs: Integers) -> Iterator[LinkMeshPairs]:
    """Yield as meshes those pairs of bodies (m, 2) that hulls do not decide.

    states (m, joints): the state of each pair.
    """
    if len(pairs) == 0:
        return
    own, world, checked = prepared.own.meshes, prepared.world, prepared.checked
    tree, bodies, tests, count = (
        checked.tree,
        checked.bodies,
        checked.tests,
        len(checked.bodies.frames),
    )
    numbers, pairs = pairs[:, 1], prepared.bodies_at(pairs)
    i, j = np.ascontiguousarray(pairs.T)
    outside, kinds = j >= tests.first, np.full(len(pairs), TRIANGLES)
    kinds[outside] = world.kinds[j[outside] - tests.first]
    segments, decided = kinds == ROUND, prepared.meshes[pairs].any(axis=1) & (kinds != BOXED)
    for part in (~outside, outside & ~segments, segments):
        rows = np.flatnonzero(part & decided)
        if len(rows) == 0:
            continue
        a = own.placed(tree, states[rows], i[rows])
        if outside[rows[0]]:
            b, radii = world.placed(j[rows] - tests.first, numbers[rows] - count)
        else:
            b, radii = own.placed(tree, states[rows], j[rows]), own.radii[j[rows]]
        slack = bodies.reaches[i[rows]] + bodies.reaches[j[rows]]
        slack += np.abs(a.centers).sum(axis=1) + np.abs(b.centers).sum(axis=1)
        yield LinkMeshPairs(rows, a, own.radii[i[rows]], b, radii, LINK_PLACING * slack)
