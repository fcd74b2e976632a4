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
from random import Random

from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.objects.shape_requests import KEPT_SHAPES
from obb_collision.node.topics.topics import collisions_from_ros
from tools.fuzz.client import STARTING, Client, FoundError
from tools.fuzz.process import Child
from tools.soak.checker import Checker, found_in
from tools.soak.result import Result
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
    """The steps of a run, and what came of them: ``child`` is the node."""

    def __init__(self, seed: int, objects: int, domain: int, result: Result) -> None:
        self._world, self._random = World(seed, objects), Random(seed)
        self._checker, self._result = Checker(self._world, result), result
        self._client = Client(domain, f"/soak_{domain}", KINDS)
        self._client.node.create_subscription(PointCloud2, "collisions", self._take, 100)
        self._stamp = 0
        self._is_begun = self._is_answered = False
        self._answered = 0.0

    def arguments(self) -> list[str]:
        """Return what the node's process is to be started with."""
        return ["--ros-args", "-r", f"__ns:={self._client.namespace}", "-p", "trigger:=arrival"]

    def close(self) -> None:
        """Take the client down."""
        self._client.close()

    def begin(self, child: Child) -> None:
        """Wait until the node answers, and all effects are computed, for the first bodies."""
        client = self._client
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
            self._client.publishers[MARKERS].publish(MarkerArray(markers=markers))

            def done(here: bool = here) -> bool:
                client = self._client
                built = client.diagnostics is not None and not client.count("unplaceable")
                return built and here == (client.count("count") > KEPT_SHAPES)

            self._client.until(child, done, "shapes, all built", STARTING)

    def step(self, child: Child) -> None:
        """Change the scene, and wait for the answer that has all of it, or that is wrong."""
        self._is_answered = False
        start = time.perf_counter()
        self._send(self._world.step())
        what = f"answer to step {self._world.steps}"
        self._client.until(child, lambda: self._is_answered or self._result.wrong, what)
        if self._result.wrong:
            return
        self._result.latencies.append(self._answered - start)
        self._checker.end()
        self._result.steps += 1

    def end(self, child: Child) -> None:
        """Read the last diagnostics: what was refused, and internal errors."""
        client = self._client
        client.diagnostics = None
        message = client.until(child, lambda: client.diagnostics, "diagnostics")
        for status in message.status:
            errors = status.name.endswith("internal errors") and status.level != status.OK
            for pair in status.values:
                if pair.key.startswith("rejected: ") and int(pair.value):
                    self._result.refused[pair.key.partition(": ")[2]] = int(pair.value)
                elif errors:
                    raise FoundError(f"the node counted internal errors: {pair.key} {pair.value}")

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
            self._client.publishers[topic].publish(message)
            self._result.sent[topic] += 1

    def _take(self, message: PointCloud2) -> None:
        now = time.perf_counter()
        self._client.answers.clear()
        rows = collisions_from_ros(message)
        if not self._is_begun:
            self._is_answered = self._checker.is_complete(found_in(rows))
        elif self._checker.judge(rows) and not self._is_answered:
            self._is_answered, self._answered = True, now
