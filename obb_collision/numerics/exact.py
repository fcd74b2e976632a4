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

"""Boxes in exact arithmetic: doubles are rational numbers, and Python's integers are exact.

Slow (tens of microseconds a box or point) and never wrong. Used where the certified kernels leave
a question open, and to widen boxes until they certainly contain what they must.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from obb_collision.typing import Floats

Vector = tuple[int, int, int]


def exact_integers(values: Iterable[float]) -> tuple[list[int], int]:
    """Return integers m and the least k >= 0 such that every value is exactly m / 2^k."""
    ratios = [float(value).as_integer_ratio() for value in values]
    power = max((denominator.bit_length() - 1 for _, denominator in ratios), default=0)
    return [top << (power - bottom.bit_length() + 1) for top, bottom in ratios], power


def exact_axes(rotation: Floats) -> tuple[tuple[Vector, Vector, Vector], int]:
    """Return the three columns of a (3, 3) matrix as integer vectors, and their power k."""
    entries, power = exact_integers(rotation.T.ravel().tolist())
    x, y, z = (_vector(entries[3 * i : 3 * i + 3]) for i in range(3))
    return (x, y, z), power


def _vector(entries: Sequence[int]) -> Vector:
    return entries[0], entries[1], entries[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def dot(a: Vector, b: Vector) -> int:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def contains_exactly(
    center: Floats, rotation: Floats, half_extents: Floats, points: Floats
) -> NDArray[np.bool_]:
    """Return (n,) whether each point (n, 3) lies in the closed box, decided exactly.

    A point p is c + sum t_i h_i a_i with abs(t_i) <= 1. With the face normal n_i = a_j x a_k that
    is abs(n_i.(p - c)) <= h_i abs(n_i.a_i) for the three i.
    """
    axes, axis_power = exact_axes(rotation)
    normals = (cross(axes[1], axes[2]), cross(axes[2], axes[0]), cross(axes[0], axes[1]))
    limits = [abs(dot(normal, axis)) for normal, axis in zip(normals, axes, strict=True)]
    inside = np.empty(len(points), np.bool_)
    for n, point in enumerate(points.tolist()):
        numbers, _ = exact_integers([*point, *center.tolist(), *half_extents.tolist()])
        offset = (numbers[0] - numbers[3], numbers[1] - numbers[4], numbers[2] - numbers[5])
        inside[n] = all(
            abs(dot(normals[i], offset)) << axis_power <= numbers[6 + i] * limits[i]
            for i in range(3)
        )
    return inside
