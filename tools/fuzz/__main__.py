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


"""The console script ``python -m tools.fuzz``."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence

from obb_collision.cli import (
    INTERRUPTED,
    MAX_SEED,
    Parser,
    interruptible,
    new_file,
    option,
    real,
    whole,
)
from obb_collision.words import shown
from tools.fuzz.attack import Part, attack
from tools.fuzz.session import faults, print_results

PROGRAM = "python -m tools.fuzz"
ONLY = re.compile(r"(message|raw|scene|robot):(\d{1,9})(?:-(\d{1,9}))?")


def _only(text: str) -> Part:
    found = ONLY.fullmatch(text)
    if found is None or int(found[3] or found[2]) < int(found[2]):
        raise argparse.ArgumentTypeError(f"must be like raw:17 or message:0-99, not {shown(text)}")
    return found[1], int(found[2]), int(found[3] or found[2]) + 1


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog=PROGRAM,
        description="Attack a node in another process, over real topics: mutated and hostile "
        "messages on every input, raw bytes, requests to its services, scene files, descriptions "
        "of robots. Verify after every batch that it is alive, answers correctly, was not blocked "
        "and does not grow.",
        epilog="Arguments behind -- are those of the node: "
        "python -m tools.fuzz -- -p accuracy:=mesh",
    )
    option(parser, "--messages", whole(0, 10**9), 20_000, "number of hostile messages")
    option(parser, "--raw", whole(0, 10**9), 2_000, "number of raw byte strings")
    option(parser, "--scenes", whole(0, 10**9), 200, "number of mutated scene files")
    option(parser, "--robots", whole(0, 10**9), 1_000, "number of mutated descriptions of robots")
    text = "share of the messages that are on the topics of a robot; 0: the node has none"
    option(parser, "--robot-share", real(0.0, 1.0), 0.05, text)
    text = "processes that share it, each with a node of its own"
    option(parser, "--processes", whole(1, 1000), 1, text)
    option(parser, "--seed", whole(0, MAX_SEED), 1, "seed of the random numbers")
    text = (
        "only this of the attack of the seed, one message at a time: message:12, raw:0-99, scene:3"
    )
    option(parser, "--only", _only, text=text)
    text = "seconds that the node may be blocked, with 0.1 more per megabyte of a batch"
    option(parser, "--bound", real(0.0, 3600.0), 0.1, text)
    text = "megabytes by which its memory may grow after a warm-up of a fifth of the time"
    option(parser, "--growth", real(0.0, 1e6), 30.0, text)
    option(parser, "--log", new_file(), text="file for the node's output")
    parser.add_argument("node", nargs="*", metavar="NODE_ARGUMENT", help="argument of the node")
    return parser


@interruptible(PROGRAM)
def main(args: Sequence[str] | None = None) -> int:
    """Attack a node; returns 0 only if nothing was found."""
    options = _parser().parse_args(args)
    attacks = attack(options)
    results = [one.result for one in attacks if one.result]
    if results:
        print_results(results)
    found = 0
    for one in attacks:
        faulty = one.found + (faults(one.result, options.growth) if one.result else [])
        found += len(faulty)
        if not faulty:
            continue
        print(*(f"FOUND: {what}" for what in faulty), sep="\n")
        if one.reached:
            print(f"again: python -m tools.fuzz --seed {options.seed} --only {one.reached}")
        if one.last_lines:
            print("last lines of the node:", *one.last_lines, sep="\n  ")
    if any(one.interrupted for one in attacks):
        sys.stderr.write(f"{PROGRAM}: interrupted\n")
    elif not found:
        print("nothing found")
    return 1 if found else INTERRUPTED if any(one.interrupted for one in attacks) else 0


if __name__ == "__main__":
    raise SystemExit(main())
