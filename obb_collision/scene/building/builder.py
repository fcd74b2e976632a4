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

"""The builder: a queue of jobs, a thread for them, and the child process that does them."""

from __future__ import annotations

import os
import signal
import socket
import struct
from collections.abc import Hashable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Condition, Thread
from typing import Any

import numpy as np

from obb_collision import _kernel_cache
from obb_collision._child import Child, MessageError, receive, send
from obb_collision.scene.building.jobs import (
    NO_BUILDER,
    NO_MEMORY,
    TOO_MANY,
    TOO_SLOW,
    BuildError,
    Job,
    Task,
    perform,
)
from obb_collision.shapes import Hull

#: Seconds that the child may take to begin: it takes 1, or 4 where it compiles.
STARTING = 60.0
#: First words of replies.
VALUE, ERROR = "value", "error"
#: Seconds beyond the time of a job after which the child ends itself.
GRACE = 5.0
#: Niceness of the child: its parent comes first.
NICENESS = 5
#: Rows and columns of a matrix for which OpenBLAS reserves its buffer.
MATRIX_SIZE = 128


@dataclass(frozen=True)
class Limits:
    """Limits: seconds and memory (bytes) of one job; waiting: bytes of all jobs that wait."""

    seconds: float = 60.0
    memory: int = 2 << 30
    waiting: int = 512 << 20


class _KilledError(BuildError):
    """A signal ended the child."""


def _more_kernels() -> list[str]:
    """Return the folders with compiled kernels, except the first, the cache."""
    return [str(place) for place in _kernel_cache.places[1:]]


class WorkerProcess:
    """The child process, run from its parent: started when needed, and again after it ended."""

    def __init__(self) -> None:
        self._child: Child | None = None
        self._memory = 0
        self._closed = False

    @property
    def number(self) -> int | None:
        """The process id of the child, None without one."""
        return None if self._child is None else self._child.number

    def run(self, task: Task, limits: Limits) -> Any:
        """Return the result of a task; BuildError where it fails.

        A child that a signal ends, as where memory is short, gets a second chance.
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
            # the socket raises BlockingIOError where the child neither takes nor gives for so long
            microseconds = max(1, round(1e6 * limits.seconds))
            duration = struct.pack("@ll", *divmod(microseconds, 1_000_000))
            with socket.socket(fileno=os.dup(connection.fileno())) as waiting:
                for option in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
                    waiting.setsockopt(socket.SOL_SOCKET, option, duration)
            connection.send((limits.seconds, _more_kernels(), task))
            if not connection.poll(limits.seconds):
                raise BlockingIOError
            reply = receive(connection)
        except BlockingIOError:  # also in the middle of a message
            self.stop()
            raise BuildError(TOO_SLOW, f"{limits.seconds:g} s is the limit") from None
        except MemoryError:
            self.stop()  # half a message may be on its way
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
        """Return how the child ended, and end it if it hasn't."""
        child = self._child
        if child is None:
            return BuildError(NO_BUILDER, f"{before}{after}")
        how, code = child.how(), child.code()
        self.stop()
        kind = BuildError if code is None or code >= 0 else _KilledError
        return kind(NO_BUILDER, f"{before}{how}{after}")

    def stop(self) -> None:
        """End the child, if there is one."""
        child, self._child = self._child, None
        if child is not None:
            child.end()

    def close(self) -> None:
        """End the child for good; a thread that waits for a reply gets a BuildError."""
        self._closed = True
        child = self._child
        if child is not None:
            child.kill()


def main(connection: Connection, memory: int, kernels: list[str]) -> None:
    """Run tasks from a connection until it closes; runs in the child process.

    memory: bytes that the child may add to those it has at the start; kernels: further folders with
    compiled kernels.
    """
    with suppress(OSError):
        os.nice(NICENESS)
    _look_for_kernels_in(kernels)
    _load_ahead()
    _limit_memory(memory)
    connection.send_bytes(b"")  # ready
    with suppress(EOFError, OSError):
        while True:
            try:
                seconds, kernels, task = connection.recv()
            except MemoryError:  # half a message is left in the connection
                send(connection, (ERROR, NO_MEMORY, ""))
                return
            # Ends the child, even if it is blocked and its parent has ended.
            signal.setitimer(signal.ITIMER_REAL, seconds + GRACE)
            _look_for_kernels_in(kernels)
            send(connection, _reply(task))
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            del task


def _look_for_kernels_in(folders: list[str]) -> None:
    """Also look for compiled kernels in the folders of the parent."""
    present = set(map(str, _kernel_cache.places))
    _kernel_cache.places.extend(Path(folder) for folder in folders if folder not in present)


def _load_ahead() -> None:
    """Load libraries and kernels, so that they do not count as memory or time of the first job."""
    import lxml.etree  # noqa: F401  # for DAE

    corners = np.vstack([np.zeros(3), np.eye(3)])
    _ = Hull(corners).local_box  # compiles the kernels that fit boxes, unless cached
    # OpenBLAS ends the process where it can't have its buffer
    np.linalg.svd(np.ones((MATRIX_SIZE, MATRIX_SIZE)) @ np.ones((MATRIX_SIZE, MATRIX_SIZE)))


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
    """Limit the bytes that the child may add to those it has now, where the system can."""
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


