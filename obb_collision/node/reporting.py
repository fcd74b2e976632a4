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

"""``/diagnostics``, once a second: inputs, objects, robots, cycle, QoS; and its warnings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from time import perf_counter

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from obb_collision.accuracy import Accuracy
from obb_collision.node.cycle import CycleRunner
from obb_collision.node.diagnostics.answer import MAX_NAMED, make_status, some
from obb_collision.node.diagnostics.monitors import (
    NANOSECONDS_F,
    CycleMonitor,
    InputMonitor,
    QosWatch,
)
from obb_collision.node.inputs.subscriptions import Subscriptions
from obb_collision.node.messages.conversions import name_from_key, stamp_to_ros
from obb_collision.node.objects.conditions import (
    ASIDE,
    FUTURE,
    HELD_BACK,
    REFUSED,
    RESHAPED,
    STALE,
    UNPLACED,
    UNSHAPED,
)
from obb_collision.node.objects.objects import Objects
from obb_collision.node.outputs.outputs import Outputs
from obb_collision.node.parameters.entries import text_from_region
from obb_collision.node.robots.robot_input import RobotInput
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard
from obb_collision.scene.report import Report

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
STALE_WORDS = {
    "unknown": "last box kept",
    "collide": "last box grown",
    "keep": "accepted where they were",
    "ignore": "ignored",
}
LONGEST_DELAY = 0.2
"""Seconds from a message's receipt to its answer, beyond which overload is reported; two periods
where those are longer."""


def input_status(
    node: str, key: str, monitor: InputMonitor, now: int, seconds: float
) -> DiagnosticStatus:
    """Rate, age and refused items by reason of one input, over the last ``seconds``."""
    messages, refused, doubted = monitor.since_last_report()
    values: list[tuple[str, object]] = [
        ("topic", monitor.topic),
        ("messages", monitor.messages),
        ("rate (Hz)", f"{messages / seconds:.2f}"),
        (
            "age (s)",
            "never" if monitor.last is None else f"{(now - monitor.last) / NANOSECONDS_F:.3f}",
        ),
        ("rejected", monitor.refused.total()),
        ("qos mismatches", monitor.mismatches),
        *([("superseded", monitor.superseded)] if monitor.superseded else ()),
        *([("lost", monitor.lost)] if monitor.lost else ()),
        *(() if monitor.ignored is None else [("not finite in the last cloud", monitor.ignored)]),
        *((f"rejected: {reason}", count) for reason, count in sorted(monitor.refused.items())),
        *((f"doubtful: {reason}", count) for reason, count in sorted(monitor.doubted.items())),
    ]
    faults = []
    if refused:
        faults.append(f"{refused} items rejected")
    if doubted:
        faults.append(f"{doubted} items used, but doubtful")
    if monitor.mismatches:
        faults.append("a publisher has incompatible QoS")
    message = "; ".join(faults) or f"{messages} messages"
    return make_status(f"{node}: input {key}", WARN if faults else OK, message, values)


def _kinds(objects: Objects) -> dict[str, npt.NDArray[np.bool_]]:
    """Return which objects are not as they should be, each under the first label that fits."""
    table, visible = objects.table, objects.table.visible
    left = visible.copy()
    kinds = {"unplaceable": table.unplaceable}
    left &= ~table.has(ASIDE)
    for label, facts in (
        ("stale", STALE),
        ("refused", REFUSED),
        ("new shape being built", RESHAPED),
        ("doubtful stamp", FUTURE | HELD_BACK),
    ):
        rows = table.has(facts)
        kinds[label] = left & rows
        left &= ~rows
    return kinds


def _shared(objects: Objects) -> list[tuple[str, object]]:
    """Return the region, and how many objects take part in it; nothing without one."""
    region = objects.scene.region
    if region is None:
        return []
    found = ", ".join(text_from_region(region))
    return [("region", found), ("near the region", len(objects.scene.objects.near))]


def _prepared(objects: Objects) -> list[tuple[str, object]]:
    """Return the shapes whose trees and hulls are built, or can't be: their pairs are on obb."""
    trees = objects.trees
    values: list[tuple[str, object]] = []
    if trees.waiting:
        values.append(("shapes being prepared, pairs on obb meanwhile", trees.waiting))
    for reason, count in sorted(trees.failed.items()):
        values.append((f"shapes not prepared, pairs on obb: {reason}", count))
    return values


