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

from obb_collision.accuracy import Accuracy
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
        self.on_boxes: dict[str, list[Accuracy]] = {}
        """Effects that are on boxes until kernels of levels above OBB are ready; and the levels."""

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

    def raised(self, computed: frozenset[str]) -> bool:
        """Return whether some of those on boxes need not stay there; request what they wait for."""
        waiting = {}
        for name, levels in self.on_boxes.items():
            wanted = levels if name in computed else ()
            ready = [self._warm.is_ready((name, level)) for level in wanted]  # requests all
            if not (ready and all(ready)):
                waiting[name] = levels
        raised, self.on_boxes = len(waiting) < len(self.on_boxes), waiting
        return raised

    def states(self) -> dict[str, str]:
        """Return the state of each effect in words, for /diagnostics."""
        computed = self.of_cycle()
        return {name: self._state(name, computed) for name in self._names}

    def _state(self, name: str, computed: frozenset[str]) -> str:
        mode = self.mode(name)
        if mode == OFF:
            return mode
        if name in computed:
            missing = [n for n in self.on_boxes.get(name, ()) if not self._warm.has((name, n))]
            why = "".join(f" on obb: {self._warm.why_not((name, n))}" for n in missing[:1])
            return f"{mode}, computed{why}"
        return f"{mode}, {self._warm.why_not(name) if self.is_requested(name) else 'not requested'}"
