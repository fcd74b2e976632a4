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

"""Results of an attack: what was sent and seen, growth of the node, and what of it is a fault."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from statistics import median

from tools.fuzz.process import Usage

WARM_UP = 0.2
"""Share of the samples before the first one that counts."""
FEWEST = 40
"""Samples from which on growth is judged."""


class Usages:
    """Samples of what a process uses, of which a share at the beginning is warm-up."""

    def __init__(self, warm_up: float = WARM_UP, window: float = WARM_UP) -> None:
        self.samples: list[Usage] = []
        self._warm_up, self._window = warm_up, window

    def add(self, usage: Usage | None) -> None:
        """Add a sample, if there is one."""
        if usage is not None:
            self.samples.append(usage)

    def ends(self) -> tuple[Usage, Usage]:
        """Return the medians of samples after warm-up, and of as many at the end."""
        count = len(self.samples)
        start, size = int(self._warm_up * count), max(1, round(self._window * count))
        early, late = self.samples[start : start + size], self.samples[-size:]
        first, last = (Usage(*map(median, zip(*part, strict=True))) for part in (early, late))
        return first, last

    def growth(self) -> Usage | None:
        """Return by how much it uses more at the end; None where there are too few samples."""
        if len(self.samples) < FEWEST:
            return None
        return Usage(*(round(after - before) for before, after in zip(*self.ends(), strict=True)))

    def course(self) -> list[float]:
        """Return the median memory (bytes) of each tenth of the samples, in their order."""
        size = max(1, len(self.samples) // 10)
        parts = [self.samples[k : k + size] for k in range(0, len(self.samples), size)]
        return [median(usage.memory for usage in part) for part in parts]


@dataclass
class Result:
    """What was sent and seen."""

    sent: Counter[str] = field(default_factory=Counter)
    """Messages and requests by topic and service."""
    probes: Counter[str] = field(default_factory=Counter)
    """Answered probes by the way in which their boxes came."""
    again: int = 0
    """Sets of boxes that were sent again, as a hostile one had a later stamp."""
    longest: float = 0.0
    """Longest time between two answers (s)."""
    lost: int = 0
    """Answers that the middleware lost on their way; times without them are not judged."""
    excused: int = 0
    """Times that were longer than allowed only because the machine had other work."""
    late: list[tuple[str, float, float]] = field(default_factory=list)
    """Where one was longer than allowed: the batch, its length and what is allowed."""
    usages: Usages = field(default_factory=Usages)
    received: Counter[str] = field(default_factory=Counter)
    """Messages that the node has received, and those that its queues lost."""
    refused: Counter[str] = field(default_factory=Counter)


MORE = 8
"""Descriptors and threads by which a node may grow after warm-up: of what comes and goes."""


def print_results(results: list[Result]) -> None:
    """Print what was sent and seen by all sessions together."""
    sent, received, probes, refused = Counter[str](), Counter[str](), Counter[str](), Counter[str]()
    for result in results:
        sent += result.sent
        received += result.received
        probes += result.probes
        refused += result.refused
    late = [row for result in results for row in result.late]
    print(f"sent: {sent.total()} ({_listed(sent)})")
    print(f"received by the inputs of the node: {_listed(received)}")
    print(f"probes answered right: {probes.total()} ({_listed(probes)})")
    again = sum(result.again for result in results)
    print(f"sets of boxes sent again, most after hostile ones with later stamps: {again}")
    print(
        f"longest time without an answer: {max(result.longest for result in results):.3f} s; "
        f"{len(late)} times longer than allowed, {sum(result.excused for result in results)} times "
        f"by what other programs took; {sum(result.lost for result in results)} answers lost on "
        "their way"
    )
    for batch, gap, allowed in late[:10]:
        print(f"  during {batch}: {gap:.3f} s, allowed were {allowed:.3f} s")
    for result in results:
        _print_usages(result)
    print(f"refused: {_listed(refused) or 'nothing was read'}")


def _print_usages(result: Result) -> None:
    samples, growth = result.usages.samples, result.usages.growth()
    if samples:
        first, last = samples[0], samples[-1]
        print(
            f"memory of the node: {_megabytes(first.memory)} after the first batch, "
            f"{_megabytes(last.memory)} at the end; by tenths of the attack "
            f"{', '.join(f'{size / 1e6:.0f}' for size in result.usages.course())}"
        )
    if growth is not None:
        print(
            f"after warm-up it grew by {_megabytes(growth.memory)}, {growth.descriptors} "
            f"descriptors, {growth.threads} threads"
        )


def faults(result: Result, most: float) -> list[str]:
    """Return what fell short; most: megabytes by which memory may grow."""
    found = []
    if result.late:
        found.append(
            f"the node was blocked for longer than allowed, first during {result.late[0][0]}"
        )
    growth = result.usages.growth()
    if growth is not None and growth.memory > most * 1e6:
        found.append(f"its memory grew by {_megabytes(growth.memory)}")
    if growth is not None and max(growth.descriptors, growth.threads) > MORE:
        found.append(f"it grew by {growth.descriptors} descriptors, {growth.threads} threads")
    return found


def _megabytes(size: float) -> str:
    return f"{size / 1e6:.1f} MB"


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
