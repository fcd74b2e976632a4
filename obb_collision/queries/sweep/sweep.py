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

"""Times at which moving boxes first touch: continuous collision of pairs of boxes.

Pairs that don't turn are answered exactly (``linear``), turning ones conservatively
(``rigid``): never a collision missed, never a time too late. Where that would take too long
or more digits than doubles have, the pair is undecided.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import as_array
from obb_collision.numerics.vec3 import (
    ZERO,
    axes_of,
    clamp,
    clamped,
    combined,
    components,
    dot,
    max_abs,
    minus,
    pick,
    pick_axis,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.sweep.linear import MISS, NO_NORMAL, spheres_pass, sweep_linear
from obb_collision.queries.sweep.motion import (
    BoxMotion,
    MovingBoxes,
    center_at,
    join_motions,
    offset_and_way,
    rotated,
    swing,
)
from obb_collision.queries.sweep.rigid import TOLERANCE_FLOOR, WORK_ROWS, sweep_rigid
from obb_collision.queries.verdict.pair_rows import as_pairs
from obb_collision.queries.verdict.sat import AXIS_COUNT, BoxAt
from obb_collision.queries.verdict.witness import box_witness, common_point
from obb_collision.typing import Floats, Integers, Vector

#: A side that rises less than this over its length, relative to the sum of all half extents,
#: lies in the plane of contact.
TOUCH_FLAT = 1e-10
#: Edges whose directions have a sine squared below this have no single crossing.
PARALLEL_SQUARED = 1e-12
#: Projections onto one box, then the other: two flat features that meet settle in a few.
TOUCH_ROUNDS = 16
#: They end when the point moves less than this, relative to the sum of all half extents.
TOUCH_SETTLED = 1e-12


#: The middle of a vertex, edge or face, how many sides of the box it spans, and the last of them.
Feature = tuple[Vector, int, int]


@njit
def contact_point(a: BoxAt, b: BoxAt, normal: Vector, axis: int) -> Vector:
    """Return the point where two boxes touch in a plane of the normal, from a to b.

    axis: the number of the normal's axis (``sat``), which tells where to look first. The corner of
    either box if one touches, else the crossing of two edges, else a point common to the flat
    features that meet.
    """
    size = 0.0
    for k in range(3):
        size += a.half_extents[k] + b.half_extents[k]
    flat = TOUCH_FLAT * size
    back = scaled(normal, -1.0)
    if axis < 3:  # a face of a: b may touch it with a corner
        q, free_b, edge_b = _support(b, back, flat)
        if free_b == 0:
            return q
        p, free_a, edge_a = _support(a, normal, flat)
        if free_a == 0:
            return p
    else:
        p, free_a, edge_a = _support(a, normal, flat)
        if free_a == 0:
            return p
        q, free_b, edge_b = _support(b, back, flat)
        if free_b == 0:
            return q
    if free_a == 1 and free_b == 1:
        u, v = pick_axis(a.axes, edge_a), pick_axis(b.axes, edge_b)
        cosine = dot(u, v)
        square = 1.0 - cosine * cosine
        if square > PARALLEL_SQUARED:
            along = dot(minus(q, p), minus(u, scaled(v, cosine))) / square
            return plus(p, scaled(u, clamp(along, pick(a.half_extents, edge_a))))
    return _common(p if free_a < free_b else q, a, b, TOUCH_SETTLED * size)


@njit
def _common(point: Vector, a: BoxAt, b: BoxAt, settled: float) -> Vector:
    """Return a point of both boxes near another, by projections onto one, then the other."""
    for _ in range(TOUCH_ROUNDS):
        point, first = _clamp_to_box(point, a)
        point, second = _clamp_to_box(point, b)
        if max(first, second) <= settled:
            break
    return point


@njit
def _clamp_to_box(point: Vector, box: BoxAt) -> tuple[Vector, float]:
    """Return the point of the box nearest to another, and the largest step along an axis."""
    along = components(box.axes, minus(point, box.center))
    excess = minus(along, clamped(along, box.half_extents))
    for k in range(3):
        if excess[k] != 0.0:
            point = minus(point, scaled(box.axes[k], excess[k]))
    return point, max_abs(excess)


@njit
def _support(box: BoxAt, normal: Vector, flat: float) -> Feature:
    """Return the feature that is farthest along the normal."""
    point, free, edge = box.center, 0, 0
    for k in range(3):
        side, extent = box.axes[k], box.half_extents[k]
        rise = extent * dot(normal, side)
        if abs(rise) <= flat:
            free += 1
            edge = k
        else:
            point = plus(point, scaled(side, math.copysign(extent, rise)))
    return point, free, edge


#: Nearer than this counts as touching where a box turns, in radii of the smaller box.
TOLERANCE = 1e-4
#: Pairs below which a second thread does not pay: 20 us where they do not turn.
FEWEST_SWEEPS = 64
#: The least tolerance that is accepted: what rounding allows (see ``rigid``).
LEAST_TOLERANCE = TOLERANCE_FLOOR


@dataclass(frozen=True, eq=False)
class Sweeps:
    """The first contacts of m moving pairs, as arrays; each pair has one of three answers.

    pairs (m, 2): rows of a and b; in a report, indices of objects.

    hits (m,) bool: the bodies touch. undecided (m,) bool: they may touch, from ``free_until`` on.
    Neither: they do not touch.

    times (m,): of first contact, in the unit of the motion; infinite without one, NaN if undecided.
    free_until (m,): until when the bodies are certainly apart, infinity if they do not touch.
    positions (m, 3) metres: where, in the common frame at that time (in or near both of boxes that
    overlap at the start); normals (m, 3): unit vectors from the first box to the second. Both NaN
    without a hit, and (0, 3) with ``contacts=False``.
    """

    pairs: Integers
    hits: NDArray[np.bool_]
    undecided: NDArray[np.bool_]
    times: Floats
    free_until: Floats
    positions: Floats
    normals: Floats

    def __len__(self) -> int:
        return len(self.hits)


class SweepArrays(NamedTuple):
    """Sweeps of m pairs for kernels: as ``Sweeps``, with times from 0 to 1."""

    free: Floats
    undecided: np.ndarray
    positions: Floats
    normals: Floats


def sweep_arrays(count: int, contacts: bool = True) -> SweepArrays:
    """Return arrays for the sweeps of pairs."""
    vectors = np.empty((2, count if contacts else 0, 3))
    return SweepArrays(np.empty(count), np.empty(count, np.bool_), *vectors)


@njit(refcount=False)
def write_sweep(
    out: SweepArrays, n: int, time: float, decided: bool, point: Vector, normal: Vector
) -> None:
    """Write when a pair first touches, or until when it is certainly apart."""
    out.free[n], out.undecided[n] = time, not decided
    if len(out.positions) > 0:
        for k in range(3):
            out.positions[n, k], out.normals[n, k] = point[k], normal[k]


def sweeps_of(pairs: Integers, out: SweepArrays) -> Sweeps:
    """Return the sweeps of pairs (m, 2)."""
    times = np.where(out.undecided, np.nan, out.free) if out.undecided.any() else out.free
    return Sweeps(pairs, np.isfinite(times), out.undecided, times, *out[:1], *out[2:])


def box_sweeps(
    a: MovingBoxes | Boxes,
    b: MovingBoxes | Boxes,
    pairs: ArrayLike | None = None,
    *,
    tolerance: float = TOLERANCE,
    contacts: bool = True,
) -> Sweeps:
    """Return when moving boxes first touch, as ``questions.sweeps``; arguments are checked."""
    near = as_tolerance(tolerance)
    row_pairs = as_pairs(a, b, pairs)
    motion, duration, rows = join_motions(a, b, row_pairs)
    out = sweep_arrays(len(rows), contacts)
    run(sweep_kernel, len(rows), FEWEST_SWEEPS, motion, rows, near, out)
    np.multiply(out.free, duration, out=out.free)
    return sweeps_of(row_pairs, out)


def as_tolerance(tolerance: float) -> float:
    """Return a validated tolerance: at least what rounding allows, at most 1."""
    near = float(as_array(tolerance, "tolerance", ()))
    if not LEAST_TOLERANCE <= near <= 1.0:
        raise ValueError(f"tolerance must be from {LEAST_TOLERANCE:g} to 1, got {near:g}")
    return near


@njit
def sweep_kernel(
    motion: BoxMotion, pairs: np.ndarray, tolerance: float, out: SweepArrays, start: int, stop: int
) -> None:
    """Write the sweeps of pairs ``start`` to ``stop`` of (m, 2)."""
    spans, work = np.empty((2, AXIS_COUNT)), np.empty((WORK_ROWS, 3))
    starts, ends, seconds, turns = motion.starts, motion.ends, motion.seconds, motion.turns
    for n in range(start, stop):
        i, j = pairs[n, 0], pairs[n, 1]
        time, normal, axis = MISS
        decided = True
        a = BoxAt(ZERO, axes_of(motion.rotations, i), vector_at(motion.half_extents, i))
        b = BoxAt(ZERO, axes_of(motion.rotations, j), vector_at(motion.half_extents, j))
        p, q, way = offset_and_way(starts, ends, seconds, i, j)
        if vector_at(turns, i) != ZERO or vector_at(turns, j) != ZERO:
            u, v = vector_at(motion.arms, i), vector_at(motion.arms, j)
            reach = motion.reaches[i] + motion.reaches[j]
            if not spheres_pass(plus(minus(p, v), u), plus(minus(q, v), u), reach):
                time, decided = sweep_rigid(motion, i, j, p, way, tolerance, work)
        elif not spheres_pass(p, q, motion.radii[i] + motion.radii[j]):
            time, normal, axis = sweep_linear(a, BoxAt(p, b.axes, b.half_extents), q, spans)
        point = NO_NORMAL
        if decided and time < np.inf and len(out.positions) > 0:
            offset = plus(p, scaled(way, time))
            if axis >= 0:
                point = contact_point(a, BoxAt(offset, b.axes, b.half_extents), normal, axis)
            else:
                point, normal = find_contact(motion, i, j, time, offset)
            point = plus(center_at(starts, ends, seconds, i, time), point)
        write_sweep(out, n, time, decided, point, normal)


@njit
def find_contact(
    motion: BoxMotion, i: int, j: int, time: float, offset: Vector
) -> tuple[Vector, Vector]:
    """Return point and normal of boxes that turn, or that overlap at the start.

    offset: from i to j, without their arms. The point is relative to i, without its arm, so that
    digits are not lost far from the origin.
    """
    swung = swing(motion, i, time)
    offset = plus(offset, minus(swing(motion, j, time), swung))
    a, b = _turned_box(motion, i, time, ZERO), _turned_box(motion, j, time, offset)
    (gap, normal, number), pair = box_witness(a, b)
    if gap >= 0.0:
        point = contact_point(a, b, normal, number)
    else:
        point = combined(a.axes, common_point(pair))
    return plus(swung, point), normal


@njit
def _turned_box(motion: BoxMotion, i: int, time: float, center: Vector) -> BoxAt:
    """Return a box as it is turned at a time, with another centre."""
    axes = rotated(axes_of(motion.rotations, i), vector_at(motion.turns, i), time)
    return BoxAt(center, axes, vector_at(motion.half_extents, i))
