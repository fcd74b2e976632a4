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

"""Effects, computed beside the pairs, one file each: its ``EFFECT``."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType

from obb_collision.accuracy import Accuracy
from obb_collision.scene.effects.base import Effect


def _modules() -> Iterator[ModuleType]:
    for info in iter_modules(__path__):
        module = import_module(f"{__name__}.{info.name}")
        if hasattr(module, "EFFECT"):
            yield module


EFFECTS: dict[str, Effect] = {module.EFFECT.name: module.EFFECT for module in _modules()}
LEVELS: dict[str, tuple[Accuracy, ...]] = {
    module.EFFECT.name: tuple(getattr(module, "BY_LEVEL", ())) for module in _modules()
}
"""By effect: the levels above OBB on which it can be computed."""
