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

"""Arrays for kernels: one tree of several robots, bodies, chains, and places in one state.

Error analysis, with u = 2^-53: a chain of k joints moves a point by at most 24 k u L from where
real arithmetic has it, where L is the length of the chain plus that of the body; rotations are
orthonormal to 16 u. LINK_PLACING is 2^14 u. For chains of 200 joints it exceeds these errors and
those of the tests of ``verdict`` and ``convex`` together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

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
from obb_collision.numerics.intrinsics import LANES
from obb_collision.numerics.vec3 import axes_of, components, rows_at, sum_abs, vector_at
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.robots.description.joints import Mechanism
from obb_collision.robots.kinematics.kinematics import FIXED, FLOATING, PRISMATIC, Tree, place_links
from obb_collision.typing import Floats, Integers, Mask, Rows, Vector

#: Distance within which bodies count as colliding, relative to the lengths of their chains.
LINK_PLACING = 2**14 * ROUNDOFF
#: Length of the sum of two opposite quaternions: a motion between them has no bounded speed.
OPPOSITE = 1e-6
FLOAT64 = np.dtype(np.float64)
#: Relative growth of lengths: more than their roundings.
LENGTH_GROWTH = 1.0 + 2.0**12 * ROUNDOFF
NO_PARTS, NO_LENGTHS = np.empty(0, np.int64), np.empty((0, 2))


class LinkBodies(NamedTuple):
    """Convex bodies (b,): those of the robots first, then those of the world.

    Each is a hull with a ball of radius ``rounds`` around every point; a box, and a sphere around
    its centre, contain it. All are in the frames of links; the last frame is that of the world. The
    last bodies are those of clouds, see ``balls``; ``radii`` and ``reaches`` hold for all balls.
    """

    frames: Integers  #: (b,) the frame
    centers: Floats  #: (b, 3) of its box
    rotations: Floats  #: (b, 3, 3)
    half_extents: Floats  #: (b, 3)
    spheres: Floats  #: (b,) radius of the sphere
    inner: Floats  #: (b,) radius of a ball around that centre, within the hull
    boxes: Mask  #: (b,) whether the hull is the box
    rounds: Floats  #: (b,)
    radii: Floats  #: (b,) largest sum of the magnitudes of a corner's coordinates
    reaches: Floats  #: (b,) length of the chain up to the frame plus that of the body
    excess: Floats  #: (b,) how far the hull may reach beyond a curved shape
    blocks: Floats  #: (m, 3, LANES) corners of all hulls, as in ``Hulls``
    starts: Integers  #: (b + 1,)


class Clouds(NamedTuple):
    """The clouds of a world (c,), and the trees over their points; see ``balls``.

    A ball is numbered by its leaf and lane: the block in ``nodes`` times LANES, plus the lane.
    """

    bodies: Integers  #: (c,) the body of each cloud
    centers: Floats  #: (c, 3) places of their frames, relative to the origin of bodies
    rotations: Floats  #: (c, 3, 3)
    nodes: Floats  #: (m, 6, LANES) as in ``BoundsTree``
    levels: Integers  #: (c + 1, LEVELS) the first block of each level; of row c only the first
    tops: Integers  #: (c,) the number of the level of the root


class Tests(NamedTuple):
    """Which bodies are tested against each other: pairs of robots' bodies, and all of the world.

    allowed (robots' bodies, world's bodies): pairs that do not count; (0, 0) if all count. nodes,
    levels, order: the tree of the world's bounds without clouds, as in ``BoundsTree``. It is
    searched once for all bodies of a link, with a sphere around them.
    """

    links: Integers  #: (l,) the frames of the robots' bodies
    starts: Integers  #: (l + 1,) the first body in each frame
    centers: Floats  #: (l, 3) spheres around the bodies of each frame
    spheres: Floats  #: (l,)
    pairs: Integers  #: (p, 2)
    allowed: Mask
    first: int  #: the first body of the world
    nodes: Floats
    levels: Integers
    order: Integers


class Chains(NamedTuple):
    """Lengths of segments of chains, along the axis of the joint before them, and across it.

    segments, joints: the path from the first link of a pair of links to the second one: its
    segments, and the joint behind each, -1 for none. Those of pair u begin at ``starts[u]``.
    """

    links: Floats  #: (links, 2) from the origin of the parent to that of the joint
    bodies: Floats  #: (robots' bodies, 2) from the origin of the link to the farthest corner
    rows: Integers  #: (p,) the pair of links of each tested pair of bodies
    starts: Integers  #: (u + 1,)
    segments: Floats  #: (s, 2)
    joints: Integers  #: (s,)


#: The chains of a ``Checked`` for states.
NO_CHAINS = Chains(NO_LENGTHS, NO_LENGTHS, NO_PARTS, np.zeros(1, np.int64), NO_LENGTHS, NO_PARTS)


class Checked(NamedTuple):
    """Robots and the world: kinematics, bodies, and which of them are tested.

    Kernels take it as ``Held``, of one type: for states, what motions need is empty.
    """

    tree: Tree
    bodies: LinkBodies
    clouds: Clouds
    tests: Tests
    owners: Integers  #: (b + 1,) the row in names of each body; the last is -1, for no body
    chains: Chains  #: for motions
    meshes: Mask  #: (b,) bodies whose pairs need meshes to be decided


class PairValues(NamedTuple):
    """Distances by state (k,), or one row for all: of bodies to the world, and of pairs."""

    bodies: Floats  #: (k, robots' bodies)
    pairs: Floats  #: (k, p)


class Placed(NamedTuple):
    """Places of frames and bodies in one state; axes of boxes are computed when needed."""

    poses: Floats  #: (1, links, 7)
    positions: Floats  #: (f, 3) of the frames
    rotations: Floats  #: (f, 3, 3)
    centers: Floats  #: (b, 3) of the bodies' boxes
    axes: Floats  #: (b, 3, 3)
    ready: Mask  #: (b,) whether axes are computed
    waiting: Integers  #: (2, STACK) blocks of the tree to visit
    candidates: Integers  #: (c, 2) pairs whose spheres overlap
    grown: Floats  #: (c,) distance within which they count as colliding, metres
    balls: Integers  #: (q,) balls near a link


@njit
def with_own_clouds(checked: Checked) -> Checked:
    """Return a copy whose bodies of clouds can be moved, or the same if there are none."""
    if len(checked.clouds.bodies) == 0:
        return checked
    b = checked.bodies
    bodies = LinkBodies(
        b.frames, b.centers.copy(), b.rotations, b.half_extents, b.spheres, b.inner, b.boxes,
        b.rounds, b.radii, b.reaches, b.excess, b.blocks.copy(), b.starts,
    )  # fmt: skip
    tree, _, clouds, tests, owners, chains, meshes = checked
    return Checked(tree, bodies, clouds, tests, owners, chains, meshes)


@njit
def without_clouds(checked: Checked) -> Checked:
    """Return robots and the world without clouds."""
    tree, bodies, clouds, tests, owners, chains, meshes = checked
    none = Clouds(
        clouds.bodies[:0], clouds.centers, clouds.rotations, clouds.nodes, clouds.levels,
        clouds.tops,
    )  # fmt: skip
    return Checked(tree, bodies, none, tests, owners, chains, meshes)


@njit
def most_pairs(checked: Checked) -> int:
    """Return the number of pairs that are tested, with balls."""
    tests = checked.tests
    return len(tests.pairs) + tests.first * (len(tests.order) + most_balls(checked.clouds))


@njit
def most_balls(clouds: Clouds) -> int:
    """Return a bound of the number of balls."""
    return LANES * len(clouds.nodes)


@njit
def new_placed(checked: Checked) -> Placed:
    """Return arrays for one state, with the bodies of the world placed."""
    bodies, tests, links = checked.bodies, checked.tests, len(checked.tree.parents)
    count, first = len(bodies.frames), tests.first
    most = most_pairs(checked)
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
        np.empty(most_balls(checked.clouds), np.int64),
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
    """Return a bound on the error of the place of body i, and of tests with it, m."""
    return LINK_PLACING * (bodies.reaches[i] + sum_abs(center)) + MESH_UNDERFLOW


@njit(inline=True, refcount=False)
def placed_box(bodies: LinkBodies, placed: Placed, i: int) -> BoxAt:
    """Return the box of body i; its axes are computed at the first call in a state."""
    axes = placed.axes
    if not placed.ready[i]:
        placed.ready[i] = True
        turn = rows_at(placed.rotations, bodies.frames[i])
        x, y, z = axes_of(bodies.rotations, i)
        x, y, z = components(turn, x), components(turn, y), components(turn, z)
        for k in range(3):
            axes[i, k, 0], axes[i, k, 1], axes[i, k, 2] = x[k], y[k], z[k]
    return box_at(BoxArrays(placed.centers, axes, bodies.half_extents), i)


def one_tree(robots: Sequence[Mechanism], bases: Floats) -> Tree:
    """Return the trees of robots as one tree, with roots at bases (r, 7)."""
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
    """Return bounds (links,) of the distance of each link from the root, m.

    Joints without limits add nothing.
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
    """The limits of the joints of several robots, including those of joints that mimic."""

    def __init__(self, robots: Sequence[Mechanism]) -> None:
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
                    mimic = float(multipliers[k]), float(offsets[k]), joint.lower, joint.upper
                    self._mimics.append((first + int(columns[k]), *mimic))
            columns = robot.tree.columns[robot.tree.kinds == FLOATING]
            self.floating += (first + columns).tolist()
            first += len(robot.joint_names)
        self._inner = np.clip([self.lower, self.upper], -MAX_MAGNITUDE, MAX_MAGNITUDE)
        self._inner[0, self.floating] = np.inf  # whose quaternions must be checked
        for column, multiplier, offset, lower, upper in self._mimics:
            if multiplier == 0.0:
                self._inner[0, column] = np.inf
                continue
            ends = (lower - offset) / multiplier, (upper - offset) / multiplier
            self._inner[0, column] = max(self._inner[0, column], min(ends))
            self._inner[1, column] = min(self._inner[1, column], max(ends))

    def hold(self, states: Any) -> bool:
        """Return whether ``states`` is an array (n, joints) of states within the limits.

        It is a fast test for most input: False for some valid arrays, too.
        """
        return (
            type(states) is np.ndarray
            and states.dtype is FLOAT64
            and states.flags.carray
            and states.shape[1:] == self.lower.shape
            and _are_between(states, self._inner)
        )

    def exceeded(self, states: Floats, others: Floats | None = None) -> Mask:
        """Return a mask (n, joints) of joints beyond their limits, or with mimics beyond theirs.

        others: more states (n, joints) for the same rows.
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
    """Raise ValueError if the quaternion of a floating joint would move through zero.

    floating: the first columns of floating joints.
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
    """Return (links,) the first link of the rigid group of each link."""
    groups = np.arange(len(tree.parents))
    for row, parent in enumerate(tree.parents.tolist()):
        if parent >= 0 and tree.kinds[row] == FIXED:
            groups[row] = groups[parent]
    return groups


