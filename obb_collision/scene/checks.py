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

"""Checks of a scene: what is kept from one to the next, and the settings they depend on."""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from time import perf_counter
from typing import Any

from numpy.typing import NDArray

from obb_collision.scene.checker import Checker, Findings
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import Before, Cycle
from obb_collision.scene.effects.settings import EffectSettings
from obb_collision.scene.objects import SceneObjects
from obb_collision.scene.refinement.budget import Budget
from obb_collision.scene.refinement.ladder import needs_spheres
from obb_collision.scene.refinement.placed_shapes import PlacedShapes
from obb_collision.scene.report import Report
from obb_collision.scene.store.allowed import PairRules
from obb_collision.scene.store.region import Region
from obb_collision.scene.store.store import ObjectStore

#: Pairs near each other that effects look at, for each that may collide: objects that are apart
#: have more neighbours than contacts.
NEAR_PER_PAIR = 10


class Checks:
    """Checks of objects by the rules about their pairs."""

    def __init__(self, objects: SceneObjects, rules: PairRules, exact: bool) -> None:
        self._objects, self._rules = objects, rules
        self.exact = exact
        self.effects = EffectSettings(EFFECTS)
        self.obstacle_points: NDArray[Any] | None = None
        self.budget: Budget | None = None
        self.max_pairs: int | None = None
        self.region: Region | None = None
        self.begin(self.make_checker(objects.store))

    def make_checker(self, store: ObjectStore) -> Checker:
        """Return a checker of a store, with the settings of now."""
        checker = Checker(store, self._objects.cache, self._rules)
        checker.limit = self.max_pairs
        checker.set_region(self.region)
        return checker

    def begin(self, checker: Checker) -> None:
        """Begin anew, with a checker of the store that the objects have now."""
        self.checker = checker
        self.invalidate()
        self._before: Before | None = None

    def invalidate(self) -> None:
        """Forget the last check: the next one makes another report, though nothing has moved."""
        self._report: weakref.ref[Report] | None = None
        self._found: Findings | None = None

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
        """Return all colliding pairs, with the effects asked for, as ``Scene.check`` does."""
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
            if self._found is None:
                self._found = self.checker.find(self.exact, self.budget)
            stages = {"pairs": perf_counter() - start}
            store = self._objects.store
            settings = self.effects.resolved(store.names, store.version)
            report = Report(self._found, store.name_tuple(), stages, self._cycle, settings)
            if self.effects.any_possible:
                report.cycle  # noqa: B018, now: the scene may change before it is used
            self._report = weakref.ref(report)
        for name in wanted:
            if name not in report.costs:
                report.compute(name, self.budget)
        if self._before is not None or not lasting:
            self._before = None if lasting else report.cycle.as_before()
        if self.budget is not None and not kept:
            self.budget.finish()
        return report

    def _cycle(self, found: Findings) -> Cycle:
        """Return the check that has just been made, as effects see it."""
        store = self._objects.store
        if store.touched or found is not self._found:
            raise RuntimeError("the scene has changed since this check, which computed no effects")
        active = store.active.copy()
        return Cycle(
            snapshot=store.snapshot(),
            active=active,
            pairs=found.decided.pairs,
            pair_filter=self.checker.pair_filter,
            old=found.old,
            last=found.before,
            obstacle_points=self.obstacle_points,
            store=store,
            before=self._before,
            enabled=active if self.region is None else store.enabled.copy(),
            region=self.region,
            spheres=self.region is not None and needs_spheres(store),
            limit=None if self.max_pairs is None else NEAR_PER_PAIR * self.max_pairs,
            names=store.name_tuple(),
            shapes=self._placed_shapes(found),
        )

    def _placed_shapes(self, found: Findings) -> PlacedShapes | None:
        """Return the shapes for effects above OBB; None where each speaks of boxes."""
        if self.checker.plain and not self.effects.above_obb:
            return None
        objects, (pairs, _, levels) = self._objects, found.decided
        given = objects.store, objects.cache, pairs, levels
        return PlacedShapes(*given, self.exact, found.total is None)
