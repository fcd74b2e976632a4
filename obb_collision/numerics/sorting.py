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

"""Sorting whole numbers by their digits, which takes time in proportion to how many there are."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit

#: Bits of a digit: the counts of its values stay in the fastest memory.
DIGIT_BITS = 11
DIGITS = 1 << DIGIT_BITS
#: Up to this many are sorted by insertion: counting the values of digits takes longer.
FEW = 48


@njit
def bits_of(number: int) -> int:
    """Return how many bits a whole number takes, which is not negative."""
    bits = 0
    while number >> bits > 0:
        bits += 1
    return bits


@njit
def sort_numbers(numbers: np.ndarray, spare: np.ndarray, low: int, high: int) -> None:
    """Sort numbers (n,) int64, none negative, by their bits ``low`` to ``high`` - 1; stable.

    spare (n,) int64: room.
    """
    count = len(numbers)
    if count <= FEW:
        _insert(numbers, low)
        return
    passes = (high - low + DIGIT_BITS - 1) // DIGIT_BITS
    counts = np.zeros((passes, DIGITS), np.int64)
    for number in numbers:
        for k in range(passes):
            counts[k, (number >> (low + DIGIT_BITS * k)) & (DIGITS - 1)] += 1
    here, there = numbers, spare
    elsewhere = False
    for k in range(passes):
        shift = low + DIGIT_BITS * k
        places = counts[k]
        if places[(here[0] >> shift) & (DIGITS - 1)] == count:
            continue  # all have the same digit
        place = 0
        for digit in range(DIGITS):
            place, places[digit] = place + places[digit], place
        for number in here:
            digit = (number >> shift) & (DIGITS - 1)
            there[places[digit]] = number
            places[digit] += 1
        here, there = there, here
        elsewhere = not elsewhere
    for n in range(count if elsewhere else 0):  # an assignment of arrays takes a second to compile
        numbers[n] = here[n]


@njit
def _insert(numbers: np.ndarray, low: int) -> None:
    for n in range(1, len(numbers)):
        number = numbers[n]
        k = n
        while k > 0 and numbers[k - 1] >> low > number >> low:
            numbers[k] = numbers[k - 1]
            k -= 1
        numbers[k] = number
