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

"""The command ``obb_collision srdf``: an SRDF of the pairs of links that need not be checked."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from obb_collision.cli import Parser, Progress, interruptible, new_file, option, real
from obb_collision.words import printable

if TYPE_CHECKING:  # what needs no robots, as a wrong option, need not load them
    from obb_collision.robots.proofs.proved_pairs import PairProof
    from obb_collision.robots.robot import Robot

NAME = "obb_collision srdf"
#: Exit code where a description cannot be read, or the SRDF not be written.
FAILED = 1
#: Longest time limit, seconds: a day.
LONGEST = 86400.0
#: Verdicts of pairs that need no check, with the reasons that MoveIt writes; and other verdicts.
REASONS = {"adjacent": "Adjacent", "never": "Never", "always": "Always"}
OTHERS = ("can collide", "undecided")


def _parser() -> Parser:
    parser = Parser(
        prog=NAME,
        description="Proves which pairs of links of a robot never or always collide within the "
        "limits of its joints. Writes an SRDF that disables these and adjacent pairs. "
        "Pairs that can collide are reported with a colliding state. Pairs that are undecided when "
        "time is up stay checked.",
        epilog=f"For example: {NAME} arm.urdf -o arm.srdf --time-limit 60",
    )
    parser.add_argument("urdf", type=Path, nargs="?", metavar="URDF", help="URDF file of the robot")
    parser.add_argument(
        "-o",
        "--output",
        type=new_file(),
        metavar="FILE",
        help="SRDF file to write; by default it is printed",
    )
    option(parser, "--time-limit", real(0.001, LONGEST), 60.0, "time for all pairs (s)")
    option(parser, "--srdf", Path, text="SRDF to copy everything from except the disabled pairs")
    parser.add_argument(
        "--package-dir",
        action="append",
        default=[],
        metavar="FOLDER",
        help="folder that contains packages of package:// URIs; may be repeated",
    )
    option(
        parser, "--report", new_file(), text="report file to write; by default it goes to stderr"
    )
    return parser


@interruptible(NAME)
def main(args: Sequence[str] | None = None) -> int:
    """Prove pairs and write the SRDF; returns the exit code."""
    parser = _parser()
    options = parser.parse_args(args)
    if options.urdf is None:  # not before unknown options are named
        parser.error("the URDF file is missing")
    for file in (options.urdf, options.srdf):
        if file is not None and not os.path.exists(file):  # before seconds of imports
            sys.stderr.write(f"{NAME}: {printable(str(file))}: the file does not exist\n")
            return FAILED
    from obb_collision.robots.description.xml_values import read_source
    from obb_collision.robots.robot import Robot

    done = count(1)
    try:
        robot = Robot.from_urdf(options.urdf, options.srdf, options.package_dir)
        srdf = None if options.srdf is None else read_source(options.srdf, "srdf")[0]
        with Progress() as progress:
            proofs = robot.prove_pairs(
                options.time_limit, lambda proof: progress.show(f"pairs of links {next(done)}")
            )
        text = srdf_text(robot, proofs, srdf)
        summary = "".join(f"{printable(line)}\n" for line in report(robot, proofs).splitlines())
        for lines, path, stream in (
            (text, options.output, sys.stdout),
            (summary, options.report, sys.stderr),
        ):
            if path is None:
                stream.write(lines)
            else:
                path.write_text(lines, encoding="utf-8")
                sys.stderr.write(f"{NAME}: wrote {printable(str(path))}\n")
    except (ValueError, OSError) as error:
        sys.stderr.write(f"{NAME}: {printable(str(error))}\n")
        return FAILED
    return 0


def srdf_text(robot: Robot, proofs: Sequence[PairProof], srdf: bytes | None = None) -> str:
    """Return an SRDF that disables pairs that are adjacent, or collide never or always.

    srdf: an SRDF to copy, except for its disabled pairs.
    """
    lines = [
        f"  <disable_collisions link1={quoteattr(a)} link2={quoteattr(b)} "
        f'reason="{REASONS[proof.verdict]}"/>'
        for proof in proofs
        for a, b in (proof.links,)
        if proof.verdict in REASONS
    ]
    if srdf is None:
        start = f'<?xml version="1.0"?>\n<robot name={quoteattr(robot.name)}>'
        return "\n".join([start, *lines, "</robot>", ""])
    return _merged(srdf, lines)


def _merged(srdf: bytes, lines: list[str]) -> str:
    from lxml import etree

    from obb_collision.robots.description.xml_values import parse

    root = parse(srdf, "srdf").node
    for element in root.findall("disable_collisions"):
        root.remove(element)
    if len(root):
        root[-1].tail = "\n  "
    else:
        root.text = "\n  "
    for line in lines:
        element = etree.fromstring(line.strip())
        element.tail = "\n  "
        root.append(element)
    if len(root):
        root[-1].tail = "\n"
    text: str = etree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0"?>\n{text}\n'


def report(robot: Robot, proofs: Sequence[PairProof]) -> str:
    """Return a line for each pair with its proof, and the number of pairs by verdict."""
    lines = [f"{a} - {b}: {_outcome(robot, proof)}" for proof in proofs for a, b in (proof.links,)]
    counts = Counter(proof.verdict for proof in proofs)
    parts = [f"{counts[kind]} {kind}" for kind in (*REASONS, *OTHERS) if counts[kind]]
    total = (
        f"{len(proofs)} pairs: {', '.join(parts)}" if proofs else "no pairs of links with shapes"
    )
    return "\n".join([*lines, total])


def _outcome(robot: Robot, proof: PairProof) -> str:
    if proof.witness is None:
        return f"{proof.verdict} ({proof.cells} cells)" if proof.cells else proof.verdict
    values = zip(robot.joint_names, proof.witness.tolist(), strict=True)
    return f"{proof.verdict}, as at " + ", ".join(f"{name} {value:.4g}" for name, value in values)
