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

"""The console script ``obb_collision view``: a running node's topics, live in the browser."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from contextlib import ExitStack, closing
from functools import partial
from math import inf
from time import monotonic
from typing import TYPE_CHECKING

from obb_collision.cli import Parser, option, whole
from obb_collision.demo.command import (
    DEFAULT_PORT,
    Interrupts,
    open_view,
    run_with_ros,
    say,
    scene_file,
)
from obb_collision.node.runtime.environment import is_ros_here, without_ros_arguments
from obb_collision.words import shown

if TYPE_CHECKING:
    from rclpy.context import Context

#: Effects whose topics are subscribed: in mode ``auto`` the node then computes them.
EFFECTS = ("contacts", "clearance", "sweep", "points")
#: Seconds until a line reports that nothing was received, and between two checks of the signals.
PATIENCE, GLANCE = 10.0, 0.1


def main(args: Sequence[str] | None = None) -> int:
    """Show a node's topics until SIGINT or SIGTERM; returns the exit code."""
    arguments = list(sys.argv[1:] if args is None else args)
    options = make_parser().parse_args(without_ros_arguments(arguments))
    if not is_ros_here("obb_collision view"):
        return 1
    return run_with_ros("obb_collision view", arguments, partial(_run, options))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog="obb_collision view",
        usage="%(prog)s [options] [NODE] [--ros-args ...]",
        description="Shows what a running obb_collision_node publishes, live in the browser, until "
        "Ctrl-C. Needs viser.",
    )
    text = "full name of the node"
    parser.add_argument("node", type=_node_name, nargs="?", default="/obb_collision", help=text)
    option(parser, "--scene", scene_file, text="its scene file: shapes and zones are on no topic")
    text = "port of the browser's page; the next free one if it is taken"
    option(parser, "--port", whole(0, 65535), DEFAULT_PORT, text)
    text = "address to serve on; 0.0.0.0: to every machine that reaches this one"
    option(parser, "--host", default="localhost", text=text)
    return parser


def _node_name(text: str) -> str:
    """Convert for argparse: a full node name."""
    if not re.fullmatch(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{shown(text)} is not the name of a node")
    return text


def _run(
    options: argparse.Namespace, context: Context, interrupts: Interrupts, stack: ExitStack
) -> int:
    from rclpy.executors import SingleThreadedExecutor

    from obb_collision.demo.listener import Listener
    from obb_collision.demo.scene import DemoScene
    from obb_collision.demo.view import LiveView

    scene = DemoScene(*options.scene) if options.scene else None
    view = open_view(options.port, options.host, scene.description.view if scene else None)
    if view is None:
        return 1
    namespace, _, name = ("/" + options.node.strip("/")).rpartition("/")
    listener = Listener(lambda line: None, EFFECTS, context=context, namespace=namespace or "/")
    stack.callback(listener.destroy_node)
    listener.watch_boxes(f"{name}/markers")
    listener.watch_inputs()
    shapes, zones = (scene.shapes, scene.zones) if scene else ({}, {})
    executor = SingleThreadedExecutor(context=context)
    stack.callback(executor.shutdown)
    executor.add_node(listener)
    limit = monotonic() + PATIENCE
    with closing(LiveView(view, listener, shapes, zones)):
        while not interrupts.asked:
            executor.spin_once(timeout_sec=GLANCE)
            if listener.boxes.stamp < 0 and monotonic() > limit:
                limit = inf
                topic = listener.resolve_topic_name(f"{name}/markers")
                say(f"nothing received on {topic} yet: is {options.node} running?")
    return 0
