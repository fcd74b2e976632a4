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

"""The process that builds, from the side of the one it builds for."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass

from obb_collision import _kernel_cache
from obb_collision.scene.building.wire import (
    NO_BUILDER,
    NO_MEMORY,
    TOO_SLOW,
    BuildError,
    Message,
    Pipe,
)

#: Seconds that the process may take to begin: it takes 1 idle, 4 where it compiles.
STARTING = 60.0
#: It finds the package where this process did, whatever the current folder is.
CODE = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from obb_collision.scene.building.worker import main; "
    "main(int(sys.argv[2]), json.loads(sys.argv[3]))"
)
#: Libraries reserve memory for each thread, and one job is done at a time.
SINGLE = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


@dataclass(frozen=True)
class Limits:
    """seconds: of a job; memory: bytes of a job; waiting: bytes of all jobs that wait."""

    seconds: float = 60.0
    memory: int = 2 << 30
    waiting: int = 512 << 20


class _KilledError(BuildError):
    """The process was ended by a signal."""


def _more_kernels() -> list[str]:
    """Return the folders of kernels besides the cache."""
    return [str(place) for place in _kernel_cache.places[1:]]


class WorkerProcess:
    """Starts the process when it is needed, and anew when it has ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Pipe | None = None
        self._memory = 0
        self._closed = False

    @property
    def number(self) -> int | None:
        """The number of the process, None while there is none."""
        return None if self._process is None else self._process.pid

    def run(self, message: Message, limits: Limits) -> Message:
        """Return the reply to a message. BuildError with the reason where there is none.

        A process that a signal ends, as where the machine is short of memory, gets a second chance.
        """
        try:
            return self._ask(message, limits)
        except _KilledError:
            if self._closed:
                raise
        try:
            return self._ask(message, limits)
        except _KilledError as error:
            raise BuildError(NO_BUILDER, f"twice, {error.detail}") from None

    def _ask(self, message: Message, limits: Limits) -> Message:
        pipe = self._started(limits)
        more = {"seconds": limits.seconds, "kernels": _more_kernels()}
        try:
            pipe.send(message | more, limits.seconds)
            reply = pipe.receive(limits.seconds)
        except TimeoutError:
            self.stop()
            raise BuildError(TOO_SLOW, f"{limits.seconds:g} s is the limit") from None
        except MemoryError:
            self.stop()  # with half a message in its pipe it is of no use
            raise BuildError(NO_MEMORY) from None
        except (OSError, ValueError) as error:
            raise self._ended(f": {error}") from None
        if reply is None:
            raise self._ended()
        if "refused" in reply:
            raise BuildError(reply["refused"], reply["detail"])
        return reply

    def _started(self, limits: Limits) -> Pipe:
        ended = self._process is not None and self._process.poll() is not None
        if ended or limits.memory != self._memory:
            self.stop()
        if self._pipe is not None:
            return self._pipe
        if not sys.executable:
            raise BuildError(NO_BUILDER, "it does not start: sys.executable is empty")
        path = json.dumps([str(folder) for folder in sys.path])
        self._memory = limits.memory
        try:
            self._process = process = subprocess.Popen(
                [sys.executable, "-c", CODE, path, str(limits.memory), json.dumps(_more_kernels())],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                env=os.environ | SINGLE,
                start_new_session=True,  # Ctrl-C is not meant for it
            )
            assert process.stdin is not None
            assert process.stdout is not None
            pipe = Pipe(process.stdout.fileno(), process.stdin.fileno())
            if self._closed:
                process.kill()
            begun = pipe.receive(STARTING) is not None
        except (OSError, ValueError) as error:
            # no interpreter, no memory to start it, or it does not begin
            raise self._ended(f" {error}", "it does not start: ") from None
        if not begun:
            raise self._ended(before="it does not start: ")
        self._pipe = pipe
        return pipe

    def _ended(self, after: str = "", before: str = "") -> BuildError:
        """Return how the process ended, and end it if it hasn't."""
        process, code = self._process, None
        if process is not None:
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.2)
            code = process.poll()
            self.stop()
        if code is not None and code < 0:
            name = str(-code)
            with suppress(ValueError):
                name = signal.Signals(-code).name
            return _KilledError(NO_BUILDER, f"{before}it was ended by {name}{after}")
        how = "it does not answer" if code is None else f"it ended with exit code {code}"
        return BuildError(NO_BUILDER, f"{before}{how if process else ''}{after}")

    def stop(self) -> None:
        """End the process, if there is one."""
        process, self._process, self._pipe = self._process, None, None
        if process is None:
            return
        with suppress(OSError):
            process.kill()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()
        with suppress(subprocess.TimeoutExpired):  # blocked by a file system: its timer ends it
            process.wait(1.0)

    def close(self) -> None:
        """End the process for good; whoever waits for a reply gets a BuildError."""
        self._closed = True
        process = self._process
        if process is not None:
            with suppress(OSError):
                process.kill()
