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

"""When do moving boxes first touch? Continuous collision of pairs of boxes.

Pairs that don't turn are answered exactly (``sweep_linear``), turning ones conservatively
(``sweep_rigid``): never a collision missed, never a time too late.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import Floats, as_array, check_magnitude
from obb_collision.queries.pair_rows import as_pairs
from obb_collision.queries.sweep_contact import contact_point
from obb_collision.queries.sweep_intervals import AXES, spheres_pass
from obb_collision.queries.sweep_linear import MISS, NO_NORMAL, sweep_linear
from obb_collision.queries.sweep_motion import (
    bounding_radii,
    check_same_boxes,
    turns_between,
)
from obb_collision.queries.sweep_rigid import FLOOR, WORK_ROWS, rotate, sweep_rigid
from obb_collision.queries.witness import common_point, witness

#: Nearer than this counts as touching where a box turns, in radii of the smaller box.
TOLERANCE = 1e-4
#: What rounding allows, and then the least that is taken (see ``sweep_rigid``).
LEAST_TOLERANCE = FLOOR


@dataclass(frozen=True, eq=False)
class Sweeps:
    """What the motion of m pairs leads to, arrays over the pairs.

    hits (m,) bool: do the boxes touch at any time? times (m,): of first contact, in the unit of
    the motion; infinite without a hit. points (m, 3) metres: where, in the common frame at that
    time (in or near both of boxes that overlap at the start); normals (m, 3): unit vectors from
    the first box to the second. Both NaN without a hit, and (0, 3) where not asked for.
    """

    hits: NDArray[np.bool_]
    times: Floats
    points: Floats
    normals: Floats

    def __len__(self) -> int:
        return len(self.hits)


def sweep(
    start: Boxes,
    end: Boxes,
    pairs: ArrayLike,
    tolerance: float = TOLERANCE,
    *,
    contacts: bool = True,
) -> Sweeps:
    """Return the first contact of each pair (m, 2) while all boxes move from start to end.

    Every box k moves during times 0 to 1 from pose k of ``start`` to pose k of ``end``: its
    centre along a line, turning the shortest way about a fixed axis, both at constant speed (by
    exactly pi either way is as short, and rounding decides). Half extents must be the same.

    Boxes that collide at the start hit at time 0; touching counts.
    Where neither box turns (rotations equal bit for bit), the time is exact but for rounding:
    never late, and at that time they are less than 4e-15 T apart (see ``sweep_linear``).
    Where one does, time and hit are conservative: never late, none missed, and at that time the
    boxes are nearer than ``tolerance`` times the bounding radius of the smaller box (or 2e-6 of
    the larger one's where that is more). A turning pair that passes by that near may hit.
    Without ``contacts`` only hits and times are computed; points and normals have no rows then.

    Raises ValueError for different lengths or half extents, for pairs that are not rows of the
    boxes, and for a tolerance outside 2e-6 to 1.
    """
    check_same_boxes(start, end)
    return _sweep(start, end.centers, turns_between(start, end), pairs, tolerance, contacts)


def sweep_twists(
    boxes: Boxes,
    twists: ArrayLike,
    pairs: ArrayLike,
    horizon: float,
    tolerance: float = TOLERANCE,
    *,
    contacts: bool = True,
) -> Sweeps:
    """Return the first contact of each pair (m, 2) within ``horizon`` seconds; times in seconds.

    twists (n, 6): linear velocity x y z of each centre (m/s) and angular velocity x y z (rad/s)
    about it, in the frame of the boxes, constant all along; several turns are fine. Otherwise as
    ``sweep``. Raises ValueError as it does, and for a horizon that is not positive.
    """
    speeds = as_array(twists, "twists", (None, 6))
    if len(speeds) != len(boxes):
        raise ValueError(
            f"twists must have one row a box, got {len(speeds)} rows for {len(boxes)} boxes"
        )
    seconds = float(as_array(horizon, "horizon", ()))
    if seconds <= 0.0:
        raise ValueError(f"horizon must be positive, got {seconds:g}")
    with np.errstate(over="ignore"):
        moved = speeds * seconds
        ends = boxes.centers + moved[:, :3]
    check_magnitude(ends, "twists times horizon", by_row=True)
    check_magnitude(moved, "twists times horizon", by_row=True)
    result = _sweep(boxes, ends, np.ascontiguousarray(moved[:, 3:]), pairs, tolerance, contacts)
    return Sweeps(result.hits, result.times * seconds, result.points, result.normals)


def _sweep(
    start: Boxes, ends: Floats, turns: Floats, pairs: ArrayLike, tolerance: float, contacts: bool
) -> Sweeps:
    rows = as_pairs(pairs, len(start))
    near = float(as_array(tolerance, "tolerance", ()))
    if not LEAST_TOLERANCE <= near <= 1.0:
        raise ValueError(f"tolerance must be from {LEAST_TOLERANCE:g} to 1, got {near:g}")
    times = np.empty(len(rows))
    points, normals = np.empty((2, len(rows) if contacts else 0, 3))
    sweep_kernel(
        start.centers, ends, start.rotations, start.half_extents,
        bounding_radii(start.half_extents), turns, rows, near, times, points, normals,
    )  # fmt: skip
    return Sweeps(np.isfinite(times), times, points, normals)


@njit
def sweep_kernel(
    starts: Floats,
    ends: Floats,
    rotations: Floats,
    half_extents: Floats,
    radii: Floats,
    turns: Floats,
    pairs: np.ndarray,
    tolerance: float,
    times: Floats,
    points: Floats,
    normals: Floats,
) -> None:
    """Write time (m,), point and normal (m, 3), or (0, 3) for none, of the first contact of pairs.

    starts, ends: centres (n, 3) at times 0 and 1; rotations (n, 3, 3) at 0; radii (n,) of the
    circumscribed spheres; turns (n, 3) rotation vectors over the whole time.
    """
    spans = np.empty((2, AXES))
    centers, turned, extents = np.empty((2, 3)), np.empty((2, 3, 3)), np.empty((2, 3))
    most = np.empty(AXES)
    work = np.empty((WORK_ROWS, 3))
    for n in range(len(pairs)):
        i, j = pairs[n, 0], pairs[n, 1]
        time, normal, axis = MISS
        if not spheres_pass(starts, ends, i, j, radii[i] + radii[j]):
            if _turns(turns, i) or _turns(turns, j):
                time = sweep_rigid(
                    starts, ends, rotations, half_extents, radii, turns, i, j, tolerance, work
                )
            else:
                time, normal, axis = sweep_linear(
                    starts, ends, rotations, half_extents, i, j, spans
                )
        times[n] = time
        if len(points) == 0:
            continue
        point = NO_NORMAL
        if axis >= 0:
            point = contact_point(starts, ends, rotations, half_extents, i, j, time, normal, axis)
        for k in range(3):
            normals[n, k], points[n, k] = normal[k], point[k]
        if axis < 0 and time < np.inf:
            _place_contact(
                starts, ends, rotations, half_extents, turns, i, j,
                time, points[n], normals[n], centers, turned, extents, most,
            )  # fmt: skip


@njit
def _turns(turns: Floats, i: int) -> bool:
    return turns[i, 0] != 0.0 or turns[i, 1] != 0.0 or turns[i, 2] != 0.0


@njit
def _place_contact(
    starts: Floats,
    ends: Floats,
    rotations: Floats,
    half_extents: Floats,
    turns: Floats,
    i: int,
    j: int,
    time: float,
    point: Floats,
    normal: Floats,
    centers: Floats,
    turned: Floats,
    extents: Floats,
    most: Floats,
) -> None:
    """Write point and normal (3,) of boxes that turn, or that overlap at the start.

    centers (2, 3), turned (2, 3, 3), extents (2, 3), most (15,): work space.
    """
    for side, row in ((0, i), (1, j)):
        rotate(rotations[row], turns[row], time, turned[side])
        for k in range(3):
            centers[side, k] = starts[row, k] + time * (ends[row, k] - starts[row, k])
            extents[side, k] = half_extents[row, k]
    a, b = turned[0], turned[1]
    gap, nx, ny, nz, axis = witness(centers[0], a, extents[0], centers[1], b, extents[1], most)
    normal[0], normal[1], normal[2] = nx, ny, nz
    if gap >= 0.0:
        point[0], point[1], point[2] = contact_point(
            centers, centers, turned, extents, 0, 1, 0.0, (nx, ny, nz), axis
        )
    else:
        common_point(centers[0], a, extents[0], centers[1], b, extents[1], point)
