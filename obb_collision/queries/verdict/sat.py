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

"""The 15 axes of two boxes, written once: every kernel that tries them takes them from here.

Two convex boxes are apart exactly when one of 15 axes separates them: the 3 + 3 face normals and
the 9 cross products of an edge of each (Gottschalk, Lin, Manocha 1996; Ericson 2005, 4.4.1). Their
numbers: 0 to 2 the faces of a, 3 to 5 those of b, 6 + 3 i + j edge i of a with edge j of b. Along
an axis n with centre offset d the gap is

    abs(n.d) - sum_i h_i abs(n.a_i) - sum_j f_j abs(n.b_j)

Two forms. In the frame of a (``BoxPair``) the dot products of the axes of both boxes give the
offset and the half lengths of the boxes along each axis, edge axes not divided by their length.
That is quick. In the world frame each axis is the cross product of two edges (``AXIS_EDGES``), face
normals too: for kernels that take the product without cancellation, for exact integers, and for
axes that move.

``best_face`` and ``best_edge`` find the axis with the largest gap by a quick calculation in the
frame of a: it orders the search, and each gap is a lower bound of the distance up to rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.numerics.constants import SHORT_SQUARE
from obb_collision.numerics.exact import sum_sorted
from obb_collision.numerics.vec3 import (
    ZERO,
    absolute,
    axes_of,
    clamped,
    columns,
    combined,
    components,
    cross,
    dot,
    dot_abs,
    minus,
    negated,
    norm,
    pick_axis,
    plus,
    replaced,
    scaled,
    sum_abs,
    vector,
    vector_at,
)
from obb_collision.typing import Axes, Floats, Vector

#: Sizes between these powers of two are taken as they are: their squares are far from the ends.
SCALED_BELOW = 2.0**-300
SCALED_ABOVE = 2.0**300


class BoxAt(NamedTuple):
    """A single box in the world frame."""

    center: Vector
    axes: Axes
    half_extents: Vector


class BoxPair(NamedTuple):
    """Boxes a, b in the frame of a. A point of a is s, abs(s) <= h; of b d + r t, abs(t) <= f."""

    d: Vector  #: centre of b
    r: Axes  #: axes of b
    h: Vector  #: half extents of a
    f: Vector  #: half extents of b


@njit(refcount=False)
def box_at(boxes: BoxArrays, i: int) -> BoxAt:
    """Return box i."""
    return BoxAt(
        vector_at(boxes.centers, i), axes_of(boxes.rotations, i), vector_at(boxes.half_extents, i)
    )


@njit
def box_of(center: Floats, rotation: Floats, half_extents: Floats) -> BoxAt:
    """Return the box of arrays (3,), (3, 3), (3,)."""
    return BoxAt(vector(center), columns(rotation), vector(half_extents))


@njit
def pair_size(offset: Vector, h: Vector, f: Vector) -> float:
    """Return T: offset of the centres and half extents of both, summed."""
    return sum_abs(offset) + (h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2])


@njit
def in_frame(offset: Vector, a: Axes, h: Vector, b: Axes, f: Vector) -> BoxPair:
    """Return boxes with axes a and b in the frame of a; offset: of b from a."""
    r = components(a, b[0]), components(a, b[1]), components(a, b[2])
    return BoxPair(components(a, offset), r, h, f)


@njit
def pair_of(a: BoxAt, b: BoxAt) -> tuple[BoxPair, float]:
    """Return two boxes in the frame of a, and their size T."""
    offset = minus(b.center, a.center)
    pair = in_frame(offset, a.axes, a.half_extents, b.axes, b.half_extents)
    return pair, pair_size(offset, a.half_extents, b.half_extents)


@njit
def along_b(pair: BoxPair, v: Vector) -> Vector:
    """Return the components of a vector along the axes of b."""
    return components(pair.r, v)


@njit
def point_of_b(pair: BoxPair, t: Vector) -> Vector:
    """Return the point d + r t of b, in the frame of a."""
    return plus(pair.d, combined(pair.r, t))


@njit
def closest_on_a(pair: BoxPair, t: Vector) -> Vector:
    """Return the point of a closest to the point t of b."""
    return clamped(point_of_b(pair, t), pair.h)


@njit
def closest_on_b(pair: BoxPair, s: Vector) -> Vector:
    """Return the point of b, in its frame, closest to the point s of a."""
    return clamped(along_b(pair, minus(s, pair.d)), pair.f)


@njit
def enter_frame(a: BoxAt, b: BoxAt) -> tuple[BoxPair, float, float]:
    """Return both boxes in the frame of a, scaled; their size T in it, and the scale."""
    d, h, f = minus(b.center, a.center), a.half_extents, b.half_extents
    size = pair_size(d, h, f)
    scale = 1.0
    if not SCALED_BELOW < size < SCALED_ABOVE and size != 0.0:
        scale = math.ldexp(1.0, min(max(-math.frexp(size)[1], -1022), 1022))
        d, h, f = scaled(d, scale), scaled(h, scale), scaled(f, scale)
    return in_frame(d, a.axes, h, b.axes, f), size * scale, scale


@njit
def leave_frame(
    a: BoxAt, b: BoxAt, s: Vector, t: Vector, n: Vector, scale: float
) -> tuple[float, Vector, Vector, Vector]:
    """Return the distance of the points, and points and normal in the world frame."""
    s = combined(a.axes, clamped(scaled(s, 1.0 / scale), a.half_extents))
    t = combined(b.axes, clamped(scaled(t, 1.0 / scale), b.half_extents))
    n = combined(a.axes, n)
    n = scaled(n, 1.0 / math.sqrt(dot(n, n)))
    v = plus(minus(b.center, a.center), minus(t, s))
    return norm(v), plus(a.center, s), plus(b.center, t), n


AXIS_COUNT = 15
#: Which two edges make each axis: 0 to 2 those of a, 3 to 5 those of b.
AXIS_EDGES = np.array(
    [
        (1, 2), (2, 0), (0, 1), (4, 5), (5, 3), (3, 4),
        (0, 3), (0, 4), (0, 5), (1, 3), (1, 4), (1, 5), (2, 3), (2, 4), (2, 5),
    ]
)  # fmt: skip


class EdgeAxes(NamedTuple):
    """An edge of b crossed with each edge of a: the boxes along these three axes."""

    offset: Vector  #: of the centres
    a: Vector  #: half the length of a
    b: Vector  #: half the length of b, from the first of its other two edges
    c: Vector  #: and from the second, apart because kernels differ in the order of the sum


@njit
def rows_of(axes: Axes) -> Axes:
    """Return the transposed axes: of a in the frame of b from those of b in the frame of a."""
    x, y, z = axes
    return (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])


@njit
def face_gap(offset: float, own: float, extents: Vector, n: Vector) -> float:
    """Return the gap along a face normal; own: extent across the face, n: in the other's frame."""
    return abs(offset) - (own + dot_abs(extents, n))


