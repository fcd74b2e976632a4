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

"""Arrays for kernels: one tree of several robots, bodies, and their places in one state.

Error analysis, with u = 2^-53: a chain of k joints moves a point by at most 24 k u L from where
real arithmetic has it, L being the lengths of the chain and the body, summed; rotations are
orthonormal to 16 u. LINK_PLACING is 2^14 u, so that both stay below it for chains of 200 joints,
with the bounds of ``verdict`` and ``convex`` for bodies that are where they are said to be.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.geometry.poses import (
    compose_poses,
    multiply_quaternions,
    rotate_vectors,
    rotation_of,
)
from obb_collision.geometry.trees.bounds_tree import STACK
from obb_collision.numerics.constants import MAX_MAGNITUDE, MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.vec3 import axes_of, components, rows_at, sum_abs, vector_at
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.robots.kinematics.kinematics import FIXED, FLOATING, PRISMATIC, Tree, place_links
from obb_collision.typing import Floats, Integers, Mask, Rows, Vector

if TYPE_CHECKING:
    from obb_collision.robots.robot import Robot

#: Distance within which bodies count as colliding, relative to the lengths of their chains.
LINK_PLACING = 2**14 * ROUNDOFF
#: Quaternions whose sum is shorter are opposite: between them, motions have no certain speed.
OPPOSITE = 1e-6
FLOAT64 = np.dtype(np.float64)


class LinkBodies(NamedTuple):
    """Convex bodies (b,): those of the robots first, then those of the world.

    Each is a hull with a ball around every point of it, of radius ``rounds``; and a box and a
    sphere around its centre that contain that. All in the frames of links; the last frame is that
    of the world.
    """

    frames: Integers  #: (b,) the frame
    centers: Floats  #: (b, 3) of its box
    rotations: Floats  #: (b, 3, 3)
    half_extents: Floats  #: (b, 3)
    spheres: Floats  #: (b,) radius of the sphere
    inner: Floats  #: (b,) radius of a ball around the same centre within the hull
    boxes: Mask  #: (b,) whether the hull is the box
    rounds: Floats  #: (b,)
    radii: Floats  #: (b,) largest sum of magnitudes of the coordinates of a corner
    reaches: Floats  #: (b,) lengths of the chain up to the frame, and of the body
    excess: Floats  #: (b,) how far the hull may reach beyond a curved shape
    blocks: Floats  #: (m, 3, LANES) corners of all hulls, as in ``Hulls``
    starts: Integers  #: (b + 1,)


class Tests(NamedTuple):
    """Which bodies are tested against each other: pairs of robots' bodies, and those of the world.

    allowed (robots' bodies, world's bodies): pairs that do not count; (0, 0) for none. nodes,
    levels, order: the tree of the world's bounds, as in ``BoundsTree``. It is asked once for all
    bodies of a link, by a sphere around them.
    """

    links: Integers  #: (l,) the frames that bodies of robots are in ...
    starts: Integers  #: (l + 1,) ... of each the first of its bodies, which are in a row ...
    centers: Floats  #: (l, 3) ... and the sphere around them
    spheres: Floats  #: (l,)
    pairs: Integers  #: (p, 2)
    allowed: Mask
    first: int  #: the first body of the world
    nodes: Floats
    levels: Integers
    order: Integers


class Chains(NamedTuple):
    """Lengths of the segments of chains, along the axis of the joint before them, and across.

    segments and joints: what leads from the first link of a pair of links, up and down, to the
    second one: segments, and the joint behind each, -1 for none; those of pair u from ``starts[u]``
    on.
    """

    links: Floats  #: (links, 2) from the origin of the parent to that of the joint
    bodies: Floats  #: (robots' bodies, 2) from the origin of the link to the farthest corner
    rows: Integers  #: (p,) which pair of links a tested pair of bodies belongs to
    starts: Integers  #: (u + 1,)
    segments: Floats  #: (s, 2)
    joints: Integers  #: (s,)


class Checked(NamedTuple):
    """Robots and the world: kinematics, bodies, and which of them are tested.

    Kernels take it as ``Held``, of which there is one kind: states leave out what motions need.
    """

    tree: Tree
    bodies: LinkBodies
    tests: Tests
    owners: Integers  #: (b + 1,) the row in names of each body, and -1 for none
    chains: Chains  #: what moves bodies
    meshes: Mask  #: (b,) bodies whose pairs hulls do not decide


class PairValues(NamedTuple):
    """A number of each body against the world, and of each pair: by state (k,), or one for all."""

    bodies: Floats  #: (k, robots' bodies)
    pairs: Floats  #: (k, p)


class Placed(NamedTuple):
    """Where frames and bodies are in one state; axes of boxes are computed where needed."""

    poses: Floats  #: (1, links, 7)
    positions: Floats  #: (f, 3) of the frames
    rotations: Floats  #: (f, 3, 3)
    centers: Floats  #: (b, 3) of the bodies' boxes
    axes: Floats  #: (b, 3, 3)
    ready: Mask  #: (b,) whether axes are computed
    waiting: Integers  #: (2, STACK) blocks of the tree to visit
    candidates: Integers  #: (c, 2) pairs whose spheres overlap
    grown: Floats  #: (c,) distance within which they count as colliding, metres


@njit
def new_placed(checked: Checked) -> Placed:
    """Return room for one state, in which the bodies of the world are placed."""
    bodies, tests, links = checked.bodies, checked.tests, len(checked.tree.parents)
    count, first = len(bodies.frames), tests.first
    most = len(tests.pairs) + first * (count - first)
    placed = Placed(
        np.empty((1, links, 7)),
        np.zeros((links + 1, 3)),
        np.zeros((links + 1, 3, 3)),
        np.empty((count, 3)),
        np.empty((count, 3, 3)),
        np.zeros(count, np.bool_),
        np.empty((2, STACK), np.int64),
        np.empty((most, 2), np.int64),
        np.empty(most),
    )
    for k in range(3):
        placed.rotations[links, k, k] = 1.0
    for i in range(first, count):
        placed.ready[i] = True
        for k in range(3):
            placed.centers[i, k] = bodies.centers[i, k]
            for m in range(3):
                placed.axes[i, k, m] = bodies.rotations[i, k, m]
    return placed


@njit(inline=True, refcount=False)
def place_state(checked: Checked, states: Floats, n: int, placed: Placed) -> None:
    """Place links and the robots' bodies in state n."""
    poses, positions, rotations = placed.poses, placed.positions, placed.rotations
    place_links(checked.tree, states, n, poses, 0)
    for frame in checked.tests.links:
        rows = rotation_of(
            (poses[0, frame, 3], poses[0, frame, 4], poses[0, frame, 5], poses[0, frame, 6])
        )
        for k in range(3):
            positions[frame, k] = poses[0, frame, k]
            for m in range(3):
                rotations[frame, k, m] = rows[k][m]
    frames, middles, centers = checked.bodies.frames, checked.bodies.centers, placed.centers
    for i in range(checked.tests.first):
        frame = frames[i]
        center = components(rows_at(rotations, frame), vector_at(middles, i))
        for k in range(3):
            centers[i, k] = positions[frame, k] + center[k]
        placed.ready[i] = False


