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

"""Time: turns of several ways to do the same, and the progress of a run of bounded time.

Others may use the machine: processor time does not run while they do, and a contestant with a bad
turn has other turns. The best turn is the time of a contestant; the median over the turns of the
ratio of two compares them. Where questions use several threads, time on the wall counts instead.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from time import perf_counter, process_time, thread_time
from typing import Any, NamedTuple

import numpy as np

from obb_collision._threads import set_threads, threads
from obb_collision.typing import Floats

Show = Callable[[str], None]
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


def seconds_of(run: Callable[[], object]) -> tuple[float, float]:
    """Return time on the wall and of the processor, of all threads."""
    start, used = perf_counter(), process_time()
    run()
    return perf_counter() - start, process_time() - used


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

    They should have run once before, so that nothing is compiled here.
    """
    clock = thread_time if threads() == 1 else perf_counter
    spent: dict[str, list[float]] = {name: [] for name in contestants}
    end = perf_counter() + seconds
    for turn in range(MOST_TURNS):
        if turn >= LEAST_TURNS and perf_counter() > end:
            break
        for name, run in contestants.items():
            if prepare is not None:
                prepare[name]()
            start = clock()
            run()
            spent[name].append(clock() - start)
    return Times({name: np.array(times) for name, times in spent.items()})


class TimedProgress:
    """Seconds spent of those allowed, and what is being done: a bar, or lines of text."""

    def __init__(self, seconds: float, bar: Any = None) -> None:
        self._start, self._seconds = perf_counter(), seconds
        self._bar, self._last = bar, ""

    @property
    def left(self) -> float:
        """Seconds left."""
        return max(0.0, self._start + self._seconds - perf_counter())

    def leave(self, seconds: float) -> None:
        """Allow this many seconds from now on, at least."""
        self._seconds = max(self._seconds, perf_counter() - self._start + seconds)
        if self._bar is not None:
            self._bar.total = self._seconds

    def show(self, what: str) -> None:
        """Report what comes next."""
        if self._bar is None:
            topic = what.rstrip("0123456789/")  # one line for all numbers of a topic
            if topic != self._last:
                print(f"[{self._seconds - self.left:4.0f} s] {topic}", file=sys.stderr, flush=True)
            self._last = topic
            return
        self._bar.set_description_str(what, refresh=False)
        self._bar.n = round(self._seconds - self.left, 1)
        self._bar.refresh()


@contextmanager
def progress(seconds: float) -> Iterator[TimedProgress]:
    """Show a bar while the block runs, if tqdm is installed and the output is a terminal."""
    try:
        tqdm = import_module("tqdm").tqdm if sys.stderr.isatty() else None
    except ImportError:
        tqdm = None
    if tqdm is None:
        yield TimedProgress(seconds)
        return
    form = "{desc:45.45} {percentage:3.0f}%|{bar}| {elapsed}"
    with tqdm(total=seconds, bar_format=form, file=sys.stderr, leave=False) as bar:
        yield TimedProgress(seconds, bar)
