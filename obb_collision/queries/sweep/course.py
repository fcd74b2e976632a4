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

"""Course of two bodies of any shape: what sweeps of hulls and of meshes share.

Each pair is looked at from the first of the two points that its bodies turn about, so that neither
a way that both share nor being far away costs digits.

Rounding is that of ``rigid``: places and rotations that are off shift a gap by ``blur_at`` or less.
"""

from __future__ import annotations

from typing import NamedTuple

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import axes_of, norm, plus, scaled, vector_at
from obb_collision.queries.meshes.tree_boxes import Place
from obb_collision.queries.sweep.motion import offset_and_way, rotated, turned_by
from obb_collision.queries.sweep.rigid import FLOOR, POSITION, SPIN, TURN, TURNING, meeting_window
from obb_collision.typing import Floats, Vector

#: Maximum number of steps: beyond, the pair is undecided. Ordinary pairs take up to ten.
MAX_STEPS = 1000
#: Of bodies that do not turn: nearer than this counts as touching, relative to both radii. A
#: distance has an error of less than 1e-9 of both sizes.
FINE = 1e-8


class BodyMotion(NamedTuple):
    """The motion of n bodies during times 0 to 1, as arrays; as ``motion.Motion`` but for centres.

    A body turns about its pivot, which moves straight.
    """

    starts: Floats  #: (n, 3) pivots at time 0
    ends: Floats  #: (n, 3) pivots at time 1, or with ``seconds`` their velocities
    seconds: float  #: how long the velocities last; 0: they are places
    rotations: Floats  #: (n, 3, 3) at time 0
    turns: Floats  #: (n, 3) rotation vectors over the whole time
    arms: Floats  #: (n, 3) from the pivot to the body's origin at time 0
    radii: Floats  #: (n,) sizes of the bodies, of which tolerances are fractions
    reaches: Floats  #: (n,) of the spheres about the pivots that hold the bodies at all times


class Course(NamedTuple):
    """The motion of a pair, seen from the pivot of the first body."""

    pivot: Vector  #: of the second body at time 0
    way: Vector  #: what is added to it until time 1
    turns: tuple[Vector, Vector]  #: rotation vectors until time 1
    arms: tuple[Vector, Vector]  #: from the pivots to the origins at time 0
    reach: float  #: of both bodies about their pivots
    begin: float  #: from when to
    last: float  #: when they may touch
    near: float  #: a distance that counts as touching
    fine: float  #: one that is worth coming down to
    stray: tuple[float, float]  #: by how much gaps are off at time 0, and more per unit of time


@njit
def course_of(motion: BodyMotion, i: int, j: int, begin: float, tolerance: float) -> Course:
    """Return the course of a pair from a time on."""
    p, _, way = offset_and_way(motion.starts, motion.ends, motion.seconds, i, j)
    u, v = vector_at(motion.turns, i), vector_at(motion.turns, j)
    reach = motion.reaches[i] + motion.reaches[j]
    first, last = meeting_window(p, way, reach)
    slower, faster = min(norm(u), norm(v)), max(norm(u), norm(v))
    if way[0] == 0.0 and way[1] == 0.0 and way[2] == 0.0 and slower == 0.0:
        last = min(last, first + TURN / faster) if faster > 0.0 else first
    r, s = motion.radii[i], motion.radii[j]
    near = max(tolerance * min(r, s), FLOOR * max(r, s))
    fine = min(near, FINE * (r + s)) if faster == 0.0 else near
    drift = POSITION * norm(way) + SPIN * (slower + faster) * reach
    stray = POSITION * norm(p) + 2.0 * TURNING * reach, drift
    arms = vector_at(motion.arms, i), vector_at(motion.arms, j)
    begin = max(begin, first)
    return Course(p, way, (u, v), arms, reach, begin, last, near, fine, stray)


@njit
def blur_at(course: Course, time: float) -> float:
    """Return by how much a gap at a time may be off, as places and rotations are."""
    return course.stray[0] + course.stray[1] * time


@njit
def places_at(
    motion: BodyMotion, i: int, j: int, course: Course, time: float
) -> tuple[Place, Place]:
    """Return where two bodies are at a time, seen from the pivot of the first."""
    turn, other = course.turns
    arm, far = turned_by(course.arms[0], turn, time), turned_by(course.arms[1], other, time)
    far = plus(plus(course.pivot, scaled(course.way, time)), far)
    return (
        Place(arm, rotated(axes_of(motion.rotations, i), turn, time)),
        Place(far, rotated(axes_of(motion.rotations, j), other, time)),
    )
