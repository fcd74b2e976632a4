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

"""A point moved into two overlapping boxes: a at the origin, b with its centre at d.

Contact points lie halfway between two faces. Where the boxes overlap by more than the thickness of
one of them, or a face leans away below the other, that is outside; most often it is not.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import (
    clamped,
    combined,
    components,
    max_abs,
    minus,
    negated,
    pick,
    pick_axis,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.contacts.patch import CAPACITY, CLIP_SLACK, KEEP, clip, write_vertex
from obb_collision.queries.verdict.pair_frame import Box
from obb_collision.typing import Floats, Vector

#: A point is pulled into both boxes in turns, at most this often. Most lie there already; where
#: faces meet at a sharp angle the turns take too long.
PULL_ROUNDS = 8


@njit
def move_into_both(point: Vector, a: Box, b: Box, size: float) -> Vector:
    """Return a point of both boxes near another; size: that of the pair.

    Projections onto convex sets in turns (von Neumann; Bregman 1965) never take two points further
    apart, so that what moves a little still does. If that takes too long, the way leads straight
    towards a point that is known to be common.
    """
    for _ in range(PULL_ROUNDS):
        point, _ = pull(point, a)
        point, moved = pull(minus(point, b.center), b)
        point = plus(point, b.center)
        if moved <= KEEP * size:
            return point
    inner, found = middle(a, b, size)
    if not found:
        return point
    way = minus(point, inner)
    part = min(_part_inside(inner, way, a), _part_inside(minus(inner, b.center), way, b))
    return plus(inner, scaled(way, part))


@njit
def pull(point: Vector, box: Box) -> tuple[Vector, float]:
    """Return the nearest point of a box, and the largest step along an axis; from its centre."""
    along = components(box.axes, point)
    excess = minus(along, clamped(along, box.half_extents))
    return minus(point, combined(box.axes, excess)), max_abs(excess)


@njit
def _part_inside(point: Vector, way: Vector, box: Box) -> float:
    """Return how much of a way, 0 to 1, can be added to a point of a box and stay in it."""
    starts, steps = components(box.axes, point), components(box.axes, way)
    part = 1.0
    for i in range(3):
        start, step, extent = starts[i], steps[i], box.half_extents[i]
        room = extent - start if step > 0.0 else extent + start
        if abs(step) * part > room:
            part = max(room, 0.0) / abs(step)
    return part


@njit
def middle(a: Box, b: Box, size: float) -> tuple[Vector, bool]:
    """Return a point common to both boxes, well inside where there is room, and whether there is.

    The mean of the vertices of all faces of each box as far as they lie in the other: together
    these bound what is common.
    """
    polygon, spare = np.empty((CAPACITY, 3)), np.empty((CAPACITY, 3))
    d = b.center
    first, count = _sum_faces(a, b, size, polygon, spare)
    second, more = _sum_faces(b, Box(negated(d), a.axes, a.half_extents), size, polygon, spare)
    total = count + more
    if total == 0:
        return (0.0, 0.0, 0.0), False
    shift = more * (d[0] / size), more * (d[1] / size), more * (d[2] / size)
    x, y, z = scaled(plus(plus(first, second), shift), size)
    return (x / total, y / total, z / total), True


@njit
def _sum_faces(a: Box, b: Box, size: float, polygon: Floats, spare: Floats) -> tuple[Vector, int]:
    """Return the sum of the vertices of faces of b that lie in a, from a, and their number.

    b: with its centre relative to that of a. Faces are clipped in the frame of a, in units of size.
    """
    total, sums = 0, (0.0, 0.0, 0.0)
    for face in range(6):
        _lay_face(a, b, face, size, polygon)
        count = 4
        for i in range(3):
            limit = a.half_extents[i] / size + CLIP_SLACK
            count = clip(polygon, count, i, 1.0, limit, spare)
            count = clip(spare, count, i, -1.0, limit, polygon)
        for k in range(count):
            sums = plus(sums, combined(a.axes, vector_at(polygon, k)))
        total += count
    return sums, total


@njit
def _lay_face(a: Box, b: Box, face: int, size: float, polygon: Floats) -> None:
    """Write the corners (4, 3) of a face of b in the frame of a."""
    j, side = face // 2, 2.0 * (face % 2) - 1.0
    j1, j2 = (j + 1) % 3, (j + 2) % 3
    middle_of_face = plus(b.center, scaled(pick_axis(b.axes, j), side * pick(b.half_extents, j)))
    u, v = pick_axis(b.axes, j1), pick_axis(b.axes, j2)
    for corner in range(4):
        p = pick(b.half_extents, j1) * (1.0 if corner == 1 or corner == 2 else -1.0)
        q = pick(b.half_extents, j2) * (1.0 if corner >= 2 else -1.0)
        x, y, z = components(a.axes, plus(plus(middle_of_face, scaled(u, p)), scaled(v, q)))
        write_vertex(polygon, corner, (x / size, y / size, z / size))
