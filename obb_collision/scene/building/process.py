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

"""The process that builds: what the one it builds for sees of it, and what it does itself."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from obb_collision import _kernel_cache
from obb_collision.scene.building.jobs import (
    NO_BUILDER,
    NO_MEMORY,
    TOO_SLOW,
    BuildError,
    Task,
    perform,
)
from obb_collision.scene.building.replies import BadReplyError, receive_reply, send_reply
from obb_collision.shapes import Hull

#: Seconds that the process may take to begin: it takes 1 idle, 4 where it compiles.
STARTING = 60.0
#: It finds the package where this process did, whatever the current folder is.
CODE = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from obb_collision.scene.building.process import main; "
    "main(int(sys.argv[2]), int(sys.argv[3]), json.loads(sys.argv[4]))"
)
#: Libraries reserve memory for each thread, and one job is done at a time.
SINGLE = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
#: Seconds beyond the time of a job after which the process ends itself.
GRACE = 5.0
#: Niceness of the process: the one it builds for comes first.
NICENESS = 5
#: Rows and columns of a matrix that OpenBLAS takes its buffer for.
SOME = 128


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
        self._connection: Connection | None = None
        self._memory = 0
        self._closed = False

    @property
    def number(self) -> int | None:
        """The number of the process, None while there is none."""
        return None if self._process is None else self._process.pid

    def run(self, task: Task, limits: Limits) -> Any:
        """Return the result of a task. BuildError with the reason where there is none.

        A process that a signal ends, as where the machine is short of memory, gets a second chance.
        """
        try:
            return self._ask(task, limits)
        except _KilledError:
            if self._closed:
                raise
        try:
            return self._ask(task, limits)
        except _KilledError as error:
            raise BuildError(NO_BUILDER, f"twice, {error.detail}") from None

    def _ask(self, task: Task, limits: Limits) -> Any:
        connection = self._started(limits)
        try:
            _limit_waiting(connection, limits.seconds)
            connection.send((limits.seconds, _more_kernels(), task))
            if not connection.poll(limits.seconds):
                raise BlockingIOError
            return receive_reply(connection)
        except BlockingIOError:  # also where it does not take, or give, all of a message
            self.stop()
            raise BuildError(TOO_SLOW, f"{limits.seconds:g} s is the limit") from None
        except MemoryError:
            self.stop()  # with half a message on its way it is of no use
            raise BuildError(NO_MEMORY) from None
        except BadReplyError as error:
            self.stop()
            raise BuildError(NO_BUILDER, str(error)) from None
        except (OSError, EOFError) as error:
            raise self._ended(f": {error}" if str(error) else "") from None

    def _started(self, limits: Limits) -> Connection:
        ended = self._process is not None and self._process.poll() is not None
        if ended or limits.memory != self._memory:
            self.stop()
        if self._connection is not None:
            return self._connection
        if not sys.executable:
            raise BuildError(NO_BUILDER, "it does not start: sys.executable is empty")
        self._memory = limits.memory
        here, there = socket.socketpair()
        self._connection = connection = Connection(here.detach())
        path = json.dumps([str(folder) for folder in sys.path])
        given = [str(there.fileno()), str(limits.memory), json.dumps(_more_kernels())]
        try:
            with there:
                self._process = process = subprocess.Popen(
                    [sys.executable, "-c", CODE, path, *given],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    env=os.environ | SINGLE,
                    pass_fds=[there.fileno()],
                    start_new_session=True,  # Ctrl-C is not meant for it
                )
            if self._closed:
                process.kill()
            if not connection.poll(STARTING):
                raise TimeoutError
            connection.recv_bytes(0)
        except (OSError, EOFError, ValueError) as error:
            # no interpreter, no memory to start it, or it does not begin
            raise self._ended(f" {error}", "it does not start: ") from None
        return connection

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
        process, self._process = self._process, None
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
        if process is None:
            return
        with suppress(OSError):
            process.kill()
        with suppress(subprocess.TimeoutExpired):  # blocked by a file system: its timer ends it
            process.wait(1.0)

    def close(self) -> None:
        """End the process for good; whoever waits for a reply gets a BuildError."""
        self._closed = True
        process = self._process
        if process is not None:
            with suppress(OSError):
                process.kill()


def _limit_waiting(connection: Connection, seconds: float) -> None:
    """Have BlockingIOError raised where a process neither takes nor gives for so long."""
    duration = struct.pack("@ll", *divmod(max(1, round(1e6 * seconds)), 1_000_000))
    with socket.socket(fileno=os.dup(connection.fileno())) as one:
        for option in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
            one.setsockopt(socket.SOL_SOCKET, option, duration)


def main(descriptor: int, memory: int, kernels: list[str]) -> None:
    """Do tasks from a connection until that ends: what the process runs.

    memory: bytes that jobs may take beyond what the process has when it begins; kernels: folders of
    kernels besides the cache.
    """
    connection = Connection(descriptor)
    with suppress(OSError):
        os.nice(NICENESS)
    _look_for_kernels_in(kernels)
    _take_what_all_jobs_need()
    _limit_memory(memory)
    connection.send_bytes(b"")  # ready
    with suppress(EOFError, OSError):
        while True:
            try:
                seconds, kernels, task = connection.recv()
            except MemoryError:  # with half a message taken there is no other one
                send_reply(connection, BuildError(NO_MEMORY))
                return
            # Ends the process, even if it is blocked and its parent has ended.
            signal.setitimer(signal.ITIMER_REAL, seconds + GRACE)
            _look_for_kernels_in(kernels)
            send_reply(connection, _reply(task))
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            del task


def _look_for_kernels_in(folders: list[str]) -> None:
    """Use the folders that the process has, to which these kernels are sent, besides the cache."""
    known = set(map(str, _kernel_cache.places))
    _kernel_cache.places.extend(Path(folder) for folder in folders if folder not in known)


def _take_what_all_jobs_need() -> None:
    """Load what would else be part of the memory of the first job, or of its time."""
    import lxml.etree  # noqa: F401  # for DAE

    corners = np.vstack([np.zeros(3), np.eye(3)])
    _ = Hull(corners).local_box  # compiles what fits boxes, where the cache lacks it
    # OpenBLAS ends the process where it can't have its buffer
    np.linalg.svd(np.ones((SOME, SOME)) @ np.ones((SOME, SOME)))


def _reply(task: Task) -> Any:
    try:
        return perform(task)
    except MemoryError:
        return BuildError(NO_MEMORY)
    except BuildError as error:
        return error
    except Exception as error:
        return BuildError(NO_BUILDER, f"{type(error).__name__}: {error}"[:1000])


def _limit_memory(memory: int) -> None:
    """Let the process have so many bytes more, where the system can limit it."""
    try:
        import resource

        now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit = now + memory
        if hard != resource.RLIM_INFINITY:
            limit = min(limit, hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    except (ImportError, OSError, ValueError):
        return
