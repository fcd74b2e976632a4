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

"""Vectors of fractions, doubles taken as exact numbers: nothing of the library."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import product
from math import isqrt
from typing import Any

import numpy as np

#: Three fractions, or three whole numbers.
Vector = Sequence[Any]
Point = tuple[Any, Any, Any]
#: Centre (3,), rotation (3, 3) and half extents (3,) as doubles.
Box = tuple[Any, Any, Any]


def exact(values: Iterable[float]) -> Point:
    """Return three doubles as fractions."""
    x, y, z = (Fraction(float(value)) for value in values)
    return x, y, z


def dot(a: Vector, b: Vector) -> Any:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a: Vector, b: Vector) -> Point:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def along(a: Vector, time: Any, way: Vector) -> Point:
    """Return a + time * way."""
    return a[0] + time * way[0], a[1] + time * way[1], a[2] + time * way[2]


def cross(a: Vector, b: Vector) -> Point:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def determinant(a: Vector, b: Vector, c: Vector) -> Any:
    """Return the determinant of the matrix with columns a, b, c."""
    return dot(a, cross(b, c))


def root(square: Fraction) -> Fraction:
    """Return the square root to more than 100 bits."""
    if square == 0:
        return Fraction(0)
    bits = square.numerator.bit_length() - square.denominator.bit_length()
    half = max(0, 110 - bits // 2)
    return Fraction(isqrt((square.numerator << 2 * half) // square.denominator), 2**half)


def norm(a: Vector) -> Fraction:
    """Return the Euclidean length."""
    return root(dot(a, a))


def taxicab(a: Vector) -> Any:
    """Return the sum of the magnitudes."""
    return abs(a[0]) + abs(a[1]) + abs(a[2])


def moved(points: Iterable[Vector], center: Any, rotation: Any) -> list[Point]:
    """Return center + rotation p, for points p of fractions."""
    rows, offset = [exact(row) for row in rotation], exact(center)
    return [along(offset, 1, [dot(row, p) for row in rows]) for p in points]


def whole(values: Any) -> tuple[Any, int]:
    """Return doubles as integers of any size (an array), and the exponent of two of their unit."""
    mantissas, exponents = np.frexp(values)
    exponents = np.where(mantissas == 0.0, 0, exponents - 53)
    least = int(exponents.min(initial=0))
    integers = (mantissas * 2.0**53).astype(np.int64).astype(object)
    return integers << (exponents - least).astype(object), least


def corners(box: Box) -> list[Point]:
    """Return the eight corners of a box."""
    center, rotation, half = box
    edges = [[h * x for x in exact(a)] for h, a in zip(exact(half), rotation.T, strict=True)]
    found = [exact(center)]
    for edge in edges:
        found = [along(c, sign, edge) for c, sign in product(found, (-1, 1))]
    return found
