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

"""What is set of a scene: its limits, rules about pairs, and effects."""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.validation import as_flag, as_points, as_whole, check_kind, warn_caller
from obb_collision.scene.checker import Checker
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import Before, Outcome, Setting
from obb_collision.scene.effects.settings import EffectSettings
from obb_collision.scene.findings import Findings
from obb_collision.scene.objects import SceneObjects
from obb_collision.scene.refinement.budget import Budget
from obb_collision.scene.report import Report
from obb_collision.scene.store.allowed import AllowedPairs, Rule, Sides
from obb_collision.scene.store.completed import completed
from obb_collision.scene.store.patterns import as_patterns, matching
from obb_collision.scene.store.region import Region
from obb_collision.words import shown

#: The largest limit on pairs: more than there can be, and its multiples are numbers for kernels.
MOST_PAIRS = 2**53
#: Seconds for a check above which milliseconds were probably meant.
LONGEST_BUDGET = 1.0


class SceneSettings(SceneObjects):
    """The objects of a scene and what is set of it."""

    def __init__(
        self,
        *,
        padding: float = 0.0,
        exact: bool = False,
        accuracy: Accuracy | str = "obb",
        time_budget: float | Budget | None = None,
        max_pairs: int | None = None,
        region: Region | None = None,
    ) -> None:
        self._allowed = AllowedPairs()
        self._effects = EffectSettings(EFFECTS.values())
        self._exact = as_flag(exact, "exact")
        self._obstacle_points: NDArray[Any] | None = None
        self._budget: Budget | None = None
        self.time_budget = time_budget
        self._max_pairs = _checked_limit(max_pairs)
        self._region: Region | None = None
        super().__init__(padding, accuracy)
        if region is not None:
            self.region = region

    @completed
    def clear(self) -> None:
        """Take all objects out; what is set stays."""
        super().clear()
        self._checker = Checker(self._store, self._cache, self._allowed)
        self._checker.limit = self._max_pairs
        self._checker.set_region(self._region)
        self._forget_report()
        self._before: Before | None = None

    def _forget_report(self) -> None:
        """Make the next check a new one, though nothing has moved."""
        self._last = LastCheck()

    @property
    def max_pairs(self) -> int | None:
        """The most pairs a report has, None for no limit; may be set.

        n objects in one place collide in n (n - 1) / 2 pairs, which soon takes gigabytes. With a
        limit time and memory grow with it and with n instead. Where more pairs collide, the first
        ones in the order of ``Report.pairs`` are kept; ``Report.truncated`` says so, ``total`` how
        many there are at least, and ``colliding`` is right for every object all the same. Effects
        look at the pairs kept, and those with pairs of their own at 10 times as many.
        """
        return self._max_pairs

    @max_pairs.setter
    def max_pairs(self, value: int | None) -> None:
        limit = _checked_limit(value)
        self._checker.last = None
        self._forget_report()
        self._max_pairs = self._checker.limit = limit

    @property
    def region(self) -> Region | None:
        """The region whose pairs are found, None for all; may be set.

        Several scenes with the same objects, and regions that hold all of space, find each pair
        once together, and all else that effects compute: a pair belongs to the region that has
        the larger, on each axis, of the lower ends of both bounds; one that is near or will
        collide, of the bounds in which the effect looks for others; the points of an object to
        that with the lower corner of its bounds. Objects farther from the region than its halo
        take no part and cost little. Raises ValueError for a halo smaller than what an effect
        that is not off looks beyond objects.
        """
        return self._region

    @region.setter
    def region(self, value: Region | None) -> None:
        check_kind(value, Region, "region", type(None))
        if value is not None and value.is_everything:
            value = None
        if value is not None:
            check_halo(value.halo, self._effects.reach())
        self._set_region(value)

    @completed
    def _set_region(self, value: Region | None) -> None:
        self._forget_report()
        self._checker.set_region(value)
        self._region = value

    @property
    def indices_near(self) -> NDArray[np.int64]:
        """(k,) the indices of the objects near to the region at the last check; all without one."""
        return np.flatnonzero(self._store.used & self._store.near)

    @property
    def time_budget(self) -> float | None:
        """Seconds for a check with the effects asked for, None for no limit; may be set.

        Above "obb" a check then uses the highest level that fits, and loses no collision by it;
        ``Report.accuracies`` says which one decided each pair. A pair left on a lower level that
        doesn't change is refined at later checks. Below "obb" there is nothing to gain.
        Building the tree of a new shape may take longer; see ``prepare``. A ``Budget`` may be set,
        too, which has a clock of its own. More than a second is warned about.
        """
        return None if self._budget is None else self._budget.seconds

    @time_budget.setter
    def time_budget(self, value: float | Budget | None) -> None:
        if value is None or isinstance(value, Budget):
            self._budget = value
        elif self._budget is None:
            self._budget = Budget(value)
        else:
            self._budget.seconds = value
        if isinstance(value, (int, float)) and value > LONGEST_BUDGET:
            warn_caller(
                f"time_budget is in seconds, got {value:g}: {value:g} ms are {value / 1e3:g}"
            )

    def allow(
        self,
        first: Iterable[str] | str,
        second: Iterable[str] | str,
        allowed: bool = True,
        *,
        known: bool = False,
    ) -> None:
        """Let objects touch: their pairs no longer count; with ``allowed=False`` they do again.

        first, second: names or patterns such as ``gripper/*``. Of several rules for a pair the last
        one counts. Rules are also for objects to come, and for links of robots, so a name that no
        object has is no error, unless ``known`` says so.

        Parameters
        ----------
        first : str or iterable of str
            Names or patterns.
        second : str or iterable of str
            Names or patterns.
        allowed : bool
        known : bool
            Whether each name or pattern must be that of an object that is there, against typing
            errors.

        Raises
        ------
        ValueError
            Naming the argument.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> _ = scene.add("plate", oc.shapes.Sphere(0.1))
        >>> scene.allow("cup", "*")
        >>> scene.check().names()
        []
        """
        flag = as_flag(allowed, "allowed")
        if as_flag(known, "known"):
            self._check_known(first, "first")
            self._check_known(second, "second")
        self._store.mark(self._store.live())  # first, for interrupts
        self._allowed.add(first, second, flag)

    def _check_known(self, side: Iterable[str] | str, argument: str) -> None:
        """Raise ValueError for a name or pattern that no object has."""
        for pattern in as_patterns(side, argument):
            if not matching([pattern], self.names).any():
                close = get_close_matches(pattern, self.names, 1)
                hint = f"; did you mean {close[0]}?" if close else ""
                raise ValueError(f"{argument} must fit objects, got {shown(pattern)}{hint}")

    @property
    def allowed(self) -> list[Rule]:
        """The rules of ``allow``, in the order in which they count.

        May be set, to rules (first, second, allowed) in place of all before; [] forgets them.
        """
        return self._allowed.rules

    @allowed.setter
    def allowed(self, rules: Iterable[Rule]) -> None:
        new = AllowedPairs.of(rules)
        if new.rules != self._allowed.rules:
            self._store.mark(self._store.live())
            self._allowed.replace(new)

    @property
    def check_only(self) -> list[Sides]:
        """The only pairs that count, (first, second) as in ``allow``; [], the default, for all.

        May be set. A pair that is allowed does not count here either.
        """
        return self._allowed.only

    @check_only.setter
    def check_only(self, pairs: Iterable[Sides]) -> None:
        self._store.mark(self._store.live())
        self._allowed.only = pairs

    @property
    def allowed_within(self) -> list[str]:
        """Namespaces, or patterns of them, within which objects may touch; [] for none.

        May be set. The namespace of ``robot/arm/1`` is ``robot/arm``; ``*`` means each one: objects
        of two namespaces count, those of one do not.
        """
        return self._allowed.within

    @allowed_within.setter
    def allowed_within(self, namespaces: Iterable[str] | str) -> None:
        self._store.mark(self._store.live())
        self._allowed.within = namespaces

    def set_effect(
        self,
        name: str,
        mode: str | None = None,
        objects: Iterable[str] | str | None = None,
        **options: float | str,
    ) -> None:
        """Set an effect; what is not given stays.

        mode: "off", "on" (at every check), or "auto" (when ``check`` is asked for it, or its result
        is read). objects: names or patterns; only pairs of which one object or both match get it.
        options: those of the effect. Raises ValueError naming what can't be used.

        Parameters
        ----------
        name : str
        mode : str, optional
        objects : str or iterable of str, optional
        **options : float or str

        Raises
        ------
        ValueError
            Naming the argument.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> scene.set_effect("clearance", "on", max_distance=0.5)
        >>> scene.effect_setting("clearance").mode
        'on'
        """
        new = self._effects.changed(name, mode, objects, options)
        if self._region is not None:
            check_halo(self._region.halo, new.reach())
        self._forget_report()
        self._effects = new

    def effect_setting(self, name: str) -> Setting:
        """Return how an effect is set. ValueError for an unknown one.

        Parameters
        ----------
        name : str

        Raises
        ------
        ValueError
            Naming the argument.

        Examples
        --------
        >>> oc.Scene().effect_setting("contacts").mode
        'auto'
        """
        return self._effects[name]

    @property
    def obstacle_points(self) -> NDArray[Any] | None:
        """Obstacle points (k, 3), float32 or float64, for the effect ``points``; None for none.

        The array is taken as it is, not copied. Rows that are not finite are ignored and counted.
        """
        return self._obstacle_points

    @obstacle_points.setter
    def obstacle_points(self, value: ArrayLike | None) -> None:
        points = None if value is None else as_points(value, "obstacle_points")
        self._forget_report()
        self._obstacle_points = points


class LastCheck:
    """What is kept of the last check: for as long as nothing changes, all that is needed."""

    def __init__(self) -> None:
        self.report: weakref.ref[Report] | None = None
        self.found: Findings | None = None
        self.outcomes_before: Mapping[str, Outcome] = {}


def _checked_limit(limit: int | None) -> int | None:
    return None if limit is None else as_whole(limit, "max_pairs", 1, MOST_PAIRS)


def check_halo(halo: float, reach: float) -> None:
    """Raise ValueError for a halo (m) of a region that is smaller than what effects look beyond."""
    if halo < reach:
        raise ValueError(
            f"halo of the region must be at least {reach:g}, as far as effects look beyond "
            f"objects, got {halo:g}"
        )