#: Limit of jobs that wait.
MOST_WAITING = 20_000


@dataclass
class Outcome:
    """A job, the keys that requested it, and, once it is done, its result or error.

    signature: equal for jobs that do the same.
    """

    job: Job
    signature: Hashable
    keys: set[Hashable]
    result: Any = None
    error: BuildError | None = None


class Builder:
    """Runs the jobs that keys request, in order; a request of a key replaces its earlier one.

    Jobs of equal signatures run once. A job that has begun is finished even if its keys have
    requested another one by then: its outcome is newer than what they have. No method waits.
    """

    def __init__(self) -> None:
        self.limits = Limits()
        """Can be set at any time."""
        self.process = WorkerProcess()
        """The process in which jobs run."""
        self._changed = Condition()
        self._wanted: dict[Hashable, Hashable] = {}  # signatures by key, in the order of requests
        self._waiting: dict[Hashable, Outcome] = {}  # by signature
        self._running: Outcome | None = None
        self._done: list[Outcome] = []
        self._size = 0
        self._closed = False
        self._thread: Thread | None = None

    def __len__(self) -> int:
        return len(self._wanted)

    def request(self, key: Hashable, signature: Hashable, job: Job) -> None:
        """Request a job in place of an earlier request of the key.

        Raises BuildError where too many jobs wait, or nothing can be built.
        """
        with self._changed:
            if self._wanted.get(key) == signature:
                return
            self._leave(key)
            entry = self._waiting.get(signature)
            if self._running is not None and self._running.signature == signature:
                entry = self._running
            elif entry is None:
                try:
                    entry = self._entered(signature, job)
                except BuildError:
                    self._wanted.pop(key, None)
                    raise
            entry.keys.add(key)
            self._wanted[key] = signature
            self._changed.notify()

    def _entered(self, signature: Hashable, job: Job) -> Outcome:
        size = self._size + job.size
        if len(self._waiting) >= MOST_WAITING or size > self.limits.waiting:
            megabytes, most = size >> 20, self.limits.waiting >> 20
            detail = f"{len(self._waiting)} of {megabytes} MB; {MOST_WAITING} of {most} MB"
            raise BuildError(TOO_MANY, f"{detail} is the limit")
        self._start()
        self._size = size
        entry = self._waiting[signature] = Outcome(job, signature, set())
        return entry

    def _leave(self, key: Hashable) -> None:
        """Take a key from the jobs that wait."""
        signature = self._wanted.get(key)
        entry = self._waiting.get(signature)
        if entry is not None:
            entry.keys.discard(key)
            if not entry.keys:
                del self._waiting[signature]
                self._size -= entry.job.size

    def cancel(self, key: Hashable) -> None:
        """Cancel the request of a key."""
        with self._changed:
            self._leave(key)
            self._wanted.pop(key, None)
            if self._running is not None:
                self._running.keys.discard(key)
            for outcome in self._done:
                outcome.keys.discard(key)

    def poll(self) -> list[Outcome]:
        """Return the outcomes since the last call, in order."""
        if not self._done:
            return []
        with self._changed:
            done, self._done = self._done, []
        return [outcome for outcome in done if outcome.keys]

    @property
    def is_busy(self) -> bool:
        """Whether a job runs."""
        return self._running is not None

    @property
    def size(self) -> int:
        """Bytes of all jobs that wait or run."""
        return self._size

    def wants(self, key: Hashable) -> bool:
        """Return whether the request of a key waits or runs."""
        return key in self._wanted

    def close(self) -> None:
        """End the thread and the process; waiting jobs are dropped."""
        with self._changed:
            self._closed = True
            self._waiting.clear()
            self._changed.notify()
        self.process.close()
        if self._thread is not None:
            self._thread.join(2.0)

    def _start(self) -> None:
        if self._closed:
            raise BuildError(NO_BUILDER, "it is closed")
        if self._thread is None:
            thread = Thread(target=self._work, daemon=True, name="builder")
            try:
                thread.start()
            except RuntimeError as error:  # no memory for another one
                raise BuildError(NO_BUILDER, str(error)) from error
            self._thread = thread

    def _work(self) -> None:
        while (outcome := self._next()) is not None:
            try:
                job, task = outcome.job, outcome.job.task()
                done = None if task is None else self.process.run(task, self.limits)
                outcome.result = job.finish(done)
            except BuildError as error:
                outcome.error = error
            except MemoryError:
                outcome.error = BuildError(NO_MEMORY)
            except Exception as error:
                outcome.error = BuildError(NO_BUILDER, f"{type(error).__name__}: {error}")
            self._finish(outcome)
            del outcome  # it may be large
        self.process.stop()

    def _next(self) -> Outcome | None:
        with self._changed:
            while not self._closed:
                for signature in self._wanted.values():
                    self._running = self._waiting.pop(signature, None)
                    if self._running is not None:
                        return self._running
                self._changed.wait()
        return None

    def _finish(self, outcome: Outcome) -> None:
        with self._changed:
            self._running = None
            self._size -= outcome.job.size
            for key in outcome.keys:
                if self._wanted.get(key) == outcome.signature:
                    del self._wanted[key]
            self._done.append(outcome)
