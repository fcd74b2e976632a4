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

"""Whether anything collides, and for which reason that may be unknown.

The only place that decides it, for the topics ``collision_status`` and ``in_collision`` and for
``/diagnostics``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from obb_collision.node.messages.conversions import NANOSECONDS, name_from_key
from obb_collision.node.objects.objects import Objects
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.scene.report import Report

FREE, COLLIDING, UNKNOWN = DiagnosticStatus.OK, DiagnosticStatus.ERROR, DiagnosticStatus.STALE
MAX_NAMED = 10
"""Objects named; the counts are complete."""

STARTING, STOPPING = "starting", "shutting down"
DISABLED = "disabled: nothing is checked"
INACTIVE = "inactive: nothing is checked"
UNCONFIGURED = "unconfigured: nothing is stored or checked"
FAILED = "the last cycle failed: internal error"
UNCHECKED = "not checked yet"
BLIND = "no state placed"
BLOCKED = "cycle blocked"
OVERLOADED = "overload: states wait"
SILENT = "no input"


@dataclass(frozen=True)
class Answer:
    """Whether anything collides, as far as it is known.

    pairs: colliding ones, of the last check. unknown: why nothing is known at all, "" if something
    is; seconds: since when, 0 if undefined. missing: objects without a box, which are not checked.
    late: objects that take part where they were, while newer states of theirs could not be placed
    in time. refused: those whose latest pose or shape could not be used. building: those that have
    their last shape, as a newer one takes long. lost: stale ones that can be beyond what they are
    grown by. stamp: of the newest state evaluated (ns), 0 for none.
    """

    pairs: int = 0
    unknown: str = STARTING
    seconds: float = 0.0
    missing: int = 0
    names_missing: tuple[str, ...] = ()
    late: int = 0
    names_late: tuple[str, ...] = ()
    refused: int = 0
    names_refused: tuple[str, ...] = ()
    building: int = 0
    names_building: tuple[str, ...] = ()
    stale: int = 0
    names_stale: tuple[str, ...] = ()
    lost: int = 0
    names_lost: tuple[str, ...] = ()
    doubtful: int = 0
    objects: int = 0
    stamp: int = 0
    more: bool = False
    """Whether ``pairs`` is less than there are."""
    robots: tuple[str, ...] = ()
    """Why it is not known where robots are, a text each."""
    notes: tuple[str, ...] = ()
    """What else is to be said of robots, a text each."""

    @property
    def level(self) -> bytes:
        """FREE, COLLIDING or UNKNOWN; COLLIDING if a pair is found, whatever else is unknown."""
        if self.unknown:
            return bytes(UNKNOWN)
        if self.pairs:
            return bytes(COLLIDING)
        return bytes(FREE if self.is_complete else UNKNOWN)

    @property
    def is_complete(self) -> bool:
        """Whether nothing is unknown, whatever collides."""
        objects = self.missing or self.late or self.refused or self.building or self.lost
        return not (self.unknown or objects or self.robots)

    def flag(self, unknown_is_collision: bool) -> bool:
        """Return the value of ``in_collision``."""
        return self.pairs > 0 or (self.level == UNKNOWN and unknown_is_collision)

    @property
    def kind(self) -> tuple[object, ...]:
        """The part whose changes are published immediately; all else waits for the next period."""
        unsure = self.missing, self.late, self.refused, self.building, self.lost, self.stale
        return self.level, self.unknown, self.robots, self.notes, *map(bool, unsure)

    @property
    def message(self) -> str:
        """Return the answer as one line of text."""
        time = f" for {self.seconds:.1f} s" if self.seconds else ""
        parts = [self.unknown + time] if self.unknown else []
        if self.pairs:
            last = " at the last check" if self.unknown else ""
            number = f"at least {self.pairs}" if self.more else str(self.pairs)
            parts.append(f"{number} pair{'s collide' if self.pairs > 1 else ' collides'}{last}")
        elif not self.unknown and self.level == FREE:
            parts.append("free")
        parts += (*self.robots, *self.notes)
        for count, names, what in (
            (self.missing, self.names_missing, "without a box (not checked)"),
            (self.late, self.names_late, "not placed in time"),
            (self.refused, self.names_refused, "refused, where they were before"),
            (self.building, self.names_building, "with a new shape being built"),
            (self.lost, self.names_lost, "stale, may be anywhere"),
            (self.stale, self.names_stale, "stale"),
        ):
            if count:
                parts.append(f"{count} {what}: {some(names, count)}")
        return "; ".join(parts)

    def without(self, reason: str, seconds: float = 0.0) -> Answer:
        """Return the same answer, unknown from now on, with the reason and its duration."""
        return replace(self, unknown=reason, seconds=seconds)

    def to_ros(self, name: str, now: int, unknown_is_collision: bool) -> DiagnosticStatus:
        """Return the status; ``now`` is the time (ns)."""
        age = f"{(now - self.stamp) / NANOSECONDS:.3f}" if self.stamp else "never"
        values: list[tuple[str, object]] = [
            ("colliding pairs at least" if self.more else "colliding pairs", self.pairs),
            ("age of the newest state (s)", age),
            ("objects", self.objects),
            ("stale", self.stale),
            ("doubtful", self.doubtful),
            ("unplaceable", self.missing),
            ("not placed in time", self.late),
            ("refused", self.refused),
            ("new shape being built", self.building),
            ("may be anywhere", self.lost),
            ("in_collision", self.flag(unknown_is_collision)),
            ("unknown_is_collision", unknown_is_collision),
        ]
        return DiagnosticStatus(
            level=self.level,
            name=name,
            message=self.message,
            hardware_id="obb_collision",
            values=[KeyValue(key=key, value=str(value)) for key, value in values],
        )


def some(names: tuple[str, ...] | list[str], count: int) -> str:
    """Return the first names, and how many more there are of ``count``."""
    shown = names[:MAX_NAMED]
    more = count - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def answer(
    objects: Objects,
    report: Report | None,
    paused: str,
    failed: bool,
    now: int,
    timeout: float,
    overdue: float = 0.0,
    robots: tuple[str, ...] = (),
) -> Answer:
    """Return the answer after a cycle.

    report: of its check, None where there was none; paused: why nothing is checked, "" if it is;
    failed: it ended in an internal error; timeout: the age (s) at which states are stale, 0 for
    never; overdue: how long (s) states waited for it, if that is too long, else 0; robots: why it
    is not known where some are.
    """
    table = objects.table
    placed, aside = table.visible, table.live & table.set_aside
    waiting = table.unplaceable & ~aside
    stale = table.live & table.stale
    lost = stale & table.lost
    missing = int(np.count_nonzero(waiting | aside)) + len(objects.unplaceable)
    failing = (f"{name} ({INTERNAL_ERROR})" for name in _names(objects, aside))
    # a stale object that is ignored takes part in nothing, wherever it is
    checked = placed & ~(stale & objects.placement.ignore_stale)
    late = checked & table.frame_refused
    unused = table.pose_refused | table.shape_refused
    refused = checked & unused & ~(late | aside) if unused.any() else unused
    building = checked & objects.shapes.overdue & ~aside
    known = Answer(
        pairs=0 if report is None else report.total,
        more=report is not None and report.truncated,
        missing=missing,
        names_missing=(*failing, *_names(objects, waiting), *_unplaceable(objects)),
        late=int(np.count_nonzero(late)),
        names_late=_names(objects, late),
        refused=int(np.count_nonzero(refused)),
        names_refused=_names(objects, refused),
        building=int(np.count_nonzero(building)),
        names_building=_names(objects, building),
        stale=int(np.count_nonzero(stale)),
        names_stale=_names(objects, stale),
        lost=int(np.count_nonzero(lost)),
        names_lost=_names(objects, lost),
        doubtful=int(np.count_nonzero(table.doubtful)),
        objects=len(table),
        stamp=objects.newest_stamp(now) if placed.any() else 0,
        robots=robots,
    )
    if paused:
        return known.without(paused)
    if failed:
        return known.without(FAILED)
    if report is None and len(table):
        return known.without(UNCHECKED)
    if overdue:
        return known.without(OVERLOADED, overdue)
    return known.without(*_blind(objects, now, timeout))


def _blind(objects: Objects, now: int, timeout: float) -> tuple[str, float]:
    """Return that no state has been placed and since how long (s), or an empty text."""
    received = objects.table.world_received[objects.table.visible]
    if timeout > 0 and len(received):
        age = (now - int(received.max())) / NANOSECONDS
        if age > timeout:
            return BLIND, age
    return "", 0.0


def _names(objects: Objects, rows: npt.NDArray[np.bool_]) -> tuple[str, ...]:
    if not rows.any():
        return ()
    slots = np.flatnonzero(rows)[:MAX_NAMED].tolist()
    return tuple(name_from_key(objects.table.key(slot)) for slot in slots)


def _unplaceable(objects: Objects) -> tuple[str, ...]:
    first = islice(objects.unplaceable.items(), MAX_NAMED)
    return tuple(f"{name_from_key(key)} ({reason})" for key, reason in first)
