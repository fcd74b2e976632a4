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

"""Which states of a robot are valid: ``states_to_check`` in, ``state_validity`` out.

States are checked as they come, in the scene as the last cycle has left it. Whatever is not known
makes them invalid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import monotonic

import numpy as np
from rclpy.publisher import Publisher

from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.cdr import CloudMessage, cloud_from_bytes
from obb_collision.node.messages.clouds import (
    cloud_from_ros,
    cloud_to_bytes,
    field_bytes,
)
from obb_collision.node.messages.conversions import LARGEST_COORDINATE, stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import namespace_number, shortened
from obb_collision.node.objects.objects import Objects
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.robots.checked_robot import CheckedRobot
from obb_collision.robots.checks.reports import StateReport
from obb_collision.robots.checks.robot_scene import RobotScene
from obb_collision.typing import Floats, Rows

TOO_SLOW = "checking took too long"
VALID, COLLIDES, OUT_OF_LIMITS, BAD_STATE, NOT_KNOWN = range(5)
"""Reasons in ``state_validity``."""
ROWS = np.dtype(
    [
        ("distance", "<f8"),
        ("index", "<u4"),
        *((name, "<i4") for name in ("ns_a", "id_a", "ns_b", "id_b")),
        *((name, "u1") for name in ("valid", "reason")),
    ],
    align=True,
)
FIELDS = field_bytes(ROWS)
MAX_STATES = 100_000
"""States of a message: the answer has 3.2 MB then, and takes 20 ms without any check."""
LONGEST_CHECK, QUICK, FEW = 0.2, 0.02, 4
"""Seconds after which the states of a message that are left are not checked: no cycle runs
meanwhile. A few are checked at a time, and more after what was quick."""


class Validity:
    """Answers the states to check of one robot."""

    def __init__(
        self,
        checked: CheckedRobot,
        objects: Objects,
        publisher: Publisher,
        monitor: InputMonitor,
        clock: Callable[[], int],
        parameters: Parameters,
    ) -> None:
        self._checked, self._table = checked, objects.table
        self._publisher, self._monitor = publisher, monitor
        self._clock, self._parameters = clock, parameters

    def take(self, data: bytes) -> None:
        """Answer a message; one that cannot be read has no answer, and is counted."""
        now, monitor = self._clock(), self._monitor
        monitor.received(now)
        try:
            message = cloud_from_bytes(data)
            stamp = stamp_from_ros(message.header.stamp)
            count = _count(message, min(self._parameters.max_cloud_points, MAX_STATES))
        except RefusedError as error:
            monitor.refuse(now, error.reason, "whole message", error.detail)
            return
        rows = np.zeros(count, ROWS)
        rows["index"], rows["reason"], rows["distance"] = np.arange(count), NOT_KNOWN, np.nan
        try:
            self._fill(rows, message)
        except RefusedError as error:
            monitor.refuse(now, error.reason, "whole message", error.detail)
        except Exception:
            self._publish(rows, stamp)  # nothing is known: what failed is counted
            raise
        self._publish(rows, stamp)

    def _publish(self, rows: np.ndarray, stamp: int) -> None:
        frame = self._parameters.fixed_frame
        self._publisher.publish(cloud_to_bytes(rows, stamp, frame, FIELDS))

    def _fill(self, rows: np.ndarray, message: CloudMessage) -> None:
        """Write what is known of the states; RefusedError where that is not all of it."""
        begin, size, start = monotonic(), FEW, 0
        scene = self._checked.scene()
        states = _states(message, self._checked.robot.joint_names, len(rows))
        bad = ~(np.abs(states) <= LARGEST_COORDINATE).all(axis=1)
        good = np.flatnonzero(~bad)
        rows["reason"][bad] = BAD_STATE
        while start < len(good):
            before = monotonic()
            if before - begin > LONGEST_CHECK:
                detail = f"{start} of {len(good)} were checked in {LONGEST_CHECK:g} s, the limit"
                raise RefusedError(TOO_SLOW, detail)
            some = good[start : start + size]
            rows[some] = self._checked_rows(rows[some], scene, states[some])
            start += size
            size = 2 * size if monotonic() - before < QUICK else max(size // 2, FEW)

    def _checked_rows(self, rows: np.ndarray, scene: RobotScene, states: Floats) -> np.ndarray:
        """Return the rows of states with what is known of them."""
        try:
            report = scene.check(states)
        except ValueError as error:
            detail = f"from row {rows['index'][0]} on: {error}"
            raise RefusedError("bad state", detail) from error
        ids = self._keys(report, len(scene.link_names))
        for column, name in enumerate(("ns_a", "id_a", "ns_b", "id_b")):
            rows[name] = ids[:, column]
        distance = self._parameters.state_validity_distance
        if distance > 0.0:
            rows["distance"] = scene.distances(states, max_distance=distance).distances
        reasons = np.where(report.out_of_limits.any(axis=1), OUT_OF_LIMITS, VALID)
        rows["reason"] = np.where(report.colliding, COLLIDES, reasons)
        rows["valid"] = rows["reason"] == VALID
        return rows

    def _keys(self, report: StateReport, links: int) -> Rows:
        """Return the keys (n, 4) of the first pairs: namespace number and id, 0 where is none."""
        keys = np.zeros((len(report.names) + 1, 2), np.int64)
        for row in np.unique(report.first_pairs).tolist():
            if 0 <= row < links:
                keys[row] = namespace_number(report.names[row]), 0
            elif row >= links:
                (slot,) = self._table.find_named([report.names[row]])
                keys[row] = self._table.ns[slot], self._table.id[slot]
        found: Rows = keys[report.first_pairs].reshape(-1, 4)
        return found


def _count(message: CloudMessage, most: int) -> int:
    """Return the number of states; RefusedError for one that the data contradict."""
    return len(cloud_from_ros(message, (), most))


def _states(message: CloudMessage, names: Iterable[str], count: int) -> Floats:
    """Return states (n, joints); RefusedError unless there is a double for each joint only."""
    names = list(names)
    given = [field.name for field in message.fields]
    known, there = set(names), set(given)
    for what, found in (
        ("unknown joint", [name for name in given if name not in known]),
        ("missing joint", [name for name in names if name not in there]),
    ):
        if found:
            raise RefusedError(what, repr(shortened(found[0])))
    rows = cloud_from_ros(message, known)
    states = np.empty((count, len(names)))
    for column, name in enumerate(names):
        if rows.dtype[name].kind != "f" or rows.dtype[name].itemsize != 8:
            raise RefusedError("field layout", f"field {name!r} is no float64")
        states[:, column] = rows[name]
    return states
