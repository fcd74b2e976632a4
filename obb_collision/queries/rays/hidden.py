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

"""Points that convex bodies hide from a sensor: the segment from it to a point meets a body.

A body is missed only where a plane certainly parts it from the segment (``convex.distance``). The
plane that did it for the ray before is tried first: neighbours in a cloud see nearly the same.
Bodies whose spheres the segment passes are missed before.

Error analysis, u as there: the ends of a segment, computed from its middle, direction and length,
are off by at most 16 u times the sum of the magnitudes of both given ends, and so is any point of
it from a centre; ``END_BOUND`` is 64 u.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision._threads import run_parts
from obb_collision.geometry.boxes import Boxes
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import (
    ZERO,
    components,
    fast_norm,
    lengths,
    minus,
    plus,
    scaled,
    sum_abs,
    vector_at,
)
from obb_collision.queries.convex.distance import rounding, search
from obb_collision.queries.convex.support import (
    SEGMENT_CORE,
    ConvexBodies,
    Core,
    Cores,
    body_place,
    borrowed_core,
)
from obb_collision.queries.meshes.placed import PairPose
from obb_collision.queries.points.points import points_in_bodies
from obb_collision.typing import Floats, Mask, Vector

#: Error of a point of a segment, relative to its ends (derivation above).
END_BOUND = 64 * ROUNDOFF
#: Points of a part, which one thread takes.
CHUNK = 1 << 14


def add_hidden(
    out: Mask,
    sensor: Floats,
    points: NDArray[np.floating],
    boxes: Boxes,
    bodies: ConvexBodies,
    padding: float,
) -> None:
    """Set out (n,) for the points (n, 3) that bodies in boxes hide from a sensor at (3,).

    Nothing is checked. Points that are set already are not looked at; none is hidden that is not
    finite. A body hides the points behind it and its padding (m). If the sensor is in the padding,
    only those behind the body itself; if the sensor is in the body, none.
    """
    near, within = (
        points_in_bodies(boxes, bodies, sensor[None], margin).counts > 0
        for margin in (padding, 0.0)
    )
    rows = np.flatnonzero(~within)
    if not len(rows):
        return
    grown = np.where(near, 0.0, padding)[rows]
    cores = bodies.take(rows, grown).arrays
    centers, spheres = boxes.centers[rows], np.empty((4, 1 + len(rows)))
    spheres[:3, 1:], spheres[:3, 0] = centers.T, centers.mean(axis=0)
    spheres[3, 1:] = lengths(boxes.half_extents[rows]) * (1.0 + END_BOUND) + grown
    spheres[3, 0] = (lengths(centers - spheres[:3, 0]) + spheres[3, 1:]).max()
    spheres[3] += END_BOUND * (np.abs(centers).sum(axis=1).max() + spheres[3])
    starts, eye = range(0, len(points), CHUNK), np.array(sensor)

    def look(n: int) -> None:
        rows = slice(starts[n], starts[n] + CHUNK)
        part = np.array(points[rows], np.float64, order="C")  # one type
        hidden_kernel(eye, part, spheres, cores, out[rows])

    run_parts(look, len(starts))


class Sight(NamedTuple):
    """The segment from a sensor to a point."""

    eye: Vector
    unit: Vector
    length: float
    error: float  #: by how much its points may be off


@njit(inline=True)
def sight_of(eye: Vector, point: Vector) -> Sight:
    """Return the segment between two points; its length is 0, infinite or NaN for no segment."""
    way = minus(point, eye)
    length = fast_norm(way)
    unit = scaled(way, 1.0 / length) if length > 0.0 else ZERO
    return Sight(eye, unit, length, END_BOUND * (sum_abs(point) + sum_abs(eye)))


@njit(inline=True)
def middle_from(sight: Sight, center: Vector) -> Vector:
    """Return the offset of the middle of a segment from a centre."""
    return minus(plus(sight.eye, scaled(sight.unit, 0.5 * sight.length)), center)


@njit
def hidden_kernel(
    sensor: Floats, points: Floats, spheres: Floats, bodies: Cores, out: np.ndarray
) -> None:
    """Set out for hidden points (n, 3); spheres (4, 1 + b): about all bodies, and each."""
    count, eye = len(bodies.kinds), (sensor[0], sensor[1], sensor[2])
    normals, near = np.zeros((count, 3)), np.empty(count + 1, np.bool_)
    for n in range(len(points)):
        if out[n]:
            continue
        sight = sight_of(eye, vector_at(points, n))
        if not 0.0 < sight.length < np.inf or _passes(sight, spheres, 0):
            continue
        for i in range(1, count + 1):  # without a branch, so that it is vectorised
            near[i] = not _passes(sight, spheres, i)
        for i in range(count):
            if near[i + 1] and _meets(sight, bodies, i, normals):
                out[n] = True
                break


@njit(inline=True)
def _passes(sight: Sight, spheres: Floats, k: int) -> bool:
    """Return whether a segment certainly does not meet sphere k."""
    (x, y, z), (u, v, w) = sight.eye, sight.unit
    x, y, z = spheres[0, k] - x, spheres[1, k] - y, spheres[2, k] - z
    along = min(max(x * u + y * v + z * w, 0.0), sight.length)
    x, y, z, reach = x - along * u, y - along * v, z - along * w, spheres[3, k] + sight.error
    return x * x + y * y + z * z > reach * reach


@njit(refcount=False)
def _meets(sight: Sight, bodies: Cores, i: int, normals: Floats) -> bool:
    """Return whether no plane certainly parts a segment from body i; normals (b, 3): tried first.

    A segment has no extent but along its own axis, so that the pose needs no other.
    """
    core, place, half = borrowed_core(bodies, i), body_place(bodies, i), 0.5 * sight.length
    segment = Core(SEGMENT_CORE, ZERO, half, core.blocks, core.first, core.last, half, 0.0)
    d, axes = middle_from(sight, place.center), (ZERO, ZERO, components(place.axes, sight.unit))
    pose = PairPose(axes, components(place.axes, d), sum_abs(d) + core.reach + half, 0.0, 0.0)
    needed = core.radius + rounding(pose) + sight.error
    found = search(core, segment, pose, vector_at(normals, i), needed)
    normals[i, 0], normals[i, 1], normals[i, 2] = found.normal
    return not found.gap > needed
