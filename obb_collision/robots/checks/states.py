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

"""Checks of states: which bodies of robots and of the world may collide, one state after another.

A body is the shape of a link, of an attached object, or of the world. Tests go from cheap to exact,
and each passes all pairs that the next one reports: spheres, boxes by their separating axes, convex
hulls by a direction that certainly separates them.

The code for one state is compiled into one kernel (``refcount=False``): passing the arrays of all
bodies to a function, and counting references to them, takes longer than most of the tests.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import Held, njit
from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.geometry.trees.bounds_tree import lowest, overlaps
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.intrinsics import LANES
from obb_collision.numerics.vec3 import (
    ZERO,
    absolute,
    combined,
    components,
    dot,
    minus,
    negated,
    plus,
    rows_at,
    vector_at,
)
from obb_collision.queries.meshes.hull_hull import HullCorners, apart
from obb_collision.queries.meshes.placed import place_at, relative_pose
from obb_collision.queries.verdict.sat import BoxAt, box_at, pair_of
from obb_collision.queries.verdict.verdict import SEPARATE, fast_verdict
from obb_collision.robots.checks.arrays import (
    LINK_PLACING,
    Checked,
    LinkBodies,
    PairValues,
    Placed,
    new_placed,
    place_state,
    placed_box,
    slack_of,
    with_own_clouds,
)
from obb_collision.robots.checks.balls import ball_center, balls_near, body_at, find_balls
from obb_collision.robots.checks.meshes import mesh_collisions_of
from obb_collision.robots.checks.model import Prepared
from obb_collision.robots.checks.reports import StatePairs, StateReport
from obb_collision.typing import Floats, Integers, Rows, Vector

SPHERE, AABB, HULL = (int(level) for level in (Accuracy.SPHERE, Accuracy.AABB, Accuracy.HULL))
#: Minimum number of states for a second thread: they take 0.1 ms.
FEWEST_STATES = 64


class StateQuestion(NamedTuple):
    """States (n, joints) to check for bodies that may collide on a level.

    bodies, pairs: distances within which bodies count as colliding, see ``PairValues``; first:
    whether the first pair of each state is enough.
    """

    checked: Checked
    level: int
    states: Floats
    bodies: Floats
    pairs: Floats
    first: bool


class CollidingPairs(NamedTuple):
    """Pairs of bodies (m, 2): of state n ``counts[n]`` pairs, up to row ``ends[n]``."""

    counts: Integers
    ends: Integers
    pairs: Integers


CROWD = 1024
"""Bodies of the world from which on the boxes of a link are looked up, not only its sphere."""


FEW_BALLS = 16
"""Balls in the sphere of a link from which on they are looked up with the boxes of its bodies."""


@njit(merge=True)
def gather(
    checked: Checked, placed: Placed, near: PairValues, row: int, stop: bool, boxes: bool
) -> int:
    """Write the pairs whose spheres overlap to the candidates; return their number.

    near: distances within which bodies count as colliding, m; row: that of the state. Pairs with
    the world come first, from the last link on, as tips collide most. stop: whether to end with a
    pair that certainly collides, by balls within bodies; it is then the first candidate, and the
    number is -1. boxes: whether boxes, too, must overlap the balls of clouds.
    """
    bodies, tests, clouds = checked.bodies, checked.tests, checked.clouds
    nodes, starts, order = tests.nodes, tests.levels, tests.order
    centers, spheres, inner = placed.centers, bodies.spheres, bodies.inner
    world = BoxArrays(centers, placed.axes, bodies.half_extents)
    blocks, levels = placed.waiting[0], placed.waiting[1]
    candidates, limits, grown = placed.candidates, placed.grown, near.bodies
    allowed, ruled = tests.allowed, len(tests.allowed) > 0
    count = 0
    for k in range(len(tests.links) if len(order) or len(clouds.bodies) else 0):
        group = len(tests.links) - 1 - k
        frame, first, last = tests.links[group], tests.starts[group], tests.starts[group + 1]
        middle = components(rows_at(placed.rotations, frame), vector_at(tests.centers, group))
        x, y, z = plus(vector_at(placed.positions, frame), middle)
        radius = 0.0
        for i in range(first, last):
            radius = max(radius, grown[row, i] + 2.0 * slack_of(bodies, i, (x, y, z)))
        radius += tests.spheres[group]
        low, high = (x - radius, y - radius, z - radius), (x + radius, y + radius, z + radius)
        if boxes and len(order) >= CROWD:
            least, most = high, low
            for i in range(first, last):
                a, reach = placed_box(bodies, placed, i), grown[row, i]
                reach += 2.0 * slack_of(bodies, i, a.center)
                sides = absolute(a.axes[0]), absolute(a.axes[1]), absolute(a.axes[2])
                u, v, w = combined(sides, a.half_extents)
                side = u + reach, v + reach, w + reach
                least = minimum(least, minus(a.center, side))
                most = maximum(most, plus(a.center, side))
            low, high = maximum(low, least), minimum(high, most)
        levels[0], blocks[0] = len(starts) - 2, 0
        depth = 1
        while depth > 0:
            depth -= 1
            level, block = levels[depth], blocks[depth]
            mask = overlaps(
                nodes, starts[level] + block, low[0], low[1], low[2], high[0], high[1], high[2]
            )
            while mask != 0:
                child = LANES * block + lowest(mask)
                mask &= mask - 1
                if level > 0:
                    levels[depth], blocks[depth] = level - 1, child
                    depth += 1
                    continue
                j = tests.first + order[child]
                b = box_at(world, j)
                for i in range(first, last):
                    if ruled and allowed[i, order[child]]:
                        continue
                    center = vector_at(centers, i)
                    square = square_distance(b, minus(b.center, center))
                    reach = spheres[i] + grown[row, i] + 2.0 * slack_of(bodies, i, center)
                    reach += LINK_PLACING * bodies.reaches[j]
                    if square > reach * reach * (1.0 + LINK_PLACING):
                        continue
                    candidates[count, 0], candidates[count, 1] = i, j
                    limits[count] = grown[row, i]
                    count += 1
                    if stop and bodies.boxes[j] and square <= inner[i] * inner[i]:
                        candidates[0, 0], candidates[0, 1] = i, j
                        return -1
        for c in range(len(clouds.bodies)):
            j = clouds.bodies[c]
            reach, place = radius + spheres[j], (x, y, z)
            enough = FEW_BALLS if boxes else len(placed.balls)
            found = find_balls(clouds, c, place, place, reach, placed.waiting, placed.balls, enough)
            few = found < enough or not boxes
            for i in range(first, last):
                if ruled and allowed[i, j - tests.first]:
                    continue
                center = vector_at(centers, i)
                near_ball = spheres[j] + grown[row, i] + 2.0 * slack_of(bodies, i, center)
                near_ball += 2.0 * LINK_PLACING * bodies.reaches[j]
                reach = (spheres[i] + near_ball) * (1.0 + LINK_PLACING)
                if not few:  # the box leaves most of them out before they are looked at
                    far = near_ball * (1.0 + LINK_PLACING) + MESH_UNDERFLOW
                    box, room = placed_box(bodies, placed, i), (placed.waiting, placed.balls)
                    found = balls_near(clouds, c, box, far, False, *room, ZERO, np.inf)
                for m in range(found):
                    d = minus(ball_center(clouds, c, placed.balls[m]), center)
                    square = dot(d, d)
                    if square > reach * reach:
                        continue
                    if few and boxes:
                        gap = square_distance(placed_box(bodies, placed, i), d)
                        if gap > near_ball * near_ball * (1.0 + LINK_PLACING):
                            continue
                    candidates[count, 0] = i
                    candidates[count, 1] = len(bodies.frames) + placed.balls[m]
                    limits[count] = grown[row, i]
                    count += 1
                    if stop and square <= inner[i] * inner[i]:
                        candidates[0, 0], candidates[0, 1] = candidates[count - 1]
                        return -1
    pairs, grown = tests.pairs, near.pairs
    for n in range(len(pairs)):
        i, j = pairs[n, 0], pairs[n, 1]
        d = minus(vector_at(centers, j), vector_at(centers, i))
        reach = spheres[i] + spheres[j] + grown[row, n]
        reach += LINK_PLACING * (bodies.reaches[i] + bodies.reaches[j])
        candidates[count, 0], candidates[count, 1] = i, j
        limits[count] = grown[row, n]
        count += dot(d, d) <= reach * reach * (1.0 + LINK_PLACING)
    return count


@njit
def minimum(u: Vector, v: Vector) -> Vector:
    """Return the lesser of each component."""
    return min(u[0], v[0]), min(u[1], v[1]), min(u[2], v[2])


@njit
def maximum(u: Vector, v: Vector) -> Vector:
    """Return the greater of each component."""
    return max(u[0], v[0]), max(u[1], v[1]), max(u[2], v[2])


@njit(inline=True, refcount=False)
def may_collide(
    bodies: LinkBodies, placed: Placed, i: int, j: int, grown: float, level: int
) -> bool:
    """Return whether bodies i and j may be within a distance ``grown``, on a level."""
    center, other = vector_at(placed.centers, i), vector_at(placed.centers, j)
    grown += slack_of(bodies, i, center) + slack_of(bodies, j, other)
    d = minus(other, center)
    reach = bodies.spheres[i] + bodies.spheres[j] + grown
    if dot(d, d) > reach * reach * (1.0 + LINK_PLACING):
        return False
    if level == SPHERE:
        return True
    b = placed_box(bodies, placed, j)
    a = placed_box(bodies, placed, i)
    near = bodies.spheres[j] + grown
    if square_distance(a, d) > near * near * (1.0 + LINK_PLACING):
        return False
    h = a.half_extents
    a = BoxAt(a.center, a.axes, (h[0] + grown, h[1] + grown, h[2] + grown))
    if level == AABB:
        return _bounds_touch(d, a, b)
    pair, size = pair_of(a, b)
    if fast_verdict(pair, size) == SEPARATE:
        return False
    return level < HULL or not _hulls_apart(bodies, placed, i, j, d, grown)


@njit
def square_distance(b: BoxAt, d: Vector) -> float:
    """Return the squared distance of a point from a box; d: from the point to the box's centre."""
    x, y, z = components(b.axes, d)
    f = b.half_extents
    x, y, z = max(abs(x) - f[0], 0.0), max(abs(y) - f[1], 0.0), max(abs(z) - f[2], 0.0)
    return x * x + y * y + z * z


