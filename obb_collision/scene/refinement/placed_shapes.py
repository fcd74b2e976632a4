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

"""The shapes of one check, for effects above OBB: where they were, and what stands for them.

An effect is computed on the level that decided its pair, or on the one that its own ``accuracy``
says; on boxes where that is OBB or below, where nothing else stands for an object, until a hull is
built that is being built elsewhere, and where a budget's time is up.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import Any, NamedTuple

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.convex.distances import ConvexDistances, convex_distances
from obb_collision.queries.convex.support import CORNERS, CURVED, ConvexBodies
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.verdict.verdict import Separations
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.refinement.bodies import convex_bodies, places_of, trees_of
from obb_collision.scene.refinement.budget import Budget, Levels
from obb_collision.scene.refinement.ladder import decide_pairs, nearest_first, pair_levels
from obb_collision.scene.store.kinds import BOX, BOXED, ROUND, TRIANGLES
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Mask, Rows

#: The option of an effect that says on which level it is computed.
AS_PAIRS = "pairs"
CHOICES = (AS_PAIRS, "obb", "hull", "mesh")


class BodyDistances(NamedTuple):
    """Bodies of pairs (m, 2), their rows (m,), (m,) in them, and how far they are apart."""

    bodies: ConvexBodies
    first: Rows
    second: Rows
    found: ConvexDistances


class PairSides(NamedTuple):
    """Bodies of some pairs: row k of a, meshes with radii about them, and row k of b."""

    rows: Rows  #: (k,) of the pairs
    turned: Mask  #: (k,) whether a is the second of the pair; round ones are b
    ends: Pairs  #: (k, 2) slots of a and of b
    a: PlacedMeshes
    radii_a: Floats
    b: Any  #: PlacedMeshes, or ConvexBodies that are cylinders, cones or ellipsoids
    radii_b: Any  #: (k,), None for ConvexBodies


class PlacedShapes:
    """Shapes as they were at a check; slots of objects that are boxes are not among them.

    pairs (m, 2), sorted, decided on levels (m,); exact: as for ``decide_pairs``; complete: whether
    pairs are all that collide.
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
        self._distances: tuple[Pairs, BodyDistances] | None = None  # those computed last
        self.depths: tuple[Pairs, Separations] | None = None
        """Depths that an effect found on MESH, for others of the same pairs."""
        self.begin(None)

    def begin(self, budget: Budget | None, name: str = "") -> None:
        """Begin an effect, by its name, in the time that a budget has left."""
        self._name = name
        self._budget, self._late = budget, np.empty((0, 2), np.int64)
        self.is_late = False
        """Whether the effect has left something on a lower level than it asks for."""

    def portions(self, count: int) -> Iterator[slice]:
        """Yield ``count`` rows in portions while there is time, all at once without a budget."""
        done = 0
        portions = (
            [slice(0, count)] if self._budget is None else self._budget.portions(count, self._name)
        )
        for portion in portions:
            yield portion
            done = portion.stop
        self.is_late |= done < count

    def nearest_first(self, boxes: Boxes, pairs: Pairs, levels: Levels) -> Iterator[Rows]:
        """Yield the rows of pairs (m, 2) above OBB in portions; the rest is on boxes from now."""
        rows, done = np.flatnonzero(levels > Accuracy.OBB), 0
        if self._budget is not None:
            rows = rows[nearest_first(boxes, pairs[rows])]
        for portion in self.portions(len(rows)):
            yield rows[portion]
            done = portion.stop
        self._late = np.concatenate([self._late, pairs[rows[done:]]])

    def reached(self, pairs: Pairs, levels: Levels) -> Levels:
        """Return levels (m,) that pairs (m, 2) ask for, OBB for those there was no time for."""
        if len(self._late) == 0:
            return levels
        late = np.isin(self._keys(pairs), self._keys(self._late))
        return np.where(late, np.int8(Accuracy.OBB), levels)

    def _keys(self, pairs: Pairs) -> Rows:
        return pairs[:, 0] * len(self.kinds) + pairs[:, 1]

    def _current_cache(self) -> ShapeCache:
        """Return the cache of the scene, or one of its own once shapes have changed there."""
        if self._cache.version != self._version:
            self._cache = self._cache.with_shapes(self._shapes)
            self._version = self._cache.version
        return self._cache

    def levels(self, pairs: Pairs, choice: str, highest: Accuracy) -> Levels:
        """Return the level (m,) that an effect on pairs (m, 2) is computed on: OBB, HULL or MESH.

        choice: of ``CHOICES``; highest: that the effect has. Pairs without triangles get HULL.
        """
        first, second = np.array(pairs.T, order="C")  # effects' arrays are read-only
        levels = pair_levels(self._store, first, second, self._asked(choice))
        if choice == AS_PAIRS:
            known, rows = self._found(pairs)
            levels[known] = self._decided[rows]
        np.minimum(levels, np.int8(highest), out=levels)
        whole = self.kinds[pairs].max(axis=1) < TRIANGLES
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

    def _asked(self, choice: str) -> Levels:
        """Return (slots,) the accuracies of a choice."""
        accuracies = self._store.accuracies
        if choice == AS_PAIRS:
            return accuracies
        return np.full_like(accuracies, Accuracy[choice.upper()])

    def object_levels(self, slots: Rows, choice: str) -> Levels:
        """Return the level (k,) that stands for slots (k,) one by one: OBB, HULL or MESH.

        choice: of ``CHOICES``, AS_PAIRS for the accuracy of each. Only triangles get MESH.
        """
        levels, kinds = self._asked(choice)[slots], self.kinds[slots]
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
        """Build the trees that pairs (k, 2) need; return (k,) which have them."""
        slots = np.unique(pairs)
        have = self._have(slots[self.kinds[slots] != ROUND], False)
        return np.asarray(have[pairs].all(axis=1))

    def _have_hulls(self, pairs: Pairs) -> Mask:
        """Build the hulls that pairs (k, 2) need; return (k,) which have them."""
        slots = np.unique(pairs)
        slots = slots[self.kinds[slots] > BOX]
        cornered = self._current_cache().cores(slots)[:, 0] == CORNERS
        have = self._have(slots[cornered], True) & (self.kinds != BOXED)
        return have[pairs].all(axis=1)

    def _have(self, slots: Rows, hull: bool) -> Mask:
        """Build what slots lack; return (n,) of all slots which do not lack it then."""
        have = np.ones(len(self.kinds), np.bool_)
        have[slots] = self._current_cache().build(self._store, slots, hull, self._budget)
        self.is_late |= self._budget is not None and not bool(have.all())
        return have

    def curved(self, pairs: Pairs) -> Mask:
        """Return (m, 2) which slots of pairs are cylinders, cones or ellipsoids."""
        slots, ends = np.unique(pairs, return_inverse=True)
        mask, shaped = np.zeros(len(slots), np.bool_), self.kinds[slots] > BOX
        mask[shaped] = np.isin(self._current_cache().cores(slots[shaped])[:, 0], CURVED)
        return mask[ends].reshape(pairs.shape)

    def exact_sides(self, boxes: Boxes, pairs: Pairs) -> Iterator[PairSides]:
        """Yield the bodies of pairs (m, 2) of slots with a mesh on at least one side."""
        curved = self.curved(pairs)
        plain = np.flatnonzero(~curved.any(axis=1))
        for some in self.mesh_sides(boxes, pairs[plain]):
            yield some._replace(rows=plain[some.rows])
        yield from self.curved_sides(boxes, pairs, curved)

    def curved_sides(self, boxes: Boxes, pairs: Pairs, curved: Mask) -> Iterator[PairSides]:
        """Yield those of ``exact_sides`` with bodies that are curved (m, 2)."""
        rows = np.flatnonzero(curved.any(axis=1))
        if len(rows):
            turned = curved[rows, 0]
            ends = np.where(turned[:, None], pairs[rows, ::-1], pairs[rows])
            bodies = self.convex_bodies(boxes, ends[:, 1])
            yield PairSides(rows, turned, ends, *self.meshes(boxes, ends[:, 0]), bodies, None)

    def mesh_sides(self, boxes: Boxes, pairs: Pairs) -> Iterator[PairSides]:
        """Yield the same with meshes around what is curved."""
        turned = self.kinds[pairs[:, 0]] == ROUND
        ends = np.where(turned[:, None], pairs[:, ::-1], pairs)
        is_round = self.kinds[ends[:, 1]] == ROUND
        for rows in (np.flatnonzero(is_round), np.flatnonzero(~is_round)):
            if len(rows):
                a, b = (self.meshes(boxes, slots) for slots in ends[rows].T)
                yield PairSides(rows, turned[rows], ends[rows], *a, *b)

    def meshes(self, boxes: Boxes, slots: Rows) -> tuple[PlacedMeshes, Floats]:
        """Return the trees of slots (k,) where they are, and their radii (k,).

        The radii have the padding. Of spheres and capsules the trees are those of their segments;
        either all of them are round or none.
        """
        trees, rows, radii = trees_of(self._store, self._current_cache(), slots)
        return PlacedMeshes.trusted(trees, rows, *places_of(self._store, boxes, slots)), radii

    def parted(self, distances: Floats, pairs: Pairs, level: Accuracy) -> Floats:
        """Return distances (m,), at most zero for pairs (m, 2) that collide on a level or above.

        And more than zero for those apart. Both are certified, if not as closely: rounding must
        not make them contradict.
        """
        known, rows = self._found(pairs)
        least = np.where(known | (not self._complete), -np.inf, np.finfo(float).tiny)
        known[known] = self._decided[rows] >= level
        return np.where(known, np.minimum(distances, 0.0), np.maximum(distances, least))

    def colliding_at(self, boxes: Boxes, poses: Floats, pairs: Pairs) -> Pairs:
        """Return those of pairs (m, 2) of slots that collide at other places, on their own levels.

        boxes, poses: of slots at that time, when the objects had the sizes that they have now. Only
        during the check itself.
        """
        there = copy(self._store)
        there.centers, there.rotations, there.half_extents = boxes.arrays
        there.poses = poses
        return decide_pairs(there, self._cache, pairs, self._exact)[0].pairs

    def _found(self, pairs: Pairs) -> tuple[Mask, Rows]:
        """Return which pairs (m, 2) collide, and the rows of those in the pairs of the check."""
        keys, wanted = self._keys(self._pairs), self._keys(pairs)
        rows = np.searchsorted(keys, wanted)
        known = rows < len(keys)
        known[known] = keys[rows[known]] == wanted[known]
        return known, rows[known]

    def bodies(self, boxes: Boxes, pairs: Pairs) -> tuple[ConvexBodies, Rows, Rows]:
        """Return the bodies of pairs (m, 2) of slots, padded, and their rows (m,), (m,) in them.

        boxes: of all slots; objects that are boxes are where these are, with their padding.
        """
        slots, ends = np.unique(pairs, return_inverse=True)
        first, second = np.ascontiguousarray(ends.reshape(-1, 2).T)
        return self.convex_bodies(boxes, slots), first, second

    def distances(self, boxes: Boxes, pairs: Pairs) -> BodyDistances:
        """Return how far apart the bodies of pairs (m, 2) of slots are, without a limit.

        Boxes as in ``bodies``. Separations and contacts of the same pairs compute them once.
        """
        if self._distances is None or not np.array_equal(self._distances[0], pairs):
            bodies, first, second = self.bodies(boxes, pairs)
            found, _ = convex_distances(bodies, bodies, first, second)
            self._distances = pairs, BodyDistances(bodies, first, second, found)
        return self._distances[1]

    def convex_bodies(self, boxes: Boxes, slots: Rows) -> ConvexBodies:
        """Return the bodies of slots (k,), padded, all of which have hulls if they need one."""
        bodies = convex_bodies(self._store, self._current_cache(), boxes, slots)
        assert (bodies.rows[bodies.kinds == CORNERS] >= 0).all()
        return bodies
