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

"""Error-free transformations and order-independent sums, in plain IEEE double arithmetic.

No fused multiply-add is used, so the results are the same with and without compilation and on
every processor. Sources: Shewchuk 1997; Cornea, Harrison, Tang 2002, analysed in Jeannerod 2015.
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
