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

"""The console script ``python -m tools.fuzz``: an attack by one process, or a share in several.

Files are read by a process that is watched, and some are given to a node at its start.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from obb_collision.cli import (
    INTERRUPTED,
    SEED,
    Parser,
    interruptible,
    new_file,
    option,
    real,
    whole,
)
from obb_collision.node.inputs.detections import DETECTIONS
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.node.robots.robot_input import JOINT_STATES
from obb_collision.words import shown
from tools.fuzz.cases import CASES, Stream
from tools.fuzz.client import STARTING, Client, FoundError
from tools.fuzz.files import READERS, mutated_scene
from tools.fuzz.messages import SOURCES
from tools.fuzz.process import Canary, Child, for_large_messages, last_lines, own_domain
from tools.fuzz.robot import ARGUMENTS, LATCHED, ROBOT
from tools.fuzz.session import Result, Session, faults, print_results

PROGRAM = "python -m tools.fuzz"
ONLY = re.compile(r"(message|raw|scene|robot):(\d{1,9})(?:-(\d{1,9}))?")
PROGRESS = 5.0
"""Seconds between two lines of progress."""
BATCH = 100
"""Hostile messages between two probes."""
MODULE = "tools.fuzz.frames"
DEPTH = 1000
"""Messages that a topic of the node queues."""
PER_NODE = 200
"""Scene files that are read for each that a node is started with."""
Part = tuple[str, int, int]
"""What, and from which number to before which one."""


def attack(options: argparse.Namespace) -> list[Attack]:
    """Run all parts in several processes; return the findings of each."""
    parts = [
        ("robot", 0, options.robots), ("scene", 0, options.scenes),
        ("message", 0, options.messages), ("raw", 0, options.raw),
    ]  # fmt: skip
    if options.only:
        parts = [options.only]
    count = 1 if options.only else options.processes
    if count == 1:
        return [_run(options, parts, 0)]
    here: Any = importlib.import_module("tools.fuzz.__main__")  # workers import no "__main__"
    pool = ProcessPoolExecutor(count, get_context("spawn"), here._take_interrupts)
    with pool:
        shares = [[share(part, index, count) for part in parts] for index in range(count)]
        for work in shares[1:] if options.messages else ():
            work.insert(0, ("message", 0, len(CASES)))  # the largest are part of each warm-up
        runs = [pool.submit(here._run, options, work, index) for index, work in enumerate(shares)]
        return [run.result() for run in runs]


def share(part: Part, index: int, count: int) -> Part:
    """Return a process's share of a part, in whole batches."""
    what, first, last = part
    batches = -(-(last - first) // BATCH)
    ends = (first + BATCH * (batches * number // count) for number in (index, index + 1))
    start, end = (min(last, number) for number in ends)
    return what, start, end


def _take_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _run(options: argparse.Namespace, parts: list[Part], index: int) -> Attack:
    """Run parts in this process. index: among the processes of the attack."""
    with tempfile.TemporaryDirectory() as folder, for_large_messages(Path(folder)):
        run = Attack(options, Path(folder), index)
        try:
            run.run(parts)
        except FoundError as error:
            run.found.insert(0, str(error))
        except KeyboardInterrupt:
            run.interrupted = True
        if run.found:
            run.last_lines = last_lines(run.log)
    return run


def queues(namespace: str) -> Iterator[str]:
    """Yield the arguments of a node whose queues lose no message."""
    yield from ("-p", f"qos_overrides.{namespace}/collisions.publisher.depth:={DEPTH}")
    for topic in (*INPUTS, DETECTIONS.topic, f"{ROBOT}/{JOINT_STATES}"):
        start = f"qos_overrides.{namespace}/{topic}.subscription"
        yield from ("-p", f"{start}.depth:={DEPTH}", "-p", f"{start}.reliability:=reliable")


class Attack:
    """Attacks nodes one after another, and notes findings."""

    def __init__(self, options: argparse.Namespace, folder: Path, index: int) -> None:
        self._options, self._folder = options, folder
        self.log = options.log or folder / "node.log"
        if options.log and index:
            self.log = options.log.with_name(f"{options.log.name}.{index}")
        self._domain = own_domain()
        self._namespace = f"/fuzz_{os.getpid()}"  # two attacks may have the same domain
        self.reached = ""
        """The batch that was sent last."""
        self.result: Result | None = None
        self.found: list[str] = []
        self.interrupted = False
        self.last_lines: list[str] = []
        """Of the output of the node, where something was found."""

    def run(self, parts: list[Part]) -> None:
        """Run parts; raise FoundError where the node reacts wrongly."""
        for what, first, last in (part for part in parts if part[0] in READERS):
            self._read_files(what, first, last)
        rest = [part for part in parts if part[0] not in READERS and part[1] < part[2]]
        if rest:
            self._attack_node(rest)

    def _start(self, arguments: list[str]) -> Child:
        """Start a node."""
        folders = f"mesh_folders:=[{str(self._folder)!r}]"
        given = ["--ros-args", "-r", f"__ns:={self._namespace}", "-p", folders]
        given += [word for one in SOURCES for word in ("-p", one)]
        given += [*queues(self._namespace), *arguments, "--ros-args", *self._options.node]
        return Child(given, self._domain, self.log, MODULE)

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


READING = 10.0
"""Seconds that a file may take, without those for which its reader waits for a processor."""
REFUSED = 1
"""Exit code of a node whose scene file can't be used."""
READY = "ready: "
"""In the log of a node that has started."""


def attack_reader(what: str, folder: Path, seed: int, first: int, last: int) -> tuple[int, float]:
    """Have a process read mutated files of a kind, "scene" or "robot".

    Returns the number of refused files, and the longest time for a file (s).
    """
    numbers = [str(number) for number in (seed, first, last)]
    module = "tools.fuzz.files"
    process = subprocess.Popen(
        [sys.executable, "-m", module, what, str(folder), *numbers],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    output, errors = process.communicate()
    done = [json.loads(line) for line in output.splitlines()]
    if process.returncode != 0 or len(done) != last - first:
        raise FoundError(f"{what}:{first + len(done)} ended its reader: {errors[-2000:]}")
    longest = max(done, key=lambda row: row[1])
    if longest[1] > READING:
        raise FoundError(f"{what}:{longest[0]} took {longest[1]:.1f} s")
    return sum(bool(refused) for _, _, refused in done), longest[1]


def attack_node(folder: Path, seed: int, number: int, start: Callable[[list[str]], Child]) -> bool:
    """Start a node with a scene file; return whether the node accepted the file."""
    path = folder / "node_scene.yaml"
    path.write_bytes(mutated_scene(seed, number))
    child = start(["-p", f"scene_file:={path}"])
    end = time.monotonic() + STARTING
    while child.exit_code is None and not child.said(READY):
        if time.monotonic() > end:
            child.end()
            raise FoundError(f"a node with scene:{number} neither started nor ended")
        time.sleep(0.05)
    taken = child.exit_code is None
    code, lines = child.end(), child.lines()
    if code != (0 if taken else REFUSED) or any("Traceback" in line for line in lines):
        raise FoundError(f"a node with scene:{number} ended with {code}: {lines[-1:]}")
    return taken


def _only(text: str) -> Part:
    match = ONLY.fullmatch(text)
    if match is None or int(match[3] or match[2]) < int(match[2]):
        raise argparse.ArgumentTypeError(f"must be like raw:17 or message:0-99, not {shown(text)}")
    return match[1], int(match[2]), int(match[3] or match[2]) + 1


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
    option(parser, "--seed", SEED, 1, "seed of the random numbers")
    text = (
        "only this of the attack of the seed, one message at a time: message:12, raw:0-99, scene:3"
    )
    option(parser, "--only", _only, text=text)
    text = "seconds that the node may be blocked, with 0.1 more per megabyte of a batch"
    option(parser, "--bound", real(0.0, 3600.0), 0.1, text)
    text = "megabytes by which its memory may grow in the second half of the attack"
    option(parser, "--growth", real(0.0, 1e6), 15.0, text)
    option(parser, "--log", new_file(), text="file for the node's output")
    parser.add_argument("node", nargs="*", metavar="NODE_ARGUMENT", help="argument of the node")
    return parser


@interruptible(PROGRAM)
def main(args: Sequence[str] | None = None) -> int:
    """Attack a node; returns 0 only without findings."""
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
