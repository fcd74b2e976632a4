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

"""Threads that wait for a call to share: waking one and waiting for it takes some 10 us.

A pool of ``concurrent.futures`` takes five times as long, more than the calls of a scene of 1,000
boxes. Threads are woken, taken back and waited for by single calls of C, which note what they have
done: an interrupt comes between these calls and finds out how far the last one got.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from operator import methodcaller

_wake = methodcaller("release")
_take_back = methodcaller("acquire", False)
#: With a limit, as an interrupt just before a wait is noticed after it.
_wait = methodcaller("acquire", True, 0.1)


class ThreadPool:
    """Threads which call what the calling thread calls, too, while it does; daemons.

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
