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

"""The interface of effects: results computed beside the pairs, only on request.

An effect sees one check of a scene (``Cycle``) and its ``Setting``, and returns a result: arrays
with a row per pair or per object, of the type that the query returns. It does not depend on other
effects. An effect with a row per pair uses ``pair_rows``, which computes only changed pairs and
survives a pair that fails.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.trees.bounds_tree import BoundsTree
from obb_collision.geometry.validation import as_array
from obb_collision.queries.verdict.coarse import bounds_of
from obb_collision.scene.broad_phase.broad_phase import (
    NO_PAIRS,
    UNLIMITED,
    Pairs,
    find_some_candidates,
    find_some_candidates_of,
    ordered_candidates,
)
from obb_collision.scene.building.shape_cache import CLOUD
from obb_collision.scene.refinement.budget import Levels
from obb_collision.scene.refinement.clouds import CloudPairs, is_cloud_pair
from obb_collision.scene.refinement.placed_shapes import AS_PAIRS, CHOICES, PlacedShapes
from obb_collision.scene.store.allowed import PairFilter
from obb_collision.scene.store.region import Region, owns, owns_pairs
from obb_collision.scene.store.store import ObjectStore, Snapshot
from obb_collision.typing import Floats, Mask, Rows
from obb_collision.words import shown

R = TypeVar("R")
"""A dataclass of arrays with one row per pair."""
ByLevel: TypeAlias = "Mapping[Accuracy, Callable[[Boxes, PlacedShapes, Pairs, Setting], R]]"
"""Functions that compute rows of pairs (k, 2) on a level above OBB: as many rows, all columns."""
OfClouds: TypeAlias = "Callable[[CloudPairs, PlacedShapes, Levels, Setting], R]"
"""A function that computes rows of pairs (k, 2) with a cloud, on levels (k,): all columns."""
#: The level of boxes, as arrays of levels have it.
OBB = np.int8(Accuracy.OBB)

#: Failing pairs that are found one by one in a check: enough to see what they have in common.
MOST_FAILURES = 16


class Option(NamedTuple):
    """An option of an effect: a number with its unit and range, or a word of the choices."""

    default: float | str
    low: float
    high: float
    description: str
    choices: tuple[float, ...] | tuple[str, ...] = ()
    reaches: bool = False
    """True for a distance (m) from objects within which others matter."""

    def checked(self, name: str, value: Any) -> float | str:
        """Return a valid value; else ValueError, which names it."""
        if isinstance(self.default, str):
            if not (isinstance(value, str) and value in self.choices):
                choices = ", ".join(map(str, self.choices))
                raise ValueError(f"{name} must be one of {choices}, got {shown(value)}")
            return value
        number = float(as_array(value, name, ()))
        if self.choices and number not in self.choices:
            choices = " or ".join(f"{choice:g}" for choice in self.choices)
            raise ValueError(f"{name} must be {choices}, got {value!r}")
        if not self.low <= number <= self.high:
            raise ValueError(f"{name} must be from {self.low:g} to {self.high:g}, got {value!r}")
        return number


#: The option for the geometry on which an effect is computed, and its name.
ACCURACY = "accuracy"
ACCURACY_OPTION = Option(
    *(AS_PAIRS, 0.0, 0.0),
    "Geometry for this effect: obb, hull, mesh, or pairs (the geometry that decided the pair).",
    choices=CHOICES,
)


@dataclass(frozen=True)
class Setting:
    """Setting of an effect: its mode, the objects selected for it (patterns), its options."""

    mode: str = "auto"
    objects: tuple[str, ...] = ("*",)
    values: Mapping[str, Any] = field(default_factory=dict)
    selected: Mask | None = None
    """(slots,) which objects are selected for the effect, None for all."""

    def reach(self, options: Mapping[str, Option]) -> float:
        """Return the distance (m) within which other objects matter to the effect."""
        far = [self.values[key] for key, option in options.items() if option.reaches]
        return max(far, default=0.0) if self.mode != "off" else 0.0

    def select(self, pairs: Pairs) -> Rows:
        """Return the indices of pairs (m, 2) with at least one object selected for the effect."""
        if self.selected is None:
            return np.arange(len(pairs))
        return np.flatnonzero(self.selected[pairs].any(axis=1))


class PreviousCheck(NamedTuple):
    """Where the objects were at the check before, by slot."""

    snapshot: Snapshot
    enabled: Mask
    born: Rows
    pairs: Pairs
    """Pairs that collided; in a region, those that it owned."""
    poses: Floats | None
    """Poses of the objects; None unless a region has effects above OBB."""

    @property
    def boxes(self) -> Boxes:
        """The boxes of all slots."""
        return self.snapshot.boxes


@dataclass(eq=False)
class Cycle:
    """One check of a scene as effects see it; the arrays do not change.

    snapshot: the boxes of all slots; active (slots,): which take part; pairs (m, 2): which collide;
    pair_filter: which pairs of slots (k,), (k,) count, None for all; old (m,): the row of each pair
    in the check before, -1 if it is to be computed anew, None if all are; last: outcomes of the
    check before, by effect.

    Only for effects that are not lazy: store, whose poses and twists may change after the check,
    and before, None unless one was computed at the check before.
    """

    snapshot: Snapshot
    active: Mask
    pairs: Pairs
    pair_filter: PairFilter | None
    old: Rows | None
    last: Mapping[str, Outcome]
    watched: Mapping[str, NDArray[Any]]
    store: ObjectStore
    before: PreviousCheck | None
    enabled: Mask
    """(slots,) which objects take part in this region or elsewhere; ``active`` without a region."""
    region: Region | None = None
    """The region whose pairs and objects count; None for all."""
    spheres: bool = False
    """True if bounds hold spheres, too, wherever their overlap matters."""
    limit: int | None = None
    """Limit of pairs for an effect with pairs of its own, None for all."""
    notes: list[str] = field(default_factory=list)
    """Reasons why an effect is incomplete; they join its failures."""
    names: Sequence[str | None] = ()
    """Names of the objects, by slot."""
    shapes: PlacedShapes | None = None
    """Shapes that stand for objects above OBB; None where every effect speaks of boxes."""

    def levels(self, pairs: Pairs, setting: Setting, highest: Accuracy) -> Levels | None:
        """Return the accuracy level (m,) on which an effect computes each of the pairs (m, 2).

        None if all levels are OBB. highest: the effect's highest level. Pairs that the budget had
        no time for have the level OBB.
        """
        if self.shapes is None or len(pairs) == 0 or highest <= Accuracy.OBB:
            return None
        levels = self.shapes.levels(pairs, setting.values[ACCURACY], highest)
        levels = self.shapes.reached(pairs, levels)
        return levels if (levels > Accuracy.OBB).any() else None

    def name(self, slot: int) -> str:
        """Return the name of an object."""
        return str(self.names[slot] if slot < len(self.names) else slot)

    @property
    def boxes(self) -> Boxes:
        """The boxes of all slots."""
        return self.snapshot.boxes

    def counted(self, slots: Rows, minimum: Floats, rows: Pairs) -> Pairs:
        """Return the pairs of slots that count, from rows (k, 2) of slots (n,).

        These may not touch, and belong to the region. A pair whose boxes are apart belongs by the
        bounds in which the effect looks for pairs; ``minimum`` (n, 3) are their lower corners.
        """
        pairs = slots[rows]
        counts = np.ones(len(pairs), np.bool_)
        if self.shapes is not None:
            counts &= ~(self.shapes.kinds[pairs] == CLOUD).all(axis=1)
        if self.region is not None and len(pairs):
            low, high = self.bounds(slots)
            a, b = rows.T
            meet = ((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)
            counts = np.where(
                meet, owns_pairs(self.region, low, rows), owns_pairs(self.region, minimum, rows)
            )
        if self.pair_filter is not None:
            counts &= self.pair_filter(pairs[:, 0], pairs[:, 1])
        return pairs if counts.all() else pairs[counts]

    def owned(self, pairs: Pairs) -> Mask:
        """Return which pairs (m, 2) of slots belong to the region where they collide."""
        if self.region is None:
            return np.ones(len(pairs), np.bool_)
        low = [self.bounds(column)[0] for column in pairs.T]
        return owns(self.region, np.maximum(*low))

    def own(self, slots: Rows) -> Rows:
        """Return the slots, among (n,), whose objects belong to the region."""
        if self.region is None:
            return slots
        return slots[owns(self.region, self.bounds(slots)[0])]

    def bounds(self, slots: Rows) -> tuple[Floats, Floats]:
        """Return the bounds (n, 3), (n, 3) of slots by which pairs belong to a region."""
        return bounds_of(self.boxes[slots], self.spheres)

    def as_before(self) -> PreviousCheck:
        """Return the state with which the next check compares."""
        needed = self.region is not None and self.shapes is not None
        poses = self.store.poses.copy() if needed else None
        return PreviousCheck(self.snapshot, self.enabled, self.store.born.copy(), self.pairs, poses)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of an effect: its result, how many pairs (or points) it ran on, and its failures.

    rows (k,): the row in ``Report.pairs`` of each row of the result, None for an effect with pairs
    of its own; values: its options.
    """

    result: Any
    count: int
    failures: tuple[str, ...] = ()
    rows: Rows | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    accuracies: Levels | None = None
    """(k,) the level of each row; None: all on OBB or below."""

    def __post_init__(self) -> None:
        freeze(self.result)  # the next check copies unchanged rows


