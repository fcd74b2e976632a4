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

"""Joints of a robot: their order, variables, mimics and tree, from its description."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from obb_collision.geometry.poses import multiply_quaternions, rotate_vectors
from obb_collision.robots.description.srdf import Pairs, VirtualJoint, sorted_pair
from obb_collision.robots.description.urdf import Description, Joint, JointKind, PlacedShape
from obb_collision.robots.kinematics.kinematics import Tree
from obb_collision.typing import Floats

#: Suffixes of the variables of joints with several, as in MoveIt.
VARIABLES = {
    JointKind.PLANAR: ("x", "y", "theta"),
    JointKind.FLOATING: ("trans_x", "trans_y", "trans_z", "rot_x", "rot_y", "rot_z", "rot_w"),
}
#: Maximum length of a chain of joints that mimic one another.
MOST_MIMICS = 100
X, Y, Z = np.eye(3)


class Mechanism(Protocol):
    """The attributes of a ``Robot`` that checks and proofs use."""

    link_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    lower: Floats
    upper: Floats
    joints: tuple[Joint, ...]
    shapes: tuple[tuple[PlacedShape, ...], ...]
    tree: Tree
    disabled_pairs: Pairs
    adjacent_pairs: Pairs


def virtual_joint_of(virtual: VirtualJoint | None, description: Description) -> Joint | None:
    """Return the virtual joint of an SRDF as a joint; None if it does not move."""
    if virtual is None or virtual.kind is JointKind.FIXED:
        return None
    return Joint(virtual.name, virtual.kind, "", virtual.child_link, description.element)


def adjacent_pairs(joints: list[Joint], shapes: dict[str, tuple[PlacedShape, ...]]) -> Pairs:
    """Return the pairs of links with shapes that joints connect, through links without shapes."""
    neighbours: dict[str, list[str]] = {link: [] for link in shapes}
    for joint in joints:
        neighbours[joint.parent].append(joint.child)
        neighbours[joint.child].append(joint.parent)
    pairs = set()
    for link in shapes:
        visited, waiting = {link}, neighbours[link][:] if shapes[link] else []
        while waiting:
            other = waiting.pop()
            if other in visited:
                continue
            visited.add(other)
            if shapes[other]:
                pairs.add(sorted_pair(link, other))
            else:
                waiting += neighbours[other]
    return frozenset(pairs)


class Variables(NamedTuple):
    """The variables of a state: names, limits, and the first one of each joint by its name."""

    names: tuple[str, ...]
    lower: Floats
    upper: Floats
    velocity: Floats
    first: dict[str, int]


def ordered_joints(description: Description) -> tuple[str, list[Joint]]:
    """Return the root link and the joints, parents before children, depth first in file order.

    RobotError for loops, for links with two parents and for several roots.
    """
    parents: dict[str, Joint] = {}
    children: dict[str, list[Joint]] = {}
    for joint in description.joints.values():
        if joint.child in parents:
            other = parents[joint.child].name
            raise joint.element.refuse(f"joint {other!r} has the same child {joint.child!r}")
        parents[joint.child] = joint
        children.setdefault(joint.parent, []).append(joint)
    roots = [link for link in description.shapes if link not in parents]
    if not roots:
        raise description.element.refuse("there is no root: the joints form a loop")
    if len(roots) > 1:
        names = ", ".join(map(repr, roots[:5])) + (", ..." if len(roots) > 5 else "")
        raise description.element.refuse(f"there are {len(roots)} roots: {names}")
    order: list[Joint] = []
    waiting = children.get(roots[0], [])[::-1]
    while waiting:
        order.append(waiting.pop())
        waiting += children.get(order[-1].child, [])[::-1]
    if len(order) < len(description.joints):
        reached = {joint.name for joint in order}
        loose = next(joint for name, joint in description.joints.items() if name not in reached)
        raise loose.element.refuse("it is part of a loop of joints")
    return roots[0], order


def variables_of(joints: list[Joint]) -> Variables:
    """Return the variables of the joints that move and do not mimic, in the order of joints."""
    names: list[str] = []
    limits: list[tuple[float, float, float]] = []
    first: dict[str, int] = {}
    for joint in joints:
        if not joint.drives:
            continue
        first[joint.name] = len(names)
        parts = VARIABLES.get(joint.kind)
        names += [joint.name] if parts is None else [f"{joint.name}/{part}" for part in parts]
        for part in parts or ("",):
            bound = 1.0 if part.startswith("rot_") else math.inf
            lower, upper = max(joint.lower, -bound), min(joint.upper, bound)
            limits.append((lower, upper, joint.velocity))
    table: Floats = np.array(limits).reshape(-1, 3).T.copy()
    table.setflags(write=False)
    return Variables(tuple(names), table[0], table[1], table[2], first)


def driven(joint: Joint, joints: dict[str, Joint]) -> tuple[str, float, float]:
    """Return the joint that a joint mimics in the end, or itself, with multiplier and offset.

    RobotError for mimics in a circle, and for a mimicked joint without exactly one variable.
    """
    name, multiplier, offset = joint.name, 1.0, 0.0
    for _ in range(MOST_MIMICS):
        mimic = joints[name].mimic
        if mimic is None:
            return name, multiplier, offset
        element = joints[name].element
        kind = joints[mimic.joint].kind
        if kind in VARIABLES or kind is JointKind.FIXED:
            raise element.refuse(f"it mimics the {kind.name.lower()} joint {mimic.joint!r}")
        offset, multiplier = offset + multiplier * mimic.offset, multiplier * mimic.multiplier
        if not math.isfinite(offset) or not math.isfinite(multiplier):
            raise element.refuse("its multiplier or offset is not finite, with those it mimics")
        name = mimic.joint
    raise joint.element.refuse(f"it mimics itself, or a chain of more than {MOST_MIMICS} joints")


def tree_of(
    root: str, joints: list[Joint], variables: Variables, virtual: Joint | None
) -> tuple[tuple[str, ...], Tree]:
    """Return the names of the links, the root first, and the tree, whose row k is link k's joint.

    joints: parents before children. virtual: the joint of the root, None if the root does not move.
    """
    by_name = {joint.name: joint for joint in (virtual, *joints) if joint is not None}
    links = (root, *(joint.child for joint in joints))
    rows = {name: row for row, name in enumerate(links)}
    count = len(links)
    tree = Tree(
        parents=np.full(count, -1),
        kinds=np.zeros(count, np.int64),
        columns=np.full(count, -1),
        multipliers=np.ones(count),
        offsets=np.zeros(count),
        translations=np.zeros((count, 3)),
        rotations=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        turned=np.zeros((count, 4)),
        directions=np.zeros((count, 3)),
        across=np.zeros((count, 3)),
    )
    for row, joint in enumerate((virtual, *joints)):
        if joint is None:
            continue
        tree.parents[row], tree.kinds[row] = rows.get(joint.parent, -1), joint.kind
        if joint.kind is not JointKind.FIXED:
            name, tree.multipliers[row], tree.offsets[row] = driven(joint, by_name)
            tree.columns[row] = variables.first[name]
        _fill_row(tree, row, joint)
    for array in tree:
        array.setflags(write=False)
    return links, tree


def _fill_row(tree: Tree, row: int, joint: Joint) -> None:
    """Write the constants of a joint: its origin and axes in the frame of the parent."""
    origin = np.array(joint.pose[3:])
    tree.translations[row], tree.rotations[row] = joint.pose[:3], origin
    planar = joint.kind in (JointKind.PLANAR, JointKind.FLOATING)
    axis = np.array(joint.axis) if joint.axis is not None else (Z if planar else X)
    tree.turned[row] = multiply_quaternions(origin, np.append(axis, 0.0))
    along, across = (axis, Y) if not planar else (X, Y)
    if joint.kind is JointKind.PLANAR:
        along, across = rotate_vectors(_turn_to(axis), np.array([X, Y]))
    tree.directions[row] = rotate_vectors(origin, along)
    tree.across[row] = rotate_vectors(origin, across)


def _turn_to(axis: Floats) -> Floats:
    """Return the shortest rotation that turns z to an axis; about x if there are several."""
    turn = np.append(np.cross(Z, axis), 1.0 + axis[2])
    length = float(np.linalg.norm(turn))
    return np.array([1.0, 0.0, 0.0, 0.0]) if length < 1e-9 else turn / length
