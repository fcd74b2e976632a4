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

"""A scene file in the node: its objects as if by markers, its settings as parameters."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from itertools import count, product
from typing import Any

import numpy as np

from obb_collision.node.messages.conversions import Key, name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import whole_from_text
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.states import State
from obb_collision.node.objects.table import ID_OFFSET
from obb_collision.node.parameters.entries import option_name
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.store.allowed import Rule
from obb_collision.scene.store.patterns import matching
from obb_collision.scene_files import SceneDescription
from obb_collision.words import shown


def keys_from_names(names: Sequence[str]) -> list[Key]:
    """Return the key of each name: ``cup/1`` is id 1 of ``cup``; any other name is a namespace."""
    keys = [_key(name) for name in names]
    taken = {key for key in keys if key is not None}
    result: list[Key] = []
    for name, key in zip(names, keys, strict=True):
        if key is None:
            key = name, next(number for number in count() if (name, number) not in taken)
            taken.add(key)
        result.append(key)
    return result


def _key(name: str) -> Key | None:
    namespace, _, digits = name.rpartition("/")
    number = whole_from_text(digits)
    return None if number is None or not 0 <= number < ID_OFFSET else (namespace, number)


class SceneFile:
    """A scene file: its parameters, its objects, and what may touch."""

    def __init__(self, scene: SceneDescription) -> None:
        self._scene = scene
        self.keys = keys_from_names(scene.names)
        names = [name_from_key(key) for key in self.keys]
        changed = zip(scene.names, names, strict=True)
        self._renamed = {old: new for old, new in changed if old != new}
        self._things = [*zip(names, scene.objects, strict=True)]

    def parameters(self) -> dict[str, Any]:
        """Return the values of parameters that correspond to the settings of the file.

        Allowed pairs are not among them: a parameter can't express exceptions from them.
        """
        scene = self._scene
        values: dict[str, Any] = {
            "groups": self._groups() or [""],
            "padding": float(scene.padding),
            "padding_overrides": self._paddings() or [""],
            "accuracy": scene.accuracy.name.lower(),
            "accuracy_overrides": self._overrides() or [""],
            "time_budget": float(scene.time_budget or 0.0),
        }
        for effect, choice in scene.effects.items():
            if choice.mode is not None:
                values[f"effects.{effect}"] = choice.mode
            if choice.objects is not None and effect in EFFECTS:
                values[option_name(effect, "objects")] = self._patterns(choice.objects) or [""]
            for key, value in choice.options.items():
                default = EFFECTS[effect].options[key].default
                values[option_name(effect, key)] = type(default)(value)
        return values

    def allowed(self) -> list[Rule]:
        """Return the rules of what may touch."""
        return [
            (first, second, rule.allowed)
            for rule in self._scene.allowed
            for first, second in product(
                self._patterns([rule.first]), self._patterns([rule.second])
            )
        ]

    def add_to(self, objects: Objects, now: int) -> list[str]:
        """Add the objects, at rest at the start; returns a line for each that cannot be added."""
        refused = []
        for key, thing in zip(self.keys, self._scene.objects, strict=True):
            try:
                slot = objects.shapes.put(key, thing.shape)
                objects.states.store(np.array([slot]), np.array([thing.pose]), State("", 0, now))
            except RefusedError as error:
                objects.shapes.refuse(key, error.reason, shape=True)
                refused.append(f"{shown(name_from_key(key))} refused, {error}")
        return refused

    def _groups(self) -> list[str]:
        """Return entries of ``groups``, one per name or pattern in them.

        A name with a colon cannot be one there; what uses the group has its members anyway.
        """
        return [
            f"{name}: {shlex.quote(pattern)}"
            for name, patterns in self._scene.groups.items()
            if ":" not in name and name == name.strip()
            for pattern in self._patterns(patterns)
        ]

    def _paddings(self) -> list[str]:
        """Return entries of ``padding_overrides``."""
        paddings = [(name, thing.padding) for name, thing in self._things]
        return [f"{name}: {padding!r}" for name, padding in paddings if padding is not None]

    def _overrides(self) -> list[str]:
        """Return entries of ``accuracy_overrides``, the objects' own behind those of patterns."""
        levels = [(self._patterns([name]), level) for name, level in self._scene.accuracies]
        own = [([name], thing.accuracy) for name, thing in self._things]
        return [
            f"{pattern}: {level.name.lower()}"
            for patterns, level in (*levels, *own)
            if level is not None
            for pattern in patterns
        ]

    def _patterns(self, patterns: Sequence[str]) -> list[str]:
        """Return patterns of names in the node: with the new names of those that have others."""
        old = list(self._renamed)
        new = [self._renamed[old[row]] for row in np.flatnonzero(matching(patterns, old))]
        kept = [pattern for pattern in patterns if "/" in pattern or "*" in pattern]
        return kept + ([] if "*" in patterns else new)
