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

"""Robots and what is attached to them as arrays for kernels: one tree, bodies, and their pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from obb_collision.geometry.poses import (
    as_poses,
    compose_poses,
    multiply_quaternions,
    rotate_vectors,
)
from obb_collision.obb import OBB
from obb_collision.robots.bodies.bodies import Body, body_of
from obb_collision.robots.description.robot import Robot
from obb_collision.robots.kinematics.kinematics import FIXED, PRISMATIC, Tree
from obb_collision.shapes import Shape
from obb_collision.typing import Floats, Integers, Mask, Rows


@dataclass(frozen=True, eq=False)
class Attached:
    """Something attached to a link, at a pose in its frame; it may touch links.

    of_scene: it is an object of the scene, which is no obstacle meanwhile.
    """

    shape: Shape | OBB
    link: int
    pose: Floats
    touch_links: frozenset[int]
    padding: float
    of_scene: bool = False


def one_tree(robots: Sequence[Robot], bases: Floats) -> Tree:
    """Return the trees of robots as one, their roots at bases (r, 7)."""
    columns = np.cumsum([0, *(len(robot.joint_names) for robot in robots)])
    rows = np.cumsum([0, *(len(robot.link_names) for robot in robots)])
    parts = []
    for robot, base, column, row in zip(robots, bases, columns, rows, strict=False):
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
    return Tree(**{name: np.concatenate([part[name] for part in parts]) for name in Tree._fields})


def chain_lengths(tree: Tree, lower: Floats, upper: Floats) -> Floats:
    """Return (links,) how far each link can be from the root, summed over its joints (metres).

    Infinite ranges of joints count as none.
    """
    lengths = np.abs(tree.translations).sum(axis=1)
    for row in np.flatnonzero(tree.kinds == PRISMATIC).tolist():
        lengths[row] += joint_reach(tree, row, lower, upper)
    for row, parent in enumerate(tree.parents.tolist()):
        if parent >= 0:
            lengths[row] += lengths[parent]
    return lengths


def joint_reach(tree: Tree, row: int, lower: Floats, upper: Floats) -> float:
    """Return the largest displacement of a prismatic joint within its limits; 0 without limits."""
    column = tree.columns[row]
    ends = tree.multipliers[row] * np.array((lower[column], upper[column])) + tree.offsets[row]
    reach = float(np.abs(ends).max())
    return reach if np.isfinite(reach) else 0.0


def mimic_limits(robots: Sequence[Robot]) -> Floats:
    """Return rows (5, m): of each joint that mimics another one its column, how, and its limits."""
    rows, first = [], 0
    for robot in robots:
        tree, links = robot.tree, robot.link_names
        for joint in robot.joints:
            if joint.mimic is not None:
                k = links.index(joint.child)
                how = tree.multipliers[k], tree.offsets[k], joint.lower, joint.upper
                rows.append((first + tree.columns[k], *how))
        first += len(robot.joint_names)
    return np.array(rows, np.float64).reshape(-1, 5).T


def rigid_groups(tree: Tree) -> Rows:
    """Return (links,) the first link of those that never move against each other."""
    groups = np.arange(len(tree.parents))
    for row, parent in enumerate(tree.parents.tolist()):
        if parent >= 0 and tree.kinds[row] == FIXED:
            groups[row] = groups[parent]
    return groups


def link_bodies(
    robots: Sequence[Robot], paddings: Floats, chains: Floats
) -> tuple[list[Body], list[int]]:
    """Return the bodies of all links, and of each the link it belongs to."""
    shapes = [shapes for robot in robots for shapes in robot.shapes]
    owners = [link for link, placed in enumerate(shapes) for _ in placed]
    bodies = [
        body_of(shape, pose, link, float(paddings[link]), float(chains[link]))
        for link, placed in enumerate(shapes)
        for shape, pose in placed
    ]
    return bodies, owners


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


def with_attached(allowed: Mask, groups: Rows, attached: Sequence[Attached]) -> Mask:
    """Return the pairs not checked with rows for what is attached after those of the links."""
    count = len(allowed)
    groups = np.append(groups, groups[[each.link for each in attached]].astype(np.int64))
    result = groups[:, None] == groups
    result[:count, :count] = allowed
    for row, each in enumerate(attached, start=count):
        touched = list(each.touch_links)
        result[row, touched] = result[touched, row] = True
    return result


def body_pairs(owners: Rows, allowed: Mask) -> Integers:
    """Return the pairs of bodies (p, 2) whose owners are checked against each other."""
    first, second = np.triu_indices(len(owners), 1)
    checked = ~allowed[owners[first], owners[second]]
    return np.column_stack([first[checked], second[checked]])


def attached_body(each: Attached, chains: Floats, padding: float) -> Body:
    """Return the body of what is attached."""
    return body_of(
        each.shape, each.pose, each.link, padding + each.padding, float(chains[each.link])
    )


def base_poses(bases: Floats) -> Floats:
    """Return poses (r, 7) with unit quaternions; ValueError naming the row."""
    as_poses(bases, "bases")
    return np.asarray(compose_poses(bases, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)))
