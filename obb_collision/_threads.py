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

"""Kernels on several threads: ranges of rows, one after another, by whichever thread is free.

The answer does not depend on how many threads there are: a kernel writes only the rows of its
range. Python threads and kernels that release the interpreter lock: numba's own threads may not be
used by two threads of a program at once. There is no pool before it is needed, none is left in a
forked process, and where no thread can be started the calling one does all.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable
from itertools import islice
from operator import index
from queue import SimpleQueue
from typing import Any

from obb_collision.words import shown

#: The environment variable that sets the number of threads.
VARIABLE = "OBB_COLLISION_THREADS"
#: The largest number of threads that is taken.
MAX_THREADS = 1024
#: Ranges per thread: rows do not all take equally long, and other programs take cores away.
RANGES = 4


class _Threads:
    """The number of threads, None before it is known, and the helpers of those that call.

    Helpers are daemons that take calls from a queue: waking one takes some 10 us, a pool of
    ``concurrent.futures`` five times as long, more than the calls of a scene of 1,000 boxes.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self.forget()

    def forget(self) -> None:
        """Forget all helpers: a fork copies no threads, but perhaps locks that are held."""
        self.calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._lock, self._helpers = threading.Lock(), 0

    def help(self, call: Callable[[], None], number: int) -> None:
        """Let up to ``number`` helpers call a function; fewer where no thread can start."""
        if self._helpers < number:
            with self._lock:
                try:
                    while self._helpers < number:
                        name = f"obb_collision_{self._helpers + 1}"
                        threading.Thread(target=self._work, name=name, daemon=True).start()
                        self._helpers += 1
                except RuntimeError:  # the interpreter ends, or can start no more threads
                    pass
        for _ in range(number):
            self.calls.put(call)

    def _work(self) -> None:
        while True:
            self.calls.get()()


_threads = _Threads()
os.register_at_fork(after_in_child=_threads.forget)


def threads() -> int:
    """Return how many threads questions about many boxes use.

    As ``set_threads`` says, else OBB_COLLISION_THREADS, a whole number from 1 to 1024, else the
    cores this process may use. Small questions use one.

    Returns
    -------
    int

    Examples
    --------
    >>> oc.threads() >= 1
    True
    """
    if _threads.number is None:
        _threads.number = _default_number()
    return _threads.number


def set_threads(number: int | None) -> int:
    """Set how many threads this process uses; the answers are the same for every number.

    Parameters
    ----------
    number : int or None
        From 1 to 1024; None: what OBB_COLLISION_THREADS says, else the cores it may use.

    Returns
    -------
    int
        The number used from now on.

    Examples
    --------
    >>> oc.set_threads(1)
    1
    >>> oc.set_threads(None) == oc.threads()
    True
    """
    used = _default_number() if number is None else _checked(number, "number")
    _threads.number = used
    return used


def _default_number() -> int:
    text = os.environ.get(VARIABLE, "").strip()
    if text:
        return _checked(int(text) if text.isdecimal() and len(text) < 9 else text, VARIABLE)
    return min(usable_cores(), MAX_THREADS)


def usable_cores() -> int:
    """Return how many cores this process may use."""
    usable = getattr(os, "sched_getaffinity", None)  # Linux only
    return len(usable(0)) if usable else os.cpu_count() or 1


def _checked(number: Any, name: str) -> int:
    try:
        whole = 0 if isinstance(number, bool) else index(number)
    except TypeError:
        whole = 0
    if not 1 <= whole <= MAX_THREADS:
        raise ValueError(
            f"{name} must be a whole number from 1 to {MAX_THREADS}, got {shown(number)}"
        )
    return whole


def ranges(count: int, least: int) -> list[tuple[int, int]]:
    """Return ranges of ``count`` rows, each of ``least`` rows or more: one if they are few."""
    if count < 2 * least or threads() == 1:
        return [(0, count)]
    parts = min(count // least, RANGES * threads())
    parts -= parts % threads() if parts > threads() else 0  # the last would be waited for
    return [(count * k // parts, count * (k + 1) // parts) for k in range(parts)]


def run(kernel: Callable[..., Any], count: int, least: int, *args: Any) -> list[Any]:
    """Return the results of ``kernel(*args, start, stop)`` on ranges of ``count`` rows.

    least: rows below which a second thread does not pay. What a call raises is raised here, once
    no other call runs.
    """
    parts = ranges(count, least)
    if len(parts) == 1:
        return [kernel(*args, 0, count)]
    kernel(*args, 0, 0)  # load or compile it in this thread, which may forbid or report that
    return run_parts(lambda part: kernel(*args, *parts[part]), len(parts))


def run_parts(call: Callable[[int], Any], count: int) -> list[Any]:
    """Return the results of ``call`` for 0 to ``count`` - 1, called by several threads.

    No call runs any more at the end, also after an interrupt: a helper notes its begin and its end
    by single calls of C, and interrupts come only between these.
    """
    results: list[Any] = [None] * count
    failed: list[BaseException] = []
    left = iter(range(count))  # no two threads get the same part
    begun: list[None] = []
    ended: SimpleQueue[None] = SimpleQueue()

    def work() -> None:
        for part in left:
            try:
                results[part] = call(part)
            except BaseException as error:
                failed.append(error)
            if failed:
                return

    def help_out() -> None:
        begun.append(None)
        work()
        ended.put(None)

    over: list[None] = []
    try:
        _threads.help(help_out, min(threads(), count) - 1)
        work()
    except BaseException as error:
        failed.append(error)
    while True:
        try:
            deque(left, maxlen=0)  # a helper that has not begun by now finds nothing left to do
            while len(over) < len(begun):
                over.extend(islice(iter(ended.get, 0), len(begun) - len(over)))
            break
        except BaseException as error:
            failed.append(error)
    if failed:
        raise failed[0]
    return results
