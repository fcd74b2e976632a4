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

"""Which links of a robot can collide with each other at all, proved over all of its states.

"never" and "always" are proved by branch and bound over the limits of the joints between two links
(``cells``), for the convex bodies that stand for shapes at accuracy ``hull``; "can collide" comes
with a state in which they do. What is neither proved nor found in time is undecided.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from obb_collision.geometry.shapes.primitives import positive_number
from obb_collision.geometry.validation import check_kind
from obb_collision.numerics.intrinsics import in_blocks
from obb_collision.robots.bodies.bodies import Body, body_of
from obb_collision.robots.bodies.robot_arrays import chain_lengths
from obb_collision.robots.description.robot import Robot
from obb_collision.robots.description.srdf import sorted_pair
from obb_collision.robots.proofs.cell_bounds import Moving
from obb_collision.robots.proofs.cells import (
    FOUND,
    GOES_ON,
    MOST_CELLS,
    PROVED,
    descend_from,
    find_state,
    search_cells,
)
from obb_collision.robots.proofs.chains import Between, Chain, chains_between
from obb_collision.typing import Floats

NEVER, ALWAYS, ADJACENT, CAN_COLLIDE, UNDECIDED = (
    "never", "always", "adjacent", "can collide", "undecided"
)  # fmt: skip
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
    robot: Robot, time_limit: float = 60.0, progress: Callable[[PairProof], None] | None = None
) -> list[PairProof]:
    """Return what is proved of each pair of links with shapes, for all states within the limits.

    Bodies are those of accuracy ``hull``. Joints without limits turn once around; where one that
    slides, or a planar or floating one, has none, a pair is undecided. The SRDF does not matter.

    Parameters
    ----------
    robot : Robot
    time_limit : float
        Seconds for all pairs; what is not done by then is undecided.
    progress : callable, optional
        Called with each ``PairProof`` when it is done.

    Returns
    -------
    list of PairProof
        In the order of the links.

    Raises
    ------
    ValueError
        Naming the argument.

    Examples
    --------
    >>> ball = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    >>> links = "".join(f'<link name="{name}">{ball}</link>' for name in "abc")
    >>> joints = "".join(
    ...     f'<joint name="{a}{b}" type="revolute"><parent link="{a}"/><child link="{b}"/>'
    ...     '<origin xyz="0.3 0 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint>'
    ...     for a, b in ("ab", "bc")
    ... )
    >>> robot = oc.Robot.from_urdf(f'<robot name="r">{links}{joints}</robot>')
    >>> for proof in oc.prove_pairs(robot):
    ...     print(*proof.links, proof.verdict)
    a b adjacent
    a c never
    b c adjacent
    """
    check_kind(robot, Robot, "robot")
    limit = positive_number(time_limit, "time_limit")
    bodies = _bodies(robot)
    order = [sorted_pair(a, b) for a, b in combinations(bodies, 2)]
    done: dict[tuple[str, str], PairProof] = {}
    waiting = []
    for links in order:
        between = None if links in robot.adjacent_pairs else chains_between(robot, *links)
        if between is not None:
            waiting.append(_Pair(robot, links, between, bodies[links[0]], bodies[links[1]]))
            continue
        done[links] = PairProof(links, ADJACENT if links in robot.adjacent_pairs else UNDECIDED)
        if progress is not None:
            progress(done[links])
    for pair in waiting[:1]:
        pair.load_kernels()
    end = time.monotonic() + limit
    waiting.sort(key=lambda pair: len(pair.between.rows))
    for left, pair in zip(range(len(waiting), 0, -1), waiting, strict=True):
        start = time.monotonic()
        proof = pair.prove(start + SHARE * max(end - start, 0.0) / (left + SHARE - 1.0))
        done[proof.links] = proof
        if progress is not None:
            progress(proof)
    return [done[links] for links in order]


def _bodies(robot: Robot) -> dict[str, list[Body]]:
    """Return the bodies of all links with shapes, as checks of states have them."""
    chains = chain_lengths(robot.tree, robot.lower, robot.upper).tolist()
    return {
        link: [body_of(shape, pose, chain=chain) for shape, pose in shapes]
        for link, shapes, chain in zip(robot.link_names, robot.shapes, chains, strict=True)
        if shapes
    }


class _Pair:
    """A pair of links and what moves them relative to each other."""

    def __init__(
        self, robot: Robot, links: tuple[str, str], between: Between, a: list[Body], b: list[Body]
    ) -> None:
        self._robot, self.links, self.between = robot, links, between
        self._bodies = [
            (_moving(one, between.a), _moving(other, between.b)) for one in a for other in b
        ]
        self._limits: Floats = np.array([between.lower, between.upper])
        self._cells = 0

    def prove(self, end: float) -> PairProof:
        """Return what can be proved until a time."""
        start = time.monotonic()
        verdict, state = self._decide(end)
        witness = None if state is None else self._whole(state)
        return PairProof(self.links, verdict, witness, self._cells, time.monotonic() - start)

    def load_kernels(self) -> None:
        """Compile or load the kernels, which takes up to a minute the first time."""
        a, b = self._bodies[0]
        count = len(self.between.rows)
        find_state(a, b, np.empty((0, count)), True)
        descend_from(a, b, np.empty((0, count)), self._limits, np.empty(count))
        cells = np.empty((1, 2, count))
        search_cells(a, b, cells, 0, 0, False, self._limits, np.empty(count))

    def _decide(self, end: float) -> tuple[str, Floats | None]:
        between = self.between
        random = np.random.default_rng(0)
        states = random.uniform(between.lower, between.upper, (SAMPLES, len(between.rows)))
        for a, b in self._bodies:
            row = find_state(a, b, states, True)
            if row >= 0:
                return self._always(states, min(end, time.monotonic() + ALWAYS_TIME)), states[row]
        downhill = np.empty(len(between.rows))
        for a, b in self._bodies:
            if descend_from(a, b, states[:STARTS], self._limits, downhill):
                return CAN_COLLIDE, downhill
            outcome, state = self._search(a, b, end, False)
            if outcome == FOUND:
                return CAN_COLLIDE, state
            if outcome != PROVED:
                return UNDECIDED, None
        return NEVER, None

    def _always(self, states: Floats, end: float) -> str:
        """Return whether the links collide always, or can do so only."""
        for a, b in self._bodies:
            if find_state(a, b, states, False) < 0 and self._search(a, b, end, True)[0] == PROVED:
                return ALWAYS
        return CAN_COLLIDE

    def _search(self, a: Moving, b: Moving, end: float, always: bool) -> tuple[int, Floats]:
        """Search the cells of a pair of bodies until a time."""
        count = len(self.between.rows)
        cells = np.empty((MOST_CELLS + 1, 2, count))
        cells[0] = self._limits
        state, waiting, outcome = np.empty(count), 1, GOES_ON
        while outcome == GOES_ON and time.monotonic() < end:
            outcome, waiting, visited = search_cells(
                a, b, cells, waiting, CELLS, always, self._limits, state
            )
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


def _moving(body: Body, chain: Chain) -> Moving:
    x, y, z = body.center.tolist()
    sphere = max(body.sphere - body.round, 0.0)
    return Moving(chain, in_blocks(body.corners), (x, y, z), sphere, body.round, body.reach)
