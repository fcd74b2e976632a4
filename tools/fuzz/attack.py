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


"""The parts of an attack in one process, or a share of each in several."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from obb_collision.node.inputs.detections import DETECTIONS
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.node.robots.robot_input import JOINT_STATES
from tools.fuzz.file_attack import attack_node, attack_reader
from tools.fuzz.files.scenes import READERS
from tools.fuzz.messages.cases import CASES
from tools.fuzz.messages.robot_messages import ARGUMENTS, LATCHED, ROBOT
from tools.fuzz.messages.stream import Stream
from tools.fuzz.process.canary import Canary
from tools.fuzz.process.child import Child
from tools.fuzz.session.client import Client, FoundError
from tools.fuzz.session.result import Result
from tools.fuzz.session.session import Session
from tools.middleware import for_large_messages

LARGEST_DOMAIN = 100
PROGRESS = 5.0
"""Seconds between two lines of progress."""
BATCH = 100
"""Hostile messages between two probes."""
MODULE = "tools.fuzz.process.frames"
DEPTH = 1000
"""Messages that a topic of the node queues."""
PER_NODE = 200
"""Scene files that are read for each that a node is started with."""
Part = tuple[str, int, int]
"""What, and from which number to before which one."""


def attack(options: Namespace) -> list[Attack]:
    """Run all parts, by as many processes as asked for; returns what each of them found."""
    parts = [
        ("robot", 0, options.robots), ("scene", 0, options.scenes),
        ("message", 0, options.messages), ("raw", 0, options.raw),
    ]  # fmt: skip
    if options.only:
        parts = [options.only]
    count = 1 if options.only else options.processes
    if count == 1:
        return [_run(options, parts, 0)]
    pool = ProcessPoolExecutor(count, get_context("spawn"), _take_interrupts)
    with pool:
        shares = [[share(part, index, count) for part in parts] for index in range(count)]
        for some in shares[1:] if options.messages else ():
            some.insert(0, ("message", 0, len(CASES)))  # the largest are part of each warm-up
        runs = [pool.submit(_run, options, some, index) for index, some in enumerate(shares)]
        return [run.result() for run in runs]


def share(part: Part, index: int, count: int) -> Part:
    """Return one of several shares of a part, in whole batches."""
    what, first, last = part
    batches = -(-(last - first) // BATCH)
    ends = (first + BATCH * (batches * one // count) for one in (index, index + 1))
    start, end = (min(last, one) for one in ends)
    return what, start, end


def _take_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _run(options: Namespace, parts: list[Part], index: int) -> Attack:
    """Run parts in this process. index: among the processes of the attack."""
    with tempfile.TemporaryDirectory() as folder, for_large_messages(Path(folder)):
        run = Attack(options, Path(folder), index)
        try:
            run.run(parts)
        except FoundError as error:
            run.found.insert(0, str(error))
        except KeyboardInterrupt:
            run.found.insert(0, "interrupted")
        if run.found:
            run.last_lines = run.lines()
    return run


def queues(namespace: str) -> Iterator[str]:
    """Yield the arguments of a node whose queues lose nothing that is sent to it or by it."""
    yield from ("-p", f"qos_overrides.{namespace}/collisions.publisher.depth:={DEPTH}")
    for topic in (*INPUTS, DETECTIONS.topic, f"{ROBOT}/{JOINT_STATES}"):
        start = f"qos_overrides.{namespace}/{topic}.subscription"
        yield from ("-p", f"{start}.depth:={DEPTH}", "-p", f"{start}.reliability:=reliable")


class Attack:
    """Attacks nodes, one after the other, and notes what it finds."""

    def __init__(self, options: Namespace, folder: Path, index: int) -> None:
        self._options, self._folder = options, folder
        self._log = options.log or folder / "node.log"
        if options.log and index:
            self._log = options.log.with_name(f"{options.log.name}.{index}")
        self._domain = 1 + os.getpid() % LARGEST_DOMAIN
        self._namespace = f"/fuzz_{os.getpid()}"  # two attacks may have the same domain
        self.reached = ""
        """The batch that was sent last."""
        self.result: Result | None = None
        self.found: list[str] = []
        self.last_lines: list[str] = []
        """Of the output of the node, where something was found."""

    def lines(self) -> list[str]:
        """Return the last lines of the node."""
        return Child.last_lines(self._log) if self._log.exists() else []

    def run(self, parts: list[Part]) -> None:
        """Run parts; FoundError for what should not be."""
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
        return Child(given, self._domain, self._log, MODULE)

    def _read_files(self, what: str, first: int, last: int) -> None:
        seed, folder = self._options.seed, self._folder
        if first >= last:
            return
        refused, longest = attack_reader(what, folder, seed, first, last)
        print(
            f"{what} files: {last - first} read, {refused} of them refused, the longest took "
            f"{longest:.2f} s",
            flush=True,
        )
        if what != "scene":
            return
        numbers = range(first, last, PER_NODE)
        taken = sum(attack_node(folder, seed, number, self._start) for number in numbers)
        print(f"of {len(numbers)} nodes {taken} took theirs", flush=True)

    def _attack_node(self, parts: list[Part]) -> None:
        stream = Stream(self._options.seed, self._folder, self._options.robot_share)
        robot = ROBOT if stream.robot else ""
        client = Client(self._domain, self._namespace, stream.types, LATCHED, robot)
        child, canary = self._start([*ARGUMENTS] if robot else []), Canary()
        try:
            session = Session(self._options, stream, client, child, canary)
            self.result = session.result
            for part in parts:
                self._send(session, stream, part)
            session.end()
        finally:
            code = child.end()
            canary.close()
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