@njit
def _bounds_touch(d: Vector, a: BoxAt, b: BoxAt) -> bool:
    """Return whether the axis-aligned bounds of two boxes have a common point."""
    for k in range(3):
        reach = 0.0
        for m in range(3):
            reach += a.half_extents[m] * abs(a.axes[m][k]) + b.half_extents[m] * abs(b.axes[m][k])
        if abs(d[k]) > reach:
            return False
    return True


@njit(inline=True, refcount=False)
def _hulls_apart(
    bodies: LinkBodies, placed: Placed, i: int, j: int, d: Vector, grown: float
) -> bool:
    """Return whether a direction certainly separates two hulls; d: from centre to centre."""
    a = place_at(placed.positions, placed.rotations, bodies.frames[i])
    b = place_at(placed.positions, placed.rotations, bodies.frames[j])
    pose = relative_pose(a, b, bodies.radii[i] + bodies.radii[j])
    reach = bodies.rounds[i] + bodies.rounds[j] + grown
    own = HullCorners(bodies.blocks, bodies.starts[i], bodies.starts[i + 1])
    other = HullCorners(bodies.blocks, bodies.starts[j], bodies.starts[j + 1])
    return apart(own, other, pose, negated(components(a.axes, d)), reach)


@njit
def pairs_kernel(
    held: Held,
    question: tuple[int, Floats, Floats, Floats, bool],
    output: tuple[Integers, Integers, Integers],
    start: int,
    stop: int,
) -> None:
    """Write the pairs of bodies that may collide in each state; without room for pairs, counts.

    With ``first``, rows of names are written instead of bodies, the smaller first. If there is room
    for pairs, states with count 0 are skipped. question, output: ``StateQuestion`` and
    ``CollidingPairs`` as plain tuples, which arrive from Python in a third of the time.
    """
    asked = StateQuestion(with_own_clouds(held.value), *question)
    _fill_pairs(asked, CollidingPairs(*output), new_placed(asked.checked), start, stop)