@njit(inline=True, refcount=False)
def slack_of(bodies: LinkBodies, i: int, center: Vector) -> float:
    """Return a bound (m) on the error of the place of body i and of its tests."""
    return LINK_PLACING * (bodies.reaches[i] + sum_abs(center)) + MESH_UNDERFLOW


@njit(inline=True, refcount=False)
def placed_box(bodies: LinkBodies, placed: Placed, i: int) -> BoxAt:
    """Return the box of body i, whose axes are computed when it is first asked for."""
    axes = placed.axes
    if not placed.ready[i]:
        placed.ready[i] = True
        turn = rows_at(placed.rotations, bodies.frames[i])
        x, y, z = axes_of(bodies.rotations, i)
        x, y, z = components(turn, x), components(turn, y), components(turn, z)
        for k in range(3):
            axes[i, k, 0], axes[i, k, 1], axes[i, k, 2] = x[k], y[k], z[k]
    return box_at(BoxArrays(placed.centers, axes, bodies.half_extents), i)


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
        self.floating: list[int] = []
        """The first columns of floating joints."""
        self._mimics: list[tuple[int, float, float, float, float]] = []
        first = 0
        for robot in robots:
            for joint in robot.joints:
                if joint.mimic is not None:
                    k = robot.link_names.index(joint.child)
                    _, _, columns, multipliers, offsets, *_ = robot.tree
                    how = float(multipliers[k]), float(offsets[k]), joint.lower, joint.upper
                    self._mimics.append((first + int(columns[k]), *how))
            columns = robot.tree.columns[robot.tree.kinds == FLOATING]
            self.floating += (first + columns).tolist()
            first += len(robot.joint_names)
        self._inner = np.clip([self.lower, self.upper], -MAX_MAGNITUDE, MAX_MAGNITUDE)
        self._inner[0, self.floating] = np.inf  # quaternions of zeros are none
        for column, multiplier, offset, lower, upper in self._mimics:
            if multiplier == 0.0:
                self._inner[0, column] = np.inf
                continue
            ends = (lower - offset) / multiplier, (upper - offset) / multiplier
            self._inner[0, column] = max(self._inner[0, column], min(ends))
            self._inner[1, column] = min(self._inner[1, column], max(ends))

    def hold(self, states: Any) -> bool:
        """Return whether something is an array of states (n, joints), all of them valid.

        Also False for some that are: it is for most states, and as fast as can be.
        """
        return (
            type(states) is np.ndarray
            and states.dtype is FLOAT64
            and states.flags.carray
            and states.shape[1:] == self.lower.shape
            and _are_between(states, self._inner)
        )

    def exceeded(self, states: Floats, others: Floats | None = None) -> Mask:
        """Return (n, joints) which joints are out of their limits, or drive one that is.

        others: more states (n, joints) of the same rows.
        """
        if others is not None:
            if self.hold(others):
                return self.exceeded(states)
            return self.exceeded(states) | self.exceeded(others)
        if self.hold(states):
            return np.zeros(states.shape, np.bool_)
        out = np.asarray((states < self.lower) | (states > self.upper))
        for column, multiplier, offset, lower, upper in self._mimics:
            moved = multiplier * states[:, column]
            room = 4.0 * ROUNDOFF * (np.abs(moved) + abs(offset))
            value = moved + offset
            out[:, column] |= (value < lower - room) | (value > upper + room)
        return out


