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

"""Verdicts of pairs above OBB: the shapes of both objects on a level, and where they are.

Spheres and capsules among each other and with boxes are decided on exact shapes, other pairs of
convex shapes on exact shapes or hulls, whatever the level. With a mesh on either side the level
matters. On MESH spheres and capsules are segments with a radius, and cylinders, cones and
ellipsoids exact shapes. The hull of the mesh beside these is tried as well, so that rounding does
not let MESH report pairs that HULL separates.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.capsules import Capsules
from obb_collision.geometry.trees.pool import segment_trees
from obb_collision.queries.convex.distances import convex_may_collide, mesh_body_distances
from obb_collision.queries.convex.support import BOX_CORE, CURVED_CORES, HULL_CORE, ConvexBodies
from obb_collision.queries.meshes.hull_hull import PlacedHulls, hulls_may_collide
from obb_collision.queries.meshes.mesh_mesh import UNLIMITED, clearances_of, mesh_verdicts
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.primitives.capsules import capsule_pair_verdicts
from obb_collision.queries.verdict.verdict import OVERLAP, SEPARATE, TOUCHING, Verdicts
from obb_collision.scene.building.shape_cache import (
    BOX,
    BOXED,
    CLOUD,
    CONVEX,
    ROUND,
    TRIANGLES,
    ShapeCache,
)
from obb_collision.scene.refinement.bodies import PLACING, convex_bodies
from obb_collision.scene.refinement.budget import ABOVE, Budget
from obb_collision.scene.refinement.clouds import CloudPairs
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Mask, Rows

#: Pairs of nodes searched for an overlap once triangles touch: 0.3 ms face to face.
EFFORT = 256


def prepare_shapes(store: ObjectStore, cache: ShapeCache) -> None:
    """Build the trees and hulls that all objects may need, and compile the kernels for them."""
    wanted = np.flatnonzero(store.active & (store.accuracies > Accuracy.OBB))
    wanted = wanted[~np.isin(store.kinds[wanted], (BOXED, CLOUD))]
    if len(wanted) == 0:
        return
    for hull in (False, True):
        cache.build(store, wanted, hull, None)
    pair = MeshPairs(store, cache, wanted[-1:], wanted[-1:], False)
    row = np.zeros(1, np.int64)
    for level in ABOVE:
        if pair.prepare(level, row, None).all():
            pair.decide(level, row)


class MeshPairs:
    """Pairs (m,), (m,) of slots, neither both boxes nor BOXED; a ``refinement.Job``."""

    def __init__(
        self, store: ObjectStore, cache: ShapeCache, first: Rows, second: Rows, exact: bool
    ) -> None:
        self._store, self._cache = store, cache
        self._exact = exact
        named = _marked(len(store.names), first, second)
        self._slots = np.flatnonzero(named)
        numbers = np.cumsum(named) - 1
        self._ends = numbers[first], numbers[second]
        kinds = store.kinds[self._slots]
        a, b = kinds[self._ends[0]], kinds[self._ends[1]]
        self._simple = np.maximum(a, b) == ROUND
        self._cloudy = np.maximum(a, b) == CLOUD
        self._solid = (np.maximum(a, b) < TRIANGLES) & ~self._simple

    def prepare(self, level: Accuracy, rows: Rows, budget: Budget | None) -> Mask:
        """Build trees and hulls of pairs while there is time; return which (k,) are ready."""
        cloudy = self._cloudy[rows]
        if cloudy.any():
            ready = np.empty(len(rows), np.bool_)
            ready[~cloudy] = self.prepare(level, rows[~cloudy], budget)
            ready[cloudy] = self._prepare_others(level, rows[cloudy], budget)
            return ready
        ready = self._simple[rows]
        hulls = self._by_hull(level, rows)
        both = ~hulls & ~ready & (level == Accuracy.MESH) & self._curved(rows)
        ready[:] = True
        for hull, needy in ((True, hulls | both), (False, ~hulls & ~self._simple[rows])):
            if not needy.any():
                continue
            i, j = self._ends[0][rows[needy]], self._ends[1][rows[needy]]
            have = _marked(len(self._slots), i, j)
            bare = have & (self._store.kinds[self._slots] == ROUND) & (level == Accuracy.MESH)
            needed = np.flatnonzero(have & ~bare)  # segments take no time
            have[needed] = self._cache.build(self._store, self._slots[needed], hull, budget)
            ready[needy] &= have[i] & have[j]
        return ready

    def _prepare_others(self, level: Accuracy, rows: Rows, budget: Budget | None) -> Mask:
        """Build the hulls or trees of the other objects of pairs with a cloud; as ``prepare``."""
        others = self._cloud_pairs(rows).others
        needy = others[self._store.kinds[others] > ROUND]
        ready = np.ones(len(self._store.kinds), np.bool_)
        ready[needy] = self._cache.build(self._store, needy, level == Accuracy.HULL, budget)
        return ready[others]

    def _cloud_pairs(self, rows: Rows) -> CloudPairs:
        """Return pairs (k,) of a cloud and another object."""
        pairs = np.column_stack([self._slots[ends[rows]] for ends in self._ends])
        return CloudPairs(self._store, self._cache, self._store.all_boxes(), pairs)

    def decide(self, level: Accuracy, rows: Rows) -> Verdicts:
        """Return verdicts (k,) of prepared pairs; OVERLAP only on MESH, where it is certain."""
        cloudy = self._cloudy[rows]
        if cloudy.any():
            result = np.empty(len(rows), np.int8)
            result[~cloudy] = self.decide(level, rows[~cloudy])
            result[cloudy] = self._cloud_pairs(rows[cloudy]).shape_verdicts(level)
            return result
        simple, hulls = self._simple[rows], self._by_hull(level, rows)
        result = np.empty(len(rows), np.int8)
        result[simple] = self._round_verdicts(rows[simple])
        result[hulls] = self._hull_verdicts(rows[hulls])
        rest = ~(simple | hulls)
        result[rest] = self._tree_verdicts(rows[rest])
        if level != Accuracy.MESH:
            return np.minimum(result, np.int8(TOUCHING))
        met = np.flatnonzero(rest & (result != SEPARATE) & self._curved(rows))
        if len(met):
            result[met[~self._may_collide(rows[met])]] = SEPARATE
        return result

    def _curved(self, rows: Rows) -> Mask:
        """Return which pairs (k,) have a shape that its hull or tree exceeds."""
        kinds = self._placed.kinds
        curved = (kinds != HULL_CORE) & (kinds != BOX_CORE)
        return np.asarray(curved[self._ends[0][rows]] | curved[self._ends[1][rows]])

    def _may_collide(self, rows: Rows) -> Mask:
        """Return which pairs (k,) of padded convex shapes are not certainly apart."""
        i, j = self._ends[0][rows], self._ends[1][rows]
        return convex_may_collide(self._bodies, self._bodies, i, j)

    def _by_hull(self, level: Accuracy, rows: Rows) -> Mask:
        """Return which pairs (k,) a level decides on hulls."""
        return ~self._simple[rows] if level == Accuracy.HULL else self._solid[rows]

    def _hull_verdicts(self, rows: Rows) -> Verdicts:
        if len(rows) == 0:
            return np.empty(0, np.int8)
        i, j = self._ends[0][rows], self._ends[1][rows]
        padded = self._store.paddings[self._slots] > 0.0
        inexact = padded[i] | padded[j] | self._curved(rows)
        met = np.empty(len(rows), np.bool_)
        places = self._placed.centers, self._placed.rotations
        bodies = PlacedHulls(*self._cache.hulls(self._slots), *places)
        met[~inexact] = hulls_may_collide(bodies, bodies, i[~inexact], j[~inexact])
        if inexact.any():
            met[inexact] = self._may_collide(rows[inexact])
        return np.where(met, np.int8(TOUCHING), np.int8(SEPARATE))

    @property
    def _bodies(self) -> ConvexBodies:
        """All bodies, with the hulls built by now."""
        hulls, rows = self._cache.hulls(self._slots)
        return replace(self._placed, hulls=hulls, rows=rows)

    @cached_property
    def _placed(self) -> ConvexBodies:
        """All bodies, with the hulls built when this was first read."""
        return convex_bodies(self._store, self._cache, self._store.all_boxes(), self._slots)

    def _tree_verdicts(self, rows: Rows) -> Verdicts:
        if len(rows) == 0:
            return np.empty(0, np.int8)
        i, j = self._ends[0][rows], self._ends[1][rows]
        pairs = np.stack([i, j], axis=1)
        places = self._placed.centers, self._placed.rotations
        bodies = PlacedMeshes.trusted(*self._cache.trees(self._slots), *places)
        effort = UNLIMITED if self._exact else EFFORT
        kinds, radii = self._store.kinds[self._slots], self._store.paddings[self._slots]
        thin = (kinds == ROUND)[pairs].any(axis=1)
        curved = np.isin(self._placed.kinds, CURVED_CORES)[pairs]
        exact = curved.any(axis=1)
        bare = ~thin & ~exact & (radii[pairs] == 0.0).all(axis=1)
        padded = ~thin & ~exact & ~bare
        verdicts = np.empty(len(rows), np.int8)
        verdicts[bare] = mesh_verdicts(
            bodies, bodies, pairs[bare], exact=self._exact, effort=effort
        )
        if padded.any():
            verdicts[padded] = _verdicts_within(bodies, radii, bodies, radii, i[padded], j[padded])
        if thin.any():
            turned = kinds[i[thin]] == ROUND
            mesh, other = np.where(turned, pairs[thin, ::-1].T, pairs[thin].T)
            # spheres and capsules as segments, with their radii and padding
            placed, own = self._placed, self._round_slots
            trees, places = segment_trees(placed.sizes[own, 3]), (placed.centers, placed.rotations)
            segments = PlacedMeshes.trusted(*trees, *(column[own] for column in places))
            verdicts[thin] = _verdicts_within(
                bodies, radii, segments, placed.radii[own], mesh, self._capsule_rows[other]
            )
        if exact.any():
            turned = curved[exact, 0]
            mesh, other = np.where(turned, pairs[exact, ::-1].T, pairs[exact].T)
            _, near = mesh_body_distances(bodies, radii, self._bodies, mesh, other, 0.0)
            verdicts[exact] = np.where(near, np.int8(TOUCHING), np.int8(SEPARATE))
        outer = (kinds == CONVEX)[pairs].any(axis=1)  # their trees are larger than they are
        return np.where(outer, np.minimum(verdicts, np.int8(TOUCHING)), verdicts)

    def _round_verdicts(self, rows: Rows) -> Verdicts:
        """Return verdicts of spheres and capsules among themselves and against boxes."""
        if len(rows) == 0:
            return np.empty(0, np.int8)
        i, j = self._ends[0][rows], self._ends[1][rows]
        kinds = self._store.kinds[self._slots]
        swapped = kinds[i] == BOX
        i, j = np.where(swapped, j, i), np.where(swapped, i, j)
        boxed = kinds[j] == BOX
        first, second = self._capsule_rows[i], self._capsule_rows[j]

        def verdicts(capsules: Capsules) -> Verdicts:
            boxes = self._store.all_boxes()
            out = np.empty(len(rows), np.int8)
            out[boxed] = capsule_pair_verdicts(capsules, first[boxed], boxes, self._slots[j[boxed]])
            out[~boxed] = capsule_pair_verdicts(capsules, first[~boxed], capsules, second[~boxed])
            return out

        outer, inner = verdicts(self._capsules(1.0)), verdicts(self._capsules(-1.0))
        return np.where(inner == OVERLAP, inner, np.minimum(outer, np.int8(TOUCHING)))

    @cached_property
    def _round_slots(self) -> Rows:
        return np.flatnonzero(self._store.kinds[self._slots] == ROUND)

    @cached_property
    def _capsule_rows(self) -> Rows:
        """The row of each slot in the results of ``_capsules``."""
        rows = np.full(len(self._slots), -1)
        rows[self._round_slots] = np.arange(len(self._round_slots))
        return rows

    def _capsules(self, sign: float) -> Capsules:
        """Return padded spheres and capsules, larger or smaller (sign) by all errors."""
        bodies, rows = self._placed, self._round_slots
        centers, halves, radii = bodies.centers[rows], bodies.sizes[rows, 3], bodies.radii[rows]
        axes = bodies.rotations[rows, :, 2] * halves[:, None]
        errors = PLACING * (np.abs(centers).sum(axis=1) + halves + radii)
        radii = np.maximum(radii + sign * errors, 0.0)
        return Capsules.trusted(centers - axes, centers + axes, radii)


def _verdicts_within(
    a: PlacedMeshes, radii_a: Floats, b: PlacedMeshes, radii_b: Floats, i: Rows, j: Rows
) -> Verdicts:
    """Return verdicts (k,) of rows of two sets of meshes with radii about them."""
    clearances, near = clearances_of(a, radii_a, b, radii_b, i, j, 0.0)
    certain = np.where(clearances.upper == 0.0, np.int8(OVERLAP), np.int8(TOUCHING))
    return np.where(near, certain, np.int8(SEPARATE))


def _marked(count: int, first: Rows, second: Rows) -> Mask:
    """Return (count,) which numbers are in either array."""
    mask = np.zeros(count, np.bool_)
    mask[first] = mask[second] = True
    return mask
