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

"""Checks of a scene, with their settings and kept state, and questions that leave it as it is."""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.bounds_tree import BoundsTree
from obb_collision.obb import OBB
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.rays.boxes import Rays
from obb_collision.queries.rays.rays import (
    RayHits,
    as_rays,
    cast_at,
    cast_at_bodies,
    cast_at_padded,
)
from obb_collision.queries.verdict.coarse import bounds_of
from obb_collision.scene.broad_phase.broad_phase import (
    Pairs,
    find_candidates_of,
    growing_candidates,
)
from obb_collision.scene.broad_phase.find_pairs import colliding_pairs
from obb_collision.scene.building.shape_cache import CLOUD, TRIANGLES, ShapeCache, kind_of
from obb_collision.scene.checker import Checker, Findings
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import Cycle, PreviousCheck
from obb_collision.scene.effects.settings import EffectSettings
from obb_collision.scene.objects import SceneObjects, local_boxes
from obb_collision.scene.refinement.budget import Budget, Levels
from obb_collision.scene.refinement.clouds import placed_balls
from obb_collision.scene.refinement.ladder import NONE, decide_pairs, is_plain, needs_spheres
from obb_collision.scene.refinement.placed_shapes import AS_PAIRS, PlacedShapes
from obb_collision.scene.report import Report
from obb_collision.scene.store.allowed import PairFilter, PairRules
from obb_collision.scene.store.region import Region
from obb_collision.scene.store.store import ObjectStore
from obb_collision.shapes import Shape
from obb_collision.typing import Floats, Rows

#: Near pairs that effects look at, for each pair of ``max_pairs``: objects that are apart have more
#: neighbours than contacts.
NEAR_PER_PAIR = 10


class Checks:
    """Checks objects by the rules about their pairs."""

    def __init__(self, objects: SceneObjects, rules: PairRules, exact: bool) -> None:
        self._objects, self._rules = objects, rules
        self.exact = exact
        self.effects = EffectSettings(EFFECTS)
        self.watched: dict[str, NDArray[Any]] = {}
        self.budget: Budget | None = None
        self.max_pairs: int | None = None
        self.region: Region | None = None
        self.begin(self.make_checker(objects.store))

    def make_checker(self, store: ObjectStore) -> Checker:
        """Return a checker of a store, with the current settings."""
        checker = Checker(store, self._objects.cache, self._rules)
        checker.limit = self.max_pairs
        checker.set_region(self.region)
        return checker

    def begin(self, checker: Checker) -> None:
        """Start again, with a checker of the store that the objects have now."""
        self.checker = checker
        self.invalidate()
        self._before: PreviousCheck | None = None

    def invalidate(self) -> None:
        """Forget the last check: the next one makes another report, though nothing has moved."""
        self._report: weakref.ref[Report] | None = None
        self._findings: Findings | None = None

    def set_max_pairs(self, limit: int | None) -> None:
        """Set the most pairs that a report has."""
        self.checker.last = None
        self.invalidate()
        self.max_pairs = self.checker.limit = limit

    def set_region(self, region: Region | None) -> None:
        """Set the region whose pairs are found."""
        self.invalidate()
        self.checker.set_region(region)
        self.region = region

    def report(self, effects: Iterable[str] | str) -> Report:
        """Return all colliding pairs, with the requested effects, as ``Scene.check`` does."""
        start = perf_counter()
        if self.budget is not None:
            self.budget.start()
        self._objects.cache.take_built()
        self.checker.settle_region()
        wanted = self.effects.wanted(effects)
        lasting = not wanted or all(EFFECTS[name].lazy for name in wanted)
        if self._objects.store.touched or self.checker.behind or not lasting:
            self.invalidate()
        report = self._report() if self._report is not None else None
        kept = report is not None
        if report is None:
            if self._findings is None:
                self._findings = self.checker.find(self.exact, self.budget)
            stages = {"pairs": perf_counter() - start}
            store = self._objects.store
            settings = self.effects.resolved(store.names, store.version)
            report = Report(self._findings, store.name_tuple(), stages, self._cycle, settings)
            if self.effects.any_possible:
                report.cycle  # noqa: B018, made now: the scene may change before it is used
            self._report = weakref.ref(report)
        for name in wanted:
            if name not in report.costs:
                report.compute(name, self.budget)
        if self._before is not None or not lasting:
            self._before = None if lasting else report.cycle.as_before()
        if self.budget is not None and not kept:
            self.budget.finish()
        return report

    def _cycle(self, findings: Findings) -> Cycle:
        """Return the last check as effects see it."""
        objects, store = self._objects, self._objects.store
        if store.touched or findings is not self._findings:
            raise RuntimeError("the scene has changed since this check, which computed no effects")
        active, (pairs, _, levels) = store.active.copy(), findings.decided
        shapes = None  # where every effect speaks of boxes
        if not self.checker.plain or self.effects.above_obb:
            complete = findings.total is None
            shapes = PlacedShapes(store, objects.cache, pairs, levels, self.exact, complete)
        return Cycle(
            snapshot=store.snapshot(),
            active=active,
            pairs=pairs,
            pair_filter=self.checker.pair_filter,
            old=findings.old,
            last=findings.before,
            watched=self.watched,
            store=store,
            before=self._before,
            enabled=active if self.region is None else store.enabled.copy(),
            region=self.region,
            spheres=self.region is not None and needs_spheres(store),
            limit=None if self.max_pairs is None else NEAR_PER_PAIR * self.max_pairs,
            names=store.name_tuple(),
            shapes=shapes,
        )


