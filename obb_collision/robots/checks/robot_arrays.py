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

"""Several robots as arrays: one tree of links, limits of joints, and pairs of links to check."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from obb_collision.geometry.poses import compose_poses, multiply_quaternions, rotate_vectors
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.robots.kinematics.kinematics import FIXED, FLOATING, PRISMATIC, Tree
from obb_collision.typing import Floats, Integers, Mask, Rows

if TYPE_CHECKING:
    from obb_collision.robots.robot import Robot

#: Quaternions whose sum is shorter are opposite: between them, motions have no certain speed.
OPPOSITE = 1e-6


def one_tree(robots: Sequence[Robot], bases: Floats) -> Tree:
    """Return the trees of robots as one, their roots at bases (r, 7)."""
    column = row = 0
    parts = []
    for robot, base in zip(robots, bases, strict=True):
        tree = robot.tree
        own = {name: value.copy() for name, value in tree._asdict().items()}
        roots = tree.parents < 0
        own["parents"][~roots] += row
        own["columns"][tree.columns >= 0] += column
        places = np.column_stack([tree.translations, tree.rotations])[roots]
        placed = compose_poses(base, places)
        own["translations"][roots], own["rotations"][roots] = placed[:, :3], placed[:, 3:]
        turn = np.broadcast_to(base[3:], (int(roots.sum()), 4))
        own["turned"][roots] = multiply_quaternions(turn, tree.turned[roots])
        for name in ("directions", "across"):
            own[name][roots] = rotate_vectors(turn, own[name][roots])
        parts.append(own)
        column, row = column + len(robot.joint_names), row + len(robot.link_names)
    return Tree(**{name: np.concatenate([part[name] for part in parts]) for name in Tree._fields})


def chain_lengths(tree: Tree, lower: Floats, upper: Floats) -> Floats:
    """Return (links,) how far each link can be from the root, summed over its joints (metres).

    Infinite ranges of joints count as none.
    """
    lengths = np.abs(tree.translations).sum(axis=1)
    for row, parent in enumerate(tree.parents.tolist()):
        if tree.kinds[row] == PRISMATIC:
            ends = np.array([limits[tree.columns[row]] for limits in (lower, upper)])
            reach = np.abs(tree.multipliers[row] * ends + tree.offsets[row]).max()
            lengths[row] += reach if np.isfinite(reach) else 0.0
        if parent >= 0:
            lengths[row] += lengths[parent]
    return lengths


class JointLimits:
    """The limits of the joints of several robots, those of joints that mimic others included."""

    def __init__(self, robots: Sequence[Robot]) -> None:
        self.lower = np.concatenate([robot.lower for robot in robots])
        self.upper = np.concatenate([robot.upper for robot in robots])
        self._mimics: list[tuple[int, float, float, float, float]] = []
        first = 0
        for robot in robots:
            for joint in robot.joints:
                if joint.mimic is not None:
                    k = robot.link_names.index(joint.child)
                    _, _, columns, multipliers, offsets, *_ = robot.tree
                    how = float(multipliers[k]), float(offsets[k]), joint.lower, joint.upper
                    self._mimics.append((first + int(columns[k]), *how))
            first += len(robot.joint_names)

    def exceeded(self, states: Floats) -> Mask:
        """Return (n, joints) which joints are out of their limits, or drive one that is."""
        out = np.asarray((states < self.lower) | (states > self.upper))
        for column, multiplier, offset, lower, upper in self._mimics:
            moved = multiplier * states[:, column]
            room = 4.0 * ROUNDOFF * (np.abs(moved) + abs(offset))
            value = moved + offset
            out[:, column] |= (value < lower - room) | (value > upper + room)
        return out


def check_turns(tree: Tree, starts: Floats, ends: Floats) -> None:
    """Raise ValueError where the quaternion of a floating joint would move through zero."""
    for column in tree.columns[tree.kinds == FLOATING].tolist():
        turns = [states[:, column + 3 : column + 7] for states in (starts, ends)]
        units = [turn / np.linalg.norm(turn, axis=1, keepdims=True) for turn in turns]
        opposite = np.flatnonzero(np.linalg.norm(units[0] + units[1], axis=1) < OPPOSITE)
        if len(opposite):
            raise ValueError(
                "ends must not have quaternions opposite to those of starts: which way to turn "
                f"is not clear, row {opposite[0]}"
            )


def rigid_groups(tree: Tree) -> Rows:
    """Return (links,) the first link of those that never move against each other."""
    groups = np.arange(len(tree.parents))
    for row, parent in enumerate(tree.parents.tolist()):
        if parent >= 0 and tree.kinds[row] == FIXED:
            groups[row] = groups[parent]
    return groups


def allowed_links(robots: Sequence[Robot], groups: Rows) -> Mask:
    """Return (links, links) which pairs are not checked: of one rigid body, adjacent, disabled."""
    allowed = groups[:, None] == groups
    first = 0
    for robot in robots:
        rows = {name: first + row for row, name in enumerate(robot.link_names)}
        for one, other in robot.disabled_pairs | robot.adjacent_pairs:
            allowed[rows[one], rows[other]] = allowed[rows[other], rows[one]] = True
        first += len(rows)
    return allowed


def body_pairs(owners: Rows, allowed: Mask) -> Integers:
    """Return the pairs of bodies (p, 2) whose owners are checked against each other."""
    first, second = np.triu_indices(len(owners), 1)
    checked = ~allowed[owners[first], owners[second]]
    return np.column_stack([first[checked], second[checked]])
