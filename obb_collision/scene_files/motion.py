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

"""Motions of objects and joints over time, for demos and measurements.

A pose is x y z qx qy qz qw, a twist linear x y z (m/s) and angular x y z (rad/s) of the object's
origin, both in the scene's frame.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import fmod

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.poses import (
    Pose,
    compose_poses,
    inverse_poses,
    multiply_quaternions,
    rotate_vectors,
    unit_poses,
    unit_quaternions,
)
from obb_collision.geometry.values import read_only_view
from obb_collision.typing import Floats


@dataclass(frozen=True)
class JointLoop:
    """Through states of joints and back to the first, at constant velocities in between.

    states (n, joints); times (n,): when it is at each, seconds, ascending from 0; period: when it
    is back at the first.
    """

    states: tuple[tuple[float, ...], ...]
    times: tuple[float, ...]
    period: float

    def at(self, time: float) -> tuple[Floats, Floats]:
        """Return values (joints,) and velocities (joints,) at a time (s)."""
        passed = fmod(time, self.period)
        row = bisect_right(self.times, passed) - 1
        states, times = np.array(self.states), (*self.times, self.period)
        velocities = (states[(row + 1) % len(states)] - states[row]) / (times[row + 1] - times[row])
        return states[row] + velocities * (passed - times[row]), velocities


Twist = tuple[float, float, float, float, float, float]
#: Poses (n, 7) and twists (n, 6).
States = tuple[Floats, Floats]
#: A pose (7,), a constant twist (6,) from there, and the seconds that have passed.
Leg = tuple[ArrayLike, ArrayLike, float]


@dataclass(frozen=True)
class Steady:
    """A constant twist from the object's pose; with ``period`` (s) it starts again there."""

    twist: Twist
    period: float | None = None

    def leg(self, start: ArrayLike, time: float) -> Leg:
        """Return the leg at a time (s)."""
        return start, self.twist, time if self.period is None else fmod(time, self.period)


@dataclass(frozen=True)
class Loop:
    """Through poses and back to the first, straight and at constant speed from one to the next.

    times (n,): when it is at each, seconds, ascending from 0; period: when it is back at the first.
    """

    poses: tuple[Pose, ...]
    times: tuple[float, ...]
    period: float

    @cached_property
    def twists(self) -> Floats:
        """Twists (n, 6) from each pose to the next."""
        poses, times = np.array(self.poses), np.array((*self.times, self.period))
        return read_only_view(twists_between(poses, np.roll(poses, -1, axis=0), np.diff(times)))

    def leg(self, start: ArrayLike, time: float) -> Leg:
        """Return the leg at a time (s); ``start`` is not needed."""
        passed = fmod(time, self.period)
        row = bisect_right(self.times, passed) - 1
        return self.poses[row], self.twists[row], passed - self.times[row]


@dataclass(frozen=True)
class Follow:
    """Carried by another object, at its initial pose relative to it.

    loop: how it moves relative to the other, in the frame of whose pose; None: not at all.
    """

    name: str
    loop: Loop | None = None


Motion = Steady | Loop | Follow


def states_at(
    starts: Floats, motions: Sequence[Motion | None], rows: Mapping[str, int], time: float
) -> States:
    """Return the states of n objects at a time (s), from their poses (n, 7) at the start.

    rows: of the objects by name, for those that follow one. Poses of objects at rest stay the same,
    bit for bit.
    """
    poses, twists = _own_states(starts, motions, time)
    levels = list(_followers(motions, rows))
    begun = _own_states(starts, motions, 0.0)[0] if levels else poses
    for level in levels:
        found, leaders = np.array(level).T
        fixed = np.array([_stays(motions[row]) for row in found])
        inner = compose_poses(inverse_poses(begun[leaders]), starts[found])[fixed]
        poses[found[fixed]] = begun[found[fixed]] = inner
        begun[found] = compose_poses(begun[leaders], begun[found])
        leading = poses[leaders], twists[leaders]
        poses[found], twists[found] = carried(leading, (poses[found], twists[found]))
    return poses, twists


def _stays(motion: Motion | None) -> bool:
    """Return whether an object stays where it is in the frame of the one it follows."""
    return isinstance(motion, Follow) and motion.loop is None


def _own_states(starts: Floats, motions: Sequence[Motion | None], time: float) -> States:
    """Return the states of all objects, of those that follow one in its frame."""
    poses, twists = starts.copy(), np.zeros((len(starts), 6))
    own = [motion.loop if isinstance(motion, Follow) else motion for motion in motions]
    legs = {k: motion.leg(starts[k], time) for k, motion in enumerate(own) if motion is not None}
    if legs:
        found = list(legs)
        begins, steady, passed = (np.array(column) for column in zip(*legs.values(), strict=True))
        poses[found], twists[found] = moved(unit_poses(begins), steady, passed), steady
    return poses, twists


def _followers(
    motions: Sequence[Motion | None], rows: Mapping[str, int]
) -> Iterable[list[tuple[int, int]]]:
    """Yield followers and their leaders, by row: first those whose leaders follow none."""
    waiting = {k: rows[m.name] for k, m in enumerate(motions) if isinstance(m, Follow)}
    while waiting:
        level = [(row, leader) for row, leader in waiting.items() if leader not in waiting]
        if not level:
            raise ValueError("objects follow each other in a loop")
        yield level
        for row, _ in level:
            del waiting[row]


def carried(leader: States, inner: States) -> States:
    """Return the states of objects with the states ``inner`` in the frames of their leaders."""
    (places, twists), (inner_poses, inner_twists) = leader, inner
    poses = compose_poses(places, inner_poses)
    turns = unit_quaternions(places[:, 3:])
    linear = twists[:, :3] + np.cross(twists[:, 3:], poses[:, :3] - places[:, :3])
    linear = linear + rotate_vectors(turns, inner_twists[:, :3])
    angular = twists[:, 3:] + rotate_vectors(turns, inner_twists[:, 3:])
    return poses, np.concatenate([linear, angular], axis=1)


def moved(poses: Floats, twists: Floats, seconds: Floats) -> Floats:
    """Return where constant twists take poses; without turning, quaternions stay bit for bit."""
    rates = np.linalg.norm(twists[:, 3:], axis=1)
    turning = rates > 0.0
    halves = 0.5 * rates * seconds
    shares = np.sin(halves) / np.where(turning, rates, 1.0)
    turns = np.concatenate([twists[:, 3:] * shares[:, None], np.cos(halves)[:, None]], axis=1)
    turned = unit_quaternions(multiply_quaternions(turns, poses[:, 3:]))
    result = poses.copy()
    result[:, :3] += twists[:, :3] * seconds[:, None]
    result[turning, 3:] = turned[turning]
    return result


def twists_between(begins: Floats, ends: Floats, seconds: Floats) -> Floats:
    """Return the constant twists (n, 6) from poses to others, turning the shorter way."""
    linear = (ends[:, :3] - begins[:, :3]) / seconds[:, None]
    turns = multiply_quaternions(ends[:, 3:], begins[:, 3:] * (-1.0, -1.0, -1.0, 1.0))
    lengths, w = np.linalg.norm(turns[:, :3], axis=1), turns[:, 3]
    angles = np.copysign(2.0 * np.arctan2(lengths, np.abs(w)), w)
    rates = angles / np.where(lengths > 0.0, lengths * seconds, 1.0)
    return np.concatenate([linear, turns[:, :3] * rates[:, None]], axis=1)
