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

"""Proofs of which links of a robot can collide with each other at all, over all of its states.

"never" and "always" are proved by branch and bound over the limits of the joints between two links
(``cells``), for the convex bodies that stand for shapes at accuracy ``hull``; "can collide" comes
with a state in which they do. What is neither proved nor found in time is undecided.

Seen from a frame in the middle, each link is moved by half of the joints: bounds of their motion,
which grow with the square of the number of joints, are a quarter of those seen from a link.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from obb_collision.geometry.poses import IDENTITY_POSE, compose_poses, inverse_poses, rotation_of
from obb_collision.robots.checks.arrays import LinkBodies, chain_lengths
from obb_collision.robots.checks.bodies import body_of
from obb_collision.robots.description.joints import driven
from obb_collision.robots.description.srdf import sorted_pair
from obb_collision.robots.description.urdf import Joint, JointKind
from obb_collision.robots.proofs.cells import (
    FOUND,
    GOES_ON,
    MOST_CELLS,
    PROVED,
    Chain,
    Moving,
    MovingPair,
    descend_from,
    find_state,
    search_cells,
)
from obb_collision.typing import Floats

if TYPE_CHECKING:
    from obb_collision.robots.robot import Robot

NEVER, ALWAYS, ADJACENT = "never", "always", "adjacent"
CAN_COLLIDE, UNDECIDED = "can collide", "undecided"
#: Random states in which a collision is looked for first: those that are frequent are found so.
SAMPLES = 1000
#: Of them, from which one goes downhill to collisions that are rare: a hundredth of a second.
STARTS = 30
#: Cells visited between two looks at the clock: about a tenth of a second.
CELLS = 10_000
#: The share of the time that one pair may take of what is left, for each that is left.
SHARE = 4.0
#: Seconds for "always", which is tried after a pair was found to collide in all samples.
ALWAYS_TIME = 2.0
#: The axis of a joint that has none.
DEFAULT_AXIS = (1.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class PairProof:
    """What is proved of a pair of links.

    Attributes
    ----------
    links : (str, str)
        Sorted.
    verdict : str
        "never", "always", "adjacent", "can collide" or "undecided".
    witness : (joints,) numpy.ndarray or None
        A state of the robot in which they collide, for "can collide".
    cells : int
        Boxes of states that were looked at.
    seconds : float
        That it took.
    """

    links: tuple[str, str]
    verdict: str
    witness: Floats | None = None
    cells: int = 0
    seconds: float = 0.0


def prove_pairs(
    robot: Robot, seconds: float, progress: Callable[[PairProof], None] | None
) -> list[PairProof]:
    """Prove pairs of links for `Robot.prove_pairs`; the seconds are validated."""
    bodies = _bodies(robot)
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
    for pair in waiting[:1]:
        pair.load_kernels()
    end = time.monotonic() + seconds
    waiting.sort(key=lambda pair: len(pair.between.rows))
    for left, pair in zip(range(len(waiting), 0, -1), waiting, strict=True):
        start = time.monotonic()
        proof = pair.prove(start + SHARE * max(end - start, 0.0) / (left + SHARE - 1.0))
        done[proof.links] = proof
        if progress is not None:
            progress(proof)
    return [done[links] for links in order]


def _bodies(robot: Robot) -> dict[str, list[LinkBodies]]:
    """Return the bodies of all links with shapes, as checks of states have them."""
    chains = chain_lengths(robot.tree, robot.lower, robot.upper).tolist()
    return {
        link: [body_of(shape, pose, chain=chain) for shape, pose in shapes]
        for link, shapes, chain in zip(robot.link_names, robot.shapes, chains, strict=True)
        if shapes
    }


class _Between(NamedTuple):
    """What moves two links relative to each other: two chains, and variables with limits."""

    chains: tuple[Chain, Chain]
    rows: list[int]  #: (v,) the variables in a state of the robot
    limits: Floats  #: (2, v)


class _LinkPair:
    """A pair of links and what moves them relative to each other."""

    def __init__(
        self,
        robot: Robot,
        links: tuple[str, str],
        between: _Between,
        bodies: dict[str, list[LinkBodies]],
    ) -> None:
        self._robot, self.links, self.between = robot, links, between
        a, b = (
            [_moving(body, chain) for body in bodies[link]]
            for link, chain in zip(links, between.chains, strict=True)
        )
        self._pairs = [MovingPair(one, other, between.limits) for one in a for other in b]
        self._cells = 0

    def prove(self, end: float) -> PairProof:
        """Prove as many pairs as possible until a time."""
        start = time.monotonic()
        verdict, state = self._decide(end)
        witness = None if state is None else self._whole(state)
        return PairProof(self.links, verdict, witness, self._cells, time.monotonic() - start)

    def load_kernels(self) -> None:
        """Compile or load the kernels, which takes up to a minute the first time."""
        find_state(self._pairs[0], np.empty((0, len(self.between.rows))), True)

    def _decide(self, end: float) -> tuple[str, Floats | None]:
        lower, upper = self.between.limits
        states = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, len(lower)))
        for pair in self._pairs:
            row = find_state(pair, states, True)
            if row >= 0:
                return self._always(states, min(end, time.monotonic() + ALWAYS_TIME)), states[row]
        downhill = np.empty(len(lower))
        for pair in self._pairs:
            if descend_from(pair, states[:STARTS], downhill):
                return CAN_COLLIDE, downhill
            outcome, state = self._search(pair, end, False)
            if outcome == FOUND:
                return CAN_COLLIDE, state
            if outcome != PROVED:
                return UNDECIDED, None
        return NEVER, None

    def _always(self, states: Floats, end: float) -> str:
        """Return whether the links collide always, or can do so only."""
        for pair in self._pairs:
            if find_state(pair, states, False) < 0 and self._search(pair, end, True)[0] == PROVED:
                return ALWAYS
        return CAN_COLLIDE

    def _search(self, pair: MovingPair, end: float, always: bool) -> tuple[int, Floats]:
        """Search the cells of a pair of bodies until a time."""
        cells = np.empty((MOST_CELLS + 1, *pair.limits.shape))
        cells[0] = pair.limits
        state, waiting, outcome = np.empty(pair.limits.shape[1]), 1, GOES_ON
        while outcome == GOES_ON and time.monotonic() < end:
            outcome, waiting, visited = search_cells(pair, cells, waiting, CELLS, always, state)
            self._cells += visited
        return outcome, state

    def _whole(self, state: Floats) -> Floats:
        """Return a state of the robot: what has no part in it is as near to zero as it can be."""
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
    """A joint on the way from one link to another, up to the parent or down to the child."""

    joint: Joint
    is_up: bool


def _between(robot: Robot, a: str, b: str) -> _Between | None:
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
    undone = [_Step(step.joint, not step.is_up) for step in steps[:middle]][::-1]
    back, on = (_chain(robot, way, names, rows) for way in (undone, steps[middle:]))
    return _Between((back, on), rows, np.array([lower, upper]))


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
    table: list[Any] = [np.array([each[k] for each in moving], kind) for k, kind in kinds]
    return Chain(places, turns, table[0].reshape(-1, 3), *table[1:])
