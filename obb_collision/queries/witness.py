"""How far apart or how deep, and along which axis: the witness of a verdict."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.validation import Floats
from obb_collision.queries.separation import careful_axis


@njit
def witness(
    ca: Floats, a: Floats, h: Floats, cb: Floats, b: Floats, f: Floats
) -> tuple[float, float, float, float, int]:
    """Return the signed gap, its unit axis from a towards b, and the number of the axis.

    The largest of the 15 gaps along normalised axes: positive, it proves that the boxes are
    apart (by at least that much); negative, it is the least translation along any of the 15 that
    separates them. Equal gaps are decided by the axes themselves, so that swapping the boxes only
    reverses the axis. Where the centres agree along the axis, its sign carries no meaning.
    """
    best = -np.inf
    bx, by, bz = 0.0, 0.0, 0.0
    number = -1
    for axis in range(15):
        gap, _, nx, ny, nz = careful_axis(ca, a, h, cb, b, f, axis)
        if gap > best or (gap == best and number >= 0 and _before(nx, ny, nz, bx, by, bz)):
            best = gap
            bx, by, bz = nx, ny, nz
            number = axis
    return best, bx, by, bz, number


@njit
def _before(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> bool:
    """Order axes by magnitudes, then by relative signs: the same for both axes reversed."""
    if abs(ax) != abs(bx):
        return abs(ax) > abs(bx)
    if abs(ay) != abs(by):
        return abs(ay) > abs(by)
    if abs(az) != abs(bz):
        return abs(az) > abs(bz)
    if ax * ay != bx * by:
        return ax * ay > bx * by
    if ay * az != by * bz:
        return ay * az > by * bz
    return ax * az > bx * bz


@njit
def witness_kernel(
    centers: Floats,
    rotations: Floats,
    half_extents: Floats,
    pairs: np.ndarray,
    gaps: Floats,
    axes: Floats,
    points: Floats,
) -> None:
    """Write gap (m,), axis (m, 3) and a point (m, 3) of the contact of each pair (m, 2)."""
    for n in range(len(pairs)):
        i, j = pairs[n]
        gap, nx, ny, nz, _ = witness(
            centers[i], rotations[i], half_extents[i], centers[j], rotations[j], half_extents[j]
        )
        gaps[n] = gap
        axes[n, 0] = nx
        axes[n, 1] = ny
        axes[n, 2] = nz
        common_point(
            centers[i], rotations[i], half_extents[i],
            centers[j], rotations[j], half_extents[j], points[n],
        )  # fmt: skip


#: Rounds of alternating projections: each moves the point into one box, then into the other.
#: Nearly always one or two are enough; thin wedges take more.
PROJECTION_ROUNDS = 32


@njit
def common_point(
    ca: Floats, a: Floats, h: Floats, cb: Floats, b: Floats, f: Floats, out: Floats
) -> None:
    """Write a point (3,) near both boxes: inside both, or nearly, where they overlap.

    Alternating projections onto convex sets (von Neumann; Bregman 1965), from between the
    centres. A place to draw the contact at, not a contact manifold.
    """
    for k in range(3):
        out[k] = ca[k] + 0.5 * (cb[k] - ca[k])
    for _ in range(PROJECTION_ROUNDS):
        _clamp(out, ca, a, h)
        if not _clamp(out, cb, b, f):
            break


@njit
def _clamp(point: Floats, center: Floats, axes: Floats, extents: Floats) -> bool:
    """Move the point to the nearest one of the box; return whether it had to move."""
    moved = False
    dx = point[0] - center[0]
    dy = point[1] - center[1]
    dz = point[2] - center[2]
    for i in range(3):
        along = dx * axes[0, i] + dy * axes[1, i] + dz * axes[2, i]
        excess = along - min(max(along, -extents[i]), extents[i])
        moved = moved or excess != 0.0
        point[0] -= excess * axes[0, i]
        point[1] -= excess * axes[1, i]
        point[2] -= excess * axes[2, i]
    return moved
