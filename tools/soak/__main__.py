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
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from random import Random

from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.cli import SEED, Parser, new_file, option, real, whole
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.objects.shape_requests import KEPT_SHAPES
from obb_collision.node.topics.topics import collisions_from_ros
from tools.fuzz.client import STARTING, Client, FoundError
from tools.fuzz.process import Child, own_domain
from tools.soak.checker import Checker, Result, found_in
from tools.soak.world import (
    FRAME,
    KINDS,
    MARKERS,
    PLACES,
    SCENERY,
    Change,
    World,
    built_shape,
    messages_of,
    obstacles,
    scenery_of,
)

SCENERY_SHARE, CLOUDS = 0.2, 0.2
"""Share of the messages of markers with scenery, and of the steps with a cloud of points."""


class Session:
    """The steps of a run and their results; ``child`` is the node."""

    def __init__(self, seed: int, objects: int, domain: int, result: Result) -> None:
        self._world, self._random = World(seed, objects), Random(seed)
        self._checker, self._result = Checker(self._world, result), result
        self.client = Client(domain, f"/soak_{domain}", KINDS)
        self.client.node.create_subscription(PointCloud2, "collisions", self._take, 100)
        self._stamp = 0
        self._is_begun = self._is_answered = False
        self._answered = 0.0

    def begin(self, child: Child) -> None:
        """Wait until the node answers, and all effects are computed, for the first bodies."""
        client = self.client
        client.listen_to_all()
        client.until(child, client.have_subscribers, "inputs", STARTING)
        self._send(self._world.first())
        client.until(child, lambda: self._is_answered, "answer to the first bodies", STARTING)
        client.until(child, client.is_all_computed, "effects, all computed", STARTING)
        self._fill_cache(child)
        self._checker.end()
        self._is_begun = True

    def _fill_cache(self, child: Child) -> None:
        """Have as many shapes built as the node keeps: from then on new ones replace old ones."""
        header = Header(stamp=stamp_to_ros(time.time_ns()), frame_id=FRAME)
        places = range(PLACES, PLACES + KEPT_SHAPES)
        shapes = [built_shape(self._random, header, place) for place in places]
        for markers in (shapes, [Marker(ns=SCENERY, action=Marker.DELETEALL)]):
            here = markers is shapes
            self.client.publishers[MARKERS].publish(MarkerArray(markers=markers))

            def done(here: bool = here) -> bool:
                client = self.client
                built = client.diagnostics is not None and not client.count(
                    "unplaceable", "objects"
                )
                return built and here == (client.count("count", "objects") > KEPT_SHAPES)

            self.client.until(child, done, "shapes, all built", STARTING)

    def step(self, child: Child) -> None:
        """Change the scene, and wait for an answer with all changes, or a wrong one."""
        self._is_answered = False
        start = time.perf_counter()
        self._send(self._world.step())
        what = f"answer to step {self._world.steps}"
        self.client.until(child, lambda: self._is_answered or self._result.wrong, what)
        if self._result.wrong:
            return
        self._result.latencies.append(self._answered - start)
        self._checker.end()
        self._result.steps += 1

    def end(self, child: Child) -> None:
        """Read the last diagnostics: refused messages, and internal errors."""
        for key, count in self.client.last_counts(child):
            if count and key.startswith("rejected: "):
                self._result.refused[key.partition(": ")[2]] = count

    def _send(self, changes: dict[str, Change]) -> None:
        """Publish the messages of a step: stamps rise, so that no state is older than the last."""
        messages = []
        for topic, change in changes.items():
            self._stamp = max(self._stamp + 1, time.time_ns())
            header = Header(stamp=stamp_to_ros(self._stamp), frame_id=FRAME)
            scenery = []
            if topic == MARKERS and self._random.random() < SCENERY_SHARE:
                scenery = [scenery_of(self._random, header)]
            messages += [(topic, one) for one in messages_of(topic, change, header, scenery)]
        if self._random.random() < CLOUDS:
            header = Header(stamp=stamp_to_ros(self._stamp), frame_id=FRAME)
            messages.append(("points", obstacles(self._random, self._world.side, header)))
        self._checker.begin(changes)
        for topic, message in messages:
            self.client.publishers[topic].publish(message)
            self._result.sent[topic] += 1

    def _take(self, message: PointCloud2) -> None:
        now = time.perf_counter()
        self.client.answers.clear()
        rows = collisions_from_ros(message)
        if not self._is_begun:
            self._is_answered = self._checker.is_complete(found_in(rows))
        elif self._checker.judge(rows) and not self._is_answered:
            self._is_answered, self._answered = True, now


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
    option(parser, "--seed", SEED, 1, "seed of the random numbers")
    option(parser, "--objects", whole(8, 1000), 120, "objects there are on average")
    option(parser, "--growth", real(0.0, 1e6), 1.0, "MB that the node's memory may grow")
    option(parser, "--json", new_file(".json"), text="file for the result, and a wrong answer")
    option(parser, "--log", new_file(), text="file for the node's output")
    parser.add_argument("node", nargs="*", metavar="NODE_ARGUMENT", help="argument of the node")
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Keep a node busy and check it; returns 0 only if everything held."""
    options = _parser().parse_args(args)
    domain = own_domain()
    result = Result(options.growth)
    with tempfile.TemporaryDirectory() as folder:
        session = Session(options.seed, options.objects, domain, result)
        log = options.log or Path(folder) / "node.log"
        given = ["--ros-args", "-r", f"__ns:={session.client.namespace}", "-p", "trigger:=arrival"]
        child = Child([*given, *options.node], domain, log)
        try:
            session.begin(child)
            _run(session, child, result, options)
            session.end(child)
        except FoundError as error:
            result.stopped = str(error)
        except KeyboardInterrupt:
            result.stopped = "interrupted"
        code = child.end()
        session.client.close()
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
