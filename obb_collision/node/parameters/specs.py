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

"""A parameter of the node: its meaning, range and choices, and how its value is read."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from obb_collision.accuracy import instead_of
from obb_collision.scene.effects.settings import MODES, OFF, ON
from obb_collision.words import MAX_NAME, MAX_OBJECT_NAME, MAX_PATH, check_name, shown

#: Most entries of a list, unless its parameter says otherwise, and most patterns among them: each
#: is compared with the names of all objects.
MAX_ENTRIES = MAX_PATTERNS = 1000
#: Most characters of an entry: two names and what stands between.
MAX_ENTRY = 2 * MAX_OBJECT_NAME + 10
#: How the types of values are called in a reason.
KINDS = {
    float: "a decimal number such as 5.0",
    int: "a whole number",
    str: "a text",
    bool: "true or false",
}


@dataclass(frozen=True)
class Spec:
    """One parameter. ``limits`` are inclusive; ``choices`` are the words or numbers allowed."""

    name: str
    default: Any
    limits: tuple[float, float] | None = None
    choices: tuple[Any, ...] = ()
    fixed: bool = False
    """Read at the start only."""
    optional: bool = False
    """Whether a text may be empty."""
    entry: Callable[[str], Any] | None = None
    """How an entry of a list is read: it raises ValueError for one that can't be used."""
    most: int = MAX_ENTRIES
    """Most entries of a list."""
    description: str = ""

    def means(self, text: str) -> Spec:
        """Return the same with a description."""
        return replace(self, description=text + (" Read at the start only." if self.fixed else ""))

    def descriptor(self) -> ParameterDescriptor:
        """Return what ``ros2 param describe`` shows."""
        descriptor = ParameterDescriptor(
            name=self.name,
            description=self.description,
            read_only=self.fixed,
            # Unquoted off and on are booleans in YAML, and an empty list has no type in ROS.
            dynamic_typing=self.choices == MODES or isinstance(self.default, list),
        )
        if self.choices:
            descriptor.additional_constraints = "one of " + _words(self.choices)
        if self.limits is not None and isinstance(self.default, float):
            low, high = self.limits
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif isinstance(self.default, int) and not isinstance(self.default, bool):
            low, high = (int(limit) for limit in self.limits or (self.choices[0], self.choices[-1]))
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
        return descriptor

    def read(self, value: Any) -> Any:
        """Return a value as the node uses it; ValueError with the reason if it can't be used."""
        if isinstance(self.default, list):
            return self._read_list(value)
        if self.choices == MODES and isinstance(value, bool):
            value = ON if value else OFF
        if type(value) is not type(self.default) and not self.choices:
            kind = KINDS[type(self.default)]
            raise ValueError(f"{self.name} must be {kind}, got {shown(value)}")
        if self.choices and value not in self.choices:
            words = _words(self.choices)
            raise ValueError(
                f"{self.name} must be one of {words}, not {shown(value)}{instead_of(value)}"
            )
        if isinstance(value, str) and (value or not self.optional):
            check_name(value, self.name, MAX_PATH if self.optional else MAX_NAME)
        if self.limits is not None:
            low, high = self.limits
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"{self.name} must be between {low:g} and {high:g}, not {value!r}")
        return value

    def _read_list(self, value: Any) -> list[Any]:
        """Return the entries; an empty text counts as none, for [] has no type in ROS."""
        entries = [value] if isinstance(value, str) else [] if value is None else value
        is_list = isinstance(entries, (list, tuple, array)) and len(entries) <= self.most
        if not is_list or not all(isinstance(entry, str) for entry in entries):
            most = f" of at most {self.most}" if isinstance(entries, (list, tuple, array)) else ""
            raise ValueError(f"{self.name} must be a list of texts{most}, got {shown(value)}")
        kept = [entry.strip() for entry in entries if entry.strip()]
        patterns = sum(any(letter in entry for letter in "*?[") for entry in kept)
        if patterns > MAX_PATTERNS:
            raise ValueError(
                f"{self.name} must have at most {MAX_PATTERNS} patterns, got {patterns}"
            )
        for entry in kept:
            check_name(entry, f"an entry of {self.name}", MAX_ENTRY)
        if self.entry is None:
            return kept
        try:
            return [self.entry(entry) for entry in kept]
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from error


def _words(choices: tuple[Any, ...]) -> str:
    return ", ".join(str(choice) for choice in choices)
