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

"""Contacts of colliding boxes: normal, depth, and a few points that stand for the patch.

The normal is the axis of least penetration of all 15, the depth how far to move along it until the
boxes only touch (``witness``). The points are vertices of the patch (``patch``), halfway
between the two faces, and lie in both boxes.

Small motions move the points a little: they are vertices of a polygon that moves with the boxes,
and noise cannot change which vertices are chosen. A point comes or goes where its depth is zero.
The normal jumps where two different axes have the same depth.

Points halfway between two faces are mostly in both boxes. Those outside, because the boxes overlap
by more than the thickness of one or a face leans away, are moved in. Pairs are computed in the
blocks of ``witness``, two boxes and their witness in each column.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.numerics.vec3 import (
    ZERO,
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
from obb_collision.queries.contacts.patch import (
    CLIP_SLACK,
    FEATURE_TIE,
    IN_CONTACT,
    POLYGON_ROWS,
    clip,
    clip_to_rectangle,
    reduce_patch,
)
from obb_collision.queries.verdict.pair_rows import as_pairs, one_set
from obb_collision.queries.verdict.sat import BoxAt, box_at, rows_of
from obb_collision.queries.verdict.verdict import careful_bound
from obb_collision.queries.verdict.witness import (
    AXES_A,
    AXES_B,
    AXIS_NUMBER,
    EXTENTS_A,
    EXTENTS_B,
    LARGEST_GAP,
    NORMAL,
    OFFSET,
    axes_in,
    vector_in,
    witness_block,
    write_in,
)
from obb_collision.typing import Axes, Floats, Integers, Vector
from obb_collision.words import shown

#: The value of ``Contacts.axes`` for pairs that are not boxes.
NO_AXIS = -1
#: Maximum numbers of points per pair that are accepted.
POINT_LIMITS = (4, 8)

#: Pairs below which a second thread does not pay: 100 us or so.
FEWEST_CONTACTS = 200


#: All arrays of ``Contacts`` except the pairs, for kernels.
ContactArrays = tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of m pairs (a, b); rows of pairs that are apart have count 0.

    pairs (m, 2): rows of a and b, in a report indices of objects.

    normals (m, 3): unit, from a to b; depths (m,): metres, not negative; counts (m,): points of
    each pair; positions (m, max_points, 3): metres, in both boxes, the deepest first, NaN past the
    count (of points equally deep to 2^-24 of the sum of the half extents always the same one,
    whatever rounding says); position_depths (m, max_points): how far the faces overlap at each
    point, along the normal, at most the depth of the pair, NaN past the count; axes (m,) int8:
    number of the axis, 0 to 2 a face of a, 3 to 5 a face of b, 6 + 3 i + j edge i of a against
    edge j of b.
    """

    pairs: Integers
    normals: Floats
    depths: Floats
    counts: Integers
    positions: Floats
    position_depths: Floats
    axes: NDArray[np.int8]

    @classmethod
    def blank(cls, pairs: Integers, max_points: int) -> Contacts:
        """Return room for pairs (m, 2) with at most ``max_points`` points each."""
        m = len(pairs)
        positions, position_depths = np.empty((m, max_points, 3)), np.empty((m, max_points))
        normals, depths, counts = np.empty((m, 3)), np.empty(m), np.empty(m, np.int64)
        axes = np.empty(m, np.int8)
        return cls(pairs, normals, depths, counts, positions, position_depths, axes)

    @property
    def arrays(self) -> ContactArrays:
        """All arrays except the pairs, for kernels."""
        return tuple(vars(self).values())[1:]

    def __len__(self) -> int:
        return len(self.pairs)


def box_contacts(
    a: Boxes, b: Boxes, pairs: ArrayLike | None = None, *, max_points: int = 4
) -> Contacts:
    """Return the contacts of boxes, with at most 4 or 8 points each."""
    limit = as_max_points(max_points)
    row_pairs = as_pairs(a, b, pairs)
    boxes, rows = one_set(a, b, row_pairs)
    return replace(pair_contacts(boxes, rows, limit), pairs=row_pairs)


def as_max_points(value: int) -> int:
    """Return the maximum number of points per pair; ValueError unless in ``POINT_LIMITS``."""
    if not isinstance(value, (int, np.integer)) or value not in POINT_LIMITS:
        raise ValueError(f"max_points must be 4 or 8, got {shown(value)}")
    return int(value)


def pair_contacts(boxes: Boxes, pairs: Integers, max_points: int) -> Contacts:
    """Return the contacts of pairs (m, 2) of rows of boxes."""
    result = Contacts.blank(pairs, max_points)
    run(contacts_kernel, len(pairs), FEWEST_CONTACTS, boxes.arrays, pairs, result.arrays)
    return result


