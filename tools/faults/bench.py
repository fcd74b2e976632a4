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

"""A node in another process, and a client that asks whether it answers right, and how soon."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.conversions import (
    NANOSECONDS,
    stamp_to_ros,
    transform_to_ros,
)
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.topics.topics import DEADLINE, collisions_from_ros
from tools.faults.peers import READY, cube
from tools.fuzz.process import Child, status_of

PEERS = "tools.faults.peers"


class Process(Child):
    """A node or a program beside it: started in an environment, limited, stopped, killed."""

    def limit(self, what: int, most: int) -> None:
        """Limit a resource of the running process (RLIMIT_*); its parent's stays."""
        _, hard = resource.prlimit(self.number, what)
        resource.prlimit(self.number, what, (most if most >= 0 else hard, hard))

    def status(self, field: str) -> int:
        """Return a size from /proc (bytes), such as VmRSS."""
        return status_of(self.number, field)

    def scheduled(self) -> tuple[int, int]:
        """Return for how long the main thread has run, and has waited for a processor (ns)."""
        running, waiting, _ = Path(f"/proc/{self.number}/schedstat").read_text().split()
        return int(running), int(waiting)

    def crowding(self, before: tuple[int, int]) -> float:
        """Return how many times longer than alone all took since ``scheduled`` was as given."""
        pairs = zip(self.scheduled(), before, strict=True)
        running, waiting = (now - then for now, then in pairs)
        return 1.0 + waiting / max(running, 1)

    def descriptors(self) -> int:
        """Return how many files it has open."""
        return len(os.listdir(f"/proc/{self.number}/fd"))

    def said(self, text: str) -> bool:
        """Return whether its output has a text."""
        return text in self.log.read_text(errors="replace")


STARTING = 120.0
"""Seconds until a node answers first, with its kernels compiled."""
ANSWERING = 20.0
"""Seconds in which a node must answer: longer means that it is blocked, blind or wrong."""
REPEAT = 0.25
"""Seconds after which a question is asked again: the message may have been dropped by overload."""
PROBE = "probe"
PLACES = ((0.0, 0.5, 9.0), (0.0, 9.0, 9.5), (0.0, 9.0, 0.5), (0.0, 5.0, 9.0))
"""Where three unit cubes are (m), so that another pair collides each time, and once none."""
PAIRS = ({(1, 2)}, {(2, 3)}, {(1, 3)}, set[tuple[int, int]]())
LATCHED = DurabilityPolicy.TRANSIENT_LOCAL


class FaultError(Exception):
    """What a node did and should not have done, or the other way round."""


