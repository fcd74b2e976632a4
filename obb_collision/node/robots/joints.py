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

"""The joints of a robot: the latest value of each, by whichever message it came.

A message that is refused leaves the joints that it names unknown until their next accepted value.
Where no velocity comes with a value, it is the difference to the value before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from obb_collision.node.diagnostics.answer import first_names
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs.inputs import LENGTHS_DIFFER
from obb_collision.node.messages.cdr import Header, Reader
from obb_collision.node.messages.conversions import LARGEST_COORDINATE, NANOSECONDS, stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import shortened
from obb_collision.node.objects.states import AHEAD, OLDER, States
from obb_collision.node.objects.table import NO_TIME
from obb_collision.robots.robot import Robot
from obb_collision.typing import Floats, Mask, Rows

BAD_POSITION, BAD_VELOCITY = "bad position", "bad velocity"
UNKNOWN_JOINT, REPEATED_JOINT = "unknown joint", "repeated joint"


class JointMessage(NamedTuple):
    """A sensor_msgs/JointState; positions (n,), velocities (m,); fault: why the rest is unreadable.

    The names are readable then, and say which joints the message was about.
    """

    header: Header
    names: list[str]
    positions: Floats
    velocities: Floats
    fault: RefusedError | None = None


def joints_from_bytes(data: bytes) -> JointMessage:
    """Return the joints in a serialised JointState; RefusedError if their names are unreadable."""
    reader = Reader(data, JointState)
    header, names = reader.header(), reader.texts()
    try:
        positions, velocities, _ = (reader.doubles(reader.count(8), 1)[:, 0] for _ in range(3))
        reader.end()
    except RefusedError as error:
        return JointMessage(header, names, np.empty(0), np.empty(0), error)
    return JointMessage(header, names, positions, velocities)


def text_from_bytes(data: bytes) -> str:
    """Return the text in a serialised String; RefusedError ("malformed message")."""
    reader = Reader(data, String)
    text = reader.text()
    reader.end()
    return text


class Timestamps:
    """When the latest values of n things came.

    known: which have one; repeated: which had one before; bad: those whose latest one could not be
    used; since: when they were true (ns), by which they age; overdue: when it is no more a late one
    that came last (ns).
    """

    def __init__(self, count: int, states: States) -> None:
        self._states = states
        self.known, self.bad, self.repeated = (np.zeros(count, np.bool_) for _ in range(3))
        self.stamps, self.received, self.since = (np.zeros(count, np.int64) for _ in range(3))
        self.overdue = np.full(count, NO_TIME)

    def find_late(self, rows: Rows, stamp: int, now: int) -> Mask:
        """Return which values come late: soon after newer ones, or their sender has restarted."""
        order_timeout = self._states.order_timeout
        late: Mask = (self.stamps[rows] > stamp) & (stamp != 0)
        late &= now - self.received[rows] <= order_timeout
        self.overdue[rows[late]] = self.received[rows[late]] + order_timeout // 2
        return late

    def note(self, rows: Rows, stamp: int, now: int) -> None:
        """Note values that can be used."""
        self.repeated[rows] |= self.known[rows]
        self.known[rows], self.bad[rows], self.received[rows] = True, False, now
        self.stamps[rows], self.overdue[rows] = stamp, NO_TIME
        self.since[rows] = self._states.since(stamp, now)

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self.received += shift
        self.since += shift
        self.stamps[:] = 0
        self.overdue[:] = NO_TIME  # stamps may restart


class Joints(Timestamps):
    """The values of ``robot.joint_names``.

    unclear: joints without a known velocity, which is zero then; senders: of the values.
    """

    def __init__(self, robot: Robot, monitor: InputMonitor, states: States) -> None:
        self._monitor = monitor
        self.names = robot.joint_names
        self._rows = {name: row for row, name in enumerate(self.names)}
        self._others = {joint.name for joint in robot.joints} - set(self.names)
        count = len(self.names)
        super().__init__(count, states)
        self.positions, self.velocities = np.zeros(count), np.zeros(count)
        self.unclear, self.senders = np.zeros(count, np.bool_), np.zeros(count, np.int64)
        # of the last state with another stamp, 0 where there is none
        self._before, self._stamps_before = np.zeros(count), np.zeros(count, np.int64)
        limits = robot.velocity_limits
        self.speed_limits = np.where(limits > 0.0, limits, np.inf)
        """How fast joints can be at most, infinite where the description does not say."""

    def store_values(self, message: JointMessage, now: int) -> None:
        """Store the values of a message; one that is refused whole makes its joints bad.

        Faults of single joints are counted. Joints that mimic others are not needed.
        """
        monitor, states = self._monitor, self._states
        rows = np.array([self._rows.get(name, -1) for name in message.names], np.int64)
        try:
            stamp = self._checked_stamp(message, rows)
        except RefusedError as error:
            self.bad[rows[rows >= 0]] = True
            monitor.refuse(error.reason, "whole message", error.detail)
            if not message.names:
                monitor.mark_unreadable(error.reason)
            return
        strange = [
            name
            for name, row in zip(message.names, rows.tolist(), strict=True)
            if row < 0 and name not in self._others
        ]
        if strange:
            monitor.doubt(UNKNOWN_JOINT, repr(shortened(strange[0])), count=len(strange))
        items = np.flatnonzero(rows >= 0)
        late = self.find_late(rows[items], stamp, now)
        monitor.refuse_rows(late, OLDER)
        items = items[~late]
        finite = np.abs(message.positions[items]) <= LARGEST_COORDINATE
        bad = items[~finite]
        if len(bad):
            self.bad[rows[bad]] = True
            name, value = repr(shortened(message.names[bad[0]])), message.positions[bad[0]]
            monitor.refuse(BAD_POSITION, name, f"{value}", count=len(bad))
        items = items[finite]
        believed = stamp <= now + states.stamp_tolerance
        if not believed:
            monitor.doubt(AHEAD, detail=f"{(stamp - now) / NANOSECONDS:.1f} s ahead")
        stamp = stamp if believed else 0
        kept, positions = rows[items], message.positions[items]
        others = kept[self.stamps[kept] != stamp]  # for differences: values of another stamp
        self._before[others] = self.positions[others]
        self._stamps_before[others] = self.stamps[others]
        velocities = self._velocities(message, items)
        lacking = np.isnan(velocities)
        velocities[lacking] = self._differences(kept, positions, stamp)[lacking]
        self.unclear[kept] = unclear = np.isnan(velocities)
        self.positions[kept], self.velocities[kept] = positions, np.where(unclear, 0.0, velocities)
        self.note(kept, stamp, now)
        self.senders[kept] = monitor.sender

    def _checked_stamp(self, message: JointMessage, rows: Rows) -> int:
        """Return the stamp (ns); RefusedError for a message that is refused whole."""
        if message.fault is not None:
            raise message.fault
        if len(message.positions) != len(rows):
            detail = f"{len(rows)} names, {len(message.positions)} positions"
            raise RefusedError(LENGTHS_DIFFER, detail)
        repeated = np.bincount(rows[rows >= 0], minlength=len(self.names)) > 1
        if repeated.any():  # which of its values counts?
            raise RefusedError(REPEATED_JOINT, repr(self.names[int(np.argmax(repeated))]))
        return stamp_from_ros(message.header.stamp)

    def _differences(self, rows: Rows, positions: Floats, stamp: int) -> Floats:
        """Return the velocities (n,) that lead to positions (n,) from the states before.

        NaN without two stamps that a sender has given one soon after the other.
        """
        time, before = stamp - self._stamps_before[rows], self._stamps_before[rows]
        usable = (stamp > 0) & (before > 0) & (time > 0) & (time <= self._states.order_timeout)
        velocities = (positions - self._before[rows]) / np.where(usable, time, 1) * NANOSECONDS
        return np.where(usable & (np.abs(velocities) <= LARGEST_COORDINATE), velocities, np.nan)

    def _velocities(self, message: JointMessage, items: Rows) -> Floats:
        """Return the velocities of items, NaN where none can be used."""
        nothing = np.full(len(items), np.nan)
        if len(message.velocities) == 0:
            return nothing
        if len(message.velocities) != len(message.names):
            detail = f"{len(message.velocities)} velocities, {len(message.names)} names"
            self._monitor.refuse(LENGTHS_DIFFER, "velocity", f"{detail}; positions used")
            return nothing
        velocities = message.velocities[items]
        bad = ~(np.abs(velocities) <= LARGEST_COORDINATE)
        odd = bad & ~np.isnan(velocities)  # joint_state_broadcaster sends NaN where it has none
        self._monitor.refuse_rows(
            odd,
            BAD_VELOCITY,
            lambda row: repr(shortened(message.names[items[row]])),
            "position used",
        )
        return np.where(bad, np.nan, velocities)

    def rows_of(self, names: list[str], may_follow: bool = False) -> list[int]:
        """Return the row of each joint, or -1 for a joint that follows another (``may_follow``).

        RefusedError for one that is unknown, or there twice.
        """
        if len(set(names)) < len(names):
            raise RefusedError(REPEATED_JOINT)
        for name in names:
            if name not in self._rows and not (may_follow and name in self._others):
                raise RefusedError(UNKNOWN_JOINT, repr(shortened(name)))
        return [self._rows.get(name, -1) for name in names]

    @property
    def stamp(self) -> int:
        """The newest stamp of a joint (ns), 0 for none."""
        return int(self.stamps.max(initial=0))

    @property
    def newest(self) -> int:
        """When the last message came (ns)."""
        return int(self.received.max(initial=0))

    def fault(self, now: int, timeout: float) -> str:
        """Return why the joints are not known, "" if they are; timeout (s): 0 for none."""
        old = self.known & (timeout > 0.0) & (now - self.since > timeout * NANOSECONDS)
        for rows, what in (
            (~self.known, "joints without a state"),
            (self.bad, "joints whose state was refused"),
            (self.overdue < now, "joints whose states have older stamps"),
            (old, "joints with a stale state"),
        ):
            if rows.any():
                names = [self.names[row] for row in np.flatnonzero(rows)]
                return f"{what}: {first_names(names, len(names))}"
        return ""

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        super().clock_jumped(shift)
        self._stamps_before[:] = 0
