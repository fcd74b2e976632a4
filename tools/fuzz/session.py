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

"""One attack: hostile messages in batches, and after each batch a probe that must be answered.

The longest time between two answers of the node is read from the times at which it published them,
and compared with what is allowed: its period, the bound on blocking, a share for each megabyte of
this batch, the one before and those that may still be on their way, and what the machine's other
work costs: for how long its threads were ready and got no processor, or for how long a process that
only sleeps stood still in that very time, whichever is more.
"""

from __future__ import annotations

import time
from argparse import Namespace
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from random import Random

import numpy as np
from rclpy.serialization import serialize_message

from obb_collision.node.messages.clouds import boxes_to_ros
from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.topics.topics import collisions_from_ros, points_inside_from_ros
from tools.fuzz.cases import Sent, Stream, grid
from tools.fuzz.client import Answer, Client, FoundError, Services
from tools.fuzz.messages import OBSTACLE
from tools.fuzz.probes import (
    BOXES,
    COMPLETE,
    MOVES,
    NUMBERS,
    SETS,
    Message,
    Pair,
    Probe,
    Probes,
    header_at,
)
from tools.fuzz.process import Canary, Child, Usages
from tools.fuzz.robot import ask_robot

PERIOD = 0.02
"""Seconds between two answers by the node's default rate."""
PER_MEGABYTE = 0.1
"""Seconds that the node may be blocked in addition per megabyte of what may just have arrived."""
ON_ITS_WAY, ON_ITS_WAY_PER_MEGABYTE = 1.0, 0.05
"""Seconds for which a message may be on its way, and more for a large one: those that are sent
later overtake it."""
LARGE = 1_000_000
"""Bytes of a message behind which there may be as many objects as the node takes."""
REQUESTS = 0.3
"""Share of the batches behind which a service gets a hostile request."""
CLEAN = 0.2
"""Share of the probes that remove all hostile objects, too."""
ASKED = 0.3
"""Share of the batches behind which states of the robot are asked for."""
CLOUD = namespace_number(f"sources/{OBSTACLE}")
"""Namespace of what the sensor sees that is an obstacle."""
FULL = "rejected: too many objects"
"""Why objects are refused that a node has no room for."""
RESENDING = 0.5
"""Seconds after which points are sent again, whose topic is best effort, and sets of boxes, which a
hostile one overtook by a stamp a little ahead: that one counts for a second."""


