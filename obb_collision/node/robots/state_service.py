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

"""MoveIt's service GetStateValidity, where moveit_msgs is installed.

What cannot be decided here makes a state invalid: constraints, joints that the robot does not have,
a scene that is not known.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.conversions import (
    LARGEST_COORDINATE,
    stamp_to_ros,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import shortened
from obb_collision.node.messages.optional import optional_type
from obb_collision.node.robots.checked_robot import CheckedRobot
from obb_collision.node.robots.joints import LENGTHS_DIFFER, UNKNOWN_JOINT
from obb_collision.node.robots.robot_input import RobotInput
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.robots.checks.reports import StateDistances, StateReport
from obb_collision.robots.checks.robot_scene import RobotScene
from obb_collision.typing import Floats

ContactInformation: Any = optional_type("moveit_msgs.msg", "ContactInformation")
ServiceType: Any = ContactInformation and optional_type("moveit_msgs.srv", "GetStateValidity")
"""None where moveit_msgs cannot be used."""

SERVICE = "check_state_validity"
"""Its name, after that of the robot; move_group has it by the same name."""
ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = range(3)
"""Types of bodies in ContactInformation."""
TOUCHING = 1e-9
"""Metres within which the deepest pair is looked for."""
NOT_EVALUATED = "not evaluated"
MAX_CONTACTS = 1000
"""Contacts of an answer: one takes 20 us, and 1,000 links in a heap have 500,000."""


class StateService:
    """Answers for one robot. contact: makes a ContactInformation; frame: the fixed frame."""

    def __init__(
        self,
        robot: RobotInput,
        checked: CheckedRobot,
        monitor: InputMonitor,
        clock: Callable[[], int],
        frame: str,
        contact: Callable[[], Any] = ContactInformation,
    ) -> None:
        self._robot, self._checked, self._monitor = robot, checked, monitor
        self._clock, self._frame, self._contact = clock, frame, contact

    def answer(self, request: Any, response: Any) -> Any:
        """Fill in the response; why a state is not looked at is counted, and logged."""
        response.valid = False
        try:
            self._answer(request, response)
        except RefusedError as error:
            self._monitor.refuse(self._clock(), error.reason, SERVICE, error.detail)
        except Exception as error:
            response.valid = False
            self._monitor.refuse(self._clock(), INTERNAL_ERROR, SERVICE, str(error))
        return response

    def _answer(self, request: Any, response: Any) -> None:
        scene = self._checked.scene()
        state = self._state(request.robot_state)
        group = self._group(request.group_name)
        given = request.constraints
        fields = "joint", "position", "orientation", "visibility"
        if any(len(getattr(given, f"{name}_constraints")) for name in fields):
            raise RefusedError(NOT_EVALUATED, "constraints")
        try:
            report = scene.check(state, all_pairs=True)
        except ValueError as error:
            raise RefusedError("bad state", str(error)) from error
        links = group | {n for n, at in scene.attached.items() if at in group}
        pairs = [pair for pair in report.pairs_of(0) if links & set(pair)]
        deepest = scene.distances(state, max_distance=TOUCHING) if pairs else None
        response.contacts = [
            self._contact_of(scene, report, pair, deepest) for pair in pairs[:MAX_CONTACTS]
        ]
        response.valid = not pairs and not report.out_of_limits.any()

    def _state(self, given: Any) -> Floats:
        """Return the state (1, joints); what is not given is as it is now, as for MoveIt."""
        joints, message = self._robot.joints, given.joint_state
        assert joints is not None
        several = given.multi_dof_joint_state
        if len(several.joint_names) or len(several.transforms):  # these may be there without names
            raise RefusedError(NOT_EVALUATED, "multi_dof_joint_state")
        if len(given.attached_collision_objects):
            raise RefusedError(NOT_EVALUATED, "attached_collision_objects")
        names, positions = list(message.name), np.array(message.position, np.float64)
        if len(names) != len(positions):
            raise RefusedError(LENGTHS_DIFFER, f"{len(names)} names, {len(positions)} positions")
        if len(set(names)) < len(names):
            raise RefusedError("repeated joint")
        if not (np.abs(positions) <= LARGEST_COORDINATE).all():
            raise RefusedError("bad state", "not finite or too large")
        state = joints.positions.copy()
        for name, value in zip(names, positions.tolist(), strict=True):
            row = joints.row(name)
            if row is None:
                raise RefusedError(UNKNOWN_JOINT, repr(shortened(name)))
            if row >= 0:
                state[row] = value
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
        return frozenset(f"{self._robot.name}/{link}" for link in links)

    def _contact_of(
        self, scene: RobotScene, report: StateReport, pair: tuple[str, str],
        deepest: StateDistances | None,
    ) -> Any:  # fmt: skip
        """Return the contact of a pair; where and how deep is said of the deepest one only."""
        contact = self._contact()
        contact.header.frame_id = self._frame
        contact.header.stamp = stamp_to_ros(self._clock())
        place, normal, depth = np.full(3, np.nan), np.full(3, np.nan), np.nan
        if deepest is not None and deepest.pairs[0] == pair:
            place, normal = deepest.points[0].mean(axis=0), deepest.directions[0]
            depth = max(-float(deepest.distances[0]), 0.0)
        for field, values in ((contact.position, place), (contact.normal, normal)):
            field.x, field.y, field.z = values.tolist()
        contact.depth = depth
        own = f"{self._robot.name}/"
        for number, name in enumerate(pair, start=1):
            is_link = name in scene.link_names
            kind = ROBOT_ATTACHED if name in scene.attached else WORLD_OBJECT
            setattr(contact, f"contact_body_{number}", name.removeprefix(own) if is_link else name)
            setattr(contact, f"body_type_{number}", ROBOT_LINK if is_link else kind)
        return contact
