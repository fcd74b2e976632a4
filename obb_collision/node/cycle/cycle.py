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

"""A cycle of the node, and when it runs: update the scene, check it, publish requested topics.

Where a check fails because of some objects, those are set aside and the rest is checked. An object
set aside takes part in no check, is grey and counted as unplaceable, so that it is not known what
collides. It is tried again now and then, since other states of it may not fail.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from rclpy.constants import S_TO_NS
from rclpy.timer import Timer

from obb_collision.node.inputs.clouds import Obstacles
from obb_collision.node.inputs.sources import Sources
from obb_collision.node.objects.conditions import ASIDE, SET_ASIDE, TRIED_AGAIN
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.table import Slots
from obb_collision.node.outputs.outputs import Outputs, Published
from obb_collision.node.runtime.guard import Guard
from obb_collision.scene.broad_phase.broad_phase import NO_PAIRS
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.report import Cost, Report

RETRY_PERIOD = 1.0
"""Seconds after which objects that were set aside are tried again."""
MAX_TRIES = 128
"""Maximum number of checks to find those that fail: 16 of 10,000 objects take at most this many."""


class SetAside:
    """Checks the scene without the objects that make checks fail.

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
        """Check the scene; raises only errors that are not due to single objects."""
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
        """Set aside all objects that take part; return them. Raise if checks fail without any."""
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
                self._guard.caught("check", error, self._table.name(int(part[0])))
        self._untried = np.concatenate([self._untried[:0], *waiting])  # they are in the next cycle
        self._retry = self._clock() + RETRY_PERIOD

    def _include(self, slots: Slots, included: bool) -> None:
        self._table.mark(slots, TRIED_AGAIN if included else SET_ASIDE)
        self._objects.placement.enable(slots)

    def _failure(self) -> Exception | None:
        """Return why a check of the included objects fails, None if it does not."""
        try:
            self._scene.check()
        except MemoryError:
            raise
        except Exception as error:
            return error
        return None


@dataclass
class CycleMonitor:
    """Durations of the cycles since the last report, and what failed since the start."""

    stages: dict[str, list[float]] = field(default_factory=dict)
    """Seconds by stage; those of whole cycles are the first."""
    overruns: int = 0
    """Cycles that took longer than a period, since the start."""
    total: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    """By effect: the pairs or points that it ran on when it was last computed."""
    failures: Counter[str] = field(default_factory=Counter)
    """By effect: what failed since the start."""
    last_failures: dict[str, str] = field(default_factory=dict)
    reported: tuple[int, int] = (0, 0)
    """Overruns and failures at the last report."""
    delay: float = 0.0
    """Longest time (s) since the last report from the receipt of a message to its answer."""
    age: float | None = None
    """Of the newest state evaluated, then (s): by its stamp, by its receipt where it has none."""

    def add_delay(self, delay: float, age: float) -> None:
        """Record how long messages waited for their answer, and the age of the newest state (s)."""
        if self.age is None or delay > self.delay:
            self.delay, self.age = delay, age

    def add(self, stages: dict[str, float], period: float) -> None:
        """Count a cycle by the durations (s) of its stages and its period (s)."""
        duration = sum(stages.values())
        for name, seconds in ({"cycle": duration} | stages).items():
            self.stages.setdefault(name, []).append(seconds)
        self.overruns += duration > period
        self.total += 1

    def add_costs(self, costs: Mapping[str, Cost]) -> dict[str, float]:
        """Record the costs of effects in a cycle; returns their stages (s)."""
        for name, cost in costs.items():
            self.counts[name] = cost.count
            if cost.failures:
                self.failures[name] += len(cost.failures)
                self.last_failures[name] = cost.failures[-1]
        return {f"effect {name}": cost.seconds for name, cost in costs.items()}

    def begin_report(self) -> None:
        """Begin new statistics."""
        self.reported = self.overruns, self.failures.total()
        self.stages, self.delay, self.age = {}, 0.0, None


