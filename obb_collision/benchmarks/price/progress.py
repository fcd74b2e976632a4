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

"""Progress of a run of bounded time: a bar if tqdm is installed, else lines of text."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from time import perf_counter
from typing import Any


class Progress:
    """Seconds spent of those allowed, and what is being done."""

    def __init__(self, seconds: float, bar: Any = None) -> None:
        self._start = perf_counter()
        self._seconds = seconds
        self._bar = bar
        self._last = ""

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
def progress(seconds: float) -> Iterator[Progress]:
    """Show a bar while the block runs, if tqdm is installed and the output is a terminal."""
    if not sys.stderr.isatty():
        yield Progress(seconds)
        return
    try:
        tqdm = import_module("tqdm").tqdm
    except ImportError:
        yield Progress(seconds)
        return
    form = "{desc:45.45} {percentage:3.0f}%|{bar}| {elapsed}"
    with tqdm(total=seconds, bar_format=form, file=sys.stderr, leave=False) as bar:
        yield Progress(seconds, bar)