def freeze(table: Any) -> None:
    """Make the arrays of a dataclass read-only, also those of dataclasses in it."""
    for value in getattr(table, "__dict__", {}).values():
        if isinstance(value, np.ndarray) and value.size:  # empty arrays may be shared
            value.setflags(write=False)
        elif is_dataclass(value):
            freeze(value)


class Effect(Protocol):
    """An effect; it has no state, so all scenes share it."""

    name: str
    description: str
    """What the effect computes, as the beginning of a sentence."""
    options: Mapping[str, Option]
    lazy: bool = True
    """True if it can be computed after the check, when the scene may have changed."""

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Compute the effect for one check."""


def take_rows(table: R, rows: Rows | Mask) -> R:
    """Return rows of a dataclass of arrays."""
    return type(table)(*(column[rows] for column in vars(table).values()))


def join_rows(tables: Sequence[R]) -> R:
    """Join the rows of dataclasses of arrays, all of one type."""
    columns = zip(*(vars(table).values() for table in tables), strict=True)
    return type(tables[0])(*map(np.concatenate, columns))


def write_rows(table: R, rows: Rows, new: R) -> None:
    """Overwrite rows of a dataclass of arrays with the rows of ``new``."""
    for key, column in vars(table).items():
        column[rows] = vars(new)[key]


def refined(
    table: R,
    cycle: Cycle,
    setting: Setting,
    by_level: ByLevel[R] | None,
    of_clouds: OfClouds[R] | None,
) -> R:
    """Compute rows of a table of boxes anew, above OBB and of clouds; return the table."""
    shapes = cycle.shapes
    if shapes is None or by_level is None or of_clouds is None:
        return table
    pairs = vars(table)["pairs"]
    levels = cycle.levels(pairs, setting, max(by_level))
    clouds = is_cloud_pair(shapes.kinds, pairs)
    if levels is not None:
        for portion in shapes.nearest_first(cycle.boxes, pairs, levels):
            for level, compute in by_level.items():
                rows = portion[(levels[portion] == level) & ~clouds[portion]]
                if len(rows):
                    write_rows(table, rows, compute(cycle.boxes, shapes, pairs[rows], setting))
        levels = shapes.reached(pairs, levels)
    rows = np.flatnonzero(clouds)
    if len(rows):
        cloud_pairs = shapes.cloud_pairs(cycle.boxes, pairs[rows])
        reached = np.full(len(rows), OBB) if levels is None else levels[rows]
        write_rows(table, rows, of_clouds(cloud_pairs, shapes, reached, setting))
    return table


def pair_rows(
    name: str,
    cycle: Cycle,
    setting: Setting,
    compute: Callable[[Boxes, Pairs], R],
    blank: R,
    by_level: ByLevel[R] | None = None,
    of_clouds: OfClouds[R] | None = None,
) -> Outcome:
    """Compute an effect's rows for the colliding pairs that it is selected for.

    compute(boxes, pairs) returns one row per pair; blank: a result without rows; by_level and
    of_clouds replace rows above OBB, and of clouds. Rows of unchanged pairs are copied from the
    check before. Pairs for which ``compute`` raises are left out.
    """
    rows = setting.select(cycle.pairs)
    if len(rows) == 0:
        return Outcome(blank, 0, (), rows, setting.values)
    highest = max(by_level) if by_level else Accuracy.OBB
    pairs = cycle.pairs.copy() if len(rows) == len(cycle.pairs) else cycle.pairs[rows]

    def compute_all(selected: Pairs) -> R:
        return refined(compute(cycle.boxes, selected), cycle, setting, by_level, of_clouds)

    levels = cycle.levels(pairs, setting, highest)
    last = cycle.last.get(name)
    old = None if last is None else _old_rows(cycle, rows, setting, last, levels)
    if last is None or old is None:
        good, result, failures = isolated(compute_all, pairs, blank, cycle.name)
        rows = rows if len(good) == len(rows) else rows[good]
        if levels is not None and cycle.shapes is not None:
            levels = cycle.shapes.reached(pairs[good], levels[good])
        return Outcome(result, len(pairs), failures, rows, setting.values, levels)
    anew = np.flatnonzero(old < 0)
    good, result, failures = isolated(compute_all, pairs[anew], blank, cycle.name)
    done = np.delete(np.arange(len(rows)), np.delete(anew, good))
    new = np.searchsorted(done, anew[good])
    result = _merged(last.result, old[done], new, result)
    if levels is not None and cycle.shapes is not None:
        levels = cycle.shapes.reached(pairs[done], levels[done])
    return Outcome(result, len(anew), failures, rows[done], setting.values, levels)


def _old_rows(
    cycle: Cycle, rows: Rows, setting: Setting, last: Outcome, levels: Levels | None
) -> Rows | None:
    """Return the row (k,) of each pair in the last result, -1 where it must be computed.

    None if all must be. levels (k,): on which the pairs are to be computed.
    """
    if cycle.old is None or last.rows is None or last.values != setting.values:
        return None
    where = np.full(max(int(cycle.old.max(initial=-1)), int(last.rows.max(initial=-1))) + 2, -1)
    where[last.rows] = np.arange(len(last.rows))
    old = where[cycle.old[rows]]  # the last entry, which -1 takes, is -1
    if levels is not None or last.accuracies is not None:
        before = np.full(len(last.rows), OBB) if last.accuracies is None else last.accuracies
        old[np.append(before, OBB)[old] != (OBB if levels is None else levels)] = -1
    return old if old.max() >= 0 else None


def _merged(last: R, old: Rows, places: Rows, new: R) -> R:
    """Return rows ``old`` (m,) of the last table, and new rows at places, where ``old`` is -1."""
    source = np.maximum(old, 0)
    columns = []
    for before, here in zip(vars(last).values(), vars(new).values(), strict=True):
        column = before.take(source, axis=0)
        column[places] = here
        columns.append(column)
    return type(new)(*columns)


def isolated(
    compute: Callable[[Pairs], R], pairs: Pairs, blank: R, name: Callable[[int], str] = str
) -> tuple[Rows, R, tuple[str, ...]]:
    """Return the rows of pairs (m, 2) for which ``compute`` works, their results, and failures.

    compute(pairs) returns a row for some or all pairs; blank: a result without rows. Instead of
    pairs there may be single objects (m,); name: of an object. ``compute`` is not called without
    pairs. Where it raises, halves are tried, down to the pairs that fail. After MOST_FAILURES whole
    parts that raise are left out, so an effect that always fails is called some
    2 (MOST_FAILURES + log2 m) times, not 2 m.
    """
    rows, tables, failures = [np.arange(0)], [blank], list[str]()
    waiting = [np.arange(len(pairs))] if len(pairs) else []
    while waiting:
        part = waiting.pop()
        try:
            table = compute(pairs if len(part) == len(pairs) else pairs[part])
        except Exception as error:  # of any kind: other pairs go on
            if len(part) > 1 and len(failures) < MOST_FAILURES:
                half = len(part) // 2
                waiting += [part[half:], part[:half]]  # the first half is next
            else:
                failures.append(_failure(pairs[part], error, name))
        else:
            rows.append(part)
            tables.append(table)
    if len(tables) == 2:  # all at once, as nearly always: nothing to copy
        return rows[1], tables[1], tuple(failures)
    return np.concatenate(rows), join_rows(tables), tuple(failures)


def _failure(pairs: Pairs, error: Exception, name: Callable[[int], str]) -> str:
    what = ("pair " if pairs.ndim > 1 else "") + ", ".join(map(name, np.ravel(pairs[0]).tolist()))
    more = f" and {len(pairs) - 1} more, not tried alone" if len(pairs) > 1 else ""
    return f"{what}{more}: {type(error).__name__}: {error}"


#: If fewer than one object in this many is selected, only pairs of selected objects are searched.
SELECTED_SHARE = 32
#: Pairs of a piece, where there are too many.
PIECE = 1 << 17


def meeting_pairs(
    cycle: Cycle, slots: Rows, minimum: Floats, maximum: Floats, selected: Mask | None
) -> Pairs:
    """Return pairs (k, 2) of slots, sorted, that may collide and whose bounds overlap.

    At most ``cycle.limit``. slots (n,) ascending, with bounds minimum and maximum (n, 3); selected
    (n,): each pair has at least one selected object, None for all.
    """
    most = UNLIMITED if cycle.limit is None else cycle.limit
    if len(slots) < 2:
        return NO_PAIRS
    few = selected is not None and np.count_nonzero(selected) * SELECTED_SHARE < len(slots)
    tree = BoundsTree.build(minimum, maximum)
    if selected is not None and few:
        pairs = find_some_candidates_of(tree, np.flatnonzero(selected), most)
    else:
        pairs = find_some_candidates(tree, most)
    if pairs is None:
        return _first_pairs(cycle, slots, minimum, tree, selected, most)
    if selected is not None and not few:
        pairs = pairs[selected[pairs].any(axis=1)]
    pairs = cycle.counted(slots, minimum, pairs)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _first_pairs(
    cycle: Cycle, slots: Rows, minimum: Floats, tree: BoundsTree, selected: Mask | None, most: int
) -> Pairs:
    """Return the first ``most`` pairs in lexicographic order, and note that there are more."""
    parts, count = [NO_PAIRS], 0
    for pairs, _ in ordered_candidates(tree, min(most, PIECE)):
        if selected is not None:
            pairs = pairs[selected[pairs].any(axis=1)]
        parts.append(cycle.counted(slots, minimum, pairs))
        count += len(parts[-1])
        if count > most:
            cycle.notes.append(f"more than {most} pairs come near each other: the first are done")
            break
    return np.concatenate(parts)[:most]
