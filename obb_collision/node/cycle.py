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

"""One cycle of the node: bring the scene up to date, check it, publish what is requested."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from obb_collision.node.diagnostics.monitors import CycleMonitor
from obb_collision.node.inputs.points import Obstacles
from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.node.objects.conditions import LIVE
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.set_aside import SetAside
from obb_collision.node.outputs.outputs import Effects, Outputs, Published
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.settings import SceneSettings
from obb_collision.scene.broad_phase.broad_phase import NO_PAIRS
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.report import Report
from obb_collision.typing import Mask


class Cycle:
    """Runs cycles, and measures their durations.

    collect: reads the queued messages; returns their maximum waiting time (s).
    """

    def __init__(
        self,
        parameters: Parameters,
        objects: Objects,
        obstacles: Obstacles,
        settings: SceneSettings,
        effects: Effects,
        outputs: Outputs,
        guard: Guard,
        collect: Callable[[], float],
    ) -> None:
        self._parameters, self._settings = parameters, settings
        self._objects, self._obstacles = objects, obstacles
        self._effects, self._outputs = effects, outputs
        self._guard, self._collect = guard, collect
        self._set_aside = SetAside(objects, guard)
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

    @property
    def waits_for_kernels(self) -> bool:
        """Whether robots are not checked, since kernels of their accuracy are being loaded."""
        return self._settings.waiting and bool(self._objects.table.of_robot.any())

    def pairs_left(self) -> tuple[int, bool]:
        """Return how many pairs collided at the last check whose objects still exist.

        And whether there were more.
        """
        pairs, were, more = self._last
        if len(pairs) == 0:
            return 0, False
        table = self._objects.table
        left = (table.has(LIVE, pairs) & (table.serial[pairs] == were)).all(axis=1)
        if self.report is not None and left.all():  # and so are those beyond what it lists
            return self.report.total, more
        return int(np.count_nonzero(left)), more

    def forget(self) -> None:
        """Forget what collided: the next check is the first one."""
        self.report, self._last = None, (NO_PAIRS, NO_PAIRS, False)

    def run(self, now: int) -> None:
        """Run one cycle at time ``now`` (ns); one that fails is counted, and the next one runs."""
        self.failed = not self._guard.run("cycle", lambda: self._run(now))
        if self.failed:
            self.report = None
        if self.report is None:
            self._outputs.events.pairs.interrupt()

    def _run(self, now: int) -> None:
        start = perf_counter()
        self.delay = waited = self._collect()
        collected = perf_counter()
        self._objects.update(now)
        stages = {"inputs": collected - start, "update": perf_counter() - collected}
        if self._settings.waiting:
            self._settings.apply_accuracy()
        if not self.paused:
            stages.update(self._check(now))
            if waited:
                took = perf_counter() - start
                self.delay = waited + took
                age = (now - self._last_stamp) / NANOSECONDS
                self.monitor.add_delay(waited + took, age + took)
        else:
            self._outputs.publish_namespaces(self._objects.table.namespaces)
        self.monitor.add(stages, 1.0 / self._parameters.rate)

    def _check(self, now: int) -> dict[str, float]:
        """Check and publish; returns the seconds of each stage and of each effect computed."""
        times = [perf_counter()]
        effects = self._effects.of_cycle()
        if self._effects.on_boxes and self._effects.raised(effects):
            self._settings.apply_effects()
        if "points" in effects:
            self._obstacles.place(now)
        times.append(perf_counter())
        last, known = self.report, () if self.report is None else tuple(self.report.costs)
        self.report = report = self._set_aside.check(effects & EFFECTS.keys())
        on_boxes = self._on_boxes(report)
        pairs = report.pairs[~on_boxes]
        self._last = pairs, self._objects.table.serial[pairs], report.truncated
        times.append(perf_counter())
        if self.waits_for_kernels or on_boxes.any():
            self.report = None
            self._outputs.publish_namespaces(self._objects.table.namespaces)
            return dict(zip(("prepare", "check"), np.diff(times).tolist(), strict=True))
        self._obstacles.note(report)
        given = self._given(report, effects, now)
        self._outputs.publish_report(given)
        times.append(perf_counter())
        self._outputs.publish_markers(given)
        times.append(perf_counter())
        names = ("prepare", "check", "publish", "markers")
        stages = dict(zip(names, np.diff(times).tolist(), strict=True))
        # where nothing had changed, the report is the one before, with what it took then
        old = known if report is last else ()
        costs = {name: cost for name, cost in report.costs.items() if name not in old}
        stages["check"] -= sum(cost.seconds for cost in costs.values())
        return stages | self.monitor.add_costs(costs)

    def _on_boxes(self, report: Report) -> Mask:
        """Return (m,) which pairs of robots are on boxes that collide though the links may not."""
        found = self._objects.pairs_on_boxes(report)
        if self.waits_for_kernels:
            found |= self._objects.table.of_robot[report.pairs].any(axis=1)
        return found

    def _given(self, report: Report, effects: frozenset[str], now: int) -> Published:
        stamp = self._objects.newest_stamp(now)
        step = max(0, stamp - self._last_stamp) / NANOSECONDS if self._last_stamp else 0.0
        self._last_stamp = stamp
        cloud_stamp = self._obstacles.stamp or stamp
        table = self._objects.table
        return Published(report, table, stamp, step, cloud_stamp, now, self._objects, effects)
