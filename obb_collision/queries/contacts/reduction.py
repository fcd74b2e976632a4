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

"""Which vertices of a contact patch stand for it: those in contact, a few, and always the same.

Polygons are arrays (count, 3) of vertices s, t, w in units of the size of the pair, see
``patch``.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.queries.contacts.patch import CAPACITY, FEATURE_TIE, KEEP, copy_vertex
from obb_collision.typing import Floats

#: A vertex is left out where it changes the patch by less than this part of the shorter edge: where
#: two nearly parallel edges cross, a place that noise moves far along them.
SLIGHT = 1.0 / 8.0

#: Direction on the face, an angle of 1 rad, by which vertices of equal depth are ordered: far from
#: any multiple of 15 degrees, so that it has no ties where boxes were placed by hand.
ORDER_S = 0.5403023058681398
ORDER_T = 0.8414709848078965


@njit
def reduce_patch(polygon: Floats, count: int, limit: int, spare: Floats) -> int:
    """Keep the vertices in contact and of these at most ``limit``, the deepest first.

    Whichever vertex changes the polygon least when left out goes first: the change is its distance
    from the line between its neighbours (the Hausdorff distance of the two polygons). Vertices that
    change next to nothing always go. Nearly equal choices are made by order around the polygon from
    the deepest vertex, not by noise.

    Where all vertices are equally deep, ``limit`` of them are chosen before looking which are in
    contact: of boxes that only just touch noise decides that.
    """
    _start_at_deepest(polygon, count, math.inf, spare)
    count = _leave_out(polygon, count, limit if _is_level(polygon, count) else CAPACITY)
    if count > 0 and polygon[0, 2] > KEEP:
        _start_at_deepest(polygon, count, KEEP, spare)
    kept = min(count, 1)
    for k in range(1, count):
        if polygon[k, 2] <= KEEP:
            copy_vertex(polygon, k, polygon, kept)
            kept += 1
    if kept == count and count <= limit:
        return count
    return _leave_out(polygon, kept, limit)


@njit
def _is_level(polygon: Floats, count: int) -> bool:
    lowest, highest = math.inf, -math.inf
    for k in range(count):
        lowest = min(lowest, polygon[k, 2])
        highest = max(highest, polygon[k, 2])
    return highest <= lowest + FEATURE_TIE


@njit
def _start_at_deepest(polygon: Floats, count: int, highest: float, spare: Floats) -> None:
    """Turn the order of vertices so that the deepest is first; of equally deep ones see ORDER.

    One above ``highest`` is not preferred to the deepest.
    """
    lowest = math.inf
    for k in range(count):
        lowest = min(lowest, polygon[k, 2])
    equal = max(lowest, min(lowest + FEATURE_TIE, highest))
    start, most = 0, -math.inf
    for k in range(count):
        place = ORDER_S * polygon[k, 0] + ORDER_T * polygon[k, 1]
        if polygon[k, 2] <= equal and place > most:
            start, most = k, place
    if start == 0:
        return
    for k in range(count):
        copy_vertex(polygon, k, spare, k)
    for k in range(count):
        copy_vertex(spare, start + k if start + k < count else start + k - count, polygon, k)


@njit
def _leave_out(polygon: Floats, count: int, limit: int) -> int:
    """Leave out vertices, never the first, until at most ``limit`` and no needless ones are left.

    Return how many there are.
    """
    while count > 1:
        least = math.inf
        for k in range(1, count):
            least = min(least, _square_change(polygon, count, k, count > limit))
        least = math.sqrt(least)
        if least > FEATURE_TIE and count <= limit:
            break
        k = 1
        while math.sqrt(_square_change(polygon, count, k, count > limit)) > least + FEATURE_TIE:
            k += 1
        for m in range(k, count - 1):
            copy_vertex(polygon, m + 1, polygon, m)
        count -= 1
    return count


@njit
def _square_change(polygon: Floats, count: int, k: int, any_turn: bool) -> float:
    """Return the squared distance of vertex k from the segment between its neighbours, on the face.

    Zero where the polygon turns only slightly, unless ``any_turn``.
    """
    before = k - 1 if k > 0 else count - 1
    after = k + 1 if k + 1 < count else 0
    s, t = polygon[k, 0] - polygon[before, 0], polygon[k, 1] - polygon[before, 1]
    p, q = polygon[after, 0] - polygon[k, 0], polygon[after, 1] - polygon[k, 1]
    shorter = min(s * s + t * t, p * p + q * q)
    u, v = s + p, t + q
    square = u * u + v * v
    if square > 0.0:
        ratio = min(max((s * u + t * v) / square, 0.0), 1.0)
        s -= ratio * u
        t -= ratio * v
    change = s * s + t * t
    if not any_turn and change <= SLIGHT * SLIGHT * shorter:
        return 0.0
    return change
