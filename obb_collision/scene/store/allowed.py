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

"""Allowed pairs: pairs whose collisions are ignored.

A pair counts if no filter excludes it: rules, of which the last that fits a pair decides; an
allowed collision matrix; ``check_only``, the only pairs that count; and namespaces within which
objects may touch. Parts of one body (``wall/1#/0``) may touch, and what is said of it holds for
them.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.validation import as_flag, warn_caller
from obb_collision.scene.store.patterns import (
    PARTS,
    as_patterns,
    as_tuples,
    is_pattern,
    matching,
    whole_of,
)
from obb_collision.typing import Mask, Rows
from obb_collision.words import shown

Patterns = tuple[str, ...]
#: Whether pairs of slots (m,), (m,) count, (m,).
PairFilter = Callable[[Rows, Rows], NDArray[np.bool_]]
#: Unused namespaces that are remembered before all are looked up anew.
SPARE_NAMESPACES = 1000
#: Limit of names with which an unknown name is compared: 20 ms.
MOST_GUESSES = 2000


class AllowedMatrix(NamedTuple):
    """Pairs of names that may touch, even if a rule forbids it.

    Thousands of pairs are as fast as a rule. rows: the row of each name, which names may
    share; allowed (r, r): symmetric.
    """

    rows: dict[str, int]
    allowed: Mask

    @classmethod
    def joined(cls, parts: Sequence[AllowedMatrix]) -> AllowedMatrix:
        """Join matrices; pairs of names in different ones may not touch."""
        ends = np.cumsum([0, *(len(part.allowed) for part in parts)]).tolist()
        rows: dict[str, int] = {}
        allowed = np.zeros((ends[-1], ends[-1]), np.bool_)
        for part, start, end in zip(parts, ends, ends[1:], strict=False):
            rows |= {name: start + row for name, row in part.rows.items()}
            allowed[start:end, start:end] = part.allowed
        return cls(rows, allowed)


NO_MATRIX = AllowedMatrix({}, np.zeros((0, 0), np.bool_))


class PairTable:
    """Decides which pairs count, by rules, a matrix, the only pairs, and namespaces.

    Objects that no rule distinguishes are of one kind, so a pair is looked up in a small table of
    kinds. When objects are added or removed, only their names are matched anew.
    """

    def __init__(
        self,
        rules: Sequence[tuple[Patterns, Patterns, bool]],
        only: Sequence[tuple[Patterns, Patterns]],
        within: Patterns,
        matrix: AllowedMatrix = NO_MATRIX,
    ) -> None:
        self._rules, self._only, self._within, self._numbered = rules, only, within, matrix.rows
        self._allowed = np.pad(matrix.allowed, (0, 1))  # the last row is of other objects, -1
        pairs = (*((a, b) for a, b, _ in rules), *only)
        self._sides = list(dict.fromkeys(side for pair in pairs for side in pair))
        patterns = ((k, list(filter(is_pattern, side))) for k, side in enumerate(self._sides))
        self._matched = {number: wild for number, wild in patterns if wild}
        self._forget()

    def _forget(self) -> None:
        self._names: list[str | None] = []
        self._columns = np.zeros((0, len(self._sides)), np.bool_)
        self._spaces: Rows = np.zeros(0, np.int64)
        self._rows: Rows = np.zeros(0, np.int64)  # of the matrix, -1 for none
        self._numbers: dict[str, int] = {}

    def pair_filter(self, names: Sequence[str | None]) -> PairFilter:
        """Return a filter for pairs of slots with these names."""
        self._match(names)
        table, kinds = self._table()
        spaces = self._spaces if self._numbers else None
        rows, allowed = self._rows, self._allowed if self._numbered else None

        def pair_filter(first: Rows, second: Rows) -> NDArray[np.bool_]:
            counts: Mask = table[kinds[first], kinds[second]]
            if spaces is not None:
                space = spaces[first]
                counts &= (space < 0) | (space != spaces[second])
            if allowed is not None:
                counts &= ~allowed[rows[first], rows[second]]
            return counts

        return pair_filter

    def _match(self, names: Sequence[str | None]) -> None:
        """Match changed names with all sides and namespaces."""
        if len(names) < len(self._names) or len(self._numbers) > len(names) + SPARE_NAMESPACES:
            self._forget()
        before = len(self._names)
        both = enumerate(zip(self._names, names, strict=False))
        new = [row for row, (old, name) in both if old is not name] + [*range(before, len(names))]
        new_names = [names[row] for row in new]
        grown = len(names) - before
        columns = np.pad(self._columns, ((0, grown), (0, 0)))
        spaces = np.pad(self._spaces, (0, grown))  # a copy: filters in use have the old one
        rows = np.pad(self._rows, (0, grown), constant_values=-1)
        where = {name: row for row, name in enumerate(new_names) if name is not None}
        parts: dict[str, list[int]] = {}
        for name in filter(_is_part, where):
            parts.setdefault(whole_of(name), []).append(where[name])
        places = np.array(new, np.int64)
        columns[places] = False
        for number, side in enumerate(self._sides):
            listed = [where[name] for name in side if name in where]
            listed += [row for name in side for row in parts.get(name, ())]
            if listed:  # a rule names few objects: no array of all objects per rule
                columns[places[listed], number] = True
            if number in self._matched:
                columns[places, number] |= matching(self._matched[number], new_names)
        spaces[places] = -1
        if self._within or parts:
            spaces[new] = [self._space(name or "") for name in new_names]
        if self._numbered:
            bodies = (self._numbered.get(whole_of(name or ""), -1) for name in new_names)
            both_names = zip(new_names, bodies, strict=True)
            rows[new] = [self._numbered.get(name or "", body) for name, body in both_names]
        self._columns, self._spaces, self._rows = columns, spaces, rows
        self._names = list(names)

    def _space(self, name: str) -> int:
        """Return the number of a name's namespace if objects may touch within it, else -1.

        A part whose body is in no such namespace has its own, in which there are only such parts.
        """
        body = whole_of(name)
        number = self._number(body)
        if number < 0 and body != name:
            return self._numbers.setdefault(name.rpartition("/")[0], len(self._numbers))
        return number

    def _number(self, name: str) -> int:
        namespace, slash, _ = name.rpartition("/")
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
            first, second = (np.flatnonzero(members[:, numbers[side]]) for side in (a, b))
            table[np.ix_(first, second)] = table[np.ix_(second, first)] = value

        table = np.ones((len(members), len(members)), np.bool_)
        for a, b, allowed in self._rules:
            fill(table, a, b, not allowed)
        if self._only:
            only = np.zeros_like(table)
            for a, b in self._only:
                fill(only, a, b, True)
            table &= only
        return table, kinds


def _kinds(columns: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Rows]:
    """Return the distinct rows (k, c) of columns (n, c), and the number (n,) of each row."""
    if columns.shape[1] == 0 or len(columns) == 0:
        return columns[:1], np.zeros(len(columns), np.int64)
    packed = np.packbits(columns, axis=1)
    rows = packed.view(f"S{packed.shape[1]}").reshape(-1)  # each compared as one number
    _, first, kinds = np.unique(rows, return_index=True, return_inverse=True)
    return columns[first], kinds.reshape(-1)  # numpy 2.0 gave it another shape


Side: TypeAlias = str | tuple[str, ...]
"""One side of a pair: names or patterns."""
Rule: TypeAlias = tuple[Side, Side, bool]
"""Whether objects of two sides may touch."""
Sides: TypeAlias = tuple[Side, Side]


class PairRules:
    """The rules about pairs, and their table for the names of a scene.

    changing: called before a rule changes.

    Examples
    --------
    >>> scene = oc.Scene()
    >>> scene.rules.allowed_within = ["robot"]
    >>> scene.allow("cup", "table")
    >>> scene.rules.allowed
    [('cup', 'table', True)]
    """

    __slots__ = (
        *("_changing", "_made", "_matrix", "_only", "_rules", "_seen", "_table", "_within"),
        "warns",
    )

    def __init__(self, changing: Callable[[], object] = lambda: None) -> None:
        self._changing = changing
        self._rules: OrderedDict[tuple[Patterns, ...], tuple[Patterns, Patterns, bool]] = (
            OrderedDict()
        )
        self._only: list[tuple[Patterns, Patterns]] = []
        self._within: Patterns = ()
        self._matrix = NO_MATRIX
        self._table: PairTable | None = None
        self._made: tuple[int, PairFilter | None] | None = None
        self._seen: set[str] = set()  # patterns of check_only that match, or caused a warning
        self.warns = True
        """Whether a check warns of patterns of ``check_only`` that match no object."""

    def add(self, first: Iterable[str], second: Iterable[str], allowed: bool) -> None:
        """Let objects of two sides touch each other; with False, no longer."""
        a, b = _side(first, "first"), _side(second, "second")
        self._renew()
        self._add(tuple(sorted((a, b))), (a, b, bool(allowed)))

    def _add(self, key: tuple[Patterns, ...], rule: tuple[Patterns, Patterns, bool]) -> None:
        a, b, allowed = rule
        overruled = (  # pairs of it that other rules may allow
            (_meet(a, p) and _meet(b, q)) or (_meet(a, q) and _meet(b, p))
            for other, (p, q, may_touch) in self._rules.items()
            if other != key and may_touch
        )
        if allowed or key not in self._rules or any(overruled):
            self._rules[key] = rule
            self._rules.move_to_end(key)  # the last rule comes last
        else:
            del self._rules[key]

    def _renew(self) -> None:
        """Forget the table and the filter, before a change."""
        self._changing()
        self._table = self._made = None

    @property
    def allowed(self) -> list[Rule]:
        """The rules (first, second, allowed), of which the last that fits a pair counts.

        Can be set, in place of all earlier ones.
        """
        return [(_shown(a), _shown(b), allowed) for a, b, allowed in self._rules.values()]

    @allowed.setter
    def allowed(self, rules: Iterable[Rule]) -> None:
        new = PairRules()
        for first, second, allowed in as_tuples(rules, "allowed", 3):
            a, b = _side(first, "allowed"), _side(second, "allowed")
            new.add(a, b, as_flag(allowed, "allowed"))
        if new.allowed != self.allowed:
            self._renew()
            self._rules = new._rules

    @property
    def check_only(self) -> list[Sides]:
        """The only pairs (first, second) that count, [] for all; can be set.

        Allowed pairs do not count here either. A check warns, once, of a name or pattern that
        matches no object and no link of its robots; see ``Scene.check_only``.
        """
        return [(_shown(a), _shown(b)) for a, b in self._only]

    @check_only.setter
    def check_only(self, pairs: Iterable[Sides]) -> None:
        self.set_only(pairs, "check_only")

    def set_only(self, pairs: Iterable[Sides], name: str) -> None:
        """Set the only pairs that count; name: of the argument, for errors."""
        only = [(_side(a, name), _side(b, name)) for a, b in as_tuples(pairs, name, 2)]
        self._renew()
        self._only, self._seen = only, set()

    @property
    def allowed_within(self) -> list[str]:
        """Namespaces, or patterns of them, within which objects may touch; can be set.

        The namespace of ``robot/arm/1`` is ``robot/arm``. ``*`` means each namespace: pairs of
        two namespaces count, those of one do not.
        """
        return list(self._within)

    @allowed_within.setter
    def allowed_within(self, namespaces: Iterable[str] | str) -> None:
        within = as_patterns(namespaces, "allowed_within")
        self._renew()
        self._within = within

    @property
    def matrix(self) -> AllowedMatrix:
        """Pairs of names that may touch, even if a rule forbids it; can be set."""
        return self._matrix

    @matrix.setter
    def matrix(self, matrix: AllowedMatrix) -> None:
        if not isinstance(matrix, AllowedMatrix):
            raise ValueError(f"matrix must be an AllowedMatrix, not {shown(matrix)}")
        self._renew()
        self._matrix = matrix

    def warn_of_unknown(self, names: Sequence[str | None]) -> None:
        """Warn of patterns of ``check_only`` that match no name: probably typing errors."""
        patterns = {pattern for pair in self._only for side in pair for pattern in side}
        for pattern in sorted(patterns - self._seen if self.warns and any(names) else ()):
            self._seen.add(pattern)
            if not matching([pattern], names).any():
                hint = guess(pattern, filter(None, names))
                warn_caller(f"check_only names {shown(pattern)}, which matches no object{hint}")

    def filter_of(self, names: Sequence[str | None]) -> PairFilter | None:
        """Return the filter of pairs of names that count, None if all do."""
        given = self._rules or self._only or self._within or self._matrix.rows
        if not (given or any(map(_is_part, filter(None, names)))):
            return None
        if self._table is None:
            rules = list(self._rules.values())
            self._table = PairTable(rules, self._only, self._within, self._matrix)
        return self._table.pair_filter(names)

    def pair_filter(self, names: Sequence[str | None], version: int) -> PairFilter | None:
        """Return the filter of pairs of slots that count, None if all do.

        names: by slot; version: changes with the names, so that the filter can be kept.
        """
        if self._made is None or self._made[0] != version:
            self.warn_of_unknown(names)
            self._made = version, self.filter_of(names)
        return self._made[1]


def guess(pattern: str, names: Iterable[str]) -> str:
    """Return a hint at the name that the user probably meant, "" without one."""
    close = get_close_matches(pattern, list(names)[:MOST_GUESSES], 1)
    return f"; did you mean {close[0]}?" if close else ""


def _side(value: Iterable[str], name: str) -> Patterns:
    patterns = as_patterns(value, name)
    if not patterns:
        raise ValueError(f"{name} must be names or patterns like 'gripper/*', got an empty list")
    return patterns


def _shown(patterns: Patterns) -> Side:
    return patterns[0] if len(patterns) == 1 else patterns


def _is_part(name: str) -> bool:
    """Return whether a name may be that of a part."""
    return f"{PARTS}/" in name


def _fits(name: str, pattern: str) -> bool:
    return fnmatchcase(name, pattern) or fnmatchcase(whole_of(name), pattern)


def _meet(a: Patterns, b: Patterns) -> bool:
    """Return whether a name may match two sides; True for two patterns."""
    return any(
        (is_pattern(p) and is_pattern(q)) or _fits(p, q) or _fits(q, p) for p in a for q in b
    )
