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

"""Arithmetic without rounding: error-free transformations, twice the digits, and exact integers.

Error-free transformations are in plain IEEE double arithmetic: no fused multiply-add is used, so
the results are the same with and without compilation and on every processor. Sources: Shewchuk
1997; Cornea, Harrison, Tang 2002, analysed in Jeannerod 2015.

A ``Wide`` is the unevaluated sum of two doubles, about 32 decimal digits. Products are off by less
than 8 u^2 of their size, sums by less than 4 u^2 of the sum of the sizes of both terms (u = 2^-53;
Joldes, Muller, Popescu 2017, "Tight and rigorous error bounds for basic building blocks of
double-word arithmetic", algorithms 5 and 11), barring under- and overflow.

Boxes in integers: doubles are rational numbers, and Python's integers are exact. Slow (tens of
microseconds a box or point) and never wrong. Used where the certified kernels leave a question
open, and to widen boxes until they certainly contain what they must.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.numerics.constants import SPLITTER
from obb_collision.typing import Floats, Vector


@njit
def two_sum_error(a: float, b: float) -> float:
    """Return the exact rounding error of fl(a + b), that is a + b - fl(a + b) (Knuth)."""
    total = a + b
    back = total - a
    return (a - (total - back)) + (b - back)


@njit
def two_product(a: float, b: float) -> tuple[float, float]:
    """Return fl(a * b) and its exact rounding error (barring underflow)."""
    product = a * b
    big = SPLITTER * a
    a_high = big - (big - a)
    a_low = a - a_high
    big = SPLITTER * b
    b_high = big - (big - b)
    b_low = b - b_high
    error = a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)
    return product, error


@njit
def determinant(a: float, b: float, c: float, d: float) -> float:
    """Return a * d - b * c with a relative error of about two units in the last place.

    Both products are taken without error. So nearly parallel axes stay well-conditioned, and
    exactly parallel ones give exactly zero.
    """
    first, first_error = two_product(a, d)
    second, second_error = two_product(b, c)
    return (first - second) + (first_error - second_error)


@njit
def sum_sorted(a: float, b: float, c: float) -> float:
    """Return the sum of three numbers, the same bit for bit in any order of them."""
    low = min(a, b)
    high = max(a, b)
    middle = min(max(low, c), high)
    return (min(low, c) + middle) + max(high, c)


@njit
def length(x: float, y: float, z: float) -> float:
    """Return the Euclidean length, without under- or overflow on the way."""
    largest = max(abs(x), abs(y), abs(z))
    if largest == 0.0:
        return 0.0
    x /= largest
    y /= largest
    z /= largest
    return largest * math.sqrt((x * x + y * y) + z * z)


Wide = tuple[float, float]
WideVector = tuple[Wide, Wide, Wide]


@njit
def add(a: Wide, b: Wide) -> Wide:
    """Return a + b."""
    high = a[0] + b[0]
    low = two_sum_error(a[0], b[0]) + (a[1] + b[1])
    total = high + low
    return total, low - (total - high)


@njit
def subtract(a: Wide, b: Wide) -> Wide:
    """Return a - b."""
    return add(a, (-b[0], -b[1]))


@njit
def multiply(a: Wide, b: Wide) -> Wide:
    """Return a b."""
    high, low = two_product(a[0], b[0])
    low += a[0] * b[1] + a[1] * b[0]
    total = high + low
    return total, low - (total - high)


@njit
def as_wide(v: tuple[float, float, float]) -> WideVector:
    """Return a vector of doubles with twice the digits."""
    return (v[0], 0.0), (v[1], 0.0), (v[2], 0.0)


@njit
def wide_difference(u: Vector, v: Vector) -> WideVector:
    """Return u - v of vectors of doubles, without error."""
    return (
        (u[0] - v[0], two_sum_error(u[0], -v[0])),
        (u[1] - v[1], two_sum_error(u[1], -v[1])),
        (u[2] - v[2], two_sum_error(u[2], -v[2])),
    )


@njit
def subtract_vectors(a: WideVector, b: WideVector) -> WideVector:
    """Return a - b."""
    return subtract(a[0], b[0]), subtract(a[1], b[1]), subtract(a[2], b[2])


@njit
def wide_cross(a: WideVector, b: WideVector) -> WideVector:
    """Return the cross product, with twice the digits."""
    return (
        subtract(multiply(a[1], b[2]), multiply(a[2], b[1])),
        subtract(multiply(a[2], b[0]), multiply(a[0], b[2])),
        subtract(multiply(a[0], b[1]), multiply(a[1], b[0])),
    )


@njit
def wide_dot(a: WideVector, b: WideVector) -> Wide:
    """Return the scalar product, with twice the digits."""
    return add(add(multiply(a[0], b[0]), multiply(a[1], b[1])), multiply(a[2], b[2]))


@njit
def largest(a: WideVector) -> float:
    """Return the largest absolute component, rounded."""
    return max(abs(a[0][0]), abs(a[1][0]), abs(a[2][0]))


Exact = tuple[int, int, int]


def exact_integers(values: Iterable[float]) -> tuple[list[int], int]:
    """Return integers m and the least k >= 0 such that every value is exactly m / 2^k."""
    ratios = [float(value).as_integer_ratio() for value in values]
    power = max((denominator.bit_length() - 1 for _, denominator in ratios), default=0)
    return [top << (power - bottom.bit_length() + 1) for top, bottom in ratios], power


def exact_axes(rotation: Floats) -> tuple[tuple[Exact, Exact, Exact], int]:
    """Return the columns of a (3, 3) matrix as integer vectors, and their power k (2^k = 1)."""
    entries, power = exact_integers(rotation.T.ravel().tolist())
    x, y, z = ((entries[k], entries[k + 1], entries[k + 2]) for k in (0, 3, 6))
    return (x, y, z), power


def exact_cross(a: Exact, b: Exact) -> Exact:
    """Return the cross product of integer vectors."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def exact_dot(a: Exact, b: Exact) -> int:
    """Return the scalar product of integer vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def contains_exactly(
    center: Floats, rotation: Floats, half_extents: Floats, points: Floats
) -> NDArray[np.bool_]:
    """Return (n,) whether each point (n, 3) lies in the closed box, decided exactly.

    A point p is c + sum t_i h_i a_i with abs(t_i) <= 1. With the face normal n_i = a_j x a_k that
    is abs(n_i.(p - c)) <= h_i abs(n_i.a_i) for the three i.
    """
    axes, axis_power = exact_axes(rotation)
    normals = [exact_cross(axes[(i + 1) % 3], axes[(i + 2) % 3]) for i in range(3)]
    limits = [abs(exact_dot(normal, axis)) for normal, axis in zip(normals, axes, strict=True)]
    inside = np.empty(len(points), np.bool_)
    for n, point in enumerate(points.tolist()):
        numbers, _ = exact_integers([*point, *center.tolist(), *half_extents.tolist()])
        offset = (numbers[0] - numbers[3], numbers[1] - numbers[4], numbers[2] - numbers[5])
        inside[n] = all(
            abs(exact_dot(normals[i], offset)) << axis_power <= numbers[6 + i] * limits[i]
            for i in range(3)
        )
    return inside
