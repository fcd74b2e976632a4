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

"""The joints of a robot: the latest value of each, by whichever message it came."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from obb_collision.node.diagnostics.answer import some
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.cdr import Header, Reader
from obb_collision.node.messages.conversions import (
    LARGEST_COORDINATE,
    NANOSECONDS,
    stamp_from_ros,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import shortened
from obb_collision.node.objects.states import AHEAD, OLDER, States
from obb_collision.robots.description.robot import Robot
from obb_collision.typing import Floats, Mask, Rows

LENGTHS_DIFFER = "array lengths differ"
BAD_POSITION, BAD_VELOCITY = "bad position", "bad velocity"
UNKNOWN_JOINT, REPEATED_JOINT = "unknown joint", "repeated joint"


class JointMessage(NamedTuple):
    """A sensor_msgs/JointState; positions (n,), velocities (m,)."""

    header: Header
    names: list[str]
    positions: Floats
    velocities: Floats


def joints_from_bytes(data: bytes) -> JointMessage:
    """Return a serialised JointState; RefusedError ("malformed message")."""
    reader = Reader(data, JointState)
    header, names = reader.header(), reader.texts()
    positions, velocities, _ = (reader.doubles(reader.count(8), 1)[:, 0] for _ in range(3))
    reader.end()
    return JointMessage(header, names, positions, velocities)


def text_from_bytes(data: bytes) -> str:
    """Return a serialised String; RefusedError ("malformed message")."""
    reader = Reader(data, String)
    text = reader.text()
    reader.end()
    return text


class Joints:
    """The values of ``robot.joint_names``, each with when it came.

    known: which joints have a value; bad: those whose latest value could not be used; unclear:
    those whose latest velocity could not be, which is zero then.
    """

    def __init__(self, robot: Robot) -> None:
        self.names = robot.joint_names
        self._rows = {name: row for row, name in enumerate(self.names)}
        self._others = {joint.name for joint in robot.joints} - set(self.names)
        count = len(self.names)
        self.positions, self.velocities = np.zeros(count), np.zeros(count)
        self.known, self.bad = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
        self.unclear = np.zeros(count, np.bool_)
        self._stamps, self._received = np.zeros(count, np.int64), np.zeros(count, np.int64)

    def take(self, message: JointMessage, now: int, monitor: InputMonitor, states: States) -> None:
        """Store the values of a message; RefusedError for one that is refused whole.

        What is wrong with single joints is counted. Joints that mimic others are not needed.
        """
        stamp = stamp_from_ros(message.header.stamp)
        rows = np.array([self._rows.get(name, -1) for name in message.names], np.int64)
        ours = rows[rows >= 0]
        if len(message.positions) != len(rows):
            self.bad[ours] = True
            detail = f"{len(rows)} names, {len(message.positions)} positions"
            raise RefusedError(LENGTHS_DIFFER, detail)
        repeated = np.bincount(ours, minlength=len(self.names)) > 1
        if repeated.any():  # which of its values counts?
            self.bad[ours] = True
            raise RefusedError(REPEATED_JOINT, repr(self.names[int(np.argmax(repeated))]))
        strange = [
            name
            for name, row in zip(message.names, rows.tolist(), strict=True)
            if row < 0 and name not in self._others
        ]
        if strange:
            monitor.doubt(now, UNKNOWN_JOINT, repr(shortened(strange[0])), count=len(strange))
        known = np.flatnonzero(rows >= 0)
        old = self._find_old(rows[known], stamp, now, states.order_timeout)
        if old.any():
            monitor.refuse(now, OLDER, count=int(np.count_nonzero(old)))
            known = known[~old]
        finite = np.abs(message.positions[known]) <= LARGEST_COORDINATE
        self._refuse(message, known[~finite], rows, now, monitor)
        known = known[finite]
        velocities, unclear = self._velocities(message, known, now, monitor)
        kept = rows[known]
        self.unclear[kept] = unclear
        self.positions[kept], self.velocities[kept] = message.positions[known], velocities
        self.known[kept], self.bad[kept], self._received[kept] = True, False, now
        believed = stamp <= now + states.stamp_tolerance
        if not believed:
            monitor.doubt(now, AHEAD, detail=f"{(stamp - now) / NANOSECONDS:.1f} s ahead")
        self._stamps[kept] = stamp if believed else 0

    def _find_old(self, rows: Rows, stamp: int, now: int, order_timeout: int) -> Mask:
        """Return which joints have a newer value, received not so long ago."""
        newer = (self._stamps[rows] > stamp) & (stamp != 0)
        return np.asarray(newer & (now - self._received[rows] <= order_timeout))

    def _refuse(
        self, message: JointMessage, items: Rows, rows: Rows, now: int, monitor: InputMonitor
    ) -> None:
        if len(items):
            self.bad[rows[items]] = True
            value = message.positions[items[0]]
            name = repr(shortened(message.names[items[0]]))
            monitor.refuse(now, BAD_POSITION, name, f"{value}", count=len(items))

    def _velocities(
        self, message: JointMessage, items: Rows, now: int, monitor: InputMonitor
    ) -> tuple[Floats, Mask]:
        """Return the velocities of items, zero where none can be used, and where it could not.

        A message without any is of joints that rest.
        """
        nothing = np.zeros(len(items))
        if len(message.velocities) == 0:
            return nothing, nothing > 0.0
        if len(message.velocities) != len(message.names):
            detail = f"{len(message.velocities)} velocities, {len(message.names)} names"
            monitor.refuse(now, LENGTHS_DIFFER, "velocity", f"{detail}; positions used")
            return nothing, nothing == 0.0
        found = message.velocities[items]
        bad = ~(np.abs(found) <= LARGEST_COORDINATE)
        if bad.any():
            name = repr(shortened(message.names[items[np.argmax(bad)]]))
            count = int(np.count_nonzero(bad))
            monitor.refuse(now, BAD_VELOCITY, name, "position used", count)
        return np.where(bad, 0.0, found), bad

    def row(self, name: str) -> int | None:
        """Return the row of a joint, -1 for one that follows others, None if there is none."""
        return self._rows.get(name, -1 if name in self._others else None)

    @property
    def stamp(self) -> int:
        """The newest stamp of a joint (ns), 0 for none."""
        return int(self._stamps.max(initial=0))

    @property
    def received(self) -> int:
        """When the last message came (ns)."""
        return int(self._received.max(initial=0))

    def fault(self, now: int, timeout: float) -> str:
        """Return why the joints are not known, "" if they are; timeout (s): 0 for none."""
        old = self.known & (timeout > 0.0) & (now - self._received > timeout * NANOSECONDS)
        for rows, what in (
            (~self.known, "joints without a state"),
            (self.bad, "joints whose state was refused"),
            (old, "joints with a stale state"),
        ):
            if rows.any():
                names = [self.names[row] for row in np.flatnonzero(rows)]
                return f"{what}: {some(names, len(names))}"
        return ""

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self._received += shift
        self._stamps[:] = 0
