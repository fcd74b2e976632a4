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
from obb_collision.robots.bodies.state_arrays import Bodies, Placed, Tests, new_placed, place_state
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


class Speeds(NamedTuple):
    """How fast bodies move at most during one motion, metres per parameter, and what it takes."""

    reaches: Floats  #: (robots' bodies, links): from a joint's axis to the body, -1: not below it
    joints: Floats  #: (links, 2): linear and angular speed of each joint
    bodies: Floats  #: (robots' bodies,) against the world
    pairs: Floats  #: (p,) against each other


@njit
def joint_reaches(tree: Tree, frames: Integers, extents: Floats, moved: Floats) -> Floats:
    """Return ``Speeds.reaches`` of bodies that are within extents (b,) of their frames' origins.

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
def _set_speeds(tree: Tree, tests: Tests, starts: Floats, ends: Floats, n: int, s: Speeds) -> None:
    """Write the speeds of joints, bodies and pairs in motion n."""
    for link in range(len(tree.parents)):
        s.joints[link, 0] = s.joints[link, 1] = 0.0
        kind, column = tree.kinds[link], tree.columns[link]
        if kind == FIXED:
            continue
        speed = abs(tree.multipliers[link] * (ends[n, column] - starts[n, column]))
        if kind < PRISMATIC:
            s.joints[link, 1] = speed
        elif kind == PRISMATIC:
            s.joints[link, 0] = speed
        else:
            for k in range(3 if kind == FLOATING else 2):
                s.joints[link, 0] += abs(ends[n, column + k] - starts[n, column + k])
            if kind == PLANAR:
                s.joints[link, 1] = abs(ends[n, column + 2] - starts[n, column + 2])
            else:
                s.joints[link, 1] = _turning_speed(starts, ends, n, column + 3)
    for i in range(len(s.bodies)):
        s.bodies[i] = _speed(s, i, -1)
    for m in range(len(tests.pairs)):
        i, j = tests.pairs[m, 0], tests.pairs[m, 1]
        s.pairs[m] = _speed(s, i, j) + _speed(s, j, i)


@njit
def speeds_kernel(
    tree: Tree, tests: Tests, reaches: Floats, starts: Floats, ends: Floats, bodies: Floats,
    pairs: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    """Write the speeds of bodies (n, b) and of pairs (n, p) in each motion."""
    links = len(tree.parents)
    for n in range(start, stop):
        speeds = Speeds(reaches, np.empty((links, 2)), bodies[n], pairs[n])
        _set_speeds(tree, tests, starts, ends, n, speeds)


@njit
def _speed(s: Speeds, i: int, other: int) -> float:
    """Return the speed of body i by the joints above it that are not above another one."""
    total = 0.0
    for link in range(s.reaches.shape[1]):
        reach = s.reaches[i, link]
        if reach >= 0.0 and not (other >= 0 and s.reaches[other, link] >= 0.0):
            total += s.joints[link, 0]
            if s.joints[link, 1] > 0.0:
                total += s.joints[link, 1] * reach
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


class Room(NamedTuple):
    """Where one motion is examined."""

    placed: Placed
    speeds: Speeds
    grown: Floats  #: (robots' bodies,)
    grown_pairs: Floats  #: (p,)
    state: Floats  #: (1, joints)
    stack: Floats  #: (DEPTH, 2) intervals to examine, the earliest last


@njit
def motions_kernel(
    tree: Tree, bodies: Bodies, tests: Tests, level: int, reaches: Floats, starts: Floats,
    ends: Floats, resolution: float, parameters: Floats, undecided: Mask, pairs: Integers,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Write where each motion first collides (n,), NaN for free, if it is undecided, the pair."""
    links, own = len(tree.parents), tests.first
    speeds = Speeds(reaches, np.empty((links, 2)), np.empty(own), np.empty(len(tests.pairs)))
    room = Room(
        new_placed(bodies, tests, links), speeds, np.empty(own), np.empty(len(tests.pairs)),
        np.empty((1, starts.shape[1])), np.empty((DEPTH, 2)),
    )  # fmt: skip
    for n in range(start, stop):
        _set_speeds(tree, tests, starts, ends, n, speeds)
        parameter, certain, i, j = _first_collision(
            tree, bodies, tests, level, starts, ends, n, resolution, room
        )
        parameters[n], undecided[n] = parameter, not certain
        pairs[n, 0], pairs[n, 1] = i, j


@njit(inline=True, refcount=False)
def _first_collision(
    tree: Tree, bodies: Bodies, tests: Tests, level: int, starts: Floats, ends: Floats, n: int,
    resolution: float, room: Room,
) -> tuple[float, bool, int, int]:  # fmt: skip
    """Return up to where motion n is free, whether that is certain to be all, and the pair."""
    stack, placed = room.stack, room.placed
    stack[0, 0], stack[0, 1] = 0.0, 1.0
    depth, hit, one, other, tried = 1, np.inf, -1, -1, 0
    while depth > 0:
        depth -= 1
        tried += 1
        first, last = stack[depth, 0], stack[depth, 1]
        middle, half = 0.5 * (first + last), 0.5 * (last - first) * BOUND_GROWTH
        found, kind = _examined(tree, bodies, tests, level, starts, ends, n, middle, half, room)
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
            certain = hit < np.inf or _collides_after(
                tree, bodies, tests, level, starts, ends, n, last, last - first, room
            )
            return first, certain, i, j
        else:
            stack[depth, 0], stack[depth, 1] = middle, last
            stack[depth + 1, 0], stack[depth + 1, 1] = first, middle
            depth += 2
    return (np.nan if hit == np.inf else hit), True, one, other


@njit(inline=True, refcount=False)
def _fastest(speeds: Speeds) -> float:
    """Return the largest speed of any body or pair."""
    fastest = 0.0
    for speed in speeds.bodies:
        fastest = max(fastest, speed)
    for speed in speeds.pairs:
        fastest = max(fastest, speed)
    return fastest


@njit(inline=True, refcount=False)
def _collides_after(
    tree: Tree, bodies: Bodies, tests: Tests, level: int, starts: Floats, ends: Floats, n: int,
    time: float, step: float, room: Room,
) -> bool:  # fmt: skip
    """Return whether a state collides soon after a time: then what led to it was no near miss."""
    for _ in range(PROBES):
        if time > 1.0:
            return False
        _, kind = _examined(tree, bodies, tests, level, starts, ends, n, time, 0.0, room)
        if kind != FREE:
            return True
        time, step = time + step, 2.0 * step
    return False


@njit(inline=True, refcount=False)
def _examined(
    tree: Tree, bodies: Bodies, tests: Tests, level: int, starts: Floats, ends: Floats, n: int,
    time: float, half: float, room: Room,
) -> tuple[int, int]:  # fmt: skip
    """Return what a state proves of motion n for the time ``half`` before and after it.

    FREE, COLLIDING (itself) or OPEN, and the candidate that is the reason.
    """
    state, placed = room.state, room.placed
    for k in range(state.shape[1]):
        state[0, k] = starts[n, k] + time * (ends[n, k] - starts[n, k])
    for i in range(tests.first):
        room.grown[i] = half * room.speeds.bodies[i] if half > 0.0 else 0.0
    for m in range(len(tests.pairs)):
        room.grown_pairs[m] = half * room.speeds.pairs[m] if half > 0.0 else 0.0
    place_state(tree, bodies, tests, state, 0, placed)
    count = gather(bodies, tests, placed, room.grown, room.grown_pairs, True)
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
