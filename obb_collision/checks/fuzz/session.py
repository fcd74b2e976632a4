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

A probe is an own set of cubes, sent in one message behind a DELETEALL of its namespace, now and
then of everything; its pairs are known from intervals of exact numbers. The longest time between
two answers of the node is read from the times at which it published them, and compared with what
is allowed: its period, the bound on blocking, what rclpy takes to decode the largest messages of
the batch (measured here), and how late a process that only sleeps was meanwhile, twice: for what
the machine's other work costs.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from pathlib import Path
from random import Random
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.checks.fuzz.child import Child
from obb_collision.checks.fuzz.messages import Messages
from obb_collision.checks.fuzz.metronome import Metronome
from obb_collision.checks.fuzz.mutations import damaged, hostile_value, mutate
from obb_collision.node.messages.conversions import NANOSECONDS, pose_to_ros, stamp_to_ros
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.parameters.table import SPECS
from obb_collision.node.topics.topics import TOPICS, collisions_from_ros

STARTING = 300.0
"""Seconds until the node answers first: on a new machine it compiles its kernels."""
ANSWERING = 20.0
"""Seconds in which a probe must be answered; longer means that the node is blocked or blind."""
PERIOD = 0.02
"""Seconds between two answers by the node's default rate."""
BATCH = 100
"""Hostile messages between two probes."""
DAMAGED = 0.15
"""Share of the messages whose bytes are damaged, besides what their fields hold."""
LARGE = 20_000
"""Bytes of a serialised message above which its decoding is timed."""
PROBE, FIRST_PROBE_ID, CUBES = "probe", 1_000_000, 6
CLEAN = 0.2
"""Share of the probes that remove all hostile objects, too."""
PROBE_NUMBER = namespace_number(PROBE)
OUTPUTS = {
    topic.name.replace("~", "obb_collision"): topic.message
    for name, topic in TOPICS.items()
    if name not in ("collisions", "collision_status", "diagnostics")
}


class FoundError(Exception):
    """What an attack found."""


@dataclass
class Result:
    """What was sent and seen."""

    sent: Counter[str] = field(default_factory=Counter)
    probes: int = 0
    longest: float = 0.0
    """Longest time between two answers (s)."""
    late: list[tuple[int, float, float]] = field(default_factory=list)
    """Where one was longer than allowed: messages sent by then, its length and what is allowed."""
    memory: tuple[int, int] = (0, 0)
    """Resident memory of the node (bytes) after the first batch and at the end."""
    refused: dict[str, int] = field(default_factory=dict)


