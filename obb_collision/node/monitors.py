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

"""Counting what comes in, what is refused and why, and how long cycles take."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from obb_collision.scene.report import Cost

NANOSECONDS_F = 1e9
MAX_REASONS = 64
"""Reasons counted apart: they are fixed phrases, so this is only a guard."""


@dataclass
class InputMonitor:
    """One input topic: messages, age, refusals by reason; warns at most once a period."""

    topic: str
    warn: Callable[[str], None]
    messages: int = 0
    last: int | None = None
    """Time of the last message (ns)."""
    refused: Counter[str] = field(default_factory=Counter)
    ignored: int | None = None
    """Of the last cloud: points that are not finite; None where nobody looked."""
    mismatches: int = 0
    """Publishers and subscribers seen with incompatible QoS."""
    warn_period: float = 5.0
    _seen: int = 0
    _seen_refused: int = 0
    _next_warning: int = 0
    _unwarned: Counter[str] = field(default_factory=Counter)

    def received(self, now: int) -> None:
        """Count a message."""
        self.messages += 1
        self.last = now

    def refuse(
        self, now: int, reason: str, item: str = "", detail: str = "", count: int = 1
    ) -> None:
        """Count refused items; warn about them now or, soon after a warning, with the next one."""
        if reason not in self.refused and len(self.refused) >= MAX_REASONS:
            reason = "other"
        self.refused[reason] += count
        self._unwarned[reason] += count
        if 0 <= self._next_warning - now < self.warn_period * NANOSECONDS_F:
            return
        self._next_warning = now + int(self.warn_period * NANOSECONDS_F)
        counts = ", ".join(f"{reason}: {n}" for reason, n in self._unwarned.items())
        last = " ".join(part for part in (item, f"({detail})" if detail else "") if part)
        self.warn(f"{self.topic}: refused {counts}" + (f"; last: {last}" if last else ""))
        self._unwarned.clear()

    def since_last_report(self) -> tuple[int, int]:
        """Messages and refused items since this was last called."""
        messages, refused = self.messages - self._seen, self.refused.total() - self._seen_refused
        self._seen, self._seen_refused = self.messages, self.refused.total()
        return messages, refused


@dataclass
class CycleMonitor:
    """Durations of the cycles since the last report, whole and by stage (s)."""

    durations: list[float] = field(default_factory=list)
    stages: dict[str, list[float]] = field(default_factory=dict)
    overruns: int = 0
    """Cycles that took longer than a period, since the start."""
    total: int = 0
    reported_overruns: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    """By effect: the pairs or points that it ran on when it was last computed."""
    failures: Counter[str] = field(default_factory=Counter)
    """By effect: what failed since the start."""
    last_failures: dict[str, str] = field(default_factory=dict)
    reported_failures: int = 0

    def add(self, stages: dict[str, float], period: float) -> None:
        """Count a cycle by its stages (s)."""
        duration = sum(stages.values())
        self.durations.append(duration)
        for name, seconds in stages.items():
            self.stages.setdefault(name, []).append(seconds)
        self.overruns += duration > period
        self.total += 1

    def add_costs(self, costs: Mapping[str, Cost]) -> dict[str, float]:
        """Count what effects took in a cycle; returns their stages (s)."""
        for name, cost in costs.items():
            self.counts[name] = cost.count
            if cost.failures:
                self.failures[name] += len(cost.failures)
                self.last_failures[name] = cost.failures[-1]
        return {f"effect {name}": cost.seconds for name, cost in costs.items()}

    def take(self) -> tuple[list[float], dict[str, list[float]]]:
        """Return the durations, whole and by stage, and begin anew."""
        taken = self.durations, self.stages
        self.reported_overruns = self.overruns
        self.reported_failures = self.failures.total()
        self.durations, self.stages = [], {}
        return taken
