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

"""Pairs of rows as they come from outside."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def as_pairs(value: ArrayLike, count: int) -> NDArray[np.int64]:
    """Return pairs (m, 2) of rows of ``count`` boxes as contiguous int64; [] is no pair.

    Raises ValueError naming ``pairs`` and the row for anything but whole numbers of a box.
    """
    try:
        array = np.asarray(value)
    except ValueError as error:  # ragged
        raise ValueError(f"pairs must have shape (m, 2): {error}") from None
    if array.size == 0 and array.shape in ((0,), (0, 2)):
        return np.empty((0, 2), np.int64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"pairs must have shape (m, 2), got {array.shape}")
    if not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"pairs must be whole numbers, got {array.dtype}")
    if array.min() < 0 or array.max() >= count:
        row = int(np.argmax(((array < 0) | (array >= count)).any(axis=1)))
        raise ValueError(f"pairs must be rows of the {count} boxes: not so in row {row}")
    return np.ascontiguousarray(array, np.int64)