class Session:
    """Attacks a node with the messages of a stream."""

    def __init__(
        self,
        options: Namespace,
        stream: Stream,
        client: Client,
        child: Child,
        canary: Canary,
    ) -> None:
        self._seed, self._bound = options.seed, options.bound
        self._stream, self._client, self._child, self._canary = stream, client, child, canary
        self._probes = Probes(stream.messages)
        self._recent: list[tuple[float, int]] = []  # till when batches may arrive, and their bytes
        self.result = Result()
        client.wait_for_start(child)
        self._services = Services(client, child)
        self._most_pairs = self._services.given("max_pairs")
        self._fill(self._services.given("max_objects"))

    def _fill(self, most: int) -> None:
        """Have the node store the maximum number of objects, then none: it keeps their memory.

        If hostile messages filled it later, that would look like growth.
        """
        for count in (most, 0):
            numbers, sizes = [namespace_number(SETS)] * count, np.ones((count, 3))
            header = header_at(time.time_ns())
            boxes = boxes_to_ros(np.arange(count), grid(count), sizes, numbers, header)
            self._client.publishers["object_boxes"].publish(boxes)

            def reached(least: int = max(count, 1)) -> bool:  # the sensor's is there
                return self._client.count("count", "objects") == least

            self._client.until(self._child, reached, f"{count} objects")

    def batch(self, name: str, sent: list[Sent]) -> None:
        """Send hostile messages and a probe; raise FoundError where the node reacts wrongly."""
        client, random = self._client, Random(f"{self._seed} batch {name}")
        client.answers = client.answers[-1:]
        began, before = time.monotonic(), self._child.delays()
        for number, message in enumerate(sent):
            client.publishers[message.topic].publish(message.data)
            self.result.sent[message.topic] += 1
            if number % 10 == 0:
                client.spin()
        size = sum(len(message.data) for message in sent)
        full = any(len(message.data) > LARGE for message in sent)
        if random.random() < REQUESTS:
            self.result.sent[f"service {self._services.attack(random)}"] += 1
        self._probe(random, full)
        if self._stream.robot is not None and random.random() < ASKED:
            ask_robot(self._stream.robot, random, client, self._child)
            self.result.probes["states of a robot"] += 1
        way = ON_ITS_WAY + ON_ITS_WAY_PER_MEGABYTE * size / 1e6
        late = [one for one in self._recent[:-1] if one[0] > began]
        self._recent = [*late, *self._recent[-1:], (began + way, size)]
        self._measure(name, sum(size for _, size in self._recent), before)

    def _measure(self, name: str, size: int, before: dict[str, float]) -> None:
        """Note how long the node was blocked, and what it uses."""
        result, waited, stalls = self.result, self._child.waited(before), self._canary.stalls()
        for first, second in pairwise(self._client.answers):
            lost = second.number - first.number - 1 if first.number and second.number else 0
            result.lost += lost
            if lost:
                continue
            start, end = first.stamp / NANOSECONDS, second.stamp / NANOSECONDS
            still = sum(max(0.0, min(end, b) - max(start, a)) for a, b in stalls)
            result.longest = max(result.longest, end - start)
            allowed = PERIOD + self._bound + PER_MEGABYTE * size / 1e6
            if end - start > allowed + max(waited, still):
                result.late.append((name, end - start, allowed + max(waited, still)))
            elif end - start > allowed:
                result.excused += 1
        result.usages.add(self._child.usage())

    def _probe(self, random: Random, full: bool) -> None:
        """Send boxes and wait for their pairs, all of them and no other."""
        number, everything = self.result.probes.total(), full or random.random() < CLEAN
        probe = self._probes.make(number, random, time.time_ns(), everything, full)
        if probe.kind in MOVES:
            self._ask(number, probe, probe.first, probe.known)
            found = self._ask(number, probe, probe.messages, probe.sure)
        else:
            found = self._ask(number, probe, probe.first + probe.messages, probe.sure)
        if found != probe.pairs:
            later = self._ask(number, probe, [], probe.sure)
            raise FoundError(
                f"pairs of probe {number}, by {probe.kind}: missing "
                f"{sorted(probe.pairs - found)}, wrong {sorted(found - probe.pairs)}; "
                f"in the next answer missing {sorted(probe.pairs - later)}, wrong "
                f"{sorted(later - probe.pairs)}; {self._client.status()}"
            )
        if probe.kind == "markers" and random.random() < 0.5:
            self._probe_points(random, probe)
        elif probe.kind == "markers":
            self._probe_obstacle(random, probe)
        self.result.probes[probe.kind] += 1

    def _ask(self, number: int, probe: Probe, messages: list[Message], sure: Pair) -> set[Pair]:
        """Send messages of a probe; return its pairs in the first answer with the pair ``sure``.

        If hostile objects leave no room for its objects or pairs, they are removed again.
        """
        client, seen, no_room = self._client, len(self._client.answers), self._client.count(FULL)
        for topic, data in messages:
            client.publishers[topic].publish(data)
        what = f"answer to probe {number}, by {probe.kind}"
        next_time = time.monotonic() + RESENDING
        is_set = probe.kind in COMPLETE
        adds = not is_set and any(topic == "objects" for topic, _ in messages)

        def answered() -> set[Pair] | None:
            nonlocal next_time, seen, no_room
            fresh, seen = client.answers[seen:], len(client.answers)
            crowded = any(one.message.width >= self._most_pairs for one in fresh)
            full = adds and client.count(FULL) > no_room
            if time.monotonic() > next_time and (crowded or full or (messages and is_set)):
                again = [one for one in messages if adds or (is_set and one[0] in COMPLETE)]
                removed = probe.room if adds or is_set else probe.others
                for topic, data in [*(removed if crowded or full else ()), *again]:
                    client.publishers[topic].publish(data)
                self.result.again += 1
                next_time, no_room = time.monotonic() + RESENDING, client.count(FULL)
            return find_answer(fresh, probe.sure[0], sure, self._most_pairs)

        found: set[Pair] = self._client.until(self._child, answered, what)
        return found

    def _probe_points(self, random: Random, probe: Probe) -> None:
        """Send finite and other points, and compare the counts in boxes."""
        message, right = self._probes.points(random, probe, time.time_ns())
        data = serialize_message(message)
        next_time = 0.0

        def answered() -> tuple[dict[int, int]] | None:
            nonlocal next_time
            if time.monotonic() > next_time:
                self._client.publishers["points"].publish(data)
                next_time = time.monotonic() + RESENDING
            for found in self._client.points:
                if found.header.stamp == message.header.stamp:
                    rows = points_inside_from_ros(found)
                    rows = rows[rows["cloud_ns"] == namespace_number("sources/points")]
                    counts = zip(rows["id"].tolist(), rows["count"].tolist(), strict=True)
                    return ({ident: count for ident, count in counts if ident in right},)
            return None

        (found,) = self._client.until(self._child, answered, "points inside")
        if found != {ident: count for ident, count in right.items() if count}:
            raise FoundError(f"points inside are {found}, right is {right}")
        self.result.probes["points"] += 1

    def _probe_obstacle(self, random: Random, probe: Probe) -> None:
        """Send a cloud that is an obstacle, and wait for its pairs with the boxes."""
        message, right = self._probes.points(random, probe, time.time_ns())
        data, found = serialize_message(message), set[int]()
        wanted = {ident for ident, count in right.items() if count}
        next_time = 0.0

        def is_right() -> bool:
            nonlocal next_time, found
            if time.monotonic() > next_time:  # a hostile one of a later stamp counts for a second
                self._client.publishers[OBSTACLE].publish(data)
                next_time = time.monotonic() + RESENDING
            rows = collisions_from_ros(self._client.answers[-1].message)
            found = {
                ident
                for cloud, ident in (("ns_a", "id_b"), ("ns_b", "id_a"))
                for ident in rows[ident][rows[cloud] == CLOUD].tolist()
            } & right.keys()
            return found == wanted

        try:
            self._client.until(self._child, is_right, "pairs of a cloud")
        except FoundError as error:
            raise FoundError(f"{error}: pairs with {found}, right is {wanted}") from error
        self.result.probes["obstacles"] += 1

    def end(self) -> None:
        """Add up the last diagnostics; FoundError if the node counted internal errors."""
        for key, count in self._client.last_counts(self._child):
            what, _, reason = key.partition(": ")
            if reason:
                self.result.refused[reason] += count
            else:
                self.result.received[what] += count