def next_joint(tree: Tree, link: int) -> int:
    """Return the nearest link, from this one to the root, whose joint moves; -1 for none."""
    while link >= 0 and (tree.kinds[link] == FIXED or tree.multipliers[link] == 0.0):
        link = int(tree.parents[link])
    return link


def allowed_links(robots: Sequence[Mechanism], groups: Rows) -> Mask:
    """Return (links, links) which pairs are not checked: rigid groups, adjacent or disabled."""
    allowed = groups[:, None] == groups
    first = 0
    for robot in robots:
        rows = {name: first + row for row, name in enumerate(robot.link_names)}
        for a, b in robot.disabled_pairs | robot.adjacent_pairs:
            allowed[rows[a], rows[b]] = allowed[rows[b], rows[a]] = True
        first += len(rows)
    return allowed


def body_pairs(owners: Rows, allowed: Mask) -> Integers:
    """Return the pairs of bodies (p, 2) whose owners are checked against each other."""
    first, second = np.triu_indices(len(owners), 1)
    checked = ~allowed[owners[first], owners[second]]
    return np.column_stack([first[checked], second[checked]])


def chains_of(tree: Tree, bodies: LinkBodies, pairs: Integers, first: int, boxes: bool) -> Chains:
    """Return the chains to the first bodies, those of robots, and between pairs (p, 2) of them.

    boxes: whether they end at the spheres and boxes around bodies, instead of their hulls.
    """
    turning = (tree.kinds != FIXED) & (tree.kinds < PRISMATIC)
    back = tree.rotations * (-1.0, -1.0, -1.0, 1.0)
    axes = rotate_vectors(back, tree.directions) * turning[:, None]  # in the frames of links
    roots = tree.parents[:, None] < 0
    links = _split(tree.translations, np.where(roots, 0.0, axes[tree.parents]))
    extents = np.empty((first, 2))
    for i, frame in enumerate(bodies.frames[:first].tolist()):
        blocks = bodies.blocks[bodies.starts[i] : bodies.starts[i + 1]]
        corners = _split(blocks.transpose(0, 2, 1).reshape(-1, 3), axes[frame])
        extents[i] = corners.max(axis=0) + bodies.rounds[i] * LENGTH_GROWTH
        if boxes:
            radius = max(bodies.spheres[i], np.linalg.norm(bodies.half_extents[i]))
            extents[i] = 0.0, (np.linalg.norm(bodies.centers[i]) + radius) * LENGTH_GROWTH
    unique, rows = np.unique(bodies.frames[pairs], axis=0, return_inverse=True)
    paths = [_path(tree, links, a, b) for a, b in unique.tolist()]
    steps = [step for path in paths for step in path]
    lengths = np.array([step[:2] for step in steps]).reshape(-1, 2)
    joints = np.array([step[2] for step in steps], np.int64)
    starts = np.cumsum([0, *map(len, paths)])
    return Chains(links, extents, rows.reshape(-1), starts, lengths, joints)


