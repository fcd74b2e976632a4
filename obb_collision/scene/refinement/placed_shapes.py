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

"""The shapes of one check, for effects above OBB: their places, trees and hulls.

An effect is computed on the level that decided its pair, or on its own ``accuracy``. It is computed
on boxes where that is OBB or below, for objects that are boxes, while a hull is being built
elsewhere, and where the time of a budget is up.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import Any, NamedTuple

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.convex.distances import ConvexDistances, convex_distances
from obb_collision.queries.convex.support import CURVED_CORES, HULL_CORE, ConvexBodies
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.verdict.verdict import Separations
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.building.shape_cache import BOX, BOXED, CLOUD, ROUND, TRIANGLES, ShapeCache
from obb_collision.scene.refinement.bodies import convex_bodies, placed_meshes
from obb_collision.scene.refinement.budget import Budget, Levels
from obb_collision.scene.refinement.clouds import CloudPairs, placed_points
from obb_collision.scene.refinement.ladder import decide_pairs, nearest_first, pair_levels
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Mask, Rows

#: Choices for the level of an effect; AS_PAIRS: the level that decided the pair.
AS_PAIRS = "pairs"
CHOICES = (AS_PAIRS, "obb", "hull", "mesh")


class BodyDistances(NamedTuple):
    """Bodies of pairs (m, 2): the rows (m,), (m,) of each pair, and their distances."""

    bodies: ConvexBodies
    first: Rows
    second: Rows
    distances: ConvexDistances


class PairSides(NamedTuple):
    """The bodies a and b of k pairs; those of a are meshes with radii."""

    rows: Rows  #: (k,) of the pairs
    turned: Mask  #: (k,) whether a is the second object of the pair; round objects are b
    ends: Pairs  #: (k, 2) slots of a and of b
    a: PlacedMeshes
    radii_a: Floats
    b: Any  #: PlacedMeshes, or ConvexBodies for cylinders, cones and ellipsoids
    radii_b: Any  #: (k,), None for ConvexBodies


class PlacedShapes:
    """The shapes of a scene at a check, except boxes.

    pairs (m, 2), sorted: the colliding pairs, decided on levels (m,); exact: as for
    ``decide_pairs``; complete: whether no pair is left out.
    """

    def __init__(
        self,
        store: ObjectStore,
        cache: ShapeCache,
        pairs: Pairs,
        levels: Levels,
        exact: bool = False,
        complete: bool = True,
    ) -> None:
        self._complete = complete
        self._store = store.with_shapes()
        self._store.poses = store.poses.copy()
        self._cache, self._version, self._shapes = cache, cache.version, cache.lend_shapes()
        self._pairs, self._decided = pairs, levels
        self._exact = exact
        self.kinds, self.paddings = store.kinds, store.paddings
        self._distances: tuple[Pairs, BodyDistances] | None = None  # of the last call
        self.depths: tuple[Pairs, Separations] | None = None
        """Depths on MESH computed by an effect, for other effects on the same pairs."""
        self.begin(None)

    def begin(self, budget: Budget | None, name: str = "") -> None:
        """Begin an effect, by its name; budget: limits its time."""
        self._name = name
        self._budget, self._late = budget, np.empty((0, 2), np.int64)
        self.is_late = False
        """Whether the effect has left rows below their level."""

    def portions(self, count: int) -> Iterator[slice]:
        """Yield ``count`` rows in portions while there is time; without a budget all at once."""
        done = 0
        portions = (
            [slice(0, count)] if self._budget is None else self._budget.portions(count, self._name)
        )
        for portion in portions:
            yield portion
            done = portion.stop
        self.is_late |= done < count

    def nearest_first(self, boxes: Boxes, pairs: Pairs, levels: Levels) -> Iterator[Rows]:
        """Yield the rows of pairs (m, 2) above OBB in portions; the rest stays on boxes."""
        rows, done = np.flatnonzero(levels > Accuracy.OBB), 0
        if self._budget is not None:
            rows = rows[nearest_first(boxes, pairs[rows])]
        for portion in self.portions(len(rows)):
            yield rows[portion]
            done = portion.stop
        self._late = np.concatenate([self._late, pairs[rows[done:]]])

    def reached(self, pairs: Pairs, levels: Levels) -> Levels:
        """Return levels (m,) of pairs (m, 2), lowered to OBB where there was no time."""
        if len(self._late) == 0:
            return levels
        late = np.isin(self._keys(pairs), self._keys(self._late))
        return np.where(late, np.int8(Accuracy.OBB), levels)

    def _keys(self, pairs: Pairs) -> Rows:
        return pairs[:, 0] * len(self.kinds) + pairs[:, 1]

    def _current_cache(self) -> ShapeCache:
        """Return the cache of the scene, or a copy once shapes have changed there."""
        if self._cache.version != self._version:
            self._cache = self._cache.with_shapes(self._shapes)
            self._version = self._cache.version
        return self._cache

    def levels(self, pairs: Pairs, choice: str, highest: Accuracy) -> Levels:
        """Return the level (m,) of an effect on pairs (m, 2): OBB, HULL or MESH.

        choice: from ``CHOICES``; highest: the effect's. Pairs without triangles get HULL at most.
        """
        first, second = np.array(pairs.T, order="C")  # effects' arrays are read-only
        levels = pair_levels(self._store, first, second, self._accuracies(choice))
        if choice == AS_PAIRS:
            collide, rows = self._rows(pairs)
            levels[collide] = self._decided[rows]
        np.minimum(levels, np.int8(highest), out=levels)
        whole = ~(self.kinds[pairs] == TRIANGLES).any(axis=1)
        levels[whole & (levels > Accuracy.HULL)] = Accuracy.HULL
        levels[levels < Accuracy.HULL] = Accuracy.OBB
        for level, have, lower in (
            (Accuracy.HULL, self._have_hulls, Accuracy.OBB),
            (Accuracy.MESH, self._have_trees, Accuracy.HULL),
        ):
            rows = np.flatnonzero(levels >= level)
            if len(rows):
                levels[rows[~have(pairs[rows])]] = lower
        return levels

    def _accuracies(self, choice: str) -> Levels:
        """Return the accuracies (slots,) of a choice."""
        accuracies = self._store.accuracies
        if choice == AS_PAIRS:
            return accuracies
        return np.full_like(accuracies, Accuracy[choice.upper()])

    def object_levels(self, slots: Rows, choice: str) -> Levels:
        """Return the level (k,) of the shape of each slot (k,): OBB, HULL or MESH.

        choice: of ``CHOICES``, AS_PAIRS for the accuracy of the object. Only meshes get MESH.
        """
        levels, kinds = self._accuracies(choice)[slots], self.kinds[slots]
        levels[(levels > Accuracy.HULL) & (kinds < TRIANGLES)] = Accuracy.HULL
        levels[(levels < Accuracy.HULL) | (kinds <= BOX)] = Accuracy.OBB
        for level, have, lower in (
            (Accuracy.MESH, self._have_trees, Accuracy.HULL),
            (Accuracy.HULL, self._have_hulls, Accuracy.OBB),
        ):
            rows = np.flatnonzero(levels == level)
            if len(rows):
                levels[rows[~have(slots[rows, None])]] = lower
        return levels

    def _have_trees(self, pairs: Pairs) -> Mask:
        """Build the trees that pairs (k, 2) need; return which (k,) have them."""
        slots = np.unique(pairs)
        have = self._have(slots[~np.isin(self.kinds[slots], (ROUND, CLOUD))], False)
        return np.asarray(have[pairs].all(axis=1))

    def _have_hulls(self, pairs: Pairs) -> Mask:
        """Build the hulls that pairs (k, 2) need; return which (k,) have them."""
        slots = np.unique(pairs)
        slots = slots[(self.kinds[slots] > BOX) & (self.kinds[slots] != CLOUD)]
        cornered = self._current_cache().cores(slots)[:, 0] == HULL_CORE
        have = self._have(slots[cornered], True) & (self.kinds != BOXED)
        return have[pairs].all(axis=1)

    def _have(self, slots: Rows, hull: bool) -> Mask:
        """Build trees or hulls of slots; return False (n,) for the slots that still lack one."""
        have = np.ones(len(self.kinds), np.bool_)
        have[slots] = self._current_cache().build(self._store, slots, hull, self._budget)
        self.is_late |= self._budget is not None and not bool(have.all())
        return have

    def curved(self, pairs: Pairs) -> Mask:
        """Return which slots of pairs (m, 2) are cylinders, cones or ellipsoids."""
        slots, ends = np.unique(pairs, return_inverse=True)
        mask, shaped = np.zeros(len(slots), np.bool_), self.kinds[slots] > BOX
        mask[shaped] = np.isin(self._current_cache().cores(slots[shaped])[:, 0], CURVED_CORES)
        return mask[ends].reshape(pairs.shape)

    def exact_sides(self, boxes: Boxes, pairs: Pairs) -> Iterator[PairSides]:
        """Yield the bodies of pairs (m, 2) of slots with a mesh on at least one side."""
        curved = self.curved(pairs)
        plain = np.flatnonzero(~curved.any(axis=1))
        for sides in self.mesh_sides(boxes, pairs[plain]):
            yield sides._replace(rows=plain[sides.rows])
        yield from self.curved_sides(boxes, pairs, curved)

    def curved_sides(self, boxes: Boxes, pairs: Pairs, curved: Mask) -> Iterator[PairSides]:
        """Yield the bodies of pairs (m, 2) with a curved side; curved: (m, 2)."""
        rows = np.flatnonzero(curved.any(axis=1))
        if len(rows):
            turned = curved[rows, 0]
            ends = np.where(turned[:, None], pairs[rows, ::-1], pairs[rows])
            bodies = self.convex_bodies(boxes, ends[:, 1])
            yield PairSides(rows, turned, ends, *self.meshes(boxes, ends[:, 0]), bodies, None)

    def mesh_sides(self, boxes: Boxes, pairs: Pairs) -> Iterator[PairSides]:
        """Yield the bodies of pairs (m, 2), with meshes around curved ones."""
        turned = self.kinds[pairs[:, 0]] == ROUND
        ends = np.where(turned[:, None], pairs[:, ::-1], pairs)
        is_round = self.kinds[ends[:, 1]] == ROUND
        for rows in (np.flatnonzero(is_round), np.flatnonzero(~is_round)):
            if len(rows):
                a, b = (self.meshes(boxes, slots) for slots in ends[rows].T)
                yield PairSides(rows, turned[rows], ends[rows], *a, *b)

    def cloud_pairs(self, boxes: Boxes, pairs: Pairs) -> CloudPairs:
        """Return pairs (m, 2) of a cloud and another object; boxes: of all slots, padded."""
        return CloudPairs(self._store, self._current_cache(), boxes, pairs)

    def points(self, slot: int) -> tuple[Floats, int, float]:
        """Return the points (n, 3) of a cloud, how many it ignores, and the radius of all (m)."""
        cloud, points, radius = placed_points(self._store, self._current_cache(), slot)
        return points, cloud.ignored, radius

    def meshes(self, boxes: Boxes, slots: Rows) -> tuple[PlacedMeshes, Floats]:
        """Return the placed trees of slots (k,), and radii (k,) with padding; see ``trees_of``."""
        return placed_meshes(self._store, self._current_cache(), boxes, slots)

    def parted(self, distances: Floats, pairs: Pairs, level: Accuracy) -> Floats:
        """Clip distances (m,) to the verdicts of pairs (m, 2).

        They become at most zero where pairs collide on a level or above, and positive where pairs
        are apart. Both are certified, but rounding could let them contradict each other.
        """
        collide, rows = self._rows(pairs)
        least = np.where(collide | (not self._complete), -np.inf, np.finfo(float).tiny)
        collide[collide] = self._decided[rows] >= level
        return np.where(collide, np.minimum(distances, 0.0), np.maximum(distances, least))

    def colliding_at(self, boxes: Boxes, poses: Floats, pairs: Pairs) -> Pairs:
        """Return the pairs, among (m, 2), that collided at an earlier time, on their own levels.

        boxes, poses: of slots at that time, when sizes were those of now. Only during the check.
        """
        earlier = copy(self._store)
        earlier.centers, earlier.rotations, earlier.half_extents = boxes.arrays
        earlier.poses = poses
        return decide_pairs(earlier, self._cache, pairs, self._exact)[0].pairs

    def _rows(self, pairs: Pairs) -> tuple[Mask, Rows]:
        """Return which pairs (m, 2) collide, and their rows in the pairs of the check."""
        keys, wanted = self._keys(self._pairs), self._keys(pairs)
        rows = np.searchsorted(keys, wanted)
        collide = rows < len(keys)
        collide[collide] = keys[rows[collide]] == wanted[collide]
        return collide, rows[collide]

    def bodies(self, boxes: Boxes, pairs: Pairs) -> tuple[ConvexBodies, Rows, Rows]:
        """Return the padded bodies of pairs (m, 2) of slots, and the rows (m,), (m,) of each pair.

        boxes: of all slots, padded.
        """
        slots, ends = np.unique(pairs, return_inverse=True)
        first, second = np.ascontiguousarray(ends.reshape(-1, 2).T)
        return self.convex_bodies(boxes, slots), first, second

    def distances(self, boxes: Boxes, pairs: Pairs) -> BodyDistances:
        """Return the distances of the bodies of pairs (m, 2) of slots, without a limit.

        Separations and contacts of the same pairs share them.
        """
        if self._distances is None or not np.array_equal(self._distances[0], pairs):
            bodies, first, second = self.bodies(boxes, pairs)
            distances, _ = convex_distances(bodies, bodies, first, second)
            self._distances = pairs, BodyDistances(bodies, first, second, distances)
        return self._distances[1]

    def convex_bodies(self, boxes: Boxes, slots: Rows) -> ConvexBodies:
        """Return the padded bodies of slots (k,), whose hulls must be built."""
        bodies = convex_bodies(self._store, self._current_cache(), boxes, slots)
        assert (bodies.rows[bodies.kinds == HULL_CORE] >= 0).all()
        return bodies
