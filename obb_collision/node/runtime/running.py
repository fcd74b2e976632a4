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

"""Run a node in its own process until a signal."""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from obb_collision.node.runtime.environment import (
    BAD_USAGE,
    SIGNALS,
    handle_signals,
    in_main_thread,
    restored_signals,
)
from obb_collision.node.runtime.inner import release

UNUSABLE = (
    ValueError,
    RuntimeError,  # rclpy's: names and QoS that rcl does not take
    NameValidationException,
    ParameterException,
    InvalidQosOverridesError,
)
"""Exceptions of a node's constructor for invalid parameters, remappings or overrides."""


class Garbage:
    """Settings of Python's garbage collector that avoid long pauses of the node's cycles.

    A full collection visits all container objects: numba, scipy and rclpy create several hundred
    thousand of them, and a collection took 0.08 to 0.3 s, once per second with diagnostics
    subscribed. Objects that exist when the node is ready live as long as it does, so that the
    collector ignores them.
    """

    settled = False

    @classmethod
    def settle(cls) -> None:
        """Exclude all present objects from further collections; only in the node's own process."""
        gc.collect()
        gc.freeze()
        cls.settled = True

    @classmethod
    def settle_more(cls) -> None:
        """Exclude objects loaded since then, too, if ``settle`` was called; takes no time."""
        if cls.settled:
            gc.freeze()


#: Bytes of the largest block after which glibc raises its thresholds (mallopt(3), 32 MB at most).
LARGEST_BLOCK = 31 << 20


def keep_freed_memory() -> None:
    """Let the process keep some 60 MB of what it frees, and not give it back at every cycle.

    Taking it again costs a page fault per 4 kB: a sixth of the time of cycles of 10,000 to 100,000
    boxes. By what glibc does by itself once a block of that size is freed; nothing is written to
    it, so that it takes no memory. Other libraries of C do as they do.
    """
    np.empty(LARGEST_BLOCK, np.uint8)


class Signals:
    """Takes SIGINT and SIGTERM while it is entered; they raise no exception in the running code.

    While the node is made, which may take as long as kernels compile, the first one ends that as
    soon as it can, and the second one ends the process at once. Afterwards the first one calls
    ``action``, once, and the others do nothing.

    A separate thread does so, as soon as a signal arrives: Python runs its handlers between two of
    its instructions only, which a main thread that waits in rclpy, reads, or computes, may be far
    from; the byte that a signal writes wakes the thread at once.
    """

    def __init__(self, action: Callable[[], None]) -> None:
        self.count = 0
        self.making = True
        self._action = action

    def __enter__(self) -> Signals:
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._thread = threading.Thread(target=self._wait, name="signals", daemon=True)
        if in_main_thread():
            self._before = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        self._thread.start()
        handle_signals(lambda *_: None)  # what has no handler writes no byte
        return self

    def __exit__(self, *_: object) -> None:
        handle_signals(signal.SIG_IGN)  # the node is ending
        if in_main_thread():
            signal.set_wakeup_fd(self._before)
        os.write(self._writer, bytes(1))  # ends a thread that still waits
        self._thread.join()
        os.close(self._reader)
        os.close(self._writer)

    def _wait(self) -> None:
        while number := os.read(self._reader, 1)[0]:
            if number not in SIGNALS:  # other signals come by here, too
                continue
            self.count += 1  # before it is asked what is done: the main thread asks in turn
            if not self.making:
                self._action()
                return
            if self.count > 1:
                os._exit(0)
            # not by sys.stderr, which may be in use just then
            os.write(2, b"stopping; a second signal ends the process at once\n")


@restored_signals()
def run_node(
    name: str, make_node: Callable[[Context, Callable[[], bool]], Any], args: Sequence[str] | None
) -> int:
    """Spin a node until SIGINT, SIGTERM or a shutdown of its context; returns the exit code.

    name: of the logger before there is a node. make_node: takes the context, and a function that
    returns whether a signal has come; it may raise ExternalShutdownException then. Returns a node
    with a ``guard``, and ``say_farewell``, which is called when a signal ends it, from another
    thread, while it can still publish.
    """
    context = Context()
    node: Any = None

    def end() -> None:
        # not by rclpy's handlers: they shut the context down at once, and nothing can be published
        try:
            if node is not None:
                node.say_farewell()
        finally:
            context.try_shutdown()

    try:
        with Signals(end) as signals:
            if not init(name, context, None if args is None else list(args)):
                return BAD_USAGE
            try:
                node = make_node(context, lambda: signals.count > 0)
            except UNUSABLE as error:
                get_logger(name).fatal(in_one_line(error))
                return 1
            executor = SingleThreadedExecutor(context=context)
            executor.add_node(node)
            Garbage.settle()
            keep_freed_memory()
            signals.making = False
            if not signals.count:
                spin(executor, partial(node.guard.caught, "executor"))
    except ExternalShutdownException:
        pass
    except Exception:
        if context.ok():  # else it failed because the context is gone
            raise
    finally:
        if node is not None:
            node.destroy_node()
        try_shutdown(context=context)
    return 0


def spin(executor: SingleThreadedExecutor, caught: Callable[[Exception], None]) -> None:
    """Spin until the context ends; other exceptions go to ``caught``.

    Such as a MemoryError for a message that rclpy decodes.
    """
    while True:
        try:
            executor.spin()
            return
        except ExternalShutdownException:
            raise
        except Exception as error:
            caught(error)
            release(executor)


def init(name: str, context: Context, arguments: list[str] | None) -> bool:
    """Initialise a context with ROS arguments; print invalid ones and return False.

    Without the signal handlers of rclpy: they would take the context away from a node being made.
    """
    try:
        rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as error:
        sys.stderr.write(f"{name}: ROS arguments that can't be used: {in_one_line(error)}\n")
        return False
    return True


def in_one_line(error: BaseException) -> str:
    """Return the message of an exception, without line breaks and locations in rcl's sources."""
    text = re.sub(r",? at \S+\.c(pp)?:\d+", "", str(error))
    text = text.removeprefix("failed to initialize rcl: ")
    return " ".join(text.split()) or type(error).__name__


def initial_parameters(name: str, namespace: str, *files: str) -> dict[str, Any]:
    """Return the parameters that a node would get from parameter files, for a launch file.

    A temporary node of that name reads the files, because the rules of ROS for matching entries to
    nodes are complex. Raises RuntimeError where one can't be read.
    """
    context = Context()
    try:
        arguments = [word for file in files for word in ("--params-file", file)]
        context.init(args=["--ros-args", *arguments])
        node = Node(
            name,
            namespace=namespace,
            context=context,
            enable_rosout=False,
            start_parameter_services=False,
            automatically_declare_parameters_from_overrides=True,
        )
        parameters: dict[str, Any] = node.get_parameters_by_prefix("")
        node.destroy_node()
        return {key: parameter.value for key, parameter in parameters.items()}
    finally:
        context.try_shutdown()
