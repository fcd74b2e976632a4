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


"""The console script ``python -m tools.soak``."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from obb_collision.cli import MAX_SEED, Parser, new_file, option, real, whole
from tools.fuzz.client import FoundError
from tools.fuzz.process import Child
from tools.soak.result import Result
from tools.soak.session import Session

LARGEST_DOMAIN = 100
SAMPLE_PERIOD = 0.5
"""Seconds between two looks at the memory of the node."""
PROGRESS = 10.0
"""Seconds between two lines of progress."""


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m tools.soak",
        description="Keep a node in another process busy for a long time: objects come, go and "
        "move by all inputs, and every answer is compared with brute force over all pairs. Its "
        "memory, descriptors and threads must not grow. The last lines say what held.",
        epilog="Arguments behind -- are those of the node: python -m tools.soak -- -p rate:=100.0",
    )
    option(parser, "--seconds", real(1.0, 1e7), 60.0, "duration, without the start of the node")
    option(parser, "--steps", whole(1, 10**9), text="end after so many steps, too")
    option(parser, "--seed", whole(0, MAX_SEED), 1, "seed of the random numbers")
    option(parser, "--objects", whole(8, 1000), 120, "objects there are on average")
    text = "seconds after which growth counts; a fifth of --seconds, at most 60, if not given"
    option(parser, "--warm-up", real(0.0, 1e7), text=text)
    option(parser, "--growth", real(0.0, 1e6), 1.0, "MB that the node's memory may grow")
    option(parser, "--json", new_file(".json"), text="file for the result, and a wrong answer")
    option(parser, "--log", new_file(), text="file for the node's output")
    parser.add_argument("node", nargs="*", metavar="NODE_ARGUMENT", help="argument of the node")
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Keep a node busy and check it; returns 0 only if everything held."""
    options = _parser().parse_args(args)
    domain = 1 + os.getpid() % LARGEST_DOMAIN
    result = Result(options.growth)
    with tempfile.TemporaryDirectory() as folder:
        session = Session(options.seed, options.objects, domain, result)
        log = options.log or Path(folder) / "node.log"
        child = Child([*session.arguments(), *options.node], domain, log)
        try:
            session.begin(child)
            _run(session, child, result, options)
            session.end(child)
        except FoundError as error:
            result.stopped = str(error)
        except KeyboardInterrupt:
            result.stopped = "interrupted"
        code = child.end()
        session.close()
        if not result.stopped and code != 0:
            result.stopped = f"the node ended with exit code {code} when asked to end"
        faults = _print(result, options.seed)
        if faults:
            print("last lines of the node:", *child.lines(), sep="\n  ")
    if options.json:
        options.json.write_text(json.dumps(result.summary() | {"seed": options.seed}, indent=1))
    return 1 if faults else 0


def _run(session: Session, child: Child, result: Result, options: argparse.Namespace) -> None:
    """Make steps until the time is over, or an answer is wrong."""
    start = due = shown_at = time.monotonic()
    warm = options.warm_up
    if warm is None:
        warm = min(60.0, options.seconds / 5.0)
    while (passed := time.monotonic() - start) < options.seconds and not result.wrong:
        if options.steps and result.steps >= options.steps:
            break
        session.step(child)
        now = time.monotonic()
        result.seconds = now - start
        if now >= due:
            due += SAMPLE_PERIOD
            if passed >= warm:
                result.usages.add(child.usage())
        if now > shown_at + PROGRESS:
            shown_at = now
            text = f"{passed:.0f} of {options.seconds:.0f} s: {result.checked} answers checked"
            print(text, file=sys.stderr, flush=True)


def _print(result: Result, seed: int) -> list[str]:
    faults = result.faults()
    print(*result.lines(), sep="\n")
    if result.failure:
        shown = {key: value for key, value in result.failure.items() if key != "bodies"}
        print(f"wrong: {json.dumps(shown)}")
        again = f"python -m tools.soak --seed {seed} --steps {result.failure['step']}"
        print(f"the same steps again: {again}; --json FILE writes all bodies")
    print(f"NOT held: {'; '.join(faults)}" if faults else "everything held")
    return faults


if __name__ == "__main__":
    raise SystemExit(main())