@njit
def face_gaps_of_a(pair: BoxPair) -> Vector:
    """Return the gaps along axes 0 to 2."""
    d, h, f = pair.d, pair.h, pair.f
    u, v, w = rows_of(pair.r)
    return face_gap(d[0], h[0], f, u), face_gap(d[1], h[1], f, v), face_gap(d[2], h[2], f, w)


@njit
def face_gaps_of_b(pair: BoxPair) -> Vector:
    """Return the gaps along axes 3 to 5."""
    (x, y, z), h, f = pair.r, pair.h, pair.f
    d = components(pair.r, pair.d)
    return face_gap(d[0], f[0], h, x), face_gap(d[1], f[1], h, y), face_gap(d[2], f[2], h, z)


@njit
def edge_axes(
    d: Vector, h: Vector, u: Vector, v: Vector, w: Vector, fv: float, fw: float
) -> EdgeAxes:
    """Return axes 6 + 3 i + j for all i; u: edge j of b, v, w: its other two of extents fv, fw."""
    half_a = (
        h[1] * abs(u[2]) + h[2] * abs(u[1]),
        h[0] * abs(u[2]) + h[2] * abs(u[0]),
        h[0] * abs(u[1]) + h[1] * abs(u[0]),
    )
    return EdgeAxes(cross(u, d), half_a, scaled(absolute(w), fv), scaled(absolute(v), fw))


@njit
def all_edge_axes(pair: BoxPair) -> tuple[EdgeAxes, EdgeAxes, EdgeAxes]:
    """Return the nine edge axes, edge by edge of b."""
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    return (
        edge_axes(d, h, x, y, z, f[1], f[2]),
        edge_axes(d, h, y, x, z, f[0], f[2]),
        edge_axes(d, h, z, x, y, f[0], f[1]),
    )


@njit
def reach_of(axes: EdgeAxes) -> Vector:
    """Return half the lengths of both boxes, summed."""
    return plus(plus(axes.a, axes.b), axes.c)


@njit
def edge_gaps(axes: EdgeAxes) -> Vector:
    """Return the gaps, not divided by the lengths of the axes."""
    return minus(absolute(axes.offset), reach_of(axes))


