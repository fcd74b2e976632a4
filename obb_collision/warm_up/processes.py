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

"""Processes that compile steps, and their progress.

Compiling holds numba's lock, and half of the time the interpreter's. A busy process therefore lets
others compile, and loads the kernels from the cache.

A process receives names of steps, and sends events, each with a text and the kernels that could not
be saved. It ends as soon as its connection is closed.
"""

from __future__ import annotations

import gc
import logging
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from traceback import format_exception_only

from obb_collision._child import Child, MessageError, receive, send
from obb_collision._kernel_cache import compiled, logger, places, unsaved
from obb_collision._threads import usable_cores
from obb_collision.warm_up import steps

#: Maximum number of processes: more would compile common kernels several times.
MOST_PROCESSES = 2
#: Seconds between two checks whether to stop.
GLANCE = 0.1
#: New objects between two garbage collections: every 700, as by default, they take a sixth of the
#: time, as most objects of the compiler stay.
OBJECTS = 50_000


@dataclass
class CompileProgress:
    """The progress of compiling: steps that are done or running, and kernels compiled.

    failed: reasons by step; stopped: whether it was stopped before the end; notes: lines to print.
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
    """Compile the kernels of steps that the cache lacks, in ``count`` processes.

    private: a second folder for kernels. look: called with the progress at each event, and every
    tenth of a second. stopped: called then, too; tells whether to stop.
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
    except OSError as error:  # a process could not be started
        progress.failed |= dict.fromkeys([*waiting, *progress.running], str(error))
    finally:
        for worker in workers:
            worker.child.end()
    for step in () if progress.stopped else waiting:
        progress.failed.setdefault(step, "no process was left to compile it")
    return progress


class _Worker:
    """A process that compiles one step at a time."""

    def __init__(self, private: Path | None) -> None:
        self.child = Child(f"{__name__}:work", "" if private is None else str(private))
        self._step: str | None = None

    def give(self, waiting: list[str], progress: CompileProgress) -> None:
        """Give the process the next step."""
        self._step = waiting.pop(0) if waiting else None
        if self._step is not None:
            progress.running.append(self._step)
            with suppress(OSError):  # the process has ended; ``take`` reports it
                send(self.child.connection, self._step)

    def take(self, waiting: list[str], progress: CompileProgress) -> bool:
        """Receive an event of the process; return whether more may follow."""
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


class NoteHandler(logging.Handler):
    """Passes the text of log records to a function."""

    def __init__(self, take: Callable[[str], None]) -> None:
        super().__init__()
        self._take = take

    def emit(self, record: logging.LogRecord) -> None:
        """Pass the text of a record on."""
        self._take(record.getMessage())


def work(connection: Connection, private: str) -> None:
    """Run steps in this process. private: a second folder for kernels, or empty."""
    gc.set_threshold(OBJECTS)
    queue: SimpleQueue[str] = SimpleQueue()
    Thread(target=_read, args=(connection, queue), daemon=True).start()

    def tell(event: str, text: str, lost: tuple[str, ...] = ()) -> None:
        try:
            send(connection, (event, text, lost))
        except OSError:  # the parent has ended
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
    """Send log lines of this package, and names of kernels as they are compiled."""
    logger.handlers = [NoteHandler(partial(tell, "note"))]
    logger.propagate = False
    count = 0

    def say() -> None:
        nonlocal count
        for name in compiled.names[count:]:
            tell("kernel", name)
        count = len(compiled.names)

    compiled.say = say


def _run(step: str) -> str:
    """Run a step; return its error, "" for none."""
    try:
        steps.run(step)
        return ""
    except Exception as failure:
        return "".join(format_exception_only(failure)).strip()
