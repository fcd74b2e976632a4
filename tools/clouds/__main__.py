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

"""The command: figures of clouds, or how often they are wrong."""

from __future__ import annotations

from collections.abc import Sequence

from obb_collision.benchmarks.measuring import on_threads
from obb_collision.cli import SEED, Parser, Progress, interruptible, new_file, option, whole
from obb_collision.robots.robot import Robot
from tools.clouds.figures import measure
from tools.pages import as_markdown, write_into
from tools.robots import default_robot


@interruptible("python -m tools.clouds")
def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table."""
    urdf, srdf, packages = default_robot()
    parser = Parser(prog="python -m tools.clouds", description="clouds: their times, and truth")
    option(parser, "--points", whole(1, 10**7), 100_000, "points of the room")
    option(parser, "--states", whole(1, 10**6), 1000, "states that are timed")
    option(parser, "--seed", SEED, 0, "of the room, states and motions")
    option(parser, "--markdown", new_file(".md"), text="page whose table is written anew")
    options = parser.parse_args(arguments)
    robot = Robot.from_urdf(urdf, srdf, [packages])
    with on_threads(1), Progress() as progress:
        rows = measure(robot, options.points, options.states, options.seed, progress.show)
    block = as_markdown([["figure, one thread", "seen", "at most"], *map(list, rows)])
    print(block)
    if options.markdown:
        write_into(options.markdown, {"clouds": block})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
