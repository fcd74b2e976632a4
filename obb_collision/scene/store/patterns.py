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

"""Patterns for names of objects: ``gripper/*``, ``*`` or a whole name; case counts."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from fnmatch import translate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.words import MAX_PATTERN, shown, text_fault


def as_patterns(value: Iterable[str] | str, name: str) -> tuple[str, ...]:
    """Return patterns from one or several; ValueError naming the argument for anything else.

    They are as the names of objects are: text that can be printed, of at most 1000 characters.
    """
    several = isinstance(value, Iterable) and getattr(value, "ndim", 1) > 0
    one = isinstance(value, str) or not several
    patterns: tuple[Any, ...] = (value,) if one else tuple(value)
    for pattern in patterns:
        if not isinstance(pattern, str) or text_fault(pattern, MAX_PATTERN):
            got = shown(pattern)
            raise ValueError(f"{name} must be names or patterns like 'gripper/*', got {got}")
    return patterns


def as_tuples(value: Iterable[Any], name: str, length: int) -> list[tuple[Any, ...]]:
    """Return tuples of one length; ValueError naming the argument for anything else."""
    try:
        rows = [() if isinstance(row, str) else tuple(row) for row in value]
    except TypeError:
        rows = [()]
    if any(len(row) != length for row in rows):
        raise ValueError(f"{name} must be a list of tuples of {length}, got {shown(value)}")
    return rows


def matching(patterns: Collection[str], names: Sequence[str | None]) -> NDArray[np.bool_]:
    """Return (n,) whether each name, None for nothing, matches any of the patterns."""
    whole = {pattern for pattern in patterns if not set(pattern) & set("*?[")}
    matches = [re.compile(translate(p)).match for p in patterns if p not in whole]
    found = (
        name is not None and (name in whole or any(match(name) for match in matches))
        for name in names
    )
    return np.fromiter(found, np.bool_, len(names))
