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

"""Fit an oriented box to points: several ways to choose its axes, ``"best"`` the smallest box.

The box certainly contains every point, in exact arithmetic for the doubles as stored. On 61 real
meshes the plain covariance box was looser than the axis-aligned one (1.27 against 1.15 times the
minimum volume, hull covariance 1.16, trimesh's minimum volume 1.005), hence ``"best"``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.fitting.candidates import (
    box_size,
    complete_frame,
    covariance_frame,
    hull_covariance_frame,
    keep_flat,
    minimum_volume_frame,
    polygon_covariance_frame,
    refined_frame,
    spread_frames,
)
from obb_collision.geometry.fitting.convex_hull import convex_hull, hull_volume
from obb_collision.geometry.fitting.enclosing import enclose_points
from obb_collision.geometry.validation import as_array
from obb_collision.numerics.constants import FLAT, MAX_MAGNITUDE, VOLUME_TIE
from obb_collision.typing import Floats
from obb_collision.words import shown

#: Extents up to this many spacings of the coordinates also count as flat: that is how points far
#: from the origin scatter when they are rounded to doubles.
FLAT_ROUNDOFFS = 4.0

#: Maximum number of hull corners used for choosing axes; above it, those extreme in DIRECTIONS
#: directions: 10,000 take trimesh 0.3 s, a round rim of 20,000 takes gigabytes.
MANY_CORNERS = 2000
#: Maximum number of points of which the hull is made: a million on a sphere take Qhull 10 s.
MANY_POINTS = 100_000
#: Number of principal frames, and of spread ones, that "best" refines (see SPREAD).
REFINED_PRINCIPAL = 2
REFINED_SPREAD = 4
#: Directions spread evenly over a half sphere; two extreme points each.
DIRECTIONS = 256


def fit_points(points: ArrayLike, fit: str = "best") -> tuple[Floats, Floats, Floats]:
    """Return (center (3,), rotation (3, 3), half_extents (3,)) of a box around points (n, 3).

    fit: how the axes are chosen: "aabb" (the coordinate axes), "covariance" (principal axes of the
    points), "hull_covariance" (of the surface of their hull), "min_volume" (trimesh's oriented
    bounds, refined), "best" (the smallest of all; of flat sets by area, of lines by length).

    Any set has a box: one point, duplicates, lines, planes. Columns of the rotation are the
    axes, determinant +1. Raises ValueError for an unknown fit, an empty set, wrong shapes or
    numbers that are not finite (with the row).
    """
    check_fit(fit)
    array = as_array(points, "points", (None, 3))
    if len(array) == 0:
        raise ValueError("points must not be empty, got shape (0, 3)")
    rotation = _choose_frame(array, fit)
    center, half_extents = enclose_points(array, rotation)
    if half_extents.max() > MAX_MAGNITUDE and fit != "aabb":
        return fit_points(array, "aabb")  # the only box within MAX_MAGNITUDE
    return center, rotation, half_extents


def check_fit(fit: str) -> str:
    """Return the name of a fit; ValueError listing the choices for any other."""
    if not isinstance(fit, str) or fit not in FITS:
        choices = ", ".join(repr(name) for name in FITS)
        raise ValueError(f"fit must be one of {choices}, got {shown(fit)}")
    return fit


def _choose_frame(points: Floats, fit: str) -> Floats:
    low, high = points.min(axis=0), points.max(axis=0)
    flat: NDArray[np.bool_] = low == high
    if fit == "aabb" or flat.sum() >= 2:
        return np.eye(3)
    scaled, noise = _normalized(points, low, high)
    rank, frame, floor = _rank(scaled, noise)
    if fit == "covariance":
        return keep_flat(frame, flat)
    if rank == 1:
        corners, judges = scaled, scaled
    else:
        corners, complete = _corners(scaled, frame)
        judges = corners if complete else scaled
    tight = (1.0 + VOLUME_TIE) * hull_volume(corners) if rank == 3 else 0.0
    best: Floats | None = None
    smallest = np.inf
    for candidate in FITS[fit](corners, frame, rank, floor):
        exact = keep_flat(candidate, flat)
        size = box_size(judges, exact, floor)
        if best is None or size < smallest * (1.0 - VOLUME_TIE):
            best, smallest = exact, size
        if smallest <= tight:
            break  # the hull is a box
    assert best is not None  # every fit offers at least the principal axes
    return best


def _normalized(points: Floats, low: Floats, high: Floats) -> tuple[Floats, float]:
    """Return the points about the centroid, size about 1, and the rounding noise in them."""
    offsets = points - (low + 0.5 * (high - low))
    exponent = int(np.frexp(np.abs(offsets).max())[1])
    scaled = np.ldexp(offsets, -exponent)
    magnitude = max(np.abs(low).max(), np.abs(high).max())
    noise = FLAT_ROUNDOFFS * float(np.ldexp(np.spacing(magnitude), -exponent))
    return scaled - scaled.mean(axis=0), noise


def _rank(points: Floats, noise: float) -> tuple[int, Floats, float]:
    """Return the dimension of the points' span, their principal axes, and the limit of flatness."""
    frame = covariance_frame(points)
    widths = np.ptp(points @ frame, axis=0)
    floor = FLAT * float(widths.max()) + noise
    return max(1, int((widths > floor).sum())), frame, floor


