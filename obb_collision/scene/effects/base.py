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

"""The interface of effects: results computed beside the pairs, only where they are asked for.

An effect sees one check of a scene (``Cycle``) and its ``Setting``, and gives a result: arrays with
a row per pair or per object, of the type that the query returns. It depends neither on other
effects nor on who asks. One that looks at pairs one by one uses ``pair_rows``, which computes only
what changed and survives a pair that fails.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import as_array
from obb_collision.queries.verdict.coarse import bounds_of
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.refinement.budget import Levels
from obb_collision.scene.refinement.placed_shapes import AS_PAIRS, CHOICES, PlacedShapes
from obb_collision.scene.store.allowed import PairFilter
from obb_collision.scene.store.region import Region, owns, owns_pairs
from obb_collision.scene.store.snapshot import Snapshot
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Mask, Rows
from obb_collision.words import shown

R = TypeVar("R")
"""A dataclass of arrays with one row per pair."""
ByLevel: TypeAlias = "Mapping[Accuracy, Callable[[Boxes, PlacedShapes, Pairs, Setting], R]]"
"""Functions that compute rows of pairs (k, 2) on a level above OBB: as many rows, all columns."""
#: The level of boxes, as arrays of levels have it.
OBB = np.int8(Accuracy.OBB)

#: Pairs that fail at one check which are looked for one by one: enough to see what they share.
MOST_FAILURES = 16


class Option(NamedTuple):
    """A number an effect can be set by: what it means, in which unit, from where to where.

    Or a word: one of the choices.
    """

    default: float | str
    low: float
    high: float
    description: str
    choices: tuple[float, ...] | tuple[str, ...] = ()
    reaches: bool = False
    """True for a distance (m) beyond objects at which others matter."""

    def checked(self, name: str, value: Any) -> float | str:
        """Return the value if it can be used; ValueError naming it otherwise."""
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


#: The name of the option that says what an effect on pairs is computed on, and the option.
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
    """(slots,) the objects selected for it, None for all."""

    def reach(self, options: Mapping[str, Option]) -> float:
        """Return how far beyond objects it looks (m)."""
        far = [self.values[key] for key, option in options.items() if option.reaches]
        return max(far, default=0.0) if self.mode != "off" else 0.0

    def select(self, pairs: Pairs) -> Rows:
        """Return the indices of pairs (m, 2) with at least one object selected for the effect."""
        if self.selected is None:
            return np.arange(len(pairs))
        return np.flatnonzero(self.selected[pairs].any(axis=1))


class Before(NamedTuple):
    """Where the objects were at the check before; rows of slots."""

    snapshot: Snapshot
    enabled: Mask
    born: Rows
    pairs: Pairs
    """Pairs that collided, in a region the pairs that it owned."""
    poses: Floats | None
    """Of the objects; None unless a region has effects above OBB."""

    @property
    def boxes(self) -> Boxes:
        """The boxes of all slots."""
        return self.snapshot.boxes


@dataclass(eq=False)
class Cycle:
    """One check of a scene as effects see it; the arrays stay as they are.

    snapshot: the boxes of all slots; active (slots,): which take part; pairs (m, 2): what collides;
    pair_filter: which pairs of slots (k,), (k,) count, None for all; old (m,): the row that each
    pair had in the check before, -1 if it is to be computed anew, None if all are; last: outcomes
    of the check before by effect; obstacle_points (k, 3): None for none.

    For effects that are not lazy only: store, whose poses and twists may change after the check,
    and before, None where nobody asked at the check before.
    """

    snapshot: Snapshot
    active: Mask
    pairs: Pairs
    pair_filter: PairFilter | None
    old: Rows | None
    last: Mapping[str, Outcome]
    obstacle_points: NDArray[Any] | None
    store: ObjectStore
    before: Before | None
    enabled: Mask
    """(slots,) which objects take part in this region or elsewhere; ``active`` without a region."""
    region: Region | None = None
    """Whose pairs, and objects, count; None for all."""
    spheres: bool = False
    """True if bounds hold spheres, too, wherever their overlap matters."""
    limit: int | None = None
    """The most pairs that an effect with pairs of its own looks at, None for all."""
    notes: list[str] = field(default_factory=list)
    """Tasks that an effect could not do at all; each becomes one of its failures."""
    names: Sequence[str | None] = ()
    """Of the objects, by slot."""
    shapes: PlacedShapes | None = None
    """Shapes that stand for objects above OBB; None where every effect speaks of boxes."""

    def levels(self, pairs: Pairs, setting: Setting, highest: Accuracy) -> Levels | None:
        """Return the level (m,) that an effect on pairs (m, 2) is computed on; None: all on OBB.

        highest: that it has. Pairs that it has found no time for are on OBB.
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
        """Return pairs of slots, of rows (k, 2) of slots (n,): those that count.

        That is: they may not touch, and belong to the region. A pair apart belongs where what the
        effect looks at does, of whose bounds ``minimum`` (n, 3) are the lower corners.
        """
        pairs = slots[rows]
        counts = np.ones(len(pairs), np.bool_)
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
        """Return (m,) which pairs (m, 2) of slots belong to the region where they collide."""
        if self.region is None:
            return np.ones(len(pairs), np.bool_)
        low = [self.bounds(column)[0] for column in pairs.T]
        return owns(self.region, np.maximum(*low))

    def own(self, slots: Rows) -> Rows:
        """Return those of slots (n,) whose objects belong to the region, each to one."""
        if self.region is None:
            return slots
        return slots[owns(self.region, self.bounds(slots)[0])]

    def bounds(self, slots: Rows) -> tuple[Floats, Floats]:
        """Return the bounds (n, 3), (n, 3) of slots whose overlap decides where a pair belongs."""
        return bounds_of(self.boxes[slots], self.spheres)

    def as_before(self) -> Before:
        """Return the state that the next check compares with."""
        needed = self.region is not None and self.shapes is not None
        poses = self.store.poses.copy() if needed else None
        return Before(self.snapshot, self.enabled, self.store.born.copy(), self.pairs, poses)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of an effect: its result, how many pairs (or points) it ran on, and what failed.

    rows (k,): which rows of ``Report.pairs`` the rows of the result are, None where they are
    others; values: the options they were computed with.
    """

    result: Any
    count: int
    failures: tuple[str, ...] = ()
    rows: Rows | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    accuracies: Levels | None = None
    """(k,) the level that each row was computed on; None: all on OBB or below."""

    def __post_init__(self) -> None:
        freeze(self.result)  # the next check copies what has not changed


def freeze(table: Any) -> None:
    """Make the arrays of a dataclass, and of those in it, read-only."""
    for value in getattr(table, "__dict__", {}).values():
        if isinstance(value, np.ndarray) and value.size:  # empty ones may be of everybody
            value.setflags(write=False)
        elif is_dataclass(value):
            freeze(value)


class Effect(Protocol):
    """One effect; a value without state, so that one serves all scenes."""

    name: str
    description: str
    """Its result, as the beginning of a sentence."""
    options: Mapping[str, Option]
    lazy: bool = True
    """True if it can still be computed after the check, when the scene may have moved on."""

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Compute it for one check."""


