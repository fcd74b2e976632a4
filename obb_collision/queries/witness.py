"""How far apart or how deep, and along which axis: the witness of a verdict."""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.validation import Floats
from obb_collision.queries.separation import FAST_BOUND, UNDERFLOW, careful_axis

#: Errors of a rough gap, relative to T (see ``separation``): of the gap before it is divided by
#: the length of its axis, and of the square of that length.
GAP_ERROR = FAST_BOUND
LENGTH_ERROR = 2.0**-44
#: An edge axis shorter than this is not worth a rough look.
SHORT = 2.0**-10

AXES = 15


@njit
def witness(
    ca: Floats, a: Floats, h: Floats, cb: Floats, b: Floats, f: Floats, most: Floats
) -> tuple[float, float, float, float, int]:
    """Return the signed gap, its unit axis from a towards b, and the number of the axis.

    ``most`` (15,) is work space.

    The largest of the 15 gaps along normalised axes: positive, it proves that the boxes are
    apart (by at least that much); negative, it is the least translation along any of the 15 that
    separates them. Equal gaps are decided by the axes themselves, so that swapping the boxes only
    reverses the axis. Where the centres agree along the axis, its sign carries no meaning.

    Only axes that may have the largest gap, by a rough calculation with its error bound, are
    computed carefully: one or two of the 15, as a rule. The result is that of all 15.
    """
    least = _bound_gaps(ca, a, h, cb, b, f, most)
    best = -np.inf
    bx, by, bz = 0.0, 0.0, 0.0
    number = -1
    for axis in range(AXES):
        if not most[axis] >= least:
            continue
        gap, _, nx, ny, nz = careful_axis(ca, a, h, cb, b, f, axis)
        if gap > best or (gap == best and _before(nx, ny, nz, bx, by, bz)):
            best = gap
            bx, by, bz = nx, ny, nz
            number = axis
    return best, bx, by, bz, number


@njit
def _bound_gaps(
    ca: Floats, a: Floats, h: Floats, cb: Floats, b: Floats, f: Floats, most: Floats
) -> float:
    """Write the most that each gap can be (15,), and return the least the largest must be."""
    dx, dy, dz = cb[0] - ca[0], cb[1] - ca[1], cb[2] - ca[2]
    size = (abs(dx) + abs(dy) + abs(dz)) + (h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2])
    least = -np.inf
    for axis in range(AXES):
        i = axis % 3
        if axis < 3:
            nx, ny, nz = a[0, i], a[1, i], a[2, i]
        elif axis < 6:
            nx, ny, nz = b[0, i], b[1, i], b[2, i]
        else:
            k = (axis - 6) // 3
            nx = a[1, k] * b[2, i] - a[2, k] * b[1, i]
            ny = a[2, k] * b[0, i] - a[0, k] * b[2, i]
            nz = a[0, k] * b[1, i] - a[1, k] * b[0, i]
        square = nx * nx + ny * ny + nz * nz
        if square < SHORT * SHORT:
            most[axis] = np.inf
            continue
        gap = abs(nx * dx + ny * dy + nz * dz)
        for k in range(3):
            gap -= h[k] * abs(nx * a[0, k] + ny * a[1, k] + nz * a[2, k])
            gap -= f[k] * abs(nx * b[0, k] + ny * b[1, k] + nz * b[2, k])
        norm = math.sqrt(square)
        error = size * (GAP_ERROR / norm + LENGTH_ERROR / square) + UNDERFLOW
        most[axis] = gap / norm + error
        least = max(least, gap / norm - error)
    return least


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
    most = np.empty(AXES)
    for n in range(len(pairs)):
        i, j = pairs[n]
        gap, nx, ny, nz, _ = witness(
            centers[i], rotations[i], half_extents[i],
            centers[j], rotations[j], half_extents[j], most,
        )  # fmt: skip
        gaps[n] = gap
        axes[n, 0] = nx
        axes[n, 1] = ny
        axes[n, 2] = nz
        common_point(
            centers[i], rotations[i], half_extents[i],
            centers[j], rotations[j], half_extents[j], points[n],
        )  # fmt: skip


#: Rounds of alternating projections: each moves the point into one box, then into the other.
#: A few are enough, but for thin wedges.
PROJECTION_ROUNDS = 32
#: They end when the point moves less than this, relative to the sum of the half extents: what
#: is drawn needs no more.
SETTLED = 1e-4


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
    settled = SETTLED * (h[0] + h[1] + h[2] + f[0] + f[1] + f[2])
    for _ in range(PROJECTION_ROUNDS):
        clamp_to_box(out, ca, a, h)
        if clamp_to_box(out, cb, b, f) <= settled:
            break


@njit
def clamp_to_box(point: Floats, center: Floats, axes: Floats, extents: Floats) -> float:
    """Move the point to the nearest one of the box; return the largest step along an axis."""
    moved = 0.0
    dx = point[0] - center[0]
    dy = point[1] - center[1]
    dz = point[2] - center[2]
    for i in range(3):
        along = dx * axes[0, i] + dy * axes[1, i] + dz * axes[2, i]
        excess = along - min(max(along, -extents[i]), extents[i])
        if excess == 0.0:
            continue
        moved = max(moved, abs(excess))
        point[0] -= excess * axes[0, i]
        point[1] -= excess * axes[1, i]
        point[2] -= excess * axes[2, i]
    return moved
