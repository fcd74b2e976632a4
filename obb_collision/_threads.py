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
from collections.abc import Callable
from operator import index, methodcaller
from typing import Any

from obb_collision.words import shown

#: The environment variable that sets the number of threads.
VARIABLE = "OBB_COLLISION_THREADS"
#: The largest number of threads that is taken.
MAX_THREADS = 1024
#: Ranges per thread: rows do not all take equally long, and other programs take cores away.
RANGES = 4

_wake = methodcaller("release")
_take_back = methodcaller("acquire", False)
#: With a limit, as an interrupt just before a wait is noticed after it.
_wait = methodcaller("acquire", True, 0.1)


class ThreadPool:
    """Threads which call what the calling thread calls, too, while it does; daemons.

    Waking one and waiting for it takes some 10 us; a pool of ``concurrent.futures`` takes five
    times as long, more than the calls of a scene of 1,000 boxes. Threads are woken, taken back and
    waited for by single calls of C, which note what they have done: an interrupt comes between
    these calls and finds out how far the last one got.

    number: how many besides the calling one; fewer where no more can be started.
    """

    def __init__(self, number: int) -> None:
        self.size = number
        self._call: Callable[[], None] | None = None
        self._in_use = threading.Lock()
        self._closed = False
        self._wakes: list[threading.Lock] = []  # each held while its thread has nothing to do,
        self._ends: list[threading.Lock] = []  # and each while it has not ended what it began
        try:
            for _ in range(number):
                self._start()
        except RuntimeError:  # the interpreter ends, or can start no more threads
            pass

    def _start(self) -> None:
        wake, end = threading.Lock(), threading.Lock()
        wake.acquire()
        end.acquire()
        name = f"obb_collision_{len(self._wakes) + 1}"
        threading.Thread(target=self._work, args=(wake, end), name=name, daemon=True).start()
        self._wakes.append(wake)
        self._ends.append(end)

    def _work(self, wake: threading.Lock, end: threading.Lock) -> None:
        while True:
            wake.acquire()
            call = self._call
            if call is None:
                return
            call()
            del call  # what it refers to may be large
            end.release()

    def share(self, call: Callable[[], None], number: int, failed: list[BaseException]) -> None:
        """Call ``call``, which raises nothing, here and in ``number`` others, as many as are free.

        It runs nowhere any more on return. An interrupt is appended to ``failed``.
        """
        if not self._in_use.acquire(blocking=False):
            call()  # another thread of the program uses them, or this one does
            return
        woken: list[None] = []
        over: list[list[bool]] = [[] for _ in self._wakes[:number]]
        try:
            self._call = call
            woken.extend(map(_wake, self._wakes[:number]))
            call()
        except BaseException as error:
            failed.append(error)
        while True:
            try:
                for k in range(len(woken)):
                    if not over[k]:  # one that has not begun finds nothing left to do
                        over[k].extend(map(_take_back, (self._wakes[k],)))
                    while not over[k][-1]:
                        over[k].extend(map(_wait, (self._ends[k],)))
                break
            except BaseException as error:
                failed.append(error)
        self._call = None
        self._in_use.release()
        if self._closed:
            self.close()

    def close(self) -> None:
        """End the threads, once they have done what they do."""
        self._closed = True
        if self._in_use.acquire(blocking=False):  # for ever
            self._call = None
            woken: list[None] = []
            woken.extend(map(_wake, self._wakes))


class _Threads:
    """The number of threads, None before it is known, and the pool of all but the calling one."""

    def __init__(self) -> None:
        self.number: int | None = None
        self.pool: ThreadPool | None = None
        self.lock = threading.Lock()

    def forget_pool(self) -> None:
        """In a forked process: threads are not copied, and the lock may be."""
        self.pool, self.lock = None, threading.Lock()

    def workers(self) -> ThreadPool:
        """Return a pool of as many threads as are wanted besides the calling one, or more."""
        pool, wanted = self.pool, threads() - 1
        if pool is None or pool.size < wanted:
            with self.lock:
                pool = self.pool
                if pool is None or pool.size < wanted:
                    if pool is not None:
                        pool.close()
                    pool = self.pool = ThreadPool(wanted)
        return pool


_threads = _Threads()
os.register_at_fork(after_in_child=_threads.forget_pool)


def threads() -> int:
    """Return how many threads questions about many boxes use.

    As ``set_threads`` says, else OBB_COLLISION_THREADS, else the cores this process may use. Small
    questions use one.

    Returns
    -------
    int

    Raises
    ------
    ValueError
        If OBB_COLLISION_THREADS is no whole number from 1 to 1024.

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

    Raises
    ------
    ValueError
        For anything else.

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
    usable = getattr(os, "sched_getaffinity", None)  # Linux only
    return min(len(usable(0)) if usable else os.cpu_count() or 1, MAX_THREADS)


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
    """Call ``kernel(*args, start, stop)`` on ranges of ``count`` rows; return what it returned.

    least: rows below which a second thread does not pay. What a call raises is raised here, once
    no other one runs any more.
    """
    parts = ranges(count, least)
    if len(parts) == 1:
        return [kernel(*args, 0, count)]
    kernel(*args, 0, 0)  # loaded, or compiled, in this thread: it may be forbidden, and be told
    return run_parts(lambda part: kernel(*args, *parts[part]), len(parts))


def run_parts(call: Callable[[int], Any], count: int) -> list[Any]:
    """Return what ``call`` returns for 0 to ``count`` - 1, called by several threads."""
    results: list[Any] = [None] * count
    failed: list[BaseException] = []
    left = iter(range(count))  # no two threads get the same of it

    def work() -> None:
        for part in left:
            try:
                results[part] = call(part)
            except BaseException as error:
                failed.append(error)
            if failed:
                return

    _threads.workers().share(work, min(threads(), count) - 1, failed)
    if failed:
        raise failed[0]
    return results
