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

"""What spinning boxes sweep: slices of time in which two of them certainly stay apart.

A box that turns a long way is held by the body it sweeps in a whole turn about its origin: the
circles of its corners about the axis of the turn and what lies between them. That body only moves
along a line, however many turns the box makes. One that turns less than ``WHOLE`` in a slice is
held by its place in the middle, grown by what its corners move from there. A direction along
which one body stays beyond the other from the beginning to the end of a slice proves it free; it is
searched as in ``meshes.convex`` (Gilbert, Johnson, Keerthi 1988); no error of the search counts.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.simplex import no_simplex, with_corner
from obb_collision.numerics.vec3 import dot, minus, norm, plus, scaled, vector_at
from obb_collision.typing import Axes, Floats, Vector

#: Radians in a slice from which on a box counts as turning all round.
WHOLE = 1.0
#: Directions tried: bodies a few hundredths of their size apart take 3 to 10.
SLICE_DIRECTIONS = 30
#: The search ends when the next point brings it nearer by less than this fraction.
SLICE_CONVERGED = 1e-6
#: Rounding of reaches and offsets, relative to these: 2048 unit roundoffs, where 64 are needed: 40
#: in a reach (``_farthest``), 8 in a corner, 6 in an offset, 10 in sums and the length of n.
SLICE_SLACK = 2048 * ROUNDOFF
#: Sine of the angle to the axis below which the direction across has lost half of its digits.
LEAST_TILT = 2.0**-26
#: Rows of the corners of a box (``fill_corners``): the axis of the turn, 8 corners, and in a row
#: how far the corners are at most from that axis.
CORNER_ROWS = 10


@njit
def fill_corners(axes: Axes, extents: Vector, arm: Vector, turn: Vector, out: Floats) -> None:
    """Write the unit axis of the turn and the corners from the origin (CORNER_ROWS, 3).

    The corners as they are at the time of axes and arm.
    """
    angle = norm(turn)
    axis = 0.0, 0.0, 1.0
    if angle > 0.0:
        axis = turn[0] / angle, turn[1] / angle, turn[2] / angle
    most = 0.0
    for n in range(8):
        corner = arm
        for k in range(3):
            side = extents[k] if n >> k & 1 else -extents[k]
            corner = plus(corner, scaled(axes[k], side))
        out[1 + n, 0], out[1 + n, 1], out[1 + n, 2] = corner
        around = minus(corner, scaled(axis, dot(corner, axis)))
        most = max(most, norm(around))
    out[0, 0], out[0, 1], out[0, 2] = axis
    out[9, 0] = most


@njit
def free_slice(
    first: Vector, last: Vector, a: Floats, angle_a: float, b: Floats, angle_b: float,
    blur: float,
) -> bool:  # fmt: skip
    """Return whether two boxes are certainly apart during a slice of time.

    first, last: offset of the origins from a to b at its two ends; a, b: corners in its middle;
    angle_a, angle_b: how far each turns; ``blur``: error of positions.
    """
    size = norm(first) + norm(last)
    bound = blur + SLICE_SLACK * (size + _radius(a) + _radius(b)) + _growth(a, angle_a)
    bound += _growth(b, angle_b)
    n, simplex = scaled(plus(first, last), 0.5), no_simplex()
    for _ in range(SLICE_DIRECTIONS):
        length = norm(n)
        if not 0.0 < length < np.inf:
            return False
        n = scaled(n, 1.0 / length)
        back = scaled(n, -1.0)
        offset = first if dot(n, first) < dot(n, last) else last
        reach_a, p = _farthest(a, angle_a, n)
        reach_b, q = _farthest(b, angle_b, back)
        gap = dot(n, offset) - reach_a - reach_b
        if gap > bound:
            return True
        if simplex.size > 0 and not length - gap > SLICE_CONVERGED * length:
            return False
        simplex = with_corner(simplex, plus(offset, minus(q, p)))
        n = simplex.nearest
        # the nearest points of what is left of the difference: no direction shows more
        if simplex.size == 4 or not norm(n) > bound:
            return False
    return False


@njit
def _growth(corners: Floats, angle: float) -> float:
    """Return how far a body is grown that does not turn all round in a slice.

    Half of the angle either way from the middle: a chord is shorter than its arc.
    """
    return 0.5 * angle * corners[9, 0] if angle < WHOLE else 0.0


@njit
def _radius(corners: Floats) -> float:
    """Return the distance from the origin to a corner, to a few roundoffs at least the largest."""
    along = 0.0
    for k in range(1, 9):
        along = max(along, abs(dot(vector_at(corners, k), vector_at(corners, 0))))
    return along + corners[9, 0]


@njit
def _farthest(corners: Floats, angle: float, n: Vector) -> tuple[float, Vector]:
    """Return how far a body, before it is grown, reaches along a unit vector, and a point there.

    A circle of a corner c reaches height * rise + radius * tilt: parts of c and of n along the axis
    and across. Each is a sum of terms no longer than c or n, so its error is absolute: 7 u of c or
    of n along, 17 u across (the stored axis is off by 4 u), and so 40 u of c in the reach, whatever
    the tilt. The point is as far as digits allow, and only leads the search: near the axis, where
    the direction across is rounding, it is the centre of the circle.
    """
    most, best, radius = -np.inf, vector_at(corners, 1), 0.0
    axis = vector_at(corners, 0)
    rise = dot(n, axis)
    out = minus(n, scaled(axis, rise))
    tilt = norm(out)
    for k in range(1, 9):
        corner, around = vector_at(corners, k), 0.0
        reach = dot(n, corner)
        if angle >= WHOLE:
            height = dot(corner, axis)
            across = minus(corner, scaled(axis, height))
            around = math.sqrt(dot(across, across))
            corner, reach = scaled(axis, height), height * rise + around * tilt
        if reach > most:
            most, best, radius = reach, corner, around
    return most, plus(best, scaled(out, radius / tilt)) if tilt > LEAST_TILT else best
