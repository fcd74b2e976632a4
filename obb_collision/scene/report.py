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

"""Report: what one check of a scene found, and what it took."""

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
from obb_collision.geometry.values import SetOnce
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
    """Cost of one effect: pairs (or points) it ran on, seconds, and what failed."""

    count: int
    seconds: float
    failures: tuple[str, ...] = ()


class Report(SetOnce):
    """The colliding pairs of a scene, m of them, as arrays with one row a pair.

    The arrays are read-only. pairs (m, 2) int64: object indices i < j, in lexicographic order.
    verdicts (m,) int8: ``Verdict.TOUCHING`` or ``OVERLAP``; both count as colliding. OVERLAP is
    certain; on levels other than OBB and MESH, where nothing is, everything is TOUCHING.
    accuracies (m,) int8: the ``Accuracy`` that each pair was decided on.
    behind: whether some were decided, or effects computed, on a lower level than they ask for,
    as the scene's time budget was used up or a shape is being built; the next check goes on.
    truncated: whether there are more pairs than ``Scene.max_pairs``, and some, whichever, are left
    out. total: how many pairs collide; at least, where truncated.
    stages: seconds spent, by stage of the check; costs: by effect, those computed so far.

    Everything else is an effect: computed when first read, from the boxes as they were at the
    check, unless the scene has it "on" or the check was asked for it. Reading one that is "off", or
    one that can't be had later and was not asked for, is a ValueError.

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
    _found: Findings
    _make_cycle: Callable[[Findings], Cycle]
    _settings: Mapping[str, Setting]

    def __init__(
        self,
        found: Findings,
        slot_names: tuple[str | None, ...],
        stages: dict[str, float],
        make_cycle: Callable[[Findings], Cycle],
        settings: Mapping[str, Setting],
    ) -> None:
        # nothing but what is given: a step whose effects are off costs no more than its pairs
        vars(self).update(
            slot_names=slot_names, stages=stages, costs={}, _found=found, _make_cycle=make_cycle,
            _settings=settings,
        )  # fmt: skip

    @cached_property
    def pairs(self) -> Pairs:
        """(m, 2) indices i < j of objects; read-only, as the next check goes by them."""
        return _read_only(self._found.decided.pairs)

    @cached_property
    def verdicts(self) -> Verdicts:
        """(m,) TOUCHING or OVERLAP."""
        return _read_only(self._found.decided.verdicts)

    @cached_property
    def accuracies(self) -> Levels:
        """(m,) the ``Accuracy`` that each pair was decided on."""
        return _read_only(self._found.decided.levels)

    @property
    def behind(self) -> bool:
        """True if something is on a lower level than it asks for; the next check goes on."""
        return self._found.behind or self._found.late

    @property
    def truncated(self) -> bool:
        """True if pairs are left out."""
        return self._found.total is not None

    @property
    def total(self) -> int:
        """Number of pairs that collide; at least, where ``truncated``."""
        return len(self) if self._found.total is None else self._found.total

    @cached_property
    def cycle(self) -> Cycle:
        """The check as effects see it."""
        return self._make_cycle(self._found)

    def __len__(self) -> int:
        return len(self._found.decided.pairs)

    def __repr__(self) -> str:
        more = f" of at least {self.total}" if self.truncated else ""
        effects = ", ".join(self._found.outcomes) or "none"
        return f"Report({len(self)}{more} pairs, effects: {effects})"

    @property
    def results(self) -> dict[str, Any]:
        """Results of the effects computed so far, by name."""
        return {name: outcome.result for name, outcome in self._found.outcomes.items()}

    def result(self, effect: str) -> Any:
        """Return the result of an effect, as its module describes it.

        Parameters
        ----------
        effect : str
            Its name.

        Raises
        ------
        ValueError
            For an unknown effect, one that is off, and one that had to be asked for.

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
        if effect not in self._found.outcomes:
            raise RuntimeError(f"the effect {effect!r} failed: {self.costs[effect].failures[0]}")
        return self._found.outcomes[effect].result

    def accuracies_of(self, effect: str) -> Levels:
        """Return the ``Accuracy`` (k,) int8 that each row of the result of an effect is of.

        Of "sweep" the rows are those of ``passed``, then those of ``predicted``. Boxes are
        ``Accuracy.OBB``. A time budget lowers these like ``accuracies``.

        Parameters
        ----------
        effect : str
            Its name.

        Raises
        ------
        ValueError
            As ``result``.

        Examples
        --------
        >>> scene = oc.Scene(accuracy="hull")
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> _ = scene.add("plate", oc.shapes.Sphere(0.1), [0, 0, 0.25, 0, 0, 0, 1])
        >>> [oc.Accuracy(level).name for level in scene.check().accuracies_of("clearance")]
        ['HULL']
        """
        result = self.result(effect)
        levels = self._found.outcomes[effect].accuracies
        if levels is None:
            parts = (result.passed, result.predicted) if effect == "sweep" else (result,)
            levels = np.full(sum(map(_rows_of, parts)), Accuracy.OBB, np.int8)
        return _read_only(levels)

    def compute(self, effect: str, budget: Budget | None = None) -> None:
        """Compute an effect and note what it took, and why it failed if it did.

        budget: that of the check, while it lasts; not for an effect with an accuracy of its own.
        """
        start = perf_counter()
        known = self._found.outcomes.get(effect)
        if known is not None:  # by a report of the same findings
            self.costs[effect] = Cost(0, 0.0, known.failures)
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
            self._found.outcomes[effect] = outcome
            count, failures = outcome.count, outcome.failures
        except Exception as error:  # whatever it is, the others and the cycle go on
            failures = (f"{type(error).__name__}: {error}",)
        self.cycle.notes.clear()
        if shapes is not None:
            self._found.late |= shapes.is_late
            shapes.begin(None)
        self.costs[effect] = Cost(count, perf_counter() - start, failures)

    @property
    def separations(self) -> Floats:
        """(m,) metres, signed: negative where they overlap.

        These, normals, positions and depths are those of the boxes up to OBB, of convex shapes
        above; on levels below OBB, and of curved shapes, separations may be positive.
        """
        return self._column("separations")

    @property
    def normals(self) -> Floats:
        """(m, 3) unit vectors from i to j, along which they overlap least."""
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
        full[self._found.outcomes["separations"].rows] = column
        return full

    @property
    def contacts(self) -> Contacts:
        """The contact patches of the colliding pairs that are selected for them."""
        return self.result("contacts")

    @property
    def clearances(self) -> Clearances:
        """Distance and closest points of pairs nearer than the limit of the effect."""
        return self.result("clearance")

    @property
    def swept(self) -> SweptPairs:
        """What objects passed since the check before, what they will run into, what is unknown."""
        return self.result("sweep")

    @property
    def points_inside(self) -> PointsInside:
        """The ``Scene.obstacle_points`` inside of objects."""
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


def _rows_of(table: Any) -> int:
    """Return how many rows a dataclass of arrays has."""
    return len(next(iter(vars(table).values())))


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    view = array.view()
    view.setflags(write=False)
    return view