class Bench:
    """A client of nodes in a namespace of its own."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder, self.domain = folder, domain
        self.namespace = f"/faults_{os.getpid()}"  # others may have the same domain
        self._context = Context()
        self._context.init(args=[], domain_id=domain)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._node = Node("faults", context=self._context, namespace=self.namespace)
        self._executor.add_node(self._node)
        self._processes: list[Process] = []
        self._turn = 0
        self.answers: list[tuple[float, set[tuple[int, int]]]] = []
        """When the node published, and the colliding pairs of the probe."""
        self.status = DiagnosticStatus()
        self.levels: set[bytes] = set()
        """Levels of the status so far."""
        self.deadlines: list[float] = []
        """When the middleware said that no status came in time."""
        self.diagnostics: dict[str, dict[str, str]] = {}
        self._publish: dict[str, Any] = {}
        self.listen(self.namespace)
        self._clock = self._node.create_publisher(Clock, "/clock", 10)

    def listen(self, namespace: str) -> None:
        """Talk to the node of a namespace."""
        node, probe = self._node, namespace_number(PROBE)
        self.namespace = namespace

        def take(message: PointCloud2, info: Any) -> None:
            rows = collisions_from_ros(message)
            rows = rows[(rows["ns_a"] == probe) & (rows["ns_b"] == probe)]
            pairs = set(zip(rows["id_a"].tolist(), rows["id_b"].tolist(), strict=True))
            self.answers.append((info["source_timestamp"] / NANOSECONDS, pairs))

        def note_status(message: DiagnosticArray) -> None:
            (self.status,) = message.status
            self.levels.add(self.status.level)

        def note_diagnostics(message: DiagnosticArray) -> None:
            for status in message.status:
                if status.name.startswith(self.namespace[1:]):
                    values = {pair.key: pair.value for pair in status.values}
                    key = status.name.split(": ", 1)[-1]
                    self.diagnostics[key] = {"message": status.message} | values

        taker: Any = take  # rclpy finds out that it wants the times, too
        node.create_subscription(PointCloud2, f"{namespace}/collisions", taker, 1000)
        callbacks = SubscriptionEventCallbacks(
            deadline=lambda event: self.deadlines.append(time.monotonic())
        )
        qos = QoSProfile(depth=1, durability=LATCHED, deadline=Duration(seconds=DEADLINE))
        topic = f"{namespace}/collision_status"
        node.create_subscription(
            DiagnosticArray, topic, note_status, qos, event_callbacks=callbacks
        )
        node.create_subscription(DiagnosticArray, "/diagnostics", note_diagnostics, 10)
        kinds = {"objects": MarkerArray, "object_transform": TransformStamped}
        self._publish = {
            name: node.create_publisher(kind, f"{namespace}/{name}", 100)
            for name, kind in kinds.items()
        }

    def close(self) -> None:
        """End all processes and the client."""
        for process in self._processes:
            process.kill()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def start(
        self, *parameters: str, namespace: str = "", wait: bool = True, **environment: str
    ) -> Process:
        """Start a node with parameters ``name:=value``, and wait until it answers."""
        words = [word for parameter in parameters for word in ("-p", parameter)]
        arguments = ["--ros-args", "-r", f"__ns:={namespace or self.namespace}", *words]
        log = self.folder / f"node_{len(self._processes)}.log"
        process = Process(arguments, self.domain, log, **environment)
        self._processes.append(process)
        if wait:
            self.meet()
            self.probe(STARTING)
        return process

    def peer(self, kind: str) -> Process:
        """Start a program of ``peers``, and wait until it is at work."""
        log = self.folder / f"{kind}_{len(self._processes)}.log"
        process = Process([kind, self.namespace], self.domain, log, PEERS)
        self._processes.append(process)
        self.until(lambda: process.said(READY), f"{kind} at work", STARTING)
        return process

    def until(self, reached: Callable[[], Any], what: str, limit: float = ANSWERING) -> float:
        """Wait for something; returns the seconds it took. FaultError if it does not come."""
        start = time.monotonic()
        while not reached():
            for process in self._processes:
                if process.exit_code not in (None, 0, -9, -2):
                    raise FaultError(f"a process ended with {process.exit_code} before {what}")
            if time.monotonic() > start + limit:
                raise FaultError(f"no {what} within {limit:g} s")
            self._executor.spin_once(timeout_sec=0.02)
        return time.monotonic() - start

    def spin(self, seconds: float) -> None:
        """Receive for some time."""
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end, "end of a time", seconds + 1.0)

    def meet(self, limit: float = STARTING) -> None:
        """Wait until a node has the publishers of the client."""
        publishers = self._publish.values()
        self.until(lambda: all(p.get_subscription_count() for p in publishers), "node", limit)

    def probe(self, limit: float = ANSWERING, stamp: float = 0.0) -> float:
        """Move the probe; returns after how many seconds the node answered right."""
        self._turn = (self._turn + 1) % len(PLACES)
        places, wanted = PLACES[self._turn], PAIRS[self._turn]
        markers = [cube((PROBE, n + 1), (x, 0.0, 0.0), stamp) for n, x in enumerate(places)]
        asked = start = time.monotonic()
        self._publish["objects"].publish(MarkerArray(markers=markers))
        since = time.time()

        def is_right() -> bool:
            nonlocal asked
            if time.monotonic() > asked + REPEAT:
                asked = time.monotonic()
                self._publish["objects"].publish(MarkerArray(markers=markers))
            return any(at > since and pairs == wanted for at, pairs in self.answers[-3:])

        self.until(is_right, "right answer", limit)
        return time.monotonic() - start

    def probes(self, seconds: float) -> float:
        """Probe for some time; returns the longest time without an answer of the node."""
        self.answers.clear()
        start = time.time()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.probe()
        times = [start, *(at for at, _ in self.answers), time.time()]
        return max(after - before for before, after in pairwise(times))

    def send(self, markers: Iterable[Marker]) -> None:
        """Publish markers."""
        self._publish["objects"].publish(MarkerArray(markers=list(markers)))

    def send_apart(self, markers: Iterable[Marker]) -> None:
        """Publish markers by a publisher of their own, which waits for nobody."""
        topic = f"{self.namespace}/objects"
        publisher = self._node.create_publisher(MarkerArray, topic, 1)
        self.until(publisher.get_subscription_count, "node")
        publisher.publish(MarkerArray(markers=list(markers)))

    def move(self, name: str, x: float, stamp: float = 0.0) -> None:
        """Publish one pose."""
        message = TransformStamped(child_frame_id=name)
        message.header.frame_id = "map"
        message.header.stamp = stamp_to_ros(round(stamp * NANOSECONDS))
        message.transform = transform_to_ros((x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        self._publish["object_transform"].publish(message)

    def send_cut(self) -> None:
        """Publish a message that ends too early."""
        data = serialize_message(MarkerArray(markers=[cube((PROBE, 1), PLACES[0])]))
        self._publish["objects"].publish(data[: len(data) // 2])

    def tick(self, seconds: float) -> None:
        """Publish a time of the simulation."""
        self._clock.publish(Clock(clock=stamp_to_ros(round(seconds * NANOSECONDS))))

    def is_stale(self, *codes: str) -> bool:
        """Return whether it is not known what collides, for one of the reasons."""
        stale = self.status.level == DiagnosticStatus.STALE
        return stale and (not codes or not self.codes.isdisjoint(codes))

    @property
    def codes(self) -> set[str]:
        """What the status says is missing."""
        values = {pair.key: pair.value for pair in self.status.values}
        return set(values.get("reasons", "").split())

    def value(self, status: str, key: str) -> float:
        """Return a number of /diagnostics, 0 where it is not there."""
        return float(self.diagnostics.get(status, {}).get(key, "0"))


def check(is_so: bool, what: str) -> None:
    """Raise FaultError with what is seen instead of what was expected."""
    if not is_so:
        raise FaultError(what)
