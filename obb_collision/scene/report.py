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

"""Report: the result of a check of a scene, and its costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.validation import check_kind
from obb_collision.geometry.values import SetOnce, read_only_view
from obb_collision.queries.clearance.clearance import Clearances
from obb_collision.queries.contacts.contacts import Contacts
from obb_collision.queries.points.points import PointsInside
from obb_collision.queries.verdict.verdict import Separations, Verdicts
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.checker import Findings
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import ACCURACY, Cycle, Setting
from obb_collision.scene.effects.settings import OFF
from obb_collision.scene.effects.sweep import SweptPairs
from obb_collision.scene.refinement.budget import Budget, Levels
from obb_collision.scene.refinement.placed_shapes import AS_PAIRS
from obb_collision.typing import Floats
from obb_collision.words import shown


@dataclass(frozen=True)
class Cost:
    """Cost of an effect: pairs (or points) it ran on, seconds, and failures."""

    count: int
    seconds: float
    failures: tuple[str, ...] = ()


class Report(SetOnce):
    """The m colliding pairs of a scene, as read-only arrays with one row a pair.

    Both TOUCHING and OVERLAP count as colliding. OVERLAP is certain; on levels other than OBB and
    MESH every verdict is TOUCHING. stages: seconds by stage of the check; costs: by effect, of
    those computed so far.

    Everything else is an effect: computed when first read, from the boxes as they were at the
    check, unless the scene has it "on" or the check requested it. ValueError for reading an
    effect that is "off", or one that must be requested at the check and was not.

    Examples
    --------
    >>> scene = oc.Scene()
    >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
    >>> _ = scene.add("plate", oc.shapes.Sphere(0.1))
    >>> report = scene.check()
    >>> report.names(), report.depths.round(9).tolist()
    ([('cup', 'plate')], [0.2])
    """

    slot_names: tuple[str | None, ...]
    stages: dict[str, float]
    costs: dict[str, Cost]
    _findings: Findings
    _make_cycle: Callable[[Findings], Cycle]
    _settings: Mapping[str, Setting]

    def __init__(
        self,
        findings: Findings,
        slot_names: tuple[str | None, ...],
        stages: dict[str, float],
        make_cycle: Callable[[Findings], Cycle],
        settings: Mapping[str, Setting],
    ) -> None:
        # no more than that: a step whose effects are off costs no more than its pairs
        vars(self).update(
            slot_names=slot_names, stages=stages, costs={}, _findings=findings,
            _make_cycle=make_cycle, _settings=settings,
        )  # fmt: skip

    @cached_property
    def pairs(self) -> Pairs:
        """(m, 2) int64 indices i < j of objects, in lexicographic order."""
        return read_only_view(self._findings.decided.pairs)

    @cached_property
    def verdicts(self) -> Verdicts:
        """(m,) int8 ``Verdict.TOUCHING`` or ``OVERLAP``."""
        return read_only_view(self._findings.decided.verdicts)

    @cached_property
    def accuracies(self) -> Levels:
        """(m,) int8 the ``Accuracy`` that each pair was decided on."""
        return read_only_view(self._findings.decided.levels)

    @property
    def behind(self) -> bool:
        """True if pairs or effects are below their level; the next check goes on with them.

        The time budget was used up, or a shape is being built.
        """
        return self._findings.behind or self._findings.late

    @property
    def truncated(self) -> bool:
        """True if there are more pairs than ``Scene.max_pairs``: any of them may be left out."""
        return self._findings.total is not None

    @property
    def total(self) -> int:
        """Number of pairs that collide; where ``truncated``, a lower bound."""
        return len(self) if self._findings.total is None else self._findings.total

    @cached_property
    def cycle(self) -> Cycle:
        """The check as effects see it."""
        return self._make_cycle(self._findings)

    def __len__(self) -> int:
        return len(self._findings.decided.pairs)

    def __repr__(self) -> str:
        more = f" of at least {self.total}" if self.truncated else ""
        effects = ", ".join(self._findings.outcomes) or "none"
        return f"Report({len(self)}{more} pairs, effects: {effects})"

    @property
    def results(self) -> dict[str, Any]:
        """Results of the effects computed so far, by name."""
        return {name: outcome.result for name, outcome in self._findings.outcomes.items()}

    def result(self, effect: str) -> Any:
        """Return the result of an effect, as its module describes it.

        Parameters
        ----------
        effect : str
            Name of the effect.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> _ = scene.add("plate", oc.shapes.Sphere(0.1))
        >>> scene.check().result("contacts").depths.round(9).tolist()
        [0.2]
        """
        check_kind(effect, str, "effect")
        if effect not in self.costs:
            if effect not in self._settings:
                raise ValueError(f"effect must be one of {', '.join(EFFECTS)}, got {shown(effect)}")
            if self._settings[effect].mode == OFF:
                raise ValueError(f"the effect {effect!r} is off in this scene")
            if not EFFECTS[effect].lazy:
                raise ValueError(f"ask for it: scene.check(effects=[{effect!r}])")
            self.compute(effect)
        if effect not in self._findings.outcomes:
            raise RuntimeError(f"the effect {effect!r} failed: {self.costs[effect].failures[0]}")
        return self._findings.outcomes[effect].result

    def accuracies_of(self, effect: str) -> Levels:
        """Return the ``Accuracy`` (k,) int8 of each row of the result of an effect.

        The rows of "sweep" are the rows of ``passed``, then of ``predicted``. Boxes are
        ``Accuracy.OBB``. A time budget lowers these like ``accuracies``.

        Parameters
        ----------
        effect : str
            Name of the effect.

        Examples
        --------
        >>> scene = oc.Scene(accuracy="hull")
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> _ = scene.add("plate", oc.shapes.Sphere(0.1), [0, 0, 0.25, 0, 0, 0, 1])
        >>> [oc.Accuracy(level).name for level in scene.check().accuracies_of("clearance")]
        ['HULL']
        """
        result = self.result(effect)
        levels = self._findings.outcomes[effect].accuracies
        if levels is None:
            parts = (result.passed, result.predicted) if effect == "sweep" else (result,)
            rows = sum(len(next(iter(vars(part).values()))) for part in parts)
            levels = np.full(rows, Accuracy.OBB, np.int8)
        return read_only_view(levels)

    def compute(self, effect: str, budget: Budget | None = None) -> None:
        """Compute an effect; note its cost and its failures.

        budget: of the check, None after it; an effect with its own accuracy does not use it.
        """
        start = perf_counter()
        earlier = self._findings.outcomes.get(effect)
        if earlier is not None:  # by a report of the same findings
            self.costs[effect] = Cost(0, 0.0, earlier.failures)
            return
        count = 0
        failures: tuple[str, ...] = ()
        shapes = self.cycle.shapes
        if shapes is not None:
            as_pairs = self._settings[effect].values.get(ACCURACY) == AS_PAIRS
            shapes.begin(budget if as_pairs else None, effect)
        try:
            with self.cycle.snapshot:
                outcome = EFFECTS[effect].run(self.cycle, self._settings[effect])
            if self.cycle.notes:
                outcome = replace(outcome, failures=(*outcome.failures, *self.cycle.notes))
            self._findings.outcomes[effect] = outcome
            count, failures = outcome.count, outcome.failures
        except Exception as error:  # of any kind: other effects and the cycle go on
            failures = (f"{type(error).__name__}: {error}",)
        self.cycle.notes.clear()
        if shapes is not None:
            self._findings.late |= shapes.is_late
            shapes.begin(None)
        self.costs[effect] = Cost(count, perf_counter() - start, failures)

    @property
    def separations(self) -> Floats:
        """(m,) signed distances of the pairs, metres: negative where objects overlap.

        These, normals, positions and depths are those of the boxes up to OBB, of convex shapes
        above; on levels below OBB, and of curved shapes, separations may be positive.
        """
        return self._column("separations")

    @property
    def normals(self) -> Floats:
        """(m, 3) unit vectors from i to j, along which the objects overlap least."""
        return self._column("normals")

    @property
    def positions(self) -> Floats:
        """(m, 3) metres: a place near both boxes at which to show the contact."""
        return self._column("positions")

    @property
    def depths(self) -> Floats:
        """(m,) metres: how deep each pair overlaps, 0 where only touching."""
        return np.maximum(-self.separations, 0.0)

    def _column(self, name: str) -> Floats:
        """Return a column of the effect ``separations``, NaN for pairs not selected for it."""
        table: Separations = self.result("separations")
        column: Floats = getattr(table, name)
        if len(column) == len(self):
            return column
        full = np.full((len(self), *column.shape[1:]), np.nan)
        full[self._findings.outcomes["separations"].rows] = column
        return full

    @property
    def contacts(self) -> Contacts:
        """The contact patches of the colliding pairs that are selected for the effect."""
        return self.result("contacts")

    @property
    def clearances(self) -> Clearances:
        """Distance and closest points of pairs nearer than the limit of the effect."""
        return self.result("clearance")

    @property
    def swept(self) -> SweptPairs:
        """Collisions between the check before and this one, and predicted ones."""
        return self.result("sweep")

    @property
    def points_inside(self) -> PointsInside:
        """How many points of each cloud, or of ``Scene.watched``, are inside which objects."""
        return self.result("points")

    @property
    def colliding(self) -> NDArray[np.bool_]:
        """(slots,) whether the object of each index is in one of ``pairs``.

        Where ``truncated``, the others may collide, too.
        """
        mask = np.zeros(len(self.slot_names), np.bool_)
        mask[self.pairs.ravel()] = True
        return mask

    def names(self) -> list[tuple[str, str]]:
        """Return the pairs by name, in the order of ``pairs``."""
        return [(str(self.slot_names[i]), str(self.slot_names[j])) for i, j in self.pairs.tolist()]
