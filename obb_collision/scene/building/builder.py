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

"""A queue of jobs, and the thread that has them built one after another."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Any

from obb_collision.scene.building.jobs import NO_BUILDER, NO_MEMORY, TOO_MANY, BuildError, Job
from obb_collision.scene.building.process import Limits, WorkerProcess

#: Jobs that may wait, whatever their size.
MOST_WAITING = 20_000


@dataclass
class Outcome:
    """A job, the keys that requested it, and, once it is done, the result or the reason for none.

    signature: what jobs that do the same have in common.
    """

    job: Job
    signature: Hashable
    keys: set[Hashable]
    result: Any = None
    error: BuildError | None = None


class Builder:
    """Builds what keys request, in order; of several requests of a key the last one is valid.

    Jobs of equal signatures are done once. A job that has begun is finished even if its keys have
    requested something else by then: its outcome is newer than what they have. No method waits.
    """

    def __init__(self) -> None:
        self.limits = Limits()
        """May be set at any time."""
        self.process = WorkerProcess()
        """Where jobs are done."""
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
        """Request a job, in the place of what the key requested before, which is cancelled.

        Raises BuildError where too much waits already, or nothing can be built.
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
        """Take a key from what waits."""
        signature = self._wanted.get(key)
        entry = self._waiting.get(signature)
        if entry is not None:
            entry.keys.discard(key)
            if not entry.keys:
                del self._waiting[signature]
                self._size -= entry.job.size

    def cancel(self, key: Hashable) -> None:
        """Cancel all that a key requested."""
        with self._changed:
            self._leave(key)
            self._wanted.pop(key, None)
            if self._running is not None:
                self._running.keys.discard(key)
            for outcome in self._done:
                outcome.keys.discard(key)

    def poll(self) -> list[Outcome]:
        """Return the outcomes since the last time, in the order in which they were done."""
        if not self._done:
            return []
        with self._changed:
            done, self._done = self._done, []
        return [outcome for outcome in done if outcome.keys]

    @property
    def is_busy(self) -> bool:
        """Whether a job is being done."""
        return self._running is not None

    @property
    def size(self) -> int:
        """Bytes of all jobs that wait or are being done."""
        return self._size

    def wants(self, key: Hashable) -> bool:
        """Return whether something that a key requested is still to come."""
        return key in self._wanted

    def close(self) -> None:
        """End it; what waits is never built."""
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
                outcome.result = self._build(outcome.job)
            except BuildError as error:
                outcome.error = error
            except MemoryError:
                outcome.error = BuildError(NO_MEMORY)
            except Exception as error:
                outcome.error = BuildError(NO_BUILDER, f"{type(error).__name__}: {error}")
            self._finish(outcome)
            del outcome  # whatever is large
        self.process.stop()

    def _build(self, job: Job) -> Any:
        task = job.task()
        return job.finish(None if task is None else self.process.run(task, self.limits))

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