def take_rows(table: R, rows: Rows | Mask) -> R:
    """Return some rows of a dataclass of arrays."""
    return type(table)(*(column[rows] for column in vars(table).values()))


def join_rows(tables: Sequence[R]) -> R:
    """Return the rows of dataclasses of arrays, all of a type, one after the other."""
    columns = zip(*(vars(table).values() for table in tables), strict=True)
    return type(tables[0])(*map(np.concatenate, columns))


def write_rows(table: R, rows: Rows, new: R) -> None:
    """Write rows of a dataclass of arrays."""
    for key, column in vars(table).items():
        column[rows] = vars(new)[key]


def refined(table: R, cycle: Cycle, setting: Setting, by_level: ByLevel[R] | None) -> R:
    """Return a table of pairs of boxes, in which rows of shapes above OBB have been written."""
    if not by_level:
        return table
    pairs = vars(table)["pairs"]
    levels = cycle.levels(pairs, setting, max(by_level))
    if levels is None or cycle.shapes is None:
        return table
    for some in cycle.shapes.nearest_first(cycle.boxes, pairs, levels):
        for level, compute in by_level.items():
            rows = some[levels[some] == level]
            if len(rows):
                write_rows(table, rows, compute(cycle.boxes, cycle.shapes, pairs[rows], setting))
    return table


