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

"""Radix sort of whole numbers: time grows in proportion to their number."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision._threads import RANGES, ranges, run_parts, threads

#: Bits of a digit: the counts of its values stay in the fastest memory.
DIGIT_BITS = 11
DIGIT_VALUES = 1 << DIGIT_BITS
#: Up to this many are sorted by insertion: counting the values of digits takes longer.
FEW_NUMBERS = 48


@njit
def bits_of(number: int) -> int:
    """Return how many bits a whole number takes; it is not negative."""
    bits = 0
    while number >> bits > 0:
        bits += 1
    return bits


@njit
def sort_numbers(numbers: np.ndarray, spare: np.ndarray, low: int, high: int) -> None:
    """Sort numbers (n,) int64, not negative, by their bits ``low`` to ``high`` - 1; stable.

    spare (n,) int64: work space.
    """
    count = len(numbers)
    if count <= FEW_NUMBERS:
        _insert(numbers, low)
        return
    passes = (high - low + DIGIT_BITS - 1) // DIGIT_BITS
    counts = np.zeros((passes, DIGIT_VALUES), np.int64)
    for number in numbers:
        for k in range(passes):
            counts[k, (number >> (low + DIGIT_BITS * k)) & (DIGIT_VALUES - 1)] += 1
    here, there = numbers, spare
    elsewhere = False
    for k in range(passes):
        shift = low + DIGIT_BITS * k
        places = counts[k]
        if places[(here[0] >> shift) & (DIGIT_VALUES - 1)] == count:
            continue  # all have the same digit
        place = 0
        for digit in range(DIGIT_VALUES):
            place, places[digit] = place + places[digit], place
        for number in here:
            digit = (number >> shift) & (DIGIT_VALUES - 1)
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


#: Highest bits by which numbers are dealt to buckets, which must fit into fast memory.
BUCKET_BITS = 8
BUCKETS = 1 << BUCKET_BITS
#: Numbers below which a second thread does not pay: sorting them takes 500 us.
FEWEST_NUMBERS = 1 << 16


def is_dealt(count: int) -> bool:
    """Return whether numbers are dealt to buckets; with a single thread that saves no time."""
    return count >= 2 * FEWEST_NUMBERS


def deal(numbers: NDArray[np.int64], out: NDArray[np.int64], high: int) -> NDArray[np.int64]:
    """Write numbers (n,) of ``high`` bits to ``out`` (n,), ordered by their highest BUCKET_BITS.

    Stable. Returns where each bucket starts, and the end (BUCKETS + 1,).
    """
    shift = high - BUCKET_BITS
    parts = ranges(len(numbers), FEWEST_NUMBERS)
    counts = np.zeros((len(parts), BUCKETS), np.int64)
    _count_kernel(numbers, shift, counts[0], 0, 0)  # see ``_threads.run``
    run_parts(lambda k: _count_kernel(numbers, shift, counts[k], *parts[k]), len(parts))
    ends = counts.T.cumsum().reshape(BUCKETS, len(parts)).T
    places = ends - counts
    starts = np.append(places[0], len(numbers))
    _deal_kernel(numbers, out, shift, places[0], 0, 0)
    run_parts(lambda k: _deal_kernel(numbers, out, shift, places[k], *parts[k]), len(parts))
    return starts


def run_buckets(call: Callable[[int, int], None], starts: NDArray[np.int64]) -> None:
    """Call ``call`` with ranges of buckets, of about as many numbers each, by several threads."""
    call(0, 0)  # see ``_threads.run``
    shares = np.linspace(0, starts[-1], RANGES * threads() + 1)
    ends = np.searchsorted(starts[:-1], shares)
    ends[-1] = BUCKETS
    run_parts(lambda k: call(int(ends[k]), int(ends[k + 1])), len(ends) - 1)


@njit
def _count_kernel(
    numbers: np.ndarray, shift: int, counts: np.ndarray, start: int, stop: int
) -> None:
    for n in range(start, stop):
        counts[numbers[n] >> shift] += 1


@njit
def _deal_kernel(
    numbers: np.ndarray, out: np.ndarray, shift: int, places: np.ndarray, start: int, stop: int
) -> None:
    for n in range(start, stop):
        bucket = numbers[n] >> shift
        out[places[bucket]] = numbers[n]
        places[bucket] += 1
