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

"""One run: steps to a node in another process, and every answer compared with the truth."""

from __future__ import annotations

import time
from collections.abc import Callable
from random import Random
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.objects.shape_requests import KEPT_SHAPES
from obb_collision.node.topics.topics import collisions_from_ros
from tools.fuzz.process.child import Child
from tools.fuzz.session.client import OUTPUTS
from tools.soak.checker import Checker, found_in
from tools.soak.encoding import (
    FRAME,
    KINDS,
    PLACES,
    SCENERY,
    built_shape,
    messages_of,
    obstacles,
    scenery_of,
)
from tools.soak.result import Result
from tools.soak.world import MARKERS, Change, World

STARTING = 300.0
"""Seconds until the node answers first: on a new machine it compiles its kernels."""
ANSWERING = 20.0
"""Seconds in which a step must be answered."""
SCENERY_SHARE, CLOUDS = 0.2, 0.2
"""Share of the messages of markers with scenery, and of the steps with a cloud of points."""


class LostError(Exception):
    """The run can't go on."""


class Session:
    """A client of a node in another process, ``child``."""

    def __init__(self, seed: int, objects: int, domain: int, result: Result) -> None:
        self._world, self._random = World(seed, objects), Random(seed)
        self._checker, self._result = Checker(self._world, result), result
        self._namespace = f"/soak_{domain}"
        self._context = Context()
        self._context.init(args=[], domain_id=domain)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._node = Node("soak", context=self._context, namespace=self._namespace)
        self._executor.add_node(self._node)
        self._publishers = {
            topic: self._node.create_publisher(kind, topic, QoSProfile(depth=100))
            for topic, kind in KINDS.items()
        }
        self._stamp = 0
        self._is_begun = self._is_answered = False
        self._answered = 0.0
        self._diagnostics: DiagnosticArray | None = None
        self._node.create_subscription(PointCloud2, "collisions", self._take, 100)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._take_status, 10)
        for topic, kind in OUTPUTS.items():  # somebody listens: every effect is computed
            self._node.create_subscription(kind, topic, lambda message: None, 10, raw=True)

    def arguments(self) -> list[str]:
        """Return what the node's process is to be started with."""
        return ["--ros-args", "-r", f"__ns:={self._namespace}", "-p", "trigger:=arrival"]

    def close(self) -> None:
        """Take the client down."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def begin(self, child: Child) -> None:
        """Wait until the node answers, and all effects are computed, for the first bodies."""

        def matched() -> bool:
            return all(p.get_subscription_count() for p in self._publishers.values())

        self._until(child, matched, "inputs", STARTING)
        self._send(self._world.first())
        self._until(child, lambda: self._is_answered, "answer to the first bodies", STARTING)
        self._until(child, self._is_all_computed, "effects, all computed", STARTING)
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
            self._publishers[MARKERS].publish(MarkerArray(markers=markers))

            def done(here: bool = here) -> bool:
                counts = self._values("objects")
                return counts.get("unplaceable") == "0" and here == (
                    int(counts["count"]) > KEPT_SHAPES
                )

            self._until(child, done, "shapes, all built", STARTING)

    def _values(self, name: str) -> dict[str, str]:
        """Return the values of a status in the latest diagnostics."""
        statuses = () if self._diagnostics is None else self._diagnostics.status
        found = [status.values for status in statuses if status.name.endswith(f": {name}")]
        return {pair.key: pair.value for pair in found[0]} if found else {}

    def step(self, child: Child) -> None:
        """Change the scene, and wait for the answer that has all of it, or that is wrong."""
        self._is_answered = False
        start = time.perf_counter()
        self._send(self._world.step())
        what = f"answer to step {self._world.steps}"
        self._until(child, lambda: self._is_answered or self._result.wrong, what)
        if self._result.wrong:
            return
        self._result.latencies.append(self._answered - start)
        self._checker.end()
        self._result.steps += 1

    def end(self, child: Child) -> None:
        """Read the last diagnostics: what was refused, and internal errors."""
        self._diagnostics = None
        message = self._until(child, lambda: self._diagnostics, "diagnostics")
        for status in message.status:
            errors = status.name.endswith("internal errors") and status.level != status.OK
            for pair in status.values:
                if pair.key.startswith("rejected: ") and int(pair.value):
                    self._result.refused[pair.key.partition(": ")[2]] = int(pair.value)
                elif errors:
                    raise LostError(f"the node counted internal errors: {pair.key} {pair.value}")

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
            self._publishers[topic].publish(message)
            self._result.sent[topic] += 1

    def _take(self, message: PointCloud2) -> None:
        now = time.perf_counter()
        rows = collisions_from_ros(message)
        if not self._is_begun:
            self._is_answered = self._checker.is_complete(found_in(rows))
        elif self._checker.judge(rows) and not self._is_answered:
            self._is_answered, self._answered = True, now

    def _take_status(self, message: DiagnosticArray) -> None:
        if message.status and message.status[0].name.startswith(self._namespace[1:]):
            self._diagnostics = message

    def _is_all_computed(self) -> bool:
        """Return whether no effect waits for its kernels any more."""
        if self._diagnostics is None:
            return False
        values = [pair for status in self._diagnostics.status for pair in status.values]
        states = [pair.value for pair in values if pair.key.startswith("effect ")]
        return bool(states) and not any("ready" in state for state in states)

    def _until(
        self, child: Child, reached: Callable[[], Any], what: str, limit: float = ANSWERING
    ) -> Any:
        end = time.monotonic() + limit
        while not (found := reached()):
            if child.exit_code is not None:
                raise LostError(f"the node ended with {child.exit_code} before {what}")
            if time.monotonic() > end:
                raise LostError(f"no {what} within {limit:g} s")
            self._executor.spin_once(timeout_sec=0.05)
        return found
