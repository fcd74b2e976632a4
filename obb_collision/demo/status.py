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

"""The subcommand ``obb_collision status``: prints the status of running nodes, or JSON."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from copy import copy
from functools import partial
from importlib.util import find_spec
from math import inf
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from obb_collision.cli import Parser, option, real
from obb_collision.demo.with_ros import Interrupts, node_name, run_with_ros, say
from obb_collision.node.runtime.environment import is_ros_here, without_ros_arguments
from obb_collision.words import printable

if TYPE_CHECKING:
    from rclpy.context import Context
    from rclpy.node import Node

PROGRAM, TOPIC = "obb_collision status", "collision_status"
LEVELS = {b"\0": "OK", b"\2": "ERROR", b"\3": "STALE"}
#: Part of the name of an endpoint whose node is not discovered yet.
UNNAMED = "_UNKNOWN_"
#: Exit codes by level; 2 is for wrong arguments, as in all commands.
EXIT_CODES = {"OK": 0, "ERROR": 1, "STALE": 3}
NOBODY = 4
INSTALLED, SOURCED = Path("/opt/ros"), "OBB_COLLISION_SOURCED"
"""The folder of ROS installations, and the variable that is set after this command sourced one."""
#: Seconds between two searches for nodes.
GLANCE = 0.1
#: Seconds after its status within which a node sends ``/diagnostics``, if it does.
DIAGNOSTICS = 2.5
#: Values of /diagnostics that are printed; the JSON has all of them.
SHOWN = (
    *("count", "colliding", "stale", "refused", "unplaceable", "cycle mean (ms)", "cycle max (ms)"),
    *("overruns", "rate (Hz)", "age (s)", "rejected"),
)


def main(args: Sequence[str] | None = None) -> int:
    """Print the status of nodes; return the code of the worst: ERROR, then STALE, then OK."""
    arguments = list(sys.argv[1:] if args is None else args)
    parser = Parser(
        prog=PROGRAM,
        usage="%(prog)s [options] [--ros-args ...]",
        description="Prints the status of running collision nodes. The exit code is 0: nothing "
        "collides "
        "(OK), 1: a pair collides (ERROR), 3: collisions are unknown (STALE), 4: no node answered.",
    )
    option(parser, "--node", node_name, text="full name of the node (default: all running nodes)")
    option(parser, "--timeout", real(0.1, 3600.0), 5.0, "maximum time to wait for a status (s)")
    parser.add_argument("--json", action="store_true", help="print all values as JSON")
    options = parser.parse_args(without_ros_arguments(arguments))
    setups = sorted(INSTALLED.glob("*/setup.bash"))
    if find_spec("rclpy") is None and setups and SOURCED not in os.environ:
        say(
            f"{PROGRAM}: uses the ROS installation {setups[-1].parent}, which is not sourced",
            sys.stderr,
        )
        words = [sys.executable, "-m", "obb_collision", "status", *arguments]
        command = ["bash", "-c", 'source "$0" && exec "$@"', str(setups[-1]), *words]
        return subprocess.run(command, env={**os.environ, SOURCED: "1"}, check=False).returncode
    if not is_ros_here(PROGRAM):
        return NOBODY
    return run_with_ros(PROGRAM, arguments, partial(_run, options))


class Status:
    """The latest status of a node: level, message, values, and parts of its diagnostics.

    stamp: of the message, s.
    """

    def __init__(self) -> None:
        self.level, self.message = "", ""
        self.stamp = 0.0
        self.values: dict[str, str] = {}
        self.parts: dict[str, dict[str, str]] = {}

    def take(self, message: Any) -> None:
        """Take a message of ``collision_status``."""
        at = message.header.stamp
        self.stamp = at.sec + 1e-9 * at.nanosec
        if len(message.status) != 1:
            self.level, self.values = "STALE", {"reason": "unreadable"}
            self.message = f"{len(message.status)} statuses in a message, expected 1"
            return
        (status,) = message.status
        self.level, self.message = LEVELS.get(status.level, "STALE"), status.message
        self.values = {pair.key: pair.value for pair in status.values}

    def counting(self, pairs: int) -> Status:
        """Return a copy with this number of pairs: the node updates its own ten times a second."""
        other = copy(self)
        first, *more = self.message.split("; ")
        if self.level == "ERROR" and self.values.get("colliding pairs") == first.split(" ")[0]:
            first = f"{pairs} pair{'s collide' if pairs > 1 else ' collides'}"
            other.message = "; ".join([first, *more])
        return other

    def lines(self, name: str) -> list[str]:
        """Return the lines of the text output."""
        reason, who = self.values.get("reason", ""), self.values.get("who", "")
        head = f"{name}: {self.level}" + (f", {reason}" if reason else "")
        lines = [head + (f" ({who})" if who else ""), f"  {self.message}"]
        counts = {k: v for k, v in self.values.items() if k not in ("reason", "who", "reasons")}
        lines.append("  " + ", ".join(f"{key} {value}" for key, value in counts.items()))
        for part, values in self.parts.items():
            shown = [f"{key} {values[key]}" for key in SHOWN if key in values]
            lines.append(f"  {part}: " + "; ".join([values["message"], *shown]))
        return [printable(line) for line in lines]


def publishers_of_status(listener: Node) -> dict[str, str]:
    """Return status topics by the names of their nodes; "" for a node not discovered yet.

    An endpoint is discovered before its node.
    """
    return {
        name if UNNAMED not in name else "": topic
        for topic, _ in listener.get_topic_names_and_types()
        if topic.endswith(f"/{TOPIC}")
        for end in listener.get_publishers_info_by_topic(topic)
        for name in [f"{end.node_namespace.rstrip('/')}/{end.node_name}"]
    }


def _listen(
    options: Any, context: Context, interrupts: Interrupts, stack: ExitStack
) -> dict[str, Status]:
    """Return the status of nodes by name, as soon as all have sent one or the time is over."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node as RosNode
    from rclpy.qos import DurabilityPolicy, QoSProfile

    listener = RosNode("obb_collision_status", context=context)
    stack.callback(listener.destroy_node)
    heard: dict[str, Status] = {}
    wanted = None if options.node is None else "/" + options.node.strip("/")

    def take_diagnostics(message: Any) -> None:
        for status in message.status:
            name, _, part = status.name.partition(": ")
            if (node := heard.get(f"/{name}")) is not None:
                node.parts[part] = {"message": status.message}
                node.parts[part] |= {pair.key: pair.value for pair in status.values}

    def look() -> bool:
        """Subscribe to the status of new nodes; returns whether the names of all are known."""
        nodes = publishers_of_status(listener)
        for name, topic in nodes.items():
            if name and name not in heard and (wanted is None or name == wanted):
                status = heard[name] = Status()
                listener.create_subscription(DiagnosticArray, topic, status.take, latched)
        return "" not in nodes or wanted in heard

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    listener.create_subscription(DiagnosticArray, "/diagnostics", take_diagnostics, 10)
    executor = SingleThreadedExecutor(context=context)
    stack.callback(executor.shutdown)
    executor.add_node(listener)
    limit = monotonic() + options.timeout
    first = inf
    while monotonic() < limit and not interrupts.asked:
        named = look()
        executor.spin_once(timeout_sec=GLANCE)
        if named and heard and all(status.level for status in heard.values()):
            first = min(first, monotonic())
            if all(status.parts for status in heard.values()):
                break
            limit = min(limit, first + DIAGNOSTICS)  # a node may have no diagnostics
    return {name: status for name, status in sorted(heard.items()) if status.level}


def _run(options: Any, context: Context, interrupts: Interrupts, stack: ExitStack) -> int:
    heard = _listen(options, context, interrupts, stack)
    if options.json:
        say(json.dumps({name: vars(status) for name, status in heard.items()}, indent=1))
    else:
        for name, status in heard.items():
            say("\n".join(status.lines(name)))
    if not heard:
        what = f"{options.node} was not" if options.node else "no collision node was"
        say(f"{PROGRAM}: {what} heard within {options.timeout:g} s", sys.stderr)
        return NOBODY
    codes = {EXIT_CODES[status.level] for status in heard.values()}
    return min(codes - {0}, default=0)
