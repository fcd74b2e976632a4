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

"""What is computed beside the pairs, one file per effect: its ``EFFECT``."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from obb_collision.scene.effects.base import Effect


def find_effects() -> dict[str, Effect]:
    """Return the effects of all modules of this folder that have one, by name."""
    modules = (import_module(f"{__name__}.{found.name}") for found in iter_modules(__path__))
    found = [module.EFFECT for module in modules if hasattr(module, "EFFECT")]
    return {effect.name: effect for effect in found}


EFFECTS = find_effects()
