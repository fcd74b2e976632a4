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

"""Scene: objects that move, and the check for collisions between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.geometry.validation import (
    as_array,
    as_flag,
    as_points,
    as_whole,
    check_kind,
    warn_caller,
)
from obb_collision.obb import OBB
from obb_collision.queries.rays.rays import RayHits
from obb_collision.scene.checks import Checks, any_collides, cast_at_objects, colliding_with
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.settings import EffectSettings
from obb_collision.scene.named_objects import NamedObjects
from obb_collision.scene.objects import as_padding
from obb_collision.scene.refinement.budget import Budget
from obb_collision.scene.report import Report
from obb_collision.scene.store.allowed import PairRules, Sides, guess
from obb_collision.scene.store.patterns import as_patterns, as_tuples, matching
from obb_collision.scene.store.region import Region
from obb_collision.scene.store.store import ObjectStore
from obb_collision.shapes import Shape
from obb_collision.words import check_names, shown

#: Attributes of the rules, and of a scene, that are pickled.
RULES = "allowed", "matrix", "check_only", "allowed_within", "warns"
PROPERTIES = ("time_budget", "max_pairs", "region", "watched")
#: The name of the points without a name, among those that are watched.
UNNAMED = "obstacle_points"
#: The largest limit of pairs: more than there can be, and kernels can take multiples of it.
MOST_PAIRS = 2**53
#: Seconds for a check above which the user probably means milliseconds.
LONGEST_BUDGET = 1.0


class Scene(NamedObjects):
    """Named objects, and which of them collide.

    A pair is decided on the lower level of its two objects; pairs of boxes are never above "obb"
    (see ``scene.refinement.ladder``). Methods raise KeyError for an unknown name or index.

    Parameters
    ----------
    padding : float
        Metres by which every box is grown on each side, not negative.
    exact : bool
        Decide by integer arithmetic what doubles can't tell from touching.
    accuracy : Accuracy or str
        The level of objects without a level of their own.
    time_budget : float, optional
        Seconds for a check, None for no limit; see the property.
    max_pairs : int, optional
        Pairs that a report has at most, None for no limit; see the property.
    region : Region, optional
        Region whose pairs are found; see the property.

    Examples
    --------
    >>> scene = oc.Scene()
    >>> _ = scene.add("table", oc.shapes.Box([2, 1, 1]))
    >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
    >>> scene.check().names()
    [('table', 'cup')]
    """

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
        super().__init__(padding, accuracy)
        self._begin(as_flag(exact, "exact"))
        self.time_budget, self.max_pairs, self.region = time_budget, max_pairs, region

    def _begin(self, exact: bool) -> None:
        self._rules = PairRules(lambda: self._objects.store.mark(self._objects.store.live()))
        self._checks = Checks(self._objects, self._rules, exact)

    def __getstate__(self) -> dict[str, Any]:
        """Return objects and settings; results are computed anew."""
        rules, checks = self._rules, self._checks
        return {
            "objects": self._objects,
            "exact": checks.exact,
            "rules": {name: getattr(rules, name) for name in RULES},
            "effects": checks.effects.settings,
            "properties": {name: getattr(self, name) for name in PROPERTIES},
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._objects = state["objects"]
        self._begin(state["exact"])
        for name, value in state["rules"].items():
            setattr(self._rules, name, value)
        self._checks.effects = EffectSettings(EFFECTS, state["effects"])
        for name, value in state["properties"].items():
            setattr(self, name, value)

    def __repr__(self) -> str:
        return f"Scene({len(self)} objects, accuracy {self._objects.accuracy.label!r})"

    def clear(self) -> None:
        """Remove all objects; settings are retained."""
        store = ObjectStore()
        checker = self._checks.make_checker(store)
        self._objects.clear(store)
        self._checks.begin(checker)

    @property
    def rules(self) -> PairRules:
        """The rules about pairs by name: which may touch, and which are checked at all."""
        return self._rules

    @property
    def effects(self) -> EffectSettings:
        """How each effect is set, by its name."""
        return self._checks.effects

    @property
    def max_pairs(self) -> int | None:
        """The limit of pairs in a report, None for no limit; can be set.

        n objects in one place collide in n (n - 1) / 2 pairs, which soon takes gigabytes. With a
        limit a check stops once it has more pairs. It keeps that many, which ones is undefined, and
        ``Report.truncated`` says so. Memory then grows with the limit and with n. Effects look at
        these pairs; effects with pairs of their own look at 10 times as many.
        """
        return self._checks.max_pairs

    @max_pairs.setter
    def max_pairs(self, value: int | None) -> None:
        limit = None if value is None else as_whole(value, "max_pairs", 1, MOST_PAIRS)
        self._checks.set_max_pairs(limit)

    @property
    def region(self) -> Region | None:
        """The region whose pairs are found, None for all pairs; can be set.

        Scenes with the same objects, and regions that together fill space, find each pair and each
        row of effects once. A pair belongs to the region of a point: on each axis the larger of the
        lower ends of both bounds. For pairs that are near or will collide, these are the bounds in
        which the effect searches; watched points belong to the lower corner of an object's bounds.
        Objects farther from the region than its halo take no part and cost little. The halo must be
        as large as the distances at which effects that are not off look from objects.
        """
        return self._checks.region

    @region.setter
    def region(self, value: Region | None) -> None:
        check_kind(value, Region, "region", type(None))
        if value is not None and value.is_everything:
            value = None
        if value is not None:
            check_halo(value.halo, self._checks.effects.reach())
        self._checks.set_region(value)

    @property
    def time_budget(self) -> float | None:
        """Seconds for a check with the requested effects, None for no limit; can be set.

        Pairs above "obb" are then decided nearest first until the time is up. The others stay on
        "obb", which misses no collision, as ``Report.behind`` and ``Report.accuracies`` say. Later
        checks go on with them. The same holds for rows of effects, see ``Report.accuracies_of``. A
        single pair, or the tree of a new shape, may exceed the time; see ``objects.prepare``. A
        ``Budget`` with a clock of its own can be set, too. More than a second makes a warning.
        """
        return None if self._checks.budget is None else self._checks.budget.seconds

    @time_budget.setter
    def time_budget(self, value: float | Budget | None) -> None:
        if value is None or isinstance(value, Budget):
            self._checks.budget = value
        elif self._checks.budget is None:
            self._checks.budget = Budget(value)
        else:
            self._checks.budget.seconds = value
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

        Of several rules for a pair the last one counts. Rules also apply to later objects and to
        links of robots, so an unknown name is no error, unless ``known`` says so.

        Parameters
        ----------
        first, second : str or iterable of str
            Names or patterns such as ``gripper/*``.
        allowed : bool
        known : bool
            Whether each name or pattern must match an object, as a guard against typing errors.

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
        self._rules.add(first, second, flag)

    def _check_known(self, side: Iterable[str] | str, argument: str) -> None:
        """Raise ValueError for a name or pattern that no object has."""
        for pattern in as_patterns(side, argument):
            if not matching([pattern], self.names).any():
                hint = guess(pattern, self.names)
                raise ValueError(f"{argument} must fit objects, got {shown(pattern)}{hint}")

    def check_only(self, sides: Iterable[Sides], *, known: bool = False) -> None:
        """Set the only pairs that count, as ``rules.check_only = sides``; [] for all pairs.

        They also apply to later objects and to links of robots, so an unknown name is no error,
        unless ``known`` says so. A check warns of it.

        Parameters
        ----------
        sides : iterable of (first, second)
            Names or patterns such as ``gripper/*``, one or several each.
        known : bool
            Whether each name or pattern must match an object.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> for name in ("cup", "plate", "table"):
        ...     _ = scene.add(name, oc.shapes.Sphere(0.1))
        >>> scene.check_only([("cup", "*")], known=True)
        >>> scene.check().names()
        [('cup', 'plate'), ('cup', 'table')]
        """
        pairs = as_tuples(sides, "sides", 2)
        if as_flag(known, "known"):
            for side in chain.from_iterable(pairs):
                self._check_known(side, "sides")
        self._rules.set_only(pairs, "sides")

    def set_effect(
        self,
        name: str,
        mode: str | None = None,
        objects: Iterable[str] | str | None = None,
        **options: float | str,
    ) -> None:
        """Set the mode, objects and options of an effect; None keeps the present value.

        Parameters
        ----------
        name : str
        mode : str, optional
            "off", "on" (at every check), or "auto" (on request, or when its result is read).
        objects : str or iterable of str, optional
            Names or patterns; the effect is computed for pairs with at least one such object.
        **options : float or str
            Options of the effect, such as ``max_distance``.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> scene.set_effect("clearance", "on", max_distance=0.5)
        >>> scene.effects["clearance"].mode
        'on'
        """
        new = self._checks.effects.changed(name, mode, objects, options)
        if self._checks.region is not None:
            check_halo(self._checks.region.halo, new.reach())
        self._checks.invalidate()
        self._checks.effects = new

    @property
    def watched(self) -> dict[str, NDArray[Any]]:
        """Points (k, 3) in metres by name, in no pair, for the effect ``points``; can be set.

        float32 or float64, not copied. Rows that are not finite are ignored and counted.
        """
        return dict(self._checks.watched)

    @watched.setter
    def watched(self, clouds: Mapping[str, ArrayLike]) -> None:
        check_kind(clouds, Mapping, "watched")
        check_names([*clouds], "watched")
        watched = {name: as_points(value, f"watched {name}") for name, value in clouds.items()}
        self._checks.invalidate()
        self._checks.watched = watched

    @property
    def obstacle_points(self) -> NDArray[Any] | None:
        """The points ``watched["obstacle_points"]``, None without; can be set."""
        return self._checks.watched.get(UNNAMED)

    @obstacle_points.setter
    def obstacle_points(self, value: ArrayLike | None) -> None:
        points = {} if value is None else {UNNAMED: as_points(value, UNNAMED)}
        rest = {name: row for name, row in self._checks.watched.items() if name != UNNAMED}
        self.watched = {**rest, **points}

    def check(self, effects: Iterable[str] | str = ()) -> Report:
        """Return all colliding pairs, with the effects requested by name.

        Only changes since the last check are computed anew. Other effects are computed when read.

        Parameters
        ----------
        effects : str or iterable of str

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> _ = scene.add("plate", oc.shapes.Sphere(0.1))
        >>> scene.check("contacts")
        Report(1 pairs, effects: contacts)
        """
        return self._checks.report(effects)

    def any_collision(self) -> bool:
        """Return whether ``check`` without a time budget reports a pair; stops at the first."""
        store, last = self._objects.store, self._checks.checker.last
        if last is not None and not last.behind and not store.touched:
            return len(last.decided.pairs) > 0
        if self._checks.region is not None:
            return len(self.check()) > 0
        pair_filter = self._rules.pair_filter(store.names, store.version)
        return any_collides(store, self._objects.cache, pair_filter, self._checks.exact)

    def query(
        self,
        shape: Shape | OBB,
        pose: ArrayLike | None = None,
        *,
        padding: float = 0.0,
        accuracy: Accuracy | str | None = None,
        ignore: Iterable[str] | str = (),
    ) -> list[str]:
        """Return the names of objects that a body would collide with, without adding it.

        In the order of ``indices``, without objects that are not enabled, or not near the region.
        Trees and hulls of the last bodies are retained: the same mesh costs one tree.

        Parameters
        ----------
        shape : Shape or OBB
            In its own frame.
        pose : (7,) array_like, optional
            x y z (metres) qx qy qz qw; the identity by default.
        padding : float
            Metres by which the body is grown on every side.
        accuracy : Accuracy or str, optional
            Accuracy level of the body, by default the scene's.
        ignore : str or iterable of str
            Names or patterns of objects that do not count.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("table", oc.shapes.Box([2, 1, 1]))
        >>> scene.query(oc.shapes.Sphere(0.25), [1.125, 0, 0, 0, 0, 0, 1])
        ['table']
        """
        check_kind(shape, Shape, "shape", OBB)
        where = IDENTITY_POSE if pose is None else as_array(pose, "pose", (7,))
        padding = as_padding(padding)
        level = self._objects.accuracy if accuracy is None else as_accuracy(accuracy)
        patterns = as_patterns(ignore, "ignore")
        self._checks.checker.settle_region()
        store, body = self._objects.store, (shape, where, padding, level)
        slots = colliding_with(store, self._objects.cache, *body, self._checks.exact)
        names = [str(store.names[slot]) for slot in slots]
        return [name for name, out in zip(names, matching(patterns, names), strict=True) if not out]

    def cast_rays(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        max_distance: ArrayLike = np.inf,
        *,
        accuracy: Accuracy | str | None = None,
        objects: Iterable[str] | str = "*",
    ) -> RayHits:
        """Return the first object on each ray: for lines of sight, and for simulated sensors.

        ``boxes`` of the result are indices of objects, -1 without one.

        Parameters
        ----------
        origins : (m, 3) array_like
            Metres.
        directions : (m, 3) array_like
            Of any length but zero.
        max_distance : float or (m,) array_like
            Metres, infinity allowed.
        accuracy : Accuracy or str, optional
            Level for all objects, by default each object's: below "hull" its box, else its hull or
            triangles. Round shapes are exact, and so is padding; padded meshes are their hulls.
        objects : str or iterable of str
            Names or patterns of the objects that rays can hit.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("wall", oc.shapes.Box([1, 5, 5]), [4, 0, 0, 0, 0, 0, 1])
        >>> hits = scene.cast_rays([[0, 0, 0]], [[1, 0, 0]])
        >>> scene.name(hits.boxes[0]), hits.distances.tolist()
        ('wall', [3.5])
        """
        level = None if accuracy is None else as_accuracy(accuracy)
        store, patterns = self._objects.store, as_patterns(objects, "objects")
        mask = store.active if "*" in patterns else store.active & matching(patterns, store.names)
        rows, cache = np.flatnonzero(mask), self._objects.cache
        return cast_at_objects(store, cache, rows, level, origins, directions, max_distance)


def check_halo(halo: float, reach: float) -> None:
    """Raise ValueError for a halo (m) that is smaller than the reach of effects beyond objects."""
    if halo < reach:
        raise ValueError(
            f"halo of the region must be at least {reach:g}, as far as effects look beyond "
            f"objects, got {halo:g}"
        )
