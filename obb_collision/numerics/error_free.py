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

"""Error-free transformations, order-independent sums, and numbers of twice the digits.

In plain IEEE double arithmetic: no fused multiply-add is used, so the results are the same with and
without compilation and on every processor. Sources: Shewchuk 1997; Cornea, Harrison, Tang 2002,
analysed in Jeannerod 2015.

A ``Pair`` is the unevaluated sum of two doubles, about 32 decimal digits. Products are off by less
than 8 u^2 of their size, sums by less than 4 u^2 of the sum of the sizes of both terms (u = 2^-53;
Joldes, Muller, Popescu 2017, "Tight and rigorous error bounds for basic building blocks of
double-word arithmetic", algorithms 5 and 11), barring under- and overflow.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.numerics.constants import SPLITTER


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

    However much cancels: the two products are taken without error, so nearly parallel axes stay
    well-conditioned and exactly parallel ones give exactly zero.
    """
    first, first_error = two_product(a, d)
    second, second_error = two_product(b, c)
    return (first - second) + (first_error - second_error)


@njit
def sum_sorted(a: float, b: float, c: float) -> float:
    """Return the sum of three numbers, the same bit for bit in whichever order they are given."""
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


Pair = tuple[float, float]
Vector = tuple[Pair, Pair, Pair]


@njit
def add(a: Pair, b: Pair) -> Pair:
    """Return a + b."""
    high = a[0] + b[0]
    low = two_sum_error(a[0], b[0]) + (a[1] + b[1])
    total = high + low
    return total, low - (total - high)


@njit
def subtract(a: Pair, b: Pair) -> Pair:
    """Return a - b."""
    return add(a, (-b[0], -b[1]))


@njit
def multiply(a: Pair, b: Pair) -> Pair:
    """Return a b."""
    high, low = two_product(a[0], b[0])
    low += a[0] * b[1] + a[1] * b[0]
    total = high + low
    return total, low - (total - high)


@njit
def as_pairs(v: tuple[float, float, float]) -> Vector:
    """Return a vector of doubles."""
    return (v[0], 0.0), (v[1], 0.0), (v[2], 0.0)


@njit
def subtract_vectors(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return subtract(a[0], b[0]), subtract(a[1], b[1]), subtract(a[2], b[2])


@njit
def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product."""
    return (
        subtract(multiply(a[1], b[2]), multiply(a[2], b[1])),
        subtract(multiply(a[2], b[0]), multiply(a[0], b[2])),
        subtract(multiply(a[0], b[1]), multiply(a[1], b[0])),
    )


@njit
def dot(a: Vector, b: Vector) -> Pair:
    """Return the scalar product."""
    return add(add(multiply(a[0], b[0]), multiply(a[1], b[1])), multiply(a[2], b[2]))


@njit
def largest(a: Vector) -> float:
    """Return the largest absolute component, rounded."""
    return max(abs(a[0][0]), abs(a[1][0]), abs(a[2][0]))
