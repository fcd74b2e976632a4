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

"""The answer whether anything collides, and what is missing to claim that nothing does.

The only place that decides it: for the status and the flag, the gate of trajectories, validity and
speed scale of robots, events and ``/diagnostics``. Free is a claim that needs evidence: each fact
that is missing names itself by a code of ``CODES``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from math import inf

import numpy as np

from obb_collision.node.cycle.cycle import CycleRunner
from obb_collision.node.diagnostics.answer import (
    MAX_NAMED,
    RADIUS,
    SELECTED_RADIUS,
    Answer,
    Reason,
    first_names,
)
from obb_collision.node.inputs.inputs import Inputs
from obb_collision.node.inputs.subscriptions import Subscriptions
from obb_collision.node.messages.conversions import name_from_key
from obb_collision.node.objects.conditions import IGNORED, LOST, STALE, STATES
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.table import OF_SOURCE, Slots
from obb_collision.node.parameters.entries import Groups, bounds_text
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.parameters.sources import WATCH, SourceSettings
from obb_collision.node.robots.robots import Robots
from obb_collision.node.runtime.clock import NodeClock
from obb_collision.node.status.collision_status import STATUS
from obb_collision.scene.effects.settings import OFF
from obb_collision.scene.store.patterns import matching
from obb_collision.scene.store.store import NO_ROWS
from obb_collision.typing import Mask

LONGEST_STANDSTILL = 1.0
"""Seconds of steady time for which a clock may stand still at most while messages come."""
LOOK = 0.5
"""Seconds between two looks for publishers that are gone, or came."""
UNASKED = ("points",)
"""Inputs whose lost messages do not matter: no object depends on them."""


class Evidence:
    """Answers by the state of objects, inputs, robots, cycles and clock.

    publishers: returns how many there are of the status, this node among them.
    """

    def __init__(
        self,
        parameters: Parameters,
        objects: Objects,
        inputs: Inputs,
        subscribed: Subscriptions,
        robots: Robots,
        cycle: CycleRunner,
        clock: NodeClock,
        publishers: Callable[[], int],
    ) -> None:
        self._parameters, self._objects, self._cycle = parameters, objects, cycle
        self._unknown, self._newest, self._robots = inputs.unknown, inputs.newest, robots
        self._senders, self._inputs = subscribed.senders, subscribed.reports
        self._clock, self._steady, self._publishers = clock, clock.seconds, publishers
        self._looked, self._others = -inf, 0
        self._activated = self._steady()
        self._standstill = LONGEST_STANDSTILL
        self._sources: list[SourceSettings] = []
        """Those that are obstacles."""
        self._unasked = set(UNASKED)
        self._required: tuple[tuple[object, ...], tuple[str, ...]] = (), ()

    def activate(self) -> None:
        """Count silences from now on."""
        self._activated = self._steady()

    def apply(self) -> None:
        """Apply the parameters: a clock may stand still for the shortest age limit at most."""
        parameters, robots = self._parameters, self._robots.robots
        limits = [parameters.object_timeout, parameters.joint_timeout if robots else 0.0]
        for entries in (parameters.object_timeout_overrides, parameters.required_inputs):
            limits += [limit for _, limit in entries]
        settings = parameters.source_settings
        self._sources = [source for source in settings if source.use != WATCH]
        limits += [source.timeout for source in self._sources]
        self._unasked = {*UNASKED, *(source.topic for source in settings if source.use == WATCH)}
        self._standstill = min((limit for limit in limits if limit), default=LONGEST_STANDSTILL)
        self._standstill = min(self._standstill, LONGEST_STANDSTILL)

    def answer(self) -> Answer:
        """Return the answer for now."""
        now = self._clock.now()
        self._look()
        faults = list(self._robots.faults())
        answer = objects_answer(self._objects, now, [slots for *_, slots in faults])
        pairs, more = self._cycle.pairs_left()
        notes = *answer.notes, *self._robots.notes()
        counts = dict(answer.counts)
        if self._parameters.mode("clearance") != OFF:
            setting = self._parameters.setting("clearance")
            whole = "*" in setting["objects"]  # else there are pairs of which none is selected
            counts[RADIUS] = setting["max_distance"] if whole else 0.0
            counts[SELECTED_RADIUS] = setting["max_distance"]
        counts["region"] = bounds_text(self._objects.scene.region)
        of_node = *self._of_cycle(), *self._of_clock(), *self._of_inputs()
        whom: dict[str, list[str]] = {}
        for code, who, _ in faults:
            whom.setdefault(code, []).append(who)
        of_robots = (Reason(code, tuple(w[:MAX_NAMED]), len(w)) for code, w in whom.items())
        reasons = *of_node, *self._of_scene(now), *of_robots
        return replace(answer, pairs=pairs, more=more, notes=notes, counts=counts).but(*reasons)

    def not_known(self) -> str:
        """Return why other states of robots cannot be checked, "" if they can.

        With a region they cannot: objects beyond it are not checked.
        """
        beyond = "objects outside the region are not checked"
        region = (
            () if self._objects.scene.region is None else (Reason("incomplete", (), 0, beyond),)
        )
        return self.answer().but(*region).why

    def _of_cycle(self) -> Iterator[Reason]:
        """Yield why the result of the last cycle does not hold now."""
        cycle, broken = self._cycle, self._objects.broken
        if cycle.paused:
            yield Reason(cycle.paused)
        elif cycle.report is None and not (cycle.failed or len(self._objects.links_on_boxes)):
            yield Reason("starting", detail="no check has ended yet")
        if cycle.failed or broken:
            yield Reason("internal_error", detail=broken or "in the last cycle")
        if cycle.delay > self._parameters.allowed_delay:
            yield Reason("overload")
        shared = [
            newest.topic
            for newest in self._newest
            if newest.is_contested and newest.topic not in self._unasked
        ]
        if self._others or shared:
            who = (*(STATUS for _ in range(self._others > 0)), *shared)
            yield Reason("two_publishers", who, len(who))

    def _of_clock(self) -> Iterator[Reason]:
        """Yield that the clock stands still, by which nothing ages.

        A paused simulation may stand for long if nothing comes: then nothing has changed.
        """
        clock = self._clock
        heard = max((monitor.heard for monitor in self._inputs.values()), default=0.0)
        until = heard if clock.has_time else self._steady()
        if until - max(clock.moved, self._activated) > self._standstill:
            yield Reason("clock_stopped", detail="" if clock.has_time else "no message on /clock")

    def _of_scene(self, now: int) -> Iterator[Reason]:
        """Yield which objects are missing: required ones, unknown ones, or all."""
        objects, parameters = self._objects, self._parameters
        may_be_empty = objects.is_declared_empty or parameters.expect_empty
        if objects.is_empty and not (may_be_empty or objects.unplaceable):
            yield Reason("no_objects")
        missing = self._missing() if parameters.required_objects else ()
        if missing:
            yield Reason("required_missing", missing[:MAX_NAMED], len(missing))
        unknown, more = self._unknown.names(now), self._unknown.left_out(now)
        if unknown or more:
            yield Reason("unknown_objects", tuple(unknown[:MAX_NAMED]), len(unknown), more=more)

    def _missing(self) -> tuple[str, ...]:
        """Return the names of required objects that do not exist; kept while nothing changes."""
        parameters, table = self._parameters, self._objects.table
        # the table makes new ranks whenever an object comes, goes or is renamed
        basis = parameters.required_objects, parameters.groups, table.ranks
        basis_before, missing = self._required
        if not basis_before or any(a is not b for a, b in zip(basis, basis_before, strict=True)):
            names = [name_from_key(key) for key in table.slots]
            meant = Groups(parameters.groups).all_meant(parameters.required_objects)
            missing = tuple(name for name in meant if not matching((name,), names).any())
            self._required = basis, missing
        return missing

    def _of_inputs(self) -> Iterator[Reason]:
        """Yield which inputs are silent, or cannot be read."""
        steady, parameters = self._steady(), self._parameters
        silent = []
        for topic, limit in parameters.required_inputs:
            heard = self._inputs[topic].heard if topic in self._inputs else 0.0
            if heard < self._activated or steady - heard > limit:
                silent.append(topic)
        for source in self._sources:
            heard = self._inputs[source.topic].heard
            if heard < self._activated and 0.0 < source.timeout < steady - self._activated:
                silent.append(source.topic)
        asked = {t: monitor for t, monitor in self._inputs.items() if t not in self._unasked}
        heard = max((monitor.heard for monitor in asked.values()), default=0.0)
        if 0.0 < parameters.input_timeout < steady - max(heard, self._activated):
            silent.append("all")
        if silent:
            yield Reason("input_silent", tuple(silent[:MAX_NAMED]), len(silent))
        bad = [
            f"{topic} ({next(iter(monitor.unreadable.values()))})"
            for topic, monitor in asked.items()
            if monitor.unreadable
        ]
        if bad:
            yield Reason("input_unreadable", tuple(bad[:MAX_NAMED]), len(bad))
        lost = [
            topic for topic, monitor in asked.items() if monitor.missed and self._is_missed(topic)
        ]
        if lost:
            yield Reason("messages_lost", tuple(lost), len(lost))

    def _is_missed(self, topic: str) -> bool:
        """Return whether lost changes matter: poses do not where all objects have newer ones."""
        missed = self._inputs[topic].missed
        if topic == "objects" or missed is None:
            return missed is not None
        table = self._objects.table
        own = table.live & ~table.of_robot & (table.of_set != OF_SOURCE)
        if (table.received[own] <= missed.time).any():
            return True
        if any(robot.has_base_of(missed.time) for robot in self._robots.robots):
            return True
        self._inputs[topic].missed = None
        return False

    def _look(self) -> None:
        """Find out who else publishes the status, and forget senders that are gone."""
        steady = self._steady()
        if 0.0 <= steady - self._looked < LOOK:
            return
        self._looked, self._others = steady, max(0, self._publishers() - 1)
        for topic, monitor in self._inputs.items():
            senders = self._senders.get(topic)
            unreadable = monitor.unreadable if senders is not None else ()
            for sender in senders.gone(unreadable) if senders and unreadable else ():
                if not self._goes_by(sender):
                    del monitor.unreadable[sender]
        for boxes in self._newest:
            if boxes.is_contested and boxes.topic in self._senders:
                boxes.forget(self._senders[boxes.topic].gone(boxes.senders))

    def _goes_by(self, sender: int) -> bool:
        """Return whether the state of any object or robot is a sender's, and not stale."""
        table = self._objects.table
        own = table.live & ((table.sender == sender) | (table.maker == sender))
        robots = self._robots.robots
        return bool((own & ~table.has(STALE)).any()) or any(r.goes_by(sender) for r in robots)


