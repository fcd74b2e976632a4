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

"""What a node uses over time, and what it has kept of it."""

from __future__ import annotations

from statistics import median

from tools.fuzz.process.child import Usage

WARM_UP = 0.2
"""Share of the samples before the first one that counts."""
FEWEST = 40
"""Samples from which on growth is judged."""


class Usages:
    """Samples of what a process uses."""

    def __init__(self) -> None:
        self.samples: list[Usage] = []

    def add(self, usage: Usage | None) -> None:
        """Add a sample, if there is one."""
        if usage is not None:
            self.samples.append(usage)

    def growth(self) -> Usage | None:
        """Return by how much the median of the last samples exceeds that after warm-up.

        None where there are too few samples.
        """
        count = len(self.samples)
        if count < FEWEST:
            return None
        size = int(WARM_UP * count)
        early, late = self.samples[size : 2 * size], self.samples[-size:]
        columns = zip(zip(*early, strict=True), zip(*late, strict=True), strict=True)
        return Usage(*(round(median(after) - median(before)) for before, after in columns))

    def course(self) -> list[float]:
        """Return the median memory (bytes) of each tenth of the samples, in their order."""
        size = max(1, len(self.samples) // 10)
        parts = [self.samples[k : k + size] for k in range(0, len(self.samples), size)]
        return [median(usage.memory for usage in part) for part in parts]