def _corners(points: Floats, frame: Floats) -> tuple[Floats, bool]:
    """Return at most a few thousand points for choosing axes, and whether their box is that of all.

    The corners of the hull, or some of them.
    """
    if len(points) <= MANY_POINTS:
        hull = convex_hull(points)
        corners = points if hull is None else points[hull.vertices]
        if len(corners) <= MANY_CORNERS:
            return corners, True
    along = points @ frame
    widths = np.ptp(along, axis=0)
    along /= np.where(widths > 0.0, widths, 1.0)  # thin sets have two sides too
    directions = _half_sphere(DIRECTIONS)
    chosen = _extreme_rows(along, directions)
    return points[chosen], False


def _half_sphere(count: int) -> Floats:
    """Return unit vectors (3, count) spread evenly over a half sphere (Fibonacci's spiral)."""
    z = (np.arange(count) + 0.5) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z])


def _extreme_rows(points: Floats, directions: Floats, block: int = 16384) -> NDArray[np.intp]:
    """Return the rows of points (n, 3) that are lowest or highest in directions (3, m)."""
    lowest = np.full(directions.shape[1], np.inf)
    highest = -lowest
    rows = np.zeros((2, directions.shape[1]), np.intp)
    for start in range(0, len(points), block):
        heights = directions.T @ points[start : start + block].T
        for extreme, pick, row, sign in (
            (lowest, heights.argmin(axis=1), rows[0], 1.0),
            (highest, heights.argmax(axis=1), rows[1], -1.0),
        ):
            found = np.take_along_axis(heights, pick[:, None], axis=1)[:, 0]
            better = sign * found < sign * extreme
            extreme[better] = found[better]
            row[better] = start + pick[better]
    return np.unique(rows)


Candidates = Callable[[Floats, Floats, int, float], Iterator[Floats]]


def _axis_aligned(corners: Floats, frame: Floats, rank: int, floor: float) -> Iterator[Floats]:
    yield np.eye(3)


def _hull_covariance(corners: Floats, frame: Floats, rank: int, floor: float) -> Iterator[Floats]:
    if rank == 1:
        found = None
    elif rank == 2:
        found = polygon_covariance_frame(corners, frame)
    else:
        found = hull_covariance_frame(corners)
    yield frame if found is None else found


def _minimum_volume(corners: Floats, frame: Floats, rank: int, floor: float) -> Iterator[Floats]:
    found = minimum_volume_frame(corners) if rank == 3 else None
    start = frame if found is None else found
    yield start if rank == 1 else refined_frame(corners, start, floor)


def _best(corners: Floats, frame: Floats, rank: int, floor: float) -> Iterator[Floats]:
    yield np.eye(3)
    if rank == 1:
        yield frame
        return
    yield from _minimum_volume(corners, frame, rank, floor)
    principal = [np.eye(3), frame, *_hull_covariance(corners, frame, rank, floor)]
    principal.sort(key=lambda candidate: box_size(corners, candidate, floor))
    for candidate in principal[:REFINED_PRINCIPAL]:
        yield refined_frame(corners, candidate, floor)
    if rank < 3:
        return  # the minimum rectangle in the plane has been found
    spread = spread_frames()
    widths = np.ptp(np.einsum("ni,mij->mnj", corners, spread), axis=1)
    for row in np.argsort(widths.prod(axis=1))[:REFINED_SPREAD]:
        candidate = complete_frame(spread[row, :, 0], spread[row, :, 1])
        yield refined_frame(corners, candidate, floor)


#: Generators of candidate axes by the name of the fit (the principal axes are given).
FITS: dict[str, Candidates] = {
    "aabb": _axis_aligned,
    "covariance": lambda corners, frame, rank, floor: iter([frame]),
    "hull_covariance": _hull_covariance,
    "min_volume": _minimum_volume,
    "best": _best,
}
