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

"""Result of a run: what was sent and checked, what the node's process holds (Linux), what held."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tools.fuzz.process import Usage
from tools.fuzz.report import Usages

MB = 1e6
WINDOW = 0.1
"""Share of the samples after the warm-up at each end that are compared: their medians."""

HELD = {
    "memory": "memory of the node (MB)",
    "children": "memory of the process that builds shapes (MB)",
}
LEVELS = (50, 95, 99)
FEW = 2
"""Descriptors or threads more at the end than after the warm-up are no growth up to this many."""


@dataclass
class Result:
    """What was sent, checked and measured.

    growth: MB that the node may grow between warm-up and end.
    """

    growth: float
    steps: int = 0
    seconds: float = 0.0
    sent: Counter[str] = field(default_factory=Counter)
    bodies: Counter[str] = field(default_factory=Counter)
    checked: int = 0
    """Answers."""
    pairs: int = 0
    """Colliding pairs in them."""
    unsure: int = 0
    """Pairs too close to call."""
    wrong: int = 0
    failure: dict[str, Any] = field(default_factory=dict)
    """The first wrong answer."""
    stopped: str = ""
    """Why the run ended early."""
    latencies: list[float] = field(default_factory=list)
    usages: Usages = field(default_factory=lambda: Usages(0.0, WINDOW))
    """Since the warm-up."""
    refused: dict[str, int] = field(default_factory=dict)

    def faults(self) -> list[str]:
        """Return what did not hold."""
        found = [self.stopped] if self.stopped else []
        if self.wrong:
            found.append(f"{self.wrong} wrong answers")
        if not self.checked:
            found.append("nothing was checked")
        found += [f"refused: {reason} {count}" for reason, count in self.refused.items()]
        for name, (first, last) in self._held().items():
            limit, unit = (FEW, "") if name in ("descriptors", "threads") else (self.growth, " MB")
            if last - first > limit:
                found.append(f"{name} grew by {last - first:.3g}{unit}")
        return found

    def _held(self) -> dict[str, tuple[float, float]]:
        """Return what the process held after the warm-up and at the end; memory in MB."""
        if not self.usages.samples:
            return {}
        pairs = zip(Usage._fields, *self.usages.ends(), strict=True)
        return {
            name: (first / MB, last / MB) if name in ("memory", "children") else (first, last)
            for name, first, last in pairs
        }

    def lines(self) -> list[str]:
        """Return what to print."""
        sent = ", ".join(f"{topic} {count}" for topic, count in sorted(self.sent.items()))
        bodies = ", ".join(f"{count} {name}" for name, count in sorted(self.bodies.items()))
        rate = self.checked / self.seconds if self.seconds else 0.0
        lines = [
            f"{self.seconds:.0f} s, {self.steps} steps; messages: {sent}",
            f"bodies: {bodies}",
            f"answers checked: {self.checked} ({rate:.0f} per second), wrong: {self.wrong}; "
            f"colliding pairs in them: {self.pairs}, too close to call: {self.unsure}",
        ]
        if self.latencies:
            figures = ", ".join(f"{name} {value:.1f}" for name, value in self.latency().items())
            lines.append(f"from the publication of a step to its answer (ms): {figures}")
        for name, (first, last) in self._held().items():
            what = HELD.get(name, name)
            lines.append(f"{what}: {first:.10g} after the warm-up, {last:.10g} at the end")
        return lines

    def latency(self) -> dict[str, float]:
        """Return percentiles of the latency, and the longest (ms)."""
        if not self.latencies:
            return {}
        times = 1e3 * np.array(self.latencies)
        values = np.percentile(times, LEVELS).round(3).tolist()
        named = dict(zip((f"{level} %" for level in LEVELS), values, strict=True))
        return named | {"longest": round(float(times.max()), 3)}

    def summary(self) -> dict[str, Any]:
        """Return all figures, for a file."""
        names = ("steps", "seconds", "checked", "wrong", "pairs", "unsure", "sent", "bodies")
        figures = {name: getattr(self, name) for name in names}
        more = {"latency (ms)": self.latency(), "after warm-up and at the end": self._held()}
        faults = {"not held": self.faults(), "refused": self.refused, "failure": self.failure}
        samples = [one._asdict() for one in self.usages.samples]
        return figures | more | faults | {"samples": samples}
