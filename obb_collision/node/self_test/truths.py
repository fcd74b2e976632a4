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

"""What is exactly so: rational arithmetic on the doubles that the kernels were given."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, product
from typing import Any

from obb_collision.geometry.boxes import Boxes
from obb_collision.numerics.exact import Vector, cross, dot, exact_axes, exact_integers
from obb_collision.typing import Floats


def overlap_squares(boxes: Boxes, a: int, b: int) -> list[Fraction]:
    """Return the squares of the overlaps of two boxes along all axes that can separate them.

    Those of boxes that are apart along an axis are negative, as its gap is.
    """
    (axes_a, power_a), (axes_b, power_b) = (exact_axes(boxes.rotations[row]) for row in (a, b))
    parts = boxes.centers[a], boxes.centers[b], boxes.half_extents[a], boxes.half_extents[b]
    numbers, power = exact_integers([number for part in parts for number in part.tolist()])
    offset = numbers[3] - numbers[0], numbers[4] - numbers[1], numbers[5] - numbers[2]
    edges = [
        *((axis, power_a, extent) for axis, extent in zip(axes_a, numbers[6:9], strict=True)),
        *((axis, power_b, extent) for axis, extent in zip(axes_b, numbers[9:], strict=True)),
    ]
    squares = []
    for axis in (*axes_a, *axes_b, *(cross(u, v) for u, v in product(axes_a, axes_b))):
        if axis == (0, 0, 0):
            continue
        reaches = (Fraction(h * abs(dot(axis, edge)), 1 << k) for edge, k, h in edges)
        reach = sum(reaches, Fraction(0))
        overlap = (reach - abs(dot(axis, offset))) / (1 << power)
        squares.append(abs(overlap) * overlap / dot(axis, axis))
    return squares


def reach_along(boxes: Boxes, a: int, b: int, normal: Floats) -> Fraction:
    """Return the square of the gap of two boxes along a normal, negative where they overlap."""
    (axes_a, power_a), (axes_b, power_b) = (exact_axes(boxes.rotations[row]) for row in (a, b))
    n = _fractions(normal)
    gap = _dot(n, _fractions(boxes.centers[b])) - _dot(n, _fractions(boxes.centers[a]))
    for row, axes, power in ((a, axes_a, power_a), (b, axes_b, power_b)):
        for axis, extent in zip(axes, boxes.half_extents[row].tolist(), strict=True):
            gap -= Fraction(extent) * abs(_dot(n, axis)) / (1 << power)
    return abs(gap) * gap / _dot(n, n)


def distance_square(p: Floats, q: Floats) -> Fraction:
    """Return the square of the distance of two points."""
    apart = [a - b for a, b in zip(_fractions(p), _fractions(q), strict=True)]
    square: Fraction = _dot(apart, apart)
    return square


def rotation_of(quaternion: Floats) -> list[Fraction]:
    """Return the nine entries, row by row, of the rotation that a quaternion x y z w means."""
    x, y, z, w = _fractions(quaternion)
    square = x * x + y * y + z * z + w * w
    entries = (
        *(w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )
    return [entry / square for entry in entries]


def bodies_collide(first: Floats, second: Floats) -> bool:
    """Return whether the convex hulls of two sets of points, tetrahedra for example, collide."""
    numbers, _ = exact_integers([*first.ravel().tolist(), *second.ravel().tolist()])
    points: list[Vector] = [
        (numbers[k], numbers[k + 1], numbers[k + 2]) for k in range(0, len(numbers), 3)
    ]
    bodies = points[: len(first)], points[len(first) :]
    edges = [[_minus(p, q) for p, q in combinations(body, 2)] for body in bodies]
    axes = [cross(u, v) for own in edges for u, v in combinations(own, 2)]
    axes += [cross(u, v) for u, v in product(*edges)]
    for axis in axes:
        low, high = ([dot(axis, point) for point in body] for body in bodies)
        if axis != (0, 0, 0) and (max(low) < min(high) or max(high) < min(low)):
            return False
    return True


def _minus(p: Vector, q: Vector) -> Vector:
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


def _fractions(values: Floats) -> list[Fraction]:
    return [Fraction(value) for value in values.tolist()]


def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
