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

"""Allowed pairs: objects that may touch, so that their collision is none.

Rules name pairs of patterns; of several that fit a pair the last one counts, as in an allowed
collision matrix. Objects that no rule tells apart form a group, so a pair is looked up in a small
table of groups, however many objects there are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.kinds import check_kind
from obb_collision.scene.store.patterns import as_patterns, matching
from obb_collision.typing import Rows

Rule = tuple[str, str, bool]
#: Whether pairs of slots (m,), (m,) count, (m,).
PairFilter = Callable[[Rows, Rows], NDArray[np.bool_]]


class AllowedPairs:
    """Rules, and the table they make for the names at hand."""

    def __init__(self) -> None:
        self._rules: dict[tuple[str, ...], Rule] = {}  # by both patterns, sorted
        self._made: tuple[int, PairFilter] | None = None

    def add(self, first: str, second: str, allowed: bool) -> None:
        """Let objects that match two patterns touch each other, or, with False, no longer.

        Raises ValueError for what is no pattern.
        """
        for value, name in ((first, "first"), (second, "second")):
            check_kind(value, str, name)
        a, b = (*as_patterns(first, "first"), *as_patterns(second, "second"))
        key = tuple(sorted((a, b)))
        before = self._rules.pop(key, None)  # the last rule comes last
        if allowed or before is None or self._may_be_allowed(a, b):
            self._rules[key] = a, b, bool(allowed)
        self._made = None

    def _may_be_allowed(self, a: str, b: str) -> bool:
        """Return whether a rule may let objects touch that match two patterns.

        If none does, a rule that was taken back can be forgotten instead of overruled.
        """
        return any(
            allowed and ((_meet(a, p) and _meet(b, q)) or (_meet(a, q) and _meet(b, p)))
            for p, q, allowed in self._rules.values()
        )

    def replace(self, rules: Iterable[Rule]) -> None:
        """Put rules in place of all before; on a ValueError those before stay."""
        new = AllowedPairs()
        for rule in rules:
            new.add(*rule)
        self._rules, self._made = new._rules, None

    @property
    def rules(self) -> list[Rule]:
        """The rules, in the order in which they count."""
        return list(self._rules.values())

    def pair_filter(self, names: Sequence[str | None], version: int) -> PairFilter | None:
        """Return which pairs count as collisions if they collide, None for all.

        names: by slot; version: a number that changes with them, so that the table can be kept.
        """
        if not self._rules:
            return None
        if self._made is None or self._made[0] != version:
            self._made = version, _pair_filter(self.rules, names)
        return self._made[1]


def _meet(a: str, b: str) -> bool:
    """Return whether a name may match two patterns; True where that is not easily told."""
    if _is_name(a):
        return fnmatchcase(a, b)
    return not _is_name(b) or fnmatchcase(b, a)


def _is_name(pattern: str) -> bool:
    return not set(pattern) & set("*?[")


def _pair_filter(rules: Sequence[Rule], names: Sequence[str | None]) -> PairFilter:
    patterns = sorted({pattern for a, b, _ in rules for pattern in (a, b)})
    columns = np.stack([matching([pattern], names) for pattern in patterns], axis=1)
    kinds, groups = np.unique(columns, axis=0, return_inverse=True)
    groups = groups.reshape(-1)  # numpy 2.0 gave it another shape
    table = np.ones((len(kinds), len(kinds)), np.bool_)
    numbers = {pattern: number for number, pattern in enumerate(patterns)}
    for a, b, allowed in rules:
        in_a, in_b = kinds[:, numbers[a]], kinds[:, numbers[b]]
        table[np.outer(in_a, in_b) | np.outer(in_b, in_a)] = not allowed

    def pair_filter(first: Rows, second: Rows) -> NDArray[np.bool_]:
        return table[groups[first], groups[second]]

    return pair_filter
