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

"""The console script ``obb_collision srdf``: which pairs of links need not be checked, proved."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from obb_collision.cli import Parser, interruptible, new_file, option, real
from obb_collision.words import printable

NAME = "obb_collision srdf"
#: Exit code where a description cannot be read, or the SRDF not be written.
FAILED = 1
#: Longest time limit, seconds: a day.
LONGEST = 86400.0


def _parser() -> Parser:
    parser = Parser(
        prog=NAME,
        description="Proves which pairs of links of a robot never collide, or always, within the "
        "limits of its joints, and writes an SRDF that has those and adjacent pairs not checked. "
        "Pairs that can collide come with a state in which they do; those undecided when time is "
        "up stay checked.",
        epilog=f"For example: {NAME} arm.urdf -o arm.srdf --time-limit 60",
    )
    parser.add_argument("urdf", type=Path, nargs="?", metavar="URDF", help="file of the robot")
    parser.add_argument(
        "-o", "--output", type=new_file(), metavar="FILE",
        help="file of the SRDF; else it is printed",
    )  # fmt: skip
    option(parser, "--time-limit", real(0.001, LONGEST), 60.0, "seconds for all pairs")
    option(parser, "--srdf", Path, text="SRDF of which all but the disabled pairs is taken over")
    parser.add_argument(
        "--package-dir", action="append", default=[], metavar="FOLDER",
        help="folder in which packages of package:// are; may be given several times",
    )  # fmt: skip
    option(parser, "--report", new_file(), text="file of the report; else it is printed to stderr")
    return parser


@interruptible(NAME)
def main(args: Sequence[str] | None = None) -> int:
    """Prove pairs and write the SRDF; returns the exit code."""
    parser = _parser()
    options = parser.parse_args(args)
    if options.urdf is None:  # not before unknown options are named
        parser.error("the file of the robot is missing")
    from obb_collision.robots.description.robot import Robot
    from obb_collision.robots.description.xml_values import read_source
    from obb_collision.robots.proofs.proved_pairs import PairProof, prove_pairs
    from obb_collision.robots.proofs.srdf_text import report, srdf_text

    done = 0

    def progress(proof: PairProof) -> None:
        nonlocal done
        done += 1
        if sys.stderr.isatty():
            sys.stderr.write(f"\r\x1b[K{done} pairs, {printable(' - '.join(proof.links))}")

    try:
        robot = Robot.from_urdf(options.urdf, options.srdf, options.package_dir)
        given = None if options.srdf is None else read_source(options.srdf, "srdf")[0]
        proofs = prove_pairs(robot, options.time_limit, progress)
        if sys.stderr.isatty():
            sys.stderr.write("\r\x1b[K")
        _write(srdf_text(robot, proofs, given), options.output, sys.stdout)
        _write(printable_lines(report(robot, proofs)), options.report, sys.stderr)
    except (ValueError, OSError) as error:
        sys.stderr.write(f"{NAME}: {printable(str(error))}\n")
        return FAILED
    return 0


def printable_lines(text: str) -> str:
    """Return a text, each of its lines printable."""
    return "".join(f"{printable(line)}\n" for line in text.splitlines())


def _write(text: str, path: Path | None, stream: TextIO) -> None:
    if path is None:
        stream.write(text)
    else:
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
