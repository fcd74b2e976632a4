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

import os
import signal
import socket
import struct
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from obb_collision import _kernel_cache
from obb_collision._child import Child, MessageError, receive, send
from obb_collision.scene.building.jobs import (
    NO_BUILDER,
    NO_MEMORY,
    TOO_SLOW,
    BuildError,
    Task,
    perform,
)
from obb_collision.shapes import Hull

#: Seconds that the process may take to begin: it takes 1 idle, 4 where it compiles.
STARTING = 60.0
#: What replies begin with.
VALUE, ERROR = "value", "error"
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
        self._child: Child | None = None
        self._memory = 0
        self._closed = False

    @property
    def number(self) -> int | None:
        """The number of the process, None while there is none."""
        return None if self._child is None else self._child.number

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
            reply = receive(connection)
        except BlockingIOError:  # also where it does not take, or give, all of a message
            self.stop()
            raise BuildError(TOO_SLOW, f"{limits.seconds:g} s is the limit") from None
        except MemoryError:
            self.stop()  # with half a message on its way it is of no use
            raise BuildError(NO_MEMORY) from None
        except MessageError as error:
            self.stop()
            raise BuildError(NO_BUILDER, str(error)) from None
        except (OSError, EOFError) as error:
            raise self._ended(f": {error}" if str(error) else "") from None
        match reply:
            case (str(kind), value) if kind == VALUE:
                return value
            case (str(kind), str(reason), str(detail)) if kind == ERROR:
                raise BuildError(reason, detail)
        self.stop()
        raise BuildError(NO_BUILDER, "its reply is not understood")

    def _started(self, limits: Limits) -> Connection:
        ended = self._child is not None and self._child.code() is not None
        if ended or limits.memory != self._memory:
            self.stop()
        if self._child is not None:
            return self._child.connection
        self._memory = limits.memory
        try:
            self._child = child = Child(f"{__name__}:main", limits.memory, _more_kernels())
            if self._closed:
                child.kill()
            if not child.connection.poll(STARTING):
                raise TimeoutError
            child.connection.recv_bytes(0)
        except (OSError, EOFError, ValueError) as error:
            # no interpreter, no memory to start it, or it does not begin
            raise self._ended(f" {error}", "it does not start: ") from None
        return child.connection

    def _ended(self, after: str = "", before: str = "") -> BuildError:
        """Return how the process ended, and end it if it hasn't."""
        child = self._child
        if child is None:
            return BuildError(NO_BUILDER, f"{before}{after}")
        how, code = child.how(), child.code()
        self.stop()
        kind = BuildError if code is None or code >= 0 else _KilledError
        return kind(NO_BUILDER, f"{before}{how}{after}")

    def stop(self) -> None:
        """End the process, if there is one."""
        child, self._child = self._child, None
        if child is not None:
            child.end()

    def close(self) -> None:
        """End the process for good; whoever waits for a reply gets a BuildError."""
        self._closed = True
        child = self._child
        if child is not None:
            child.kill()


def _limit_waiting(connection: Connection, seconds: float) -> None:
    """Have BlockingIOError raised where a process neither takes nor gives for so long."""
    duration = struct.pack("@ll", *divmod(max(1, round(1e6 * seconds)), 1_000_000))
    with socket.socket(fileno=os.dup(connection.fileno())) as one:
        for option in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
            one.setsockopt(socket.SOL_SOCKET, option, duration)


def main(connection: Connection, memory: int, kernels: list[str]) -> None:
    """Do tasks from a connection until that ends: what the process runs.

    memory: bytes that jobs may take beyond what the process has when it begins; kernels: folders of
    kernels besides the cache.
    """
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
                send(connection, (ERROR, NO_MEMORY, ""))
                return
            # Ends the process, even if it is blocked and its parent has ended.
            signal.setitimer(signal.ITIMER_REAL, seconds + GRACE)
            _look_for_kernels_in(kernels)
            send(connection, _reply(task))
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


def _reply(task: Task) -> tuple[Any, ...]:
    try:
        return VALUE, perform(task)
    except MemoryError:
        return ERROR, NO_MEMORY, ""
    except BuildError as error:
        return ERROR, error.reason, error.detail
    except Exception as error:
        return ERROR, NO_BUILDER, f"{type(error).__name__}: {error}"[:1000]


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
