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

"""The topics ``collision_status`` and ``in_collision``, and the watchdog behind them.

Both are latched, so the last message of a node that stops would remain valid. Hence: an unknown
state is published immediately, whichever part detects it; a separate thread, by a steady clock of
its own, publishes it while a cycle is blocked, and repeats the last message
where cycles are far apart; and the status is offered with a deadline, by which the middleware
notifies subscribers when the node is gone.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from math import inf
from typing import Protocol

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from std_msgs.msg import Bool

from obb_collision.node.diagnostics.answer import Answer, Reason
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.runtime.guard import Guard

PERIOD = 0.1
"""Minimum time (s) between two equal messages of ``collision_status``."""
FAREWELL = 0.3
"""Maximum time (s) that an ending node waits for the delivery of its last message."""
FLAG, STATUS = "in_collision", "collision_status"


class StatusTopics(Protocol):
    """Which of both topics are published."""

    def is_off(self, name: str) -> bool:
        """Return whether a topic is never published."""
        ...

    def is_requested(self, name: str) -> bool:
        """Return whether a topic is published though nothing has changed."""
        ...


class CollisionStatus:
    """Publishes the status of collisions; may be called from any thread.

    unknown_is_collision: what the flag is while collisions are unknown; allowed_delay: for how long
    (s) no cycle may end; now: time of the node's clock (ns); steady: seconds. ``start`` begins to
    repeat the last answer, and to watch the cycles from the first one that ends.
    """

    def __init__(
        self,
        name: str,
        publishers: Mapping[str, Publisher],
        topics: StatusTopics,
        unknown_is_collision: Callable[[], bool],
        now: Callable[[], int],
        guard: Guard,
        allowed_delay: Callable[[], float] = lambda: inf,
        steady: Callable[[], float] = time.monotonic,
    ) -> None:
        self._name, self._publishers, self._topics = name, publishers, topics
        self._unknown_is_collision, self._allowed_delay = unknown_is_collision, allowed_delay
        self._now, self._guard, self._steady = now, guard, steady
        self._lock = threading.RLock()
        self.answer = Answer()
        """The last one."""
        self._published: tuple[object, ...] | None = None
        self._flag: bool | None = None
        self._sent = self._alive = steady()
        self._resting = True  # no cycle runs
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None

    def rest(self, reason: Reason | None = None) -> None:
        """Say that nothing is known, and expect no cycle until one ends."""
        with self._lock:
            self._resting = True
            self._publish(Answer((reason or Reason("starting"),)))

    def start(self) -> None:
        """Repeat the last answer, and watch over the cycles from now on."""
        self._thread = threading.Thread(target=self._watch, name="collision_status", daemon=True)
        self._thread.start()

    def update(self, answer: Answer, cycle: bool = False) -> None:
        """Publish an answer; cycle: whether the answer is that of a completed cycle."""
        with self._lock:
            if cycle:
                self._alive, self._resting = self._steady(), False
            self._publish(answer, beat=cycle)

    def close(self) -> None:
        """Publish that the node ends, and nothing after that."""
        try:
            with self._lock:
                if not self._closed.is_set():
                    self._publish(self.answer.but(Reason("shutting_down")))
                    self._closed.set()
            for name in (STATUS, FLAG):
                self._publishers[name].wait_for_all_acked(Duration(seconds=FAREWELL))
        except Exception:  # the context is gone: nothing can be published
            self._closed.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(FAREWELL)

    @property
    def is_off(self) -> bool:
        """Whether both topics are off."""
        return self._topics.is_off(STATUS) and self._topics.is_off(FLAG)

    def look(self) -> None:
        """Publish that the cycle is blocked, or repeat the last answer between cycles."""
        with self._lock:
            if self._closed.is_set() or self.is_off:
                return
            silent = self._steady() - self._alive
            blocked = silent > self._allowed_delay() and not self._resting
            answer = self.answer
            if blocked:
                answer = answer.but(Reason("blocked"))
            if blocked or self._steady() - self._sent >= 1.5 * PERIOD:
                self._publish(answer, keep=not blocked)

    def _watch(self) -> None:
        while not self._closed.wait(PERIOD):
            try:
                self.look()
            except Exception as error:
                try:
                    self._guard.caught("watchdog", error)
                except Exception:  # the context is gone: nothing can be published
                    return

    def _publish(self, answer: Answer, beat: bool = False, keep: bool = True) -> None:
        """Publish an answer on the requested topics; keep: store it as the last answer.

        beat: publish the flag even if it is unchanged: it is published every cycle.
        """
        with self._lock:
            if self._closed.is_set():
                return
            if keep:
                self.answer = answer
            unknown_counts = self._unknown_is_collision()
            kind = (*answer.kind, unknown_counts)
            changed, self._published = kind != self._published, kind
            self._publish_status(answer, changed, unknown_counts)
            flag, beats = answer.flag(unknown_counts), beat and self._topics.is_requested(FLAG)
            if (flag != self._flag or beats) and not self._topics.is_off(FLAG):
                self._flag = flag
                self._publishers[FLAG].publish(Bool(data=flag))

    def _publish_status(self, answer: Answer, changed: bool, unknown_counts: bool) -> None:
        due = self._steady() - self._sent >= PERIOD and self._topics.is_requested(STATUS)
        if self._topics.is_off(STATUS) or not (changed or due):
            return
        self._sent = self._steady()
        now = self._now()
        message = DiagnosticArray(status=[answer.to_ros(self._name, now, unknown_counts)])
        message.header.stamp = stamp_to_ros(now)
        self._publishers[STATUS].publish(message)
