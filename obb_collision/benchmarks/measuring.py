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

"""Timing of contestants in turns, tables of their times, and the machine.

Others may use the machine: processor time does not run while they do, and a contestant with a bad
turn has other turns. The best turn is the time of a contestant; the median over the turns of the
ratio of two compares them. Where questions use several threads, time on the wall counts instead.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from time import perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np

from obb_collision._threads import set_threads, threads
from obb_collision.typing import Floats

Show = Callable[[str], None]
Table = list[list[str]]
#: Minimum and maximum turns per contestant, whatever the time allowed.
LEAST_TURNS, MOST_TURNS = 3, 100


@contextmanager
def on_threads(number: int) -> Iterator[None]:
    """Let our kernels use that many threads in the block."""
    before = threads()
    set_threads(number)
    try:
        yield
    finally:
        set_threads(before)


class Times(NamedTuple):
    """Seconds of every turn (t,) of every contestant."""

    seconds: Mapping[str, Floats]

    def best(self, name: str) -> float:
        """Return the seconds of the best turn."""
        return float(self.seconds[name].min())

    def ratio(self, slow: str, fast: str) -> float:
        """Return how many times longer ``slow`` takes than ``fast``: the median of the turns."""
        return float(np.median(self.seconds[slow] / self.seconds[fast]))


def take_turns(
    contestants: Mapping[str, Callable[[], object]],
    seconds: float,
    prepare: Mapping[str, Callable[[], object]] | None = None,
) -> Times:
    """Time all contestants turn by turn for about ``seconds``; ``prepare`` is not measured.

    Each must have run once before, so that nothing is compiled here.
    """
    clock = thread_time if threads() == 1 else perf_counter
    spent: dict[str, list[float]] = {name: [] for name in contestants}
    end = perf_counter() + seconds
    for turn in range(MOST_TURNS):
        if turn >= LEAST_TURNS and perf_counter() > end:
            break
        for name, run in contestants.items():
            if prepare is not None and name in prepare:
                prepare[name]()
            start = clock()
            run()
            spent[name].append(clock() - start)
    return Times({name: np.array(times) for name, times in spent.items()})


def as_text(lines: Table) -> str:
    """Return a table in columns of spaces."""
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    padded = ("  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) for line in lines)
    return "\n".join(line.rstrip() for line in padded)


def digits(value: float, count: int = 3) -> str:
    """Return a number with that many digits."""
    return f"{value:#.{count}g}".rstrip(".") if value < 10**count else f"{value:,.0f}"


def machine(distributions: Iterable[str]) -> dict[str, Any]:
    """Describe the machine, and the versions of distributions: None if not installed."""
    versions: dict[str, str | None] = {}
    for name in sorted({"numpy", "numba", *distributions}):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    facts = {"machine": platform.machine(), "cores": os.cpu_count()}
    return {**facts, "python": platform.python_version(), "versions": versions}


def machine_line(facts: Mapping[str, Any]) -> str:
    """Return ``machine`` as a line of text."""
    named = (f"{name} {number or 'not installed'}" for name, number in facts["versions"].items())
    head = f"{facts['machine']}, {facts['cores']} cores, Python {facts['python']}"
    return ", ".join([head, *named])
