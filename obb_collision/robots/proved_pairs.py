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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from obb_collision.numerics.lanes import in_blocks
from obb_collision.robots.bodies import Body, body_of
from obb_collision.robots.cells import (
    FOUND,
    GOES_ON,
    MOST_CELLS,
    PROVED,
    Moving,
    find_state,
    search_cells,
)
from obb_collision.robots.chains import Between, Chain, chains_between
from obb_collision.robots.robot import Robot
from obb_collision.typing import Floats

NEVER, ALWAYS, ADJACENT, CAN_COLLIDE, UNDECIDED = (
    "never", "always", "adjacent", "can collide", "undecided"
)  # fmt: skip
#: Random states in which a collision is looked for first: those that are frequent are found so.
SAMPLES = 1000
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
    """Return what is proved of each pair of links with shapes, in the order of the links.

    time_limit: seconds for all pairs. progress: called with each, in the order in which they are
    done.
    """
    end = time.monotonic() + time_limit
    bodies = {
        link: [body_of(shape, pose) for shape, pose in shapes]
        for link, shapes in zip(robot.link_names, robot.shapes, strict=True)
        if shapes
    }
    waiting = []
    done: dict[tuple[str, str], PairProof] = {}
    for a, b in combinations(bodies, 2):
        links = (min(a, b), max(a, b))
        if links in robot.adjacent_pairs:
            done[links] = PairProof(links, ADJACENT)
            continue
        between = chains_between(robot, *links)
        if between is None:
            done[links] = PairProof(links, UNDECIDED)
        else:
            waiting.append(_Pair(robot, links, between, bodies[links[0]], bodies[links[1]]))
    if progress is not None:
        for proof in done.values():
            progress(proof)
    waiting.sort(key=lambda pair: len(pair.between.rows))
    for left, pair in zip(range(len(waiting), 0, -1), waiting, strict=True):
        start = time.monotonic()
        proof = pair.prove(start + SHARE * max(end - start, 0.0) / (left + SHARE - 1.0))
        done[proof.links] = proof
        if progress is not None:
            progress(proof)
    order = [(min(a, b), max(a, b)) for a, b in combinations(bodies, 2)]
    return [done[links] for links in order]


class _Pair:
    """A pair of links and what moves them relative to each other."""

    def __init__(
        self, robot: Robot, links: tuple[str, str], between: Between, a: list[Body], b: list[Body]
    ) -> None:
        self._robot, self.links, self.between = robot, links, between
        self._bodies = [
            (_moving(one, between.a), _moving(other, between.b)) for one in a for other in b
        ]
        self._cells = 0

    def prove(self, end: float) -> PairProof:
        """Return what can be proved until a time."""
        start = time.monotonic()
        verdict, state = self._decide(end)
        witness = None if state is None else self._whole(state)
        return PairProof(self.links, verdict, witness, self._cells, time.monotonic() - start)

    def _decide(self, end: float) -> tuple[str, Floats | None]:
        between = self.between
        random = np.random.default_rng(0)
        states = random.uniform(between.lower, between.upper, (SAMPLES, len(between.rows)))
        for a, b in self._bodies:
            row = find_state(a, b, states, True)
            if row >= 0:
                return self._always(states, min(end, time.monotonic() + ALWAYS_TIME)), states[row]
        for a, b in self._bodies:
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
        limits = cells[0] = np.array([self.between.lower, self.between.upper])
        state, waiting, outcome = np.empty(count), 1, GOES_ON
        while outcome == GOES_ON and time.monotonic() < end:
            outcome, waiting, visited = search_cells(
                a, b, cells, waiting, CELLS, always, limits, state
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
    return Moving(chain, in_blocks(body.corners), (x, y, z), body.sphere, body.round, body.reach)


def rigid(proofs: list[PairProof]) -> Iterator[PairProof]:
    """Yield the proofs of pairs that need not be checked."""
    return (proof for proof in proofs if proof.verdict in (NEVER, ALWAYS, ADJACENT))