@njit(inline=True, refcount=False)
def _fill_pairs(
    question: StateQuestion, output: CollidingPairs, placed: Placed, start: int, stop: int
) -> None:
    checked, level, states = question.checked, question.level, question.states
    near = PairValues(question.bodies, question.pairs)
    first, bodies = question.first, checked.bodies
    counts, ends, pairs = output.counts, output.ends, output.pairs
    for n in range(start, stop):
        if len(pairs) and counts[n] == 0:
            continue
        place_state(checked, states, n, placed)
        row = n if len(near.bodies) > 1 else 0
        count = gather(checked, placed, near, row, first, level > SPHERE)
        number = 0
        for m in range(abs(count)):
            i, other = placed.candidates[m, 0], placed.candidates[m, 1]
            j = body_at(bodies, checked.clouds, other)
            if other != j:
                for k in range(3):
                    placed.centers[j, k] = bodies.centers[j, k]
            if count < 0 or may_collide(bodies, placed, i, j, placed.grown[m], level):
                number += 1
                if first:
                    i, other = checked.owners[i], checked.owners[j]
                    i, other = min(i, other), max(i, other)
                if len(pairs):
                    pairs[ends[n] - number, 0], pairs[ends[n] - number, 1] = i, other
                if first:
                    break
        if len(pairs) == 0:
            counts[n] = number