def objects_reasons(objects: Objects, others: Iterable[Slots] = ()) -> Iterator[Reason]:
    """Yield why objects may not be where their boxes are, each object once.

    others: slots of objects whose reasons are reported elsewhere.
    """
    table = objects.table
    left, present = table.live & ~table.has(IGNORED), table.facts
    for slots in others:
        left[slots] = False
    for code, facts in STATES.items():
        refused = objects.unplaceable.items() if code == "refused" else ()
        newcomers = [f"{name_from_key(key)} ({why})" for key, why in islice(refused, MAX_NAMED)]
        on_boxes = objects.links_on_boxes if code == "shape_building" else NO_ROWS
        if not (present & facts or newcomers or len(on_boxes)):
            continue
        rows = table.has(facts)
        rows[on_boxes] = True
        affected, left = left & rows, left & ~rows
        count = int(np.count_nonzero(affected)) + (len(objects.unplaceable) if newcomers else 0)
        if count:
            yield Reason(code, (*newcomers, *_names(objects, affected)), count)


def objects_answer(objects: Objects, now: int, others: Iterable[Slots] = ()) -> Answer:
    """Return the answer by objects alone at a time (ns), no pair checked; others: see reasons."""
    table = objects.table
    reasons = tuple(objects_reasons(objects, others))
    stale = table.has(STALE)
    accepted = stale & ~table.has(LOST)
    number = int(np.count_nonzero(accepted))
    names = first_names(_names(objects, accepted), number)
    counts: dict[str, object] = {
        "objects": len(table),
        "stale": int(np.count_nonzero(stale)),
        "doubtful": int(np.count_nonzero(table.doubtful)),
        **{reason.code: reason.count for reason in reasons},
    }
    if objects.scene.region is not None:  # regions are joined by stamps
        counts["stamped"] = objects.believed_stamp(now) > 0
    return Answer(
        reasons,
        notes=(f"{number} stale (accepted): {names}",) if number else (),
        counts=counts,
        stamp=objects.newest_stamp(now) if table.visible.any() else 0,
    )


def _names(objects: Objects, rows: Mask) -> tuple[str, ...]:
    slots = np.flatnonzero(rows)[:MAX_NAMED].tolist()
    return tuple(map(objects.table.name, slots))
