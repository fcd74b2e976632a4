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

"""Minimum half extents with which a box of given axes certainly contains points.

A box holds exactly the points center + sum t_i h_i a_i with abs(t_i) <= 1, for the doubles as
stored. Its axes are orthonormal only to rounding, so the coordinates of a point p along them are
x = R^-1 (p - center), not R^T (p - center). They don't depend on the half extents, hence each
half extent is the largest abs(x_i), rounded up. Integers decide what rounding leaves open.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from obb_collision.numerics.constants import PRODUCT_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.exact import Vector, cross, dot, exact_axes, exact_integers
from obb_collision.typing import Floats

#: Rounding error of one coordinate R^T (p - center), relative to abs(R)^T abs(p - center): one
#: roundoff for the subtraction, three for the dot product (Higham, Accuracy and Stability, 3.1),
#: and one for the bound itself; twice that.
COORDINATE_BOUND = 10 * ROUNDOFF

#: Up to this many points near one face are settled by integers (about 5 us each); with more,
#: as on the finely meshed faces of a scan, the face moves out by the rounding bound instead.
EXACT_POINTS = 64


def round_up(numerator: int, denominator: int) -> float:
    """Return the smallest double that is not below numerator / denominator, both positive or 0 / n.

    Raises OverflowError where there is none.
    """
    nearest = numerator / denominator  # correctly rounded, for integers of any size
    over, under = nearest.as_integer_ratio()
    if over * denominator < numerator * under:
        nearest = math.nextafter(nearest, math.inf)
    return nearest


@dataclass(frozen=True)
class ExactFrame:
    """R^-1 exactly: coordinate i of a vector v is (normals[i].v) * 2**power / determinant."""

    normals: tuple[Vector, Vector, Vector]
    determinant: int
    power: int

    @classmethod
    def of(cls, rotation: Floats) -> ExactFrame:
        """Return the frame of the stored columns of a rotation (3, 3)."""
        (x, y, z), power = exact_axes(rotation)
        normals = (cross(y, z), cross(z, x), cross(x, y))
        return cls(normals, dot(normals[0], x), power)

    def reach(self, axis: int, vectors: Sequence[Vector], power: int) -> float:
        """Return the largest abs(coordinate) of vectors / 2**power, exactly rounded up."""
        normal = self.normals[axis]
        largest = max(abs(dot(normal, vector)) for vector in vectors)
        return self.lift(largest, power)

    def lift(self, product: int, power: int) -> float:
        """Return abs(normal.v) = product / 2**power as a coordinate, exactly rounded up."""
        return round_up(product << self.power, abs(self.determinant) << power)


def enclose_points(points: Floats, rotation: Floats) -> tuple[Floats, Floats]:
    """Return (center (3,), half_extents (3,)) of a box that certainly contains points (n, 3).

    rotation (3, 3): orthonormal to rounding. The half extents are the minimum for that centre,
    or, on axes where more than EXACT_POINTS points decide, within a few roundoffs of the size.
    """
    low = points.min(axis=0)
    start = low + 0.5 * (points.max(axis=0) - low)
    first, exponent = _scaled_offsets(points, start)
    along = first @ rotation
    middle = 0.5 * (along.min(axis=0) + along.max(axis=0))
    center: Floats = start + np.ldexp(rotation @ middle, exponent)

    offsets, exponent = _scaled_offsets(points, center)
    along = np.abs(offsets @ rotation, out=along)
    reach = along.max(axis=0)
    bound = _coordinate_bounds(rotation, np.abs(points - center).max(axis=0), reach, exponent)
    frame = ExactFrame.of(rotation)
    half_extents = np.empty(3)
    for axis in range(3):
        used = np.flatnonzero(frame.normals[axis])
        if len(used) == 1:  # a coordinate axis: the two extreme points decide, exactly
            column = points[:, used[0]]
            doubtful = np.array([column.argmin(), column.argmax()])
        else:
            doubtful = np.flatnonzero(along[:, axis] >= reach[axis] - 2.0 * bound[axis])
        if len(doubtful) <= EXACT_POINTS:
            half_extents[axis] = _exact_reach(points[doubtful], center, frame, axis)
        else:
            outer = math.nextafter(float(reach[axis] + bound[axis]), math.inf)
            half_extents[axis] = _unscale_up(outer, exponent)
    return center, half_extents


def _scaled_offsets(points: Floats, center: Floats) -> tuple[Floats, int]:
    """Return (points - center) * 2**-exponent, of size about 1, and the exponent."""
    offsets = points - center
    exponent = int(np.frexp(np.abs(offsets).max())[1])
    return np.ldexp(offsets, -exponent, out=offsets), exponent


def _coordinate_bounds(rotation: Floats, largest: Floats, reach: Floats, exponent: int) -> Floats:
    """Return (3,) rigorous bounds on abs(computed - exact coordinate), in scaled units.

    largest (3,): the largest abs(p - center) per component, unscaled; reach (3,): the largest
    computed coordinates. Zero on an axis exactly orthogonal to all offsets, so that flat sets in
    a plane z = const stay flat.
    """
    size = np.abs(rotation).T @ np.ldexp(largest, -exponent)
    rounding = COORDINATE_BOUND * size
    rounding += PRODUCT_UNDERFLOW * ((rotation != 0.0).T @ (largest > 0.0))
    # R^-1 = (I + E)^-1 R^T with E = R^T R - I, and abs((I + E)^-1 - I) <= sum of abs(E)^k,
    # which is below abs(E) + 2 abs(E)^2 for E this small. E itself is rounded: see the factor.
    axes, power = exact_axes(rotation)
    one = 1 << 2 * power
    gram = [[dot(a, b) for b in axes] for a in axes]
    defect = np.array(
        [[abs(gram[i][j] - one * (i == j)) / one for j in range(3)] for i in range(3)]
    )
    skew = defect + 2.0 * defect @ defect
    return rounding + (1.0 + 16.0 * ROUNDOFF) * (skew @ (reach + rounding))


def _exact_reach(points: Floats, center: Floats, frame: ExactFrame, axis: int) -> float:
    """Return the largest abs(coordinate) of points (n, 3) along one axis, exactly rounded up."""
    numbers, power = exact_integers([*center.tolist(), *points.ravel().tolist()])
    offsets = [
        (numbers[k] - numbers[0], numbers[k + 1] - numbers[1], numbers[k + 2] - numbers[2])
        for k in range(3, len(numbers), 3)
    ]
    return frame.reach(axis, offsets, power)


def _unscale_up(value: float, exponent: int) -> float:
    """Return value * 2**exponent, rounded up where the result is subnormal."""
    result = math.ldexp(value, exponent)
    if math.ldexp(result, -exponent) < value:
        result = math.nextafter(result, math.inf)
    return result