def first_pairs(prepared: Prepared, accuracy: Accuracy, states: Floats) -> Integers:
    """Return a pair (n, 2) that may collide in each state, as rows of names; -1 for none."""
    count = len(states)
    ends, pairs = np.arange(1, count + 1), np.empty((count, 2), np.int64)
    pairs.fill(-1)
    question = int(accuracy), states, *prepared.touching, True
    run(pairs_kernel, count, FEWEST_STATES, prepared.held, question, (ends, ends, pairs))
    return pairs


def all_pairs(
    prepared: Prepared, accuracy: Accuracy, states: Floats, near: PairValues
) -> tuple[Rows, Integers]:
    """Return all pairs (m, 2) of bodies that may collide, and their states (m,), ascending.

    near: distances within which bodies count as colliding.
    """
    counts = np.zeros(len(states), np.int64)
    question = prepared.held, (int(accuracy), states, *near, False)
    no_room = np.empty((0, 2), np.int64)
    run(pairs_kernel, len(states), FEWEST_STATES, *question, (counts, counts, no_room))
    pairs = np.empty((int(counts.sum()), 2), np.int64)
    run(pairs_kernel, len(states), FEWEST_STATES, *question, (counts, np.cumsum(counts), pairs))
    return np.repeat(np.arange(len(states)), counts), pairs


def check_states(
    prepared: Prepared, accuracy: Accuracy, states: Floats, every: bool
) -> StateReport:
    """Return which states (n, joints) are valid; every: whether to find all colliding pairs."""
    first = first_pairs(prepared, accuracy, states)
    colliding = None
    if accuracy == Accuracy.MESH:
        rows = np.flatnonzero(first[:, 0] >= 0)
        near = np.ascontiguousarray(states[rows])
        numbers, pairs = all_pairs(prepared, accuracy, near, prepared.touching)
        kept = mesh_collisions_of(prepared, near[numbers], pairs)
        colliding = _named_pairs(prepared, rows[numbers[kept]], pairs[kept])
        first = np.full_like(first, -1)
        rows, places = np.unique(colliding.states, return_index=True)
        first[rows] = colliding.pairs[places]
    elif every:
        rows, pairs = all_pairs(prepared, accuracy, states, prepared.touching)
        colliding = _named_pairs(prepared, rows, pairs)
    out = prepared.limits.exceeded(states)
    return StateReport(out, first, prepared.names, colliding if every else None)


def _named_pairs(prepared: Prepared, states: Rows, pairs: Integers) -> StatePairs:
    """Return pairs of bodies as pairs of links and objects, each once per state."""
    unique = np.unique(np.column_stack([states, prepared.owners_of(pairs)]), axis=0)
    return StatePairs(unique[:, 0], unique[:, 1:])
