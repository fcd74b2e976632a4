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

"""Proofs of which links of a robot can collide with each other in any state within its limits.

"never" and "always" are proved by branch and bound over the limits of the joints between two links
(``cells``), for their bodies at accuracy ``hull``. "can collide" comes with a colliding state.

Both links are seen from a frame in the middle of the joints between them, so that each is moved by
half of the joints. Bounds of motion grow with the square of the number of joints, so they are a
quarter of those seen from one of the links.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from obb_collision.geometry.poses import IDENTITY_POSE, compose_poses, inverse_poses, rotation_of
from obb_collision.robots.checks.arrays import LinkBodies, chain_lengths
from obb_collision.robots.checks.bodies import body_of
from obb_collision.robots.description.joints import Mechanism, driven
from obb_collision.robots.description.srdf import sorted_pair
from obb_collision.robots.description.urdf import Joint, JointKind
from obb_collision.robots.proofs.cells import (
    DISPROVED,
    MOST_CELLS,
    PROVED,
    SEARCHING,
    Chain,
    Moving,
    MovingPair,
    descend_from,
    find_state,
    search_cells,
)
from obb_collision.typing import Floats

#: The verdicts of a ``PairProof``.
NEVER_COLLIDE, ALWAYS_COLLIDE, ADJACENT = "never", "always", "adjacent"
CAN_COLLIDE, UNDECIDED = "can collide", "undecided"
#: Random states that are checked first: frequent collisions are among them.
SAMPLES = 1000
#: Samples from which a descent looks for rare collisions: a hundredth of a second.
STARTS = 30
#: Cells visited between two looks at the clock: about a tenth of a second.
CELLS = 10_000
#: How many times its equal share of the remaining time a pair may take.
SHARE = 4.0
#: Seconds for a proof of "always", which is tried for a pair that collides in all samples.
ALWAYS_TIME = 2.0
#: The axis of a joint whose description has none.
DEFAULT_AXIS = (1.0, 0.0, 0.0)
TURNING = (JointKind.REVOLUTE, JointKind.CONTINUOUS)


@dataclass(frozen=True, eq=False)
class PairProof:
    """Whether a pair of links can collide, and how this was proved.

    Attributes
    ----------
    links : (str, str)
        Names of the links, sorted.
    verdict : str
        "never", "always", "adjacent", "can collide" or "undecided".
    witness : (joints,) numpy.ndarray or None
        A state of the robot in which both links collide, for "can collide".
    cells : int
        Boxes of states that the proof visited.
    seconds : float
        The time that the proof took.
    """

    links: tuple[str, str]
    verdict: str
    witness: Floats | None = None
    cells: int = 0
    seconds: float = 0.0


def prove_pairs(
    robot: Mechanism, seconds: float, progress: Callable[[PairProof], None] | None
) -> list[PairProof]:
    """Prove all pairs of links with shapes, see ``Robot.prove_pairs``."""
    chains = chain_lengths(robot.tree, robot.lower, robot.upper).tolist()
    bodies = {  # as checks of states have them
        link: [body_of(shape, pose, chain=chain) for shape, pose in shapes]
        for link, shapes, chain in zip(robot.link_names, robot.shapes, chains, strict=True)
        if shapes
    }
    order = [sorted_pair(a, b) for a, b in combinations(bodies, 2)]
    done: dict[tuple[str, str], PairProof] = {}
    waiting = []
    for links in order:
        between = None if links in robot.adjacent_pairs else _between(robot, *links)
        if between is not None:
            waiting.append(_LinkPair(robot, links, between, bodies))
            continue
        done[links] = PairProof(links, ADJACENT if links in robot.adjacent_pairs else UNDECIDED)
        if progress is not None:
            progress(done[links])
    for pair in waiting[:1]:  # kernels are compiled, or loaded, before the time begins
        find_state(pair.bodies[0], np.empty((0, len(pair.between.rows))), True)
    end = time.monotonic() + seconds
    waiting.sort(key=lambda pair: len(pair.between.rows))
    for left, pair in zip(range(len(waiting), 0, -1), waiting, strict=True):
        start = time.monotonic()
        proof = pair.prove(start + SHARE * max(end - start, 0.0) / (left + SHARE - 1.0))
        done[proof.links] = proof
        if progress is not None:
            progress(proof)
    return [done[links] for links in order]


class _Between(NamedTuple):
    """The joints between two links: a chain to each from a frame in the middle."""

    chains: tuple[Chain, Chain]
    rows: list[int]  #: (v,) their variables in a state of the robot
    limits: Floats  #: (2, v)


class _LinkPair:
    """A pair of links, the joints between them, and their pairs of bodies."""

    def __init__(
        self,
        robot: Mechanism,
        links: tuple[str, str],
        between: _Between,
        bodies: dict[str, list[LinkBodies]],
    ) -> None:
        self._robot, self.links, self.between = robot, links, between
        a, b = (
            [_moving(body, chain) for body in bodies[link]]
            for link, chain in zip(links, between.chains, strict=True)
        )
        self.bodies = [MovingPair(first, second, between.limits) for first in a for second in b]
        self._cells = 0

    def prove(self, end: float) -> PairProof:
        """Return what can be proved of the pair until a time."""
        start = time.monotonic()
        verdict, state = self._decide(end)
        witness = None if state is None else self._whole(state)
        return PairProof(self.links, verdict, witness, self._cells, time.monotonic() - start)

    def _decide(self, end: float) -> tuple[str, Floats | None]:
        lower, upper = self.between.limits
        states = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, len(lower)))
        for pair in self.bodies:
            row = find_state(pair, states, True)
            if row >= 0:
                return self._always(states, min(end, time.monotonic() + ALWAYS_TIME)), states[row]
        downhill = np.empty(len(lower))
        for pair in self.bodies:
            if descend_from(pair, states[:STARTS], downhill):
                return CAN_COLLIDE, downhill
            outcome, state = self._search(pair, end, False)
            if outcome == DISPROVED:
                return CAN_COLLIDE, state
            if outcome != PROVED:
                return UNDECIDED, None
        return NEVER_COLLIDE, None

    def _always(self, states: Floats, end: float) -> str:
        """Return the verdict of links that collide in some state: always, or only in some."""
        for pair in self.bodies:
            if find_state(pair, states, False) < 0 and self._search(pair, end, True)[0] == PROVED:
                return ALWAYS_COLLIDE
        return CAN_COLLIDE

    def _search(self, pair: MovingPair, end: float, always: bool) -> tuple[int, Floats]:
        """Search the cells of a pair of bodies until a time."""
        cells = np.empty((MOST_CELLS + 1, *pair.limits.shape))
        cells[0] = pair.limits
        state, waiting, outcome = np.empty(pair.limits.shape[1]), 1, SEARCHING
        while outcome == SEARCHING and time.monotonic() < end:
            outcome, waiting, visited = search_cells(pair, cells, waiting, CELLS, always, state)
            self._cells += visited
        return outcome, state

    def _whole(self, state: Floats) -> Floats:
        """Return the state of the whole robot for a state of the joints between the links.

        All other joints are as near to zero as limits allow.
        """
        whole = np.clip(0.0, self._robot.lower, self._robot.upper)
        for column, name in enumerate(self._robot.joint_names):
            if name.endswith("/rot_w"):
                whole[column] = 1.0
        whole[self.between.rows] = state
        return whole


def _moving(body: LinkBodies, chain: Chain) -> Moving:
    x, y, z = body.centers[0].tolist()
    radius, reach = float(body.rounds[0]), float(body.reaches[0])
    sphere, count = max(float(body.spheres[0]) - radius, 0.0), len(chain.axes)
    axes, values = np.empty((2, count, 3)), np.empty((2, count))
    return Moving(chain, body.blocks, (x, y, z), sphere, radius, reach, *axes, *values)


class _Step(NamedTuple):
    """A joint on the way between two links, passed up to its parent or down to its child."""

    joint: Joint
    is_up: bool


def _between(robot: Mechanism, a: str, b: str) -> _Between | None:
    """Return the joints between two links; None if one of them has no limits."""
    steps = _way(robot, a, b)
    names = {joint.name: joint for joint in robot.joints}
    moving = [k for k, step in enumerate(steps) if step.joint.kind is not JointKind.FIXED]
    if any(steps[k].joint.kind in (JointKind.PLANAR, JointKind.FLOATING) for k in moving):
        return None
    driver = {k: driven(steps[k].joint, names) for k in moving}
    rows = sorted({robot.joint_names.index(name) for name, _, _ in driver.values()})
    lower, upper = robot.lower[rows], robot.upper[rows]
    for column, row in enumerate(rows):
        moved = [k for k in moving if driver[k][0] == robot.joint_names[row]]
        # a whole turn of the variable changes nothing
        if all(steps[k].joint.kind in TURNING and driver[k][1].is_integer() for k in moved):
            if lower[column] <= -math.pi and upper[column] >= math.pi:
                lower[column], upper[column] = -math.pi, math.pi
            upper[column] = min(upper[column], lower[column] + 2.0 * math.pi)
        elif not np.isfinite([lower[column], upper[column]]).all():
            return None
    middle = moving[len(moving) // 2] if moving else 0
    undone = [_Step(step.joint, not step.is_up) for step in steps[:middle]][::-1]
    back, on = (_chain(robot, way, names, rows) for way in (undone, steps[middle:]))
    return _Between((back, on), rows, np.array([lower, upper]))


def _way(robot: Mechanism, a: str, b: str) -> list[_Step]:
    """Return the joints from link a to link b."""
    above = {joint.child: joint for joint in robot.joints if joint.parent in robot.link_names}

    def to_root(link: str) -> list[Joint]:
        joints = []
        while link in above:
            joints.append(above[link])
            link = above[link].parent
        return joints

    up, down = to_root(a), to_root(b)
    while up and down and up[-1] is down[-1]:
        up.pop()
        down.pop()
    return [_Step(joint, True) for joint in up] + [_Step(joint, False) for joint in down[::-1]]


def _chain(robot: Mechanism, steps: list[_Step], names: dict[str, Joint], rows: list[int]) -> Chain:
    """Return steps as a chain. A step up inverts the motion of the joint, then its origin."""
    fixed: list[Floats] = [IDENTITY_POSE]
    moving = []
    for joint, is_up in steps:
        origin = np.array(joint.pose)
        if not is_up:
            fixed[-1] = compose_poses(fixed[-1], origin)
        if joint.kind is not JointKind.FIXED:
            name, factor, offset = driven(joint, names)
            sign, slides = -1.0 if is_up else 1.0, joint.kind is JointKind.PRISMATIC
            axis, column = joint.axis or DEFAULT_AXIS, rows.index(robot.joint_names.index(name))
            moving.append((axis, slides, column, sign * factor, sign * offset))
            fixed.append(IDENTITY_POSE)
        if is_up:
            fixed[-1] = compose_poses(fixed[-1], inverse_poses(origin))
    places = np.array([pose[:3] for pose in fixed])
    turns = np.array([rotation_of(tuple(pose[3:].tolist())) for pose in fixed])
    kinds = enumerate((np.float64, np.bool_, np.int64, np.float64, np.float64))
    table: list[Any] = [np.array([joint[k] for joint in moving], kind) for k, kind in kinds]
    return Chain(places, turns, table[0].reshape(-1, 3), *table[1:])
