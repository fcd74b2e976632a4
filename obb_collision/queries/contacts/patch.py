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

"""Contact patch of two overlapping boxes: the faces turned to each other, overlaid and reduced.

Seen along the normal, each box turns one face most to the other: the reference and the incident
face (Ericson 2005, 5.5; Gregorius, GDC 2013). Both are laid on the plane of the first along the
normal and clipped against each other (Sutherland, Hodgman 1974). At each vertex of the common
part the depth is the distance between the two faces along the normal. Vertices where the faces
have passed each other are the patch; the deepest of them has the depth of the pair. This holds for
all 15 axes: of two edges that cross, or a vertex in a face, only one vertex is left; of an edge
on a face two. No other case is needed, so none can flip into another: nearly equal axes have
nearly equal patches.

Vertices (s, t, w): place s, t on the face of a, from its centre along its two edges, and height w
of the face of b above it along the normal, all in units of the size of the pair: the sum of the
six half extents. Polygons are arrays (count, 3) of them. Tolerances are in units of the size, too.

``reduce_patch`` chooses the vertices that stand for it: those in contact, a few, always the same.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.typing import Floats

#: Rows of a polygon. A quad clipped by four lines has at most eight vertices; where rounding bends
#: a sliver, each line can add half as many again as there are.
POLYGON_ROWS = 24

#: Two features count as equal within this, and the first is taken: noise far below can't flip it.
FEATURE_TIE = 2.0**-24

#: Lines of clipping are moved out by this, more than rounding moves a vertex: boxes that touch at
#: a vertex or an edge keep it. Points are put back on the line.
CLIP_SLACK = 512 * ROUNDOFF

#: Faces that have not quite met at a vertex count as in contact there up to this distance, and
#: points may be outside of a box by as much: resting boxes keep their vertices.
IN_CONTACT = 2.0**-31


@njit
def clip_to_rectangle(
    polygon: Floats, count: int, limit_s: float, limit_t: float, spare: Floats
) -> int:
    """Clip to abs(s), abs(t) within the limits; return the number of vertices left."""
    for column in range(2):
        limit = limit_s if column == 0 else limit_t
        low, high = math.inf, -math.inf
        for k in range(count):
            low = min(low, polygon[k, column])
            high = max(high, polygon[k, column])
        above, below = high > limit + CLIP_SLACK, low < -limit - CLIP_SLACK
        if above:
            count = clip(polygon, count, column, 1.0, limit + CLIP_SLACK, spare)
        if above and below:
            count = clip(spare, count, column, -1.0, limit + CLIP_SLACK, polygon)
        elif below:
            count = clip(polygon, count, column, -1.0, limit + CLIP_SLACK, spare)
        if above != below:
            for k in range(count):
                copy_vertex(spare, k, polygon, k)
        if high > limit or low < -limit:
            for k in range(count):
                polygon[k, column] = min(max(polygon[k, column], -limit), limit)
    return count


@njit
def copy_vertex(source: Floats, k: int, target: Floats, m: int) -> None:
    """Copy row k of one array (n, 3) to row m of another; whole rows at once are slower."""
    target[m, 0] = source[k, 0]
    target[m, 1] = source[k, 1]
    target[m, 2] = source[k, 2]


@njit
def clip(polygon: Floats, count: int, column: int, sign: float, limit: float, out: Floats) -> int:
    """Write the part of the polygon with sign * column <= limit (Sutherland, Hodgman 1974)."""
    written = 0
    for k in range(count):
        following = k + 1 if k + 1 < count else 0
        here = sign * polygon[k, column] - limit
        there = sign * polygon[following, column] - limit
        if here <= 0.0:
            copy_vertex(polygon, k, out, written)
            written += 1
        if (here < 0.0 and there > 0.0) or (here > 0.0 and there < 0.0):
            ratio = here / (here - there)
            for c in range(3):
                out[written, c] = polygon[k, c] + ratio * (polygon[following, c] - polygon[k, c])
            out[written, column] = sign * limit
            written += 1
    return written


#: A vertex is left out where it changes the patch by less than this part of the shorter edge: where
#: two nearly parallel edges cross, a place that noise moves far along them.
SLIGHT_TURN = 1.0 / 8.0

#: Direction on the face, an angle of 1 rad, by which vertices of equal depth are ordered: far from
#: any multiple of 15 degrees, so that it has no ties where boxes were placed by hand.
ORDER_S = 0.5403023058681398
ORDER_T = 0.8414709848078965


@njit
def reduce_patch(polygon: Floats, count: int, limit: int, spare: Floats) -> int:
    """Keep the vertices in contact and of these at most ``limit``, the deepest first.

    The vertex that changes the polygon least is left out first. The change is its distance from the
    line between its neighbours (the Hausdorff distance of the two polygons). Vertices that change
    next to nothing are always left out. Nearly equal choices follow the order around the polygon
    from the deepest vertex, so that noise cannot change them.

    Where all vertices are equally deep, ``limit`` of them are chosen before those in contact: of
    boxes that only just touch, noise decides which are.
    """
    _start_at_deepest(polygon, count, math.inf, spare)
    count = _leave_out(polygon, count, limit if _is_level(polygon, count) else POLYGON_ROWS)
    if count > 0 and polygon[0, 2] > IN_CONTACT:
        _start_at_deepest(polygon, count, IN_CONTACT, spare)
    kept = min(count, 1)
    for k in range(1, count):
        if polygon[k, 2] <= IN_CONTACT:
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
    """Rotate the vertices so that the deepest is first; of equally deep ones see ORDER.

    A vertex above ``highest`` is not preferred to the deepest.
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

    Returns their number.
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
    if not any_turn and change <= SLIGHT_TURN * SLIGHT_TURN * shorter:
        return 0.0
    return change
