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

"""Points of a cloud inside boxes, meshes or convex bodies, or within a margin of them.

Boxes are closed, as in ``containment``. Without a margin the answer for each point is that of
``contains``, and undecided points count as inside. With a margin a point counts if its Euclidean
distance to the box is at most the margin, or exceeds it by less than 2^-44 of the point's distance
from the centre, the half extents and the margin. ``containment`` says the same of meshes and hulls.

Clouds are taken as they are: float32 or float64, of any strides, NaN and infinite points among
them. Threads test parts of the cloud. Sums and minima do not depend on the parts, so the result is
the same bit for bit for any number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run_parts
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import as_array, as_flag, as_points, check_kind
from obb_collision.numerics.constants import ROUNDOFF, UNDERFLOW
from obb_collision.numerics.exact import length
from obb_collision.numerics.vec3 import lengths
from obb_collision.queries.convex.support import ConvexBodies, Solids, solids_of
from obb_collision.queries.meshes.placed import PlacedMeshes, root_boxes
from obb_collision.queries.meshes.trees import NodeStack, node_stack
from obb_collision.queries.points.containment import (
    INSIDE_BOUND,
    OUTSIDE,
    body_holds,
    convex_holds,
    place_carefully,
)
from obb_collision.queries.points.grid import (
    CELL_COUNT,
    CELL_GRID,
    CELL_START,
    Grid,
    build_grid,
    find_cell,
)
from obb_collision.queries.primitives.segments import LARGEST_EXPONENT
from obb_collision.typing import Floats, Integers, Vector

#: Points a thread takes at a time: 1 ms or so, so that all end together.
CHUNK = 1 << 15
#: Pairs of box and cell tested for the grid, per point: a test takes less time than a point.
GRID_EFFORT = 0.1
#: Parts of a cloud at most: each has results of its own for every box.
MOST_CHUNKS = 64
#: Points that count as inside are within this of the box, relative to the half extents and margin.
POINT_REACH = 8192 * ROUNDOFF


@dataclass(frozen=True, eq=False)
class PointsInside:
    """The points of a cloud in each box or mesh; the centre of a mesh is that of its box.

    indices (n,): rows of the boxes.

    counts (n,): points inside. first (n,): the lowest index of those, -1 without any. nearest
    (n,): the index of the one nearest to the box centre (of equally near ones the lowest), -1
    without any. distances (n,) metres: its distance from the centre, infinite without any.
    ignored: points with a coordinate that is not finite. boxes (p,), with ``each_point``: the
    lowest box that holds each point, -1 for none.

    In a report there is a row per pair of a cloud and an object, by cloud. indices: of objects.
    clouds (n,): of the cloud's objects, or -1 - k for cloud k of ``Scene.watched``, counted from 0.
    positions (n, 3) metres: of the nearest points, NaN without any.
    """

    indices: Integers
    counts: Integers
    first: Integers
    nearest: Integers
    distances: Floats
    ignored: int
    boxes: NDArray[np.int32] | None = None
    clouds: Integers | None = None
    positions: Floats | None = None

    def __len__(self) -> int:
        return len(self.indices)


def points_inside(
    boxes: Boxes | PlacedMeshes, points: ArrayLike, margin: float = 0.0, *, each_point: bool = False
) -> PointsInside:
    """Return which points of a cloud lie inside which boxes or meshes.

    Parameters
    ----------
    boxes : Boxes or PlacedMeshes
        Solids hold what is inside, surfaces what is on them.
    points : (p, 3) array_like
        Metres, float32 or float64; rows that are not finite are ignored and counted.
    margin : float
        Metres; points this near to a box or mesh count, too.
    each_point : bool
        Whether to return ``boxes``, too: for each point, which box holds it.

    Returns
    -------
    PointsInside
        counts (n,), first (n,), nearest (n,), distances (n,) metres from the centre; ignored; boxes
        (p,) with ``each_point``.

    Examples
    --------
    >>> zones = oc.Boxes([[0, 0, 0], [5, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
    >>> oc.points_inside(zones, [[0.5, 0, 0], [0, 0, 0.75], [9, 9, 9]]).counts.tolist()
    [2, 0]
    """
    if not isinstance(boxes, PlacedMeshes):
        check_kind(boxes, Boxes, "boxes")
    as_flag(each_point, "each_point")
    cloud = as_points(points, "points")
    reach = float(as_array(margin, "margin", ()))
    if reach < 0.0:
        raise ValueError(f"margin must not be negative, got {reach!r}")
    if isinstance(boxes, Boxes):
        return points_in_bodies(boxes, None, cloud, reach, each_point=each_point)
    return points_in_bodies(root_boxes(boxes), boxes, cloud, reach, each_point=each_point)


def points_in_bodies(
    boxes: Boxes,
    bodies: PlacedMeshes | ConvexBodies | None,
    cloud: NDArray[np.floating],
    reach: float,
    radii: Floats | None = None,
    each_point: bool = False,
) -> PointsInside:
    """Return which points are in boxes, or in the bodies in them; arguments are not checked.

    bodies: body i is within box i. reach: the margin (m). radii (n,): of meshes (m); convex bodies
    have radii of their own.
    """
    radii = np.zeros(len(boxes)) if radii is None else radii
    inner = None if bodies is None else solids_of(bodies, radii)
    size = max(CHUNK, -(-len(cloud) // MOST_CHUNKS))
    starts = range(0, len(cloud), size)
    tallies = np.zeros((len(starts), 3, len(boxes)), np.int64)
    squares = np.empty((len(starts), len(boxes)))
    ignored = np.zeros(len(starts), np.int64)
    labels = np.empty(len(cloud) if each_point else 0, np.int32)
    zones = _zones(boxes, reach, len(cloud))

    def look(n: int, count: int = size) -> None:
        part = np.array(cloud[starts[n] : starts[n] + count], np.float64, order="C")  # one type
        out = tallies[n], squares[n], labels
        ignored[n] = points_kernel(part, starts[n], zones, reach, inner, out)

    if len(starts) > 1:
        look(0, 0)  # see ``_threads.run``
    run_parts(look, len(starts))
    by_point = labels if each_point else None
    return _merged(boxes, cloud, tallies, squares, int(ignored.sum()), by_point)


class Zones(NamedTuple):
    """Boxes that may hold points."""

    whole: Floats  #: (6,) bounds of all boxes
    grid: Grid
    records: Floats
    """(n, 17) centre, rotation row by row, half extents, their sum with the margin, and the power
    of two that makes this about 1"""


def _zones(boxes: Boxes, margin: float, points: int) -> Zones:
    size = boxes.half_extents.sum(axis=1) + margin
    pad = (margin + POINT_REACH * size + 4.0 * UNDERFLOW)[:, None]
    minimum, maximum = boxes.world_bounds()
    bounds = np.concatenate([minimum - pad, maximum + pad], axis=1)
    grown = boxes.arrays._replace(half_extents=boxes.half_extents + pad)
    grid = build_grid(bounds, grown, int(GRID_EFFORT * points))
    whole = np.concatenate(
        [bounds[:, :3].min(axis=0, initial=np.inf), bounds[:, 3:].max(axis=0, initial=-np.inf)]
    )
    power = np.clip(np.frexp(size)[1], -LARGEST_EXPONENT, LARGEST_EXPONENT)
    columns = [boxes.centers, boxes.rotations.reshape(-1, 9), boxes.half_extents, size[:, None]]
    records = np.concatenate([*columns, np.ldexp(1.0, -power)[:, None]], axis=1)
    return Zones(whole, grid, records)


def _merged(
    boxes: Boxes,
    cloud: NDArray[np.floating],
    tallies: Integers,
    squares: Floats,
    ignored: int,
    labels: NDArray[np.int32] | None,
) -> PointsInside:
    """Merge the results of the parts of a cloud: tallies (parts, 3, n) and squares (parts, n)."""
    counts = tallies[:, 0].sum(axis=0)
    first, nearest = np.full((2, len(boxes)), -1)
    distances = np.full(len(boxes), np.inf)
    held = np.flatnonzero(counts)
    if len(held):
        hit = tallies[:, 0, held] > 0
        first[held] = np.where(hit, tallies[:, 1, held], len(cloud)).min(axis=0)
        # argmin takes the first part of equally near ones, and with it the lowest index
        part = np.where(hit, squares[:, held], np.inf).argmin(axis=0)
        nearest[held] = tallies[part, 2, held]
        offsets = cloud[nearest[held]].astype(np.float64) - boxes.centers[held]
        distances[held] = lengths(offsets)
    indices = np.arange(len(boxes))
    return PointsInside(indices, counts, first, nearest, distances, ignored, labels)


#: Columns of a box's record: centre (3), rotation (9), half extents (3), then these.
RECORD_SIZE, RECORD_SCALE = 15, 16


@njit
def points_kernel(
    points: Floats,
    first: int,
    zones: Zones,
    margin: float,
    inner: Solids | None,
    out: tuple[np.ndarray, Floats, np.ndarray],
) -> int:
    """Write which points (m, 3) are in boxes, or bodies in them; return how many are not finite.

    first: the number of the first point. inner: None compiles no code for bodies.

    out: counts, first and nearest (3, n); squares (n,) of the least scaled distance; labels (p,) or
    (0,), the lowest box of each point.
    """
    whole, (cells, items, frames, numbers), records = zones
    tallies, squares, labels = out
    ignored = 0
    labelled = len(labels) > 0
    waiting = node_stack()
    for row in range(len(points)):
        n, label = first + row, -1
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        if (
            (x >= whole[0])
            & (y >= whole[1])
            & (z >= whole[2])
            & (x <= whole[3])
            & (y <= whole[4])
            & (z <= whole[5])
        ):
            cell = 0
            while cells[cell, CELL_GRID] >= 0:
                cell = find_cell(frames, numbers, cells[cell, CELL_GRID], x, y, z)
            last = cells[cell, CELL_START] + cells[cell, CELL_COUNT]
            for m in range(cells[cell, CELL_START], last):
                b = items[m] + 0  # int64, as other tallies are: int32 would compile more kernels
                dx, dy, dz = x - records[b, 0], y - records[b, 1], z - records[b, 2]
                if not _inside(records, b, dx, dy, dz, margin):
                    continue
                if inner is not None:  # noqa: SIM102  # None is another type
                    if not _holds(inner, b, (x, y, z), margin, waiting):
                        continue
                scale = records[b, RECORD_SCALE]
                dx, dy, dz = scale * dx, scale * dy, scale * dz
                square = dx * dx + dy * dy + dz * dz
                if tallies[0, b] == 0:
                    tallies[1, b] = n
                if tallies[0, b] == 0 or square < squares[b]:
                    tallies[2, b] = n
                    squares[b] = square
                tallies[0, b] += 1
                label = b if label < 0 else min(label, b)
        elif (x - x) + (y - y) + (z - z) != 0.0:
            ignored += 1
        if labelled:
            labels[n] = label
    return ignored


@njit(refcount=False)
def _holds(inner: Solids, b: int, point: Vector, margin: float, waiting: NodeStack) -> bool:
    """Return whether the body in box b contains a point."""
    if len(inner.meshes.meshes) > 0:
        return body_holds(inner.meshes, b, point, margin + inner.radii[b], waiting)
    return convex_holds(inner.cores, b, point, margin)


@njit(refcount=False)
def _inside(records: Floats, b: int, dx: float, dy: float, dz: float, margin: float) -> bool:
    """Return whether the point at this offset from the centre of box b counts as inside."""
    x = abs(records[b, 3] * dx + records[b, 6] * dy + records[b, 9] * dz) - records[b, 12]
    y = abs(records[b, 4] * dx + records[b, 7] * dy + records[b, 10] * dz) - records[b, 13]
    z = abs(records[b, 5] * dx + records[b, 8] * dy + records[b, 11] * dz) - records[b, 14]
    bound = INSIDE_BOUND * (abs(dx) + abs(dy) + abs(dz) + records[b, RECORD_SIZE]) + UNDERFLOW
    excess = max(x, y, z)
    if excess > margin + bound:
        return False
    if excess < -bound:
        return True
    if margin > 0.0:
        return length(max(x, 0.0), max(y, 0.0), max(z, 0.0)) <= margin + bound
    x_axis = records[b, 3], records[b, 6], records[b, 9]
    y_axis = records[b, 4], records[b, 7], records[b, 10]
    z_axis = records[b, 5], records[b, 8], records[b, 11]
    half_extents = records[b, 12], records[b, 13], records[b, 14]
    place = place_carefully((dx, dy, dz), (x_axis, y_axis, z_axis), half_extents)
    return place != OUTSIDE
