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

"""Processes that compile steps, their progress, and what runs in such a process.

Compiling holds a lock of numba's, and the interpreter's half of the time: in a process that has
other things to do, it is done elsewhere, and what is compiled comes by the cache.

Names of steps go in; what happens comes out: an event, a text, and what no folder took. The process
ends with its connection, at once: who started it has ended, or needs no more of it.
"""

from __future__ import annotations

import gc
import logging
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from traceback import format_exception_only

from obb_collision._child import Child, MessageError, receive, send
from obb_collision._kernel_cache import compiled, logger, places, unsaved
from obb_collision._threads import usable_cores
from obb_collision.warm_up import steps

#: More would compile much of what they have in common several times over.
MOST_PROCESSES = 2
#: Seconds between two looks at whether to stop.
GLANCE = 0.1
#: Objects made between two looks for those that nothing refers to: looking every 700, as Python
#: does, takes a sixth of compiling, which makes many that stay.
OBJECTS = 50_000


@dataclass
class CompileProgress:
    """CompileProgress: steps that are done, kernels compiled, and what failed.

    failed: why, by step; stopped: whether it was stopped before all steps were done; notes: lines
    that a user should read.
    """

    steps: tuple[str, ...]
    done: list[str] = field(default_factory=list)
    running: list[str] = field(default_factory=list)
    kernels: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    stopped: bool = False


def compile_steps(
    names: Iterable[str],
    *,
    count: int | None = None,
    private: Path | None = None,
    look: Callable[[CompileProgress], None] = lambda progress: None,
    stopped: Callable[[], bool] = lambda: False,
) -> CompileProgress:
    """Compile what steps need and the cache lacks, in ``count`` processes; returns at the end.

    private: a second folder for kernels. look: called from time to time, and whenever something
    has happened. stopped: asked every tenth of a second.
    """
    progress = CompileProgress(tuple(names))
    waiting = list(progress.steps)
    if count is None:
        count = min(MOST_PROCESSES, usable_cores())
    workers: list[_Worker] = []
    try:
        for _ in range(min(count, len(waiting))):
            workers.append(_Worker(private))
            workers[-1].give(waiting, progress)
        busy = {worker.child.connection: worker for worker in workers}
        while busy and not progress.stopped:
            for ready in wait(list(busy), GLANCE):
                if isinstance(ready, Connection) and not busy[ready].take(waiting, progress):
                    del busy[ready]
            look(progress)
            progress.stopped = stopped()
    except OSError as error:  # no process, no connection
        progress.failed |= dict.fromkeys([*waiting, *progress.running], str(error))
    finally:
        for worker in workers:
            worker.child.end()
    for step in () if progress.stopped else waiting:
        progress.failed.setdefault(step, "no process was left to compile it")
    return progress


class _Worker:
    """One process."""

    def __init__(self, private: Path | None) -> None:
        self.child = Child(f"{__name__}:work", "" if private is None else str(private))
        self._step: str | None = None

    def give(self, waiting: list[str], progress: CompileProgress) -> None:
        """Give the process the next step."""
        self._step = waiting.pop(0) if waiting else None
        if self._step is not None:
            progress.running.append(self._step)
            with suppress(OSError):  # it has ended, which ``take`` sees
                send(self.child.connection, self._step)

    def take(self, waiting: list[str], progress: CompileProgress) -> bool:
        """Note an event of the process; return whether there may be more."""
        assert self._step is not None
        try:
            event, text, lost = receive(self.child.connection)
        except (EOFError, OSError, MessageError):
            progress.failed[self._step] = f"its process: {self.child.how()}"
            progress.running.remove(self._step)
            return False
        if event == "kernel":
            progress.kernels.append(text)
        elif event == "note":
            progress.notes.append(text)
        else:
            progress.running.remove(self._step)
            progress.done.append(self._step)
            if text:
                progress.failed[self._step] = text
            elif lost:
                progress.failed[self._step] = f"no folder takes kernels ({lost[0]} and others)"
            self.give(waiting, progress)
        return self._step is not None


def work(connection: Connection, private: str) -> None:
    """Run steps in this process. private: a second folder for kernels, or nothing."""
    gc.set_threshold(OBJECTS)
    queue: SimpleQueue[str] = SimpleQueue()
    Thread(target=_read, args=(connection, queue), daemon=True).start()

    def tell(event: str, text: str, lost: tuple[str, ...] = ()) -> None:
        try:
            send(connection, (event, text, lost))
        except OSError:  # who started this has ended
            os._exit(0)

    _listen(tell)
    if private:
        places.append(Path(private))
    while True:
        tell("done", _run(queue.get()), tuple(unsaved))


def _read(connection: Connection, queue: SimpleQueue[str]) -> None:
    with suppress(EOFError, OSError):
        while True:
            queue.put(receive(connection))
    os._exit(0)


def _listen(tell: Callable[[str, str], None]) -> None:
    """Pass on what this package logs and the kernels it compiles."""

    class NoteHandler(logging.Handler):
        """Tells what is logged."""

        def emit(self, record: logging.LogRecord) -> None:
            tell("note", record.getMessage())

    logger.handlers = [NoteHandler()]
    logger.propagate = False
    told = 0

    def say() -> None:
        nonlocal told
        for name in compiled.names[told:]:
            tell("kernel", name)
        told = len(compiled.names)

    compiled.say = say


def _run(step: str) -> str:
    """Run a step; return an error, if there is one."""
    try:
        steps.run(step)
        return ""
    except Exception as failure:
        return "".join(format_exception_only(failure)).strip()
