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

"""The console scripts: ``obb_collision`` and its subcommands, of which some have their own.

They import what takes long, or needs ROS, only after they have read the arguments and found ROS. A
signal during these imports ends them at once and silently.
"""

from __future__ import annotations

import signal
import sys

if __name__ == "__main__":  # first of all, for what is imported next
    from obb_collision.node.runtime.environment import end_at_once_on_signals

    end_at_once_on_signals()

from argparse import REMAINDER, RawDescriptionHelpFormatter
from collections.abc import Callable, Sequence
from importlib import import_module

import obb_collision
from obb_collision.cli import Parser
from obb_collision.node.runtime.environment import (
    end_at_once_on_signals,
    handle_signals,
    is_ros_here,
    restored_signals,
    without_ros_arguments,
)
from obb_collision.words import command_line

Command = Callable[[Sequence[str] | None], int]

SUBCOMMANDS = {
    "node": ("commands:node", "run the collision node, until Ctrl-C"),
    "demo": ("commands:demo", "run the node and a moving scene in one process"),
    "view": ("commands:view", "show a running node live in the browser"),
    "status": ("commands:status", "print the status of running nodes, with an exit code"),
    "merge": ("commands:merge", "merge the nodes of several regions, until Ctrl-C"),
    "srdf": ("robots.srdf_command:main", "prove which links of a robot can never collide"),
    "warm-up": ("warm_up.command:main", "compile all kernels, so that later starts are fast"),
    "accuracy": (
        "benchmarks.command:accuracy",
        "measure the cost of each level of accuracy on this machine",
    ),
    "speed": ("benchmarks.command:speed", "measure the speed of checks on this machine"),
}
"""By name: module and function, and what it does."""


def _program(name: str, what: str, epilog: str, module: str, needed: str = "") -> Command:
    """Return a command that takes ROS arguments only, and runs the ``main`` of a module.

    needed: a parameter that must be given, unless a file may give it.
    """

    @restored_signals()
    def run(args: Sequence[str] | None = None) -> int:
        end_at_once_on_signals()
        parser = Parser(
            prog=name,
            usage="%(prog)s [--help] [--ros-args ...]",
            description=f"{what}, until SIGINT or SIGTERM. Takes ROS arguments only.",
            epilog=f"For example: {command_line(name)} --ros-args {epilog}",
            allow_abbrev=False,
        )
        words = sys.argv[1:] if args is None else args
        parser.parse_args(without_ros_arguments(words))
        if not is_ros_here(name):
            return 1
        if needed and not any(f"{needed}:=" in word or word == "--params-file" for word in words):
            parser.error(f"needs the parameter {needed}")
        return _main_of(module)(args)

    return run


def _main_of(module: str, function: str = "main") -> Command:
    command: Command = getattr(import_module(f"obb_collision.{module}"), function)
    return command


def _loaded(module: str, function: str = "main") -> Command:
    """Return a command whose module is imported once a signal ends it silently."""

    @restored_signals()
    def run(args: Sequence[str] | None = None) -> int:
        end_at_once_on_signals()
        return _main_of(module, function)(args)

    return run


node = _program(
    "obb_collision_node",
    "Publishes which objects of a scene collide",
    "-p rate:=100.0 --params-file FILE -r __ns:=/cell -r objects:=scene --log-level debug. "
    "The topics and parameters are in docs/topics.md, the parameters with comments in "
    "config/obb_collision.yaml.",
    "node.node",
)
merge = _program(
    "obb_collision_merge",
    "Merges the topics of collision nodes that share a scene by regions",
    "-p regions:='[west, east]' -p timeout:=0.5. The topics and parameters are in docs/scaling.md.",
    "node.merger",
    "regions",
)
demo = _loaded("demo.command")
view = _loaded("demo.command", "view_main")
status = _loaded("demo.status")


def _script(command: Command) -> Command:
    """Return a command as a console script, after which the process ends: later signals do nothing.

    The command itself, and a script called with arguments, restore the handlers of signals.
    """

    def script(args: Sequence[str] | None = None) -> int:
        if args is not None:
            return command(args)
        end_at_once_on_signals()  # also between the command and what follows
        try:
            return command(None)
        finally:
            handle_signals(signal.SIG_IGN)

    return script


def main(args: Sequence[str] | None = None) -> int:
    """Run the subcommand that the arguments begin with; returns the exit code."""
    parser = Parser(
        prog="obb_collision",
        description="Certified collision checking of oriented bounding boxes.",
        epilog="commands:\n"
        + "\n".join(f"  {name:9} {does}" for name, (_, does) in SUBCOMMANDS.items()),
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=obb_collision.__version__)
    parser.add_argument("command", choices=SUBCOMMANDS, metavar="COMMAND", help="see below")
    parser.add_argument(
        "arguments", nargs=REMAINDER, help="arguments of the command, see COMMAND --help"
    )
    options = parser.parse_args(args)
    return _main_of(*SUBCOMMANDS[options.command][0].split(":"))(options.arguments)


script, node_script, merge_script, demo_script = map(_script, (main, node, merge, demo))

if __name__ == "__main__":
    raise SystemExit(node_script(None))
