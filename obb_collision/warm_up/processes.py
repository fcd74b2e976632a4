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

Names of steps go in; what happens comes out: an event and its values. The process ends with its
connection, at once: who started it has ended, or needs no more of it.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from traceback import format_exception_only
from typing import Any

from obb_collision._kernel_cache import compiled, logger, places, unsaved
from obb_collision._threads import usable_cores
from obb_collision.warm_up import steps

#: More would compile much of what they have in common several times over.
MOST_PROCESSES = 2
#: Seconds between two looks at whether to stop.
GLANCE = 0.1
#: Seconds that a process may take to end.
ENDING = 1.0
#: Objects made between two looks for those that nothing refers to: looking every 700, as Python
#: does, takes a sixth of compiling, which makes many that stay.
OBJECTS = 50_000

CODE = (
    "import sys; sys.path[:] = {path!r}; from obb_collision.warm_up.processes import work; "
    "work({descriptor}, {private!r})"
)


@dataclass
class CompileProgress:
    """CompileProgress: steps that are done, kernels compiled, and what failed.

    failed: why, by step; unsaved: kernels that no folder took; stopped: whether it was stopped
    before all steps were done; notes: lines that a user should read.
    """

    steps: tuple[str, ...]
    done: list[str] = field(default_factory=list)
    running: list[str] = field(default_factory=list)
    kernels: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    unsaved: list[str] = field(default_factory=list)
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
        busy = {worker.connection: worker for worker in workers}
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
            worker.end()
    for step in () if progress.stopped else waiting:
        progress.failed.setdefault(step, "no process was left to compile it")
    return progress


class _Worker:
    """One process."""

    def __init__(self, private: Path | None) -> None:
        if not sys.executable:
            raise OSError("no Python interpreter: sys.executable is empty")
        here, there = socket.socketpair()
        self.connection = Connection(here.detach())
        self._step: str | None = None
        with there:
            code = CODE.format(
                path=sys.path,
                descriptor=there.fileno(),
                private="" if private is None else str(private),
            )
            self._process = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[there.fileno()],
            )

    def give(self, waiting: list[str], progress: CompileProgress) -> None:
        """Give the process the next step."""
        self._step = waiting.pop(0) if waiting else None
        if self._step is not None:
            progress.running.append(self._step)
            with suppress(OSError):  # it has ended, which ``take`` sees
                self.connection.send(self._step)

    def take(self, waiting: list[str], progress: CompileProgress) -> bool:
        """Note an event of the process; return whether there may be more."""
        assert self._step is not None
        try:
            event, values = self.connection.recv()
        except (EOFError, OSError):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(ENDING)
            self.end()
            code = self._process.returncode or 0
            name = signal.Signals(-code).name if code < 0 else f"code {code}"
            progress.failed[self._step] = f"its process ended with {name}"
            progress.running.remove(self._step)
            return False
        if event == "kernel":
            progress.kernels.append(values)
        elif event == "note":
            progress.notes.append(values)
        else:
            lost, error = values
            progress.running.remove(self._step)
            progress.done.append(self._step)
            if error:
                progress.failed[self._step] = error
            elif lost:
                progress.unsaved += lost
                progress.failed[self._step] = f"no folder takes kernels ({lost[0]} and others)"
            self.give(waiting, progress)
        return self._step is not None

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self.connection.close()
        with suppress(subprocess.TimeoutExpired):  # it is blocked by a file system
            self._process.wait(ENDING)


def work(descriptor: int, private: str) -> None:
    """Run steps in this process. private: a second folder for kernels, or nothing."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal; who started this decides
    connection = Connection(descriptor)
    gc.set_threshold(OBJECTS)
    queue: SimpleQueue[str] = SimpleQueue()
    Thread(target=_read, args=(connection, queue), daemon=True).start()

    def tell(event: str, values: Any) -> None:
        try:
            connection.send((event, values))
        except OSError:  # who started this has ended
            os._exit(0)

    _listen(tell)
    if private:
        places.append(Path(private))
    while True:
        tell("done", _run(queue.get()))


def _read(connection: Connection, queue: SimpleQueue[str]) -> None:
    with suppress(EOFError, OSError):
        while True:
            queue.put(connection.recv())
    os._exit(0)


def _listen(tell: Callable[[str, Any], None]) -> None:
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


def _run(step: str) -> tuple[list[str], str]:
    """Run a step; return the kernels that no folder took, and an error, if there is one."""
    try:
        steps.run(step)
        return list(unsaved), ""
    except Exception as failure:
        return [], "".join(format_exception_only(failure)).strip()
