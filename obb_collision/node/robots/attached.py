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

"""Objects attached to links: their markers are locked to the frame of a link.

They are objects like all others, placed in each cycle where their link is; in checks of states of
the robot they are a part of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from obb_collision.geometry.poses import compose_poses
from obb_collision.node.messages.conversions import pose_faults
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.frames import LINK_NOT_KNOWN, FrameSource
from obb_collision.node.objects.objects import Objects
from obb_collision.node.robots.links import AttachedObjects
from obb_collision.node.robots.robot_input import RobotInput
from obb_collision.typing import Floats, Rows


class LinkFrames:
    """The frames of links, by joint states: ``ROBOT/LINK``, or LINK where one robot alone has it.

    inner: all other frames, and all frames at stamps. The frame in which a robot stands is of
    those, whatever its name.
    """

    def __init__(self, inner: FrameSource, fixed_frame: str, names: Sequence[str]) -> None:
        self._inner, self._fixed_frame, self._names = inner, fixed_frame, names
        self.waits, self.description = inner.waits, inner.description
        self.robots: Sequence[RobotInput] = ()

    def find(self, frame: str) -> tuple[RobotInput, int] | None:
        """Return the robot and the row of the link that a frame is of, None for another frame."""
        name, slash, link = frame.partition("/")
        own = slash and name in self._names
        found = [
            (robot, row)
            for robot in self.robots
            if robot.links is not None and (robot.name == name or not own)
            for row in [robot.links.rows.get(link if own else frame)]
            if row is not None
        ]
        if len(found) != 1 or any(robot.stands_in == frame for robot in self.robots):
            return None
        return found[0]

    def lookup(self, frame: str, stamp: int) -> Floats:
        """Return the pose (7,) of a frame; RefusedError also while joints are not known."""
        found = self.find(frame) if stamp == 0 else None
        if found is None:
            return self._other(frame, stamp)
        robot, row = found
        if robot.fault:
            raise RefusedError(LINK_NOT_KNOWN, f"{frame!r}: {robot.fault}")
        return compose_poses(self.base(robot), robot.link_poses[row])

    def _other(self, frame: str, stamp: int) -> Floats:
        try:
            return self._inner.lookup(frame, stamp)
        except RefusedError as error:
            name, slash, _ = frame.partition("/")
            robots = [robot for robot in self.robots if robot.links is None and robot.name == name]
            if slash and robots:
                raise RefusedError(LINK_NOT_KNOWN, f"{frame!r}: {robots[0].fault}") from error
            raise

    def base(self, robot: RobotInput) -> Floats:
        """Return where the root link is (7,), in the fixed frame; RefusedError if not known."""
        if robot.where is None:
            raise RefusedError(LINK_NOT_KNOWN, f"robot {robot.name}: no base")
        pose, frame = robot.where
        if frame in ("", self._fixed_frame):
            return pose
        found = self._inner.lookup(frame, 0)
        if any(fault.any() for fault in pose_faults(found[None])):
            raise RefusedError(LINK_NOT_KNOWN, f"robot {robot.name}: bad pose of its base")
        return compose_poses(found, pose)


def find_attached(objects: Objects, frames: LinkFrames) -> dict[str, AttachedObjects]:
    """Return what is attached to the links of each robot, by its name."""
    table = objects.table
    slots = np.flatnonzero(table.live & table.locked)
    found: dict[str, list[tuple[Rows, int]]] = {}
    for index in np.unique(table.frame[slots]).tolist():
        link = frames.find(objects.placement.frame_table.name(index))
        if link is not None:
            some = slots[table.frame[slots] == index]
            found.setdefault(link[0].name, []).append((some, link[1]))
    return {
        name: AttachedObjects(
            np.concatenate([some for some, _ in parts]),
            np.concatenate([np.full(len(some), row) for some, row in parts]),
        )
        for name, parts in found.items()
    }
