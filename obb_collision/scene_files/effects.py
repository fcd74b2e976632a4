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

"""The key ``effects`` of a scene file: modes, objects, options."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType

from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.settings import MODES
from obb_collision.scene_files.description import NODE_EFFECTS, EffectChoice
from obb_collision.scene_files.yaml_values import Value

#: Patterns that a word or a list of words stands for.
Patterns = Callable[[Value], tuple[str, ...]]


def read_effects(value: Value, patterns: Patterns) -> dict[str, EffectChoice]:
    """Return the settings of each effect."""
    choices: dict[str, EffectChoice] = {}
    for name, entry in value.fields((*EFFECTS, *NODE_EFFECTS)).items():
        with value.problems.kept():
            choices[name] = _read_effect(name, entry, patterns)
    return choices


def _read_effect(name: str, value: Value, patterns: Patterns) -> EffectChoice:
    if not value.is_mapping:
        return EffectChoice(value.choice(MODES))
    known = EFFECTS[name].options if name in EFFECTS else {}
    places = ("objects",) if name in EFFECTS else ()
    fields = value.fields(("mode", *places, *known))
    mode = fields["mode"].choice(MODES) if "mode" in fields else None
    objects = patterns(fields["objects"]) if "objects" in fields else None
    options: dict[str, float | str] = {}
    for key, option in known.items():
        if key in fields:
            with fields[key].reasons():
                entry = fields[key]
                word = isinstance(option.default, str)
                options[key] = option.checked(key, entry.text() if word else entry.number())
    return EffectChoice(mode, objects, MappingProxyType(options))