@njit
def contacts_kernel(
    boxes: BoxArrays, pairs: np.ndarray, out: ContactArrays, start: int, stop: int
) -> None:
    """Write the contacts of pairs ``start`` to ``stop`` of (m, 2), as in ``Contacts``."""
    normals, depths, counts, _, position_depths, axes = out
    block = np.zeros((CONTACT_ROWS, CONTACT_BLOCK))
    polygon, spare = np.empty((POLYGON_ROWS, 3)), np.empty((POLYGON_ROWS, 3))
    for first in range(start, stop, CONTACT_BLOCK):
        count = min(CONTACT_BLOCK, stop - first)
        witness_block(boxes, pairs, first, count, block)
        lay_faces(block, count)
        slots = 0
        for n in range(count):
            row = first + n
            gap = block[LARGEST_GAP, n]
            axes[row] = int(block[AXIS_NUMBER, n])
            write_at(normals, row, vector_in(block, NORMAL, n))
            depths[row] = max(0.0, -gap)
            counts[row] = 0
            if gap > 0.0:
                a, b = box_at(boxes, pairs[row, 0]), box_at(boxes, pairs[row, 1])
                if gap > careful_bound(a, b):
                    continue
            counts[row] = _find_vertices(block, n, position_depths.shape[1], polygon, spare)
            slots = max(slots, counts[row])
        for slot in range(slots):
            place_points(block, count, slot)
        for n in range(count):
            origin = vector_at(boxes.centers, pairs[first + n, 0])
            counts[first + n] = _write_points(block, n, origin, out, first + n, spare)


@njit
def _find_vertices(block: Floats, n: int, limit: int, polygon: Floats, spare: Floats) -> int:
    """Write the vertices of the patch of a pair into its slots, and return their number."""
    for k in range(4):
        write_at(polygon, k, vector_in(block, FACE_QUAD + 3 * k, n))
    count = clip_to_rectangle(polygon, 4, block[FACE_LIMIT, n], block[FACE_LIMIT + 1, n], spare)
    count = reduce_patch(polygon, count, limit, spare)
    for k in range(count):
        write_in(block, SLOT_VERTEX + 3 * k, n, vector_at(polygon, k))
    return count


@njit
def _write_points(
    block: Floats, n: int, origin: Vector, out: ContactArrays, row: int, spare: Floats
) -> int:
    """Write a row of points and their depths, and return their number."""
    _, _, counts, points, depths, _ = out
    size = block[PAIR_SIZE, n]
    written = 0
    for k in range(counts[row]):
        point = vector_in(block, SLOT_POINT + 3 * k, n)
        if block[SLOT_SETTLED + k, n] == 0.0:
            a = BoxAt(ZERO, axes_in(block, AXES_A, n), vector_in(block, EXTENTS_A, n))
            d = vector_in(block, OFFSET, n)
            b = BoxAt(d, axes_in(block, AXES_B, n), vector_in(block, EXTENTS_B, n))
            point = move_into_both(point_at(block, SLOT_VERTEX + 3 * k, n), a, b, size)
        # points that were pulled together count once
        for m in range(written):
            if max_abs(minus(point, vector_at(spare, m))) <= FEATURE_TIE * size:
                break
        else:
            write_at(spare, written, point)
            point = plus(origin, point)
            points[row, written, 0], points[row, written, 1], points[row, written, 2] = point
            depths[row, written] = max(0.0, -(block[SLOT_VERTEX + 3 * k + 2, n] * size))
            written += 1
    for k in range(written, depths.shape[1]):
        points[row, k, 0] = points[row, k, 1] = points[row, k, 2] = np.nan
        depths[row, k] = np.nan
    return written


#: A point is pulled into both boxes in turns, at most this often. Most lie there already; where
#: faces meet at a sharp angle the turns take too long.
PULL_ROUNDS = 8


@njit
def move_into_both(point: Vector, a: BoxAt, b: BoxAt, size: float) -> Vector:
    """Return a point of both boxes near another; size: that of the pair.

    Alternating projections onto convex sets (von Neumann; Bregman 1965) never move two points
    further apart, so small motions stay small. If they take too long, the point moves straight
    towards a known common point.
    """
    for _ in range(PULL_ROUNDS):
        point, _ = pull(point, a)
        point, moved = pull(minus(point, b.center), b)
        point = plus(point, b.center)
        if moved <= IN_CONTACT * size:
            return point
    inner, exists = middle(a, b, size)
    if not exists:
        return point
    way = minus(point, inner)
    part = min(_part_inside(inner, way, a), _part_inside(minus(inner, b.center), way, b))
    return plus(inner, scaled(way, part))


@njit
def pull(point: Vector, box: BoxAt) -> tuple[Vector, float]:
    """Return the point of a box nearest to another, and the largest step; seen from its centre."""
    along = components(box.axes, point)
    excess = minus(along, clamped(along, box.half_extents))
    return minus(point, combined(box.axes, excess)), max_abs(excess)


