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

"""Time at which two boxes that turn as they move come near: conservative advancement.

As long as one of the 15 axes separates, the boxes are apart (``sat``). From a time at
which axis n does, with gap g, the walk steps on for as long as n, carried along by the boxes it
belongs to, certainly goes on separating; then it looks for axes anew. It ends where the largest
gap is below the tolerance and no axis allows a step worth while (Mirtich 1996; the motion bound
along a moving axis instead of the distance's: Zhang, Lee, Kim 2006). See ``bounds`` for
the step.

Only the time during which the spheres about both origins meet is walked, so the length of a motion
costs little. Of a box that turns beside one that does neither turn nor move, one turn is enough.
Boxes that turn many times are bounded by the body they sweep in a whole turn (``bounds``), and
most of that time is skipped. Where the walk still takes too many steps, or rounding leaves less
than the tolerance, the pair is undecided, with the time until which the boxes are apart.

Rounding: lengths are in units of a power of two about as large as the boxes and their arms. With u
the unit roundoff, a place is off by 4 u of offset and way so far (``offset_and_way``, and the time
itself), bounded by POSITION_ROUNDING; a rotation by 16 u and 5 u of the angle so far, bounded by
ROTATION_ROUNDING and ANGLE_ROUNDING. During a step the boxes move as if displaced by that much.
This shifts a gap in proportion to the length of its axis (``blur``); the rounding of the step
itself is the same for short and long axes (``rounding``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import (
    ZERO,
    axes_of,
    cross,
    dot,
    minus,
    norm,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.sweep.bounds import (
    CORNER_ROWS,
    TURNING_ALL_ROUND,
    Approach,
    TurningBox,
    best_step,
    fill_corners,
    free_slice,
    turning,
)
from obb_collision.queries.sweep.motion import BoxMotion, rotated, turned_by
from obb_collision.queries.verdict.sat import box_at
from obb_collision.queries.verdict.verdict import SEPARATE, careful_verdict
from obb_collision.typing import Floats, Vector

#: Rows of work space: the corners of two boxes.
WORK_ROWS = 2 * CORNER_ROWS
#: Rounding of gaps, relative to the boxes and their offset, and to their arms.
GAP_ROUNDING = 2048 * ROUNDOFF
ARM_ROUNDING = 128 * ROUNDOFF
#: Rounding of places and rotations (see above).
POSITION_ROUNDING = 8 * ROUNDOFF
ROTATION_ROUNDING = 32 * ROUNDOFF
ANGLE_ROUNDING = 8 * ROUNDOFF
#: Maximum number of steps: beyond, the pair is undecided. Ordinary pairs take up to ten, boxes
#: that turn past each other many times just out of reach some hundred.
MAX_BOX_STEPS = 2000
#: Of a corner next to a corner, the largest gap of the 15 axes may show only this much of the
#: distance: the separating directions are a cone spanned by three of the axes, all within 90
#: degrees, so one of these is within acos(1 / sqrt(3)) of the direction of the distance.
SHOWN_SHARE = 3.0**-0.5
#: Least tolerance, relative to the radius of the larger box: nearly parallel edges are too short
#: an axis to show a gap below sqrt(2 GAP_ROUNDING) of it, 7e-7 (see ``verdict._implied_margin``).
TOLERANCE_FLOOR = 2e-6
#: Places that are off by more than this share of the tolerance can't decide whether it is met.
DECISIVE_SHARE = 1.0 / 32.0
#: A whole turn, and more for rounding.
WHOLE_TURN = 2.0 * math.pi * (1.0 + 8192 * ROUNDOFF)
#: Ways whose square is below this count as zero: they are lost in rounding.
LEAST_WAY_SQUARE = 2.0**-960

#: Ways and turns longer than this, in units of the boxes and radians, are not walked.
FARTHEST_WAY = 2.0**200

#: The time of contact, infinity if none, and True; or the time until which the boxes are certainly
#: apart, and False: undecided beyond.
FirstContact = tuple[float, bool]


class RelativeWay(NamedTuple):
    """The way of the origin of the second box, seen from the first.

    Lengths are in units of ``1 / scale`` metres. The offset at a time is off by ``stray[0]`` and
    ``stray[1]`` times the time.
    """

    start: Vector  #: offset at ``begin``
    way: Vector  #: change of the offset per unit of time
    begin: float
    last: float  #: end of the time walked
    scale: float
    stray: tuple[float, float]


@njit
def sweep_rigid(
    motion: BoxMotion, i: int, j: int, p: Vector, way: Vector, tolerance: float, work: Floats
) -> FirstContact:
    """Return the first contact of boxes i and j during times 0 to 1 (see ``FirstContact``).

    p: offset of the centres at time 0; way: what their origins add to it until time 1; ``work``
    (WORK_ROWS, 3) is work space.
    """
    wa, wb = norm(vector_at(motion.turns, i)), norm(vector_at(motion.turns, j))
    reach_a, reach_b = motion.reaches[i], motion.reaches[j]
    pivot = plus(minus(p, vector_at(motion.arms, j)), vector_at(motion.arms, i))
    time, last = meeting_window(pivot, way, reach_a + reach_b)
    if way == ZERO and (wa == 0.0 or wb == 0.0):
        last = min(last, time + WHOLE_TURN / max(wa, wb))
    if time > last:
        return np.inf, True
    scale = math.ldexp(1.0, min(-math.frexp(max(reach_a, reach_b))[1], 1020))
    stray = POSITION_ROUNDING * norm(p) * scale, POSITION_ROUNDING * norm(way) * scale
    start, way = scaled(plus(pivot, scaled(way, time)), scale), scaled(way, scale)
    if not norm(way) + wa + wb < FARTHEST_WAY:
        return time, time == 0.0 and _touch(motion, i, j)
    course = RelativeWay(start, way, time, last, scale, stray)
    radius_a, radius_b = motion.radii[i] * scale, motion.radii[j] * scale
    reach_a, reach_b = reach_a * scale, reach_b * scale
    speed, end = norm(way), norm(plus(start, scaled(way, last - time)))
    limit = max(tolerance * min(radius_a, radius_b), TOLERANCE_FLOOR * max(radius_a, radius_b))
    least_step = SHOWN_SHARE * limit / (speed + wa * reach_a + wb * reach_b)
    turn_time = WHOLE_TURN / max(wa, wb)
    look, span, steps = time, last - time, 0
    while time <= last:
        if last - time > 1.5 * turn_time and time >= look:
            time, span, tried = _skip(motion, i, j, course, time, span, work)
            if time > last:
                return np.inf, True
            look, span, steps = time + turn_time, 2.0 * turn_time, steps + tried
        if steps >= MAX_BOX_STEPS:
            return time, False
        a, arm_a, swing_a = _turned_box(motion, i, time, scale)
        b, arm_b, swing_b = _turned_box(motion, j, time, scale)
        offset = plus(start, scaled(way, time - course.begin))
        far = max(norm(offset), end)
        offset = plus(offset, minus(arm_b, arm_a))
        rate = plus(way, minus(swing_b, swing_a))
        skew = ROTATION_ROUNDING + ANGLE_ROUNDING * (wa + wb) * time
        rounding = GAP_ROUNDING * (radius_a + radius_b + norm(offset))
        rounding += ARM_ROUNDING * (reach_a + reach_b)
        blur = stray[0] + stray[1] * time + skew * (reach_a + reach_b)
        approach = Approach(offset, rate, far, speed, last - time)
        gap, step = best_step(approach, a, b, rounding, blur)
        if (
            gap <= SHOWN_SHARE * limit - 2.0 * min(blur, DECISIVE_SHARE * limit)
            and step <= least_step
        ):
            sharp = blur <= DECISIVE_SHARE * limit
            sharp &= 2.0 * rounding * max(radius_a, radius_b) <= limit * limit
            return time, sharp or (time == 0.0 and _touch(motion, i, j))
        if not step >= 0.0:
            return time, False
        time += step
        steps += 1
    return np.inf, True


@njit
def _turned_box(
    motion: BoxMotion, i: int, time: float, scale: float
) -> tuple[TurningBox, Vector, Vector]:
    """Return a box at a time, the arm from its origin to its centre, and its derivative."""
    turn = vector_at(motion.turns, i)
    axes = rotated(axes_of(motion.rotations, i), turn, time)
    arm = scaled(turned_by(vector_at(motion.arms, i), turn, time), scale)
    extents = scaled(vector_at(motion.half_extents, i), scale)
    return turning(axes, extents, turn, motion.reaches[i] * scale), arm, cross(turn, arm)


@njit
def _skip(
    motion: BoxMotion, i: int, j: int, course: RelativeWay, time: float, span: float, work: Floats
) -> tuple[float, float, int]:
    """Return until when the swept bodies are apart, infinity for the end; a span; and the tries.

    Slices of ``span`` at first; twice as long after each that is free, half after one that is not,
    down to one turn of the box that turns faster.
    """
    start, way, begin, last, _, stray = course
    a, b = work[:CORNER_ROWS], work[CORNER_ROWS:]
    faster = max(norm(vector_at(motion.turns, i)), norm(vector_at(motion.turns, j)))
    tries = 0
    while span >= WHOLE_TURN / faster and tries < MAX_BOX_STEPS:
        end = min(time + span, last)
        angle_a, skew_a = _fill_slice(motion, i, course, time, end, a)
        angle_b, skew_b = _fill_slice(motion, j, course, time, end, b)
        blur = stray[0] + stray[1] * end + skew_a + skew_b
        tries += 1
        first = plus(start, scaled(way, time - begin))
        final = plus(start, scaled(way, end - begin))
        if free_slice(first, final, a, angle_a, b, angle_b, blur):
            if end >= last:
                return np.inf, span, tries
            time, span = end, 2.0 * span
        else:
            span *= 0.5
    return time, span, tries


@njit
def _fill_slice(
    motion: BoxMotion, i: int, course: RelativeWay, time: float, end: float, corners: Floats
) -> tuple[float, float]:
    """Write the corners of a box in the middle of a slice, for ``free_slice``.

    Returns its turn in the slice, and how far rounding may displace its corners.
    """
    turn, middle = vector_at(motion.turns, i), 0.5 * (time + end)
    box, arm, _ = _turned_box(motion, i, middle, course.scale)
    fill_corners(box.axes, box.half_extents, arm, turn, corners)
    whole = norm(turn)
    angle = whole * (end - time)
    skew = ROTATION_ROUNDING
    if angle < TURNING_ALL_ROUND:
        skew += ANGLE_ROUNDING * whole * end
    return angle, skew * motion.reaches[i] * course.scale


@njit(refcount=False)
def _touch(motion: BoxMotion, i: int, j: int) -> bool:
    """Return whether two boxes are not certainly apart at time 0."""
    boxes = BoxArrays(motion.starts, motion.rotations, motion.half_extents)
    return careful_verdict(box_at(boxes, i), box_at(boxes, j)) != SEPARATE


@njit
def meeting_window(p: Vector, way: Vector, reach: float) -> tuple[float, float]:
    """Return first and last time in [0, 1] at which an offset is at most ``reach`` long.

    p: the offset at time 0. Rounded outwards; first > last if there is none.
    """
    largest = reach
    for k in range(3):
        largest = max(largest, abs(p[k]), abs(way[k]))
    scale = math.ldexp(1.0, min(-math.frexp(largest)[1], 1020))
    p, way, reach = scaled(p, scale), scaled(way, scale), reach * scale
    square = dot(way, way)
    if square < LEAST_WAY_SQUARE:
        return (0.0, 1.0) if norm(p) <= reach + GAP_ROUNDING else (1.0, 0.0)
    middle = -dot(p, way) / square
    # the nearest offset itself: no cancellation of large squares
    nearest = norm(plus(p, scaled(way, middle)))
    grown = reach + GAP_ROUNDING * (1.0 + abs(middle) * math.sqrt(square))
    if nearest > grown:
        return 1.0, 0.0
    half = math.sqrt((grown - nearest) * (grown + nearest) / square)
    slack = GAP_ROUNDING * (1.0 + abs(middle) + half)
    return max(0.0, middle - half - slack), min(1.0, middle + half + slack)
