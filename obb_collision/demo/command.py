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

"""The commands of demo and live view: ``obb_collision_demo`` and ``obb_collision view``.

Slow imports wait until the arguments are validated.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing, nullcontext
from functools import partial
from math import inf
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from obb_collision.cli import SEED, Parser, new_file, option, real, whole
from obb_collision.demo.with_ros import Interrupts, node_name, run_with_ros, say
from obb_collision.node.runtime.environment import (
    is_ros_here,
    without_ros_arguments,
)
from obb_collision.words import printable, shown

if TYPE_CHECKING:
    from rclpy.context import Context

    from obb_collision.demo.motion import Motions
    from obb_collision.demo.run import Demo
    from obb_collision.demo.view import BrowserView
    from obb_collision.scene_files.description import View as Viewpoint


SCENES = "tabletop, warehouse, lidar_zone, arm_cell, camera"
"""The scene files of the package."""
DEFAULT_SCENE = "warehouse"
DEFAULT_SECONDS = 10.0
DEFAULT_PORT = 8080
#: With fewer there are no pairs.
MIN_OBJECTS = 2
MAX_OBJECTS = 5000
MAX_SECONDS = 86400.0
#: Publications of moving objects per second, Hz.
RATE = 30.0


def main(args: Sequence[str] | None = None) -> int:
    """Run the demo; returns the exit code."""
    arguments = list(sys.argv[1:] if args is None else args)
    own = arguments[: arguments.index("--ros-args")] if "--ros-args" in arguments else arguments
    options = make_parser().parse_args(own)
    if not is_ros_here("obb_collision_demo"):
        return 1
    # other machines do not see the demo, unless the environment says so
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    ros_arguments = arguments[len(own) :]
    return run_with_ros("obb_collision_demo", ros_arguments, partial(_run, options))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog="obb_collision_demo",
        description="Runs the collision node and a moving scene in one process. Prints pairs as "
        "they begin and end, then a summary, and saves a picture.",
    )
    text = f"duration in seconds (default: {DEFAULT_SECONDS:g}; with --view until Ctrl-C)"
    option(parser, "--seconds", real(0.1, MAX_SECONDS), text=text)
    what = parser.add_mutually_exclusive_group()
    text = (
        f"scene file: one of {SCENES}, the path of your own file, or of a "
        f"MoveIt planning scene (default: {DEFAULT_SCENE})"
    )
    option(what, "--scene", scene_file, text=text)
    objects = whole(MIN_OBJECTS, MAX_OBJECTS)
    option(
        what,
        "--objects",
        objects,
        text="number of objects of a random scene, instead of a scene file",
    )
    option(parser, "--seed", SEED, 4, "seed of the random scene")
    text = f"show the scene live at http://localhost:PORT (default: {DEFAULT_PORT}); needs viser"
    port = whole(0, 65535)
    parser.add_argument("--view", type=port, nargs="?", const=DEFAULT_PORT, help=text)
    picture = "obb_collision_demo.png"
    option(parser, "--picture", new_file(".png"), picture, "PNG file of the scene at the end")
    parser.add_argument("--no-picture", action="store_true", help="do not save a picture")
    return parser


def scene_file(text: str) -> tuple[Motions, Path]:
    """Convert for argparse: the scene of a file, how it moves, and the path of the file."""
    if not os.path.exists(text) and text not in SCENES.split(", "):  # before seconds of imports
        reason = f"the file does not exist; the scenes of the package are {SCENES}"
        raise argparse.ArgumentTypeError(f"{shown(text)}: {reason}")
    from obb_collision.demo.motion import read_motions
    from obb_collision.scene_files import SceneFileError, describe_scene, find_scene

    try:
        file = find_scene(text)
        motions = read_motions(describe_scene(file), file)
    except SceneFileError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    if not motions.description.objects:
        raise argparse.ArgumentTypeError(f"{text}: it has no objects")
    return motions, file


def _run(
    options: argparse.Namespace, context: Context, interrupts: Interrupts, stack: ExitStack
) -> int:
    demo, live_view = _make_demo(options, context, interrupts)
    stack.callback(demo.close)
    with live_view:
        demo.run()
    for line in demo.summary():
        say(line)
    if not options.no_picture:
        _picture(demo.save_picture, options.picture)
    return 0


def _make_demo(
    options: argparse.Namespace, context: Context, interrupts: Interrupts
) -> tuple[Demo, Any]:
    """Return the demo and its live view; prints the scene's description and notes."""
    from obb_collision.demo.run import Demo
    from obb_collision.demo.scene import DemoScene, random_scene

    if options.objects is not None:
        scene = DemoScene(random_scene(options.objects, options.seed))
    else:
        scene = DemoScene(*(options.scene or scene_file(DEFAULT_SCENE)))
    description = scene.description
    say(f"scene {description.name}: {description.description or printable(str(scene.file))}")
    for note in description.notes:
        say(f"note: {note}")
    view = open_view(options.view, view=description.view) if options.view is not None else None
    seconds = options.seconds or (DEFAULT_SECONDS if view is None else MAX_SECONDS)
    demo = Demo(
        context,
        scene,
        RATE,
        seconds,
        say,
        live=view is not None,
        stopped=lambda: interrupts.asked,
    )
    if view is None:
        return demo, nullcontext()
    from obb_collision.demo.view import LiveView

    return demo, closing(LiveView(view, demo.listener, scene.shapes, scene.zones))


