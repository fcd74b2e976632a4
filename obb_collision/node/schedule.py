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

"""When cycles run: by a timer, or as soon as something arrives."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from obb_collision.node.parameters.parameters import Parameters

SHORTEST_TIMER = 1e-4
"""Period (s) of the timer that ends a burst where min_period is zero."""


STORM_SHARE = 0.1
"""Maximum share of the time that calls in a burst may take."""
STORM_PERIOD = 0.05
"""Minimum seconds between two calls in a burst."""


class Calm:
    """Rate limiter: makes a call immediately, or later in a burst of calls; never drops the last.

    start(seconds): have ``end`` called after that time. clock: seconds, rising.
    """

    def __init__(
        self,
        call: Callable[[], object],
        start: Callable[[float], None],
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        self._call, self._start, self._clock = call, start, clock
        self._next = float("-inf")
        self._waits = False

    def __call__(self) -> None:
        """Make the call now or soon."""
        rest = self._next - self._clock()
        if rest <= 0.0:
            self.end()
        elif not self._waits:
            self._waits = True
            self._start(rest)

    def settle(self) -> None:
        """Make the call now, if it waits."""
        if self._waits:
            self.end()

    def end(self) -> None:
        """Make the call now."""
        self._waits = False
        start = self._clock()
        try:
            self._call()
        finally:
            end = self._clock()
            self._next = end + max(STORM_PERIOD, (end - start) / STORM_SHARE)


class Schedule:
    """Calls ``cycle`` according to the parameters ``trigger``, ``rate`` and ``min_period``.

    clock: of steady time, because a paused or missing simulation clock must not stop the checks.
    """

    def __init__(self, node: Node, parameters: Parameters, cycle: Callable[[], None]) -> None:
        self._node, self._parameters, self._run = node, parameters, cycle
        self.clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._last = float("-inf")
        self._timer = node.create_timer(1.0 / parameters.rate, self._cycle, clock=self.clock)
        self._burst_timer = node.create_timer(SHORTEST_TIMER, self._end_burst, clock=self.clock)
        self._burst_timer.cancel()
        self._timers = [self._timer, self._burst_timer]

    def close(self) -> None:
        """Make no calls any more."""
        for timer in self._timers:
            self._node.destroy_timer(timer)

    def calm(self, call: Callable[[], object]) -> Calm:
        """Return a rate limiter of a call."""
        calm = Calm(call, lambda seconds: start(seconds))

        def end() -> None:
            timer.cancel()
            calm.settle()

        timer = self._node.create_timer(STORM_PERIOD, end, clock=self.clock)
        timer.cancel()
        self._timers.append(timer)

        def start(seconds: float) -> None:
            timer.timer_period_ns = round(1e9 * max(seconds, SHORTEST_TIMER))
            timer.reset()

        return calm

    def apply(self) -> None:
        """Apply a new rate."""
        period = round(1e9 / self._parameters.rate)
        if self._timer.timer_period_ns != period:
            self._timer.timer_period_ns = period
            self._timer.reset()

    def arrived(self) -> None:
        """With trigger arrival: compute at once, or once the burst is over."""
        if self._parameters.trigger != "arrival":
            return
        rest = self._parameters.min_period - (perf_counter() - self._last)
        if rest <= 0.0:
            self._cycle()
            self._timer.reset()
        elif self._burst_timer.is_canceled():
            self._burst_timer.timer_period_ns = round(1e9 * max(rest, SHORTEST_TIMER))
            self._burst_timer.reset()

    def _end_burst(self) -> None:
        self._burst_timer.cancel()
        self._cycle()

    def _cycle(self) -> None:
        self._run()
        self._last = perf_counter()
