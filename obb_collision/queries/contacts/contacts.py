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
chosen with a preference that noise can't turn. A point comes or goes where its depth is zero. What
does jump is the normal, where two axes that differ have the same depth, as it does by its meaning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.numerics.vec3 import max_abs, minus, plus, vector_at, write_at
from obb_collision.queries.contacts.blocks import (
    BLOCK,
    LIMIT,
    PLACE,
    QUAD,
    ROWS,
    SETTLED,
    SIZE,
    VERTEX,
    lay_faces,
    move_into_both,
    place_points,
    point_at,
)
from obb_collision.queries.contacts.patch import (
    CAPACITY,
    FEATURE_TIE,
    clip_to_rectangle,
    reduce_patch,
)
from obb_collision.queries.verdict.blocks import (
    AXES_A,
    AXES_B,
    EXTENTS_A,
    EXTENTS_B,
    LARGEST,
    NORMAL,
    NUMBER,
    OFFSET,
    axes_in,
    vector_in,
    witness_block,
    write_in,
)
from obb_collision.queries.verdict.pair_rows import as_pairs, one_set
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.queries.verdict.verdict import careful_bound
from obb_collision.typing import Floats, Integers, Vector
from obb_collision.words import shown

#: What ``Contacts.axes`` has for pairs that are no boxes.
NO_AXIS = -1
#: How many points a pair can be asked for.
LIMITS = (4, 8)

#: Pairs below which a second thread does not pay: 100 us or so.
FEWEST_CONTACTS = 200


#: The arrays of ``Contacts`` but for the pairs, for kernels.
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
        """All but the pairs, for kernels."""
        return tuple(vars(self).values())[1:]

    def __len__(self) -> int:
        return len(self.pairs)


def box_contacts(
    a: Boxes, b: Boxes, pairs: ArrayLike | None = None, *, max_points: int = 4
) -> Contacts:
    """Return the contacts of boxes, with at most 4 or 8 points each."""
    limit = as_max_points(max_points)
    given = as_pairs(a, b, pairs)
    boxes, rows = one_set(a, b, given)
    return replace(pair_contacts(boxes, rows, limit), pairs=given)


def as_max_points(value: int) -> int:
    """Return how many points a pair is asked for; ValueError for anything but ``LIMITS``."""
    if not isinstance(value, (int, np.integer)) or value not in LIMITS:
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
    block = np.zeros((ROWS, BLOCK))
    polygon, spare = np.empty((CAPACITY, 3)), np.empty((CAPACITY, 3))
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        witness_block(boxes, pairs, first, count, block)
        lay_faces(block, count)
        slots = 0
        for n in range(count):
            row = first + n
            gap = block[LARGEST, n]
            axes[row] = int(block[NUMBER, n])
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
    """Write the vertices of the patch of a pair into its slots, and return how many."""
    for k in range(4):
        write_at(polygon, k, vector_in(block, QUAD + 3 * k, n))
    count = clip_to_rectangle(polygon, 4, block[LIMIT, n], block[LIMIT + 1, n], spare)
    count = reduce_patch(polygon, count, limit, spare)
    for k in range(count):
        write_in(block, VERTEX + 3 * k, n, vector_at(polygon, k))
    return count


@njit
def _write_points(
    block: Floats, n: int, origin: Vector, out: ContactArrays, row: int, spare: Floats
) -> int:
    """Write a row of points and of their depths, and return how many."""
    _, _, counts, points, depths, _ = out
    size = block[SIZE, n]
    found = 0
    for k in range(counts[row]):
        point = vector_in(block, PLACE + 3 * k, n)
        if block[SETTLED + k, n] == 0.0:
            a = BoxAt((0.0, 0.0, 0.0), axes_in(block, AXES_A, n), vector_in(block, EXTENTS_A, n))
            d = vector_in(block, OFFSET, n)
            b = BoxAt(d, axes_in(block, AXES_B, n), vector_in(block, EXTENTS_B, n))
            point = move_into_both(point_at(block, VERTEX + 3 * k, n), a, b, size)
        # points that were pulled together count once
        for m in range(found):
            if max_abs(minus(point, vector_at(spare, m))) <= FEATURE_TIE * size:
                break
        else:
            write_at(spare, found, point)
            point = plus(origin, point)
            points[row, found, 0], points[row, found, 1], points[row, found, 2] = point
            depths[row, found] = max(0.0, -(block[VERTEX + 3 * k + 2, n] * size))
            found += 1
    for k in range(found, depths.shape[1]):
        points[row, k, 0] = points[row, k, 1] = points[row, k, 2] = np.nan
        depths[row, k] = np.nan
    return found
