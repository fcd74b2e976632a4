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

Names of steps go in, a line each; what happens comes out, a line of JSON each: ``kernel``,
``note``, and for each step ``done`` with a list of what could not be kept and an error, if any.
The process ends with its input, at once: who started it has ended, or needs no more of it.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import selectors
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from time import monotonic
from traceback import format_exception_only
from typing import Any, TextIO

from obb_collision._kernel_cache import compiled, logger, places, unsaved
from obb_collision.warm_up import steps

#: More would compile much of what they have in common several times over.
MOST_PROCESSES = 2
#: Seconds between two looks at whether to stop.
GLANCE = 0.1
#: Seconds without a kernel compiled or a step done after which a process counts as hanging: the
#: slowest kernels take 15 s where others have the processors, and a small board is slower.
PATIENCE = 600.0
#: Seconds that a process may take to end.
ENDING = 1.0
#: Objects made between two looks for those that nothing refers to: looking every 700, as Python
#: does, takes a sixth of compiling, which makes many that stay.
OBJECTS = 50_000

CODE = (
    "import sys; sys.path[:] = {path!r}; from obb_collision.warm_up.processes import work; "
    "work({private!r}, {niceness!r})"
)


@dataclass
class CompileProgress:
    """CompileProgress: steps that are done, kernels compiled, and what failed.

    failed: why, by step; hung: those of them whose process took too long; unsaved: kernels that no
    folder took; stopped: whether it was stopped before all steps were done; notes: lines that a
    user should read.
    """

    steps: tuple[str, ...]
    done: list[str] = field(default_factory=list)
    running: list[str] = field(default_factory=list)
    kernels: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    hung: list[str] = field(default_factory=list)
    unsaved: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stopped: bool = False


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def compile_steps(
    names: Iterable[str],
    *,
    count: int | None = None,
    private: Path | None = None,
    niceness: int = 0,
    patience: float = PATIENCE,
    look: Callable[[CompileProgress], None] = lambda progress: None,
    stopped: Callable[[], bool] = lambda: False,
) -> CompileProgress:
    """Compile what steps need and the cache lacks, in ``count`` processes; returns at the end.

    The longest steps have parts that are steps of their own, see ``steps.BESIDE``.

    private: a second folder for kernels. patience: seconds without a sign of life after which a
    process is ended, its step has failed, and a new one takes the steps that are left. look: called
    from time to time, and whenever something has happened. stopped: asked every tenth of a second.
    """
    wanted = [part for step in names for part in (step, *steps.BESIDE.get(step, ()))]
    progress = CompileProgress(tuple(dict.fromkeys(wanted)))
    waiting = list(progress.steps)
    if count is None:
        count = min(MOST_PROCESSES, cores())
    workers: list[_Worker] = []
    with selectors.DefaultSelector() as selector:

        def start() -> None:
            worker = _Worker(private, niceness)
            workers.append(worker)
            selector.register(worker.out, selectors.EVENT_READ, worker)
            worker.give(waiting, progress)

        try:
            for _ in range(min(count, len(waiting))):
                start()
            while selector.get_map() and not progress.stopped:
                for key, _ in selector.select(GLANCE):
                    if not key.data.take(waiting, progress):
                        selector.unregister(key.fileobj)
                for key in list(selector.get_map().values()):
                    if key.data.hangs(patience):
                        selector.unregister(key.fileobj)
                        key.data.give_up(patience, progress)
                        if waiting:
                            start()
                look(progress)
                progress.stopped = stopped()
        except OSError as error:  # no process, no pipe
            progress.failed |= dict.fromkeys([*waiting, *progress.running], str(error))
        finally:
            for worker in workers:
                worker.end()
    for step in () if progress.stopped else waiting:
        progress.failed.setdefault(step, "no process was left to compile it")
    return progress


