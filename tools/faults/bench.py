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
import time
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.conversions import (
    NANOSECONDS,
    stamp_to_ros,
    transform_to_ros,
)
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.topics.topics import DEADLINE, collisions_from_ros
from tools.faults.peers import READY, cube
from tools.fuzz.client import ANSWERING, Answer, Client, FoundError
from tools.fuzz.process import Child

PEERS = "tools.faults.peers"
STARTING = 120.0
"""Seconds until a node answers first, with its kernels compiled."""
REPEAT = 0.25
"""Seconds after which a question is asked again: the message may have been dropped by overload."""
PROBE = "probe"
PLACES = ((0.0, 0.5, 9.0), (0.0, 9.0, 9.5), (0.0, 9.0, 0.5), (0.0, 5.0, 9.0))
"""Places of three unit cubes (m): each has another colliding pair, and one has no pair."""
PAIRS = ({(1, 2)}, {(2, 3)}, {(1, 3)}, set[tuple[int, int]]())
KINDS: dict[str, type] = {
    "objects": MarkerArray, "object_transform": TransformStamped, "/clock": Clock,
}  # fmt: skip


def pairs_of(answer: Answer) -> set[tuple[int, int]]:
    """Return the colliding pairs of the probe."""
    rows, probe = collisions_from_ros(answer.message), namespace_number(PROBE)
    rows = rows[(rows["ns_a"] == probe) & (rows["ns_b"] == probe)]
    return set(zip(rows["id_a"].tolist(), rows["id_b"].tolist(), strict=True))


