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

"""Which effects are called for: what is on, and what somebody subscribes to.

An effect of the scene is computed, and a topic built, only where this says so. Kernels that are
not ready yet are made ready beside the cycles first.
"""

from __future__ import annotations

from collections.abc import Mapping

from rclpy.publisher import Publisher

from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.parameters.table import MEANINGS
from obb_collision.node.runtime.warm_up import WarmUp
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.settings import AUTO, OFF, ON

TOPICS = {
    "collisions": "collisions",
    "text": "collisions_text",
    "in_collision": "in_collision",
    "collision_status": "collision_status",
    "contacts": "contacts",
    "clearance": "clearances",
    "sweep": "predicted_collisions",
    "points": "points_inside",
    "markers": "~/markers",
    "diagnostics": "/diagnostics",
}
"""The topic of each effect that has one."""
DESCRIBED = ("collisions", "text")
"""Topics that say what the effect ``separations`` gives."""


class Effects:
    """What is called for, by the name of the effect; publishers: of those with a topic."""

    def __init__(
        self, parameters: Parameters, publishers: Mapping[str, Publisher], warm: WarmUp
    ) -> None:
        self._parameters, self._publishers, self._warm = parameters, publishers, warm

    def mode(self, name: str) -> str:
        """Return off, auto or on."""
        return self._parameters.mode(name)

    def is_called(self, name: str) -> bool:
        """Return whether something calls for an effect now."""
        mode = self.mode(name)
        if mode != AUTO:
            return mode == ON
        if name not in TOPICS:
            return any(self.is_called(topic) for topic in DESCRIBED)
        return self._publishers[name].get_subscription_count() > 0

    def of_cycle(self) -> frozenset[str]:
        """Return the effects to compute in this cycle."""
        called = {name for name in TOPICS if self.is_called(name)}
        mode = self.mode("separations")
        if mode == ON or (mode == AUTO and not called.isdisjoint(DESCRIBED)):
            called.add("separations")
        return frozenset(n for n in called if n not in EFFECTS or self._warm.is_ready(n))

    def states(self) -> dict[str, str]:
        """Say in words what becomes of each effect, for /diagnostics."""
        computed = self.of_cycle()
        return {name: self._state(name, computed) for name in MEANINGS}

    def _state(self, name: str, computed: frozenset[str]) -> str:
        mode = self.mode(name)
        if mode == OFF or name in computed:
            return mode if mode == OFF else f"{mode}, computed"
        return f"{mode}, {self._warm.why_not(name) if self.is_called(name) else 'not called for'}"
