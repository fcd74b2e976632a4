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

In a cell, a box of variables, a direction n that separates two bodies in the middle of the cell
separates them everywhere if it does so by more than the bodies can move along n. The motion of a
point p by joints with axes w_i through o_i, whose values are off by at most d_i, is at most

    sum_i d_i |n.(w_i x (p - o_i))| + 1/2 sum_j r_j d_j (d_j + 2 sum_(i<j) d_i),

joints counted from the frame in which n is fixed: the second derivative by joints i <= j is
w_i x (w_j x (p - o_j)), which is no longer than the distance r_j of p from the axis of joint j. For
a joint that slides, r_j is 1, and what belongs to two that slide is left out. It is at most
sum_i min(d_i, 2) r_i as well. r_j holds in the whole cell: it is that in the middle, and what the
joints behind j move.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import (
    axes_of,
    combined,
    components,
    cross,
    dot,
    minus,
    negated,
    norm,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.convex.depth import Room, deepest, room_for_depth
from obb_collision.queries.convex.distance import Search, search
from obb_collision.queries.convex.support import CORNERS, Core
from obb_collision.queries.meshes.tree_boxes import Place, moved, relative_pose
from obb_collision.robots.chains import Chain
from obb_collision.typing import Axes, Floats, Vector

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


class Moving(NamedTuple):
    """A convex body and what moves it."""

    chain: Chain
    blocks: Floats  #: (m, 3, LANES) corners in the frame of the link
    center: Vector  #: of a sphere around it
    sphere: float
    round: float  #: radius around each point of the hull of the corners
    reach: float  #: largest sum of magnitudes of coordinates of a point


class Work(NamedTuple):
    """What kernels write to: of each joint, for both bodies."""

    origins: Floats  #: (2, k, 3) in the frame between the links
    axes: Floats  #: (2, k, 3)
    far: Floats  #: (2, k) greatest distance of a point from the axis; 1 of those that slide
    widths: Floats  #: (2, k) half the width of the cell in its value


@njit
def work_for(a: Moving, b: Moving) -> Work:
    """Return room for one pair of bodies."""
    k = max(len(a.chain.axes), len(b.chain.axes))
    return Work(np.empty((2, k, 3)), np.empty((2, k, 3)), np.empty((2, k)), np.empty((2, k)))


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
        place_a, place_b = _placed(a, states[n], 0, work), _placed(b, states[n], 1, work)
        found = _searched(a, place_a, b, place_b)
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
        place_a, place_b = _placed(a, state, 0, work), _placed(b, state, 1, work)
        found = _searched(a, place_a, b, place_b)
        gap = found.distance - a.round - b.round
        if gap <= 0.0:
            return True
        n = combined(place_a.axes, found.normal)
        p = plus(place_a.center, combined(place_a.axes, found.p))
        q = plus(place_b.center, combined(place_b.axes, found.q))
        slopes[:] = 0.0
        _add_slopes(a, p, negated(n), 0, work, slopes)
        _add_slopes(b, q, n, 1, work, slopes)
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
def _add_slopes(
    body: Moving, point: Vector, n: Vector, side: int, work: Work, slopes: Floats
) -> None:
    """Add how fast a point of a body moves along n with each variable."""
    chain = body.chain
    for i in range(len(chain.axes)):
        axis = vector_at(work.axes[side], i)
        speed = axis
        if not chain.slides[i]:
            speed = cross(axis, minus(point, vector_at(work.origins[side], i)))
        slopes[chain.columns[i]] += chain.factors[i] * dot(n, speed)


@njit
def _look(
    a: Moving, b: Moving, lower: Floats, upper: Floats, middle: Floats, always: bool, work: Work,
    room: Room,
) -> tuple[bool, bool, int]:  # fmt: skip
    """Return whether a cell is proved, whether the middle collides, and where to divide it."""
    place_a, place_b = _placed(a, middle, 0, work), _placed(b, middle, 1, work)
    found = _searched(a, place_a, b, place_b)
    collides = found.distance <= a.round + b.round
    spread_a = _measure(a, place_a, lower, upper, 0, work)
    spread_b = _measure(b, place_b, lower, upper, 1, work)
    size = a.reach + b.reach
    n = combined(place_a.axes, found.normal)
    if collides and always:
        pose = relative_pose(place_a, place_b, size)
        core_a, core_b = _core(a), _core(b)
        depth = a.round + b.round
        if found.distance > 0.0:
            depth -= found.distance
        else:
            depth -= deepest(core_a, core_b, pose, found, room).gap
        if depth - spread_a - spread_b > DEPTH_SLACK * size:
            return True, collides, -1
    if not collides and not always:
        gap = _least(b, place_b, n, spread_b, 1, work) + _least(
            a, place_a, negated(n), spread_a, 0, work
        )
        if gap > SLACK * size:
            return True, collides, -1
    p = plus(place_a.center, combined(place_a.axes, found.p))
    q = plus(place_b.center, combined(place_b.axes, found.q))
    return False, collides, _widest(a, p, b, q, n, lower, upper, work)


@njit
def _placed(body: Moving, state: Floats, side: int, work: Work) -> Place:
    """Return where a body is, and write the axes of its joints."""
    chain = body.chain
    center, axes = vector_at(chain.places, 0), axes_of(chain.turns, 0)
    for i in range(len(chain.axes)):
        own = vector_at(chain.axes, i)
        axis = combined(axes, own)
        for k in range(3):
            work.origins[side, i, k], work.axes[side, i, k] = center[k], axis[k]
        value = chain.factors[i] * state[chain.columns[i]] + chain.offsets[i]
        if chain.slides[i]:
            center = plus(center, scaled(axis, value))
        else:
            axes = _product(axes, _turn(own, value))
        center = plus(center, combined(axes, vector_at(chain.places, i + 1)))
        axes = _product(axes, axes_of(chain.turns, i + 1))
    return Place(center, axes)


@njit
def _product(a: Axes, b: Axes) -> Axes:
    """Return the product of matrices, given and returned by columns."""
    return combined(a, b[0]), combined(a, b[1]), combined(a, b[2])


@njit
def _turn(axis: Vector, angle: float) -> Axes:
    """Return the columns of the rotation about a unit vector."""
    x, y, z = axis
    s, c = math.sin(angle), math.cos(angle)
    d = 2.0 * math.sin(0.5 * angle) ** 2
    return (
        (c + d * x * x, d * x * y + s * z, d * x * z - s * y),
        (d * x * y - s * z, c + d * y * y, d * y * z + s * x),
        (d * x * z + s * y, d * y * z - s * x, c + d * z * z),
    )


@njit
def _core(body: Moving) -> Core:
    zero = 0.0, 0.0, 0.0
    return Core(CORNERS, zero, 0.0, body.blocks, 0, len(body.blocks), body.reach, 0.0)


@njit
def _searched(a: Moving, place_a: Place, b: Moving, place_b: Place) -> Search:
    """Return the distance of the hulls of corners; in the frame of a."""
    pose = relative_pose(place_a, place_b, a.reach + b.reach)
    start = plus(moved(pose, b.center), negated(a.center))
    return search(_core(a), _core(b), pose, start, np.inf)


@njit
def _measure(
    body: Moving, place: Place, lower: Floats, upper: Floats, side: int, work: Work
) -> float:
    """Return how far points of a body move at most within a cell; write ``far`` and ``widths``."""
    chain = body.chain
    center = plus(place.center, combined(place.axes, body.center))
    spread = 0.0
    for i in range(len(chain.axes) - 1, -1, -1):
        column = chain.columns[i]
        width = 0.5 * abs(chain.factors[i]) * (upper[column] - lower[column])
        far = 1.0
        if not chain.slides[i]:
            arm = minus(center, vector_at(work.origins[side], i))
            far = norm(cross(vector_at(work.axes[side], i), arm)) + body.sphere + spread
        work.far[side, i], work.widths[side, i] = far, width
        spread += far * (width if chain.slides[i] else min(width, 2.0))
    return spread


@njit
def _least(
    body: Moving, place: Place, n: Vector, spread: float, side: int, work: Work
) -> float:  # fmt: skip
    """Return a lower bound of n.p for all points p of a body in all of a cell."""
    count = len(body.chain.axes)
    slopes = np.empty((count, 4))
    curve = before = 0.0
    for i in range(count):
        axis, width = vector_at(work.axes[side], i), work.widths[side, i]
        if body.chain.slides[i]:
            slope, offset = (0.0, 0.0, 0.0), width * dot(n, axis)
            curve += width * before
        else:
            across = scaled(cross(n, axis), width)  # n.(w x (p - o)) = (n x w).(p - o)
            slope = components(place.axes, across)
            offset = dot(across, minus(place.center, vector_at(work.origins[side], i)))
            curve += work.far[side, i] * width * (0.5 * width + before)
            before += width
        slopes[i, 0], slopes[i, 1], slopes[i, 2] = slope
        slopes[i, 3] = offset
    own = components(place.axes, n)
    bent = straight = np.inf
    blocks = body.blocks
    for block in range(len(blocks)):
        for lane in range(blocks.shape[2]):
            x = blocks[block, 0, lane], blocks[block, 1, lane], blocks[block, 2, lane]
            along = dot(own, x)
            straight = min(straight, along)
            for i in range(count):
                along -= abs(
                    slopes[i, 0] * x[0] + slopes[i, 1] * x[1] + slopes[i, 2] * x[2] + slopes[i, 3]
                )
            bent = min(bent, along)
    return dot(n, place.center) + max(bent - curve, straight - spread) - body.round


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
    _add_slopes(a, p, negated(n), 0, work, slopes)
    _add_slopes(b, q, n, 1, work, slopes)
    _add_curves(a, 0, work, curves)
    _add_curves(b, 1, work, curves)
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


@njit
def _add_curves(body: Moving, side: int, work: Work, curves: Floats) -> None:
    """Add what each variable has to do with the curvature of the path of a body."""
    chain = body.chain
    total = 0.0
    for i in range(len(chain.axes)):
        if not chain.slides[i]:
            total += work.widths[side, i]
    for i in range(len(chain.axes)):
        curves[chain.columns[i]] += work.widths[side, i] * work.far[side, i] * total
