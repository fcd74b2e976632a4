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

"""Boxes that certainly contain points, or another box that is transformed.

A box holds exactly the points center + sum t_i h_i a_i with abs(t_i) <= 1, for the doubles as
stored. Its axes are orthonormal only to rounding, so the coordinates of a point p along them are
x = R^-1 (p - center), not R^T (p - center). They don't depend on the half extents, hence each
half extent is the largest abs(x_i), rounded up. Integers decide what rounding leaves open.

Also a box under any invertible 4 x 4 matrix. Rigid motions, uniform scales, scales along the box
axes and reflections give the box itself, up to the roundoff of its numbers. Under shear the
transformed box is a skewed one; the smallest of several boxes around it is taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.fitting.candidates import complete_frame
from obb_collision.geometry.validation import as_array, check_last_rows, orthonormal_defect
from obb_collision.numerics.constants import (
    FLAT,
    MAX_MAGNITUDE,
    ORTHONORMAL_ROUNDING,
    PRODUCT_UNDERFLOW,
    ROUNDOFF,
    VOLUME_TIE,
)
from obb_collision.numerics.exact import Exact, exact_axes, exact_cross, exact_dot, exact_integers
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

    Raises OverflowError beyond the largest double.
    """
    nearest = numerator / denominator  # correctly rounded, for integers of any size
    over, under = nearest.as_integer_ratio()
    if over * denominator < numerator * under:
        nearest = math.nextafter(nearest, math.inf)
    return nearest


