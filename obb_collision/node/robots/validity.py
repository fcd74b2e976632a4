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

"""Answers about states of a robot: by topic, and by MoveIt's service.

``states_to_check`` in, ``state_validity`` out; GetStateValidity, where moveit_msgs is installed.
States are checked as they come, in the scene as the last cycle has left it. Whatever is not known
makes them invalid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import monotonic
from typing import Any

import numpy as np
from rclpy.publisher import Publisher

from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs.inputs import LENGTHS_DIFFER
from obb_collision.node.messages.cdr import CloudMessage, cloud_from_bytes
from obb_collision.node.messages.clouds import (
    cloud_from_ros,
    cloud_to_bytes,
    field_bytes,
)
from obb_collision.node.messages.conversions import (
    LARGEST_COORDINATE,
    stamp_from_ros,
    stamp_to_ros,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import namespace_number, shortened
from obb_collision.node.messages.optional import optional
from obb_collision.node.robots.checked_robot import CheckedRobot, portions
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.robots.checks.reports import MotionReport, StateDistances, StateReport
from obb_collision.robots.robot_scene import RobotScene
from obb_collision.typing import Floats, Rows

TOO_SLOW = "checking took too long"
VALID, COLLIDES, OUT_OF_LIMITS, BAD_STATE, NOT_KNOWN = range(5)
"""Reasons in ``state_validity``."""


def _layout(first: str) -> np.dtype[np.void]:
    numbers = [(name, "<i4") for name in ("ns_a", "id_a", "ns_b", "id_b")]
    flags = [(name, "u1") for name in ("valid", "reason")]
    return np.dtype([(first, "<f8"), ("index", "<u4"), *numbers, *flags], align=True)


ROWS, PATH_ROWS = _layout("distance"), _layout("fraction")
MEANINGS = {
    "distance": "Distance of the nearest pair (m), negative: depth. NaN without "
    "state_validity_distance; infinite beyond it.",
    "index": "Row of the state in the message.",
    "ns_a id_a ns_b id_b": "The colliding pair; links have id 0.",
    "valid": "1: within limits and certainly free.",
    "reason": "0 valid; 1 collides; 2 a joint out of its limits; 3 not finite; 4 collisions "
    "unknown.",
}
PATH_MEANINGS = {
    "fraction": "path_validity has it in place of the distance: the first bad motion is certainly "
    "free up to there, from 0 to 1; NaN unless it collides.",
    "index": "In path_validity: row of the state at which the first bad motion begins.",
}
"""Of the fields, for docs/topics.md."""
MAX_STATES = 100_000
"""States of a message: the answer has 3.2 MB then, and takes 20 ms without any check."""
LONGEST_CHECK, QUICK = 0.2, 0.02
"""Seconds after which the states of a message that are left are not checked, as no cycle runs
meanwhile; and of a portion of them that is quick."""


class ValidityTopics:
    """Answers the states and paths to check of one robot, each by a publisher."""

    def __init__(self, checked: CheckedRobot, states: Publisher, paths: Publisher) -> None:
        self._checked, self._of_states, self._of_paths = checked, states, paths
        self._parameters = checked.parameters

    def answer(self, data: bytes, now: int) -> None:
        """Answer a message of states, a row for each.

        RefusedError, without an answer, for one that cannot be read.
        """
        self._answer(data, ROWS, self._fill, self._of_states)

    def answer_path(self, data: bytes, now: int) -> None:
        """Answer a message whose states are a path, by one row, as ``answer`` does."""
        self._answer(data, PATH_ROWS, self._fill_path, self._of_paths)

    def _answer(
        self,
        data: bytes,
        layout: np.dtype[np.void],
        fill: Callable[[np.ndarray, CloudMessage, int], None],
        publisher: Publisher,
    ) -> None:
        message = cloud_from_bytes(data)
        stamp = stamp_from_ros(message.header.stamp)
        most = min(self._parameters.max_cloud_points, MAX_STATES)
        count = len(cloud_from_ros(message, (), most))
        rows = np.zeros(count if layout is ROWS else 1, layout)
        rows["index"], rows["reason"] = np.arange(len(rows)), NOT_KNOWN
        rows[(layout.names or ())[0]] = np.nan
        try:
            fill(rows, message, count)
        finally:  # unknown rows are published, too, before the reason is counted
            frame = self._parameters.fixed_frame
            publisher.publish(cloud_to_bytes(rows, stamp, frame, field_bytes(layout)))

    def _fill_path(self, rows: np.ndarray, message: CloudMessage, count: int) -> None:
        """Fill in the row of a path: its first bad motion; RefusedError where it is unknown."""
        begin = monotonic()
        scene = self._checked.scene()
        path = _states(message, self._checked.robot.joint_names, count)
        bad = np.flatnonzero(~(np.abs(path) <= LARGEST_COORDINATE).all(axis=1))
        if len(bad) or count == 0:
            rows["reason"], rows["index"] = BAD_STATE, bad[:1].sum()
            return
        for part in portions(max(count - 1, 1), QUICK):
            _limit(begin, part.start, "motions")
            states = path[part.start : part.stop + 1]
            try:
                report = scene.check_path(states)
                number = report.first_invalid
                if number is None:
                    continue
                report = scene.check_path(states[number : number + 2], first=True)
            except ValueError as error:
                raise RefusedError("bad state", str(error)) from error
            rows["index"], collides = part.start + number, bool(report.colliding[0])
            rows["reason"] = COLLIDES if collides else OUT_OF_LIMITS
            rows["fraction"] = report.fractions[0]
            ids = self._keys(report, len(scene.link_names))
            for column, name in enumerate(("ns_a", "id_a", "ns_b", "id_b")):
                rows[name] = ids[:, column]
            return
        rows["reason"], rows["valid"] = VALID, True

    def _fill(self, rows: np.ndarray, message: CloudMessage, count: int) -> None:
        """Fill in the rows of states; RefusedError where some stay unknown."""
        begin = monotonic()
        scene = self._checked.scene()
        states = _states(message, self._checked.robot.joint_names, count)
        bad = ~(np.abs(states) <= LARGEST_COORDINATE).all(axis=1)
        good = np.flatnonzero(~bad)
        rows["reason"][bad] = BAD_STATE
        for part in portions(len(good), QUICK):
            _limit(begin, part.start, f"of {len(good)} states")
            rows[good[part]] = self._checked_rows(rows[good[part]], scene, states[good[part]])

    def _checked_rows(self, rows: np.ndarray, scene: RobotScene, states: Floats) -> np.ndarray:
        """Return the rows of states, checked."""
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

    def _keys(self, report: StateReport | MotionReport, links: int) -> Rows:
        """Return the keys (n, 4) of the first pairs: namespace number and id, 0 where is none."""
        table = self._checked.objects.table
        keys = np.zeros((len(report.names) + 1, 2), np.int64)
        for row in np.unique(report.first_pairs[report.first_pairs >= 0]).tolist():
            if row < links:
                keys[row] = namespace_number(report.names[row]), 0
            else:
                (slot,) = table.find_named([report.names[row]])
                keys[row] = table.ns[slot], table.id[slot]
        keys_of_pairs: Rows = keys[report.first_pairs].reshape(-1, 4)
        return keys_of_pairs


def _limit(begin: float, done: int, things: str) -> None:
    """Raise RefusedError if a check that began takes too long."""
    if monotonic() - begin > LONGEST_CHECK:
        detail = f"{done} {things} were checked in {LONGEST_CHECK:g} s, the limit"
        raise RefusedError(TOO_SLOW, detail)


def _states(message: CloudMessage, names: Iterable[str], count: int) -> Floats:
    """Return states (n, joints); RefusedError unless there is a double for each joint only."""
    names = list(names)
    fields = [field.name for field in message.fields]
    joints, present = set(names), set(fields)
    for what, wrong in (
        ("unknown joint", [name for name in fields if name not in joints]),
        ("missing joint", [name for name in names if name not in present]),
    ):
        if wrong:
            raise RefusedError(what, repr(shortened(wrong[0])))
    rows = cloud_from_ros(message, joints)
    states = np.empty((count, len(names)))
    for column, name in enumerate(names):
        if rows.dtype[name].kind != "f" or rows.dtype[name].itemsize != 8:
            raise RefusedError("field layout", f"field {name!r} is not float64")
        states[:, column] = rows[name]
    return states


ContactInformation: Any = optional("moveit_msgs.msg", "ContactInformation")
ServiceType: Any = ContactInformation and optional("moveit_msgs.srv", "GetStateValidity")
"""None where moveit_msgs cannot be used."""

SERVICE = "check_state_validity"
"""Its name, after that of the robot; move_group has it by the same name."""
ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = range(3)
"""Types of bodies in ContactInformation."""
SEARCH_DISTANCE = 1e-9
"""Metres: pairs that are farther apart are not looked at for the deepest one."""
NOT_EVALUATED = "not evaluated"
MAX_CONTACTS = 1000
"""Contacts of an answer: one takes 20 us, and 1,000 links in a heap have 500,000."""


class StateService:
    """Answers MoveIt's service for one robot. contact: makes a ContactInformation."""

    def __init__(
        self,
        checked: CheckedRobot,
        monitor: InputMonitor,
        contact: Callable[[], Any] = ContactInformation,
    ) -> None:
        self._checked, self._monitor, self._contact = checked, monitor, contact

    def answer(self, request: Any, response: Any) -> Any:
        """Fill in the response; why a state is not looked at is counted, and logged."""
        response.valid = False
        try:
            self._answer(request, response)
        except RefusedError as error:
            self._monitor.refuse(error.reason, SERVICE, error.detail)
        except Exception as error:
            response.valid = False
            self._monitor.refuse(INTERNAL_ERROR, SERVICE, str(error))
        return response

    def _answer(self, request: Any, response: Any) -> None:
        scene = self._checked.scene()
        state = self._state(request.robot_state)
        group = self._group(request.group_name)
        constraints = request.constraints
        fields = "joint", "position", "orientation", "visibility"
        if any(len(getattr(constraints, f"{name}_constraints")) for name in fields):
            raise RefusedError(NOT_EVALUATED, "constraints")
        try:
            report = scene.check(state, all_pairs=True)
        except ValueError as error:
            raise RefusedError("bad state", str(error)) from error
        links = group | {n for n, at in scene.attached.items() if at in group}
        pairs = [pair for pair in report.pairs_of(0) if links & set(pair)]
        deepest = (
            scene.distances(state, max_distance=SEARCH_DISTANCE, still_pairs=True)
            if pairs
            else None
        )
        response.contacts = [
            self._contact_of(scene, pair, deepest) for pair in pairs[:MAX_CONTACTS]
        ]
        response.valid = not pairs and not report.out_of_limits.any()

    def _state(self, state: Any) -> Floats:
        """Return the state (1, joints); a joint that is missing is as now, as for MoveIt."""
        joints, message = self._checked.joints, state.joint_state
        several = state.multi_dof_joint_state
        if len(several.joint_names) or len(several.transforms):  # these may be there without names
            raise RefusedError(NOT_EVALUATED, "multi_dof_joint_state")
        if len(state.attached_collision_objects):
            raise RefusedError(NOT_EVALUATED, "attached_collision_objects")
        names, positions = list(message.name), np.array(message.position, np.float64)
        if len(names) != len(positions):
            raise RefusedError(LENGTHS_DIFFER, f"{len(names)} names, {len(positions)} positions")
        if not (np.abs(positions) <= LARGEST_COORDINATE).all():
            raise RefusedError("bad state", "not finite or too large")
        rows = np.array(joints.rows_of(names, may_follow=True), np.int64)
        state = joints.positions.copy()
        state[rows[rows >= 0]] = positions[rows >= 0]
        return state[None]

    def _group(self, name: str) -> frozenset[str]:
        """Return the links that a group moves, and its own; all without a name."""
        robot = self._checked.robot
        if not name:
            return self._prefixed(robot.link_names)
        group = robot.groups.get(name)
        if group is None:
            raise RefusedError("unknown group", repr(shortened(name)))
        moved = set(group.links)
        for joint in robot.joints:  # those of parents first
            if joint.name in group.joints or joint.parent in moved:
                moved.add(joint.child)
        return self._prefixed(moved)

    def _prefixed(self, links: Any) -> frozenset[str]:
        return frozenset(f"{self._checked.input.name}/{link}" for link in links)

    def _contact_of(
        self, scene: RobotScene, pair: tuple[str, str], deepest: StateDistances | None
    ) -> Any:
        """Return the contact of a pair; place and depth are those of the deepest pair only."""
        contact = self._contact()
        contact.header.frame_id = self._checked.parameters.fixed_frame
        contact.header.stamp = stamp_to_ros(self._checked.clock())
        place, normal, depth = np.full(3, np.nan), np.full(3, np.nan), np.nan
        if deepest is not None and deepest.pairs[0] == pair:
            place, normal = deepest.points[0].mean(axis=0), deepest.directions[0]
            depth = max(-float(deepest.distances[0]), 0.0)
        for field, values in ((contact.position, place), (contact.normal, normal)):
            field.x, field.y, field.z = values.tolist()
        contact.depth = depth
        own = f"{self._checked.input.name}/"
        for number, name in enumerate(pair, start=1):
            is_link = name in scene.link_names
            kind = ROBOT_ATTACHED if name in scene.attached else WORLD_OBJECT
            setattr(contact, f"contact_body_{number}", name.removeprefix(own) if is_link else name)
            setattr(contact, f"body_type_{number}", ROBOT_LINK if is_link else kind)
        return contact
