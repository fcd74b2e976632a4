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

"""The ``Accuracy`` of each object: the scene's, or that of the last override it matches."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import translate

from obb_collision.accuracy import Accuracy, as_accuracy

#: Most overrides: one for each object that a node takes unless told otherwise.
MAX_OVERRIDES = 20000

Override = tuple[str, Accuracy]
"""A pattern of names ``ns/id``, and the level of the objects that match it."""


def override_from_text(text: str) -> Override:
    """Read ``PATTERN: LEVEL``, or ``NAMESPACE=LEVEL`` for all of a namespace.

    ValueError with the reason.
    """
    found = re.fullmatch(r"(.*?)\s*([:=])\s*(\w*)", text)
    if found is None:
        raise ValueError(f"{text!r} is not like 'gripper/*: mesh' or 'gripper=mesh'")
    where, sign, level = found.groups()
    if sign == "=":
        where += "/*"
    elif "/" not in where and "*" not in where:
        hint = f"; all of a namespace are '{where}/*' or '{where}='" if where else ""
        raise ValueError(f"{where!r} in {text!r} is no name like 'gripper/1' or pattern{hint}")
    return where, as_accuracy(level)


class Overrides:
    """Overrides, of which the last one that fits a name counts."""

    def __init__(self, overrides: Sequence[Override] = ()) -> None:
        self.overrides = tuple(overrides)
        numbered = list(enumerate(self.overrides))
        self._names = {where: number for number, (where, _) in numbered if not _is_pattern(where)}
        self._tests = [
            (number, re.compile(translate(where)).match)
            for number, (where, _) in reversed(numbered)
            if _is_pattern(where)
        ]

    def level(self, name: str) -> Accuracy | None:
        """Return the level of an object by its name, None for the scene's."""
        by_name = self._names.get(name, -1)
        by_pattern = (number for number, match in self._tests if number > by_name and match(name))
        last = next(by_pattern, by_name)
        return None if last < 0 else self.overrides[last][1]

    def capped(self, highest: Accuracy) -> Overrides:
        """Return the same with no level above ``highest``."""
        return Overrides([(pattern, min(level, highest)) for pattern, level in self.overrides])


def _is_pattern(where: str) -> bool:
    return any(letter in where for letter in "*?[")