def _split(vectors: Floats, axes: Floats) -> Floats:
    """Return the lengths (n, 2) of vectors (n, 3) along unit axes (or zeros), and across them."""
    along = (vectors * axes).sum(axis=1)
    across = vectors - along[:, None] * axes
    lengths = np.column_stack([np.abs(along), np.linalg.norm(across, axis=1)])
    room = LENGTH_GROWTH - 1.0  # for roundings of orthogonal vectors
    return lengths * LENGTH_GROWTH + room * np.linalg.norm(vectors, axis=1)[:, None]


def _path(tree: Tree, links: Floats, a: int, b: int) -> list[tuple[float, float, int]]:
    """Return the segments of the chain from link a to link b.

    Each is its length along the axis of the joint before it, its length across that axis (m), and
    the row of the joint behind it, -1 for none.
    """
    up, down = [a], [b]
    while up[-1] != down[-1]:  # parents stand before children
        chain = up if up[-1] > down[-1] else down
        chain.append(int(tree.parents[chain[-1]]))
    steps, place = [], np.zeros(3)  # from the origin of the current link
    for link in up[:-1]:
        steps.append((0.0, float(np.linalg.norm(place)) * LENGTH_GROWTH, link))
        place = -tree.translations[link]
    for number, link in enumerate(down[-2::-1]):
        along, across = links[link].tolist()
        if number == 0:  # the joint of the common ancestor does not count
            place = place + tree.translations[link]
            along, across = 0.0, float(np.linalg.norm(place)) * LENGTH_GROWTH
            place = np.zeros(3)
        steps.append((along, across, link))
    steps.append((0.0, float(np.linalg.norm(place)) * LENGTH_GROWTH, -1))
    return steps
