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

"""Data of the kernels of motions: questions, results, bounds of one motion, and its states.

``motions`` explains the method.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.bounds_tree import STACK
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.robots.checks.arrays import (
    Checked,
    Placed,
    most_balls,
    most_pairs,
    place_state,
)
from obb_collision.robots.kinematics.kinematics import FIXED, FLOATING, PLANAR, PRISMATIC, Tree
from obb_collision.typing import Floats, Integers, Mask

#: Relative growth of bounds: more than the roundings of all their terms.
BOUND_GROWTH = 1.0 + 1e-9
#: Maximum number of waiting intervals of a pair: each halving leaves one, and doubles allow 64.
DEPTH = 64
#: Largest angular speed: squares must be finite, and faster bodies are bounded by their reach.
FASTEST = 1e100
#: Number of states that are kept: the ends of a piece, and middles of intervals.
SLOTS = 8


class MotionQuestion(NamedTuple):
    """Motions from starts to ends (n, joints) to check on a level."""

    checked: Checked
    level: int
    first: bool  #: whether to find the first collision of each motion, instead of any
    resolution: float
    starts: Floats
    ends: Floats


class MotionHits(NamedTuple):
    """The results of motions (n,)."""

    fractions: Floats  #: (n,) where it collides, from 0 to 1; NaN if it is free
    undecided: Mask  #: (n,)
    pairs: Integers  #: (n, 2) of bodies, -1 for none


class OpenSpans(NamedTuple):
    """Pairs with meshes, and intervals in which their hulls may collide.

    Motion n has ``counts[n]`` of them, up to row ``ends[n]``.
    """

    counts: Integers
    ends: Integers
    pairs: Integers  #: (m, 3) as candidates of ``MotionRoom``
    spans: Floats  #: (m, 2)


class MovingPairs(NamedTuple):
    """Pairs in intervals of motions (k,), and how far they move."""

    motions: Integers
    pairs: Integers  #: (k, 3) as candidates; -1: the body that moves farthest in the whole motion
    times: Floats  #: (k, 2)
    moves: Floats  #: (k, 2) bounds of the way on a line, and off it


class Findings(NamedTuple):
    """Results of one motion: arrays of length 1, which inlined kernels can set."""

    limits: Floats  #: the time of the earliest collision so far; infinite for none
    certain: Mask  #: whether a state there certainly collides
    tried: Integers  #: number of intervals halved
    written: Integers  #: number of spans written


class Bends(NamedTuple):
    """Bounds of one motion: of the end of each chain a row of five numbers.

    They are its angular speed, the same without the last joint, its speed, its second derivative,
    and the length of the chain.
    """

    joints: Floats  #: (links, 3) angular speed, linear speed, farthest slide
    links: Floats  #: (links, 5) chains from the world to links
    bodies: Floats  #: (robots' bodies, 5) chains from the world to the farthest corner
    pairs: Floats  #: (u, 5) chains from the first link of a pair to the second


class MotionRoom(NamedTuple):
    """Arrays for one motion."""

    placed: Placed  #: SLOTS states; candidates (c, 3): the fixed body, the body that moves in its
    #: frame, and the row of the tested pair, -1 if the fixed body is one of the world
    times: Floats  #: (SLOTS,) of these states, NaN for none
    bends: Bends
    state: Floats  #: (1, joints)
    directions: Floats  #: (c, 3) from the second body of each candidate to the first
    stack: Floats  #: (DEPTH + 2, 2) intervals of a pair to halve, the earliest last
    slots: Integers  #: (DEPTH + 2, 2) the slots of their ends
    result: Findings


@njit(inline=True, refcount=False)
def _add_segment(bounds: Floats, row: int, along: float, across: float) -> None:
    """Add a segment to a chain; the last joint does not turn the part along its axis."""
    w, inner = bounds[row, 0], bounds[row, 1]
    bounds[row, 2] += w * across + inner * along
    bounds[row, 3] += w * w * across + inner * inner * along
    bounds[row, 4] += across + along


@njit(inline=True, refcount=False)
def _add_joint(bounds: Floats, row: int, joints: Floats, link: int) -> None:
    """Add a joint to a chain: it slides, and turns the segments behind it."""
    w, speed, far = bounds[row, 0], joints[link, 1], joints[link, 2]
    bounds[row, 2] += w * far + speed
    bounds[row, 3] += w * (w * far + 2.0 * speed)
    bounds[row, 4] += far
    bounds[row, 0], bounds[row, 1] = w + joints[link, 0], w


@njit(inline=True, refcount=False)
def set_joints(tree: Tree, starts: Floats, ends: Floats, n: int, joints: Floats) -> float:
    """Write the speeds of joints in motion n; return how much roundings may turn or move a link.

    A quaternion that moves linearly turns at an angular speed of at most w, which changes by at
    most w^2. With other joints this is bounded as an even turn at 2^(1/2) w.
    """
    blur = 0.0
    for link in range(len(tree.parents)):
        joints[link, 0] = joints[link, 1] = joints[link, 2] = 0.0
        kind, column, factor = tree.kinds[link], tree.columns[link], abs(tree.multipliers[link])
        if kind == FIXED:
            continue
        speed = factor * abs(ends[n, column] - starts[n, column])
        far = factor * max(abs(starts[n, column]), abs(ends[n, column]))
        if kind < PRISMATIC:
            joints[link, 0] = min(speed, FASTEST)
        elif kind == PRISMATIC:
            joints[link, 1], joints[link, 2] = speed, far + abs(tree.offsets[link])
        else:
            far = 0.0
            for k in range(3 if kind == FLOATING else 2):
                a, b = starts[n, column + k], ends[n, column + k]
                joints[link, 1] += abs(b - a)
                far += max(abs(a), abs(b))
            joints[link, 2] = far
            if kind == PLANAR:
                a, b = starts[n, column + 2], ends[n, column + 2]
                joints[link, 0] = min(abs(b - a), FASTEST)
                far += max(abs(a), abs(b))
            else:
                turn = math.sqrt(2.0) * _turning_speed(starts, ends, n, column + 3)
                joints[link, 0] = min(turn, FASTEST)
                far += 4.0
        blur += 8.0 * ROUNDOFF * far
    return blur


@njit(refcount=False)
def _turning_speed(starts: Floats, ends: Floats, n: int, column: int) -> float:
    """Return the largest angular speed of a quaternion that moves linearly and is normalised.

    It is twice its speed over its least length on the way; infinite if that may be zero.
    """
    square = along = length = 0.0
    for k in range(4):
        step = ends[n, column + k] - starts[n, column + k]
        square += step * step
        along -= step * starts[n, column + k]
    if square == 0.0:
        return 0.0
    t = min(max(along / square, 0.0), 1.0)
    for k in range(4):
        part = starts[n, column + k] + t * (ends[n, column + k] - starts[n, column + k])
        length += part * part
    return 2.0 * math.sqrt(square / length) if length > 1e-20 * square else np.inf


@njit(inline=True, refcount=False)
def set_bends(question: MotionQuestion, bends: Bends) -> None:
    """Write the bounds of links and bodies in the world, and of pairs."""
    parents, frames = question.checked.tree.parents, question.checked.bodies.frames
    chains, bodies = question.checked.chains, bends.bodies
    joints, links, pairs = bends.joints, bends.links, bends.pairs
    for link in range(len(parents)):
        for k in range(5):
            links[link, k] = links[parents[link], k] if parents[link] >= 0 else 0.0
        _add_segment(links, link, chains.links[link, 0], chains.links[link, 1])
        _add_joint(links, link, joints, link)
    for i in range(len(bodies)):
        for k in range(5):
            bodies[i, k] = links[frames[i], k]
        _add_segment(bodies, i, chains.bodies[i, 0], chains.bodies[i, 1])
    for u in range(len(pairs)):
        for k in range(5):
            pairs[u, k] = 0.0
        for step in range(chains.starts[u], chains.starts[u + 1]):
            _add_segment(pairs, u, chains.segments[step, 0], chains.segments[step, 1])
            if chains.joints[step] >= 0:
                _add_joint(pairs, u, joints, chains.joints[step])


@njit(inline=True, refcount=False)
def bend_of(span: float, second: float, length: float, blur: float) -> float:
    """Return a bound of how far a point is off the line between its places at an interval's ends.

    However often its chain turns, that is at most twice the length of the chain.
    """
    bend = min(0.125 * span * span * second, 2.0 * length)
    return BOUND_GROWTH * bend + blur * (1.0 + length)


@njit(inline=True, refcount=False)
def pair_bend(question: MotionQuestion, bends: Bends, m: int, span: float, blur: float) -> float:
    """Return the bend of the second body of pair m in the frame of the first."""
    u, j = question.checked.chains.rows[m], question.checked.tests.pairs[m, 1]
    along, across = question.checked.chains.bodies[j, 0], question.checked.chains.bodies[j, 1]
    w, inner = bends.pairs[u, 0], bends.pairs[u, 1]
    second = bends.pairs[u, 3] + w * w * across + inner * inner * along
    return bend_of(span, second, bends.pairs[u, 4] + along + across, blur)


@njit
def new_room(question: MotionQuestion) -> MotionRoom:
    """Return arrays for one motion."""
    checked, joints = question.checked, question.starts.shape[1]
    links, first = len(checked.tree.parents), checked.tests.first
    count, pairs = len(checked.bodies.frames), len(question.checked.chains.starts) - 1
    most = most_pairs(checked)
    placed = Placed(
        np.empty((SLOTS, links, 7)),
        np.zeros((SLOTS, links + 1, 3)),
        np.zeros((SLOTS, links + 1, 3, 3)),
        np.empty((SLOTS, count, 3)),
        np.empty((SLOTS, count, 3, 3)),
        np.zeros((SLOTS, count), np.bool_),
        np.empty((2, STACK), np.int64),
        np.empty((most, 3), np.int64),
        np.empty(most),
        np.empty(most_balls(checked.clouds), np.int64),
    )
    for slot in range(SLOTS):
        for k in range(3):
            placed.rotations[slot, links, k, k] = 1.0
    bends = Bends(
        np.empty((links, 3)), np.empty((links, 5)), np.empty((first, 5)), np.empty((pairs, 5))
    )
    return MotionRoom(
        placed,
        np.full(SLOTS, np.nan),
        bends,
        np.empty((1, joints)),
        np.empty((most, 3)),
        np.empty((DEPTH + 2, 2)),
        np.empty((DEPTH + 2, 2), np.int64),
        Findings(np.empty(1), np.empty(1, np.bool_), np.empty(1, np.int64), np.empty(1, np.int64)),
    )


@njit(inline=True, refcount=False)
def slot_of(placed: Placed, slot: int) -> Placed:
    """Return the state in a slot."""
    return Placed(
        placed.poses[slot : slot + 1],
        placed.positions[slot],
        placed.rotations[slot],
        placed.centers[slot],
        placed.axes[slot],
        placed.ready[slot],
        placed.waiting,
        placed.candidates,
        placed.grown,
        placed.balls,
    )


@njit(inline=True, refcount=False)
def place(question: MotionQuestion, n: int, time: float, slot: int, room: MotionRoom) -> None:
    """Place the state of motion n at a time in a slot, if it is not there already."""
    if room.times[slot] == time:
        return
    starts, ends, state = question.starts, question.ends, room.state
    for k in range(state.shape[1]):
        part = starts[n, k] + time * (ends[n, k] - starts[n, k])
        state[0, k] = ends[n, k] if time == 1.0 else part
    place_state(question.checked, state, 0, slot_of(room.placed, slot))
    room.times[slot] = time


@njit(refcount=False)
def free_slot(times: Floats, time: float, slot_a: int, slot_b: int) -> int:
    """Return the slot of a time, else a slot that may be overwritten, not one of two in use."""
    slot = 2
    for k in range(2, SLOTS):
        if times[k] == time:
            return k
        if k != slot_a and k != slot_b and (slot in (slot_a, slot_b) or math.isnan(times[k])):
            slot = k
    return slot