def find_answer(answers: list[Answer], first: int, sure: Pair, most: int) -> set[Pair] | None:
    """Return the pairs of a probe in the first whole answer that has its sure pair, else None.

    most: limit of the pairs of an answer; an answer at the limit may lack the pairs of the probe.
    """
    for answer in answers:
        rows = collisions_from_ros(answer.message)
        if len(rows) >= most:
            continue
        ours = [name in NUMBERS for name in rows["ns_a"].tolist()]
        ids = zip(rows["id_a"][ours].tolist(), rows["id_b"][ours].tolist(), strict=True)
        pairs = {pair for pair in ids if all(first <= one < first + BOXES for one in pair)}
        if sure in pairs:
            return pairs
    return None


@dataclass
class Result:
    """What was sent and seen."""

    sent: Counter[str] = field(default_factory=Counter)
    """Messages and requests by topic and service."""
    probes: Counter[str] = field(default_factory=Counter)
    """Answered probes by the way in which their boxes came."""
    again: int = 0
    """Sets of boxes that were sent again, as a hostile one had a later stamp."""
    longest: float = 0.0
    """Longest time between two answers (s)."""
    lost: int = 0
    """Answers that the middleware lost on their way; times without them are not judged."""
    excused: int = 0
    """Times that were longer than allowed only because the machine had other work."""
    late: list[tuple[str, float, float]] = field(default_factory=list)
    """Where one was longer than allowed: the batch, its length and what is allowed."""
    usages: Usages = field(default_factory=Usages)
    received: Counter[str] = field(default_factory=Counter)
    """Messages that the node has received, and those that its queues lost."""
    refused: Counter[str] = field(default_factory=Counter)


MORE = 8
"""Descriptors and threads by which a node may grow after warm-up: of what comes and goes."""


def print_results(results: list[Result]) -> None:
    """Print what was sent and seen by all sessions together."""
    sent, received, probes, refused = (
        sum((getattr(result, name) for result in results), Counter[str]())
        for name in ("sent", "received", "probes", "refused")
    )
    late = [row for result in results for row in result.late]
    print(f"sent: {sent.total()} ({_listed(sent)})")
    print(f"received by the inputs of the node: {_listed(received)}")
    print(f"probes answered right: {probes.total()} ({_listed(probes)})")
    again = sum(result.again for result in results)
    print(f"sets of boxes sent again, most after hostile ones with later stamps: {again}")
    print(
        f"longest time without an answer: {max(result.longest for result in results):.3f} s; "
        f"{len(late)} times longer than allowed, {sum(result.excused for result in results)} times "
        f"by what other programs took; {sum(result.lost for result in results)} answers lost on "
        "their way"
    )
    for batch, gap, allowed in late[:10]:
        print(f"  during {batch}: {gap:.3f} s, allowed were {allowed:.3f} s")
    for result in results:
        _print_usages(result)
    print(f"refused: {_listed(refused) or 'nothing was read'}")


def _print_usages(result: Result) -> None:
    samples, growth = result.usages.samples, result.usages.growth()
    if samples:
        first, last = samples[0], samples[-1]
        print(
            f"memory of the node: {_megabytes(first.memory)} after the first batch, "
            f"{_megabytes(last.memory)} at the end; by tenths of the attack "
            f"{', '.join(f'{size / 1e6:.0f}' for size in result.usages.course())}"
        )
    if growth is not None:
        print(
            f"after warm-up it grew by {_megabytes(growth.memory)}, {growth.descriptors} "
            f"descriptors, {growth.threads} threads"
        )


def faults(result: Result, most: float) -> list[str]:
    """Return the goals that were missed; most: allowed growth of memory (MB)."""
    found = []
    if result.late:
        found.append(
            f"the node was blocked for longer than allowed, first during {result.late[0][0]}"
        )
    growth = result.usages.growth()
    if growth is not None and growth.memory > most * 1e6:
        found.append(f"its memory grew by {_megabytes(growth.memory)}")
    if growth is not None and max(growth.descriptors, growth.threads) > MORE:
        found.append(f"it grew by {growth.descriptors} descriptors, {growth.threads} threads")
    return found


def _megabytes(size: float) -> str:
    return f"{size / 1e6:.1f} MB"


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
