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
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from obb_collision.checks.fuzz.child import Child
from obb_collision.checks.fuzz.client import Client, FoundError
from obb_collision.checks.fuzz.report import faults, print_result
from obb_collision.checks.fuzz.scene_attack import attack_node, attack_reader
from obb_collision.checks.fuzz.scenes import READERS
from obb_collision.checks.fuzz.session import Session
from obb_collision.checks.fuzz.stream import Stream
from obb_collision.cli import MAX_SEED, Parser, new_file, option, real, whole
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.words import shown

LARGEST_DOMAIN = 100
PROGRESS = 5.0
"""Seconds between two lines of progress."""
BATCH = 100
"""Hostile messages between two probes."""
MODULE = "obb_collision.checks.fuzz.frames"
DEPTH = 1000
"""Messages that a topic of the node queues."""
PROFILE = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
<data_writer profile_name="writer" is_default_profile="true">
<historyMemoryPolicy>DYNAMIC</historyMemoryPolicy></data_writer>
<data_reader profile_name="reader" is_default_profile="true">
<historyMemoryPolicy>DYNAMIC</historyMemoryPolicy></data_reader>
</profiles></dds>
"""
PER_NODE = 200
"""Scene files that are read for each that a node is started with."""
ONLY = re.compile(r"(message|raw|scene|robot):(\d{1,9})(?:-(\d{1,9}))?")
TRANSPORTS = ("FASTDDS_BUILTIN_TRANSPORTS", "LARGE_DATA")
"""By UDP a message of 28 MB takes the middleware up to a minute on a busy machine, and what is
behind it waits: that is no fault of the node. This sends by TCP."""
Part = tuple[str, int, int]


def _only(text: str) -> Part:
    found = ONLY.fullmatch(text)
    if found is None or int(found[3] or found[2]) < int(found[2]):
        raise argparse.ArgumentTypeError(f"must be like raw:17 or message:0-99, not {shown(text)}")
    return found[1], int(found[2]), int(found[3] or found[2]) + 1


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="obb_collision_fuzz",
        description="Attack a node in another process, over real topics: mutated and hostile "
        "messages on every input, raw bytes, requests to its services, scene files, descriptions "
        "of robots. Verify after every batch that it is alive, answers correctly, was not blocked "
        "and does not grow.",
        epilog="Arguments behind -- are those of the node: obb_collision_fuzz -- -p accuracy:=mesh",
    )
    option(parser, "--messages", whole(0, 10**9), 20_000, "number of hostile messages")
    option(parser, "--raw", whole(0, 10**9), 2_000, "number of raw byte strings")
    option(parser, "--scenes", whole(0, 10**9), 200, "number of mutated scene files")
    option(parser, "--robots", whole(0, 10**9), 1_000, "number of mutated descriptions of robots")
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


def queues(namespace: str) -> list[str]:
    """Return the arguments of a node whose queues lose nothing that is sent to it."""
    given = []
    for topic in INPUTS:
        start = f"qos_overrides.{namespace}/{topic}.subscription"
        given += ["-p", f"{start}.depth:={DEPTH}", "-p", f"{start}.reliability:=reliable"]
    return given


def releasing(folder: Path) -> dict[str, str]:
    """Return the environment of a node whose middleware releases the memory of messages.

    By default Fast DDS keeps for each place in a queue the memory of the largest message that it
    had: bounded, but as much as a leak of the node would be.
    """
    profile = folder / "middleware.xml"
    profile.write_text(PROFILE)
    return {
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
        "RMW_FASTRTPS_USE_QOS_FROM_XML": "1",
    }


class Attack:
    """The attack of the options: its parts, one after the other."""

    def __init__(self, options: argparse.Namespace, folder: Path) -> None:
        self._options, self._folder = options, folder
        self._log = options.log or folder / "node.log"
        self._domain = 1 + os.getpid() % LARGEST_DOMAIN
        self.reached = ""
        """The batch that was sent last."""
        self.child: Child | None = None
        self.found: list[str] = []

    def run(self) -> None:
        """Run all parts; FoundError for what should not be."""
        options = self._options
        everything = [
            ("robot", 0, options.robots), ("scene", 0, options.scenes),
            ("message", 0, options.messages),
        ]  # fmt: skip
        parts = [options.only] if options.only else [*everything, ("raw", 0, options.raw)]
        for what, first, last in (part for part in parts if part[0] in READERS):
            self._read_files(what, first, last)
        rest = [part for part in parts if part[0] not in READERS and part[1] < part[2]]
        if rest:
            self._attack_node(rest)

    def _start(self, arguments: list[str]) -> Child:
        """Start a node."""
        folders = f"mesh_folders:=[{str(self._folder)!r}]"
        given = ["--ros-args", "-r", f"__ns:={self._namespace}", "-p", folders]
        given += [*queues(self._namespace), *arguments, "--ros-args", *self._options.node]
        self.child = Child(given, self._domain, self._log, MODULE, releasing(self._folder))
        return self.child

    @property
    def _namespace(self) -> str:
        return f"/fuzz_{self._domain}"

    def _read_files(self, what: str, first: int, last: int) -> None:
        seed, folder = self._options.seed, self._folder
        if first >= last:
            return
        refused, longest = attack_reader(what, folder, seed, first, last)
        print(
            f"{what} files: {last - first} read, {refused} of them refused, the longest took "
            f"{longest:.2f} s"
        )
        if what != "scene":
            return
        numbers = range(first, last, PER_NODE)
        taken = sum(attack_node(folder, seed, number, self._start) for number in numbers)
        print(f"of {len(numbers)} nodes {taken} took theirs")

    def _attack_node(self, parts: list[Part]) -> None:
        options = self._options
        stream = Stream(options.seed, self._folder)
        client = Client(self._domain, stream.types)
        child = self._start([])
        try:
            session = Session(options.seed, stream, client, child, options.bound)
            try:
                for part in parts:
                    self._send(session, stream, part)
                session.end()
            finally:
                print_result(session.result)
            self.found += faults(session.result, options.growth)
        finally:
            code = child.end()
            client.close()
        if code != 0:
            raise FoundError(f"the node ended with exit code {code} when asked to end")

    def _send(self, session: Session, stream: Stream, part: Part) -> None:
        """Send a part in batches."""
        what, first, last = part
        make = stream.message if what == "message" else stream.raw
        start = shown_at = time.monotonic()
        for number in range(first, last, BATCH):
            end = min(last, number + BATCH)
            self.reached = f"{what}:{number}-{end - 1}"
            session.batch(self.reached, [make(one) for one in range(number, end)])
            now = time.monotonic()
            if now - shown_at > PROGRESS:
                shown_at = now
                rate = (end - first) / (now - start)
                longest = session.result.longest
                sys.stderr.write(
                    f"{self.reached} of {last}, {rate:.0f} per second, longest time without an "
                    f"answer {longest:.3f} s\n"
                )


def main(args: Sequence[str] | None = None) -> int:
    """Attack a node; returns 0 only if nothing was found."""
    options = _parser().parse_args(args)
    os.environ.setdefault(*TRANSPORTS)
    with tempfile.TemporaryDirectory() as folder:
        attack = Attack(options, Path(folder))
        try:
            attack.run()
        except FoundError as error:
            attack.found.insert(0, str(error))
        except KeyboardInterrupt:
            attack.found.insert(0, "interrupted")
        if not attack.found:
            print("nothing found")
            return 0
        print(*(f"FOUND: {what}" for what in attack.found), sep="\n")
        if attack.reached:
            print(f"again: obb_collision_fuzz --seed {options.seed} --only {attack.reached}")
        if attack.child is not None:
            print("last lines of the node:", *attack.child.lines(), sep="\n  ")
    return 1