@njit
def _part_inside(point: Vector, way: Vector, box: BoxAt) -> float:
    """Return which part of a way, 0 to 1, leads a point of a box no further than its surface."""
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
    """Return a point common to both boxes, inside where there is room, and whether there is one.

    It is the mean of the vertices of all faces of each box, clipped by the other: together these
    bound the common part.
    """
    polygon, spare = np.empty((POLYGON_ROWS, 3)), np.empty((POLYGON_ROWS, 3))
    d = b.center
    first, count = _sum_faces(a, b, size, polygon, spare)
    second, more = _sum_faces(b, BoxAt(negated(d), a.axes, a.half_extents), size, polygon, spare)
    total = count + more
    if total == 0:
        return ZERO, False
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
    total, sums = 0, ZERO
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
CONTACT_BLOCK = 32
#: Maximum number of points of a pair.
POINT_SLOTS = 8
#: Least size of a pair, metres: its reciprocal must be finite. Below that a box counts as a point.
SMALLEST_PAIR = 1e-300

#: Rows of a block, once the witness is there: the incident face laid on the reference face, four
#: vertices; half extents of the reference face; the size of the pair; from the centre of a to that
#: of the face, and its two edges; vertices, points, and whether these are in both boxes, per slot.
FACE_QUAD, FACE_LIMIT, PAIR_SIZE, FACE_CENTER, FACE_AXES, SLOT_VERTEX = 27, 39, 41, 51, 54, 60
SLOT_POINT = SLOT_VERTEX + 3 * POINT_SLOTS
SLOT_SETTLED = SLOT_POINT + 3 * POINT_SLOTS
#: The same rows of the current slot, at places that the compiler knows.
VERTEX_NOW = SLOT_SETTLED + POINT_SLOTS
PLACE_NOW, SETTLED_NOW, CONTACT_ROWS = VERTEX_NOW + 3, VERTEX_NOW + 6, VERTEX_NOW + 7


@njit(inline=True)
def lay_faces(block: Floats, count: int) -> None:
    """Write the face of b turned to a, on the face of a turned to b: s, t, w as in ``patch``."""
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
        write_in(block, FACE_QUAD, n, scaled(minus(left, edge2), scale))
        write_in(block, FACE_QUAD + 3, n, scaled(minus(right, edge2), scale))
        write_in(block, FACE_QUAD + 6, n, scaled(plus(right, edge2), scale))
        write_in(block, FACE_QUAD + 9, n, scaled(plus(left, edge2), scale))
        block[FACE_LIMIT, n], block[FACE_LIMIT + 1, n] = h[1] * scale, h[2] * scale
        block[PAIR_SIZE, n] = size
        write_in(block, FACE_CENTER, n, scaled(across, side))
        write_in(block, FACE_AXES, n, u)
        write_in(block, FACE_AXES + 3, n, v)


@njit(inline=True)
def _turned(normal: Vector, axes: Axes, extents: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """Return the axes and extents of a box, first the axis along the normal."""
    x, y, z = components(axes, normal)
    x, y, z = abs(x), abs(y), abs(z)
    enough = max(x, y, z) - FEATURE_TIE
    first, second = x >= enough, y >= enough
    p, q, r = rows_of(axes)
    p, q, r = _rolled(first, second, p), _rolled(first, second, q), _rolled(first, second, r)
    return (*rows_of((p, q, r)), _rolled(first, second, extents))


@njit(inline=True)
def _rolled(first: bool, second: bool, v: Vector) -> Vector:
    """Return v rotated to begin with its first, second or third component."""
    return (
        _chosen(first, second, v),
        _chosen(first, second, (v[1], v[2], v[0])),
        _chosen(first, second, (v[2], v[0], v[1])),
    )


@njit(inline=True)
def _chosen(first: bool, second: bool, v: Vector) -> float:
    """Return the first component chosen; one number at a time, because LLVM branches for more."""
    later = v[1] if second else v[2]
    return v[0] if first else later


@njit(inline=True)
def place_points(block: Floats, count: int, slot: int) -> None:
    """Write the points of a slot, halfway between the faces, moved into both boxes.

    Two rounds of ``move_into_both`` settle nearly all.
    """
    for k in range(3):
        for n in range(count):
            block[VERTEX_NOW + k, n] = block[SLOT_VERTEX + 3 * slot + k, n]
    _pull_points(block, count)
    for n in range(count):
        block[SLOT_SETTLED + slot, n] = block[SETTLED_NOW, n]
    for k in range(3):
        for n in range(count):
            block[SLOT_POINT + 3 * slot + k, n] = block[PLACE_NOW + k, n]


@njit(inline=True)
def _pull_points(block: Floats, count: int) -> None:
    for n in range(count):  # without a branch
        a = BoxAt(ZERO, axes_in(block, AXES_A, n), vector_in(block, EXTENTS_A, n))
        d = vector_in(block, OFFSET, n)
        b = BoxAt(d, axes_in(block, AXES_B, n), vector_in(block, EXTENTS_B, n))
        most = IN_CONTACT * block[PAIR_SIZE, n]
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
    s, t, w = scaled(vector_in(block, vertex, n), block[PAIR_SIZE, n])
    u, v = vector_in(block, FACE_AXES, n), vector_in(block, FACE_AXES + 3, n)
    point = plus(plus(vector_in(block, FACE_CENTER, n), scaled(u, s)), scaled(v, t))
    return plus(point, scaled(vector_in(block, NORMAL, n), 0.5 * w))
