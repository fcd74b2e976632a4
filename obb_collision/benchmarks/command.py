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

"""The commands ``obb_collision accuracy`` and ``obb_collision speed``.

What takes long to import is imported once the arguments are known to be usable.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence

from obb_collision.cli import (
    SEED,
    Parser,
    Progress,
    interruptible,
    mesh_folder,
    new_file,
    option,
    real,
    whole,
)
from obb_collision.words import shown

#: Forms of scenes, and the peers of a full step.
FORM_NAMES = ("uniform", "plane", "line", "walls", "clusters", "identical", "decades", "far")
PEER_NAMES = ("MuJoCo", "coal tree", "coal SSaP", "coal naive", "python-fcl")


@interruptible("obb_collision accuracy")
def accuracy(arguments: Sequence[str] | None = None) -> int:
    """Measure what accuracy costs; exit code 1 if a level missed a collision."""
    parser = Parser(
        prog="obb_collision accuracy",
        description="Measures the cost of each level of accuracy: time, memory and false alarms, "
        "beside the installed peers.",
    )
    option(parser, "--seconds", real(0.001, 1e6), 100.0, "approximate total time (s)")
    option(parser, "--seed", SEED, 0, "seed of the random poses")
    option(parser, "--bodies", whole(1, 10**6), 2_000, "number of bodies")
    option(parser, "--pairs", whole(1, 10**8), 60_000, "pairs per corpus")
    option(parser, "--meshes", mesh_folder, text="folder of further STL and OBJ files to measure")
    option(parser, "--timed", whole(1, 10**8), 3_000, "pairs timed beside the peers")
    _add_files(parser)
    options = parser.parse_args(arguments)
    with Progress() as progress:
        progress.show("loading")
        from obb_collision.benchmarks.accuracy import report, run

        result = run(options, progress.show)
    return report(result, options)


def _add_files(parser: Parser) -> None:
    option(parser, "--json", new_file(), text="write all numbers as JSON")
    option(parser, "--picture", new_file(".png", ".svg"), text="draw all numbers as PNG or SVG")


def _peer_of(names: Sequence[str]) -> Callable[[str], str]:
    def convert(text: str) -> str:
        if not any(text in name for name in names):
            reason = f"{shown(text)} is not part of any of the names {', '.join(names)}"
            raise argparse.ArgumentTypeError(reason)
        return text

    return convert


def speed_parser(program: str, peers: Sequence[str] = PEER_NAMES) -> Parser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=program,
        description="Measures a full step beside the installed peers: new poses in, every "
        "colliding pair out.",
    )
    add, cores = parser.add_argument, sorted({1, os.cpu_count() or 1})
    add("--sizes", type=whole(1, 10**7), nargs="+", help="numbers of boxes")
    add("--forms", choices=FORM_NAMES, nargs="+", help="forms of the scenes")
    add("--moving", type=real(0.0, 1.0), nargs="+", help="fractions of the boxes that move")
    add(
        "--threads",
        type=whole(1, 1024),
        nargs="+",
        default=cores,
        help="numbers of threads of this library",
    )
    text = "peers to compare with, by parts of their names"
    add("--peers", type=_peer_of(peers), nargs="+", metavar="NAME", help=text)
    option(parser, "--seconds", real(0.001, 1e6), 2.0, "minimum time per scene (s)")
    option(parser, "--steps", whole(1, 10**6), 20, "minimum number of steps per scene")
    text = "maximum time per scene (s); slower peers are left out"
    option(parser, "--limit", real(0.001, 1e6), 40.0, text)
    option(parser, "--seed", SEED, 0, "seed of the random scenes")
    _add_files(parser)
    what = "measure the cost of effects in the scenes of the package instead"
    add("--effects", action="store_true", help=what)
    return parser


@interruptible("obb_collision speed")
def speed(arguments: Sequence[str] | None = None) -> int:
    """Measure the full step, or the effects, and print the tables."""
    options = speed_parser("obb_collision speed").parse_args(arguments)
    with Progress() as progress:
        progress.show("loading")
        from obb_collision.benchmarks.contestants import PEERS
        from obb_collision.benchmarks.speed import measure, report

        result = measure(options, PEERS, progress.show)
    report(result, options)
    return 0
