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

"""A process that runs steps, so that their kernels are in the cache; see ``processes``.

Names of steps come in, a line each; what happens goes out, a line of JSON each: ``kernel``,
``note``, and for each step ``done`` with a list of what could not be kept and an error, if any.
The process ends with its input, at once: who started it has ended, or needs no more of it.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from traceback import format_exception_only
from typing import Any, TextIO

#: Objects made between two looks for those that nothing refers to: looking every 700, as Python
#: does, takes a sixth of compiling, which makes many that stay.
OBJECTS = 50_000


def main(private: str, niceness: int) -> None:
    """Run the process. private: a second folder for kernels, or nothing."""
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
        from obb_collision import _kernel_cache

        _kernel_cache.places.append(Path(private))
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
    from obb_collision._kernel_cache import compiled, logger

    class Notes(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            tell("note", text=record.getMessage())

    logger.handlers = [Notes()]
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
        from obb_collision._kernel_cache import unsaved
        from obb_collision.warm_up import steps

        steps.run(step)
        lost = list(unsaved)
    except Exception as failure:
        lost, error = [], "".join(format_exception_only(failure)).strip()
    tell("done", step=step, unsaved=lost, error=error)
