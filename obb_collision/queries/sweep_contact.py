"""Where do two boxes touch at the time of impact? One point of the contact, by features."""

from __future__ import annotations

import math

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
    ca: Floats,
    a: Floats,
    h: Floats,
    cb: Floats,
    b: Floats,
    f: Floats,
    nx: float,
    ny: float,
    nz: float,
    out: Floats,
) -> None:
    """Write the point (3,) where boxes touch whose contact plane has the normal n, a to b.

    The corner of either box if that is what touches, the crossing of two edges, else some point
    common to the flat features that meet.
    """
    size = h[0] + h[1] + h[2] + f[0] + f[1] + f[2]
    free_a, edge_a, ax, ay, az = _support(ca, a, h, nx, ny, nz, FLAT * size)
    if free_a == 0:
        out[0], out[1], out[2] = ax, ay, az
        return
    free_b, edge_b, bx, by, bz = _support(cb, b, f, -nx, -ny, -nz, FLAT * size)
    out[0], out[1], out[2] = bx, by, bz
    if free_b == 0:
        return
    if free_a == 1 and free_b == 1:
        ux, uy, uz = a[0, edge_a], a[1, edge_a], a[2, edge_a]
        vx, vy, vz = b[0, edge_b], b[1, edge_b], b[2, edge_b]
        cosine = ux * vx + uy * vy + uz * vz
        square = 1.0 - cosine * cosine
        if square > PARALLEL_SQUARED:
            wx, wy, wz = bx - ax, by - ay, bz - az
            along = wx * (ux - cosine * vx) + wy * (uy - cosine * vy) + wz * (uz - cosine * vz)
            along = min(max(along / square, -h[edge_a]), h[edge_a])
            out[0], out[1], out[2] = ax + along * ux, ay + along * uy, az + along * uz
            return
    if free_a < free_b:
        out[0], out[1], out[2] = ax, ay, az
    for _ in range(ROUNDS):
        moved = clamp_to_box(out, ca, a, h)
        if max(moved, clamp_to_box(out, cb, b, f)) <= SETTLED * size:
            break


@njit
def _support(
    center: Floats, axes: Floats, extents: Floats, nx: float, ny: float, nz: float, flat: float
) -> tuple[int, int, float, float, float]:
    """Return the middle of what is farthest along n, how many sides it spans, and the last one."""
    x, y, z = center[0], center[1], center[2]
    free, edge = 0, 0
    for k in range(3):
        ex, ey, ez = axes[0, k], axes[1, k], axes[2, k]
        rise = extents[k] * (nx * ex + ny * ey + nz * ez)
        if abs(rise) <= flat:
            free += 1
            edge = k
            continue
        reach = math.copysign(extents[k], rise)
        x += reach * ex
        y += reach * ey
        z += reach * ez
    return free, edge, x, y, z
