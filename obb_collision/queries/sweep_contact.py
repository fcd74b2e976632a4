"""Where do two boxes touch at the time of impact? One point of the contact, by features."""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.validation import Floats
from obb_collision.queries.witness import clamp_to_box

#: A side that rises less than this over its length, relative to the sum of all half extents,
#: lies in the plane of contact.
FLAT = 1e-10
#: Edges whose directions have a sine squared below this have no one crossing.
PARALLEL_SQUARED = 1e-12
#: Projections onto one box, then the other: two flat features that meet settle in a few.
ROUNDS = 16
#: They end when the point moves less than this, relative to the sum of all half extents.
SETTLED = 1e-12


@njit
def contact_point(
    starts: Floats,
    ends: Floats,
    rotations: Floats,
    half_extents: Floats,
    i: int,
    j: int,
    time: float,
    nx: float,
    ny: float,
    nz: float,
) -> tuple[float, float, float]:
    """Return the point where boxes i and j touch in a plane of the normal n, from i to j.

    The corner of either box if that is what touches, the crossing of two edges, else some point
    common to the flat features that meet.
    """
    size = 0.0
    for k in range(3):
        size += half_extents[i, k] + half_extents[j, k]
    flat = FLAT * size
    where = starts, ends, rotations, half_extents
    free_a, m, ax, ay, az = _support(*where, i, time, nx, ny, nz, flat)
    if free_a == 0:
        return ax, ay, az
    free_b, n, bx, by, bz = _support(*where, j, time, -nx, -ny, -nz, flat)
    if free_b == 0:
        return bx, by, bz
    if free_a == 1 and free_b == 1:
        ux, uy, uz = rotations[i, 0, m], rotations[i, 1, m], rotations[i, 2, m]
        vx, vy, vz = rotations[j, 0, n], rotations[j, 1, n], rotations[j, 2, n]
        cosine = ux * vx + uy * vy + uz * vz
        square = 1.0 - cosine * cosine
        if square > PARALLEL_SQUARED:
            wx, wy, wz = bx - ax, by - ay, bz - az
            along = wx * (ux - cosine * vx) + wy * (uy - cosine * vy) + wz * (uz - cosine * vz)
            along = min(max(along / square, -half_extents[i, m]), half_extents[i, m])
            return ax + along * ux, ay + along * uy, az + along * uz
    work = np.empty((3, 3))
    point, ca, cb = work[0], work[1], work[2]
    corner = (ax, ay, az) if free_a < free_b else (bx, by, bz)
    point[0], point[1], point[2] = corner
    for k in range(3):
        ca[k] = starts[i, k] + time * (ends[i, k] - starts[i, k])
        cb[k] = starts[j, k] + time * (ends[j, k] - starts[j, k])
    for _ in range(ROUNDS):
        moved = clamp_to_box(point, ca, rotations[i], half_extents[i])
        if max(moved, clamp_to_box(point, cb, rotations[j], half_extents[j])) <= SETTLED * size:
            break
    return point[0], point[1], point[2]


@njit
def _support(
    starts: Floats,
    ends: Floats,
    rotations: Floats,
    half_extents: Floats,
    i: int,
    time: float,
    nx: float,
    ny: float,
    nz: float,
    flat: float,
) -> tuple[int, int, float, float, float]:
    """Return the middle of what is farthest along n, how many sides it spans, and the last one."""
    x = starts[i, 0] + time * (ends[i, 0] - starts[i, 0])
    y = starts[i, 1] + time * (ends[i, 1] - starts[i, 1])
    z = starts[i, 2] + time * (ends[i, 2] - starts[i, 2])
    free, edge = 0, 0
    for k in range(3):
        ex, ey, ez = rotations[i, 0, k], rotations[i, 1, k], rotations[i, 2, k]
        rise = half_extents[i, k] * (nx * ex + ny * ey + nz * ez)
        if abs(rise) <= flat:
            free += 1
            edge = k
            continue
        reach = math.copysign(half_extents[i, k], rise)
        x += reach * ex
        y += reach * ey
        z += reach * ez
    return free, edge, x, y, z
