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

As in ``scene.refinement.mesh_pairs``: only pairs with a mesh; other pairs are convex, and decided
by their hulls. At "mesh" a body is everything within a radius of its triangles, its padding; a
sphere or capsule is a segment with one. The roundings of kinematics are allowed for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from obb_collision.queries.mesh_contacts.surfaces import within
from obb_collision.queries.meshes.mesh_clearance import clearances_of
from obb_collision.queries.meshes.meshes import mesh_verdicts
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.verdict.verdict import SEPARATE, Separations
from obb_collision.robots.checks.arrays import LINK_PLACING
from obb_collision.robots.checks.model import Prepared
from obb_collision.scene.building.shape_cache import BOXED, ROUND, TRIANGLES
from obb_collision.typing import Floats, Integers, Mask, Rows


class PairDistances(NamedTuple):
    """How far apart pairs (m,) are, with bounds: of the triangles if they have any."""

    lower: Floats  #: (m,) negative by at least the depth where they overlap, infinite past a limit
    upper: Floats  #: (m,) 0 where they overlap
    vectors: Floats  #: (m, 3, 3) the closest points of both, and the direction


class LinkMeshPairs(NamedTuple):
    """Some pairs as meshes: row k of a against row k of b, each with a radius about it."""

    rows: Rows  #: (k,) of the pairs
    a: PlacedMeshes
    radii_a: Floats
    b: PlacedMeshes
    radii_b: Floats
    slack: Floats  #: (k,) how far they may be from where they are, both together (metres)


def mesh_collisions_of(prepared: Prepared, states: Floats, pairs: Integers) -> Mask:
    """Return (m,) which pairs (m, 2) that may collide at "hull" do in the state (m, joints)."""
    result = np.ones(len(pairs), np.bool_)
    for each in _placed_pairs(prepared, states, pairs):
        apart = np.ones(len(each.rows), np.bool_)
        bare = np.flatnonzero((each.radii_a == 0.0) & (each.radii_b == 0.0))
        apart[bare] = mesh_verdicts(each.a, each.b, np.column_stack([bare, bare])) == SEPARATE
        rest = np.flatnonzero(apart)
        grown = each.radii_a + each.slack
        _, near = clearances_of(each.a, grown, each.b, each.radii_b, rest, rest, 0.0)
        apart[rest] = ~near
        result[each.rows] = ~apart
    return result


def set_mesh_distances(
    prepared: Prepared,
    states: Floats,
    pairs: Integers,
    found: PairDistances,
    limit: float,
    depths: bool,
) -> None:
    """Write the distances of pairs (m, 2) with a mesh, given those of their hulls.

    depths: whether to look for the depth of those that overlap; it is at least that otherwise.
    """
    for each in _placed_pairs(prepared, states, pairs):
        k = np.arange(len(each.rows))
        near, is_near = clearances_of(each.a, each.radii_a, each.b, each.radii_b, k, k, limit)
        apart = is_near & (near.upper > each.slack)
        some, rows = k[apart], each.rows[apart]
        lower = np.maximum(near.distances[some] - each.slack[some], found.lower[rows])
        found.upper[rows] = near.upper[some] + each.slack[some]
        found.lower[rows] = np.minimum(np.maximum(lower, 0.0), found.upper[rows])
        for side, values in enumerate((near.positions_a, near.positions_b, near.normals)):
            found.vectors[rows, side] = values[some]
        found.lower[each.rows[~is_near]] = found.upper[each.rows[~is_near]] = np.inf
        overlap = k[is_near & ~apart]
        found.upper[each.rows[overlap]] = 0.0
        if depths and len(overlap):
            _set_depths(each, overlap, found)
        found.lower[each.rows[overlap]] = np.minimum(found.lower[each.rows[overlap]], 0.0)


def _set_depths(sides: LinkMeshPairs, k: Rows, found: PairDistances) -> None:
    """Write the depths of meshes in rows k of sides that overlap, and where they are."""
    rows = sides.rows[k]
    from_a, from_b, normals = found.vectors[rows].transpose(1, 0, 2)
    lower, middles = np.minimum(found.lower[rows], 0.0), 0.5 * (from_a + from_b)
    outer = Separations(np.column_stack([k, k]), lower, normals.copy(), middles)
    deep = within(outer, sides.a, sides.radii_a, sides.b, sides.radii_b)
    half = 0.5 * deep.separations[:, None] * deep.normals
    found.lower[rows] = deep.separations - sides.slack[k]
    found.vectors[rows, 0], found.vectors[rows, 1] = deep.positions - half, deep.positions + half
    found.vectors[rows, 2] = deep.normals


def _placed_pairs(prepared: Prepared, states: Floats, pairs: Integers) -> Iterator[LinkMeshPairs]:
    """Yield those of pairs (m, 2) that meshes decide, in their states."""
    if len(pairs) == 0:
        return
    own, world, (tree, bodies, tests, *_) = prepared.own.meshes, prepared.world, prepared.checked
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
            b, radii = world.placed(j[rows] - tests.first)
        else:
            b, radii = own.placed(tree, states[rows], j[rows]), own.radii[j[rows]]
        slack = bodies.reaches[i[rows]] + bodies.reaches[j[rows]]
        slack += np.abs(a.centers).sum(axis=1) + np.abs(b.centers).sum(axis=1)
        yield LinkMeshPairs(rows, a, own.radii[i[rows]], b, radii, LINK_PLACING * slack)
