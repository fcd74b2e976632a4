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

"""How boxes move: what every kernel of sweeps reads, and where a box is at a time.

Time runs from 0 to 1. The origin of a box, a point fixed to it, goes along a line at constant
speed while the box turns about it at constant speed; its centre is at the end of the ``arm`` from
there. Displacements are what is stored and subtracted, never positions at the end: far from the
origin of the frame these have lost the digits that matter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import cross, dot, minus, norm, plus, scaled, vector_at
from obb_collision.typing import Axes, Floats, Vector

#: A turn: unit axis, sine, 1 - cosine.
Spin = tuple[Vector, float, float]


class Motion(NamedTuple):
    """The motion of n boxes, as arrays."""

    starts: Floats  #: (n, 3) centres at time 0
    ends: Floats  #: (n, 3) centres at time 1, or with ``seconds`` velocities of the origins
    seconds: float  #: how long the velocities last; 0: they are centres
    rotations: Floats  #: (n, 3, 3) at time 0
    half_extents: Floats  #: (n, 3)
    radii: Floats  #: (n,) of the spheres round the boxes
    turns: Floats  #: (n, 3) rotation vectors over the whole time
    arms: Floats  #: (n, 3) from origin to centre at time 0; zero for boxes that do not turn
    reaches: Floats  #: (n,) of the spheres about the origins that hold the boxes at all times


@njit
def offset_and_way(
    starts: Floats, ends: Floats, seconds: float, i: int, j: int
) -> tuple[Vector, Vector, Vector]:
    """Return the offset of the centres from i to j at time 0, at time 1, and their difference.

    But for the arms: as if both boxes kept their rotations. Off by at most 4 unit roundoffs of
    the offset at 0 and the way; a way that both share cancels before anything is rounded.
    """
    first = minus(vector_at(starts, j), vector_at(starts, i))
    change = minus(vector_at(ends, j), vector_at(ends, i))
    if seconds == 0.0:
        return first, change, minus(change, first)
    way = scaled(change, seconds)
    return first, plus(first, way), way


@njit
def place_at(starts: Floats, ends: Floats, seconds: float, i: int, time: float) -> Vector:
    """Return the centre of a box at a time, but for its arm."""
    start, end = vector_at(starts, i), vector_at(ends, i)
    moved = minus(end, start) if seconds == 0.0 else scaled(end, seconds)
    return plus(start, scaled(moved, time))


@njit
def swing(motion: Motion, i: int, time: float) -> Vector:
    """Return how far turning about its origin has taken the centre of a box."""
    arm = vector_at(motion.arms, i)
    if arm[0] == 0.0 and arm[1] == 0.0 and arm[2] == 0.0:
        return arm
    return minus(turned_by(arm, vector_at(motion.turns, i), time), arm)


@njit
def turned_by(v: Vector, turn: Vector, time: float) -> Vector:
    """Return a vector turned by ``time`` times a rotation vector."""
    return v if time == 0.0 else _spun(v, _spin(turn, time))


@njit
def rotated(axes: Axes, turn: Vector, time: float) -> Axes:
    """Return axes turned by ``time`` times a rotation vector."""
    spin = _spin(turn, time)
    if spin[1] == 0.0 and spin[2] == 0.0:
        return axes
    return _spun(axes[0], spin), _spun(axes[1], spin), _spun(axes[2], spin)


@njit
def _spin(turn: Vector, time: float) -> Spin:
    """Return the unit axis of a turn, the sine of its angle, and 1 minus the cosine."""
    angle = norm(turn)
    if angle == 0.0 or time == 0.0:
        return (0.0, 0.0, 0.0), 0.0, 0.0
    half = math.sin(0.5 * (angle * time))
    # 2 sin^2 of half the angle: without cancellation
    axis = turn[0] / angle, turn[1] / angle, turn[2] / angle
    return axis, math.sin(angle * time), 2.0 * half * half


@njit
def _spun(v: Vector, spin: Spin) -> Vector:
    """Return a vector turned (Rodrigues)."""
    axis, sine, bend = spin
    along = minus(scaled(axis, dot(axis, v)), v)
    return plus(plus(v, scaled(cross(axis, v), sine)), scaled(along, bend))
