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

"""Kernels that read numbers, texts and lists in the bytes of a message.

Plain little-endian CDR (OMG DDS-RTPS, 10.5). Every length and count is checked against what is left
of the message before it is used, in 64 bits, where none of them can wrap.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from obb_collision._jit import njit
from obb_collision.node.messages.marker_writer import ENCAPSULATION

ORIGIN = len(ENCAPSULATION)
"""Numbers are aligned to their size, counted from here."""
HALF = 1 << 31
"""Of the numbers that four bytes can be."""

Bytes = npt.NDArray[np.uint8]


@njit
def whole(data: Bytes, at: int) -> int:
    """Return the unsigned number of four bytes."""
    low = np.int64(data[at]) | (np.int64(data[at + 1]) << 8)
    high = np.int64(data[at + 2]) | (np.int64(data[at + 3]) << 8)
    return int(low | (high << 16))


@njit
def signed(data: Bytes, at: int) -> int:
    """Return the number of four bytes."""
    number = whole(data, at)
    return number - 2 * HALF if number >= HALF else number


@njit
def aligned(at: int, size: int) -> int:
    """Return the next place that is a multiple of ``size``, a power of two."""
    return at + ((ORIGIN - at) & (size - 1))


@njit
def text(data: Bytes, at: int) -> tuple[int, int, int]:
    """Return where a text begins, its length, and where it ends: -1 if it is none."""
    at = aligned(at, 4)
    if at + 4 > len(data):
        return 0, 0, -1
    size = whole(data, at)
    at += 4
    if size == 0:  # not by the standard, but some write it
        return at, 0, at
    if size > len(data) - at or data[at + size - 1] != 0:
        return 0, 0, -1
    return at, size - 1, at + size


@njit
def items(data: Bytes, at: int, item: int, alignment: int) -> tuple[int, int, int]:
    """Return where a list of items of some bytes begins, its length, and where it ends, or -1."""
    at = aligned(at, 4)
    if at + 4 > len(data):
        return 0, 0, -1
    count = whole(data, at)
    at += 4
    if count == 0:
        return at, 0, at
    at = aligned(at, alignment)
    if at > len(data) or count > (len(data) - at) // item:
        return 0, 0, -1
    return at, count, at + count * item


@njit
def equal(data: Bytes, a: int, b: int, size: int) -> bool:
    """Return whether the bytes from two places on are the same."""
    same = True
    for k in range(size):
        same &= data[a + k] == data[b + k]
    return same


@njit
def doubles(data: Bytes, at: int, bits: npt.NDArray[np.uint64]) -> None:
    """Copy the bits of numbers of eight bytes; the caller sees to it that they are there."""
    for k in range(len(bits)):
        value = np.uint64(0)
        for byte in range(8):
            value |= np.uint64(data[at + 8 * k + byte]) << np.uint64(8 * byte)
        bits[k] = value


@njit
def texts(data: Bytes, at: int, spans: npt.NDArray[np.int64]) -> tuple[int, int]:
    """Write where each text of a list begins and ends; return how many are sound, and their end."""
    for n in range(len(spans)):
        start, size, end = text(data, at)
        if end < 0:
            return n, at
        spans[n, 0], spans[n, 1] = start, start + size
        at = end
    return len(spans), at
