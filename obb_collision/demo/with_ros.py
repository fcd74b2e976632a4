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

"""Run a command that needs ROS until it ends or is interrupted."""

from __future__ import annotations

import argparse
import re
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, TextIO, TypeAlias

from obb_collision.cli import BAD_USAGE
from obb_collision.node.runtime.environment import handle_signals, restored_signals
from obb_collision.words import shown

if TYPE_CHECKING:
    from rclpy.context import Context


class Interrupts:
    """Turns SIGINT and SIGTERM into ``asked``; the second one raises KeyboardInterrupt, once.

    The first one raises nothing: rclpy may swallow an exception in a callback.
    """

    def __init__(self) -> None:
        self.asked = False
        self._raised = False
        handle_signals(self._take)

    def _take(self, *_: object) -> None:
        if self.asked and not self._raised:
            self._raised = True
            raise KeyboardInterrupt
        self.asked = True


Work: TypeAlias = "Callable[[Context, Interrupts, ExitStack], int]"


@restored_signals()
def run_with_ros(program: str, ros_arguments: list[str], work: Work) -> int:
    """Run ``work`` with a context and a stack, which is closed at its end; return its exit code."""
    interrupts, stack = Interrupts(), ExitStack()
    import rclpy.context
    from rclpy.executors import ExternalShutdownException

    from obb_collision.node.runtime.running import UNUSABLE, in_one_line, init

    context = rclpy.context.Context()
    if not init(program, context, ros_arguments):
        return BAD_USAGE
    try:
        return work(context, interrupts, stack)
    except (TimeoutError, *UNUSABLE) as error:
        say(f"{program}: {in_one_line(error)}", sys.stderr)
        return 1
    except ExternalShutdownException:
        say(f"{program}: interrupted", sys.stderr)
        return 0
    except KeyboardInterrupt:
        say(f"{program}: interrupted twice", sys.stderr)
        return 0
    finally:
        handle_signals(signal.SIG_IGN)  # the work is ending
        stack.close()
        context.try_shutdown()


def say(line: str, stream: TextIO | None = None) -> None:
    """Print a line at once."""
    out = stream or sys.stdout
    out.write(line + "\n")
    out.flush()


def node_name(text: str) -> str:
    """Convert for argparse: a full node name."""
    if not re.fullmatch(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{shown(text)} is not the name of a node")
    return text