def _effect_levels(report: Report | None) -> Iterator[tuple[str, object]]:
    """Yield how many rows of each effect computed so far are of which accuracy."""
    for name in () if report is None else sorted(report.results):
        assert report is not None
        levels = Counter(report.accuracies_of(name).tolist())
        yield from (
            (f"{name} on {Accuracy(level).label}", n) for level, n in sorted(levels.items())
        )


def object_status(
    node: str, objects: Objects, policy: str, report: Report | None
) -> DiagnosticStatus:
    """Count objects: stale, refused (last box kept), unplaceable (no box: not checked)."""
    table, kinds = objects.table, _kinds(objects)
    colliding: object = "not known"
    if report is not None:  # what left since then does not count
        rows = min(len(report.colliding), len(table.condition))
        colliding = int(np.count_nonzero(report.colliding[:rows] & table.live[:rows]))
    levels = Counter() if report is None else Counter(report.accuracies.tolist())
    cap = None if report is None else report.cap
    counts = {label: int(np.count_nonzero(found)) for label, found in kinds.items()}
    counts["unplaceable"] += len(objects.unplaceable)
    reasons = Counter(objects.unplaceable.values())
    reasons["shape being built"] = int(np.count_nonzero(table.has(UNSHAPED)))
    reasons["no transform yet"] = int(np.count_nonzero(table.has(UNPLACED) & ~table.has(UNSHAPED)))
    reasons[INTERNAL_ERROR] += int(np.count_nonzero(table.has(ASIDE)))
    values: list[tuple[str, object]] = [
        ("count", len(table)),
        ("colliding", colliding),
        *_shared(objects),
        *([("pairs at least", report.total)] if report is not None and report.truncated else ()),
        *((f"pairs on {Accuracy(level).label}", count) for level, count in sorted(levels.items())),
        *_effect_levels(report),
        *(() if cap is None else [("highest accuracy in the time budget", Accuracy(cap).label)]),
        ("stale policy", policy),
        *_prepared(objects),
        *counts.items(),
        *((f"unplaceable: {reason}", count) for reason, count in sorted(reasons.items()) if count),
        *(
            (f"names {label}", text)
            for label, text in _named(objects, kinds, counts).items()
            if text
        ),
    ]
    kept = "last box kept"
    words = {
        "stale": f"stale ({STALE_WORDS[policy]})",
        "refused": f"refused ({kept})",
        "new shape being built": f"new shapes being built ({kept})",
        "doubtful stamp": "with a doubtful stamp",
        "unplaceable": "unplaceable (not checked)",
    }
    faults = [f"{counts[label]} {text}" for label, text in words.items() if counts[label]]
    if report is not None and report.truncated:
        faults.append(f"at least {report.total} pairs collide (the first {len(report)} published)")
    message = "; ".join(faults) or f"{len(table)} objects"
    return make_status(f"{node}: objects", WARN if faults else OK, message, values)


def _named(
    objects: Objects, kinds: Mapping[str, npt.NDArray[np.bool_]], counts: Mapping[str, int]
) -> dict[str, str]:
    """Return the names of objects by kind, the first ones."""
    table, texts = objects.table, {}
    for label, rows in kinds.items():
        keys = [table.key(slot) for slot in np.flatnonzero(rows)[:MAX_NAMED].tolist()]
        if label == "unplaceable":
            keys = [*islice(objects.unplaceable, MAX_NAMED), *keys]
        texts[label] = some([name_from_key(key) for key in keys], counts[label])
    return texts


def cycle_status(
    node: str,
    cycles: CycleMonitor,
    effects: Mapping[str, str],
    paused: str,
    seconds: float,
    period: float,
) -> DiagnosticStatus:
    """Mean and longest duration of the last cycles, whole, by stage and by effect; overruns.

    effects: state of each by name, in words; paused: why nothing is checked, "" if it is; period:
    between two cycles (s).
    """
    overruns_before, failures_before = cycles.reported_overruns, cycles.reported_failures
    delay, age = cycles.delay, cycles.age
    durations, stages = cycles.take()
    values: list[tuple[str, object]] = [
        ("enabled", not paused),
        ("rate (Hz)", f"{len(durations) / seconds:.2f}"),
        ("overruns", cycles.overruns),
        ("cycles", cycles.total),
    ]
    if age is not None:
        values.append(("longest delay (s)", f"{delay:.3f}"))
        values.append(("age of the newest state evaluated (s)", f"{age:.3f}"))
    for name, times in (("cycle", durations), *stages.items()):
        if times:
            values.append((f"{name} mean (ms)", f"{1e3 * sum(times) / len(times):.3f}"))
            values.append((f"{name} max (ms)", f"{1e3 * max(times):.3f}"))
    for name, state in effects.items():
        values.append((f"effect {name}", state))
        if name in cycles.counts:
            values.append((f"effect {name} ran on", cycles.counts[name]))
        if name in cycles.failures:
            values.append((f"effect {name} failures", cycles.failures[name]))
            values.append((f"effect {name} last failure", cycles.last_failures[name]))
    faults = []
    if age is not None and delay > max(LONGEST_DELAY, 2.0 * period):
        faults.append(f"overload: states wait {delay:.2f} s, the newest one is {age:.2f} s old")
    if cycles.failures.total() > failures_before:
        faults.append("effects failed on some pairs")
    if paused:
        faults.append(paused)
    if cycles.overruns > overruns_before:
        faults.append(f"{cycles.overruns - overruns_before} cycles took longer than a period")
    message = "; ".join(faults) or f"{len(durations)} cycles"
    return make_status(f"{node}: cycle", WARN if faults else OK, message, values)


