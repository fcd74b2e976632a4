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

"""Points of contact patches of many pairs of boxes, a block of pairs at a time.

A point moved into two overlapping boxes: a at the origin, b with its centre at d.

Contact points lie halfway between two faces. Where the boxes overlap by more than the thickness of
one of them, or a face leans away below the other, that is outside; most often it is not.

As in ``verdict.blocks``, on the same blocks: two boxes and their witness in each column.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import (
    clamped,
    combined,
    components,
    dot,
    max_abs,
    minus,
    negated,
    pick,
    pick_axis,
    plus,
    scaled,
    vector_at,
    write_at,
)
from obb_collision.queries.contacts.patch import CAPACITY, CLIP_SLACK, FEATURE_TIE, KEEP, clip
from obb_collision.queries.verdict.blocks import (
    AXES_A,
    AXES_B,
    EXTENTS_A,
    EXTENTS_B,
    NORMAL,
    OFFSET,
    axes_in,
    vector_in,
    write_in,
)
from obb_collision.queries.verdict.sat import BoxAt, rows_of
from obb_collision.typing import Axes, Floats, Vector

#: A point is pulled into both boxes in turns, at most this often. Most lie there already; where
#: faces meet at a sharp angle the turns take too long.
PULL_ROUNDS = 8


@njit
def move_into_both(point: Vector, a: BoxAt, b: BoxAt, size: float) -> Vector:
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
def pull(point: Vector, box: BoxAt) -> tuple[Vector, float]:
    """Return the nearest point of a box, and the largest step along an axis; from its centre."""
    along = components(box.axes, point)
    excess = minus(along, clamped(along, box.half_extents))
    return minus(point, combined(box.axes, excess)), max_abs(excess)


@njit
def _part_inside(point: Vector, way: Vector, box: BoxAt) -> float:
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
def middle(a: BoxAt, b: BoxAt, size: float) -> tuple[Vector, bool]:
    """Return a point common to both boxes, well inside where there is room, and whether there is.

    The mean of the vertices of all faces of each box as far as they lie in the other: together
    these bound what is common.
    """
    polygon, spare = np.empty((CAPACITY, 3)), np.empty((CAPACITY, 3))
    d = b.center
    first, count = _sum_faces(a, b, size, polygon, spare)
    second, more = _sum_faces(b, BoxAt(negated(d), a.axes, a.half_extents), size, polygon, spare)
    total = count + more
    if total == 0:
        return (0.0, 0.0, 0.0), False
    shift = more * (d[0] / size), more * (d[1] / size), more * (d[2] / size)
    x, y, z = scaled(plus(plus(first, second), shift), size)
    return (x / total, y / total, z / total), True


@njit
def _sum_faces(
    a: BoxAt, b: BoxAt, size: float, polygon: Floats, spare: Floats
) -> tuple[Vector, int]:
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
def _lay_face(a: BoxAt, b: BoxAt, face: int, size: float, polygon: Floats) -> None:
    """Write the corners (4, 3) of a face of b in the frame of a."""
    j, side = face // 2, 2.0 * (face % 2) - 1.0
    j1, j2 = (j + 1) % 3, (j + 2) % 3
    middle_of_face = plus(b.center, scaled(pick_axis(b.axes, j), side * pick(b.half_extents, j)))
    u, v = pick_axis(b.axes, j1), pick_axis(b.axes, j2)
    for corner in range(4):
        p = pick(b.half_extents, j1) * (1.0 if corner == 1 or corner == 2 else -1.0)
        q = pick(b.half_extents, j2) * (1.0 if corner >= 2 else -1.0)
        x, y, z = components(a.axes, plus(plus(middle_of_face, scaled(u, p)), scaled(v, q)))
        write_at(polygon, corner, (x / size, y / size, z / size))


#: Pairs in a block: their numbers (29 kB) stay in the fastest memory.
BLOCK = 32
#: Most points of a pair.
SLOTS = 8
#: Least size of a pair, metres: its reciprocal must be finite. Below that a box counts as a point.
SMALLEST_PAIR = 1e-300

#: Rows of a block, once the witness is there: the incident face laid on the reference face, four
#: vertices; half extents of the reference face; the size of the pair; from the centre of a to that
#: of the face, and its two edges; vertices, points, and whether these are in both boxes, per slot.
QUAD, LIMIT, SIZE, ACROSS, EDGES, VERTEX = 27, 39, 41, 51, 54, 60
PLACE = VERTEX + 3 * SLOTS
SETTLED = PLACE + 3 * SLOTS
#: The same of the slot that is being worked on: rows whose places the compiler knows.
VERTEX_NOW = SETTLED + SLOTS
PLACE_NOW, SETTLED_NOW, ROWS = VERTEX_NOW + 3, VERTEX_NOW + 6, VERTEX_NOW + 7


@njit(inline=True)
def lay_faces(block: Floats, count: int) -> None:
    """Write the face of b that is turned to a as seen on the face of a that is turned to b.

    Vertices are s, t, w as in ``patch``.
    """
    for n in range(count):  # without a branch
        normal = vector_in(block, NORMAL, n)
        axes_a, axes_b = axes_in(block, AXES_A, n), axes_in(block, AXES_B, n)
        h, f = vector_in(block, EXTENTS_A, n), vector_in(block, EXTENTS_B, n)
        size = max((h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2]), SMALLEST_PAIR)
        across, u, v, h = _turned(normal, axes_a, h)
        across_b, u_b, v_b, f = _turned(normal, axes_b, f)
        up = dot(normal, across)
        up = up if up != 0.0 else 1.0  # without a normal: such pairs are apart
        side = h[0] if up >= 0.0 else -h[0]
        side_b = -f[0] if dot(normal, across_b) >= 0.0 else f[0]
        # s, t, w of a vector are its dot products with these three
        plane = (
            minus(u, scaled(across, dot(normal, u) / up)),
            minus(v, scaled(across, dot(normal, v) / up)),
            (across[0] / up, across[1] / up, across[2] / up),
        )
        middle = plus(vector_in(block, OFFSET, n), scaled(across_b, side_b))
        middle = components(plane, minus(middle, scaled(across, side)))
        edge1 = components(plane, scaled(u_b, f[1]))
        edge2 = components(plane, scaled(v_b, f[2]))
        scale = 1.0 / size
        left, right = minus(middle, edge1), plus(middle, edge1)
        write_in(block, QUAD, n, scaled(minus(left, edge2), scale))
        write_in(block, QUAD + 3, n, scaled(minus(right, edge2), scale))
        write_in(block, QUAD + 6, n, scaled(plus(right, edge2), scale))
        write_in(block, QUAD + 9, n, scaled(plus(left, edge2), scale))
        block[LIMIT, n], block[LIMIT + 1, n] = h[1] * scale, h[2] * scale
        block[SIZE, n] = size
        write_in(block, ACROSS, n, scaled(across, side))
        write_in(block, EDGES, n, u)
        write_in(block, EDGES + 3, n, v)


@njit(inline=True)
def _turned(normal: Vector, axes: Axes, extents: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """Return the three axes of a box and its extents, that first which is along the normal."""
    x, y, z = components(axes, normal)
    x, y, z = abs(x), abs(y), abs(z)
    enough = max(x, y, z) - FEATURE_TIE
    first, second = x >= enough, y >= enough
    p, q, r = rows_of(axes)
    p, q, r = _rolled(first, second, p), _rolled(first, second, q), _rolled(first, second, r)
    return (*rows_of((p, q, r)), _rolled(first, second, extents))


@njit(inline=True)
def _rolled(first: bool, second: bool, v: Vector) -> Vector:
    """Return v from its first component on, from its second or its third, round and round."""
    return (
        _chosen(first, second, v),
        _chosen(first, second, (v[1], v[2], v[0])),
        _chosen(first, second, (v[2], v[0], v[1])),
    )


@njit(inline=True)
def _chosen(first: bool, second: bool, v: Vector) -> float:
    """Return a component: one number at a time, for LLVM makes branches of more."""
    later = v[1] if second else v[2]
    return v[0] if first else later


@njit(inline=True)
def place_points(block: Floats, count: int, slot: int) -> None:
    """Write the points of a slot, halfway between the faces, moved into both boxes.

    In two rounds of ``move_into_both``, after which nearly all are settled.
    """
    for k in range(3):
        for n in range(count):
            block[VERTEX_NOW + k, n] = block[VERTEX + 3 * slot + k, n]
    _pull_points(block, count)
    for n in range(count):
        block[SETTLED + slot, n] = block[SETTLED_NOW, n]
    for k in range(3):
        for n in range(count):
            block[PLACE + 3 * slot + k, n] = block[PLACE_NOW + k, n]


@njit(inline=True)
def _pull_points(block: Floats, count: int) -> None:
    for n in range(count):  # without a branch
        a = BoxAt((0.0, 0.0, 0.0), axes_in(block, AXES_A, n), vector_in(block, EXTENTS_A, n))
        d = vector_in(block, OFFSET, n)
        b = BoxAt(d, axes_in(block, AXES_B, n), vector_in(block, EXTENTS_B, n))
        most = KEEP * block[SIZE, n]
        point, _ = pull(point_at(block, VERTEX_NOW, n), a)
        point, moved = pull(minus(point, d), b)
        first, settled = plus(point, d), moved <= most
        point, _ = pull(first, a)
        point, moved = pull(minus(point, d), b)
        second = plus(point, d)
        block[SETTLED_NOW, n] = 1.0 if settled or moved <= most else 0.0
        for k in range(3):
            block[PLACE_NOW + k, n] = first[k] if settled else second[k]


@njit(inline=True)
def point_at(block: Floats, vertex: int, n: int) -> Vector:
    """Return the point of a vertex halfway between the faces, from the centre of a."""
    s, t, w = scaled(vector_in(block, vertex, n), block[SIZE, n])
    u, v = vector_in(block, EDGES, n), vector_in(block, EDGES + 3, n)
    point = plus(plus(vector_in(block, ACROSS, n), scaled(u, s)), scaled(v, t))
    return plus(point, scaled(vector_in(block, NORMAL, n), 0.5 * w))