class CycleRunner:
    """Runs the cycles of a node, and measures their durations.

    collect: applies the messages that wait, and returns for how long (s) the oldest one has.
    """

    def __init__(
        self,
        objects: Objects,
        obstacles: Obstacles,
        sources: Sources,
        outputs: Outputs,
        guard: Guard,
        collect: Callable[[], float],
    ) -> None:
        self._objects, self._obstacles, self._outputs = objects, obstacles, outputs
        self._guard, self._collect, self._sources = guard, collect, sources
        self._set_aside = SetAside(objects, guard)
        self.monitor = CycleMonitor()
        self.period = 1.0
        """Seconds beyond which a cycle is too long."""
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
        """The code of the reason why nothing is checked, "" while checks run."""
        return "inactive" if not self.active else "" if self.enabled else "disabled"

    def pairs_left(self) -> tuple[int, bool]:
        """Return how many pairs of objects that still exist collided at the last check.

        Also return whether more pairs did.
        """
        pairs, serials, more = self._last
        if len(pairs) == 0:
            return 0, False
        left = self._objects.table.have_serials(pairs, serials).all(axis=1)
        if self.report is not None and left.all():  # and so are those beyond what it lists
            return self.report.total, more
        return int(np.count_nonzero(left)), more

    def forget(self) -> None:
        """Forget what collided: the next check is the first one."""
        self.report, self._last = None, (NO_PAIRS, NO_PAIRS, False)

    def run(self, now: int) -> None:
        """Run one cycle at time ``now`` (ns); one that fails is counted, and the next one runs."""
        failed = True  # while it runs, the last one answers requests
        with self._guard.catching("cycle"):
            start = perf_counter()
            self.delay = waited = self._collect()
            collected = perf_counter()
            self._objects.update(now)
            stages = {"inputs": collected - start, "update": perf_counter() - collected}
            if not self.paused:
                stages.update(self.run_stages(now))
                if waited:
                    took = perf_counter() - start
                    self.delay = waited + took
                    age = (now - self._last_stamp) / S_TO_NS
                    self.monitor.add_delay(waited + took, age + took)
            else:
                self._outputs.publish_namespaces(self._objects.table.namespaces)
            self.monitor.add(stages, self.period)
            failed = False
        self.failed = failed
        if failed:
            self.report = None
        if self.report is None:
            self._outputs.events.pairs.interrupt()

    def run_stages(self, now: int) -> dict[str, float]:
        """Check and publish; returns the seconds of each stage and of each effect computed."""
        times = [perf_counter()]
        effects = self._outputs.effects.of_cycle()
        if "points" in effects:
            self._obstacles.use_newest(now)
            self._sources.apply_watched()
        times.append(perf_counter())
        last, costs_before = self.report, () if self.report is None else tuple(self.report.costs)
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
        checked = self._published(report, effects, now)
        self._outputs.publish_report(checked)
        times.append(perf_counter())
        with self._guard.catching("output markers"):
            self._outputs.publish_markers(checked)
        times.append(perf_counter())
        names = ("prepare", "check", "publish", "markers")
        stages = dict(zip(names, np.diff(times).tolist(), strict=True))
        # without changes the report is the one before, with its costs
        old = costs_before if report is last else ()
        costs = {name: cost for name, cost in report.costs.items() if name not in old}
        stages["check"] -= sum(cost.seconds for cost in costs.values())
        return stages | self.monitor.add_costs(costs)

    def _published(self, report: Report, effects: frozenset[str], now: int) -> Published:
        stamp = self._objects.newest_stamp(now)
        step = max(0, stamp - self._last_stamp) / S_TO_NS if self._last_stamp else 0.0
        self._last_stamp = stamp
        cloud_stamp = self._obstacles.stamp or stamp
        table = self._objects.table
        return Published(report, table, stamp, step, cloud_stamp, now, self._objects, effects)


SHORTEST_TIMER = 1e-4
"""Period (s) of the timer that ends a burst where min_period is zero."""


class Schedule:
    """Runs cycles according to the parameters ``trigger``, ``rate`` and ``min_period``.

    make_timer: makes a timer of a period (s) by steady time: a simulation clock may stand still.
    """

    def __init__(
        self,
        make_timer: Callable[[float, Callable[[], Any]], Timer],
        run_cycle: Callable[[], None],
    ) -> None:
        self._run_cycle = run_cycle
        self._on_arrival, self._min_period = False, 0.0
        self._timer = make_timer(1.0, run_cycle)
        self._burst_timer = make_timer(SHORTEST_TIMER, self._end_burst)
        self._burst_timer.cancel()
        self.last = float("-inf")
        """When the last cycle ended (s)."""

    def apply(self, trigger: str, rate: float, min_period: float) -> None:
        """Apply the parameters."""
        self._on_arrival, self._min_period = trigger == "arrival", min_period
        period = round(S_TO_NS / rate)
        if self._timer.timer_period_ns != period:
            self._timer.timer_period_ns = period
            self._timer.reset()

    def arrived(self) -> None:
        """With the trigger "arrival" run a cycle at once, or once a burst of messages is over."""
        if not self._on_arrival:
            return
        rest = self._min_period - (perf_counter() - self.last)
        if rest <= 0.0:
            self._run_cycle()
            self._timer.reset()
        elif self._burst_timer.is_canceled():
            self._burst_timer.timer_period_ns = round(S_TO_NS * max(rest, SHORTEST_TIMER))
            self._burst_timer.reset()

    def _end_burst(self) -> None:
        self._burst_timer.cancel()
        self._run_cycle()
