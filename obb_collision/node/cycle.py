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

"""A cycle of the node, and when it runs: update the scene, check it, publish what is requested.

Where a check fails because of some objects, those are set aside and the rest is checked. An object
set aside takes part in no check, is grey and counted as unplaceable, so that it is not known what
collides. It is tried again now and then, since other states of it may not fail.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from obb_collision.node.diagnostics.monitors import CycleMonitor
from obb_collision.node.messages.conversions import NANOSECONDS, name_from_key
from obb_collision.node.objects.conditions import ASIDE, SET_ASIDE, TRIED_AGAIN
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.table import Slots
from obb_collision.node.outputs.outputs import Published
from obb_collision.node.runtime.guard import Guard
from obb_collision.scene.broad_phase.broad_phase import NO_PAIRS
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.report import Report

if TYPE_CHECKING:
    from obb_collision.node.node import CollisionNode

RETRY_PERIOD = 1.0
"""Seconds after which objects that were set aside are tried again."""
MAX_TRIES = 128
"""Maximum number of checks to find those that fail: 16 of 10,000 objects take at most this many."""


class SetAside:
    """Checks the scene of objects, without those with which that fails.

    clock: seconds, rising.
    """

    def __init__(
        self, objects: Objects, guard: Guard, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._objects, self._guard, self._clock = objects, guard, clock
        self._scene, self._table = objects.scene, objects.table
        self._retry = 0.0
        self._untried: Slots = np.empty(0, np.int64)  # for whom there was no time

    def check(self, effects: Collection[str]) -> Report:
        """Check the scene; raises only what is not due to single objects."""
        due = self._due()
        try:
            report = self._scene.check(() if len(due) else effects)
        except MemoryError:  # of no object in particular
            raise
        except Exception as error:
            self._isolate([self._exclude_all(error)])
        else:
            if not len(due):
                return report
            self._isolate([due])
        return self._scene.check(effects)

    def _due(self) -> Slots:
        """Return objects that are set aside and to be tried again now."""
        aside = np.flatnonzero(self._table.has(ASIDE))
        if len(aside) == 0 or self._clock() >= self._retry:
            return aside
        return aside[np.isin(aside, self._untried)]

    def _exclude_all(self, error: Exception) -> Slots:
        """Set aside all objects that take part and return them; raise if checks fail without."""
        slots = np.flatnonzero(self._table.live)
        slots = slots[self._objects.placement.takes_part(slots)]
        self._include(slots, False)
        if self._failure() is not None:
            self._include(slots, True)
            raise error
        return slots

    def _isolate(self, waiting: list[Slots]) -> None:
        """Include parts that are set aside again, halved where checks fail, down to objects."""
        for _ in range(MAX_TRIES):
            if not waiting:
                break
            part = waiting.pop()
            self._include(part, True)
            error = self._failure()
            if error is None:
                continue
            self._include(part, False)
            if len(part) > 1:
                waiting += [part[len(part) // 2 :], part[: len(part) // 2]]
            else:
                name = name_from_key(self._table.key(int(part[0])))
                self._guard.caught("check", error, name)
        self._untried = np.concatenate([self._untried[:0], *waiting])  # they are in the next cycle
        self._retry = self._clock() + RETRY_PERIOD

    def _include(self, slots: Slots, included: bool) -> None:
        self._table.mark(slots, TRIED_AGAIN if included else SET_ASIDE)
        self._objects.placement.enable(slots)

    def _failure(self) -> Exception | None:
        """Return why a check of what takes part fails, None if it does not."""
        try:
            self._scene.check()
        except MemoryError:
            raise
        except Exception as error:
            return error
        return None


class CycleRunner:
    """Runs the cycles of a node, and measures their durations."""

    def __init__(self, node: CollisionNode) -> None:
        self._node, self._objects = node, node.objects
        self._obstacles, self._effects, self._outputs = node.obstacles, node.effects, node.outputs
        self._set_aside = SetAside(node.objects, node.guard)
        self.monitor = CycleMonitor()
        self.enabled, self.active = True, False
        self.report: Report | None = None
        """Of the last check, None where it is not known what collides."""
        self._last = NO_PAIRS, NO_PAIRS, False
        """Pairs (m, 2) of slots that collided at the last check since the activation, what their
        objects were, and whether there were more."""
        self.failed = False
        """Whether the last cycle ended in an internal error: its answer is not known."""
        self.delay = 0.0
        """How long (s) the oldest message that the last cycle answered has waited for that."""
        self._last_stamp = 0

    @property
    def paused(self) -> str:
        """The code of why nothing is checked, "" if it is."""
        return "inactive" if not self.active else "" if self.enabled else "disabled"

    def pairs_left(self) -> tuple[int, bool]:
        """Return how many pairs collided at the last check whose objects still exist.

        And whether there were more.
        """
        pairs, were, more = self._last
        if len(pairs) == 0:
            return 0, False
        left = self._objects.table.are(pairs, were).all(axis=1)
        if self.report is not None and left.all():  # and so are those beyond what it lists
            return self.report.total, more
        return int(np.count_nonzero(left)), more

    def forget(self) -> None:
        """Forget what collided: the next check is the first one."""
        self.report, self._last = None, (NO_PAIRS, NO_PAIRS, False)

    def run(self, now: int) -> None:
        """Run one cycle at time ``now`` (ns); one that fails is counted, and the next one runs."""
        failed = True  # while it runs, what is asked is answered by what the last one was
        with self._node.guard.catching("cycle"):
            start = perf_counter()
            self.delay = waited = self._node.collect()
            collected = perf_counter()
            self._objects.update(now)
            stages = {"inputs": collected - start, "update": perf_counter() - collected}
            if not self.paused:
                stages.update(self.run_stages(now))
                if waited:
                    took = perf_counter() - start
                    self.delay = waited + took
                    age = (now - self._last_stamp) / NANOSECONDS
                    self.monitor.add_delay(waited + took, age + took)
            else:
                self._outputs.publish_namespaces(self._objects.table.namespaces)
            self.monitor.add(stages, 1.0 / self._node.parameters.rate)
            failed = False
        self.failed = failed
        if failed:
            self.report = None
        if self.report is None:
            self._outputs.events.pairs.interrupt()

    def run_stages(self, now: int) -> dict[str, float]:
        """Check and publish; returns the seconds of each stage and of each effect computed."""
        times = [perf_counter()]
        effects = self._effects.of_cycle()
        if "points" in effects:
            self._obstacles.place(now)
        times.append(perf_counter())
        last, known = self.report, () if self.report is None else tuple(self.report.costs)
        self.report = report = self._set_aside.check(effects & EFFECTS.keys())
        on_boxes = self._objects.pairs_on_boxes(report)
        pairs = report.pairs[~on_boxes]
        self._last = pairs, self._objects.table.serial[pairs], report.truncated
        times.append(perf_counter())
        if on_boxes.any():
            self.report = None
            self._outputs.publish_namespaces(self._objects.table.namespaces)
            return dict(zip(("prepare", "check"), np.diff(times).tolist(), strict=True))
        self._obstacles.note(report)
        given = self._given(report, effects, now)
        self._outputs.publish_report(given)
        times.append(perf_counter())
        with self._node.guard.catching("output markers"):
            self._outputs.publish_markers(given)
        times.append(perf_counter())
        names = ("prepare", "check", "publish", "markers")
        stages = dict(zip(names, np.diff(times).tolist(), strict=True))
        # where nothing had changed, the report is the one before, with what it took then
        old = known if report is last else ()
        costs = {name: cost for name, cost in report.costs.items() if name not in old}
        stages["check"] -= sum(cost.seconds for cost in costs.values())
        return stages | self.monitor.add_costs(costs)

    def _given(self, report: Report, effects: frozenset[str], now: int) -> Published:
        stamp = self._objects.newest_stamp(now)
        step = max(0, stamp - self._last_stamp) / NANOSECONDS if self._last_stamp else 0.0
        self._last_stamp = stamp
        cloud_stamp = self._obstacles.stamp or stamp
        table = self._objects.table
        return Published(report, table, stamp, step, cloud_stamp, now, self._objects, effects)


SHORTEST_TIMER = 1e-4
"""Period (s) of the timer that ends a burst where min_period is zero."""


class Schedule:
    """Runs cycles according to the parameters ``trigger``, ``rate`` and ``min_period``.

    clock: of steady time, because a paused or missing simulation clock must not stop the checks.
    """

    def __init__(self, node: CollisionNode) -> None:
        self._node, self._parameters = node, node.parameters
        self.clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.last = float("-inf")
        """When the last cycle ended (s)."""
        period = 1.0 / self._parameters.rate
        self._timer = node.create_timer(period, node.run_cycle, clock=self.clock)
        self._burst_timer = node.create_timer(SHORTEST_TIMER, self._end_burst, clock=self.clock)
        self._burst_timer.cancel()
        for timer in (self._timer, self._burst_timer):
            node.undo.callback(node.destroy_timer, timer)

    def apply(self) -> None:
        """Apply a new rate."""
        period = round(1e9 / self._parameters.rate)
        if self._timer.timer_period_ns != period:
            self._timer.timer_period_ns = period
            self._timer.reset()

    def arrived(self, topic: str) -> None:
        """With trigger arrival: compute at once, or once the burst is over.

        Not for queries, nor for points that nobody asked for.
        """
        node = self._node
        if self._parameters.trigger != "arrival" or node.topics[topic].is_query:
            return
        if topic == "points" and not node.effects.is_requested("points"):
            return
        rest = self._parameters.min_period - (perf_counter() - self.last)
        if rest <= 0.0:
            node.run_cycle()
            self._timer.reset()
        elif self._burst_timer.is_canceled():
            self._burst_timer.timer_period_ns = round(1e9 * max(rest, SHORTEST_TIMER))
            self._burst_timer.reset()

    def _end_burst(self) -> None:
        self._burst_timer.cancel()
        self._node.run_cycle()