def open_view(
    port: int, host: str = "localhost", view: Viewpoint | None = None
) -> BrowserView | None:
    """Open the view in the browser; if that fails, print why and return None."""
    try:
        from obb_collision.demo.view import BrowserView

        opened = BrowserView(port, host, view)
    except ImportError:
        say("the live view needs viser: pip install 'obb_collision[view]'", sys.stderr)
        return None
    except (OSError, ValueError) as error:  # the port is in use, or the host unknown
        say(f"no live view: {error}", sys.stderr)
        return None
    say(f"view: {opened.url}")
    return opened


def _picture(save: Callable[[Path], None], file: Path) -> None:
    """Save the picture, or print why not: the demo is complete without."""
    try:
        save(file)
        say(f"picture: {file}")
    except ImportError as error:
        say(f"no picture, which needs matplotlib: {error}", sys.stderr)
    except OSError as error:
        say(f"no picture: {error}", sys.stderr)


#: Effects whose topics the view subscribes to, so that a node computes them in mode ``auto``.
VIEW_EFFECTS = ("contacts", "clearance", "sweep", "points")
#: Seconds until the view reports that it received nothing, and between two checks for signals.
VIEW_PATIENCE, GLANCE = 10.0, 0.1


def view_main(args: Sequence[str] | None = None) -> int:
    """Show a node's topics until SIGINT or SIGTERM; returns the exit code."""
    arguments = list(sys.argv[1:] if args is None else args)
    options = view_parser().parse_args(without_ros_arguments(arguments))
    if not is_ros_here("obb_collision view"):
        return 1
    return run_with_ros("obb_collision view", arguments, partial(_run_view, options))


def view_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog="obb_collision view",
        usage="%(prog)s [options] [NODE] [--ros-args ...]",
        description="Shows the topics of a running obb_collision_node live in the browser, until "
        "Ctrl-C. Needs viser.",
    )
    text = "full name of the node"
    parser.add_argument("node", type=node_name, nargs="?", default="/obb_collision", help=text)
    option(
        parser,
        "--scene",
        scene_file,
        text="scene file of the node: shapes and zones are not published",
    )
    text = "port of the page; if it is in use, the next free port"
    option(parser, "--port", whole(0, 65535), DEFAULT_PORT, text)
    text = "address to serve on; 0.0.0.0: all network interfaces"
    option(parser, "--host", default="localhost", text=text)
    return parser


def _run_view(
    options: argparse.Namespace, context: Context, interrupts: Interrupts, stack: ExitStack
) -> int:
    from rclpy.executors import SingleThreadedExecutor

    from obb_collision.demo.listener import Listener
    from obb_collision.demo.scene import DemoScene
    from obb_collision.demo.status import publishers_of_status
    from obb_collision.demo.view import LiveView

    scene = DemoScene(*options.scene) if options.scene else None
    view = open_view(options.port, options.host, scene.description.view if scene else None)
    if view is None:
        return 1
    namespace, _, name = ("/" + options.node.strip("/")).rpartition("/")
    listener = Listener(
        lambda line: None, VIEW_EFFECTS, context=context, namespace=namespace or "/"
    )
    stack.callback(listener.destroy_node)
    listener.watch_boxes(f"{name}/markers")
    listener.watch_inputs()
    shapes, zones = (scene.shapes, scene.zones) if scene else ({}, {})
    executor = SingleThreadedExecutor(context=context)
    stack.callback(executor.shutdown)
    executor.add_node(listener)
    limit = monotonic() + VIEW_PATIENCE
    with closing(LiveView(view, listener, shapes, zones)):
        while not interrupts.asked:
            executor.spin_once(timeout_sec=GLANCE)
            if listener.boxes.stamp < 0 and monotonic() > limit:
                limit = inf
                topic = listener.resolve_topic_name(f"{name}/markers")
                nodes = ", ".join(filter(None, sorted(publishers_of_status(listener))))
                can = f"running nodes: {nodes}" if nodes else "no collision node was found"
                say(f"nothing received on {topic} yet; {can}")
    return 0
