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
from importlib.metadata import version
from time import perf_counter
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from diagnostic_msgs.srv import SelfTest
from llvmlite.binding import get_host_cpu_name
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.task import Future

import obb_collision as oc
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.self_test.running import Result, compare_all

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

    def _status(self, result: Result) -> DiagnosticStatus:
        values: list[tuple[str, object]] = [
            ("compared", result.compared),
            ("different", result.different),
            ("seconds", f"{result.seconds:.3f}"),
            *((f"difference {number}", text) for number, text in enumerate(result.examples, 1)),
        ]
        level = DiagnosticStatus.WARN if result.reason else DiagnosticStatus.OK
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if result.failed else level,
            name=f"{self._name}: self-test of {result.comparison.name}",
            message=_message(result),
            hardware_id="obb_collision",
            values=[KeyValue(key=key, value=str(value)) for key, value in values],
        )


def _message(result: Result) -> str:
    counts = f"{result.compared} {result.comparison.pieces} compared, {result.different} different"
    text = f"{counts} from exact arithmetic"
    return f"{text}; {result.reason}" if result.reason else text
