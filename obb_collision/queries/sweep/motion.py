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

"""Motion of boxes, from pose to pose or by twists: places at a time, turns, swept bounds.

Time runs from 0 to 1. The origin of a box, a point fixed to it, goes along a line at constant
speed while the box turns about it at constant speed; its centre is at the end of the ``arm`` from
there. Displacements are what is stored and subtracted, never positions at the end: far from the
origin of the frame these have lost the digits that matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import fill_quaternions
from obb_collision.geometry.validation import (
    as_array,
    check_kind,
    check_lengths,
    check_magnitude,
    refuse_where,
)
from obb_collision.numerics.constants import BOUND_SLACK, BOUND_UNDERFLOW, ROUNDOFF, SMALL_SQUARE
from obb_collision.numerics.exact import length
from obb_collision.numerics.vec3 import (
    ZERO,
    axes_of,
    cross,
    dot,
    lengths,
    minus,
    norm,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.sweep.bounds import CORNER_ROWS, fill_corners
from obb_collision.typing import Axes, Floats, Integers, Vector

M = TypeVar("M", bound="tuple[Any, ...]")

#: A turn: unit axis, sine, 1 - cosine.
Spin = tuple[Vector, float, float]


class BoxMotion(NamedTuple):
    """The motion of n boxes during times 0 to 1, as arrays."""

    starts: Floats  #: (n, 3) centres at time 0
    ends: Floats  #: (n, 3) centres at time 1, or with ``seconds`` velocities of the origins
    seconds: float  #: how long the velocities last; 0: they are centres
    rotations: Floats  #: (n, 3, 3) at time 0
    half_extents: Floats  #: (n, 3)
    radii: Floats  #: (n,) of the spheres round the boxes
    turns: Floats  #: (n, 3) rotation vectors over the whole time
    arms: Floats  #: (n, 3) from origin to centre at time 0; zero for boxes that do not turn
    reaches: Floats  #: (n,) of the spheres about the origins that hold the boxes at all times


def joined_motions(a: M, b: M) -> M:
    """Return the motion of both sets, first that of a; they have the same times."""
    columns = zip(a, b, strict=True)
    both = (x if isinstance(x, float) else np.concatenate([x, y]) for x, y in columns)
    return type(a)._make(both)  # type: ignore[attr-defined]


@njit
def offset_and_way(
    starts: Floats, ends: Floats, seconds: float, i: int, j: int
) -> tuple[Vector, Vector, Vector]:
    """Return the offset of the centres from i to j at time 0, at time 1, and their difference.

    Without the arms: as if both boxes kept their rotations. Off by at most 4 unit roundoffs of the
    offset at 0 and the way; a way that both share cancels before anything is rounded.
    """
    first = minus(vector_at(starts, j), vector_at(starts, i))
    change = minus(vector_at(ends, j), vector_at(ends, i))
    if seconds == 0.0:
        return first, change, minus(change, first)
    way = scaled(change, seconds)
    return first, plus(first, way), way


@njit
def center_at(starts: Floats, ends: Floats, seconds: float, i: int, time: float) -> Vector:
    """Return the centre of a box at a time, without the turn of its arm."""
    start, end = vector_at(starts, i), vector_at(ends, i)
    moved = minus(end, start) if seconds == 0.0 else scaled(end, seconds)
    return plus(start, scaled(moved, time))


@njit
def swing(motion: BoxMotion, i: int, time: float) -> Vector:
    """Return how far the turn about its origin has moved the centre of a box."""
    arm = vector_at(motion.arms, i)
    if arm == ZERO:
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
        return ZERO, 0.0, 0.0
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


#: Rounding of a radius, or of a bound on motion: a few units of 2^-53.
OUTWARD = 1.0 + 32 * ROUNDOFF


def check_same_boxes(start: Boxes, end: Boxes) -> None:
    """Raise ValueError unless both have the same number of boxes with the same half extents."""
    check_kind(start, Boxes, "start")
    check_kind(end, Boxes, "end")
    check_lengths(start=start, end=end)
    differ = start.half_extents != end.half_extents
    refuse_where(differ, "end must have the half extents of start, they differ")


def turns_between(start: Boxes, end: Boxes) -> Floats:
    """Return the rotation vectors (n, 3), radians: angle at most pi times the unit axis.

    Exactly zero if both rotations are the same bit for bit. At exactly pi both ways are equally
    short, and rounding decides between them.
    """
    vectors = np.zeros((len(start), 3))
    turned = np.flatnonzero((start.rotations != end.rotations).any(axis=(1, 2)))
    _fill_turns(start.arrays.rotations, end.arrays.rotations, turned, vectors)
    return vectors


@njit
def _fill_turns(first: Floats, last: Floats, rows: np.ndarray, out: Floats) -> None:
    """Write rows of the rotation vectors (n, 3) from one rotation (n, 3, 3) to another."""
    relative, quaternion = np.empty((1, 3, 3)), np.empty((1, 4))
    for n in rows:
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += last[n, i, k] * first[n, j, k]
                relative[0, i, j] = total
        fill_quaternions(relative, quaternion)
        x, y, z, w = quaternion[0]
        sine = length(x, y, z)
        # Two rotations that differ by rounding may give a null axis: then there is no turn.
        if sine > 0.0:
            scale = 2.0 * math.atan2(sine, w) / sine
            out[n, 0], out[n, 1], out[n, 2] = x * scale, y * scale, z * scale


def bounding_radii(half_extents: Floats) -> Floats:
    """Return (n,) radii of the circumscribed spheres, rounded up."""
    radii = np.empty(len(half_extents))
    _fill_radii(half_extents, radii)
    return radii


@njit
def _fill_radii(half_extents: Floats, out: Floats) -> None:
    for n in range(len(half_extents)):
        x, y, z = vector_at(half_extents, n)
        square = x * x + y * y + z * z
        plain = math.sqrt(square) if SMALL_SQUARE < square < math.inf else length(x, y, z)
        out[n] = plain * OUTWARD + BOUND_UNDERFLOW


def swept_bounds(start: Boxes, end: Boxes) -> tuple[Floats, Floats]:
    """Return minimum and maximum (n, 3) of axis-aligned boxes that certainly contain each motion.

    The union of the bounds at both ends, which is all a motion without turning needs. A turn by
    the angle w takes a point at most radius w^2 / 8 away from the line between its ends (the
    error of linear interpolation), and never out of the sphere round the box: the lesser counts.
    Raises ValueError if lengths or half extents differ.
    """
    check_same_boxes(start, end)
    low_a, high_a = start.world_bounds()
    low_b, high_b = end.world_bounds()
    low, high = np.minimum(low_a, low_b), np.maximum(high_a, high_b)
    angles = lengths(turns_between(start, end))[:, None]
    radii = bounding_radii(start.arrays.half_extents)[:, None]
    sag = radii * (0.125 * OUTWARD) * angles * angles
    least, most = np.minimum(start.centers, end.centers), np.maximum(start.centers, end.centers)
    slack = BOUND_SLACK * (np.maximum(abs(least), abs(most)) + radii) + BOUND_UNDERFLOW
    return (
        np.where(angles > 0.0, np.maximum(low - sag, least - radii) - slack, low),
        np.where(angles > 0.0, np.minimum(high + sag, most + radii) + slack, high),
    )


def motion_bounds(start: Boxes, end: Boxes) -> Floats:
    """Return (n,) metres that no point of each box exceeds on its way, rounded up."""
    turned = lengths(turns_between(start, end)) * bounding_radii(start.arrays.half_extents)
    return (lengths(end.centers - start.centers) + turned) * OUTWARD


def sweep_needed(start: Boxes, end: Boxes) -> NDArray[np.bool_]:
    """Return (n,) whether a box moves so far that it could pass through something unseen.

    That is: farther than its smallest half extent, by the longest way of any of its points. A
    pair needs a sweep if either box does. Raises ValueError if lengths or half extents differ.

    What skipping the other pairs promises. Let two boxes be apart at the start and at the end,
    and M the sum of both ways. At a time t some axis that separated at the start is overlapped
    by at most what both moved until then, and likewise for the end and what they still move: so
    the depth (least translation that separates) is never more than M / 2. If the centre of one
    box were inside the other, the depth would be more than its smallest half extent. As M / 2 is
    not above the larger of both, the thicker box never gets its centre into the thinner one, let
    alone through it: thin plates are not passed through, however thin. What may go unseen is a
    graze at a corner or edge that begins and ends within the step, at most M / 2 deep.
    """
    check_same_boxes(start, end)
    far = motion_bounds(start, end) > start.half_extents.min(axis=1)
    return np.asarray(moved_between(start, end) & far)


def moved_between(start: Boxes, end: Boxes) -> NDArray[np.bool_]:
    """Return (n,) which boxes moved or turned at all."""
    turned = (start.rotations != end.rotations).any(axis=(1, 2))
    return np.asarray(turned | (start.centers != end.centers).any(axis=1))


#: Rounding of a corner turned about the origin, relative to its distance from there: 24 unit
#: roundoffs and 5 of the angle, bounded by 64 and 8.
CORNER_SLACK = 64 * ROUNDOFF
ANGLE_SLACK = 8 * ROUNDOFF


def twist_motion(
    boxes: Boxes, twists: Floats, origins: ArrayLike | None, seconds: float
) -> BoxMotion:
    """Return the motion of boxes with twists (n, 6) of their origins (n, 3), None for the centres.

    Raises ValueError for a wrong number of rows and for ways too long.
    """
    if len(twists) != len(boxes):
        raise ValueError(
            f"twists must have one row per box, got {len(twists)} rows for {len(boxes)} boxes"
        )
    with np.errstate(over="ignore"):
        moved = twists * seconds
        check_magnitude(boxes.centers + moved[:, :3], "twists times duration", by_row=True)
    check_magnitude(moved, "twists times duration", by_row=True)
    reaches = radii = bounding_radii(boxes.arrays.half_extents)
    arms = np.zeros_like(boxes.centers)
    if origins is not None:
        places = as_array(origins, "origins", (None, 3))
        if len(places) != len(boxes):
            raise ValueError(
                f"origins must have one row per box, got {len(places)} rows for {len(boxes)} boxes"
            )
        turning = twists[:, 3:].any(axis=1)
        arms[turning] = boxes.centers[turning] - places[turning]
        check_magnitude(arms, "distance of origins from the boxes", by_row=True)
        reaches = (radii + lengths(arms)) * OUTWARD
    speeds, turns = np.ascontiguousarray(twists[:, :3]), np.ascontiguousarray(moved[:, 3:])
    c, r, h = boxes.arrays
    return BoxMotion(c, speeds, seconds, r, h, radii, turns, arms, reaches)


def twist_bounds(
    boxes: Boxes, twists: Floats, origins: ArrayLike | None, seconds: float
) -> tuple[Floats, Floats]:
    """Return minimum and maximum (n, 3) that certainly contain boxes that keep their twists.

    For boxes that turn, the lesser of two: the circles of all corners about the axis, valid for any
    turn; and the corners at the beginning and at the end, grown by the sag of the arcs between
    them, r w^2 / 8 for the angle w.
    """
    motion = twist_motion(boxes, twists, origins, seconds)
    minimum, maximum = boxes.world_bounds()
    _spread(motion, minimum, maximum, np.empty((2 * CORNER_ROWS, 3)))
    return minimum, maximum


@njit
def _spread(motion: BoxMotion, minimum: Floats, maximum: Floats, work: Floats) -> None:
    """Grow bounds (n, 3) of the boxes at the beginning to those of their motion."""
    low, high = np.empty(3), np.empty(3)
    for n in range(len(minimum)):
        angle = norm(vector_at(motion.turns, n))
        for k in range(3):
            low[k], high[k] = minimum[n, k], maximum[n, k]
        if angle > 0.0:
            _turning_bounds(motion, n, angle, low, high, work)
        for k in range(3):
            way = motion.ends[n, k] * motion.seconds
            slack = BOUND_SLACK * (abs(way) + max(abs(low[k]), abs(high[k]))) + BOUND_UNDERFLOW
            minimum[n, k] = low[k] + min(way, 0.0) - (slack if way < 0.0 else 0.0)
            maximum[n, k] = high[k] + max(way, 0.0) + (slack if way > 0.0 else 0.0)


@njit
def _turning_bounds(
    motion: BoxMotion, n: int, angle: float, low: Floats, high: Floats, work: Floats
) -> None:
    """Write bounds (3,) of a box that turns about its origin, which stays in place."""
    first, last = work[:CORNER_ROWS], work[CORNER_ROWS:]
    axes, extents = axes_of(motion.rotations, n), vector_at(motion.half_extents, n)
    turn, arm = vector_at(motion.turns, n), vector_at(motion.arms, n)
    moved = plus(arm, swing(motion, n, 1.0))
    fill_corners(axes, extents, arm, turn, first)
    fill_corners(rotated(axes, turn, 1.0), extents, moved, turn, last)
    sag = 0.125 * angle * angle * OUTWARD * first[9, 0] + ANGLE_SLACK * angle * motion.reaches[n]
    pole = vector_at(first, 0)
    for k in range(3):
        axis = pole[k]
        tilt = math.hypot(pole[(k + 1) % 3], pole[(k + 2) % 3]) + CORNER_SLACK
        least, most, ring_least, ring_most = np.inf, -np.inf, np.inf, -np.inf
        for m in range(1, 9):
            corner = vector_at(first, m)
            height = dot(pole, corner)
            around = norm(minus(corner, scaled(pole, height)))
            ring_least = min(ring_least, height * axis - around * tilt)
            ring_most = max(ring_most, height * axis + around * tilt)
            least = min(least, first[m, k], last[m, k])
            most = max(most, first[m, k], last[m, k])
        center = motion.starts[n, k]
        slack = CORNER_SLACK * motion.reaches[n] + BOUND_SLACK * (abs(center) + abs(arm[k]))
        origin = center - arm[k]
        low[k] = origin + max(ring_least, least - sag) - slack - BOUND_UNDERFLOW
        high[k] = origin + min(ring_most, most + sag) + slack + BOUND_UNDERFLOW


@dataclass(frozen=True, eq=False, repr=False)
class MovingBoxes:
    """n boxes that move, each from its pose in ``start`` to that in ``end``, during times 0 to 1.

    Centres move along lines, and boxes turn the shortest way about a fixed axis, both at constant
    speed (by exactly pi either way is as short, and rounding decides).

    Parameters
    ----------
    start, end : Boxes
        Of the same half extents.

    Examples
    --------
    >>> start = oc.Boxes([[0, 0, 0], [5, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
    >>> end = oc.Boxes([[4, 0, 0], [5, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
    >>> moving = oc.MovingBoxes(start, end)
    >>> oc.sweeps(moving, moving, [[0, 1]]).times.round(9).tolist()
    [0.75]
    """

    arrays: BoxMotion
    """All of it, for kernels."""
    duration: float
    """How long the motion lasts: 1, or seconds."""

    def __init__(self, start: Boxes, end: Boxes) -> None:
        check_same_boxes(start, end)
        (c, r, h), turns = start.arrays, turns_between(start, end)
        radii = bounding_radii(h)
        ends = end.arrays.centers
        motion = BoxMotion(c, ends, 0.0, r, h, radii, turns, np.zeros_like(c), radii)
        vars(self).update(arrays=motion, duration=1.0)

    @classmethod
    def from_twists(
        cls, boxes: Boxes, twists: ArrayLike, duration: float, *, origins: ArrayLike | None = None
    ) -> MovingBoxes:
        """Return boxes that keep their twists; many turns are fine.

        Parameters
        ----------
        boxes : Boxes
            Where they are at time 0.
        twists : (n, 6) array_like
            Linear velocity x y z of the origin of each (m/s), angular velocity x y z (rad/s), in
            the frame of the boxes.
        duration : float
            Seconds, positive.
        origins : (n, 3) array_like, optional
            Points fixed to the boxes and anywhere, metres; the centres by default.

        Examples
        --------
        >>> boxes = oc.Boxes([[0, 0, 0], [5, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
        >>> moving = oc.MovingBoxes.from_twists(boxes, [[1, 0, 0, 0, 0, 0], [0] * 6], 10.0)
        >>> oc.sweeps(moving, moving, [[0, 1]]).times.round(9).tolist()
        [3.0]
        """
        check_kind(boxes, Boxes, "boxes")
        seconds = float(as_array(duration, "duration", ()))
        if seconds <= 0.0:
            raise ValueError(f"duration must be positive, got {seconds:g}")
        motion = twist_motion(boxes, as_array(twists, "twists", (None, 6)), origins, seconds)
        made = cls.__new__(cls)
        vars(made).update(arrays=motion, duration=seconds)
        return made

    def __len__(self) -> int:
        return len(self.arrays.starts)

    def __repr__(self) -> str:
        kind = "from pose to pose" if self.arrays.seconds == 0.0 else f"for {self.duration:g} s"
        return f"MovingBoxes({len(self)} {kind})"


def join_motions(
    a: MovingBoxes | Boxes, b: MovingBoxes | Boxes, pairs: Integers
) -> tuple[BoxMotion, float, Integers]:
    """Return the motion of both sets, its duration, and the pairs (m, 2) as rows of it.

    Boxes that do not move take the other's duration. Raises ValueError if both move during
    different times.
    """
    first, second = (_moving(x, y) for x, y in ((a, b), (b, a)))
    if a is b:
        return first.arrays, first.duration, pairs
    if (first.arrays.seconds, first.duration) != (second.arrays.seconds, second.duration):
        raise ValueError(f"a and b must move during the same times, got {first} and {second}")
    both = joined_motions(first.arrays, second.arrays)
    return both, first.duration, pairs + np.array([0, len(first)])


def _moving(boxes: MovingBoxes | Boxes, other: MovingBoxes | Boxes) -> MovingBoxes:
    """Return boxes that may stand still as moving ones, with the times of ``other``."""
    if isinstance(boxes, MovingBoxes):
        return boxes
    if isinstance(other, MovingBoxes) and other.arrays.seconds != 0.0:
        return MovingBoxes.from_twists(boxes, np.zeros((len(boxes), 6)), other.duration)
    return MovingBoxes(boxes, boxes)
