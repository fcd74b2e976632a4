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

Only the time during which the spheres round both boxes meet is walked, so the length of a motion
costs little. Rounding: lengths are in units of a power of two that no offset or radius exceeds;
in these units gaps, rotations and positions are off by less than 2^-42 of 1 + the motion.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.error_free import length
from obb_collision.geometry.validation import Floats
from obb_collision.queries.sweep_bounds import best_step

#: Rows of work space: 11 here, 12 for ``best_step``.
WORK_ROWS = 23
#: Rounding of gaps over a whole motion (see above).
ROUNDING = 2.0**-42
#: Steps at most: beyond, the pair counts as hitting at the time reached. Ordinary pairs take
#: up to ten, boxes that turn past each other many times just out of reach some hundred.
MAX_STEPS = 2000
#: Of a corner next to a corner, the largest gap of the 15 axes may show only this much of the
#: distance: the separating directions are a cone spanned by three of the axes, all within 90
#: degrees, so one of these is within acos(1 / sqrt(3)) of the direction of the distance.
SHOWN = 3.0**-0.5
#: Least tolerance, relative to the radius of the larger box: nearly parallel edges are too short
#: an axis to show a gap below sqrt(2 ROUNDING) of it, 7e-7 (see ``separation._implied_margin``).
FLOOR = 2e-6


@njit
def sweep_rigid(
    starts: Floats,
    ends: Floats,
    rotations: Floats,
    half_extents: Floats,
    radii: Floats,
    turns: Floats,
    i: int,
    j: int,
    tolerance: float,
    work: Floats,
) -> float:
    """Return the time in [0, 1] of the first contact of boxes i and j; infinity for none.

    starts, ends: centres (n, 3) at times 0 and 1; rotations (n, 3, 3) at 0; radii (n,) of the
    circumscribed spheres; turns (n, 3) rotation vectors. ``work`` (WORK_ROWS, 3) is work space.
    """
    a, b = work[0:3], work[3:6]
    start, way, d, h, f = work[6], work[7], work[8], work[9], work[10]
    scale = _scale(starts, ends, i, j, max(radii[i], radii[j]))
    for k in range(3):
        first = (starts[j, k] - starts[i, k]) * scale
        start[k] = first
        way[k] = (ends[j, k] - ends[i, k]) * scale - first
        h[k] = half_extents[i, k] * scale
        f[k] = half_extents[j, k] * scale
    reach_a, reach_b = radii[i] * scale, radii[j] * scale
    wa = length(turns[i, 0], turns[i, 1], turns[i, 2])
    wb = length(turns[j, 0], turns[j, 1], turns[j, 2])
    motion = length(way[0], way[1], way[2]) + wa * reach_a + wb * reach_b
    rounding = ROUNDING * (1.0 + motion)
    near = SHOWN * max(
        tolerance * min(reach_a, reach_b), FLOOR * max(reach_a, reach_b), 4.0 * rounding
    )
    least_step = near / motion
    time, last = _meeting_window(start, way, reach_a + reach_b + rounding)
    steps = 0
    while time <= last and steps < MAX_STEPS:
        rotate(rotations[i], turns[i], time, a)
        rotate(rotations[j], turns[j], time, b)
        for k in range(3):
            d[k] = start[k] + time * way[k]
        gap, step = best_step(
            d, way, a, h, turns[i], reach_a, b, f, turns[j], reach_b,
            rounding, last - time, work[11:],
        )  # fmt: skip
        if gap <= near and step <= least_step:
            return time
        time += step
        steps += 1
    return time if time <= last else np.inf


@njit
def _scale(starts: Floats, ends: Floats, i: int, j: int, radius: float) -> float:
    """Return the power of two that brings both offsets and the radius to at most 1 (1 for 0)."""
    largest = radius
    for k in range(3):
        largest = max(largest, abs(starts[j, k] - starts[i, k]), abs(ends[j, k] - ends[i, k]))
    _, exponent = math.frexp(largest)
    return math.ldexp(1.0, min(-exponent, 1020))


@njit
def _meeting_window(start: Floats, way: Floats, reach: float) -> tuple[float, float]:
    """Return first and last time in [0, 1] that the offset is no longer than ``reach``.

    Rounded outwards; first > last if there is none.
    """
    along = start[0] * way[0] + start[1] * way[1] + start[2] * way[2]
    square = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
    excess = start[0] * start[0] + start[1] * start[1] + start[2] * start[2] - reach * reach
    if square == 0.0:
        return (0.0, 1.0) if excess <= ROUNDING else (1.0, 0.0)
    middle = -along / square
    # least distance squared, from the nearest offset itself: no cancellation of large squares
    nearest = 0.0
    for k in range(3):
        nearest += (start[k] + middle * way[k]) ** 2
    room = reach * reach - nearest + ROUNDING * (1.0 + abs(middle)) * reach
    if room < 0.0:
        return 1.0, 0.0
    half = math.sqrt(room / square)
    slack = ROUNDING * (1.0 + abs(middle) + half)
    return max(0.0, middle - half - slack), min(1.0, middle + half + slack)


@njit
def rotate(rotation: Floats, turn: Floats, time: float, out: Floats) -> None:
    """Write the rotation (3, 3) turned by ``time`` times the rotation vector (Rodrigues)."""
    x, y, z = turn
    angle = length(x, y, z)
    if angle == 0.0 or time == 0.0:
        out[:] = rotation
        return
    x /= angle
    y /= angle
    z /= angle
    angle *= time
    sine = math.sin(angle)
    bend = 2.0 * math.sin(0.5 * angle) ** 2  # 1 - cos, without cancellation
    for k in range(3):
        px, py, pz = rotation[0, k], rotation[1, k], rotation[2, k]
        along = x * px + y * py + z * pz
        out[0, k] = px + sine * (y * pz - z * py) + bend * (x * along - px)
        out[1, k] = py + sine * (z * px - x * pz) + bend * (y * along - py)
        out[2, k] = pz + sine * (x * py - y * px) + bend * (z * along - pz)
