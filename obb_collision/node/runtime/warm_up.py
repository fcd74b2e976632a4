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

"""Kernels compiled before a cycle needs them: at the start, or beside the cycles.

Nothing is compiled in the node's process while it runs: numba compiles under one lock, and the
cycle would wait for it. Other processes compile into the cache (see ``warm_up``), and a thread
loads what they made. Only what is requested is loaded, which costs memory and time.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Event, Thread
from time import perf_counter

from obb_collision import _kernel_cache
from obb_collision.accuracy import Accuracy
from obb_collision.node.runtime.running import Garbage
from obb_collision.warm_up import steps
from obb_collision.warm_up.processes import CompileProgress, compile_steps
from obb_collision.warm_up.steps import (
    BOXES,
    MESSAGES,
    NODE_STEPS,
    ROBOTS,
    accuracy_step,
    effect_level_step,
    effect_step,
)
from obb_collision.words import command_line

FIRST_WORD, NEXT_WORD = 2.0, 5.0
"""Seconds until the first line about the progress, and between two lines."""
MEANWHILE = "; effects stay off or on boxes, and pairs on 'obb' meanwhile"
NICENESS = 5
"""Of what compiles beside the cycles: these come first, but it must not starve."""
RETRY = 60.0
"""Seconds after which what could not be made ready is tried again."""
ENDING = 2.0
"""Seconds that the thread has to end what compiles: it looks every tenth of a second."""

Thing = Accuracy | str | tuple[str, Accuracy]
"""A level of ``Accuracy``, the name of an effect, an effect on a level above OBB, or ROBOTS."""


class WarmUp:
    """Which kernels are ready, and a thread that compiles the others.

    info, warning: log a line. stopped: whether the start is to be abandoned.
    """

    def __init__(
        self,
        info: Callable[[str], None],
        warning: Callable[[str], None],
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self._info, self._warning, self._stopped = info, warning, stopped
        self._ready: set[str] = set()
        self._steps: tuple[str, ...] = NODE_STEPS
        self._asked: dict[str, float] = {}  # when it may be requested again
        self._refused: dict[str, str] = {}
        self._queue: SimpleQueue[str | None] = SimpleQueue()
        self._missing: list[str] = []  # requested, and to be compiled
        self._thread: Thread | None = None
        self._closed = Event()
        self._is_cache_full = False
        self._handler = _Forward(warning)
        _kernel_cache.logger.addHandler(self._handler)

    def start(
        self, things: Iterable[Thing], report: Callable[[str], None] = lambda text: None
    ) -> None:
        """Make ready what every cycle needs, and these things.

        report: takes how far compiling is.
        """
        wanted = {BOXES, MESSAGES, effect_step("separations")} | set(map(_step, things))
        self._steps = (*NODE_STEPS, *sorted(wanted - set(NODE_STEPS)))
        needed = [step for step in self._steps if step in wanted]
        missing = self._load(needed)
        if not missing:
            return
        progress = self._compile(missing, self._stopped, 0, report)
        failed = self._load(missing)
        if failed and not progress.stopped:
            self._compile_here(progress.failed.get(failed[0], "it is not in the cache"))

    def has(self, thing: Thing) -> bool:
        """Return whether a thing is ready, and request nothing."""
        return _step(thing) in self._ready

    def is_ready(self, thing: Thing) -> bool:
        """Return whether a thing is ready; if not, request it."""
        step = _step(thing)
        if step in self._ready:
            return True
        if perf_counter() >= self._asked.get(step, 0.0):
            self._asked[step] = float("inf")
            try:
                self._start()
                self._queue.put(step)
            except RuntimeError as error:  # no memory for a thread
                self._refuse(step, str(error))
        return False

    def why_not(self, thing: Thing) -> str:
        """Return the reason why a thing is not ready."""
        return self._refused.get(_step(thing), "kernels being compiled")

    def close(self) -> None:
        """End what compiles: other processes, which must not outlive this one."""
        self._closed.set()
        self._queue.put(None)
        if self._thread is not None:
            self._thread.join(ENDING)
        _kernel_cache.logger.removeHandler(self._handler)

    def _start(self) -> None:
        """Start the thread that compiles, a daemon: the end of the node must not wait for it."""
        if self._thread is None:
            thread = Thread(target=self._work, daemon=True, name="warm-up")
            thread.start()
            self._thread = thread

    def _work(self) -> None:
        while not self._closed.is_set():
            self._take_requests(wait=not self._missing)
            # what was compiled meanwhile may have what they need
            missing, self._missing = self._load(self._missing), []
            if not missing or self._closed.is_set():
                continue
            try:
                progress = self._compile(missing, self._closed.is_set, NICENESS, lambda text: None)
                failed = progress.failed
            except Exception as error:  # no memory for processes, for example
                failed = dict.fromkeys(missing, f"{type(error).__name__}: {error}")
            else:
                if progress.stopped:
                    return
            for step in self._load(missing):
                self._refuse(step, failed.get(step, "it is not in the cache"))

    def _take_requests(self, wait: bool) -> None:
        """Load the requested steps that the cache has; the others are compiled next.

        wait: for one request at least.
        """
        asked = [self._queue.get()] if wait else []
        with suppress(Empty):
            while True:
                asked.append(self._queue.get_nowait())
        self._missing += self._load([step for step in asked if step is not None])

    def _refuse(self, step: str, reason: str) -> None:
        self._refused[step] = f"cannot be compiled: {reason}"
        self._asked[step] = perf_counter() + RETRY
        self._warning(
            f"cannot compile kernels for {step} beside the cycles: {reason}; it stays off and is "
            f"retried in {RETRY:.0f} s"
        )

    def _load(self, names: Sequence[str]) -> list[str]:
        """Load the steps that the cache has all of; return the others."""
        for step in names:
            if step in self._ready:
                continue
            try:
                with _kernel_cache.only_loading():
                    steps.run(step)
                self._ready.add(step)
                self._refused.pop(step, None)
                Garbage.settle_more()
            except _kernel_cache.KernelMissingError:
                pass
            except Exception as error:  # it would fail in a cycle, too, where it is counted
                self._warning(f"kernels for {step}: {type(error).__name__}: {error}")
                self._ready.add(step)
        return [step for step in names if step not in self._ready]

    def _compile(
        self,
        missing: list[str],
        stopped: Callable[[], bool],
        niceness: int,
        report: Callable[[str], None],
    ) -> CompileProgress:
        kept = f"cached in {_kernel_cache.places[0]}" if _kernel_cache.places else "not cached"
        self._info(
            f"compiling kernels for {', '.join(missing)} (up to a minute on first use), {kept}"
            f"{MEANWHILE if niceness else ''}; "
            f"{command_line('obb_collision warm-up')} compiles all beforehand"
        )
        report("compiling kernels (up to a minute on first use)")
        start = perf_counter()
        due, noted, done = start + FIRST_WORD, 0, 0

        def look(progress: CompileProgress) -> None:
            nonlocal due, noted, done
            self._take_requests(wait=False)  # what the cache has need not wait for what compiles
            self._load(progress.done[done:])
            done = len(progress.done)
            for note in progress.notes[noted:]:
                self._warning(note)
            noted = len(progress.notes)
            if perf_counter() >= due:
                due = perf_counter() + NEXT_WORD
                text = (
                    f"compiling: {len(progress.kernels)} kernels and {len(progress.done)} of "
                    f"{len(progress.steps)} steps done after {perf_counter() - start:.0f} s, "
                    f"now {', '.join(progress.running)}"
                )
                self._info(text)
                report(text)

        needs_private = self._is_cache_full or _kernel_cache.why_not_kept()
        progress = compile_steps(
            missing,
            private=_kernel_cache.private_place() if needs_private else None,
            niceness=niceness,
            look=look,
            stopped=stopped,
        )
        self._is_cache_full |= bool(progress.unsaved)
        if progress.done and not progress.stopped:
            self._info(
                f"compiled {len(progress.kernels)} kernels for {', '.join(progress.done)} in "
                f"{perf_counter() - start:.1f} s"
            )
        return progress

    def _compile_here(self, reason: str) -> None:
        """Compile all that may ever be switched on, as nothing can be compiled elsewhere later."""
        self._warning(
            f"cannot compile kernels in another process: {reason}; everything that may be switched "
            "on later is compiled before the node starts"
        )
        for step in self._steps:
            if step not in self._ready | self._refused.keys() and not self._stopped():
                start, before = perf_counter(), len(_kernel_cache.compiled.names)
                steps.run(step)
                self._ready.add(step)
                self._info(
                    f"compiled {len(_kernel_cache.compiled.names) - before} kernels for {step} in "
                    f"{perf_counter() - start:.1f} s"
                )


class _Forward(logging.Handler):
    """Forwards log records of the library."""

    def __init__(self, take: Callable[[str], None]) -> None:
        super().__init__()
        self._take = take

    def emit(self, record: logging.LogRecord) -> None:
        self._take(record.getMessage())


def _step(thing: Thing) -> str:
    if isinstance(thing, tuple):
        return effect_level_step(*thing)
    if thing == ROBOTS:
        return ROBOTS
    return accuracy_step(thing) if isinstance(thing, Accuracy) else effect_step(thing)
