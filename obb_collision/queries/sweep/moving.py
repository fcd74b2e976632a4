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

"""MovingBoxes: boxes and how they move, from pose to pose or by twists."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.kinds import check_kind
from obb_collision.geometry.validation import as_array
from obb_collision.queries.sweep.motion import bounding_radii, check_same_boxes, turns_between
from obb_collision.queries.sweep.poses import Motion
from obb_collision.queries.sweep.twists import twist_motion
from obb_collision.typing import Integers


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

    __slots__ = ("duration", "motion")

    motion: Motion
    duration: float
    """How long the motion lasts: 1, or seconds."""

    def __init__(self, start: Boxes, end: Boxes) -> None:
        check_same_boxes(start, end)
        radii = bounding_radii(start.half_extents)
        self.motion = Motion(
            start.centers, end.centers, 0.0, start.rotations, start.half_extents,
            radii, turns_between(start, end), np.zeros_like(start.centers), radii,
        )  # fmt: skip
        self.duration = 1.0

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
        made = cls.__new__(cls)
        made.motion = twist_motion(boxes, as_array(twists, "twists", (None, 6)), origins, seconds)
        made.duration = seconds
        return made

    def __len__(self) -> int:
        return len(self.motion.starts)

    def __repr__(self) -> str:
        kind = "from pose to pose" if self.motion.seconds == 0.0 else f"for {self.duration:g} s"
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
        return first.motion, first.duration, pairs
    if (first.motion.seconds, first.duration) != (second.motion.seconds, second.duration):
        raise ValueError(f"a and b must move during the same times, got {first} and {second}")
    columns = zip(first.motion, second.motion, strict=True)
    both = (x if isinstance(x, float) else np.concatenate([x, y]) for x, y in columns)
    return Motion._make(both), first.duration, pairs + np.array([0, len(first)])


def _moving(boxes: MovingBoxes | Boxes, other: MovingBoxes | Boxes) -> MovingBoxes:
    """Return boxes that may stand still as moving, during the times of others."""
    if isinstance(boxes, MovingBoxes):
        return boxes
    if isinstance(other, MovingBoxes) and other.motion.seconds != 0.0:
        return MovingBoxes.from_twists(boxes, np.zeros((len(boxes), 6)), other.duration)
    return MovingBoxes(boxes, boxes)