class Bench:
    """Nodes, and a client in a namespace of its own."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder, self._domain = folder, domain
        self._processes: list[Child] = []
        self._clients: list[Client] = []
        self._turn = 0
        self.status = DiagnosticStatus()
        self.levels: set[bytes] = set()
        """Levels of the status so far."""
        self.deadlines: list[float] = []
        """Times at which the middleware reported a missed deadline of the status."""
        self.listen(f"/faults_{os.getpid()}")  # others may have the same domain

    @property
    def client(self) -> Client:
        """The client of the current node."""
        return self._clients[-1]

    def listen(self, namespace: str) -> None:
        """Talk to the node of a namespace."""
        self._clients.append(Client(self._domain, namespace, KINDS))

        def note_status(message: DiagnosticArray) -> None:
            (self.status,) = message.status
            self.levels.add(self.status.level)

        self.client.node.create_subscription(
            DiagnosticArray,
            "collision_status",
            note_status,
            QoSProfile(
                depth=1,
                durability=DurabilityPolicy.TRANSIENT_LOCAL,
                deadline=Duration(seconds=DEADLINE),
            ),
            event_callbacks=SubscriptionEventCallbacks(
                deadline=lambda event: self.deadlines.append(time.monotonic())
            ),
        )

    def close(self) -> None:
        """End all processes and clients."""
        for process in self._processes:
            process.kill()
        for client in self._clients:
            client.close()

    def start(
        self, *parameters: str, namespace: str = "", wait: bool = True, **environment: str
    ) -> Child:
        """Start a node with parameters ``name:=value``, and wait until it answers."""
        words = [word for parameter in parameters for word in ("-p", parameter)]
        arguments = ["--ros-args", "-r", f"__ns:={namespace or self.client.namespace}", *words]
        process = self._run("node", arguments, **environment)
        if wait:
            self.begin()
        return process

    def peer(self, kind: str) -> Child:
        """Start a program of ``peers``, and wait until it is at work."""
        process = self._run(kind, [kind, self.client.namespace], module=PEERS)
        self.until(lambda: process.said(READY), f"{kind} at work", STARTING)
        return process

    def _run(self, name: str, arguments: list[str], **more: str) -> Child:
        log = self.folder / f"{name}_{len(self._processes)}.log"
        self._processes.append(Child(arguments, self._domain, log, **more))
        return self._processes[-1]

    def until(self, reached: Callable[[], Any], what: str, limit: float = ANSWERING) -> float:
        """Wait for something; returns the seconds it took. FoundError if it does not come."""
        start = time.monotonic()
        while not reached():
            for process in self._processes:
                if process.exit_code not in (None, 0, -9, -2):
                    raise FoundError(f"a process ended with {process.exit_code} before {what}")
            check(time.monotonic() <= start + limit, f"no {what} within {limit:g} s")
            self.client.spin(0.02)
        return time.monotonic() - start

    def spin(self, seconds: float) -> None:
        """Receive messages for a time (s)."""
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end, "end of a time", seconds + 1.0)

    def meet(self, limit: float = STARTING) -> None:
        """Wait until a node has the publishers of the client."""
        self.until(self.client.have_subscribers, "node", limit)

    def begin(self, limit: float = STARTING) -> None:
        """Wait until a node answers right."""
        self.meet(limit)
        self.probe(limit)

    def probe(self, limit: float = ANSWERING, stamp: float = 0.0) -> float:
        """Move the probe; returns after how many seconds the node answered right."""
        self._turn = (self._turn + 1) % len(PLACES)
        places, wanted = PLACES[self._turn], PAIRS[self._turn]
        markers = [cube((PROBE, n + 1), (x, 0.0, 0.0), stamp) for n, x in enumerate(places)]
        asked = start = time.monotonic()
        self.send(markers)
        since = time.time_ns()

        def is_right() -> bool:
            nonlocal asked
            if time.monotonic() > asked + REPEAT:
                asked = time.monotonic()
                self.send(markers)
            last = [answer for answer in self.client.answers[-3:] if answer.stamp > since]
            return wanted in map(pairs_of, last)

        self.until(is_right, "right answer", limit)
        return time.monotonic() - start

    def probes(self, seconds: float) -> float:
        """Probe the node for a time (s); return the longest time without an answer."""
        self.client.answers.clear()
        start = time.time_ns()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.probe()
        times = [start, *(answer.stamp for answer in self.client.answers), time.time_ns()]
        return max(after - before for before, after in pairwise(times)) / NANOSECONDS

    def send(self, markers: Iterable[Marker]) -> None:
        """Publish markers."""
        self.client.publishers["objects"].publish(MarkerArray(markers=list(markers)))

    def send_apart(self, markers: Iterable[Marker]) -> None:
        """Publish markers by a publisher of their own, which waits for nobody."""
        publisher = self.client.node.create_publisher(MarkerArray, "objects", 1)
        self.until(publisher.get_subscription_count, "node")
        publisher.publish(MarkerArray(markers=list(markers)))

    def move(self, name: str, x: float, stamp: float = 0.0) -> None:
        """Publish one pose."""
        message = TransformStamped(child_frame_id=name)
        message.header.frame_id = "map"
        message.header.stamp = stamp_to_ros(round(stamp * NANOSECONDS))
        message.transform = transform_to_ros((x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        self.client.publishers["object_transform"].publish(message)

    def send_cut(self) -> None:
        """Publish a message that ends too early."""
        data = serialize_message(MarkerArray(markers=[cube((PROBE, 1), PLACES[0])]))
        self.client.publishers["objects"].publish(data[: len(data) // 2])

    def tick(self, seconds: float) -> None:
        """Publish a time of the simulation."""
        self.client.publishers["/clock"].publish(
            Clock(clock=stamp_to_ros(round(seconds * NANOSECONDS)))
        )

    def is_stale(self, *codes: str) -> bool:
        """Return whether the status is STALE for one of the reasons."""
        stale = self.status.level == DiagnosticStatus.STALE
        return stale and (not codes or not self.codes.isdisjoint(codes))

    @property
    def codes(self) -> set[str]:
        """The reason codes of the status."""
        values = {pair.key: pair.value for pair in self.status.values}
        return set(values.get("reasons", "").split())


def check(is_so: bool, what: str) -> None:
    """Raise FoundError with the observation, unless a condition holds."""
    if not is_so:
        raise FoundError(what)
