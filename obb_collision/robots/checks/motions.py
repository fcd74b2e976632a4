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

"""Kernels that check motions of robots from state to state, between the two as well.

All joints move linearly in the parameter t from 0 to 1. No point of a body moves faster than the
sum of what each joint above it can do: its speed, times the largest distance that the body can have
from its axis (Schwarzer, Saha and Latombe 2005). So a state whose bodies are farther apart than the
pair moves within a time is proof that the motion is free for as long, before and after. Where a
state is no such proof, its interval is halved, the earlier half first, until the pair moves less
than the resolution in it: that is undecided. A state that collides cuts off what comes after it.
What takes more than MOST_STATES, as a joint that turns a million times, is undecided, too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import norm, vector_at
from obb_collision.robots.checks.arrays import (
    Checked,
    PairValues,
    Placed,
    new_placed,
    place_state,
)
from obb_collision.robots.checks.states import gather, may_collide
from obb_collision.robots.kinematics.kinematics import FIXED, FLOATING, PLANAR, PRISMATIC, Tree
from obb_collision.typing import Floats, Integers, Mask

#: Relative growth of bounds: more than the roundings of all that goes into them.
BOUND_GROWTH = 1.0 + 1e-9
#: Halvings after which an interval has no doubles left to be halved at.
DEPTH = 64
#: States of one motion; what is open after so many is undecided. Usual motions take some hundred.
MOST_STATES = 20_000
#: States tried after an undecided interval, each twice as far away as the one before.
PROBES = 12
#: What is found in an interval: its state proves it free, collides, or neither.
FREE, COLLIDING, OPEN = -1, -2, 0


class Motions(NamedTuple):
    """Motions from starts to ends (n, joints); bodies are nowhere farther from joints than reaches.

    reaches (robots' bodies, links): from a joint's axis to the body, -1: not below it.
    """

    starts: Floats
    ends: Floats
    reaches: Floats


class FirstHits(NamedTuple):
    """Where each motion first collides (n,), NaN for free, if it is undecided, the pair (n, 2)."""

    parameters: Floats
    undecided: Mask
    pairs: Integers


class MotionState(NamedTuple):
    """Where one motion is examined; speeds are bounds, metres per parameter."""

    placed: Placed
    joints: Floats  #: (links, 2): linear and angular speed of each joint
    speeds: PairValues
    near: PairValues
    state: Floats  #: (1, joints)
    stack: Floats  #: (DEPTH, 2) intervals to examine, the earliest last


@njit
def joint_reaches(tree: Tree, frames: Integers, extents: Floats, moved: Floats) -> Floats:
    """Return ``Motions.reaches`` of bodies that are within extents (b,) of their frames' origins.

    moved (columns,): the largest magnitude of each joint's value in all motions.
    """
    reaches = np.full((len(frames), len(tree.parents)), -1.0)
    for i in range(len(frames)):
        reach, link = extents[i], frames[i]
        while link >= 0:
            kind, column = tree.kinds[link], tree.columns[link]
            reach += norm(vector_at(tree.translations, link))
            if kind != FIXED:
                reaches[i, link] = (reach - norm(vector_at(tree.translations, link))) * BOUND_GROWTH
            if kind == PRISMATIC:
                reach += abs(tree.multipliers[link]) * moved[column] + abs(tree.offsets[link])
            elif kind >= PLANAR:
                for k in range(3 if kind == FLOATING else 2):
                    reach += moved[column + k]
            link = tree.parents[link]
    return reaches


@njit
def _set_speeds(
    checked: Checked, motions: Motions, n: int, joints: Floats, speeds: PairValues, row: int
) -> None:
    """Write the speeds of joints, and those of bodies and pairs to a row, in motion n."""
    tree, pairs, (starts, ends, reaches) = checked.tree, checked.tests.pairs, motions
    for link in range(len(tree.parents)):
        joints[link, 0] = joints[link, 1] = 0.0
        kind, column = tree.kinds[link], tree.columns[link]
        if kind == FIXED:
            continue
        speed = abs(tree.multipliers[link] * (ends[n, column] - starts[n, column]))
        if kind < PRISMATIC:
            joints[link, 1] = speed
        elif kind == PRISMATIC:
            joints[link, 0] = speed
        else:
            for k in range(3 if kind == FLOATING else 2):
                joints[link, 0] += abs(ends[n, column + k] - starts[n, column + k])
            if kind == PLANAR:
                joints[link, 1] = abs(ends[n, column + 2] - starts[n, column + 2])
            else:
                joints[link, 1] = _turning_speed(starts, ends, n, column + 3)
    for i in range(len(reaches)):
        speeds.bodies[row, i] = _speed(reaches, joints, i, -1)
    for m in range(len(pairs)):
        i, j = pairs[m, 0], pairs[m, 1]
        speeds.pairs[row, m] = _speed(reaches, joints, i, j) + _speed(reaches, joints, j, i)


@njit
def speeds_kernel(
    checked: Checked, motions: Motions, speeds: PairValues, start: int, stop: int
) -> None:
    """Write the speeds of bodies and of pairs in each motion."""
    joints = np.empty((len(checked.tree.parents), 2))
    for n in range(start, stop):
        _set_speeds(checked, motions, n, joints, speeds, n)


@njit
def _speed(reaches: Floats, joints: Floats, i: int, other: int) -> float:
    """Return the speed of body i by the joints above it that are not above another one."""
    total = 0.0
    for link in range(reaches.shape[1]):
        reach = reaches[i, link]
        if reach >= 0.0 and not (other >= 0 and reaches[other, link] >= 0.0):
            total += joints[link, 0]
            if joints[link, 1] > 0.0:
                total += joints[link, 1] * reach
    return total * BOUND_GROWTH


@njit
def _turning_speed(starts: Floats, ends: Floats, n: int, column: int) -> float:
    """Return the angular speed of a quaternion that moves linearly and is made a unit one.

    Twice its speed over its least length on the way; infinite if that may be zero.
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


@njit
def motions_kernel(
    checked: Checked,
    level: int,
    motions: Motions,
    resolution: float,
    hits: FirstHits,
    start: int,
    stop: int,
) -> None:
    """Write where each motion first collides."""
    own, pairs = checked.tests.first, len(checked.tests.pairs)
    room = MotionState(
        new_placed(checked),
        np.empty((len(checked.tree.parents), 2)),
        PairValues(np.empty((1, own)), np.empty((1, pairs))),
        PairValues(np.empty((1, own)), np.empty((1, pairs))),
        np.empty((1, motions.starts.shape[1])),
        np.empty((DEPTH, 2)),
    )
    for n in range(start, stop):
        _set_speeds(checked, motions, n, room.joints, room.speeds, 0)
        parameter, certain, i, j = _first_collision(checked, level, motions, n, resolution, room)
        hits.parameters[n], hits.undecided[n] = parameter, not certain
        hits.pairs[n, 0], hits.pairs[n, 1] = i, j


@njit(inline=True, refcount=False)
def _first_collision(
    checked: Checked, level: int, motions: Motions, n: int, resolution: float, room: MotionState
) -> tuple[float, bool, int, int]:
    """Return up to where motion n is free, whether that is certain to be all, and the pair.

    Where an interval is open, and no state after it collides soon, what led to it is a near miss.
    """
    stack, placed = room.stack, room.placed
    stack[0, 0], stack[0, 1] = 0.0, 1.0
    depth, hit, one, other, tried, probes = 1, np.inf, -1, -1, 0, 0
    i = j = -1
    first = last = step = 0.0
    while depth > 0:
        middle, half = last, 0.0
        if probes == 0:
            depth -= 1
            tried += 1
            first, last = stack[depth, 0], stack[depth, 1]
            middle, half = 0.5 * (first + last), 0.5 * (last - first) * BOUND_GROWTH
        found, kind = _examined(checked, level, motions, n, middle, half, room)
        if probes > 0:
            last, step, probes = last + step, 2.0 * step, probes - 1
            if kind != FREE or probes == 0 or last > 1.0:
                return first, kind != FREE, i, j
            continue
        if kind == FREE:
            continue
        i, j = placed.candidates[found, 0], placed.candidates[found, 1]
        near = 0.0 if kind == COLLIDING else placed.grown[found]
        last_of_all = not first < middle < last or depth + 2 > DEPTH
        if kind == COLLIDING:
            hit, one, other, depth = middle, i, j, 1  # what is waiting comes later
            stack[0, 0], stack[0, 1] = first, middle
            enough = last_of_all or tried >= MOST_STATES
            if enough or half * _fastest(room.speeds) <= resolution:
                return first, True, i, j
        elif last_of_all or near <= resolution or tried >= MOST_STATES:
            if hit < np.inf:
                return first, True, i, j
            depth, probes, step = 1, PROBES, last - first
        else:
            stack[depth, 0], stack[depth, 1] = middle, last
            stack[depth + 1, 0], stack[depth + 1, 1] = first, middle
            depth += 2
    return (np.nan if hit == np.inf else hit), True, one, other


@njit(inline=True, refcount=False)
def _fastest(speeds: PairValues) -> float:
    """Return the largest speed of any body or pair."""
    fastest = 0.0
    for i in range(speeds.bodies.shape[1]):
        fastest = max(fastest, speeds.bodies[0, i])
    for m in range(speeds.pairs.shape[1]):
        fastest = max(fastest, speeds.pairs[0, m])
    return fastest


@njit(inline=True, refcount=False)
def _examined(
    checked: Checked,
    level: int,
    motions: Motions,
    n: int,
    time: float,
    half: float,
    room: MotionState,
) -> tuple[int, int]:
    """Return what a state proves of motion n for the time ``half`` before and after it.

    FREE, COLLIDING (itself) or OPEN, and the candidate that is the reason.
    """
    starts, ends, bodies = motions.starts, motions.ends, checked.bodies
    state, placed, near, speeds = room.state, room.placed, room.near, room.speeds
    for k in range(state.shape[1]):
        state[0, k] = starts[n, k] + time * (ends[n, k] - starts[n, k])
    for i in range(near.bodies.shape[1]):
        near.bodies[0, i] = half * speeds.bodies[0, i] if half > 0.0 else 0.0
    for m in range(near.pairs.shape[1]):
        near.pairs[0, m] = half * speeds.pairs[0, m] if half > 0.0 else 0.0
    place_state(checked, state, 0, placed)
    count = gather(checked, placed, near, 0, True)
    if count < 0:
        return 0, COLLIDING
    reason = -1
    for step in range(2 * count):
        m = step % count
        if step < count:  # is any within what it may move?
            if reason >= 0:
                continue
        elif reason < 0:
            break
        elif m < reason:
            continue
        i, j = placed.candidates[m, 0], placed.candidates[m, 1]
        limit = placed.grown[m] if step < count else 0.0
        if may_collide(bodies, placed, i, j, limit, level):
            if step >= count:
                return m, COLLIDING
            reason = m
    return max(reason, 0), FREE if reason < 0 else OPEN
