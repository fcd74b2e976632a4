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

"""Two boxes in the frame of one, as tuples of numbers, and the way into that frame and back."""

from __future__ import annotations

import math
from typing import NamedTuple

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.numerics.vec3 import (
    axes_of,
    clamped,
    columns,
    combined,
    components,
    dot,
    minus,
    norm,
    plus,
    scaled,
    sum_abs,
    vector,
    vector_at,
)
from obb_collision.typing import Axes, Floats, Vector

#: Sizes between these powers of two are taken as they are: their squares are far from the ends.
SCALED_BELOW = 2.0**-300
SCALED_ABOVE = 2.0**300


class Box(NamedTuple):
    """One box in the world frame."""

    center: Vector
    axes: Axes
    half_extents: Vector


class Pair(NamedTuple):
    """Boxes a, b in the frame of a. A point of a is s, abs(s) <= h; of b d + r t, abs(t) <= f."""

    d: Vector  #: centre of b
    r: Axes  #: axes of b
    h: Vector  #: half extents of a
    f: Vector  #: half extents of b


@njit(refcount=False)
def box_at(boxes: BoxArrays, i: int) -> Box:
    """Return box i."""
    return Box(
        vector_at(boxes.centers, i), axes_of(boxes.rotations, i), vector_at(boxes.half_extents, i)
    )


@njit
def box_of(center: Floats, rotation: Floats, half_extents: Floats) -> Box:
    """Return the box of arrays (3,), (3, 3), (3,)."""
    return Box(vector(center), columns(rotation), vector(half_extents))


@njit
def pair_size(offset: Vector, h: Vector, f: Vector) -> float:
    """Return T: offset of the centres and half extents of both, summed."""
    return sum_abs(offset) + (h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2])


@njit
def in_frame(offset: Vector, a: Axes, h: Vector, b: Axes, f: Vector) -> Pair:
    """Return boxes with axes a and b in the frame of a; offset: of b from a."""
    r = components(a, b[0]), components(a, b[1]), components(a, b[2])
    return Pair(components(a, offset), r, h, f)


@njit
def pair_of(a: Box, b: Box) -> tuple[Pair, float]:
    """Return two boxes in the frame of a, and their size T."""
    offset = minus(b.center, a.center)
    pair = in_frame(offset, a.axes, a.half_extents, b.axes, b.half_extents)
    return pair, pair_size(offset, a.half_extents, b.half_extents)


@njit
def along_b(pair: Pair, v: Vector) -> Vector:
    """Return the components of a vector along the axes of b."""
    return components(pair.r, v)


@njit
def point_of_b(pair: Pair, t: Vector) -> Vector:
    """Return d + r t."""
    return plus(pair.d, combined(pair.r, t))


@njit
def closest_on_a(pair: Pair, t: Vector) -> Vector:
    """Return s of the point of a closest to that of b."""
    return clamped(point_of_b(pair, t), pair.h)


@njit
def closest_on_b(pair: Pair, s: Vector) -> Vector:
    """Return t of the point of b closest to that of a."""
    return clamped(along_b(pair, minus(s, pair.d)), pair.f)


@njit
def enter_frame(a: Box, b: Box) -> tuple[Pair, float, float]:
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
    a: Box, b: Box, s: Vector, t: Vector, n: Vector, scale: float
) -> tuple[float, Vector, Vector, Vector]:
    """Return the distance of the points, the points and the normal in the world frame."""
    s = combined(a.axes, clamped(scaled(s, 1.0 / scale), a.half_extents))
    t = combined(b.axes, clamped(scaled(t, 1.0 / scale), b.half_extents))
    n = combined(a.axes, n)
    n = scaled(n, 1.0 / math.sqrt(dot(n, n)))
    v = plus(minus(b.center, a.center), minus(t, s))
    return norm(v), plus(a.center, s), plus(b.center, t), n
