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

"""The kernel that walks the bytes of a Detection3DArray and writes where everything is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from obb_collision._jit import njit
from obb_collision.node.messages.cdr_kernels import (
    Bytes,
    aligned,
    doubles,
    equal,
    text,
    whole,
)

RESULT = 44
"""Numbers of a result: a score, and a pose with its covariance."""
FRAME, ID, SAME_FRAME, INTEGERS = 0, 2, 4, 5
"""Columns of a detection: where texts begin and end, whether its frame is that of the one before;
and their number."""
FLOATS = 10
"""Position, quaternion x y z w and size."""


@njit
def _skip_results(data: Bytes, at: int) -> int:
    """Return where the results of a detection end, or -1."""
    at = aligned(at, 4)
    if at + 4 > len(data):
        return -1
    count = whole(data, at)
    at += 4
    if count > (len(data) - at) // (8 * RESULT):
        return -1
    for _ in range(count):
        _, _, at = text(data, at)  # class
        if at < 0:
            return -1
        at = aligned(at, 8) + 8 * RESULT
        if at > len(data):
            return -1
    return at


@njit
def scan_detections(
    data: Bytes, at: int, integers: npt.NDArray[np.int64], bits: npt.NDArray[np.uint64]
) -> tuple[int, int]:
    """Fill one row per detection; return how many are sound, and where the last of them ends."""
    for n in range(len(integers)):
        row = integers[n]
        frame, size, end = text(data, aligned(at, 4) + 8)  # behind a stamp
        if end >= 0:
            end = _skip_results(data, end)
        if end < 0:
            return n, at
        row[FRAME], row[FRAME + 1] = frame, frame + size
        end = aligned(end, 8)
        if end + 8 * FLOATS > len(data):
            return n, at
        doubles(data, end, bits[n])
        ident, length, end = text(data, end + 8 * FLOATS)
        if end < 0:
            return n, at
        row[ID], row[ID + 1] = ident, ident + length
        at = end
        if n > 0:
            last = integers[n - 1]
            same = size == last[FRAME + 1] - last[FRAME]
            row[SAME_FRAME] = same and equal(data, frame, last[FRAME], size)
    return len(integers), at
