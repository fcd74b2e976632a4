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

"""When do two boxes that turn as they move come near each other? Conservative advancement.

As long as one of the 15 axes separates, the boxes are apart (``separation``). From a time at
which axis n does, with gap g, the walk steps on for as long as n, carried along by the boxes it
belongs to, certainly goes on separating; then it looks for axes anew. It ends where the largest
gap is below the tolerance and no axis allows a step worth while (Mirtich 1996; the motion bound
along a moving axis instead of the distance's: Zhang, Lee, Kim 2006). See ``sweep_bounds`` for
the step.

Only the time during which the spheres about both origins meet is walked, so the length of a motion
costs little. Of a box that turns beside one that does neither turn nor move, one turn tells all.
Boxes that turn many times are held by what they sweep in a whole turn (``sweep_slices``), and most
of that time is never walked. Where the walk still takes too many steps, or rounding leaves less
than the tolerance, the answer is that it is not known, and until when the boxes are apart.

Rounding: lengths are in units of a power of two about as large as the boxes and their arms. With u
the unit roundoff, a place is off by 4 u of offset and way so far (``offset_and_way``, and the time
itself), bounded by POSITION; a rotation by 16 u and 5 u of the angle so far, bounded by TURNING
and SPIN: the boxes move as ones do that are displaced a little, for as long as a step lasts. This
shifts a gap in proportion to the length of its axis (``blur``), the rounding of the step itself by
as much for short axes as for long ones (``rounding``).
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.error_free import length
from obb_collision.queries.sweep.bounds import best_step
from obb_collision.queries.sweep.poses import Motion, rotate, turned_by
from obb_collision.queries.sweep.slices import CORNER_ROWS, WHOLE, fill_corners, free_slice
from obb_collision.queries.sweep.slices import WORK_ROWS as SLICE_ROWS
from obb_collision.queries.verdict.sat import Vector, dot, minus, plus, scaled, vector
from obb_collision.queries.verdict.verdict import SEPARATE, classify_careful
from obb_collision.typing import Floats

#: Rows of work space: the walk's, those of ``best_step``, of two bodies and of ``free_slice``.
OWN_ROWS = 11
STEP_ROWS = 12
WORK_ROWS = OWN_ROWS + STEP_ROWS + 2 * CORNER_ROWS + SLICE_ROWS
#: Rounding of gaps, relative to the boxes and their offset, and to their arms.
GAP_ROUNDING = 2048 * ROUNDOFF
ARM_ROUNDING = 128 * ROUNDOFF
#: Rounding of places and rotations (see above).
POSITION = 8 * ROUNDOFF
TURNING = 32 * ROUNDOFF
SPIN = 8 * ROUNDOFF
#: Steps at most: beyond, it is not known. Ordinary pairs take up to ten, boxes that turn past each
#: other many times just out of reach some hundred.
MAX_STEPS = 2000
#: Of a corner next to a corner, the largest gap of the 15 axes may show only this much of the
#: distance: the separating directions are a cone spanned by three of the axes, all within 90
#: degrees, so one of these is within acos(1 / sqrt(3)) of the direction of the distance.
SHOWN = 3.0**-0.5
#: Least tolerance, relative to the radius of the larger box: nearly parallel edges are too short
#: an axis to show a gap below sqrt(2 GAP_ROUNDING) of it, 7e-7 (see ``verdict._implied_margin``).
FLOOR = 2e-6
#: Places that are off by more than this share of the tolerance can't tell whether it is kept.
SHARP = 1.0 / 32.0
#: A whole turn and what rounding takes from it.
TURN = 2.0 * math.pi * (1.0 + 8192 * ROUNDOFF)
#: Ways whose square is below this are none: they are lost in rounding.
LEAST_WAY_SQUARE = 2.0**-960

#: Ways and turns longer than this, in units of the boxes and radians, are not walked.
FARTHEST = 2.0**200

#: What is found: the time of contact, infinity for none, or until when the boxes are certainly
#: apart; and whether it is known.
Answer = tuple[float, bool]


@njit
def sweep_rigid(
    motion: Motion, i: int, j: int, p: Vector, way: Vector, tolerance: float, work: Floats
) -> Answer:
    """Return the first contact of boxes i and j during times 0 to 1 (see ``Answer``).

    p: offset of the centres at time 0; way: what their origins add to it until time 1; ``work``
    (WORK_ROWS, 3) is work space.
    """
    turn_a, turn_b = vector(motion.turns, i), vector(motion.turns, j)
    wa, wb = _norm(turn_a), _norm(turn_b)
    reach_a, reach_b = motion.reaches[i], motion.reaches[j]
    pivot = plus(minus(p, vector(motion.arms, j)), vector(motion.arms, i))
    time, last = _meeting_window(pivot, way, reach_a + reach_b)
    if way[0] == 0.0 and way[1] == 0.0 and way[2] == 0.0 and (wa == 0.0 or wb == 0.0):
        last = min(last, time + TURN / max(wa, wb))
    if time > last:
        return np.inf, True
    scale = math.ldexp(1.0, min(-math.frexp(max(reach_a, reach_b))[1], 1020))
    radius_a, radius_b = motion.radii[i] * scale, motion.radii[j] * scale
    reach_a, reach_b = reach_a * scale, reach_b * scale
    begin, start = time, scaled(plus(pivot, scaled(way, time)), scale)
    stray = POSITION * _norm(p) * scale, POSITION * _norm(way) * scale
    way = scaled(way, scale)
    speed = _norm(way)
    if not speed + wa + wb < FARTHEST:
        return time, time == 0.0 and _touch(motion, i, j)
    limit = max(tolerance * min(radius_a, radius_b), FLOOR * max(radius_a, radius_b))
    least_step = SHOWN * limit / (speed + wa * reach_a + wb * reach_b)
    a, b, d, velocity, h, f = work[0:3], work[3:6], work[6], work[7], work[8], work[9]
    for k in range(3):
        h[k], f[k] = motion.half_extents[i, k] * scale, motion.half_extents[j, k] * scale
    end = _norm(plus(start, scaled(way, last - begin)))
    turn_time = TURN / max(wa, wb)
    look, span, steps = time, last - time, 0
    while time <= last:
        if last - time > 1.5 * turn_time and time >= look:
            time, span, tried = _skip(
                motion, i, j, start, way, begin, time, last, span, turn_time, scale, stray, work
            )
            if time > last:
                return np.inf, True
            look, span, steps = time + turn_time, 2.0 * turn_time, steps + tried
        if steps >= MAX_STEPS:
            return time, False
        rotate(motion.rotations[i], motion.turns[i], time, a)
        rotate(motion.rotations[j], motion.turns[j], time, b)
        offset = plus(start, scaled(way, time - begin))
        far = max(_norm(offset), end)
        arm_a = scaled(turned_by(vector(motion.arms, i), turn_a, time), scale)
        arm_b = scaled(turned_by(vector(motion.arms, j), turn_b, time), scale)
        offset = plus(offset, minus(arm_b, arm_a))
        rate = plus(way, minus(_cross(turn_b, arm_b), _cross(turn_a, arm_a)))
        for k in range(3):
            d[k], velocity[k] = offset[k], rate[k]
        skew = TURNING + SPIN * (wa + wb) * time
        rounding = GAP_ROUNDING * (radius_a + radius_b + _norm(offset))
        rounding += ARM_ROUNDING * (reach_a + reach_b)
        blur = stray[0] + stray[1] * time + skew * (reach_a + reach_b)
        gap, step = best_step(
            d, velocity, far, speed, a, h, motion.turns[i], reach_a,
            b, f, motion.turns[j], reach_b, rounding, blur, last - time, work[OWN_ROWS:],
        )  # fmt: skip
        if gap <= SHOWN * limit - 2.0 * min(blur, SHARP * limit) and step <= least_step:
            sharp = blur <= SHARP * limit
            sharp &= 2.0 * rounding * max(radius_a, radius_b) <= limit * limit
            return time, sharp or (time == 0.0 and _touch(motion, i, j))
        if not step >= 0.0:
            return time, False
        time += step
        steps += 1
    return np.inf, True


@njit
def _skip(
    motion: Motion, i: int, j: int, start: Vector, way: Vector, begin: float, time: float,
    last: float, span: float, turn: float, scale: float, stray: tuple[float, float], work: Floats,
) -> tuple[float, float, int]:  # fmt: skip
    """Return until when what the boxes sweep is apart, infinity for ``last``; a span; the tries.

    Slices of ``span`` at first; twice as long after each that is free, half after one that is not,
    down to one turn of the box that turns faster.
    """
    corners = work[OWN_ROWS + STEP_ROWS :]
    tries = 0
    while span >= turn and tries < MAX_STEPS:
        end = min(time + span, last)
        _fill(motion, i, 0.5 * (time + end), scale, corners[:CORNER_ROWS], work)
        _fill(motion, j, 0.5 * (time + end), scale, corners[CORNER_ROWS : 2 * CORNER_ROWS], work)
        angles = np.empty(2)
        blur = stray[0] + stray[1] * end
        for side, row in ((0, i), (1, j)):
            whole = _norm(vector(motion.turns, row))
            angles[side] = whole * (end - time)
            skew = TURNING if angles[side] >= WHOLE else TURNING + SPIN * whole * end
            blur += skew * motion.reaches[row] * scale
        tries += 1
        if free_slice(
            plus(start, scaled(way, time - begin)), plus(start, scaled(way, end - begin)),
            corners[:CORNER_ROWS], angles[0], corners[CORNER_ROWS : 2 * CORNER_ROWS], angles[1],
            blur, corners[2 * CORNER_ROWS :],
        ):  # fmt: skip
            if end >= last:
                return np.inf, span, tries
            time, span = end, 2.0 * span
        else:
            span *= 0.5
    return time, span, tries


@njit
def _fill(motion: Motion, i: int, time: float, scale: float, corners: Floats, work: Floats) -> None:
    """Write what ``free_slice`` takes of a box in the middle of a slice."""
    turn = vector(motion.turns, i)
    rotation, extents = work[0:3], work[10]
    rotate(motion.rotations[i], motion.turns[i], time, rotation)
    for k in range(3):
        extents[k] = motion.half_extents[i, k] * scale
    arm = scaled(turned_by(vector(motion.arms, i), turn, time), scale)
    fill_corners(rotation, extents, arm, turn, corners)


@njit
def _touch(motion: Motion, i: int, j: int) -> bool:
    """Return whether two boxes are not certainly apart at time 0."""
    verdict = classify_careful(
        motion.starts[i], motion.rotations[i], motion.half_extents[i],
        motion.starts[j], motion.rotations[j], motion.half_extents[j],
    )  # fmt: skip
    return verdict != SEPARATE


@njit
def _norm(v: Vector) -> float:
    return length(v[0], v[1], v[2])


@njit
def _cross(u: Vector, v: Vector) -> Vector:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@njit
def _meeting_window(p: Vector, way: Vector, reach: float) -> tuple[float, float]:
    """Return first and last time in [0, 1] that an offset is no longer than ``reach``.

    It is p at time 0. Rounded outwards; first > last if there is none.
    """
    largest = reach
    for k in range(3):
        largest = max(largest, abs(p[k]), abs(way[k]))
    scale = math.ldexp(1.0, min(-math.frexp(largest)[1], 1020))
    p, way, reach = scaled(p, scale), scaled(way, scale), reach * scale
    square = dot(way, way)
    if square < LEAST_WAY_SQUARE:
        return (0.0, 1.0) if _norm(p) <= reach + GAP_ROUNDING else (1.0, 0.0)
    middle = -dot(p, way) / square
    # the nearest offset itself: no cancellation of large squares
    nearest = _norm(plus(p, scaled(way, middle)))
    grown = reach + GAP_ROUNDING * (1.0 + abs(middle) * math.sqrt(square))
    if nearest > grown:
        return 1.0, 0.0
    half = math.sqrt((grown - nearest) * (grown + nearest) / square)
    slack = GAP_ROUNDING * (1.0 + abs(middle) + half)
    return max(0.0, middle - half - slack), min(1.0, middle + half + slack)
