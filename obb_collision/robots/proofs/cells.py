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

"""Kernels of proofs: branch and bound over the variables between two links.

A cell is a box of variables. A direction that separates two bodies in the middle of a cell does so
in all of it, if the gap exceeds what the bodies can move along it. Likewise they collide in all of
it if they overlap by more than they can move.

Joints are counted from the frame in which a direction n is fixed. Their axes are w_i through o_i,
and their values change by at most d_i. Along n, a point p then moves by at most

    sum_i d_i |n.(w_i x (p - o_i))| + 1/2 sum_j r_j d_j (d_j + 2 sum_(i<j) d_i),

as the second derivative by joints i <= j is w_i x (w_j x (p - o_j)), which is no longer than the
distance r_j of p from the axis of joint j. For a prismatic joint r_j is 1, and terms of two
prismatic joints are zero. Another bound is sum_i min(d_i, 2) r_i. r_j holds in the whole cell: it
is the one in the middle, plus what the joints behind j move.
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
from obb_collision.queries.convex.depth import DepthRoom, deepest, room_for_depth
from obb_collision.queries.convex.distance import GapSearch, search
from obb_collision.queries.convex.support import HULL_CORE, Core
from obb_collision.queries.meshes.placed import Place, moved, relative_pose
from obb_collision.typing import Axes, Floats, Integers, Mask, Vector

#: The gap that a proof must leave, relative to the reach of both bodies: far above all rounding and
#: above the distance that counts as touching in checks of states.
SLACK = 1e-9
#: The same of the depth of two bodies, which is found by a search.
DEPTH_SLACK = 1e-6
#: A cell narrower than this in all its variables, radians or metres, is not divided.
NARROWEST = 1e-5
#: Outcomes of a search: not ended, proved, disproved by a state, not decided.
SEARCHING, PROVED, DISPROVED, OPEN = 0, 1, 2, 3
#: Steps of a descent, how much farther than to the contact each goes, and its longest change of a
#: variable, radians or metres.
STEPS, FARTHER, LONGEST = 100, 1.5, 0.3
#: Maximum number of waiting cells: each division leaves one, and doubles allow 60 per variable.
MOST_CELLS = 4096
NO_CELLS: Floats = np.empty((0, 2, 0))


class Chain(NamedTuple):
    """k joints from a frame outwards: F_0 J_0 F_1 J_1 ... F_k, which is the frame of a link.

    Joint i turns about an axis through the origin, or slides along it, by factor times variable
    plus offset.
    """

    places: Floats  #: (k + 1, 3) of F
    turns: Floats  #: (k + 1, 3, 3)
    axes: Floats  #: (k, 3) unit vectors
    slides: Mask  #: (k,) whether it slides
    columns: Integers  #: (k,) its variable, a row of the limits
    factors: Floats  #: (k,)
    offsets: Floats  #: (k,)


class Moving(NamedTuple):
    """A convex body, the chain that moves it, and arrays for values of each joint."""

    chain: Chain
    blocks: Floats  #: (m, 3, LANES) corners in the frame of the link
    center: Vector  #: of a sphere around it
    sphere: float
    round: float  #: radius of a ball around each point of the hull of the corners
    reach: float  #: largest sum of the magnitudes of a point's coordinates
    origins: Floats  #: (k, 3) in the frame between the links
    axes: Floats  #: (k, 3)
    far: Floats  #: (k,) greatest distance of a point from the axis; 1 for a prismatic joint
    widths: Floats  #: (k,) half the width of the cell, in the value of the joint


class MovingPair(NamedTuple):
    """Two bodies, and limits (2, v) of the variables that move them against each other."""

    a: Moving
    b: Moving
    limits: Floats


class CellGap(NamedTuple):
    """The places of two bodies in a state, and the distance of the hulls of their corners."""

    a: Place
    b: Place
    nearest: GapSearch  #: in the frame of a
    n: Vector  #: from a to b, in the frame between the links
    p: Vector  #: the nearest points
    q: Vector


def find_state(pair: MovingPair, states: Floats, collides: bool) -> int:
    """Return the first of states (n, v) in which bodies collide, or are free; -1 for none."""
    return _search(pair, states, NO_CELLS, 0, 0, collides, np.empty(pair.limits.shape[1]))[2]


def descend_from(pair: MovingPair, states: Floats, witness: Floats) -> bool:
    """Return whether a descent from one of states (n, v) finds a collision; write ``witness``."""
    return _search(pair, states, NO_CELLS, 0, 1, True, witness)[0] == DISPROVED


def search_cells(
    pair: MovingPair, cells: Floats, waiting: int, most: int, always: bool, witness: Floats
) -> tuple[int, int, int]:
    """Continue a search; return its outcome, the number of waiting and that of visited cells.

    cells (MOST_CELLS + 1, 2, v): lower and upper limits of the waiting cells. most: maximum number
    of cells to visit. always: whether to prove that bodies collide everywhere, instead of nowhere.
    witness (v,): a state that disproves it, or in which it is open.
    """
    return _search(pair, pair.limits, cells, waiting, most, always, witness)


@njit
def _search(
    pair: MovingPair,
    states: Floats,
    cells: Floats,
    waiting: int,
    most: int,
    collides: bool,
    witness: Floats,
) -> tuple[int, int, int]:
    """Search cells; without cells, check states (n, v), or descend from them if most is not zero.

    One kernel, as each kernel that computes distances takes seconds to compile.
    """
    if len(cells):
        return _search_cells(pair, cells, waiting, most, collides, witness)
    for n in range(len(states)):
        for v in range(len(witness)):
            witness[v] = states[n, v]
        if most > 0:
            if _descend(pair, witness):
                return DISPROVED, 0, n
        elif _touch(pair, _gap(pair, witness)) == collides:
            return DISPROVED, 0, n
    return OPEN, 0, -1


@njit(merge=True)
def _search_cells(
    pair: MovingPair, cells: Floats, waiting: int, most: int, always: bool, witness: Floats
) -> tuple[int, int, int]:
    room, visited = room_for_depth(), 0
    while waiting > 0:
        if visited == most:
            return SEARCHING, waiting, visited
        waiting -= 1
        visited += 1
        lower, upper = cells[waiting, 0], cells[waiting, 1]
        for v in range(len(witness)):
            witness[v] = 0.5 * (lower[v] + upper[v])
        gap = _gap(pair, witness)
        collides = _touch(pair, gap)
        if _is_proved(pair, gap, lower, upper, collides, always, room):
            continue
        if collides != always:
            return DISPROVED, waiting, visited
        column = _widest(pair, gap, lower, upper)
        if column < 0 or upper[column] - lower[column] < NARROWEST or waiting + 2 > MOST_CELLS:
            disproved = not always and _descend(pair, witness)
            return DISPROVED if disproved else OPEN, waiting, visited
        for v in range(len(witness)):
            cells[waiting + 1, 0, v], cells[waiting + 1, 1, v] = lower[v], upper[v]
        cells[waiting, 1, column] = cells[waiting + 1, 0, column] = witness[column]
        waiting += 2
    return PROVED, 0, visited


@njit(merge=True)
def _descend(pair: MovingPair, state: Floats) -> bool:
    """Move a state downhill until the bodies collide; return whether they do."""
    slopes, limits = np.empty(len(state)), pair.limits
    for _ in range(STEPS):
        gap = _gap(pair, state)
        distance = gap.nearest.distance - pair.a.round - pair.b.round
        if distance <= 0.0:
            return True
        slopes[:] = 0.0
        _add_slopes(pair.a, gap.p, negated(gap.n), slopes)
        _add_slopes(pair.b, gap.q, gap.n, slopes)
        total = 0.0
        for v in range(len(state)):
            blocked = state[v] <= limits[0, v] if slopes[v] > 0.0 else state[v] >= limits[1, v]
            slopes[v] = 0.0 if blocked else slopes[v]
            total += slopes[v] * slopes[v]
        if total == 0.0:
            return False
        for v in range(len(state)):
            step = -FARTHER * distance * slopes[v] / total
            step = min(max(step, -LONGEST), LONGEST)
            state[v] = min(max(state[v] + step, limits[0, v]), limits[1, v])
    return False


@njit
def _gap(pair: MovingPair, state: Floats) -> CellGap:
    """Return the gap of both bodies in a state; write the axes of their joints."""
    a, b = _placed(pair.a, state), _placed(pair.b, state)
    pose = relative_pose(a, b, pair.a.reach + pair.b.reach)
    start = plus(moved(pose, pair.b.center), negated(pair.a.center))
    near = search(_core_of(pair.a), _core_of(pair.b), pose, start, np.inf)
    p, q = plus(a.center, combined(a.axes, near.p)), plus(b.center, combined(b.axes, near.q))
    return CellGap(a, b, near, combined(a.axes, near.normal), p, q)


@njit(merge=True)
def _touch(pair: MovingPair, gap: CellGap) -> bool:
    """Return whether the bodies have a common point."""
    return gap.nearest.distance <= pair.a.round + pair.b.round


@njit
def _placed(body: Moving, state: Floats) -> Place:
    """Return the place of a body; write the axes of its joints."""
    chain = body.chain
    center, axes = vector_at(chain.places, 0), axes_of(chain.turns, 0)
    for i in range(len(chain.axes)):
        own = vector_at(chain.axes, i)
        axis = combined(axes, own)
        for k in range(3):
            body.origins[i, k], body.axes[i, k] = center[k], axis[k]
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
    """Return the product of two matrices as columns."""
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


@njit(merge=True)
def _core_of(body: Moving) -> Core:
    """Return the hull of the corners of a body, in the frame of its link."""
    zero = 0.0, 0.0, 0.0
    return Core(HULL_CORE, zero, 0.0, body.blocks, 0, len(body.blocks), body.reach, 0.0)


@njit(merge=True)
def _is_proved(
    pair: MovingPair,
    gap: CellGap,
    lower: Floats,
    upper: Floats,
    collides: bool,
    always: bool,
    room: DepthRoom,
) -> bool:
    """Return whether bodies certainly collide, or are free, in a whole cell as in its middle.

    Writes ``far`` and ``widths`` of both bodies.
    """
    a, b, nearest = pair.a, pair.b, gap.nearest
    spread_a, spread_b = _spread(a, gap.a, lower, upper), _spread(b, gap.b, lower, upper)
    size = a.reach + b.reach
    if collides != always:
        return False
    if not collides:
        least = _least_along(b, gap.b, gap.n, spread_b)
        return least + _least_along(a, gap.a, negated(gap.n), spread_a) > SLACK * size
    depth = a.round + b.round
    if nearest.distance > 0.0:
        depth -= nearest.distance
    else:
        pose = relative_pose(gap.a, gap.b, size)
        depth -= deepest(_core_of(a), _core_of(b), pose, nearest, room).gap
    return depth - spread_a - spread_b > DEPTH_SLACK * size


@njit
def _spread(body: Moving, place: Place, lower: Floats, upper: Floats) -> float:
    """Return how far a point of a body moves at most in a cell; write ``far`` and ``widths``."""
    chain = body.chain
    center = plus(place.center, combined(place.axes, body.center))
    spread = 0.0
    for i in range(len(chain.axes) - 1, -1, -1):
        column = chain.columns[i]
        width = 0.5 * abs(chain.factors[i]) * (upper[column] - lower[column])
        far = 1.0
        if not chain.slides[i]:
            arm = minus(center, vector_at(body.origins, i))
            far = norm(cross(vector_at(body.axes, i), arm)) + body.sphere + spread
        body.far[i], body.widths[i] = far, width
        spread += far * (width if chain.slides[i] else min(width, 2.0))
    return spread


@njit
def _least_along(body: Moving, place: Place, n: Vector, spread: float) -> float:
    """Return a lower bound of n.p for all points p of a body, in a whole cell."""
    count = len(body.chain.axes)
    slopes = np.empty((count, 4))
    curve = before = 0.0
    for i in range(count):
        axis, width = vector_at(body.axes, i), body.widths[i]
        if body.chain.slides[i]:
            slope, offset = (0.0, 0.0, 0.0), width * dot(n, axis)
            curve += width * before
        else:
            across = scaled(cross(n, axis), width)  # n.(w x (p - o)) = (n x w).(p - o)
            slope = components(place.axes, across)
            offset = dot(across, minus(place.center, vector_at(body.origins, i)))
            curve += body.far[i] * width * (0.5 * width + before)
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
def _add_slopes(body: Moving, point: Vector, n: Vector, slopes: Floats) -> None:
    """Add the speed of a point of a body along n, by each variable."""
    chain = body.chain
    for i in range(len(chain.axes)):
        axis = vector_at(body.axes, i)
        speed = axis
        if not chain.slides[i]:
            speed = cross(axis, minus(point, vector_at(body.origins, i)))
        slopes[chain.columns[i]] += chain.factors[i] * dot(n, speed)


@njit
def _add_curves(body: Moving, curves: Floats) -> None:
    """Add the share of each variable in the curvature of a body's path."""
    chain = body.chain
    total = 0.0
    for i in range(len(chain.axes)):
        if not chain.slides[i]:
            total += body.widths[i]
    for i in range(len(chain.axes)):
        curves[chain.columns[i]] += body.widths[i] * body.far[i] * total


@njit(merge=True)
def _widest(pair: MovingPair, gap: CellGap, lower: Floats, upper: Floats) -> int:
    """Return the variable that loosens the bound most; -1 for none.

    Its weight is its share in the curvature of the paths. If motion without curvature prevents a
    proof, too, the speed of the nearest points along n is added.
    """
    slopes, curves = np.zeros(len(lower)), np.zeros(len(lower))
    _add_slopes(pair.a, gap.p, negated(gap.n), slopes)
    _add_slopes(pair.b, gap.q, gap.n, slopes)
    _add_curves(pair.a, curves)
    _add_curves(pair.b, curves)
    room = dot(gap.n, minus(gap.q, gap.p)) - pair.a.round - pair.b.round
    for v in range(len(lower)):
        slopes[v] = 0.5 * abs(slopes[v]) * (upper[v] - lower[v])
        room -= slopes[v]
    best, column = 0.0, -1
    for v in range(len(lower)):
        weight = curves[v] + (slopes[v] if room <= 0.0 else 0.0)
        if weight > best and upper[v] > lower[v]:
            best, column = weight, v
    return column
