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

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.fitting.candidates import (
    HullFaces,
    box_sizes,
    complete_frame,
    covariance_frame,
    face_frames,
    flat_frames,
    hull_covariance_frame,
    keep_flat,
    refined_frames,
    spread_frames,
    upright_frame,
)
from obb_collision.geometry.fitting.convex_hull import convex_hull
from obb_collision.geometry.fitting.enclosing import enclose_points
from obb_collision.geometry.validation import as_array, as_rows
from obb_collision.numerics.constants import FLAT, MAX_MAGNITUDE, VOLUME_TIE
from obb_collision.typing import Floats
from obb_collision.words import shown

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull


#: Maximum number of hull corners used for choosing axes; above it, those extreme in DIRECTIONS
#: directions: 10,000 take trimesh 0.3 s, a round rim of 20,000 takes gigabytes.
MANY_CORNERS = 2000
#: Maximum number of points of which the hull is made: a million on a sphere take Qhull 10 s.
MANY_POINTS = 100_000
#: Directions spread evenly over a half sphere; two extreme points each.
DIRECTIONS = 256


@dataclass(frozen=True)
class Corners:
    """Up to a few thousand points (n, 3) by which axes are chosen: corners of the hull.

    hull: of these points, None where they are flat; complete: whether all points have their box.
    """

    points: Floats
    hull: ConvexHull | None
    complete: bool


def few_corners(points: Floats, frame: Floats, rank: int) -> Corners:
    """Return extreme points that represent a cloud about the origin; frame: its principal axes."""
    few = len(points) <= MANY_POINTS
    hull = convex_hull(points) if few and rank == 3 else None
    if few and len(points if hull is None else hull.vertices) <= MANY_CORNERS:
        return Corners(points, hull, True)
    along = points @ frame
    widths = np.ptp(along, axis=0)
    along /= np.where(widths > 0.0, widths, 1.0)  # thin sets have two sides too
    chosen = points[_extreme_rows(along, _half_sphere(DIRECTIONS))]
    return Corners(chosen, convex_hull(chosen) if rank == 3 else None, False)


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
            reached = np.take_along_axis(heights, pick[:, None], axis=1)[:, 0]
            better = sign * reached < sign * extreme
            extreme[better] = reached[better]
            row[better] = start + pick[better]
    return np.unique(rows)


#: Extents up to this many spacings of the coordinates also count as flat: that is how points far
#: from the origin scatter when they are rounded to doubles.
FLAT_ROUNDOFFS = 4.0

#: Number of principal frames, and of spread ones, that "best" refines (see SPREAD).
REFINED_PRINCIPAL = 2
REFINED_SPREAD = 8
#: Faces of the hull whose boxes it refines.
REFINED_FACES = 8


FITS = ("aabb", "covariance", "hull_covariance", "min_volume", "best", "upright")


def fit_points(points: ArrayLike, fit: str = "best") -> tuple[Floats, Floats, Floats]:
    """Return (center (3,), rotation (3, 3), half_extents (3,)) of a box around points (n, 3).

    fit: how the axes are chosen: "aabb" (the coordinate axes), "covariance" (principal axes of the
    points), "hull_covariance" (of the surface of their hull), "min_volume" (the smallest box with a
    side on a face of the hull, refined), "best" (the smallest of all; of flat sets by area, of
    lines by length), "upright" (z up, and the smallest rectangle seen from above).

    Any set has a box: one point, duplicates, lines, planes. Columns of the rotation are the
    axes, determinant +1. Raises ValueError for an unknown fit, an empty set, wrong shapes or
    numbers that are not finite (with the row).
    """
    check_fit(fit)
    array = as_array(points, "points", (None, 3))
    if len(array) == 0:
        raise ValueError("points must not be empty, got shape (0, 3)")
    return _fitted(array, fit)


def fit_clouds(
    clouds: ArrayLike | Iterable[ArrayLike], offsets: ArrayLike | None = None, fit: str = "best"
) -> tuple[Floats, Floats, Floats]:
    """Return the boxes of ``fit_points`` for k clouds: (k, 3), (k, 3, 3), (k, 3).

    clouds: k arrays (n, 3), or with offsets (k + 1,) one array of which cloud i is the rows from
    offsets[i] to offsets[i + 1]. Raises ValueError as ``fit_points``, naming the cloud.
    """
    check_fit(fit)
    parts = _listed(clouds) if offsets is None else _cut(clouds, offsets)
    boxes = np.empty((len(parts), 3)), np.empty((len(parts), 3, 3)), np.empty((len(parts), 3))
    for k, points in enumerate(parts):
        if len(points) == 0:
            raise ValueError(f"points must not be empty in cloud {k}")
        for out, value in zip(boxes, _fitted(points, fit), strict=True):
            out[k] = value
    return boxes


