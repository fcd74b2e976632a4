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

"""What an effect is: something computed on top of the pairs, only where it is called for.

An effect sees one check of a scene (``Cycle``) and how it is set (``Setting``), and gives a result.
It neither knows other effects nor who asks. One that looks at pairs one by one uses ``pair_rows``,
which computes only what changed and lives through a pair that fails.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import as_array
from obb_collision.queries.verdict.verdict import Verdicts
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.store.allowed import Counts
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Mask, Rows

Table = tuple[NDArray[Any], ...]

#: Pairs that fail at one check which are looked for one by one: enough to see what they share.
MOST_FAILURES = 16


class Option(NamedTuple):
    """A number an effect can be set by: what it means, in which unit, from where to where."""

    default: float
    low: float
    high: float
    description: str
    choices: tuple[float, ...] = ()

    def checked(self, name: str, value: Any) -> float:
        """Return the value if it can be used; ValueError naming it otherwise."""
        number = float(as_array(value, name, ()))
        if self.choices and number not in self.choices:
            choices = " or ".join(f"{choice:g}" for choice in self.choices)
            raise ValueError(f"{name} must be {choices}, got {value!r}")
        if not self.low <= number <= self.high:
            raise ValueError(f"{name} must be from {self.low:g} to {self.high:g}, got {value!r}")
        return number


@dataclass(frozen=True)
class Setting:
    """How an effect is set: its mode, the objects that call for it (patterns), its options."""

    mode: str = "auto"
    objects: tuple[str, ...] = ("*",)
    values: Mapping[str, float] = field(default_factory=dict)
    wanted: Mask | None = None
    """(slots,) the objects that call for it, None for all."""

    def calls(self, pairs: Pairs) -> Rows:
        """Return the rows of pairs (m, 2) of which one object or both call for the effect."""
        if self.wanted is None:
            return np.arange(len(pairs))
        return np.flatnonzero(self.wanted[pairs].any(axis=1))


class Before(NamedTuple):
    """Where the objects were at the check before; rows of slots."""

    boxes: Boxes
    active: Mask
    born: Rows


@dataclass(eq=False)
class Cycle:
    """One check of a scene as effects see it; the arrays stay as they are.

    boxes: of all slots; active (slots,): which take part; pairs (m, 2) and verdicts (m,): what
    collides; counts: which pairs of slots (k,), (k,) count, None for all; old (m,): the row that
    each pair had in the check before, -1 if it is to be computed anew, None if all are; last:
    results of the check before by effect; points (k, 3): obstacles, None for none.

    For effects that are not lazy only: store, whose poses and twists may change after the check,
    and before, None where nobody asked at the check before.
    """

    boxes: Boxes
    active: Mask
    pairs: Pairs
    verdicts: Verdicts
    counts: Counts | None
    old: Rows | None
    last: Mapping[str, Any]
    points: NDArray[Any] | None
    store: ObjectStore
    before: Before | None
    limit: int | None = None
    """The most pairs that an effect with pairs of its own looks at, None for all."""
    notes: list[str] = field(default_factory=list)
    """What an effect could not do at all; becomes a failure of its."""

    def counted(self, pairs: Pairs) -> Pairs:
        """Return those of pairs (k, 2) that may not touch."""
        if self.counts is None:
            return pairs
        return pairs[self.counts(pairs[:, 0], pairs[:, 1])]

    def as_before(self) -> Before:
        """Return what the next check can compare with."""
        return Before(self.boxes, self.active, self.store.born.copy())


@dataclass(frozen=True, eq=False)
class Outcome:
    """What an effect gave: its result, how many pairs (or points) it ran on, and what failed."""

    result: Any
    count: int
    failures: tuple[str, ...] = ()


class Effect(Protocol):
    """One effect; a value without state, so that one serves all scenes."""

    name: str
    options: Mapping[str, Option]
    lazy: bool
    """Whether it can still be computed after the check, when the scene may have moved on."""

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Compute it for one check."""