def robot_status(node: str, robot: RobotInput) -> DiagnosticStatus:
    """Whether it is known where a robot is, or why not."""
    message = robot.fault or "known"
    level = WARN if robot.fault else OK
    return make_status(f"{node}: robot {robot.name}", level, message, robot.describe().items())


def guard_status(node: str, guard: Guard) -> DiagnosticStatus:
    """Count failures inside the node by where they happened; an error once there was one."""
    values: list[tuple[str, object]] = [("total", guard.total), *sorted(guard.counts.items())]
    if guard.last:
        values.append(("last", guard.last))
    message = f"{guard.total} {INTERNAL_ERROR}s" if guard.total else "none"
    return make_status(f"{node}: internal errors", ERROR if guard.total else OK, message, values)


def qos_status(node: str, reasons: Mapping[str, list[str]]) -> DiagnosticStatus:
    """Name publishers and subscribers that can't be matched, by topic, and why the first can't."""
    found = {topic: whys for topic, whys in reasons.items() if whys}
    message = "incompatible QoS on " + ", ".join(found) if found else "no mismatch"
    values: list[tuple[str, object]] = [(topic, len(whys)) for topic, whys in found.items()]
    for topic, whys in found.items():
        values += [(f"{topic}: {number}", why) for number, why in enumerate(whys[:MAX_NAMED], 1)]
    return make_status(f"{node}: qos", WARN if found else OK, message, values)


PERIOD = 1.0
"""Seconds between two messages."""


class Reporting:
    """Publishes the state of all parts of a node. now: time of its clock (ns)."""

    def __init__(
        self,
        node: Node,
        monitors: dict[str, InputMonitor],
        subscriptions: Subscriptions,
        objects: Objects,
        cycle: CycleRunner,
        outputs: Outputs,
        now: Callable[[], int],
        robots: Sequence[RobotInput] = (),
    ) -> None:
        self._name = node.get_fully_qualified_name().lstrip("/")
        self._monitors, self._subscriptions, self._objects = monitors, subscriptions, objects
        self._cycle, self._outputs, self._robots, self._now = cycle, outputs, robots, now
        self._qos = QosWatch(node, node.get_logger().warning)
        self._last = perf_counter()

    def publish(self) -> None:
        """Check QoS, log pending warnings, and publish the message if it is requested."""
        elapsed, now = perf_counter() - self._last, self._now()
        self._last += elapsed
        self._qos.look({**self._subscriptions.open, **self._outputs.ends})
        for topic, monitor in self._monitors.items():
            monitor.flush()
            monitor.mismatches = len(self._qos.reasons.get(topic, ()))
        if self._outputs.effects.is_requested("diagnostics"):
            self._publish(elapsed, now)
            return
        self._cycle.monitor.take()
        for monitor in self._monitors.values():
            monitor.since_last_report()

    def _publish(self, elapsed: float, now: int) -> None:
        name, cycle, parameters = self._name, self._cycle, self._outputs.parameters
        period = 1.0 / parameters.rate
        message = DiagnosticArray()
        message.header.stamp = stamp_to_ros(now)
        message.status = [
            *(
                input_status(name, topic, monitor, now, elapsed)
                for topic, monitor in self._monitors.items()
            ),
            object_status(name, self._objects, parameters.stale_policy, cycle.report),
            *(robot_status(name, robot) for robot in self._robots),
            cycle_status(
                name, cycle.monitor, self._outputs.effects.states(), cycle.paused, elapsed, period
            ),
            guard_status(name, self._outputs.guard),
            qos_status(name, self._qos.reasons),
        ]
        self._outputs.publishers["diagnostics"].publish(message)
