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

"""A node in a process of its own, until a signal."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence

import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown


def run(name: str, make_node: Callable[[Context], Node], args: Sequence[str] | None) -> int:
    """Spin a node until SIGINT, SIGTERM or a shutdown of its context; returns the exit code.

    name: of the logger, for what is said before there is a node.
    """
    # rclpy's handlers wake the executor and then call these. Without them Python would raise
    # KeyboardInterrupt in whatever line runs just then, and a signal from before rclpy's handlers
    # stand would be lost or deadly.
    received: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: received.append(number))
    context = Context()
    arguments = None if args is None else list(args)
    rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.ALL)
    node = None
    try:
        if received:
            return 0
        # first, for rclpy's executor can't be made half once the context is gone
        executor = SingleThreadedExecutor(context=context)
        try:
            node = make_node(context)
        except (ValueError, ParameterException) as error:  # a parameter that can't be used
            get_logger(name).fatal(str(error))
            return 1
        executor.add_node(node)
        executor.spin()
    except ExternalShutdownException:
        pass
    except Exception:
        if context.ok():  # what fails because the context is gone is no error
            raise
    finally:
        if node is not None:
            node.destroy_node()
        try_shutdown(context=context)
    return 0
