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

"""A trajectory that was forwarded: what of it is still before the robot, and how to stop it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from obb_collision.node.robots.joints import Joints
from obb_collision.robots.kinematics.splines import Pieces, distances_from
from obb_collision.typing import Floats


@dataclass
class Running:
    """A trajectory that was forwarded: its pieces, and when it began (ns)."""

    pieces: Pieces
    begin: int
    names: list[str]
    joints: Joints
    columns: list[int]
    """The joints that it moves, in the order of the names."""
    present: Floats
    """All joints when it was planned: the others are to stay there."""
    robot: object
    world: tuple[object, ...]
    """What it was certified for, and in."""
    passed: float = -np.inf
    """The time of the trajectory at which the robot was, at least."""

    def find_moved(self, tolerance: float) -> str:
        """Return the name of a joint that was to stay and has not, "" for none."""
        off = np.abs(self.joints.positions - self.present)
        off[self.columns] = 0.0
        return self.joints.names[int(np.argmax(off))] if off.max(initial=0.0) > tolerance else ""

    def advance(self, elapsed: float, tolerance: float) -> None:
        """Note how far the robot is, by the joints: controllers can be slower than planned.

        It is at the first piece from the last one on that the joints are near to.
        """
        pieces, here = self.pieces, self.joints.positions
        ahead = np.flatnonzero((pieces.finishes > self.passed) & (pieces.begins <= elapsed))
        near = ahead[distances_from(pieces.take(ahead), here) <= tolerance]
        if len(near):
            self.passed = float(pieces.begins[near[0]])
        last = pieces.finishes.max()
        there = np.abs(pieces.ends[np.argmax(pieces.finishes)] - here).max(initial=0.0)
        if elapsed >= last and there <= tolerance:
            self.passed = float(last)

    def hold(self) -> JointTrajectory:
        """Return a trajectory that stays where the joints are."""
        positions = self.joints.positions[self.columns].tolist()
        return JointTrajectory(
            joint_names=self.names, points=[JointTrajectoryPoint(positions=positions)]
        )