@dataclass(frozen=True, eq=False)
class PairTable:
    """Results with one row for each of some colliding pairs.

    rows (k,): rows of ``Report.pairs``; pairs (k, 2): the same as object indices; columns: arrays
    (k, ...); values: the options they were computed with.
    """

    rows: Rows
    pairs: Pairs
    columns: Table
    values: Mapping[str, float]


def pair_rows(
    name: str,
    cycle: Cycle,
    setting: Setting,
    compute: Callable[[Boxes, Pairs], Table],
    blank: Table,
) -> tuple[PairTable, int, tuple[str, ...]]:
    """Return the table of the pairs that call for an effect, how many were computed, failures.

    compute(boxes, pairs) returns columns with one row a pair; blank: the same without a row. Rows
    of pairs that are as they were in the check before are copied. Pairs for which ``compute``
    raises are left out, and where there are none it is not called.
    """
    rows = setting.calls(cycle.pairs)
    if len(rows) == 0:
        return PairTable(rows, cycle.pairs[rows], blank, setting.values), 0, ()
    last: PairTable | None = cycle.last.get(name)
    known = _known_rows(cycle, rows, setting, last)
    anew = np.flatnonzero(known < 0)

    def computed(pairs: Pairs) -> Table:
        return compute(cycle.boxes, pairs)

    good, columns, failures = isolated(computed, cycle.pairs[rows[anew]], blank)
    copied = np.flatnonzero(known >= 0)
    if last is not None and len(copied):
        order = np.argsort(np.concatenate([copied, anew[good]]))
        parts = zip(last.columns, columns, strict=True)
        columns = tuple(np.concatenate([old[known[copied]], new])[order] for old, new in parts)
    rows = np.delete(rows, np.delete(anew, good))
    return PairTable(rows, cycle.pairs[rows], columns, setting.values), len(anew), failures


def _known_rows(cycle: Cycle, rows: Rows, setting: Setting, last: PairTable | None) -> Rows:
    """Return (k,) the row of each pair in the last table, -1 where it must be computed."""
    if cycle.old is None or last is None or last.values != setting.values:
        return np.full(len(rows), -1)
    where = np.full(max(int(cycle.old.max(initial=-1)), int(last.rows.max(initial=-1))) + 2, -1)
    where[last.rows] = np.arange(len(last.rows))
    return where[cycle.old[rows]]  # the last entry, which -1 takes, is -1


def isolated(
    compute: Callable[[Pairs], Table], pairs: Pairs, blank: Table
) -> tuple[Rows, Table, tuple[str, ...]]:
    """Return the rows of pairs (m, 2) that ``compute`` can do, their columns, and its failures.

    compute(pairs) returns columns with a row for some or all pairs; blank: the same without one.
    Without pairs it is not called; where it raises, halves are tried, down to the pairs that fail.
    After MOST_FAILURES of these what raises is left out as it is, so that an effect that always
    fails is called some 2 (MOST_FAILURES + log2 m) times, not 2 m.
    """
    rows, tables, failures = [np.arange(0)], [blank], list[str]()
    waiting = [np.arange(len(pairs))] if len(pairs) else []
    while waiting:
        part = waiting.pop()
        try:
            table = compute(pairs[part])
        except Exception as error:  # whatever it is, other pairs go on
            if len(part) > 1 and len(failures) < MOST_FAILURES:
                half = len(part) // 2
                waiting += [part[half:], part[:half]]  # the first half is next
            else:
                failures.append(_failure(pairs[part], error))
        else:
            rows.append(part)
            tables.append(table)
    if len(tables) == 2:  # all at once, as nearly always: nothing to copy
        return rows[1], tables[1], tuple(failures)
    columns = tuple(np.concatenate(parts) for parts in zip(*tables, strict=True))
    return np.concatenate(rows), columns, tuple(failures)


def _failure(pairs: Pairs, error: Exception) -> str:
    first, second = pairs[0].tolist()
    more = f" and {len(pairs) - 1} more, not tried alone" if len(pairs) > 1 else ""
    return f"pair {first}, {second}{more}: {type(error).__name__}: {error}"
