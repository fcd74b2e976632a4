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

"""Settings of the effects of a scene, and the objects selected for each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from obb_collision.geometry.values import SetOnce
from obb_collision.scene.effects.base import ACCURACY, Effect, Setting
from obb_collision.scene.refinement.placed_shapes import AS_PAIRS
from obb_collision.scene.store.patterns import as_patterns, matching
from obb_collision.words import shown

OFF, AUTO, ON = MODES = ("off", "auto", "on")
"""An effect is computed never, on request, or at every check."""


class EffectSettings(SetOnce):
    """The ``Setting`` of each effect, by name."""

    def __init__(
        self, effects: Mapping[str, Effect], settings: Mapping[str, Setting] | None = None
    ) -> None:
        self._effects = effects
        self._settings = settings or {
            name: Setting(values={key: option.default for key, option in effect.options.items()})
            for name, effect in effects.items()
        }
        self._resolved: tuple[int, dict[str, Setting]] | None = None
        modes = {name: setting.mode for name, setting in self._settings.items()}
        self._always = tuple(name for name, mode in modes.items() if mode == ON)
        self.any_possible = any(mode != OFF for mode in modes.values())
        """Whether any effect is not off."""
        self.above_obb = any(
            setting.mode != OFF and setting.values.get(ACCURACY, AS_PAIRS) in ("hull", "mesh")
            for setting in self._settings.values()
        )
        """Whether the accuracy of any effect that is not off is above OBB."""

    @property
    def settings(self) -> dict[str, Setting]:
        """All settings, by the names of effects."""
        return dict(self._settings)

    def __getitem__(self, name: str) -> Setting:
        return self._settings[self.check_name(name)]

    def check_name(self, name: str) -> str:
        """Return the name of an effect; ValueError with the choices for any other text."""
        if not isinstance(name, str) or name not in self._settings:
            choices = ", ".join(self._settings)
            raise ValueError(f"effect must be one of {choices}, got {shown(name)}")
        return name

    def changed(
        self,
        name: str,
        mode: str | None = None,
        objects: Iterable[str] | str | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> EffectSettings:
        """Return settings in which one effect has other values; None keeps a value."""
        setting = self[name]
        available = self._effects[name].options
        if mode is not None and not (isinstance(mode, str) and mode in MODES):
            raise ValueError(f"mode of {name} must be off, auto or on, got {shown(mode)}")
        values = dict(setting.values)
        for key, value in (options or {}).items():
            if key not in available:
                choices = f"has {', '.join(available)}" if available else "has no options"
                raise ValueError(f"effect {name} {choices}; got {key!r}")
            values[key] = available[key].checked(f"{name} {key}", value)
        patterns = setting.objects if objects is None else as_patterns(objects, f"{name} objects")
        new = replace(setting, mode=mode or setting.mode, objects=patterns, values=values)
        return EffectSettings(self._effects, {**self._settings, name: new})

    def reach(self) -> float:
        """Return the distance (m) within which other objects matter to effects that are not off."""
        return max(
            self._settings[name].reach(effect.options) for name, effect in self._effects.items()
        )

    def wanted(self, asked: Iterable[str] | str) -> Sequence[str]:
        """Return the effects to compute: those that are on, and requested ones that are not off."""
        if isinstance(asked, tuple) and not asked:
            return self._always
        if isinstance(asked, np.ndarray) or not isinstance(asked, Iterable):
            raise TypeError(f"effects must be names of effects, got {shown(asked)}")
        requested = (asked,) if isinstance(asked, str) else asked
        names = {self.check_name(name) for name in requested}
        modes = ((name, setting.mode) for name, setting in self._settings.items())
        return [name for name, mode in modes if mode == ON or (mode == AUTO and name in names)]

    def resolved(self, names: Sequence[str | None], version: int) -> Mapping[str, Setting]:
        """Return the settings with masks of the objects selected for each effect.

        names: by slot; version: changes with the names, so that masks can be reused.
        """
        if self._resolved is None or self._resolved[0] != version:
            self._resolved = (
                version,
                {
                    name: setting
                    if "*" in setting.objects
                    else replace(setting, selected=matching(setting.objects, names))
                    for name, setting in self._settings.items()
                },
            )
        return self._resolved[1]
