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

"""Two boxes in the frame of one, as tuples of numbers: compiled, they live in registers.

Small arrays and loops over them cost five to ten times as much: kernels that spend their time on
one pair at a time are written with these.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import (
    axes_of,
    clamped,
    combined,
    components,
    dot,
    dot_abs,
    minus,
    norm,
    plus,
    scaled,
    vector_at,
)
from obb_collision.typing import Axes, Floats, Vector

#: Sizes between these powers of two are taken as they are: their squares are far from the ends.
SCALED_BELOW = 2.0**-300
SCALED_ABOVE = 2.0**300


class Pair(NamedTuple):
    """Boxes a, b in the frame of a. A point of a is s, abs(s) <= h; of b d + r t, abs(t) <= f."""

    d: Vector  #: centre of b
    r: Axes  #: axes of b
    h: Vector  #: half extents of a
    f: Vector  #: half extents of b


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
def gap_along(pair: Pair, n: Vector) -> float:
    """Return the gap along a unit vector from a to b: at most the distance."""
    return dot(n, pair.d) - dot_abs(pair.h, n) - dot_abs(pair.f, along_b(pair, n))


@njit
def enter_frame(
    centers: Floats, rotations: Floats, extents: Floats, i: int, j: int
) -> tuple[Pair, float, float]:
    """Return both boxes in the frame of i, scaled; their size in it, and the scale.

    The size is that of ``separation``: offset of the centres and half extents of both, summed.
    """
    d = minus(vector_at(centers, j), vector_at(centers, i))
    h, f = vector_at(extents, i), vector_at(extents, j)
    size = (abs(d[0]) + abs(d[1]) + abs(d[2])) + (h[0] + h[1] + h[2]) + (f[0] + f[1] + f[2])
    scale = 1.0
    if not SCALED_BELOW < size < SCALED_ABOVE and size != 0.0:
        scale = math.ldexp(1.0, min(max(-math.frexp(size)[1], -1022), 1022))
        d, h, f = scaled(d, scale), scaled(h, scale), scaled(f, scale)
    a, b = axes_of(rotations, i), axes_of(rotations, j)
    r = components(a, b[0]), components(a, b[1]), components(a, b[2])
    return Pair(components(a, d), r, h, f), size * scale, scale


@njit
def leave_frame(
    centers: Floats, rotations: Floats, extents: Floats, i: int, j: int,
    s: Vector, t: Vector, n: Vector, scale: float,
) -> tuple[float, Vector, Vector, Vector]:  # fmt: skip
    """Return the distance of the points, the points and the normal in the world frame."""
    a = axes_of(rotations, i)
    s = clamped(scaled(s, 1.0 / scale), vector_at(extents, i))
    t = clamped(scaled(t, 1.0 / scale), vector_at(extents, j))
    s, t, n = (combined(a, s), combined(axes_of(rotations, j), t), combined(a, n))
    n = scaled(n, 1.0 / math.sqrt(dot(n, n)))
    p, q = vector_at(centers, i), vector_at(centers, j)
    v = plus(minus(q, p), minus(t, s))
    return norm(v), plus(p, s), plus(q, t), n
