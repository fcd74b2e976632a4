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
from rclpy.constants import S_TO_NS

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
    "blocked": "blocked: no cycle has ended in time",
    "overload": "overload: states wait too long",
    "clock_stopped": "time from /clock stands still",
    "two_publishers": "several publishers of a topic that may have only one",
    "no_objects": "no objects received (set expect_empty if the scene may be empty)",
    "required_missing": "required objects missing",
    "input_silent": "no message within the time limit",
    "input_unreadable": "the last message could not be read",
    "messages_lost": "messages were lost",
    "unknown_objects": "states of unknown objects",
    "shape_building": "shape being built",
    "unplaced": "objects without a usable pose",
    "refused": "latest state refused, last box kept",
    "late_frame": "transform not received in time",
    "stale": "stale",
    "robot_unknown": "no usable robot description",
    "joint_unknown": "no usable joint states",
    "base_unknown": "no usable pose of the robot base",
    "incomplete": "the check was incomplete",
    "region_silent": "no message from regions",
    "region_gap": "regions do not cover all of space",
    "region_twice": "regions overlap, or have several publishers",
    "region_unmatched": "no stamp was evaluated by all regions",
}
"""The codes in the order in which they are reported, each with what it means."""
REMEDIES = {
    "starting": "Wait: no check has ended yet, or kernels are being compiled.",
    "unconfigured": "Configure and activate the node: autostart is false.",
    "inactive": "Activate the node.",
    "disabled": "Call ~/enable with true.",
    "shutting_down": "The node is shutting down; this is its last message.",
    "internal_error": "Report the error with the log. The code ends with ~/clear or the next "
    "check that passes.",
    "blocked": "No cycle ended within 1 / rate + cycle_timeout. Reduce the load of the machine.",
    "overload": "States wait longer than 1 / rate + cycle_timeout. Send them by object_poses, "
    "lower the rate, or set time_budget.",
    "clock_stopped": "Messages arrive, but the time of /clock does not advance, so nothing ages. "
    "Start the clock, or unset use_sim_time.",
    "two_publishers": "For collision_status: give each node its own name or namespace. For sets "
    "of boxes: merge them in one sender. For sensors: name a source for each. The code ends when "
    "one publisher is left.",
    "no_objects": "Send objects, or a robot for what sensors see. If the scene is empty, set "
    "expect_empty, call ~/clear, send DELETEALL or an empty set, delete the last object, or load a "
    "scene file without objects.",
    "required_missing": "Send the objects of required_objects.",
    "input_silent": "Start the sender: no message arrived within required_inputs, input_timeout or "
    "the timeout of a source.",
    "input_unreadable": "The last message of a sender was damaged or of another type. The code "
    "ends "
    "with a readable message of this sender, when sender and objects are gone, or with ~/clear.",
    "messages_lost": "Send all objects again after a DELETEALL, or call ~/clear. For topics of "
    "poses, a newer pose of every object suffices. To avoid losses, send less often or use a "
    "deeper queue.",
    "unknown_objects": "States name objects that the node does not have. Send these objects again, "
    "or list them in ignored_objects. The code ends a second after the last such state.",
    "shape_building": "Wait: a shape or hull is being built.",
    "unplaced": "Send a pose of the object, or the transform of its frame.",
    "refused": "The latest state was invalid; the object keeps its last box. /diagnostics gives "
    "the reason.",
    "late_frame": "Publish the transform within transform_timeout. Until then the object lags "
    "behind.",
    "stale": "The latest state is older than the age limit, by stamp, receipt or transform. Start "
    "the sender, synchronise clocks (or set judge_ages), or set stale_policy_overrides.",
    "robot_unknown": "Publish a valid ROBOT/robot_description.",
    "joint_unknown": "Publish finite positions of every joint, with stamps within joint_timeout.",
    "base_unknown": "Publish the pose of the robot's base, or its transform: see robot_bases.",
    "incomplete": "Merger: the status message of a region is empty.",
    "region_silent": "Merger: start the named regions, or send all objects to them again.",
    "region_gap": "Merger: set bounds that cover all of space, and run the same version in all "
    "nodes.",
    "region_twice": "Merger: set bounds that do not overlap, and run one node per region.",
    "region_unmatched": "Merger: send states with stamps; no stamp was evaluated by all regions.",
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
        """The objects that the reason is about, as text."""
        return first_names(self.who, max(self.count, len(self.who)), self.more)

    @property
    def text(self) -> str:
        """The reason for people."""
        what = CODES[self.code] + (f", {self.detail}" if self.detail else "")
        return f"{what}: {self.whom}" if self.who else what


@dataclass(frozen=True)
class Answer:
    """The answer whether objects collide.

    reasons: missing evidence for the claim that nothing collides, in the order of ``CODES``. pairs:
    how many collided at the last check, of those whose objects still exist; more: at least so many.
    notes: further texts for people. counts: of objects, by their state. stamp: of the
    newest state evaluated (ns), 0 for none, None where it is unknown.
    """

    reasons: tuple[Reason, ...] = (Reason("starting"),)
    pairs: int = 0
    more: bool = False
    notes: tuple[str, ...] = ()
    counts: Mapping[str, object] = field(default_factory=dict)
    stamp: int | None = 0

    @property
    def level(self) -> bytes:
        """COLLIDING if a pair is known to collide, else UNKNOWN with a reason, FREE without any."""
        if self.pairs:
            return bytes(COLLIDING)
        return bytes(UNKNOWN if self.reasons else FREE)

    def flag(self, unknown_is_collision: bool) -> bool:
        """Return the value of ``in_collision``."""
        return self.pairs > 0 or (bool(self.reasons) and unknown_is_collision)

    @property
    def kind(self) -> tuple[object, ...]:
        """The part whose changes are published immediately; all else waits for the next period."""
        reasons = ((reason.code, reason.who, reason.detail) for reason in self.reasons)
        return self.level, self.notes, *reasons

    @property
    def why(self) -> str:
        """The missing evidence as a line of text; empty if there is none."""
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
        ordered = sorted(first.values(), key=lambda reason: _ORDER[reason.code])
        return replace(self, reasons=tuple(ordered))

    def to_ros(self, name: str, now: int, unknown_is_collision: bool) -> DiagnosticStatus:
        """Return the status; ``now`` is the time (ns)."""
        age = {}
        if self.stamp is not None:
            seconds = f"{(now - self.stamp) / S_TO_NS:.3f}"
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


def first_names(names: Iterable[str], count: int, at_least: bool = False) -> str:
    """Return the first names, and how many of ``count`` follow; at_least: there may be more."""
    shown = list(islice(names, MAX_NAMED))
    more = count - len(shown)
    least = "at least " if at_least else ""
    return ", ".join(shown) + (f" and {least}{more} more" if more > 0 else "")