@njit
def _are_between(states: Floats, limits: Floats) -> bool:
    """Return whether all states (n, joints) are between limits (2, joints)."""
    good = True
    for n in range(len(states)):
        for k in range(states.shape[1]):
            good &= limits[0, k] <= states[n, k] <= limits[1, k]  # False for NaN, too
    return good


def check_turns(floating: Sequence[int], starts: Floats, ends: Floats) -> None:
    """Raise ValueError where the quaternion of a floating joint would move through zero.

    floating: their first columns.
    """
    for column in floating:
        turns = [states[:, column + 3 : column + 7] for states in (starts, ends)]
        units = [turn / np.linalg.norm(turn, axis=1, keepdims=True) for turn in turns]
        opposite = np.flatnonzero(np.linalg.norm(units[0] + units[1], axis=1) < OPPOSITE)
        if len(opposite):
            raise ValueError(
                "ends must not have quaternions opposite to those of starts: which way to turn "
                f"is not clear in row {opposite[0]}"
            )


def rigid_groups(tree: Tree) -> Rows:
    """Return (links,) the first link of those that never move against each other."""
    groups = np.arange(len(tree.parents))
    for row, parent in enumerate(tree.parents.tolist()):
        if parent >= 0 and tree.kinds[row] == FIXED:
            groups[row] = groups[parent]
    return groups


def driving_joints(tree: Tree) -> Mask:
    """Return (links + 1, links) whether the joint of a link moves another one; none the world.

    Those of fixed joints, and of joints that mimic others by nothing, move none.
    """
    count = len(tree.parents)
    moving = (tree.kinds != FIXED) & (tree.multipliers != 0.0)
    driven = np.zeros((count + 1, count), np.bool_)
    for link, parent in enumerate(tree.parents.tolist()):
        if parent >= 0:
            driven[link] = driven[parent]
        driven[link, link] = moving[link]
    return driven


def next_joint(tree: Tree, link: int) -> int:
    """Return the link whose joint is the first that moves a link, upwards; -1 for none."""
    while link >= 0 and (tree.kinds[link] == FIXED or tree.multipliers[link] == 0.0):
        link = int(tree.parents[link])
    return link


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
