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
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from time import perf_counter
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from obb_collision.accuracy import Accuracy
from obb_collision.node.cycle.cycle import CycleRunner
from obb_collision.node.diagnostics.answer import MAX_NAMED, first_names, make_status
from obb_collision.node.diagnostics.monitors import InputMonitor, QosWatch
from obb_collision.node.inputs.subscriptions import Subscriptions
from obb_collision.node.messages.conversions import NANOSECONDS, name_from_key, stamp_to_ros
from obb_collision.node.objects.conditions import (
    ABSENT,
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
from obb_collision.node.robots.robots import Robots
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.scene.report import Report

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
STALE_WORDS = {
    "unknown": "last box kept",
    "collide": "last box grown",
    "keep": "accepted where they were",
    "ignore": "ignored",
}
KINDS = (
    ("unplaceable", ABSENT, "unplaceable (not checked)"),
    ("stale", STALE, "stale ({})"),
    ("refused", REFUSED, "refused (last box kept)"),
    ("new shape being built", RESHAPED, "new shapes being built (last box kept)"),
    ("doubtful stamp", FUTURE | HELD_BACK, "with a doubtful stamp"),
)
"""Labels of objects that are not as they should be, the facts that mean it, and words for it; of
those that fit an object the first one counts."""
LONGEST_DELAY = 0.2
"""Seconds from a message's receipt to its answer, beyond which overload is reported; two periods
where those are longer."""
PERIOD = 1.0
"""Seconds between two messages."""


class Part(NamedTuple):
    """The state of a part of the node: its faults, or the message without any, and its values."""

    name: str
    faults: Sequence[str]
    fine: str
    values: Iterable[tuple[str, object]]
    level: bytes = WARN
    """Where there are faults."""


def input_part(topic: str, monitor: InputMonitor, now: int, seconds: float) -> Part:
    """Return the rate, age and refused items by reason of an input, over the last ``seconds``."""
    messages, refused, doubted = monitor.since_last_report()
    age = "never" if monitor.last is None else f"{(now - monitor.last) / NANOSECONDS:.3f}"
    values: dict[str, object] = {
        "topic": monitor.topic,
        "messages": monitor.messages,
        "rate (Hz)": f"{messages / seconds:.2f}",
        "age (s)": age,
        "rejected": monitor.refused.total(),
        "qos mismatches": monitor.mismatches,
    }
    more = {"superseded": monitor.superseded, "lost": monitor.lost}
    values |= {key: value for key, value in more.items() if value}
    if monitor.ignored is not None:
        values["not finite in the last cloud"] = monitor.ignored
    values |= {f"last cloud: {what}": count for what, count in monitor.last_cloud.items()}
    for word, counts in (("rejected", monitor.refused), ("doubtful", monitor.doubted)):
        values |= {f"{word}: {reason}": count for reason, count in sorted(counts.items())}
    faults = {
        f"{refused} items rejected": refused,
        f"{doubted} items used, but doubtful": doubted,
        "a publisher has incompatible QoS": monitor.mismatches,
    }
    faults_there = [text for text, count in faults.items() if count]
    return Part(f"input {topic}", faults_there, f"{messages} messages", values.items())


def objects_part(objects: Objects, policy: str, report: Report | None) -> Part:
    """Count objects: stale, refused (last box kept), unplaceable (no box: not checked)."""
    table, kinds = objects.table, _kinds(objects)
    counts = {label: int(np.count_nonzero(rows)) for label, rows in kinds.items()}
    counts["unplaceable"] += len(objects.unplaceable)
    values = [
        ("count", len(table)),
        *_checked(objects, report),
        ("stale policy", policy),
        *_prepared(objects),
        *counts.items(),
        *_unplaceable(objects),
        *_named(objects, kinds, counts),
    ]
    faults = [
        f"{counts[label]} {words.format(STALE_WORDS[policy])}"
        for label, _, words in (*KINDS[1:], KINDS[0])
        if counts[label]
    ]
    if report is not None and report.truncated:
        faults.append(f"at least {report.total} pairs collide ({len(report)} published)")
    return Part("objects", faults, f"{len(table)} objects", values)


def _kinds(objects: Objects) -> dict[str, npt.NDArray[np.bool_]]:
    """Return which objects are of each of ``KINDS``, by label."""
    table, kinds = objects.table, {}
    left = table.live
    for label, facts, _ in KINDS:
        kinds[label], left = left & table.has(facts), left & ~table.has(facts)
    return kinds


def _checked(objects: Objects, report: Report | None) -> Iterator[tuple[str, object]]:
    """Yield how many collide, of which accuracy pairs and rows of effects are, and the region."""
    table, region = objects.table, objects.scene.region
    if region is not None:
        yield "region", ", ".join(text_from_region(region))
        yield "near the region", len(objects.scene.objects.near)
    if report is None:
        yield "colliding", "not known"
        return
    rows = min(len(report.colliding), len(table.condition))  # what left since then does not count
    count = int(np.count_nonzero(report.colliding[:rows] & table.live[:rows]))
    yield "colliding", f"at least {count}" if report.truncated else count
    if report.truncated:
        yield "pairs at least", report.total
    levels = {"pairs": report.accuracies}
    levels |= {name: report.accuracies_of(name) for name in sorted(report.results)}
    for name, accuracies in levels.items():
        for level, count in sorted(Counter(accuracies.tolist()).items()):
            yield f"{name} on {Accuracy(level).label}", count
    if objects.scene.time_budget is not None:
        yield "left on obb by the time budget", "some" if report.behind else "none"


def _prepared(objects: Objects) -> Iterator[tuple[str, object]]:
    """Yield the shapes whose trees and hulls are built, or can't be: their pairs are on obb."""
    if objects.trees.waiting:
        yield "shapes being prepared, pairs on obb meanwhile", objects.trees.waiting
    for reason, count in sorted(objects.trees.failed.items()):
        yield f"shapes not prepared, pairs on obb: {reason}", count


def _unplaceable(objects: Objects) -> Iterator[tuple[str, object]]:
    """Yield how many objects have no box, by reason."""
    table, reasons = objects.table, Counter(objects.unplaceable.values())
    unshaped = table.has(UNSHAPED)
    for reason, rows in (
        ("shape being built", unshaped),
        ("no transform yet", table.has(UNPLACED) & ~unshaped),
        (INTERNAL_ERROR, table.has(ASIDE)),
    ):
        reasons[reason] += int(np.count_nonzero(rows))
    for reason, count in sorted(reasons.items()):
        if count:
            yield f"unplaceable: {reason}", count


def _named(
    objects: Objects, kinds: dict[str, npt.NDArray[np.bool_]], counts: dict[str, int]
) -> Iterator[tuple[str, object]]:
    """Yield the names of objects by kind, the first ones."""
    for label, rows in kinds.items():
        keys = [objects.table.key(slot) for slot in np.flatnonzero(rows)[:MAX_NAMED].tolist()]
        if label == "unplaceable":
            keys = [*islice(objects.unplaceable, MAX_NAMED), *keys]
        if keys:
            yield f"names {label}", first_names([name_from_key(key) for key in keys], counts[label])


def publish_parts(outputs: Outputs, node: str, now: int, parts: Iterable[Part]) -> None:
    """Publish parts of a node at a time (ns), if that is requested."""
    if not outputs.effects.is_requested("diagnostics"):
        return
    message = DiagnosticArray()
    message.header.stamp = stamp_to_ros(now)
    for name, faults, fine, values, level in parts:
        text = "; ".join(faults) or fine
        level = level if faults else OK
        message.status.append(make_status(f"{node}: {name}", level, text, values))
    outputs.publishers["diagnostics"].publish(message)


class Reporting:
    """Publishes the state of all parts of a node, by its full name."""

    def __init__(
        self,
        name: str,
        outputs: Outputs,
        objects: Objects,
        subscribed: Subscriptions,
        robots: Robots,
        cycle: CycleRunner,
        qos: QosWatch,
        now: Callable[[], int],
    ) -> None:
        self._name, self._outputs, self._objects = name, outputs, objects
        self._subscribed, self._robots, self._cycle = subscribed, robots, cycle
        self._qos, self._now = qos, now
        self._monitors = objects.monitors
        self.more: list[Callable[[], Part]] = []
        """Make the states of further parts."""
        self._last = perf_counter()

    def publish(self) -> None:
        """Check QoS, log pending warnings, and publish the message if it is requested."""
        elapsed, now = perf_counter() - self._last, self._now()
        self._last += elapsed
        self._qos.compare({**self._subscribed.open, **self._outputs.ends})
        for topic, monitor in self._monitors.items():
            monitor.flush()
            monitor.mismatches = len(self._qos.reasons.get(topic, ()))
        publish_parts(self._outputs, self._name, now, self.parts(elapsed, now))
        for monitor in self._monitors.values():
            monitor.since_last_report()
        self._cycle.monitor.begin_report()

    def parts(self, elapsed: float, now: int) -> Iterator[Part]:
        """Yield all parts at a time (ns), of the last seconds."""
        for topic, monitor in self._monitors.items():
            yield input_part(topic, monitor, now, elapsed)
        policy = self._outputs.parameters.stale_policy
        yield objects_part(self._objects, policy, self._cycle.report)
        for robot in self._robots.robots:
            faults = [robot.fault] if robot.fault else []
            yield Part(f"robot {robot.name}", faults, "known", robot.describe().items())
        for make in self.more:
            yield make()
        yield self._cycle_part(elapsed)
        yield self._guard_part()
        yield self._qos_part()

    def _cycle_part(self, seconds: float) -> Part:
        """Mean and longest duration of the last cycles, whole, by stage and by effect; overruns."""
        cycles, paused = self._cycle.monitor, self._cycle.paused
        number = len(cycles.stages.get("cycle", ()))
        values: dict[str, object] = {
            "enabled": not paused,
            "rate (Hz)": f"{number / seconds:.2f}",
            "overruns": cycles.overruns,
            "cycles": cycles.total,
        }
        if cycles.age is not None:
            values["longest delay (s)"] = f"{cycles.delay:.3f}"
            values["age of the newest state evaluated (s)"] = f"{cycles.age:.3f}"
        for name, times in cycles.stages.items():
            values[f"{name} mean (ms)"] = f"{1e3 * sum(times) / len(times):.3f}"
            values[f"{name} max (ms)"] = f"{1e3 * max(times):.3f}"
        for name, state in self._outputs.effects.states().items():
            values[f"effect {name}"] = state
            if name in cycles.counts:
                values[f"effect {name} ran on"] = cycles.counts[name]
            if name in cycles.failures:
                values[f"effect {name} failures"] = cycles.failures[name]
                values[f"effect {name} last failure"] = cycles.last_failures[name]
        faults, (overruns, failures) = [], cycles.reported
        longest = max(LONGEST_DELAY, 2.0 / self._outputs.parameters.rate)
        if cycles.age is not None and cycles.delay > longest:
            waited = f"{cycles.delay:.2f} s, the newest one is {cycles.age:.2f} s old"
            faults.append(f"overload: states wait {waited}")
        if cycles.failures.total() > failures:
            faults.append("effects failed on some pairs")
        if paused:
            faults.append(paused)
        if cycles.overruns > overruns:
            faults.append(f"{cycles.overruns - overruns} cycles took longer than a period")
        return Part("cycle", faults, f"{number} cycles", values.items())

    def _guard_part(self) -> Part:
        """Count failures inside the node by where they happened; an error once there was one."""
        guard = self._outputs.guard
        values: dict[str, object] = {"total": guard.total, **dict(sorted(guard.counts.items()))}
        if guard.last:
            values["last"] = guard.last
        faults = [f"{guard.total} {INTERNAL_ERROR}s"] if guard.total else []
        return Part("internal errors", faults, "none", values.items(), ERROR)

    def _qos_part(self) -> Part:
        """Name ends that can't be matched, by topic, and why the first can't."""
        mismatches = {topic: whys for topic, whys in self._qos.reasons.items() if whys}
        values: list[tuple[str, object]] = [
            (topic, len(whys)) for topic, whys in mismatches.items()
        ]
        for topic, whys in mismatches.items():
            values += [(f"{topic}: {row}", why) for row, why in enumerate(whys[:MAX_NAMED], 1)]
        faults = [f"incompatible QoS on {', '.join(mismatches)}"] if mismatches else []
        return Part("qos", faults, "no mismatch", values)