class _Worker:
    """One process."""

    def __init__(self, private: Path | None, niceness: int) -> None:
        code = CODE.format(
            path=sys.path, private="" if private is None else str(private), niceness=niceness
        )
        if not sys.executable:
            raise OSError("no Python interpreter: sys.executable is empty")
        self._process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self.out = self._process.stdin, self._process.stdout
        self._rest = b""
        self._step: str | None = None
        self._last_message = monotonic()

    def give(self, waiting: list[str], progress: CompileProgress) -> None:
        """Give the process the next step."""
        self._step = waiting.pop(0) if waiting else None
        if self._step is None:
            return
        progress.running.append(self._step)
        with suppress(BrokenPipeError):  # it has ended, which ``take`` sees
            self._in.write(f"{self._step}\n".encode())
            self._in.flush()

    def take(self, waiting: list[str], progress: CompileProgress) -> bool:
        """Read what the process has written; return whether there may be more."""
        data = os.read(self.out.fileno(), 1 << 16)
        self._last_message = monotonic()
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._note(json.loads(line), waiting, progress)
        if not data and self._step is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(ENDING)
            self.end()
            code = self._process.returncode or 0
            name = signal.Signals(-code).name if code < 0 else f"code {code}"
            progress.failed[self._step] = f"its process ended with {name}"
            progress.running.remove(self._step)
        return bool(data) and self._step is not None

    def _note(self, said: dict[str, Any], waiting: list[str], progress: CompileProgress) -> None:
        if said["event"] == "kernel":
            progress.kernels.append(said["name"])
        elif said["event"] == "note":
            progress.notes.append(said["text"])
        else:
            step, lost = said["step"], said["unsaved"]
            progress.running.remove(step)
            progress.done.append(step)
            if said["error"]:
                progress.failed[step] = said["error"]
            elif lost:
                progress.unsaved += lost
                progress.failed[step] = f"no folder takes kernels ({lost[0]} and others)"
            self.give(waiting, progress)

    def hangs(self, patience: float) -> bool:
        """Return whether nothing has come from the process for too long."""
        return self._step is not None and monotonic() - self._last_message > patience

    def give_up(self, patience: float, progress: CompileProgress) -> None:
        """End a process that hangs; its step has failed."""
        self.end()
        if self._step is not None:
            progress.running.remove(self._step)
            progress.hung.append(self._step)
            progress.failed[self._step] = f"no kernel was compiled for {patience:g} s"

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        for pipe in (self._in, self.out):
            with suppress(OSError):
                pipe.close()
        with suppress(subprocess.TimeoutExpired):  # it is blocked by a file system
            self._process.wait(ENDING)


def work(private: str, niceness: int) -> None:
    """Run steps in this process. private: a second folder for kernels, or nothing."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal; who started this decides
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what else is printed does not belong among the lines
    os.nice(niceness)
    gc.set_threshold(OBJECTS)
    queue: SimpleQueue[str] = SimpleQueue()
    Thread(target=_read, args=(queue,), daemon=True).start()
    tell = _teller(out)
    _listen(tell)
    if private:
        places.append(Path(private))
    while True:
        _run(queue.get(), tell)


def _read(queue: SimpleQueue[str]) -> None:
    for line in sys.stdin:
        queue.put(line.strip())
    os._exit(0)


def _teller(out: TextIO) -> Callable[..., None]:
    def tell(event: str, **values: Any) -> None:
        try:
            out.write(json.dumps({"event": event, **values}) + "\n")
            out.flush()
        except OSError:  # the reader has ended
            os._exit(0)

    return tell


def _listen(tell: Callable[..., None]) -> None:
    """Pass on what this package logs and the kernels it compiles."""

    class NoteHandler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            tell("note", text=record.getMessage())

    logger.handlers = [NoteHandler()]
    logger.propagate = False
    told = 0

    def say() -> None:
        nonlocal told
        for name in compiled.names[told:]:
            tell("kernel", name=name)
        told = len(compiled.names)

    compiled.say = say


def _run(step: str, tell: Callable[..., None]) -> None:
    error = ""
    try:
        steps.run(step)
        lost = list(unsaved)
    except Exception as failure:
        lost, error = [], "".join(format_exception_only(failure)).strip()
    tell("done", step=step, unsaved=lost, error=error)