class Session:
    """A client of a node in another process."""

    def __init__(self, seed: int, domain: int, folder: Path, bound: float) -> None:
        self._random, self._bound = Random(seed), bound
        self._namespace = f"/fuzz_{domain}"
        self._folder = folder
        self._messages = Messages(self._random, folder)
        self.result = Result()
        self._context = Context()
        self._context.init(args=[], domain_id=domain)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._node = Node("fuzz", context=self._context, namespace=self._namespace)
        self._executor.add_node(self._node)
        makers = self._messages.makers.items()
        self._publishers = {
            topic: self._node.create_publisher(kind, topic, QoSProfile(depth=1000))
            for topic, (kind, _) in makers
        }
        self._answers: list[tuple[int, PointCloud2]] = []
        self._diagnostics: DiagnosticArray | None = None
        take: Any = self._take  # rclpy finds out that it wants the times, too
        self._node.create_subscription(PointCloud2, "collisions", take, 1000)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._take_status, 10)
        for topic, kind in OUTPUTS.items():  # somebody listens: every effect is computed
            self._node.create_subscription(kind, topic, lambda message: None, 10, raw=True)
        self._given: dict[str, Any] = {}
        self._metronome = Metronome()

    def arguments(self) -> list[str]:
        """Return what the node's process is to be started with."""
        folders = f"mesh_folders:=[{str(self._folder)!r}]"
        return ["--ros-args", "-r", f"__ns:={self._namespace}", "-p", folders]

    def close(self) -> None:
        """Take the client down."""
        self._metronome.end()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _take(self, message: PointCloud2, info: Any) -> None:
        self._answers.append((int(info["source_timestamp"]), message))

    def _take_status(self, message: DiagnosticArray) -> None:
        if message.status and message.status[0].name.startswith(self._namespace[1:]):
            self._diagnostics = message

    def _until(
        self, child: Child, reached: Callable[[], Any], what: str, limit: float = ANSWERING
    ) -> Any:
        end = time.monotonic() + limit
        while not (found := reached()):
            if child.exit_code is not None:
                raise FoundError(f"the node ended with {child.exit_code} before {what}")
            if time.monotonic() > end:
                raise FoundError(f"no {what} within {limit:g} s")
            self._executor.spin_once(timeout_sec=0.05)
        return found

    def begin(self, child: Child) -> None:
        """Wait until the node answers, and note its parameters."""
        publishers = self._publishers.values()
        self._until(
            child, lambda: all(p.get_subscription_count() for p in publishers), "inputs", STARTING
        )
        self._until(child, lambda: self._answers, "collisions", STARTING)
        names = [spec.name for spec in SPECS]
        request = GetParameters.Request(names=names)
        values = self._call(child, GetParameters, "get_parameters", request).values
        self._given = dict(zip(names, values, strict=True))
        self._until(child, lambda: self._diagnostics, "diagnostics")
        self._until(child, self._all_computed, "effects, all computed", STARTING)

    def _all_computed(self) -> bool:
        """Whether no effect waits for its kernels any more."""
        assert self._diagnostics is not None
        values = [pair for status in self._diagnostics.status for pair in status.values]
        states = [pair.value for pair in values if pair.key.startswith("effect ")]
        return bool(states) and not any("ready" in state for state in states)

    def batch(self, child: Child, count: int) -> None:
        """Send ``count`` hostile messages and a probe; FoundError for what should not be."""
        self._answers = self._answers[-1:]
        decoding: dict[str, float] = {}
        self._metronome.restart()
        for number in range(count):
            topic = self._random.choice(list(self._publishers))
            data = self._hostile(topic)
            if len(data) > LARGE:
                decoding[topic] = max(decoding.get(topic, 0.0), self._decoding(data, topic))
            if self._random.random() < DAMAGED:
                data = damaged(data, self._random)
            self._publishers[topic].publish(data)
            self.result.sent[topic] += 1
            if number % 10 == 0:
                self._executor.spin_once(timeout_sec=0.0)
        if self._random.random() < 0.3:
            self._disturb(child)
        self._probe(child)
        times = [stamp / NANOSECONDS for stamp, _ in self._answers]
        gap = max((after - before for before, after in pairwise(times)), default=0.0)
        allowed = PERIOD + self._bound + sum(decoding.values()) + 2.0 * self._metronome.latest
        self.result.longest = max(self.result.longest, gap)
        if gap > allowed:
            self.result.late.append((self.result.sent.total(), gap, allowed))
        memory = child.memory()
        self.result.memory = (self.result.memory[0] or memory, memory)

    def _hostile(self, topic: str) -> bytes:
        message, random = self._messages.makers[topic][1](), self._random
        for _ in range(random.choice((0, 1, 1, 2, 5))):
            try:
                mutate(message, random)
            except AssertionError:  # rclpy refuses to set it, so it can't be sent
                continue
        return serialize_message(message)

    def _decoding(self, data: bytes, topic: str) -> float:
        """Return how long rclpy takes to decode a message (s)."""
        start = time.perf_counter()
        deserialize_message(data, self._messages.makers[topic][0])
        return time.perf_counter() - start

    def _disturb(self, child: Child) -> None:
        """Set a parameter to anything, and call a service; then as it was."""
        random = self._random
        name = random.choice(list(self._given))
        request = SetParameters.Request()
        request.parameters = [_hostile_parameter(name, random)]
        answer = self._call(child, SetParameters, "set_parameters", request)
        self.result.sent["parameters"] += 1
        if answer.results[0].successful:
            request.parameters[0].value = self._given[name]
            back = self._call(child, SetParameters, "set_parameters", request).results[0]
            if not back.successful:
                value = parameter_value_to_python(self._given[name])
                raise FoundError(f"{name} can't be set back to {value!r}: {back.reason}")
        if random.random() < 0.2:
            self._call(child, Trigger, "clear", Trigger.Request())
        if random.random() < 0.2:
            for data in (False, True):
                self._call(child, SetBool, "enable", SetBool.Request(data=data))

    def _call(self, child: Child, kind: Any, name: str, request: Any) -> Any:
        client = self._node.create_client(kind, f"obb_collision/{name}")
        try:
            self._until(child, client.service_is_ready, f"service {name}")
            future = client.call_async(request)
            return self._until(child, lambda: future.done() and future.result(), f"answer {name}")
        finally:
            self._node.destroy_client(client)

    def _probe(self, child: Child) -> None:
        """Send cubes and wait for their pairs, all of them and no other."""
        random, stamp = self._random, time.time_ns()
        everything = random.random() < CLEAN
        delete = Marker(action=Marker.DELETEALL, ns="" if everything else PROBE)
        message = MarkerArray(markers=[delete])
        first, cubes = FIRST_PROBE_ID + CUBES * self.result.probes, []
        for number in range(CUBES):
            edges = [random.randint(1, 8) / 8 for _ in range(3)]
            # the first two always meet: by their pair the answer is known
            place = [random.randint(0, 16) / 8 if number > 1 else 1.0 for _ in range(3)]
            cubes.append((place, edges))
            marker = Marker(ns=PROBE, id=first + number, type=Marker.CUBE)
            marker.header.frame_id, marker.header.stamp = "map", stamp_to_ros(stamp)
            marker.pose = pose_to_ros((*place, 0.0, 0.0, 0.0, 1.0))
            marker.scale.x, marker.scale.y, marker.scale.z = edges
            message.markers.append(marker)
        self._publishers["objects"].publish(message)
        seen = len(self._answers)
        what = f"answer to probe {self.result.probes}"
        found = self._until(child, lambda: self._answer(seen, (first, first + 1)), what)
        wanted = {
            (first + i, first + j)
            for i, j in combinations(range(CUBES), 2)
            if _meet(cubes[i], cubes[j])
        }
        if found != wanted:
            raise FoundError(f"pairs of the probe: {sorted(found)}, right is {sorted(wanted)}")
        self.result.probes += 1

    def _answer(self, seen: int, pair: tuple[int, int]) -> set[tuple[int, int]] | None:
        """Return the pairs among probes of the first answer that has a pair, None for not yet."""
        for _, message in self._answers[seen:]:
            rows = collisions_from_ros(message)
            rows = rows[(rows["ns_a"] == PROBE_NUMBER) & (rows["ns_b"] == PROBE_NUMBER)]
            ids = zip(rows["id_a"].tolist(), rows["id_b"].tolist(), strict=True)
            if pair in (pairs := set(ids)):
                return pairs
        return None

    def end(self, child: Child) -> None:
        """Read the last diagnostics; FoundError where the node counted internal errors."""
        self._diagnostics = None
        message = self._until(child, lambda: self._diagnostics, "diagnostics")
        for status in message.status:
            for pair in status.values:
                if pair.key.startswith("rejected: "):
                    reason = pair.key.partition(": ")[2]
                    self.result.refused[reason] = self.result.refused.get(reason, 0) + int(
                        pair.value
                    )
            if status.name.endswith("internal errors") and status.level != status.OK:
                counts = "; ".join(f"{pair.key}: {pair.value}" for pair in status.values)
                raise FoundError(f"the node counted internal errors: {counts}")


Cube = tuple[list[float], list[float]]


def _meet(a: Cube, b: Cube) -> bool:
    """Return whether closed cubes meet; all numbers are multiples of 1/8, exact in doubles."""
    return all(2 * abs(p - q) <= s + t for p, q, s, t in zip(a[0], b[0], a[1], b[1], strict=True))


def _hostile_parameter(name: str, random: Random) -> Parameter:
    value = ParameterValue(type=random.randrange(10))
    value.bool_value = random.random() < 0.5
    value.integer_value = hostile_value("int64", random)
    value.double_value = hostile_value("double", random)
    value.string_value = hostile_value("string", random)
    value.byte_array_value = [b"\0"] * random.randint(0, 3)
    value.bool_array_value = [True] * random.randint(0, 3)
    value.integer_array_value = [1] * random.randint(0, 3)
    value.double_array_value = [hostile_value("double", random)] * random.randint(0, 3)
    texts = ("* *", "a/* b/*", "a/1: mesh", "*: hull", "a=sphere", "", "a", value.string_value)
    value.string_array_value = [random.choice(texts) for _ in range(random.randint(0, 3))]
    return Parameter(name=name, value=value)
