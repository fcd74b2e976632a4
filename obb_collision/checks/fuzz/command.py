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

# ruff: noqa: T201 - a command line tool prints
"""The console script ``obb_collision_fuzz``."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from obb_collision.checks.fuzz.child import Child
from obb_collision.checks.fuzz.session import BATCH, FoundError, Result, Session
from obb_collision.cli import MAX_SEED, Parser, new_file, option, real, whole

LARGEST_DOMAIN = 100
PROGRESS = 5.0
"""Seconds between two lines of progress."""


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="obb_collision_fuzz",
        description="Send mutated messages to a node in another process, over real topics, and "
        "verify after every batch that it is alive, answers correctly and was not blocked.",
        epilog="Arguments behind -- are those of the node: obb_collision_fuzz -- -p accuracy:=mesh",
    )
    option(parser, "--messages", whole(1, 10**9), 20_000, "number of hostile messages")
    option(parser, "--seed", whole(0, MAX_SEED), 1, "seed of the random numbers")
    text = "seconds that the node may be blocked beyond what rclpy takes to decode"
    option(parser, "--bound", real(0.0, 3600.0), 0.1, text)
    option(parser, "--log", new_file(), text="file for the node's output")
    parser.add_argument("node", nargs="*", metavar="NODE_ARGUMENT", help="argument of the node")
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Attack a node; returns 0 only if nothing was found."""
    options = _parser().parse_args(args)
    domain = 1 + os.getpid() % LARGEST_DOMAIN
    with tempfile.TemporaryDirectory() as folder:
        log = options.log or Path(folder) / "node.log"
        session = Session(options.seed, domain, Path(folder), options.bound)
        child = Child([*session.arguments(), *options.node], domain, log)
        found = ""
        try:
            _attack(session, child, options.messages)
        except FoundError as error:
            found = str(error)
        except KeyboardInterrupt:
            found = "interrupted"
        code = child.end()
        session.close()
        if not found and code != 0:
            found = f"the node ended with exit code {code} when asked to end"
        _print(session.result)
        if not found and session.result.late:
            found = "the node was blocked for longer than allowed"
        if found:
            sent = session.result.sent.total()
            print(f"FOUND after {sent} messages of seed {options.seed}: {found}")
            print("last lines of the node:", *child.lines(), sep="\n  ")
            return 1
    print("nothing found")
    return 0


def _attack(session: Session, child: Child, messages: int) -> None:
    session.begin(child)
    start = last = time.monotonic()
    sent = 0
    while sent < messages:
        count = min(BATCH, messages - sent)
        session.batch(child, count)
        sent += count
        now = time.monotonic()
        if now - last > PROGRESS:
            last = now
            rate = sent / (now - start)
            sys.stderr.write(
                f"{sent} of {messages} messages, {rate:.0f} per second, longest time without an "
                f"answer {session.result.longest:.3f} s\n"
            )
    session.end(child)


def _print(result: Result) -> None:
    sent = ", ".join(f"{topic} {count}" for topic, count in sorted(result.sent.items()))
    print(f"sent: {result.sent.total()} ({sent}); probes answered right: {result.probes}")
    print(
        f"longest time without an answer: {result.longest:.3f} s; "
        f"{len(result.late)} times longer than allowed"
    )
    for sent_then, gap, allowed in result.late[:10]:
        print(f"  before message {sent_then}: {gap:.3f} s, allowed were {allowed:.3f} s")
    first, last = (size / 2**20 for size in result.memory)
    print(f"memory of the node: {first:.0f} MiB after the first batch, {last:.0f} MiB at the end")
    reasons = ", ".join(f"{reason} {count}" for reason, count in sorted(result.refused.items()))
    print(f"refused: {reasons or 'nothing was read'}")
