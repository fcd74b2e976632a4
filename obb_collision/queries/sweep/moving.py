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

"""Boxes and how they move, from pose to pose or by twists, and bounds for any number of turns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import as_array, check_kind, check_magnitude
from obb_collision.numerics.constants import BOUND_SLACK, BOUND_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.vec3 import axes_of, dot, lengths, minus, norm, plus, scaled, vector_at
from obb_collision.queries.sweep.bounds import CORNER_ROWS, fill_corners
from obb_collision.queries.sweep.motion import (
    OUTWARD,
    Motion,
    bounding_radii,
    check_same_boxes,
    joined,
    rotated,
    swing,
    turns_between,
)
from obb_collision.typing import Floats, Integers

#: Rounding of a corner turned about the origin, relative to its distance from there: 24 unit
#: roundoffs and 5 of the angle, bounded by 64 and 8.
CORNER_SLACK = 64 * ROUNDOFF
ANGLE_SLACK = 8 * ROUNDOFF


def twist_motion(boxes: Boxes, twists: Floats, origins: ArrayLike | None, seconds: float) -> Motion:
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
    return Motion(c, speeds, seconds, r, h, radii, turns, arms, reaches)


def twist_bounds(
    boxes: Boxes, twists: Floats, origins: ArrayLike | None, seconds: float
) -> tuple[Floats, Floats]:
    """Return minimum and maximum (n, 3) that certainly contain boxes that keep their twists.

    Of what turns, the lesser of two: the circles of all corners about the axis, which hold it
    however far it turns; and the corners at the beginning and at the end, grown by the sag of the
    arcs between them, r w^2 / 8 for the angle w.
    """
    motion = twist_motion(boxes, twists, origins, seconds)
    minimum, maximum = boxes.world_bounds()
    _spread(motion, minimum, maximum, np.empty((2 * CORNER_ROWS, 3)))
    return minimum, maximum


@njit
def _spread(motion: Motion, minimum: Floats, maximum: Floats, work: Floats) -> None:
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
    motion: Motion, n: int, angle: float, low: Floats, high: Floats, work: Floats
) -> None:
    """Write bounds (3,) of a box that turns about its origin as if that stayed where it is."""
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

    Raises
    ------
    ValueError
        For different lengths or half extents.
    TypeError
        For anything but boxes.

    Examples
    --------
    >>> start = oc.Boxes([[0, 0, 0], [5, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
    >>> end = oc.Boxes([[4, 0, 0], [5, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
    >>> moving = oc.MovingBoxes(start, end)
    >>> oc.sweeps(moving, moving, [[0, 1]]).times.round(9).tolist()
    [0.75]
    """

    arrays: Motion
    """All of it, for kernels."""
    duration: float
    """How long the motion lasts: 1, or seconds."""

    def __init__(self, start: Boxes, end: Boxes) -> None:
        check_same_boxes(start, end)
        (c, r, h), turns = start.arrays, turns_between(start, end)
        radii = bounding_radii(h)
        ends = end.arrays.centers
        motion = Motion(c, ends, 0.0, r, h, radii, turns, np.zeros_like(c), radii)
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

        Raises
        ------
        ValueError
            For other shapes, a duration that is not positive, and ways too long.
        TypeError
            For anything but boxes.

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
) -> tuple[Motion, float, Integers]:
    """Return the motion of both sets, its duration, and the pairs (m, 2) as rows of it.

    Boxes that do not move take on the other's duration. Raises ValueError where both move, but not
    during the same times.
    """
    first, second = (_moving(x, y) for x, y in ((a, b), (b, a)))
    if a is b:
        return first.arrays, first.duration, pairs
    if (first.arrays.seconds, first.duration) != (second.arrays.seconds, second.duration):
        raise ValueError(f"a and b must move during the same times, got {first} and {second}")
    both = joined(first.arrays, second.arrays)
    return both, first.duration, pairs + np.array([0, len(first)])


def _moving(boxes: MovingBoxes | Boxes, other: MovingBoxes | Boxes) -> MovingBoxes:
    """Return boxes that may stand still as moving, during the times of others."""
    if isinstance(boxes, MovingBoxes):
        return boxes
    if isinstance(other, MovingBoxes) and other.arrays.seconds != 0.0:
        return MovingBoxes.from_twists(boxes, np.zeros((len(boxes), 6)), other.duration)
    return MovingBoxes(boxes, boxes)
