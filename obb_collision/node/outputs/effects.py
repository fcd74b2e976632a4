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

"""Which effects are requested: those that are on, and those whose topics have subscribers.

An effect of the scene is computed, and a message built, only if it is requested. Kernels that are
not ready yet are compiled beside the cycles first.
"""

from __future__ import annotations

from collections.abc import Mapping

from rclpy.publisher import Publisher

from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.runtime.warm_up import WarmUp
from obb_collision.node.topics.topics import TOPICS, mode_names
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.settings import AUTO, OFF, ON


class Effects:
    """What is requested, by the name of the effect; publishers: of those with a topic."""

    def __init__(
        self, parameters: Parameters, publishers: Mapping[str, Publisher], warm: WarmUp
    ) -> None:
        self._parameters, self._publishers, self._warm = parameters, publishers, warm
        self._names = mode_names()

    def mode(self, name: str) -> str:
        """Return off, auto or on."""
        return self._parameters.mode(name)

    def is_requested(self, name: str) -> bool:
        """Return whether an effect is on, or there are subscribers of a topic that needs it."""
        mode = self.mode(name)
        if mode != AUTO:
            return mode == ON
        if name not in TOPICS:
            return any(name in topic.needs and self.is_requested(n) for n, topic in TOPICS.items())
        return self._publishers[name].get_subscription_count() > 0

    def of_cycle(self) -> frozenset[str]:
        """Return the effects to compute in this cycle."""
        requested = filter(self.is_requested, self._names)
        return frozenset(n for n in requested if n not in EFFECTS or self._warm.is_ready(n))

    def states(self) -> dict[str, str]:
        """Return the state of each effect in words, for /diagnostics."""
        computed = self.of_cycle()
        return {name: self._state(name, computed) for name in self._names}

    def _state(self, name: str, computed: frozenset[str]) -> str:
        mode = self.mode(name)
        if mode == OFF or name in computed:
            return mode if mode == OFF else f"{mode}, computed"
        return f"{mode}, {self._warm.why_not(name) if self.is_requested(name) else 'not requested'}"
