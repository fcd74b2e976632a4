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

"""Scene: objects that come, move and go, and the check for collisions between them."""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.kinds import as_flag, check_kind
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.geometry.validation import as_array, as_points, as_whole, warn_caller
from obb_collision.obb import OBB
from obb_collision.queries.rays.rays import RayHits
from obb_collision.scene.checker import Checker
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import Before, Cycle, Outcome, Setting
from obb_collision.scene.effects.settings import EffectSettings
from obb_collision.scene.findings import Findings
from obb_collision.scene.objects import SceneObjects, check_padding, local_box
from obb_collision.scene.questions import any_collides, body_in, colliding_with
from obb_collision.scene.ray_questions import cast_at_objects
from obb_collision.scene.refinement.budget import Budget
from obb_collision.scene.refinement.ladder import needs_spheres
from obb_collision.scene.refinement.mesh_pairs import prepare_shapes
from obb_collision.scene.refinement.placed_shapes import PlacedShapes
from obb_collision.scene.report import Report
from obb_collision.scene.store.allowed import AllowedPairs, Rule, Sides
from obb_collision.scene.store.patterns import as_patterns, matching
from obb_collision.scene.store.region import Region
from obb_collision.shapes import Shape
from obb_collision.words import shown

#: Depth of the trees on the level "obb_tree": eight boxes a mesh.
DEFAULT_DEPTH = 3
#: The largest limit on pairs: more than there can be, and its multiples are numbers for kernels.
MOST_PAIRS = 2**53
#: Pairs near each other that effects look at, for each that may collide: objects that are apart
#: have more neighbours than contacts.
NEAR_PER_PAIR = 10
#: Seconds for a check above which milliseconds were probably meant.
LONGEST_BUDGET = 1.0


