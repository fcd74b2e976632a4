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

"""Patterns for names of objects such as ``gripper/*``, case-sensitive, and values by pattern."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from fnmatch import translate
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.words import MAX_PATTERN, shown, text_fault


def as_patterns(value: Iterable[str] | str, name: str) -> tuple[str, ...]:
    """Return one or several patterns as a tuple; else ValueError naming the argument.

    A pattern is printable text of at most 1000 characters.
    """
    many = isinstance(value, Iterable) and getattr(value, "ndim", 1) > 0
    single = isinstance(value, str) or not many
    patterns: tuple[Any, ...] = (value,) if single else tuple(value)
    for pattern in patterns:
        if not isinstance(pattern, str) or text_fault(pattern, MAX_PATTERN):
            got = shown(pattern)
            raise ValueError(f"{name} must be names or patterns like 'gripper/*', got {got}")
    return patterns


def as_tuples(value: Iterable[Any], name: str, length: int) -> list[tuple[Any, ...]]:
    """Return tuples of one length; else ValueError naming the argument."""
    try:
        rows = [() if isinstance(row, str) else tuple(row) for row in value]
    except TypeError:
        rows = [()]
    if any(len(row) != length for row in rows):
        raise ValueError(f"{name} must be a list of tuples of {length}, got {shown(value)}")
    return rows


def is_pattern(text: str) -> bool:
    """Return whether a text may match other names than itself."""
    return any(letter in text for letter in "*?[")


PARTS = "#"
"""Ends the namespace of the parts of a body: ``wall/1#/0`` and ``wall/1#/1`` are ``wall/1``."""
PART = re.compile(rf"(.*/-?[0-9]{{1,10}}){PARTS}/[0-9]+", re.DOTALL).fullmatch


def whole_of(name: str) -> str:
    """Return the name of the body that a name is a part of, else the name itself."""
    part = PART(name) if f"{PARTS}/" in name else None
    return name if part is None else part[1]


def matching(patterns: Collection[str], names: Sequence[str | None]) -> NDArray[np.bool_]:
    """Return (n,) whether each name matches any of the patterns; None matches none.

    What matches a body matches its parts.
    """
    whole = {pattern for pattern in patterns if not is_pattern(pattern)}
    matches = [re.compile(translate(p)).match for p in patterns if p not in whole]

    def fits(name: str) -> bool:
        if name in whole or any(match(name) for match in matches):
            return True
        body = whole_of(name)
        return body is not name and fits(body)

    return np.fromiter((name is not None and fits(name) for name in names), np.bool_, len(names))


#: Limit of overrides: one for each object of a node by default.
MAX_OVERRIDES = 20000
#: Largest padding by name, metres.
MAX_PADDING = 1000.0

Value = TypeVar("Value")
Override = tuple[str, Accuracy]
"""A pattern of names ``ns/id``, and the level of the objects that match it."""


def override_from_text(text: str) -> Override:
    """Read ``PATTERN: LEVEL``, or ``NAMESPACE=LEVEL`` for a whole namespace."""
    return read_override(text, "mesh", as_accuracy)


def padding_from_text(text: str) -> tuple[str, float]:
    """Read ``PATTERN: METRES``, or ``NAMESPACE=METRES`` for a whole namespace."""
    return read_override(text, "0.02", _as_padding)


def read_override(text: str, example: str, read: Callable[[str], Value]) -> tuple[str, Value]:
    """Read ``PATTERN: VALUE``, or ``NAMESPACE=VALUE`` for a whole namespace.

    example: of a value, for the ValueError.
    """
    parts = re.fullmatch(r"(.*?)\s*([:=])\s*([\w.+-]*)", text)
    if parts is None:
        raise ValueError(f"{text!r} is not like 'gripper/*: {example}' or 'gripper={example}'")
    where, sign, value = parts.groups()
    return where + ("/*" if sign == "=" else ""), read(value)


def _as_padding(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"padding must be a number, got {text!r}") from None
    if not 0.0 <= value <= MAX_PADDING:
        raise ValueError(f"padding must be between 0 and {MAX_PADDING:g} m, not {text}")
    return value


class Overrides(Generic[Value]):
    """Values by pattern; the last one that matches a name counts."""

    def __init__(self, overrides: Sequence[tuple[str, Value]] = ()) -> None:
        self.overrides = tuple(overrides)
        numbered = list(enumerate(self.overrides))
        self._names = {where: number for number, (where, _) in numbered if not is_pattern(where)}
        self._tests = [
            (number, re.compile(translate(where)).match)
            for number, (where, _) in reversed(numbered)
            if is_pattern(where)
        ]

    def __bool__(self) -> bool:
        return bool(self.overrides)

    def value(self, name: str) -> Value | None:
        """Return the value for a name, None where no pattern matches the name or its body."""
        last = self._last(name)
        if (body := whole_of(name)) is not name:
            last = max(last, self._last(body))
        return None if last < 0 else self.overrides[last][1]

    def _last(self, name: str) -> int:
        """Return the number of the last override that matches, -1 for none."""
        by_name = self._names.get(name, -1)
        by_pattern = (number for number, match in self._tests if number > by_name and match(name))
        return next(by_pattern, by_name)
