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

"""Allowed collision matrices of MoveIt as rules between patterns of names.

As in ``moveit_msgs/AllowedCollisionMatrix``: an entry of the matrix decides; without one, the
defaults of the two names do, both of them if there are two.
"""

from __future__ import annotations

from itertools import product

from obb_collision.scene_files.description import AllowedRule
from obb_collision.scene_files.yaml_values import Value, items_of

KEYS = ("entry_names", "entry_values", "default_entry_names", "default_entry_values")


def read_matrix(value: Value) -> list[AllowedRule]:
    """Return the rules of a matrix, in an order in which the last one that matches a pair is right.

    Entries that forbid what no rule allows are redundant and left out.
    """
    fields = value.fields(KEYS)
    defaults = _read_defaults(fields)
    rules: list[AllowedRule] = []
    for wanted in (True, False):  # where a pair has two defaults, both must allow it
        for name, allowed in defaults.items():
            if allowed == wanted and (allowed or True in defaults.values()):
                rules += rules_with_all(name, allowed)
    for (first, second), allowed in _read_entries(fields).items():
        if allowed or defaults.get(first) or defaults.get(second):
            rules += rules_between(first, second, allowed)
    return rules


def rules_between(first: str, second: str, allowed: bool) -> list[AllowedRule]:
    """Return the rules for all that is called by two names of MoveIt."""
    pairs = product(patterns_of(first), patterns_of(second))
    rules = [AllowedRule(a, b, allowed) for a, b in pairs]
    if first != second:
        return rules
    return [rule for rule in rules if rule.first.endswith("/*") and rule.second.endswith("/*")]


def rules_with_all(name: str, allowed: bool) -> list[AllowedRule]:
    """Return the rules for a name of MoveIt and everything."""
    return [AllowedRule(pattern, "*", allowed) for pattern in patterns_of(name)]


def patterns_of(name: str) -> tuple[str, str]:
    """Return patterns for a name and for its parts ``name/...``, such as markers of a namespace."""
    exact = "".join(f"[{letter}]" if letter in "*?[" else letter for letter in name)
    return exact, f"{exact}/*"


def _read_defaults(fields: dict[str, Value]) -> dict[str, bool]:
    names = items_of(fields, "default_entry_names")
    values = items_of(fields, "default_entry_values")
    if len(names) != len(values):
        fields[next(key for key in KEYS[2:] if key in fields)].refuse(
            f"there are {len(names)} default_entry_names and {len(values)} default_entry_values"
        )
    return {name.text(): flag.flag() for name, flag in zip(names, values, strict=True)}


def _read_entries(fields: dict[str, Value]) -> dict[tuple[str, str], bool]:
    """Return the entry of the matrix per pair of different names."""
    names = [name.text() for name in items_of(fields, "entry_names")]
    rows = items_of(fields, "entry_values")
    if len(rows) != len(names):
        fields[next(key for key in KEYS[:2] if key in fields)].refuse(
            f"there are {len(names)} entry_names and {len(rows)} rows of entry_values"
        )
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        fields["entry_names"].refuse(f"{twice} stands twice")
    matrix = [_read_row(row, len(names)) for row in rows]
    entries: dict[tuple[str, str], bool] = {}
    for i, first in enumerate(names):
        for j, second in enumerate(names[:i]):
            if matrix[i][j] != matrix[j][i]:
                rows[i].refuse(f"not symmetric: {first} with {second} and the other way round")
            entries[second, first] = matrix[i][j]
    return entries


def _read_row(row: Value, count: int) -> list[bool]:
    """Return a row: a list, or the list ``enabled`` of a message."""
    cells = row.fields(("enabled",), ("enabled",))["enabled"] if row.is_mapping else row
    flags = [cell.flag() for cell in cells.items()]
    if len(flags) != count:
        cells.refuse(f"must have {count} entries, one a name, got {len(flags)}")
    return flags
