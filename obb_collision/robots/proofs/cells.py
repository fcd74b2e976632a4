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

"""Branch and bound over the variables between two links: what holds in a whole box of them.

In a cell, a box of variables, a direction that separates two bodies in the middle of the cell
separates them everywhere if it does so by more than the bodies can move along it (``cell_bounds``).
Likewise they collide everywhere if they are deeper in the middle than they can move.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import combined, dot, minus, negated, plus
from obb_collision.queries.convex.depth import Polytope, deepest, room_for_depth
from obb_collision.queries.meshes.tree_boxes import relative_pose
from obb_collision.robots.proofs.cell_bounds import (
    Moving,
    Work,
    add_curves,
    add_slopes,
    core_of,
    distance_of,
    least_along,
    measure,
    place_body,
    work_for,
)
from obb_collision.typing import Floats, Vector

#: What a proof must leave, relative to the reach of both bodies: far above all rounding, and above
#: what counts as touching in checks of states.
SLACK = 1e-9
#: The same of the depth of two bodies, which is found by a search.
DEPTH_SLACK = 1e-6
#: A cell narrower than this in all its variables, radians or metres, is not divided.
NARROWEST = 1e-5
#: How a search ended, or that it goes on.
GOES_ON, PROVED, FOUND, UNDECIDED = 0, 1, 2, 3
#: Steps downhill from where a cell could not be decided, how much farther than to the contact each
#: goes, and its longest in a variable, radians or metres.
STEPS, FARTHER, LONGEST = 100, 1.5, 0.3
#: Cells that may wait: each division leaves one, and no variable is divided more than 60 times.
MOST_CELLS = 4096


@njit
def search_cells(
    a: Moving, b: Moving, cells: Floats, waiting: int, most: int, always: bool, limits: Floats,
    witness: Floats,
) -> tuple[int, int, int]:  # fmt: skip
    """Go on with a search; return how it ended, how many cells wait, and how many were visited.

    cells (MOST_CELLS + 1, 2, v): lower and upper limits of those that wait. most: how many to
    visit. always: whether to prove that the bodies collide everywhere, and not nowhere. limits
    (2, v): of all states. witness (v,): a state that shows that it is not so (FOUND), or where it
    could not be decided.
    """
    work, room = work_for(a, b), room_for_depth()
    visited = 0
    while waiting > 0:
        if visited == most:
            return GOES_ON, waiting, visited
        waiting -= 1
        visited += 1
        lower, upper = cells[waiting, 0], cells[waiting, 1]
        for v in range(len(witness)):
            witness[v] = 0.5 * (lower[v] + upper[v])
        proved, collides, column = _look(a, b, lower, upper, witness, always, work, room)
        if proved:
            continue
        if collides != always:
            return FOUND, waiting, visited
        if column < 0 or upper[column] - lower[column] < NARROWEST or waiting + 2 > MOST_CELLS:
            found = not always and _descend(a, b, witness, limits, work)
            return FOUND if found else UNDECIDED, waiting, visited
        for v in range(len(witness)):
            cells[waiting + 1, 0, v], cells[waiting + 1, 1, v] = lower[v], upper[v]
        cells[waiting, 1, column] = cells[waiting + 1, 0, column] = witness[column]
        waiting += 2
    return PROVED, 0, visited


@njit
def find_state(a: Moving, b: Moving, states: Floats, collides: bool) -> int:
    """Return the first of states (n, v) in which the bodies collide, or do not; -1 for none."""
    work = work_for(a, b)
    for n in range(len(states)):
        place_a, place_b = place_body(a, states[n], 0, work), place_body(b, states[n], 1, work)
        found = distance_of(a, place_a, b, place_b)
        if (found.distance <= a.round + b.round) == collides:
            return n
    return -1


@njit
def descend_from(
    a: Moving, b: Moving, states: Floats, limits: Floats, witness: Floats
) -> bool:  # fmt: skip
    """Return whether going downhill from one of states (n, v) finds a collision: ``witness``."""
    work = work_for(a, b)
    for n in range(len(states)):
        for v in range(len(witness)):
            witness[v] = states[n, v]
        if _descend(a, b, witness, limits, work):
            return True
    return False


@njit
def _descend(a: Moving, b: Moving, state: Floats, limits: Floats, work: Work) -> bool:
    """Move a state to where the bodies collide; return whether there is such a place near it."""
    slopes = np.empty(len(state))
    for _ in range(STEPS):
        place_a, place_b = place_body(a, state, 0, work), place_body(b, state, 1, work)
        found = distance_of(a, place_a, b, place_b)
        gap = found.distance - a.round - b.round
        if gap <= 0.0:
            return True
        n = combined(place_a.axes, found.normal)
        p = plus(place_a.center, combined(place_a.axes, found.p))
        q = plus(place_b.center, combined(place_b.axes, found.q))
        slopes[:] = 0.0
        add_slopes(a, p, negated(n), 0, work, slopes)
        add_slopes(b, q, n, 1, work, slopes)
        total = 0.0
        for v in range(len(state)):
            blocked = state[v] <= limits[0, v] if slopes[v] > 0.0 else state[v] >= limits[1, v]
            slopes[v] = 0.0 if blocked else slopes[v]
            total += slopes[v] * slopes[v]
        if total == 0.0:
            return False
        for v in range(len(state)):
            step = -FARTHER * gap * slopes[v] / total
            step = min(max(step, -LONGEST), LONGEST)
            state[v] = min(max(state[v] + step, limits[0, v]), limits[1, v])
    return False


@njit
def _look(
    a: Moving, b: Moving, lower: Floats, upper: Floats, middle: Floats, always: bool, work: Work,
    room: Polytope,
) -> tuple[bool, bool, int]:  # fmt: skip
    """Return whether a cell is proved, whether the middle collides, and where to divide it."""
    place_a, place_b = place_body(a, middle, 0, work), place_body(b, middle, 1, work)
    found = distance_of(a, place_a, b, place_b)
    collides = found.distance <= a.round + b.round
    spread_a = measure(a, place_a, lower, upper, 0, work)
    spread_b = measure(b, place_b, lower, upper, 1, work)
    size = a.reach + b.reach
    n = combined(place_a.axes, found.normal)
    if collides and always:
        pose = relative_pose(place_a, place_b, size)
        core_a, core_b = core_of(a), core_of(b)
        depth = a.round + b.round
        if found.distance > 0.0:
            depth -= found.distance
        else:
            depth -= deepest(core_a, core_b, pose, found, room).gap
        if depth - spread_a - spread_b > DEPTH_SLACK * size:
            return True, collides, -1
    if not collides and not always:
        gap = least_along(b, place_b, n, spread_b, 1, work) + least_along(
            a, place_a, negated(n), spread_a, 0, work
        )
        if gap > SLACK * size:
            return True, collides, -1
    p = plus(place_a.center, combined(place_a.axes, found.p))
    q = plus(place_b.center, combined(place_b.axes, found.q))
    return False, collides, _widest(a, p, b, q, n, lower, upper, work)


@njit
def _widest(
    a: Moving, p: Vector, b: Moving, q: Vector, n: Vector, lower: Floats, upper: Floats,
    work: Work,
) -> int:  # fmt: skip
    """Return the variable that loosens the bound most; -1 if there is none.

    By the curvature of the paths, and where that alone does not prevent a proof, by how fast the
    nearest points p and q part along n.
    """
    slopes, curves = np.zeros(len(lower)), np.zeros(len(lower))
    add_slopes(a, p, negated(n), 0, work, slopes)
    add_slopes(b, q, n, 1, work, slopes)
    add_curves(a, 0, work, curves)
    add_curves(b, 1, work, curves)
    gap = dot(n, minus(q, p)) - a.round - b.round
    for v in range(len(lower)):
        slopes[v] = 0.5 * abs(slopes[v]) * (upper[v] - lower[v])
        gap -= slopes[v]
    best, found = 0.0, -1
    for v in range(len(lower)):
        weight = curves[v] + (slopes[v] if gap <= 0.0 else 0.0)
        if weight > best and upper[v] > lower[v]:
            best, found = weight, v
    return found