def pair_rows(
    name: str,
    cycle: Cycle,
    setting: Setting,
    compute: Callable[[Boxes, Pairs], R],
    blank: R,
    by_level: ByLevel[R] | None = None,
) -> Outcome:
    """Compute an effect's rows for the colliding pairs that it is selected for.

    compute(boxes, pairs) returns one row per pair; blank: the same without a row; by_level: what
    takes their place above OBB. Rows of pairs that are as they were in the check before are copied.
    Pairs for which ``compute`` raises are left out, and where there are none it is not called.
    """
    rows = setting.select(cycle.pairs)
    if len(rows) == 0:
        return Outcome(blank, 0, (), rows, setting.values)
    highest = max(by_level) if by_level else Accuracy.OBB
    pairs = cycle.pairs.copy() if len(rows) == len(cycle.pairs) else cycle.pairs[rows]

    def compute_some(some: Pairs) -> R:
        return refined(compute(cycle.boxes, some), cycle, setting, by_level)

    levels = cycle.levels(pairs, setting, highest)
    last = cycle.last.get(name)
    known = None if last is None else _known_rows(cycle, rows, setting, last, levels)
    if last is None or known is None:
        good, result, failures = isolated(compute_some, pairs, blank, cycle.name)
        rows = rows if len(good) == len(rows) else rows[good]
        levels = None if levels is None else _reached(cycle, pairs[good], levels[good])
        return Outcome(result, len(pairs), failures, rows, setting.values, levels)
    anew = np.flatnonzero(known < 0)
    good, result, failures = isolated(compute_some, pairs[anew], blank, cycle.name)
    done = np.delete(np.arange(len(rows)), np.delete(anew, good))
    new = np.searchsorted(done, anew[good])
    result = _merged(last.result, known[done], new, result)
    levels = None if levels is None else _reached(cycle, pairs[done], levels[done])
    return Outcome(result, len(anew), failures, rows[done], setting.values, levels)


def _reached(cycle: Cycle, pairs: Pairs, levels: Levels) -> Levels:
    return levels if cycle.shapes is None else cycle.shapes.reached(pairs, levels)


def _known_rows(
    cycle: Cycle, rows: Rows, setting: Setting, last: Outcome, levels: Levels | None
) -> Rows | None:
    """Return (k,) the row of each pair in the last result, -1 where it must be computed.

    None where that is everywhere. levels (k,): they are to be computed on.
    """
    if cycle.old is None or last.rows is None or last.values != setting.values:
        return None
    where = np.full(max(int(cycle.old.max(initial=-1)), int(last.rows.max(initial=-1))) + 2, -1)
    where[last.rows] = np.arange(len(last.rows))
    known = where[cycle.old[rows]]  # the last entry, which -1 takes, is -1
    if levels is not None or last.accuracies is not None:
        before = np.full(len(last.rows), OBB) if last.accuracies is None else last.accuracies
        known[np.append(before, OBB)[known] != (OBB if levels is None else levels)] = -1
    return known if known.max() >= 0 else None


def _merged(last: R, known: Rows, places: Rows, new: R) -> R:
    """Return rows of the last table, known (m,), but rows of a new one in places, where -1 is."""
    source = np.maximum(known, 0)
    columns = []
    for before, here in zip(vars(last).values(), vars(new).values(), strict=True):
        column = before.take(source, axis=0)
        column[places] = here
        columns.append(column)
    return type(new)(*columns)


def isolated(
    compute: Callable[[Pairs], R], pairs: Pairs, blank: R, name: Callable[[int], str] = str
) -> tuple[Rows, R, tuple[str, ...]]:
    """Return the rows of pairs (m, 2) that ``compute`` can do, their results, and its failures.

    compute(pairs) returns a row for some or all pairs; blank: the same without one. In place of
    pairs there may be single objects (m,); name: that of an object. Without pairs
    it is not called; where it raises, halves are tried, down to the pairs that fail. After
    MOST_FAILURES of these what raises is left out as it is, so that an effect that always fails is
    called some 2 (MOST_FAILURES + log2 m) times, not 2 m.
    """
    rows, tables, failures = [np.arange(0)], [blank], list[str]()
    waiting = [np.arange(len(pairs))] if len(pairs) else []
    while waiting:
        part = waiting.pop()
        try:
            table = compute(pairs if len(part) == len(pairs) else pairs[part])
        except Exception as error:  # whatever it is, other pairs go on
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
