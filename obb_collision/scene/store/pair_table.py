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

"""The table by which pairs are filtered: arrays, whatever the number of objects and rules.

Objects that no rule tells apart are of one kind, so a pair is looked up in a small table of kinds.
When objects come or go, only their names are matched anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from obb_collision.scene.store.patterns import matching
from obb_collision.typing import Mask, Rows

Patterns = tuple[str, ...]
#: Whether pairs of slots (m,), (m,) count, (m,).
PairFilter = Callable[[Rows, Rows], NDArray[np.bool_]]
#: Namespaces remembered that no object has any more, before all are looked up anew.
SPARE_NAMESPACES = 1000


class PairTable:
    """Which pairs count, by rules, the only pairs to check, and namespaces within which none do."""

    def __init__(
        self,
        rules: Sequence[tuple[Patterns, Patterns, bool]],
        only: Sequence[tuple[Patterns, Patterns]],
        within: Patterns,
    ) -> None:
        self._rules, self._only, self._within = rules, only, within
        pairs = (*((a, b) for a, b, _ in rules), *only)
        self._sides = list(dict.fromkeys(side for pair in pairs for side in pair))
        self._forget()

    def _forget(self) -> None:
        self._names: list[str | None] = []
        self._columns = np.zeros((0, len(self._sides)), np.bool_)
        self._spaces: Rows = np.zeros(0, np.int64)
        self._numbers: dict[str, int] = {}

    def pair_filter(self, names: Sequence[str | None]) -> PairFilter:
        """Return the filter of pairs of slots with these names."""
        self._match(names)
        table, kinds = self._table()
        spaces = self._spaces if self._within else None

        def pair_filter(first: Rows, second: Rows) -> NDArray[np.bool_]:
            counts: Mask = table[kinds[first], kinds[second]]
            if spaces is not None:
                space = spaces[first]
                counts &= (space < 0) | (space != spaces[second])
            return counts

        return pair_filter

    def _match(self, names: Sequence[str | None]) -> None:
        """Match the names that are not as before with all sides and namespaces."""
        if len(names) < len(self._names) or len(self._numbers) > len(names) + SPARE_NAMESPACES:
            self._forget()
        known = len(self._names)
        both = enumerate(zip(self._names, names, strict=False))
        new = [row for row, (old, name) in both if old is not name] + [*range(known, len(names))]
        some = [names[row] for row in new]
        grown = len(names) - known
        columns = np.pad(self._columns, ((0, grown), (0, 0)))
        spaces = np.pad(self._spaces, (0, grown))  # a copy: filters in use have the old one
        where = {name: row for row, name in enumerate(some) if name is not None}
        for number, side in enumerate(self._sides):
            columns[new, number] = _members(side, some, where)
        if self._within:
            spaces[new] = [self._space(name) for name in some]
        self._columns, self._spaces, self._names = columns, spaces, list(names)

    def _space(self, name: str | None) -> int:
        """Return a number for the namespace of a name if objects may touch in it, else -1."""
        namespace, slash, _ = (name or "").rpartition("/")
        number = self._numbers.get(namespace)
        if number is None:
            listed = any(fnmatchcase(namespace, pattern) for pattern in self._within)
            number = self._numbers[namespace] = len(self._numbers) if listed else -1
        return number if slash else -1

    def _table(self) -> tuple[NDArray[np.bool_], Rows]:
        """Return whether pairs of kinds (k, k) count, and the kind of each slot (n,)."""
        members, kinds = _kinds(self._columns)
        numbers = {side: number for number, side in enumerate(self._sides)}

        def fill(table: NDArray[np.bool_], a: Patterns, b: Patterns, value: bool) -> None:
            one, other = (np.flatnonzero(members[:, numbers[side]]) for side in (a, b))
            table[np.ix_(one, other)] = table[np.ix_(other, one)] = value

        table = np.ones((len(members), len(members)), np.bool_)
        for a, b, allowed in self._rules:
            fill(table, a, b, not allowed)
        if self._only:
            only = np.zeros_like(table)
            for a, b in self._only:
                fill(only, a, b, True)
            table &= only
        return table, kinds


def _members(
    side: Patterns, names: Sequence[str | None], where: dict[str, int]
) -> NDArray[np.bool_]:
    """Return which names (n,) a side names or matches; where: the row of each."""
    patterns = [pattern for pattern in side if set(pattern) & set("*?[")]
    found = matching(patterns, names) if patterns else np.zeros(len(names), np.bool_)
    found[[where[name] for name in side if name in where]] = True
    return found


def _kinds(columns: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Rows]:
    """Return the distinct rows (k, c) of columns (n, c), and which of them each row is (n,)."""
    if columns.shape[1] == 0 or len(columns) == 0:
        return columns[:1], np.zeros(len(columns), np.int64)
    packed = np.packbits(columns, axis=1)
    rows = packed.view(f"S{packed.shape[1]}").reshape(-1)  # compared as one number each
    _, first, kinds = np.unique(rows, return_index=True, return_inverse=True)
    return columns[first], kinds.reshape(-1)  # numpy 2.0 gave it another shape
