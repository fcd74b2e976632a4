"""Is a point inside a box? Closed boxes: the surface belongs to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.geometry.exact import contains_exactly
from obb_collision.geometry.validation import Floats

OUTSIDE = 0
DOUBTFUL = 1
INSIDE = 2

#: Bound of abs(a_i.(p - c)) - h_i relative to abs(p - c) + sum h: rounding gives 6 units of
#: 2^-53; that a_i is the face normal of orthonormal axes only to 64 units (see ``separation``)
#: gives 2 x 96 more.
CONTAINMENT_BOUND = 2.0**-45
#: Added to the bound: more than what gradual underflow can take.
UNDERFLOW = 2.0**-1060


def contains(
    center: Floats, rotation: Floats, half_extents: Floats, points: Floats, exact: bool = False
) -> NDArray[np.bool_]:
    """Return (n,) whether each point (n, 3) lies in the closed box.

    Points that doubles can't tell from the surface (within ``CONTAINMENT_BOUND`` of the size)
    count as inside; with ``exact=True`` they are decided by integer arithmetic.
    """
    places = np.empty(len(points), np.int8)
    containment_kernel(center, rotation, half_extents, points, places)
    inside: NDArray[np.bool_] = places != OUTSIDE
    if exact:
        doubtful = np.flatnonzero(places == DOUBTFUL)
        inside[doubtful] = contains_exactly(center, rotation, half_extents, points[doubtful])
    return inside


@njit
def containment_kernel(
    center: Floats, axes: Floats, extents: Floats, points: Floats, out: np.ndarray
) -> None:
    """Write INSIDE, OUTSIDE or DOUBTFUL for each point."""
    size = extents[0] + extents[1] + extents[2]
    for n in range(len(points)):
        dx = points[n, 0] - center[0]
        dy = points[n, 1] - center[1]
        dz = points[n, 2] - center[2]
        excess = max(
            abs(axes[0, 0] * dx + axes[1, 0] * dy + axes[2, 0] * dz) - extents[0],
            abs(axes[0, 1] * dx + axes[1, 1] * dy + axes[2, 1] * dz) - extents[1],
            abs(axes[0, 2] * dx + axes[1, 2] * dy + axes[2, 2] * dz) - extents[2],
        )
        bound = CONTAINMENT_BOUND * (abs(dx) + abs(dy) + abs(dz) + size) + UNDERFLOW
        if excess > bound:
            out[n] = OUTSIDE
        elif excess < -bound:
            out[n] = INSIDE
        else:
            out[n] = DOUBTFUL