def _listed(clouds: Any) -> list[Floats]:
    if not isinstance(clouds, Iterable) or isinstance(clouds, str):
        raise ValueError(f"points must be clouds of shape (n, 3), got {shown(clouds)}")
    return [as_array(cloud, f"points of cloud {k}", (None, 3)) for k, cloud in enumerate(clouds)]


def _cut(points: Any, offsets: ArrayLike) -> list[Floats]:
    array = as_array(points, "points", (None, 3))
    ends = as_rows(offsets, "offsets", len(array) + 1)
    if len(ends) == 0 or ends[0] != 0 or ends[-1] != len(array) or (np.diff(ends) < 0).any():
        raise ValueError(f"offsets must ascend from 0 to the number of points, {len(array)}")
    return [array[i:j] for i, j in pairwise(ends)]


def _fitted(array: Floats, fit: str) -> tuple[Floats, Floats, Floats]:
    rotation = _choose_frame(array, fit)
    center, half_extents = enclose_points(array, rotation)
    if half_extents.max() > MAX_MAGNITUDE and fit != "aabb":
        return _fitted(array, "aabb")  # the only box within MAX_MAGNITUDE
    return center, rotation, half_extents


def check_fit(fit: str) -> str:
    """Return the name of a fit; ValueError with the choices for any other text."""
    if not isinstance(fit, str) or fit not in FITS:
        choices = ", ".join(repr(name) for name in FITS)
        raise ValueError(f"fit must be one of {choices}, got {shown(fit)}")
    return fit


def _choose_frame(points: Floats, fit: str) -> Floats:
    low, high = points.min(axis=0), points.max(axis=0)
    flat: NDArray[np.bool_] = low == high
    if fit == "aabb" or flat.sum() >= 2:
        return np.eye(3)
    offsets = points - (low + 0.5 * (high - low))
    exponent = int(np.frexp(np.abs(offsets).max())[1])
    scaled = np.ldexp(offsets, -exponent)  # of size about 1
    magnitude = max(np.abs(low).max(), np.abs(high).max())
    noise = FLAT_ROUNDOFFS * float(np.ldexp(np.spacing(magnitude), -exponent))
    scaled -= scaled.mean(axis=0)
    if fit == "upright":
        return upright_frame(scaled)
    frame = covariance_frame(scaled)
    widths = np.ptp(scaled @ frame, axis=0)
    floor = FLAT * float(widths.max()) + noise
    rank = max(1, int((widths > floor).sum()))  # the dimension of the span
    if fit == "covariance":
        return keep_flat(frame, flat)
    corners = few_corners(scaled, frame, rank)
    frames = _candidates(corners, fit, frame, rank, floor)
    if flat.any():
        frames = np.array([keep_flat(candidate, flat) for candidate in frames])
    sizes = box_sizes(corners.points if corners.complete else scaled, frames, floor)
    best = frames[int((sizes <= (1.0 + VOLUME_TIE) * sizes.min()).argmax())]
    return keep_flat(complete_frame(best[:, 0], best[:, 1]), flat)


def _candidates(corners: Corners, fit: str, frame: Floats, rank: int, floor: float) -> Floats:
    """Return candidate axes (m, 3, 3) of a fit that looks at the hull; frame: principal axes."""
    aligned, all_fits = np.eye(3), fit == "best"
    if rank == 1:
        return np.array([aligned, frame]) if all_fits else frame[None]
    points, hull = corners.points, corners.hull
    if hull is None:
        spread, smallest = flat_frames(points, frame)
        if all_fits:
            return np.array([aligned, spread, smallest, frame])
        return (spread if fit == "hull_covariance" else smallest)[None]
    faces = HullFaces(points, hull.vertices, hull.simplices, hull.neighbors)
    if fit == "min_volume":
        return refined_frames(faces, _best_faces(faces, floor)[:1], floor)
    spread = hull_covariance_frame(points[hull.simplices])
    if not all_fits:
        return spread[None]
    principal, starts = np.array([aligned, frame, spread]), [_best_faces(faces, floor)]
    for frames, count in ((principal, REFINED_PRINCIPAL), (spread_frames(), REFINED_SPREAD)):
        order = np.argsort(box_sizes(points[hull.vertices], frames, floor), kind="stable")
        starts.append(frames[order[:count]])
    return np.concatenate([principal[:1], refined_frames(faces, np.concatenate(starts), floor)])


def _best_faces(faces: HullFaces, floor: float) -> Floats:
    """Return axes (k, 3, 3) of the smallest boxes with a side on a face, equal boxes once."""
    frames, volumes = face_frames(faces, floor)
    order = np.argsort(volumes)
    ordered = volumes[order]
    differs = np.r_[True, ordered[1:] > (1.0 + VOLUME_TIE) * ordered[:-1]]
    return frames[order[differs][:REFINED_FACES]]
