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

"""The console script ``obb_collision_demo``."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from obb_collision.cli import BAD_USAGE, MAX_SEED, Parser, new_file, real, whole
from obb_collision.geometry.words import printable
from obb_collision.node.demo.layout import DEFAULT_OBJECTS, DEFAULT_SEED, MIN_OBJECTS
from obb_collision.node.demo.scene import DemoScene
from obb_collision.node.environment import SIGNALS, is_ros_here, set_defaults
from obb_collision.scene.files import (
    READY,
    SceneDescription,
    SceneFileError,
    describe_scene,
    find_scene,
)

if TYPE_CHECKING:
    from obb_collision.node.demo.file_scene import FileScene

#: More would be a load test; ``obb_collision_latency`` is one.
MAX_OBJECTS = 5000
MAX_SECONDS = 86400.0
MAX_RATE = 200.0


def main(args: Sequence[str] | None = None) -> int:
    """Run the demo; returns the exit code."""
    arguments = list(sys.argv[1:] if args is None else args)
    own = arguments[: arguments.index("--ros-args")] if "--ros-args" in arguments else arguments
    options = make_parser().parse_args(own)
    if not is_ros_here("obb_collision_demo"):
        return 1
    set_defaults()
    # The demo is for this machine; who wants it on the network says so.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return _run(options, arguments[len(own) :])


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; it refuses what can't be used, with the reason."""
    parser = Parser(
        prog="obb_collision_demo",
        description="The collision node and a moving warehouse in one process: prints the pairs "
        "as they begin and end, then a summary, and saves a picture.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument(
        "--seconds", type=real(0.1, MAX_SECONDS), default=10.0, help="how long to run"
    )
    parser.add_argument(
        "--scene",
        type=_description,
        metavar="FILE",
        help=f"scene file instead of the warehouse that is built in: one of {', '.join(READY)}, a "
        "path of one of your own, or of a MoveIt planning scene",
    )
    parser.add_argument(
        "--objects",
        type=whole(MIN_OBJECTS, MAX_OBJECTS),
        default=DEFAULT_OBJECTS,
        help="how many objects there are in the built-in scene",
    )
    parser.add_argument(
        "--seed",
        type=whole(0, MAX_SEED),
        default=DEFAULT_SEED,
        help="of the built-in scene",
    )
    parser.add_argument(
        "--rate",
        type=real(1.0, MAX_RATE),
        default=30.0,
        help="how many times a second what moves is published (Hz)",
    )
    parser.add_argument(
        "--picture",
        type=new_file(),
        default="obb_collision_demo.png",
        metavar="FILE",
        help="PNG of how the scene ends",
    )
    parser.add_argument("--no-picture", action="store_true", help="draw no picture")
    return parser


def _description(text: str) -> tuple[SceneDescription, Path]:
    """Convert for argparse: what a scene file says, and where it is."""
    try:
        file = find_scene(text)
        description = describe_scene(file)
    except SceneFileError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    if not description.objects:
        raise argparse.ArgumentTypeError(f"{text}: there are no objects in it")
    return description, file


class _Interrupts:
    """Turns SIGINT and SIGTERM into ``asked``; the second one raises KeyboardInterrupt, once.

    An exception would come in the middle of any callback, where rclpy may swallow it.
    """

    def __init__(self) -> None:
        self.asked = False
        self._raised = False
        for number in SIGNALS:
            signal.signal(number, self._take)

    def _take(self, *_: object) -> None:
        if self.asked and not self._raised:
            self._raised = True
            raise KeyboardInterrupt
        self.asked = True

    def ignore(self) -> None:
        """Take no more signals: what is left to do is to end."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def _run(options: argparse.Namespace, ros_arguments: list[str]) -> int:
    interrupts = _Interrupts()
    from rclpy.context import Context

    from obb_collision.node.demo.run import Demo
    from obb_collision.node.running import UNUSABLE, in_one_line, init

    context = Context()
    if not init("obb_collision_demo", context, ros_arguments):
        return BAD_USAGE
    demo = None
    try:
        scene = _scene(options)
        demo = Demo(context, scene, options.rate, options.seconds, _say)
        demo.run(lambda: interrupts.asked)
        for line in demo.summary():
            _say(line)
        if not options.no_picture:
            _picture(demo.save_picture, options.picture)
    except (TimeoutError, *UNUSABLE) as error:
        _say(f"obb_collision_demo: {in_one_line(error)}", sys.stderr)
        return 1
    except KeyboardInterrupt:
        _say("obb_collision_demo: interrupted twice", sys.stderr)
    finally:
        interrupts.ignore()
        if demo is not None:
            demo.close()
        context.try_shutdown()
    return 0


def _scene(options: argparse.Namespace) -> DemoScene | FileScene:
    """Return the scene asked for, and say what of a file is left out."""
    if options.scene is None:
        return DemoScene(options.objects, options.seed)
    from obb_collision.node.demo.file_scene import FileScene

    description, file = options.scene
    _say(f"scene {description.name}: {description.description or printable(str(file))}")
    for note in description.notes:
        _say(f"note: {note}")
    return FileScene(description, file)


def _picture(save: Callable[[Path], None], file: Path) -> None:
    """Save the picture, or say why there is none: the demo has done its work without."""
    try:
        save(file)
        _say(f"picture: {file}")
    except ImportError as error:
        _say(f"no picture, for it needs matplotlib: {error}", sys.stderr)
    except OSError as error:
        _say(f"no picture: {error}", sys.stderr)


def _say(line: str, stream: TextIO | None = None) -> None:
    out = stream or sys.stdout
    out.write(line + "\n")
    out.flush()