@njit
def edge_numbers(number: int) -> tuple[int, int]:
    """Return i, j of an edge axis, 6 + 3 i + j."""
    return AXIS_EDGES[number, 0], AXIS_EDGES[number, 1] - 3


@njit
def factors(a: Axes, b: Axes, number: int) -> tuple[Vector, Vector]:
    """Return the two edges whose cross product is an axis."""
    i, j = AXIS_EDGES[number, 0], AXIS_EDGES[number, 1]
    u = pick_axis(a, i) if i < 3 else pick_axis(b, i - 3)
    return u, pick_axis(a, j) if j < 3 else pick_axis(b, j - 3)


@njit
def projected_radius(n: Vector, axes: Axes, extents: Vector) -> float:
    """Return half the length of a box along n, the same for any order of its axes."""
    return sum_sorted(
        extents[0] * abs(dot(n, axes[0])),
        extents[1] * abs(dot(n, axes[1])),
        extents[2] * abs(dot(n, axes[2])),
    )


@njit
def unit_axis(pair: BoxPair, number: int) -> Vector:
    """Return the unit vector of an axis in the frame of a, from a to b; NaN of parallel edges."""
    if number < 3:
        n = replaced(ZERO, number, 1.0)
    elif number < 6:
        n = pick_axis(pair.r, number - 3)
    else:
        i, j = edge_numbers(number)
        u = pick_axis(pair.r, j)
        if i == 0:
            n = 0.0, -u[2], u[1]
        elif i == 1:
            n = u[2], 0.0, -u[0]
        else:
            n = -u[1], u[0], 0.0
        norm = math.sqrt(dot(n, n))
        if norm == 0.0:
            return math.nan, math.nan, math.nan
        n = n[0] / norm, n[1] / norm, n[2] / norm
    return negated(n) if dot(n, pair.d) < 0.0 else n


@njit
def gap_along(pair: BoxPair, n: Vector) -> float:
    """Return the gap along a unit vector from a to b: at most the distance."""
    return dot(n, pair.d) - dot_abs(pair.h, n) - dot_abs(pair.f, components(pair.r, n))


#: A gap and the number of its axis.
AxisGap = tuple[float, int]


@njit
def best_face(pair: BoxPair) -> AxisGap:
    """Return the largest gap along a face normal, and its number: 0 to 2 of a, 3 to 5 of b."""
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    u, v, w = rows_of(pair.r)
    p, q, r = components(pair.r, d)
    best = -math.inf, 0
    best = _larger(best, abs(d[0]) - h[0] - dot_abs(f, u), 0)
    best = _larger(best, abs(d[1]) - h[1] - dot_abs(f, v), 1)
    best = _larger(best, abs(d[2]) - h[2] - dot_abs(f, w), 2)
    best = _larger(best, abs(p) - f[0] - dot_abs(h, x), 3)
    best = _larger(best, abs(q) - f[1] - dot_abs(h, y), 4)
    return _larger(best, abs(r) - f[2] - dot_abs(h, z), 5)


@njit
def best_edge(pair: BoxPair, best: AxisGap) -> AxisGap:
    """Return the largest gap along a unit edge axis i, j, number 6 + 3 i + j; else ``best``.

    Only positive gaps count. A quick calculation: not certain among equals and among nearly
    parallel edges.
    """
    d, (x, y, z), h, f = pair.d, pair.r, pair.h, pair.f
    for j in range(3):
        axes = edge_axes(d, h, x, y, z, f[1], f[2])
        across, a, b, c = axes.offset, axes.a, axes.b, axes.c
        best = _larger(best, _edge_gap(across[0], a[0], b[0] + c[0], x[1], x[2]), 6 + j)
        best = _larger(best, _edge_gap(across[1], a[1], b[1] + c[1], x[2], x[0]), 9 + j)
        best = _larger(best, _edge_gap(across[2], a[2], b[2] + c[2], x[0], x[1]), 12 + j)
        x, y, z = y, z, x
        f = f[1], f[2], f[0]
    return best


@njit
def _edge_gap(offset: float, a: float, b: float, p: float, q: float) -> float:
    """Return the gap along a unit edge axis, whose components are p and q up to their signs.

    a, b: the reach of the boxes. -inf if the gap is not positive, or for nearly parallel edges.
    """
    gap = abs(offset) - a - b
    square = p * p + q * q
    if gap > 0.0 and square > SHORT_SQUARE:
        return gap / math.sqrt(square)
    return -math.inf


@njit
def _larger(best: AxisGap, gap: float, number: int) -> AxisGap:
    return (gap, number) if gap > best[0] else best
