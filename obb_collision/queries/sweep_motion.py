"""How far boxes get between two poses: turns, swept bounds, and whether a sweep is called for.

Box k moves for one unit of time from its start pose to its end pose: its centre along a line at
constant speed, turning at constant speed the shortest way about a fixed axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BOUND_SLACK, BOUND_UNDERFLOW, Boxes
from obb_collision.geometry.error_free import length
from obb_collision.geometry.poses import quaternions_from_matrices
from obb_collision.geometry.validation import Floats, first_bad_row

#: Rounding of a radius, or of a bound on motion: a few units of 2^-53.
OUTWARD = 1.0 + 2.0**-48


def check_same_boxes(start: Boxes, end: Boxes) -> None:
    """Raise ValueError unless both have the same number of boxes with the same half extents."""
    if len(start) != len(end):
        raise ValueError(
            f"start and end must have the same length, got {len(start)} and {len(end)}"
        )
    if not np.array_equal(start.half_extents, end.half_extents):
        differ = (start.half_extents != end.half_extents).any(axis=1)
        raise ValueError(
            f"end must have the half extents of start, they differ{first_bad_row(differ)}"
        )


def turns_between(start: Boxes, end: Boxes) -> Floats:
    """Return the rotation vectors (n, 3), radians: angle at most pi times the unit axis.

    Exactly zero where both rotations are the same bit for bit. At exactly pi both ways are
    equally short, and rounding decides between them.
    """
    vectors = np.zeros((len(start), 3))
    turned = np.flatnonzero(_turned(start.rotations, end.rotations))
    if len(turned):
        relative = np.einsum("nij,nkj->nik", end.rotations[turned], start.rotations[turned])
        quaternions = quaternions_from_matrices(relative)
        sines = np.linalg.norm(quaternions[:, :3], axis=1)
        angles = 2.0 * np.arctan2(sines, quaternions[:, 3])
        # Two rotations that differ by rounding may give a null axis: then there is no turn.
        scale = np.divide(angles, sines, out=np.zeros_like(sines), where=sines > 0.0)
        vectors[turned] = quaternions[:, :3] * scale[:, None]
    return vectors


@njit
def _turned(first: Floats, last: Floats) -> np.ndarray:
    """Return (n,) whether two rotations (n, 3, 3) differ in any bit."""
    result = np.zeros(len(first), np.bool_)
    for n in range(len(first)):
        for i in range(3):
            for j in range(3):
                result[n] |= first[n, i, j] != last[n, i, j]
    return result


def bounding_radii(half_extents: Floats) -> Floats:
    """Return (n,) radii of the circumscribed spheres, rounded up."""
    radii = np.empty(len(half_extents))
    _fill_radii(half_extents, radii)
    return radii


@njit
def _fill_radii(half_extents: Floats, out: Floats) -> None:
    for n in range(len(half_extents)):
        x, y, z = half_extents[n, 0], half_extents[n, 1], half_extents[n, 2]
        out[n] = length(x, y, z) * OUTWARD + BOUND_UNDERFLOW


def swept_bounds(start: Boxes, end: Boxes) -> tuple[Floats, Floats]:
    """Return minimum and maximum (n, 3) of axis-aligned boxes that certainly contain each motion.

    The union of the bounds at both ends, which is all a motion without turning needs. A turn by
    the angle w takes a point at most radius w^2 / 8 away from the line between its ends (the
    error of linear interpolation), and never out of the sphere round the box: the lesser counts.
    Raises ValueError if lengths or half extents differ.
    """
    check_same_boxes(start, end)
    low_a, high_a = start.world_bounds()
    low_b, high_b = end.world_bounds()
    low, high = np.minimum(low_a, low_b), np.maximum(high_a, high_b)
    angles = np.linalg.norm(turns_between(start, end), axis=1)
    turning = np.flatnonzero(angles > 0.0)
    if len(turning):
        radii = bounding_radii(start.half_extents[turning])[:, None]
        sag = radii * (0.125 * OUTWARD) * (angles[turning] ** 2)[:, None]
        centers = np.stack([start.centers[turning], end.centers[turning]])
        slack = BOUND_SLACK * (np.abs(centers).max(axis=0) + radii) + BOUND_UNDERFLOW
        low[turning] = np.maximum(low[turning] - sag, centers.min(axis=0) - radii) - slack
        high[turning] = np.minimum(high[turning] + sag, centers.max(axis=0) + radii) + slack
    return low, high


def motion_bounds(start: Boxes, end: Boxes) -> Floats:
    """Return (n,) metres that no point of each box exceeds on its way, rounded up."""
    way = end.centers - start.centers
    turned = np.linalg.norm(turns_between(start, end), axis=1) * bounding_radii(start.half_extents)
    with np.errstate(over="ignore"):
        total: Floats = (np.hypot(np.hypot(way[:, 0], way[:, 1]), way[:, 2]) + turned) * OUTWARD
    return total


def sweep_needed(start: Boxes, end: Boxes) -> NDArray[np.bool_]:
    """Return (n,) whether a box moves so far that it could pass through something unseen.

    That is: farther than its smallest half extent, by the longest way of any of its points. A
    pair needs a sweep if either box does. Raises ValueError if lengths or half extents differ.

    What skipping the other pairs promises. Let two boxes be apart at the start and at the end,
    and M the sum of both ways. At a time t some axis that separated at the start is overlapped
    by at most what both moved until then, and likewise for the end and what they still move: so
    the depth (least translation that separates) is never more than M / 2. If the centre of one
    box were inside the other, the depth would be more than its smallest half extent. As M / 2 is
    not above the larger of both, the thicker box never gets its centre into the thinner one, let
    alone through it: thin plates are not passed through, however thin. What may go unseen is a
    graze at a corner or edge that begins and ends within the step, at most M / 2 deep.
    """
    check_same_boxes(start, end)
    smallest = start.half_extents.min(axis=1, initial=np.inf)
    needed: NDArray[np.bool_] = motion_bounds(start, end) > smallest
    return needed & ~_still(start, end)


def _still(start: Boxes, end: Boxes) -> NDArray[np.bool_]:
    moved = (start.centers != end.centers).any(axis=1)
    result: NDArray[np.bool_] = ~(moved | _turned(start.rotations, end.rotations))
    return result