@dataclass(frozen=True)
class ExactFrame:
    """R^-1 exactly: coordinate i of a vector v is (normals[i].v) * 2**power / determinant."""

    normals: tuple[Exact, Exact, Exact]
    determinant: int
    power: int

    @classmethod
    def of(cls, rotation: Floats) -> ExactFrame:
        """Return the frame of the stored columns of a rotation (3, 3)."""
        (x, y, z), power = exact_axes(rotation)
        normals = (exact_cross(y, z), exact_cross(z, x), exact_cross(x, y))
        return cls(normals, exact_dot(normals[0], x), power)

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
            size = math.ldexp(outer, exponent)
            if math.ldexp(size, -exponent) < outer:  # it is subnormal
                size = math.nextafter(size, math.inf)
            half_extents[axis] = size
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
    unit = 1 << 2 * power
    gram = [[exact_dot(a, b) for b in axes] for a in axes]
    defect = np.array(
        [[abs(gram[i][j] - unit * (i == j)) / unit for j in range(3)] for i in range(3)]
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
    return frame.lift(max(abs(exact_dot(frame.normals[axis], offset)) for offset in offsets), power)


#: Axes that changed by no more than this, the error of the product and its normalisation, have not
#: turned.
UNTURNED = 8 * ROUNDOFF

#: Edges orthonormal to this are those of a box: the matrix is a similarity, or scales along the
#: box axes. Any other frame saves less than this squared.
SQUARE = 2.0**-40


def transform_box(
    center: Floats, rotation: Floats, half_extents: Floats, matrix: ArrayLike
) -> tuple[Floats, Floats, Floats]:
    """Return (center, rotation, half_extents) of a box that contains the box moved by ``matrix``.

    center (3,), rotation (3, 3) orthonormal to rounding, half_extents (3,) >= 0 are trusted;
    ``matrix`` (4, 4) acts on columns. Containment is exact, for the exact products of these
    doubles: each half extent is the smallest double that suffices. Raises ValueError for a matrix
    with numbers that are not finite, a last row other than 0 0 0 1, or no inverse, and for
    results beyond 1e300.
    """
    moves = as_array(matrix, "matrix", (4, 4))
    check_last_rows(moves[None], "matrix")
    columns, _ = exact_axes(moves[:3, :3])
    if exact_dot(exact_cross(columns[0], columns[1]), columns[2]) == 0:
        raise ValueError("matrix must be invertible, its determinant is zero")
    frame = _choose_frame(moves[:3, :3], rotation, half_extents)
    try:
        return _enclose(center, rotation, half_extents, moves, frame)
    except OverflowError:
        raise ValueError(f"matrix moves the box beyond {MAX_MAGNITUDE:g}") from None


def _choose_frame(linear: Floats, rotation: Floats, half_extents: Floats) -> Floats:
    axes = _scaled(_scaled(linear) @ rotation)
    sides = _scaled(axes * _scaled(half_extents))
    best, smallest = rotation, np.inf
    for candidate in _candidates(axes, sides, rotation):
        extents = np.abs(candidate.T @ sides).sum(axis=1)
        size = float(np.prod(np.maximum(extents, FLAT * extents.max())))
        if size < smallest * (1.0 - VOLUME_TIE):
            best, smallest = candidate, size
    return best


def _scaled(array: Floats) -> Floats:
    """Return the array scaled by a power of two to a largest entry of about 1."""
    return np.ldexp(array, -int(np.frexp(np.abs(array).max())[1]))


def _candidates(axes: Floats, sides: Floats, rotation: Floats) -> Iterator[Floats]:
    """Yield frames for the skewed box whose edges are ``sides``, parallel to ``axes``."""
    longest = np.abs(axes).max(axis=0)
    if not longest.all():  # an axis is too short, beside the others, to be scaled with them
        return
    units = axes / longest
    units = units / np.sqrt((units * units).sum(axis=0))
    same, reversed_ = np.abs(units - rotation), np.abs(units + rotation)
    turned = np.minimum(same.max(axis=0), reversed_.max(axis=0))
    if (turned <= UNTURNED).all():
        yield rotation
    for exponent in (0, 1):  # a matrix that is rigid up to a power of two
        frame = np.ldexp(axes, exponent)
        if abs(orthonormal_defect(frame[None])[0]) <= ORTHONORMAL_ROUNDING:
            yield _right_handed(frame)
            break
    if abs(orthonormal_defect(units[None])[0]) <= SQUARE:
        yield complete_frame(units[:, 0], units[:, 1])
        return  # still a box: no other frame gives a smaller one
    for i, j, k in permutations(range(3)):  # a side of the box flush with a face and an edge
        turned_frame = np.empty((3, 3))
        turned_frame[:, [i, j, k]] = complete_frame(units[:, i], units[:, j])
        yield _right_handed(turned_frame)
    for k in range(3):  # flush with a face, and with the projection onto it of the edge across
        normal = np.cross(units[:, (k + 1) % 3], units[:, (k + 2) % 3])
        if normal.any():
            yield complete_frame(normal, units[:, k])
    spread, _, _ = np.linalg.svd(sides)
    yield complete_frame(spread[:, 0], spread[:, 1])


def _right_handed(frame: Floats) -> Floats:
    """Return axes (3, 3), in columns; the third is reversed where they are left-handed."""
    if np.linalg.det(frame) < 0.0:
        frame[:, 2] *= -1.0
    return frame + 0.0


def _enclose(
    center: Floats, rotation: Floats, half_extents: Floats, moves: Floats, frame: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the smallest box with the axes of ``frame`` around the moved box, by integers."""
    middle, middle_power = _moved_center(center, moves)
    new_center = np.array([x / (1 << middle_power) for x in middle])
    if np.abs(new_center).max() > MAX_MAGNITUDE:
        raise OverflowError
    stored, stored_power = exact_integers(new_center.tolist())
    sides, side_power = _moved_sides(rotation, half_extents, moves)

    power = max(middle_power, stored_power, side_power)
    x, y, z = (
        (m << power - middle_power) - (s << power - stored_power)
        for m, s in zip(middle, stored, strict=True)
    )
    exact = ExactFrame.of(frame)
    reach = np.empty(3)
    for i, normal in enumerate(exact.normals):
        across = sum(abs(exact_dot(normal, side)) for side in sides) << power - side_power
        reach[i] = exact.lift(across + abs(exact_dot(normal, (x, y, z))), power)
    if reach.max() > MAX_MAGNITUDE:
        raise OverflowError
    return new_center, frame, reach


def _moved_center(center: Floats, moves: Floats) -> tuple[list[int], int]:
    """Return the center moved by ``moves`` (4, 4), as integers times 2**-power, and the power."""
    entries, entry_power = exact_integers(moves[:3].ravel().tolist())
    point, point_power = exact_integers([*center.tolist(), 1.0])
    rows = (entries[4 * k : 4 * k + 4] for k in range(3))
    moved = [sum(a * b for a, b in zip(row, point, strict=True)) for row in rows]
    return moved, entry_power + point_power


def _moved_sides(rotation: Floats, half_extents: Floats, moves: Floats) -> tuple[list[Exact], int]:
    """Return half edges moved by ``moves`` (4, 4), as integers times 2**-power, and the power."""
    entries, entry_power = exact_integers(moves[:3, :3].ravel().tolist())
    axes, axis_power = exact_axes(rotation)
    lengths, length_power = exact_integers(half_extents.tolist())
    rows = [(entries[k], entries[k + 1], entries[k + 2]) for k in (0, 3, 6)]
    sides: list[Exact] = [
        (
            length * exact_dot(rows[0], axis),
            length * exact_dot(rows[1], axis),
            length * exact_dot(rows[2], axis),
        )
        for axis, length in zip(axes, lengths, strict=True)
    ]
    return sides, entry_power + axis_power + length_power
