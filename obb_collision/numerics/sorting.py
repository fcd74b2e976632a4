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
def sort_by_keys(keys: np.ndarray, values: np.ndarray, bits: int) -> None:
    """Sort keys (n,) int64, from 0 to 2^bits - 1, and the values (n,) int64 with them; stable."""
    count = len(keys)
    if count <= FEW:
        _insert(keys, values)
        return
    passes = (bits + DIGIT_BITS - 1) // DIGIT_BITS
    counts = np.zeros((passes, DIGITS), np.int64)
    for n in range(count):
        for k in range(passes):
            counts[k, (keys[n] >> (DIGIT_BITS * k)) & (DIGITS - 1)] += 1
    keys_from, keys_to = keys, np.empty(count, np.int64)
    values_from, values_to = values, np.empty(count, np.int64)
    elsewhere = False
    for k in range(passes):
        shift = DIGIT_BITS * k
        places = counts[k]
        if places[(keys_from[0] >> shift) & (DIGITS - 1)] == count:
            continue  # all have the same digit
        place = 0
        for digit in range(DIGITS):
            place, places[digit] = place + places[digit], place
        for n in range(count):
            digit = (keys_from[n] >> shift) & (DIGITS - 1)
            keys_to[places[digit]], values_to[places[digit]] = keys_from[n], values_from[n]
            places[digit] += 1
        keys_from, keys_to = keys_to, keys_from
        values_from, values_to = values_to, values_from
        elsewhere = not elsewhere
    for n in range(count if elsewhere else 0):  # an assignment of arrays takes a second to compile
        keys[n], values[n] = keys_from[n], values_from[n]


@njit
def _insert(keys: np.ndarray, values: np.ndarray) -> None:
    for n in range(1, len(keys)):
        key, value = keys[n], values[n]
        k = n
        while k > 0 and keys[k - 1] > key:
            keys[k], values[k] = keys[k - 1], values[k - 1]
            k -= 1
        keys[k], values[k] = key, value