def any_collides(
    store: ObjectStore, cache: ShapeCache, pair_filter: PairFilter | None, exact: bool
) -> bool:
    """Return whether any two objects collide."""
    active = np.flatnonzero(store.active)
    boxes = store.boxes(active)
    if len(active) < 2:
        return False
    tree = BoundsTree.build(*bounds_of(boxes, needs_spheres(store)))
    for candidates in growing_candidates(tree):
        pairs = active[candidates]
        if pair_filter is not None:
            pairs = pairs[pair_filter(*pairs.T)]
        if len(_colliding(store, cache, pairs, exact)):
            return True
    return False


def colliding_with(
    store: ObjectStore, cache: ShapeCache, shape: Shape | OBB, pose: Floats, padding: float,
    level: Accuracy, exact: bool,
) -> Rows:  # fmt: skip
    """Return the slots, ascending, of objects that a body at a pose (7,) would collide with."""
    larger, slot = store.with_body(local_boxes(shape), pose, padding, kind_of(shape), level)
    own = cache.at_once()
    own.put(own.shape_for(slot, shape))
    try:
        active = np.flatnonzero(larger.active)
        bounds = bounds_of(larger.boxes(active), needs_spheres(larger))
        candidates = find_candidates_of(*bounds, int(np.searchsorted(active, slot)))
        pairs = _colliding(larger, own, active[candidates], exact)
        return np.sort(pairs.sum(axis=1) - slot)
    finally:
        cache.retain(slot)
        cache.leave(slot)  # after an interrupt the next object in the slot does so


def _colliding(store: ObjectStore, cache: ShapeCache, candidates: Pairs, exact: bool) -> Pairs:
    """Return the candidates, pairs (m, 2) of slots, that collide."""
    if is_plain(store):
        return colliding_pairs(store.all_boxes(), candidates, exact)[0]
    return decide_pairs(store, cache, candidates, exact)[0].pairs


def cast_at_objects(
    store: ObjectStore, cache: ShapeCache, slots: Rows, level: Accuracy | None,
    origins: ArrayLike, directions: ArrayLike, max_distance: ArrayLike,
) -> RayHits:  # fmt: skip
    """Return the first objects on rays; ``boxes`` of the result are slots.

    level: accuracy level for all objects, None for each object's own.
    """
    rays = as_rays(origins, directions, max_distance)
    own = store.accuracies[slots] if level is None else np.full(len(slots), np.int8(level))
    balls = (store.kinds[slots] == CLOUD) & (own >= Accuracy.OBB)
    clouds, slots, own = slots[balls].tolist(), slots[~balls], own[~balls]
    best = _cast_at_shapes(store, cache, slots, level, own, rays)
    for slot in clouds:
        bodies, boxes = placed_balls(store, cache, slot)
        best = _nearer(best, cast_at_bodies(bodies, boxes, rays), np.full(len(boxes), slot))
    return best


def _cast_at_shapes(
    store: ObjectStore, cache: ShapeCache, slots: Rows, level: Accuracy | None, own: Levels,
    rays: Rays,
) -> RayHits:  # fmt: skip
    """Return the first objects on rays, as ``cast_at_objects``; own (n,): level of each slot."""
    levels = np.full(len(slots), Accuracy.OBB, np.int8)
    shapes = None
    if own.max(initial=0) > Accuracy.OBB:
        shapes = PlacedShapes(store, cache, NONE.pairs, NONE.levels)
        choice = AS_PAIRS if level is None else max(level, Accuracy.OBB).name.lower()
        levels = shapes.object_levels(slots, choice)
    plain = slots[levels == Accuracy.OBB]
    best = _nearer(None, cast_at(store.boxes(plain), rays), plain)
    if shapes is None:
        return best
    meshes, thick = store.kinds[slots] == TRIANGLES, store.paddings[slots] > 0.0
    for surface in (Accuracy.HULL, Accuracy.MESH):
        bare = slots[meshes & ~thick & (levels == surface)]
        if len(bare):
            best = _nearer(best, cast_at(_surfaces(store, cache, bare, surface), rays), bare)
    padded = slots[meshes & thick & (levels == Accuracy.MESH)]
    if len(padded):
        targets, radii = _surfaces(store, cache, padded, Accuracy.MESH), store.paddings[padded]
        best = _nearer(best, cast_at_padded(targets, radii, rays), padded)
    convex = slots[(~meshes | thick) & (levels == Accuracy.HULL)]
    if len(convex):
        bodies = shapes.convex_bodies(store.all_boxes(), convex)
        best = _nearer(best, cast_at_bodies(bodies, store.boxes(convex), rays), convex)
    return best


def _surfaces(store: ObjectStore, cache: ShapeCache, slots: Rows, level: Accuracy) -> PlacedMeshes:
    """Return the placed hulls or meshes of slots (k,)."""
    trees = cache.surfaces(slots, level == Accuracy.HULL)
    return PlacedMeshes.trusted(*trees, *as_poses(store.poses[slots], warn=False))


def _nearer(best: RayHits | None, hits: RayHits, slots: Rows) -> RayHits:
    """Return the nearer hits of both; ``boxes`` of hits are rows of slots."""
    rows = np.append(slots, -1)[hits.boxes]
    faces = np.full(len(rows), -1) if hits.faces is None else hits.faces
    named = RayHits(rows, hits.distances, hits.positions, hits.normals, faces)
    if best is None:
        return named
    nearer = (named.distances < best.distances) | (
        (named.distances == best.distances) & (named.boxes >= 0) & (named.boxes < best.boxes)
    )
    columns = [
        np.where(nearer if new.ndim == 1 else nearer[:, None], new, old)
        for new, old in zip(vars(named).values(), vars(best).values(), strict=True)
    ]
    return RayHits(*columns)
