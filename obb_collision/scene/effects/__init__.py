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

"""What is computed beside the pairs, one module and one entry per effect."""

from __future__ import annotations

from obb_collision.scene.effects.base import Effect
from obb_collision.scene.effects.clearance import Clearance
from obb_collision.scene.effects.contacts import ContactPatches
from obb_collision.scene.effects.points import Points
from obb_collision.scene.effects.separations import Separations
from obb_collision.scene.effects.sweep import Sweep

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (Separations(), ContactPatches(), Clearance(), Sweep(), Points())
}
