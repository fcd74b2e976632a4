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

"""The joints between two links, as two chains that start at a frame between them.

Seen from a frame in the middle, each link is moved by half of the joints: bounds of their motion,
which grow with the square of the number of joints, are a quarter of those seen from a link.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision.geometry.poses import (
    IDENTITY_POSE,
    Pose,
    compose_poses,
    inverse_poses,
    rotation_of,
)
from obb_collision.robots.description.robot import Robot
from obb_collision.robots.description.tree import driven
from obb_collision.robots.description.urdf import Joint, JointKind
from obb_collision.typing import Floats, Integers, Mask

#: The axis of a joint that has none.
DEFAULT_AXIS = (1.0, 0.0, 0.0)


class Chain(NamedTuple):
    """k joints from a frame outwards: F_0 J_0 F_1 J_1 ... F_k, which is the frame of a link.

    Joint i turns about an axis through the origin, or slides along it, by its factor times a
    variable plus its offset.
    """

    places: Floats  #: (k + 1, 3) of F
    turns: Floats  #: (k + 1, 3, 3)
    axes: Floats  #: (k, 3) unit vectors
    slides: Mask  #: (k,) whether it slides
    columns: Integers  #: (k,) its variable, a row of ``Between.rows``
    factors: Floats  #: (k,)
    offsets: Floats  #: (k,)


class Between(NamedTuple):
    """What moves two links relative to each other: two chains, and the limits of variables (v,)."""

    a: Chain
    b: Chain
    rows: Integers  #: (v,) the variables in a state of the robot
    lower: Floats
    upper: Floats


class _Step(NamedTuple):
    """A joint on the way from one link to another, up to the parent or down to the child."""

    joint: Joint
    is_up: bool


def chains_between(robot: Robot, a: str, b: str) -> Between | None:
    """Return the joints between two links; None if one of them has no bounds."""
    steps = _way(robot, a, b)
    names = {joint.name: joint for joint in robot.joints}
    moving = [k for k, step in enumerate(steps) if step.joint.kind is not JointKind.FIXED]
    if any(steps[k].joint.kind in (JointKind.PLANAR, JointKind.FLOATING) for k in moving):
        return None
    driver = {k: driven(steps[k].joint, names) for k in moving}
    rows = sorted({robot.joint_names.index(name) for name, _, _ in driver.values()})
    lower, upper = robot.lower[rows], robot.upper[rows]
    for column, row in enumerate(rows):
        name = robot.joint_names[row]
        by = [k for k in moving if driver[k][0] == name]
        if _whole_turns_are_none([steps[k].joint for k in by], [driver[k][1] for k in by]):
            lower[column], upper[column] = _one_turn(lower[column], upper[column])
        elif not np.isfinite([lower[column], upper[column]]).all():
            return None
    middle = moving[len(moving) // 2] if moving else 0
    back = [_Step(step.joint, not step.is_up) for step in steps[:middle]][::-1]
    chains = [_chain(robot, way, names, rows) for way in (back, steps[middle:])]
    return Between(chains[0], chains[1], np.array(rows, np.int64), lower, upper)


def _whole_turns_are_none(joints: list[Joint], factors: list[float]) -> bool:
    """Return whether a variable may be changed by whole turns: all that it drives turns by such."""
    turning = (JointKind.REVOLUTE, JointKind.CONTINUOUS)
    return all(joint.kind in turning for joint in joints) and all(
        float(factor).is_integer() for factor in factors
    )


def _one_turn(lower: float, upper: float) -> tuple[float, float]:
    """Return limits of one turn within others, or these if they are narrower."""
    if lower <= -math.pi and upper >= math.pi:
        return -math.pi, math.pi
    return lower, min(upper, lower + 2.0 * math.pi)


def _way(robot: Robot, a: str, b: str) -> list[_Step]:
    """Return the joints from link a to link b."""
    above = {joint.child: joint for joint in robot.joints if joint.parent in robot.link_names}

    def to_root(link: str) -> list[Joint]:
        found = []
        while link in above:
            found.append(above[link])
            link = above[link].parent
        return found

    up, down = to_root(a), to_root(b)
    while up and down and up[-1] is down[-1]:
        up.pop()
        down.pop()
    return [_Step(joint, True) for joint in up] + [_Step(joint, False) for joint in down[::-1]]


def _chain(robot: Robot, steps: list[_Step], names: dict[str, Joint], rows: list[int]) -> Chain:
    """Return steps as a chain. Up, a joint is undone first, and then its origin."""
    fixed: list[Floats] = [IDENTITY_POSE]
    axes, slides, columns, factors, offsets = [], [], [], [], []
    for joint, is_up in steps:
        origin = np.array(joint.pose)
        if not is_up:
            fixed[-1] = compose_poses(fixed[-1], origin)
        if joint.kind is not JointKind.FIXED:
            name, factor, offset = driven(joint, names)
            sign = -1.0 if is_up else 1.0
            axes.append(joint.axis or DEFAULT_AXIS)
            slides.append(joint.kind is JointKind.PRISMATIC)
            columns.append(rows.index(robot.joint_names.index(name)))
            factors.append(sign * factor)
            offsets.append(sign * offset)
            fixed.append(IDENTITY_POSE)
        if is_up:
            fixed[-1] = compose_poses(fixed[-1], inverse_poses(origin))
    return Chain(
        np.array([pose[:3] for pose in fixed]), np.array([_matrix(pose) for pose in fixed]),
        np.array(axes, np.float64).reshape(-1, 3), np.array(slides, np.bool_),
        np.array(columns, np.int64), np.array(factors, np.float64), np.array(offsets, np.float64),
    )  # fmt: skip


def _matrix(pose: Floats | Pose) -> Floats:
    x, y, z, w = (float(number) for number in pose[3:])
    return np.array(rotation_of((x, y, z, w)))