class Scene(SceneObjects):
    """Named objects, and which of them collide.

    padding: metres by which every box is grown on each side.
    exact: decide by integer arithmetic what doubles can't tell from touching.
    accuracy: the level of ``Accuracy`` for objects without one of their own, or its name. A pair is
    decided on the lower level of its two objects, above "obb" only where that can say more than
    boxes do (see ``scene.ladder``).
    tree_depth: of the boxes of "obb_tree", 2^depth a mesh.
    time_budget: seconds for a check, None for no limit; see the property.
    max_pairs: pairs that a report has at most, None for no limit; see the property.
    Raises ValueError for a padding or depth below zero, a budget or limit that is not positive, and
    an unknown accuracy.

    Parameters
    ----------
    padding : float
        Metres, not negative.
    exact : bool
    accuracy : Accuracy or str
    tree_depth : int
    time_budget : float, optional
        Seconds.
    max_pairs : int, optional
    region : Region, optional
        Whose pairs are found; see the property.

    Raises
    ------
    ValueError
        Naming the argument.

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
        tree_depth: int = DEFAULT_DEPTH,
        time_budget: float | Budget | None = None,
        max_pairs: int | None = None,
        region: Region | None = None,
    ) -> None:
        self._allowed = AllowedPairs()
        self._effects = EffectSettings(EFFECTS.values())
        self._exact = as_flag(exact, "exact")
        self._tree_depth = as_whole(tree_depth, "tree_depth")
        self._obstacle_points: NDArray[Any] | None = None
        self._budget: Budget | None = None
        self.time_budget = time_budget
        self._max_pairs = _checked_limit(max_pairs)
        self._region: Region | None = None
        super().__init__(padding, accuracy)
        if region is not None:
            self.region = region

    def __repr__(self) -> str:
        return f"Scene({len(self)} objects, accuracy {self._accuracy.name.lower()!r})"

    def __setattr__(self, name: str, value: object) -> None:
        """Set a property; AttributeError, with a guess, for what a scene has not."""
        if not (name.startswith("_") or hasattr(type(self), name)):
            settable = [key for key in dir(type(self)) if is_settable(type(self), key)]
            close = get_close_matches(name, settable, 1)
            hint = f"; did you mean {close[0]}?" if close else f"; it has {', '.join(settable)}"
            raise AttributeError(f"Scene has no {shown(name)} to set{hint}")
        super().__setattr__(name, value)

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
    def tree_depth(self) -> int:
        """Depth of the boxes on the level "obb_tree": at most 2^depth of them a mesh."""
        return self._tree_depth

    @tree_depth.setter
    def tree_depth(self, value: int) -> None:
        self._tree_depth = as_whole(value, "tree_depth")
        high = self._store.accuracies >= Accuracy.OBB_TREE
        self._store.mark(np.flatnonzero(self._store.used & high))

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
        self._max_pairs = _checked_limit(value)
        self._checker.limit, self._checker.last = self._max_pairs, None
        self._forget_report()

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
        if value is None or value.is_everything:
            self._region = None
        else:
            check_halo(value.halo, self._effects.reach())
            self._region = value
        self._checker.set_region(self._region)
        self._forget_report()

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

    def prepare(self) -> None:
        """Build the trees and hulls of all shapes now; else the first checks that need them do."""
        prepare_shapes(self._store, self._cache)

    def allow(
        self, first: Iterable[str] | str, second: Iterable[str] | str, allowed: bool = True
    ) -> None:
        """Let objects touch: their pairs no longer count; with ``allowed=False`` they do again.

        first, second: names or patterns such as ``gripper/*``. Of several rules for a pair the last
        one counts. Raises ValueError for what is no pattern.

        Parameters
        ----------
        first : str or iterable of str
            Names or patterns.
        second : str or iterable of str
            Names or patterns.
        allowed : bool

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
        self._allowed.add(first, second, as_flag(allowed, "allowed"))
        self._store.mark(self._store.live())

    @property
    def allowed(self) -> list[Rule]:
        """The rules of ``allow``, in the order in which they count.

        May be set, to rules (first, second, allowed) in place of all before; [] forgets them.
        """
        return self._allowed.rules

    @allowed.setter
    def allowed(self, rules: Iterable[Rule]) -> None:
        before = self._allowed.rules
        self._allowed.replace(rules)
        if self._allowed.rules != before:
            self._store.mark(self._store.live())

    @property
    def check_only(self) -> list[Sides]:
        """The only pairs that count, (first, second) as in ``allow``; [], the default, for all.

        May be set. A pair that is allowed does not count here either.
        """
        return self._allowed.only

    @check_only.setter
    def check_only(self, pairs: Iterable[Sides]) -> None:
        self._allowed.only = pairs
        self._store.mark(self._store.live())

    @property
    def allowed_within(self) -> list[str]:
        """Namespaces, or patterns of them, within which objects may touch; [] for none.

        May be set. The namespace of ``robot/arm/1`` is ``robot/arm``; ``*`` means each one: objects
        of two namespaces count, those of one do not.
        """
        return self._allowed.within

    @allowed_within.setter
    def allowed_within(self, namespaces: Iterable[str] | str) -> None:
        self._allowed.within = namespaces
        self._store.mark(self._store.live())

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
        before = self._effects[name]
        self._effects.set(name, mode, objects, options)
        if self._region is not None:
            try:
                check_halo(self._region.halo, self._effects.reach())
            except ValueError:
                self._effects.set(name, before.mode, before.objects, before.values)
                raise
        self._forget_report()

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
        self._obstacle_points = None if value is None else as_points(value, "obstacle_points")
        self._forget_report()

    def check(self, effects: Iterable[str] | str = ()) -> Report:
        """Return all colliding pairs, with the effects asked for by name, or the one.

        Only what changed since the last check is computed anew. ValueError for an unknown effect.

        Parameters
        ----------
        effects : str or iterable of str

        Returns
        -------
        Report
            What collides; effects not asked for are computed when read.

        Raises
        ------
        ValueError
            Naming the argument.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> _ = scene.add("plate", oc.shapes.Sphere(0.1))
        >>> scene.check("contacts")
        Report(1 pairs, effects: contacts)
        """
        start = perf_counter()
        if self._budget is not None:
            self._budget.start()
        self._cache.take_built()
        self._checker.settle_region()
        wanted = self._effects.wanted(effects)
        lasting = not wanted or all(EFFECTS[name].lazy for name in wanted)
        last = self._last
        if self._store.touched or self._checker.behind or not lasting:
            last.report = last.found = None
        report = last.report() if last.report is not None else None
        if report is None:
            report = self._reported(start)
            last.report = weakref.ref(report)
        for name in wanted:
            if name not in report.costs:
                report.compute(name)
        if self._before is not None or not lasting:
            self._before = None if lasting else report.cycle.as_before()
        if self._budget is not None:
            self._budget.finish()
        return report

    def any_collision(self) -> bool:
        """Return whether anything collides; stops at the first pair.

        Returns
        -------
        bool
            Whether ``check`` without a time budget would report a pair.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("table", oc.shapes.Box([2, 1, 1]))
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.any_collision()
        True
        """
        last = self._checker.last
        if last is not None and not last.behind and not self._store.touched:
            return len(last.pairs) > 0
        if self._region is not None:
            return len(self.check()) > 0
        pair_filter = self._allowed.pair_filter(self._store.names, self._store.version)
        return any_collides(
            *(self._store, self._cache, pair_filter, self._tree_depth, self._exact)
        )[0]

    def query(
        self,
        shape: Shape | OBB,
        pose: ArrayLike | None = None,
        *,
        padding: float = 0.0,
        accuracy: Accuracy | str | None = None,
        ignore: Iterable[str] | str = (),
    ) -> list[str]:
        """Return the objects that a body would collide with, without adding it.

        The trees and hulls of the last bodies are retained: the same mesh costs one tree.

        Parameters
        ----------
        shape : Shape or OBB
            In its own frame.
        pose : (7,) array_like, optional
            x y z (metres) qx qy qz qw; the identity by default.
        padding : float
            Metres by which its box is grown.
        accuracy : Accuracy or str, optional
            Its level, by default that of the scene.
        ignore : str or iterable of str
            Names or patterns of objects that do not count.

        Returns
        -------
        list of str
            Names, in the order of ``indices``. Objects that are not enabled, or not near to the
            region, do not count.

        Raises
        ------
        ValueError
            Naming the argument.
        TypeError
            For another kind of shape.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("table", oc.shapes.Box([2, 1, 1]))
        >>> scene.query(oc.shapes.Sphere(0.25), [1.125, 0, 0, 0, 0, 0, 1])
        ['table']
        """
        check_kind(shape, Shape, "shape", OBB)
        where = IDENTITY_POSE if pose is None else as_array(pose, "pose", (7,))
        check_padding(padding)
        level = self._accuracy if accuracy is None else as_accuracy(accuracy)
        patterns = as_patterns(ignore, "ignore")
        self._checker.settle_region()
        body = body_in(self._store, self._cache, shape, local_box(shape), where, padding, level)
        with body as slot:
            found = colliding_with(self._store, self._cache, slot, self._tree_depth, self._exact)
            names = [str(self._store.names[row]) for row in found]
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
        """Return what each ray hits first: for lines of sight, and for simulated sensors.

        Parameters
        ----------
        origins : (m, 3) array_like
            Metres.
        directions : (m, 3) array_like
            Of any length but zero.
        max_distance : float or (m,) array_like
            Metres, infinity allowed.
        accuracy : Accuracy or str, optional
            Of all objects, by default that of each: below "hull" its box, else its hull or its
            triangles. Round shapes are exact, and so is padding; padded meshes are their hulls.
        objects : str or iterable of str
            Names and patterns of what rays can hit.

        Returns
        -------
        RayHits
            ``boxes`` are indices of objects, -1 for none.

        Raises
        ------
        ValueError
            Naming the argument and the row.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("wall", oc.shapes.Box([1, 5, 5]), [4, 0, 0, 0, 0, 0, 1])
        >>> found = scene.cast_rays([[0, 0, 0]], [[1, 0, 0]])
        >>> scene.name(found.boxes[0]), found.distances.tolist()
        ('wall', [3.5])
        """
        level = None if accuracy is None else as_accuracy(accuracy)
        store, patterns = self._store, as_patterns(objects, "objects")
        there = store.active if "*" in patterns else store.active & matching(patterns, store.names)
        return cast_at_objects(
            *(store, self._cache, np.flatnonzero(there), level),
            *(origins, directions, max_distance),
        )

    def _find(self) -> Findings:
        """Return what collides and nothing more: what a check costs without any effect."""
        return self._checker.find(self._tree_depth, self._exact, self._budget)

    def _reported(self, start: float) -> Report:
        """Return a report of what collides now: of what is known already where nothing changed."""
        store, last = self._store, self._last
        found = last.found
        if found is None:
            before = self._checker.last
            found = last.found = self._find()
            last.outcomes_before = {} if before is None else before.outcomes
        stages = {"pairs": perf_counter() - start}
        active = store.active.copy()
        cycle = Cycle(
            *(store.snapshot(), active, found.pairs, found.verdicts),
            *(self._checker.pair_filter, found.old, last.outcomes_before),
            *(self._obstacle_points, store, self._before),
            enabled=active if self._region is None else store.enabled.copy(),
            region=self._region,
            spheres=self._region is not None and needs_spheres(store),
            limit=None if self._max_pairs is None else NEAR_PER_PAIR * self._max_pairs,
            names=store.name_tuple(),
            shapes=self._placed_shapes(found),
        )
        settings = self._effects.resolved(store.names, store.version)
        return Report(found, store.name_tuple(), stages, cycle, settings)

    def _placed_shapes(self, found: Findings) -> PlacedShapes | None:
        """Return the shapes for effects above OBB; None where each speaks of boxes."""
        if self._checker.plain and not self._effects.above_obb:
            return None
        return PlacedShapes(
            *(self._store, self._cache, found.pairs, found.accuracies, found.cap),
            *(self._tree_depth, self._exact),
        )


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


def is_settable(kind: type, name: str) -> bool:
    """Return whether a name is a property of a class that can be set."""
    return getattr(getattr(kind, name), "fset", None) is not None
