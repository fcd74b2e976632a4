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

"""Answer to whether objects collide, and the reasons why it is unknown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from obb_collision.node.messages.conversions import NANOSECONDS

FREE, COLLIDING, UNKNOWN = DiagnosticStatus.OK, DiagnosticStatus.ERROR, DiagnosticStatus.STALE
MAX_NAMED = 10
"""Objects named; the counts are complete, or say that they are not."""

RADIUS = "clearance radius (m)"
"""Of the status: pairs that are farther apart are not in ``clearances``. 0 if some are left out."""
SELECTED_RADIUS = "clearance radius of selected objects (m)"
"""The same for pairs with one of ``effects.clearance_objects``."""

CODES = {
    "starting": "starting",
    "unconfigured": "unconfigured: nothing is stored or checked",
    "inactive": "inactive: nothing is checked",
    "disabled": "disabled: nothing is checked",
    "shutting_down": "shutting down",
    "internal_error": "internal error",
    "blocked": "cycle blocked",
    "overload": "overload: states wait too long",
    "clock_stopped": "the clock stands still",
    "two_publishers": "several publishers of what one has to say",
    "no_objects": "no object is known, and nobody said that there is none",
    "required_missing": "required objects missing",
    "input_silent": "no input",
    "input_unreadable": "the last message could not be read",
    "messages_lost": "messages were lost",
    "unknown_objects": "states of unknown objects",
    "shape_building": "shape being built",
    "unplaced": "without a pose",
    "refused": "refused, where they were before",
    "late_frame": "not placed in time",
    "stale": "stale",
    "robot_unknown": "robot not known",
    "joint_unknown": "joints not known",
    "base_unknown": "base not known",
    "incomplete": "not checked completely",
    "region_silent": "regions are silent",
    "region_gap": "regions leave a gap",
    "region_twice": "regions overlap, or have several publishers",
    "region_unmatched": "no stamp that all regions have evaluated",
}
"""The codes in the order in which they are reported, each with what it means."""
REMEDIES = {
    "starting": "No check has ended yet, or kernels are being compiled: wait.",
    "unconfigured": "autostart is false: configure and activate the node.",
    "inactive": "Activate the node.",
    "disabled": "Call ~/enable with true.",
    "shutting_down": "The node ends; this is its last message.",
    "internal_error": "Report it, with the log. Ends with ~/clear or the next check that passes.",
    "blocked": "No cycle ended within 1 / rate + cycle_timeout: look at the load of the machine.",
    "overload": "States wait longer than that: send them by object_poses, lower the rate, or set "
    "time_budget.",
    "clock_stopped": "Nothing ages: /clock does not move though messages come. Start it, or "
    "unset use_sim_time.",
    "two_publishers": "Of collision_status: give each node its own name or namespace. Of complete "
    "sets: let one sender join them. Ends when one is left.",
    "no_objects": "Send objects, or say that there are none: ~/clear, DELETEALL, DELETE of the "
    "last, an empty set, a scene file without objects, expect_empty.",
    "required_missing": "Send the objects of required_objects.",
    "input_silent": "No message within required_inputs or input_timeout: start its sender.",
    "input_unreadable": "The last message of a sender was damaged or of another type. Ends with a "
    "readable one of this sender, when it is gone and its objects are, or with ~/clear.",
    "messages_lost": "Send all objects again after a DELETEALL, or call ~/clear. Poses: ends once "
    "a newer one came of every object. Send less often, or give the topic a deeper queue.",
    "unknown_objects": "States name objects that the node lacks: send these again, or list them in "
    "ignored_objects. Ends after a second of silence.",
    "shape_building": "A shape or hull is being built: wait.",
    "unplaced": "The object has no pose yet that can be placed: send one, or its transform.",
    "refused": "The latest state was bad; the object stays where it was. /diagnostics has the "
    "reason.",
    "late_frame": "Publish the transform within transform_timeout; the object follows late.",
    "stale": "The latest state is older than the age limit, by stamp, receipt or transform: start "
    "its sender, synchronise clocks (judge_ages), or set stale_policy_overrides.",
    "robot_unknown": "Publish ROBOT/robot_description.",
    "joint_unknown": "Publish finite values of every joint, stamped within joint_timeout.",
    "base_unknown": "Publish the robot's base, or its transform: see robot_bases.",
    "incomplete": "Merger: a region's status has no content.",
    "region_silent": "Merger: start the regions named, or send them all objects again.",
    "region_gap": "Merger: give the regions bounds that fill space; nodes must be of one version.",
    "region_twice": "Merger: give the regions bounds that do not overlap, and each one node.",
    "region_unmatched": "Merger: no stamp was evaluated by all regions: stamp the states.",
}
"""What ends each code, for docs/status.md."""
_ORDER = {code: number for number, code in enumerate(CODES)}


@dataclass(frozen=True)
class Reason:
    """A fact that is missing for the claim that nothing collides.

    code: one of ``CODES``; who: whom it is about, the first MAX_NAMED of ``count``; detail: what
    else people want to know; more: at least so many. Nothing in it changes while the fact stays
    missing.
    """

    code: str
    who: tuple[str, ...] = ()
    count: int = 0
    detail: str = ""
    more: bool = False

    @property
    def whom(self) -> str:
        """Whom it is about, as text."""
        return some(self.who, max(self.count, len(self.who)), self.more)

    @property
    def text(self) -> str:
        """The reason for people."""
        what = CODES[self.code] + (f", {self.detail}" if self.detail else "")
        return f"{what}: {self.whom}" if self.who else what


@dataclass(frozen=True)
class Answer:
    """What is known of collisions.

    reasons: what is missing for the claim that nothing collides, in the order of ``CODES``. pairs:
    how many collided at the last check, of those whose objects still exist; more: at least so many.
    notes: what else people should know. counts: of objects, by what is said of them. stamp: of the
    newest state evaluated (ns), 0 for none, None where nobody knows.
    """

    reasons: tuple[Reason, ...] = (Reason("starting"),)
    pairs: int = 0
    more: bool = False
    notes: tuple[str, ...] = ()
    counts: Mapping[str, object] = field(default_factory=dict)
    stamp: int | None = 0

    @property
    def level(self) -> bytes:
        """COLLIDING if a pair is known to, else UNKNOWN with a reason, and FREE without any."""
        if self.pairs:
            return bytes(COLLIDING)
        return bytes(UNKNOWN if self.reasons else FREE)

    def flag(self, unknown_is_collision: bool) -> bool:
        """Return the value of ``in_collision``."""
        return self.pairs > 0 or (bool(self.reasons) and unknown_is_collision)

    @property
    def kind(self) -> tuple[object, ...]:
        """The part whose changes are published immediately; all else waits for the next period."""
        reasons = ((each.code, each.who, each.detail) for each in self.reasons)
        return self.level, self.notes, *reasons

    @property
    def why(self) -> str:
        """What is missing, as a line of text; empty if nothing is."""
        return "; ".join(reason.text for reason in self.reasons)

    @property
    def message(self) -> str:
        """Return the answer as one line of text."""
        parts = [] if self.pairs or self.reasons else ["free"]
        if self.pairs:
            number = f"at least {self.pairs}" if self.more else str(self.pairs)
            parts.append(f"{number} pair{'s collide' if self.pairs > 1 else ' collides'}")
        return "; ".join([*parts, *(reason.text for reason in self.reasons), *self.notes])

    def but(self, *reasons: Reason) -> Answer:
        """Return the same answer with further reasons."""
        first = {reason.code: reason for reason in (*reasons, *self.reasons)}
        found = sorted(first.values(), key=lambda reason: _ORDER[reason.code])
        return replace(self, reasons=tuple(found))

    def to_ros(self, name: str, now: int, unknown_is_collision: bool) -> DiagnosticStatus:
        """Return the status; ``now`` is the time (ns)."""
        age = {}
        if self.stamp is not None:
            seconds = f"{(now - self.stamp) / NANOSECONDS:.3f}"
            age["age of the newest state (s)"] = seconds if self.stamp else "never"
        first = self.reasons[0] if self.reasons else Reason("")
        values: list[tuple[str, object]] = [
            ("reason", first.code),
            ("who", first.whom),
            ("reasons", " ".join(reason.code for reason in self.reasons)),
            ("colliding pairs at least" if self.more else "colliding pairs", self.pairs),
            *age.items(),
            *self.counts.items(),
            ("in_collision", self.flag(unknown_is_collision)),
            ("unknown_is_collision", unknown_is_collision),
        ]
        return make_status(name, self.level, self.message, values)


def make_status(
    name: str,
    level: bytes,
    message: str,
    values: Iterable[tuple[str, object]],
    hardware_id: str = "obb_collision",
) -> DiagnosticStatus:
    """Return a status, by default one of the node."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values]
    return DiagnosticStatus(
        level=level, name=name, message=message, hardware_id=hardware_id, values=pairs
    )


def some(names: Iterable[str], count: int, at_least: bool = False) -> str:
    """Return the first names, and how many more there are of ``count``, or of at least so many."""
    shown = list(islice(names, MAX_NAMED))
    more = count - len(shown)
    least = "at least " if at_least else ""
    return ", ".join(shown) + (f" and {least}{more} more" if more > 0 else "")
