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
from collections.abc import Iterable
from difflib import get_close_matches
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.geometry.validation import as_array, check_kind
from obb_collision.obb import OBB
from obb_collision.queries.rays.rays import RayHits
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import Cycle
from obb_collision.scene.findings import Findings
from obb_collision.scene.object_settings import check_padding
from obb_collision.scene.objects import local_boxes
from obb_collision.scene.questions import any_collides, body_in, colliding_with
from obb_collision.scene.ray_questions import cast_at_objects
from obb_collision.scene.refinement.ladder import needs_spheres
from obb_collision.scene.refinement.mesh_pairs import prepare_shapes
from obb_collision.scene.refinement.placed_shapes import PlacedShapes
from obb_collision.scene.report import Report
from obb_collision.scene.settings import SceneSettings
from obb_collision.scene.store.patterns import as_patterns, matching
from obb_collision.shapes import Shape
from obb_collision.words import shown

#: Pairs near each other that effects look at, for each that may collide: objects that are apart
#: have more neighbours than contacts.
NEAR_PER_PAIR = 10


class Scene(SceneSettings):
    """Named objects, and which of them collide.

    padding: metres by which every box is grown on each side.
    exact: decide by integer arithmetic what doubles can't tell from touching.
    accuracy: the level of ``Accuracy`` for objects without one of their own, or its name. A pair is
    decided on the lower level of its two objects, above "obb" only where that can say more than
    boxes do (see ``scene.refinement.ladder``).
    time_budget: seconds for a check, None for no limit; see the property.
    max_pairs: pairs that a report has at most, None for no limit; see the property.
    Raises ValueError for a padding below zero, a budget or limit that is not positive, and
    an unknown accuracy.

    Parameters
    ----------
    padding : float
        Metres, not negative.
    exact : bool
    accuracy : Accuracy or str
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

    def __repr__(self) -> str:
        return f"Scene({len(self)} objects, accuracy {self._accuracy.label!r})"

    def __setattr__(self, name: str, value: object) -> None:
        """Set a property; AttributeError, with a guess, for what a scene has not."""
        if not (name.startswith("_") or hasattr(type(self), name)):
            settable = [key for key in dir(type(self)) if is_settable(type(self), key)]
            close = get_close_matches(name, settable, 1)
            hint = f"; did you mean {close[0]}?" if close else f"; it has {', '.join(settable)}"
            raise AttributeError(f"Scene has no {shown(name)} to set{hint}")
        super().__setattr__(name, value)

    def prepare(self) -> None:
        """Build the trees and hulls of all shapes now; else the first checks that need them do."""
        prepare_shapes(self._store, self._cache)

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
        return any_collides(*(self._store, self._cache, pair_filter, self._exact))[0]

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
        body = body_in(self._store, self._cache, shape, local_boxes(shape), where, padding, level)
        with body as (store, cache, slot):
            found = colliding_with(store, cache, slot, self._exact)
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
        return self._checker.find(self._exact, self._budget)

    def _reported(self, start: float) -> Report:
        """Return a report of what collides now: of what is known already where nothing changed."""
        store, last = self._store, self._last
        found = last.found
        if found is None:
            before = self._checker.last
            found = last.found = self._find()
            last.outcomes_before = {} if before is None else before.outcomes
        stages = {"pairs": perf_counter() - start}
        settings = self._effects.resolved(store.names, store.version)
        report = Report(found, store.name_tuple(), stages, self._cycle, settings)
        if self._effects.any_possible:
            report.cycle  # noqa: B018, now: the scene may change before it is used
        return report

    def _cycle(self, found: Findings) -> Cycle:
        """Return the check that has just been made, as effects see it."""
        store, last = self._store, self._last
        if store.touched or found is not last.found:
            raise RuntimeError("the scene has changed since this check, whose effects are all off")
        active = store.active.copy()
        return Cycle(
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

    def _placed_shapes(self, found: Findings) -> PlacedShapes | None:
        """Return the shapes for effects above OBB; None where each speaks of boxes."""
        if self._checker.plain and not self._effects.above_obb:
            return None
        return PlacedShapes(
            *(self._store, self._cache, found.pairs, found.accuracies, found.cap),
            *(self._exact, found.total is None),
        )


def is_settable(kind: type, name: str) -> bool:
    """Return whether a name is a property of a class that can be set."""
    return getattr(getattr(kind, name), "fset", None) is not None
