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

"""Points of the difference of two bodies, and the part of their hull nearest to the origin.

As ``numerics.simplex`` (Ericson 2005, 5.1.5 and 5.1.6), with the points of both bodies that each
corner comes from. Plain floating point: distances are proved by planes.

``careful_nearest`` finds it with twice the digits, by trying all parts of the simplex.

For bodies nearly in touch and for needles, where ``simplex`` chooses the wrong part or a direction
that is mostly rounding. Corners are computed anew from the points of both bodies, whose doubles
count as exact, as does the pose between them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.exact import (
    Wide,
    WideVector,
    add,
    as_wide,
    multiply,
    subtract,
    subtract_vectors,
    wide_cross,
    wide_dot,
)
from obb_collision.numerics.vec3 import ZERO, max_abs, norm, scaled
from obb_collision.queries.meshes.placed import PairPose
from obb_collision.typing import Vector


class Corner(NamedTuple):
    """A point of the difference, w = p - q."""

    w: Vector  #: in the frame of a
    p: Vector  #: of a, in its frame
    q: Vector  #: of b, in its own


NO_CORNER = Corner(ZERO, ZERO, ZERO)
#: Sine of the angle below which two edges have no plane, even with twice the digits.
COLLINEAR_SINE = 2.0**-80


class WideNearest(NamedTuple):
    """The nearest point, and weights of four corners."""

    point: Vector
    weights: tuple[float, float, float, float]
    inside: bool  #: whether there are four corners, and the origin lies among them


@njit
def careful_nearest(
    a: Corner, b: Corner, c: Corner, d: Corner, count: int, pose: PairPose, unit: float
) -> WideNearest:
    """Return the nearest point of the first ``count`` corners; unit: a power of two, the scale."""
    corners = _wide(a, pose, unit), _wide(b, pose, unit), _wide(c, pose, unit), _wide(d, pose, unit)
    nearest, weights = corners[0], (1.0, 0.0, 0.0, 0.0)
    best = np.inf, 0.0
    for i in range(count):
        v = corners[i]
        square = wide_dot(v, v)
        if _less(square, best):
            best, nearest, weights = square, v, _weights(i, 1.0, i, 0.0, i, 0.0)
        for j in range(i + 1, count):
            sound, y, v = _on_line(corners[i], corners[j])
            square = wide_dot(v, v)
            if sound and _less(square, best):
                best, nearest, weights = square, v, _weights(i, 1.0 - y, j, y, j, 0.0)
            for k in range(j + 1, count):
                sound, y, z, v = _on_plane(corners[i], corners[j], corners[k])
                square = wide_dot(v, v)
                if sound and _less(square, best):
                    best, nearest = square, v
                    weights = _weights(i, 1.0 - y - z, j, y, k, z)
    inside = count == 4 and _holds_origin(corners[0], corners[1], corners[2], corners[3])
    return WideNearest((nearest[0][0], nearest[1][0], nearest[2][0]), weights, inside)


@njit
def _less(a: Wide, b: Wide) -> bool:
    """Return whether a < b, compared with all digits."""
    return a[0] < b[0] or (a[0] == b[0] and a[1] < b[1])


@njit
def _weights(
    i: int, x: float, j: int, y: float, k: int, z: float
) -> tuple[float, float, float, float]:
    """Return weights of four corners: x, y, z of corners i, j, k; of equal corners the first."""
    return (
        _weight(0, i, x, j, y, k, z),
        _weight(1, i, x, j, y, k, z),
        _weight(2, i, x, j, y, k, z),
        _weight(3, i, x, j, y, k, z),
    )


@njit
def _weight(row: int, i: int, x: float, j: int, y: float, k: int, z: float) -> float:
    return x if row == i else y if row == j else z if row == k else 0.0


@njit
def _wide(corner: Corner, pose: PairPose, unit: float) -> WideVector:
    """Return the corner, p - (axes q + offset) with q moved by the pose, times ``unit``."""
    x, y, z = pose.axes
    q = corner.q
    return (
        _component(corner.p[0], x[0], y[0], z[0], q, pose.offset[0], unit),
        _component(corner.p[1], x[1], y[1], z[1], q, pose.offset[1], unit),
        _component(corner.p[2], x[2], y[2], z[2], q, pose.offset[2], unit),
    )


@njit
def _component(
    p: float, x: float, y: float, z: float, q: Vector, offset: float, unit: float
) -> Wide:
    turned = wide_dot(as_wide((x, y, z)), as_wide((q[0] * unit, q[1] * unit, q[2] * unit)))
    return subtract(subtract((p * unit, 0.0), (offset * unit, 0.0)), turned)


@njit
def _divide(a: Wide, b: Wide) -> Wide:
    """Return a / b, to about 10 u^2."""
    first = a[0] / b[0]
    rest = subtract(a, multiply(b, (first, 0.0)))
    return add((first, 0.0), (rest[0] / b[0], 0.0))


@njit
def _scaled(v: WideVector, s: Wide) -> WideVector:
    return multiply(v[0], s), multiply(v[1], s), multiply(v[2], s)


@njit
def _on_line(a: WideVector, b: WideVector) -> tuple[bool, float, WideVector]:
    """Return whether the foot of the origin on a line lies between a and b, and where."""
    edge = subtract_vectors(b, a)
    length, along = wide_dot(edge, edge), wide_dot(edge, a)
    if not length[0] > 0.0:
        return False, 0.0, a
    y = _divide((-along[0], -along[1]), length)
    v = _scaled(edge, y)
    return 0.0 <= y[0] <= 1.0, y[0], (add(a[0], v[0]), add(a[1], v[1]), add(a[2], v[2]))


@njit
def _on_plane(a: WideVector, b: WideVector, c: WideVector) -> tuple[bool, float, float, WideVector]:
    """Return whether the foot of the origin on a plane lies in a triangle, and where."""
    u, v = subtract_vectors(b, a), subtract_vectors(c, a)
    normal = wide_cross(u, v)
    square = wide_dot(normal, normal)
    if not square[0] > 0.0:
        return False, 0.0, 0.0, a
    # by the triangles that the origin makes with the sides, seen along the normal
    y = _divide(wide_dot(normal, wide_cross(v, a)), square)[0]
    z = _divide(wide_dot(normal, wide_cross(a, u)), square)[0]
    sound = y >= 0.0 and z >= 0.0 and y + z <= 1.0
    return sound, y, z, _scaled(normal, _divide(wide_dot(normal, a), square))


@njit
def careful_plane(
    a: Corner, b: Corner, c: Corner, pose: PairPose, unit: float
) -> tuple[Vector, float]:
    """Return the unit normal of a triangle and the offset of its plane, infinite for a line."""
    corner = _wide(a, pose, unit)
    u = subtract_vectors(_wide(b, pose, unit), corner)
    v = subtract_vectors(_wide(c, pose, unit), corner)
    normal = wide_cross(u, v)
    n = normal[0][0], normal[1][0], normal[2][0]
    length = norm(n)
    if not length > COLLINEAR_SINE * math.sqrt(wide_dot(u, u)[0] * wide_dot(v, v)[0]):
        return (1.0, 0.0, 0.0), np.inf
    n = scaled(n, 1.0 / length)
    return n, wide_dot(as_wide(n), corner)[0]


@njit
def _holds_origin(a: WideVector, b: WideVector, c: WideVector, d: WideVector) -> bool:
    """Return whether the origin lies in a tetrahedron that is not flat."""
    volume = _side(a, b, c, d)
    if volume == 0.0:
        return False
    zero = as_wide(ZERO)
    return (
        _side(a, b, c, zero) * volume >= 0.0
        and _side(b, a, d, zero) * _side(b, a, d, c) >= 0.0
        and _side(c, b, d, zero) * _side(c, b, d, a) >= 0.0
        and _side(a, c, d, zero) * _side(a, c, d, b) >= 0.0
    )


@njit
def _side(a: WideVector, b: WideVector, c: WideVector, d: WideVector) -> float:
    """Return the sign of the side of the plane of a, b and c that d is on."""
    normal = wide_cross(subtract_vectors(b, a), subtract_vectors(c, a))
    value = wide_dot(normal, subtract_vectors(d, a))[0]
    return 1.0 if value > 0.0 else -1.0 if value < 0.0 else 0.0


@njit
def are_same(new: Corner, corner: Corner) -> bool:
    """Return whether two corners come from the same points."""
    return new.p == corner.p and new.q == corner.q


@njit
def is_zero(v: Vector) -> bool:
    """Return whether a vector is zero, or NaN."""
    return not max_abs(v) > 0.0
