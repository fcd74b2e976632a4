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

"""The service ``~/self_test``: answered from a thread of its own, while cycles go on."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import islice
from time import perf_counter
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.srv import SelfTest
from llvmlite.binding import get_host_cpu_name
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.task import Future

import obb_collision as oc
from obb_collision._kernel_cache import KernelMissingError, only_loading
from obb_collision.node.diagnostics.answer import make_status
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.self_test.comparisons import COMPARISONS, Comparison

ENDING = 1.0
"""Seconds that an ending node waits for the thread: a piece of work takes milliseconds."""


class SelfTestService:
    """Offers the service in every state of the node."""

    def __init__(self, node: Node, name: str, guard: Guard) -> None:
        self._node, self._name, self._guard = node, name, guard
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None
        # a group of its own: one that waits for an answer would hold up the others of its group
        group = MutuallyExclusiveCallbackGroup()
        node.create_service(SelfTest, "~/self_test", self._answer, callback_group=group)

    def close(self) -> None:
        """End a test that runs."""
        self._closed.set()
        if self._thread is not None:
            self._thread.join(ENDING)

    async def _answer(self, request: SelfTest.Request, response: Any) -> Any:
        """Start a test, and answer when it is done; the executor goes on with other callbacks."""
        done = Future()
        thread = threading.Thread(
            target=self._work, args=(done, response), name="self_test", daemon=True
        )
        try:
            thread.start()
        except RuntimeError as error:  # no memory for another one: nothing has passed
            self._guard.caught("self test", error)
            return response
        self._thread = thread
        await done
        return response

    def _work(self, done: Future, response: Any) -> None:
        try:
            start = perf_counter()
            results = [*compare_all(self._closed.is_set)]
            response.id = (
                f"obb_collision {oc.__version__}, numba {version('numba')}, "
                f"{get_host_cpu_name()}, {perf_counter() - start:.2f} s"
            )
            response.passed = bytes([not any(result.failed for result in results)])
            response.status = [self._status(result) for result in results]
        except Exception as error:
            self._guard.caught("self test", error)
        finally:
            done.set_result(None)
            executor = self._node.executor
            if executor is not None and not self._closed.is_set():
                executor.wake()  # it may have nothing else to do

    def _status(self, result: Compared) -> DiagnosticStatus:
        values: list[tuple[str, object]] = [
            ("compared", result.compared),
            ("different", result.different),
            ("seconds", f"{result.seconds:.3f}"),
            *((f"difference {number}", text) for number, text in enumerate(result.examples, 1)),
        ]
        level = DiagnosticStatus.WARN if result.reason else DiagnosticStatus.OK
        text = (
            f"{result.compared} {result.comparison.pieces} compared, {result.different} different"
        )
        text += " from exact arithmetic" + (f"; {result.reason}" if result.reason else "")
        name = f"{self._name}: self-test of {result.comparison.name}"
        return make_status(name, DiagnosticStatus.ERROR if result.failed else level, text, values)


TIME = 1.7
"""Seconds that all comparisons may take together, so that the answer is there within two."""
WORK, PAUSE = 5e-4, 1e-4
"""Seconds of work at a time, and of the pause after it, in which a cycle gets the interpreter."""
SEED = 2026
SHOWN = 3
"""Differences that are told; all are counted."""
STOPPED = "the node ends"
LATE = "no time was left"


@dataclass
class Compared:
    """What one comparison came to: how many pieces were compared, and which of them differ."""

    comparison: Comparison
    compared: int = 0
    different: int = 0
    examples: list[str] = field(default_factory=list)
    seconds: float = 0.0
    reason: str = ""
    """Why it ended before it was complete, "" if it was."""

    @property
    def failed(self) -> bool:
        """Whether anything was wrong, or nothing was compared at all."""
        return self.different > 0 or (self.reason != "" and not self.compared)


def compare_all(
    stopped: Callable[[], bool] = lambda: False,
    clock: Callable[[], float] = time.perf_counter,
    seconds: float = TIME,
) -> Iterator[Compared]:
    """Yield the result of each comparison; what one leaves of its time is the next one's."""
    start = clock()
    for number, comparison in enumerate(COMPARISONS, 1):
        yield compare(comparison, stopped, clock, start + seconds * number / len(COMPARISONS))


def compare(
    comparison: Comparison,
    stopped: Callable[[], bool],
    clock: Callable[[], float],
    end: float,
) -> Compared:
    """Make one comparison until a time; kernels are not compiled, which would hold up cycles."""
    result = Compared(comparison)
    start = paused = clock()
    pieces = comparison.run(np.random.default_rng(SEED))
    try:
        with only_loading():
            while not result.reason:
                differences = [*islice(pieces, 1)]
                if not differences:
                    break
                result.compared += 1
                if differences[0]:
                    result.different += 1
                    result.examples += differences[: SHOWN - len(result.examples)]
                now = clock()
                if now >= end:
                    result.reason = LATE
                elif stopped():
                    result.reason = STOPPED
                elif now - paused >= WORK:
                    time.sleep(PAUSE)
                    paused = clock()
    except KernelMissingError:
        result.reason = "its kernels are not compiled yet"
    except Exception as error:
        result.different += 1
        result.examples.append(f"{type(error).__name__}: {error}")
    result.seconds = clock() - start
    return result
