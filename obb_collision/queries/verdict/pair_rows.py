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

"""Validation of pairs, by the convention ``f(a, b, pairs=None)`` of all questions about pairs."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import as_indices
from obb_collision.typing import Floats, Integers, Rows


class Sized(Protocol):
    """A sequence of rows."""

    def __len__(self) -> int: ...


class RowPairs(NamedTuple):
    """Pairs of bodies for kernels: body ``rows_a[n]`` of a with body ``rows_b[n]`` of b."""

    a: Any  #: arrays of bodies of one kind, as ``Boxes.arrays``
    rows_a: Rows
    b: Any
    rows_b: Rows


def as_pairs(a: Sized, b: Sized, pairs: ArrayLike | None) -> Integers:
    """Return pairs (m, 2) of rows of a and of b as contiguous int64, a copy; [] has no pairs.

    Raises ValueError naming ``pairs`` and the row unless all are whole numbers of rows; without
    pairs, if a and b differ in length.
    """
    if pairs is None:
        return np.repeat(_each_row(a, b), 2).reshape(-1, 2)
    array = as_indices(pairs, "pairs", "whole numbers of shape (m, 2)")
    if array.size == 0 and array.shape in ((0,), (0, 2)):
        return np.empty((0, 2), np.int64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"pairs must have shape (m, 2), got {array.shape}")
    if array.dtype.kind not in "iu":
        raise ValueError(f"pairs must be whole numbers, got {array.dtype}")
    wrong = ((array < 0) | (array >= (len(a), len(b)))).any(axis=1)
    if wrong.any():
        row, lengths = int(np.argmax(wrong)), f"{len(a)} and {len(b)}"
        raise ValueError(f"pairs must be rows of {lengths}, got {array[row].tolist()} in row {row}")
    return array.astype(np.int64, copy=False)


def as_sides(a: Sized, b: Sized, pairs: ArrayLike | None) -> tuple[Rows, Rows]:
    """Return the rows (m,) of a and of b, each contiguous."""
    if pairs is None:
        rows = _each_row(a, b)
        return rows, rows
    first, second = np.ascontiguousarray(as_pairs(a, b, pairs).T)
    return first, second


def _each_row(a: Sized, b: Sized) -> Rows:
    if len(a) != len(b):
        raise ValueError(
            f"a and b must have the same length, got {len(a)} and {len(b)}, or give pairs"
        )
    return np.arange(len(a))


def one_set(a: Boxes, b: Boxes, pairs: Integers) -> tuple[Boxes, Integers]:
    """Return boxes that contain both sets, and pairs (m, 2) as their rows; no copy if b is a."""
    if a is b:
        return a, pairs
    both = map(np.concatenate, zip(a.arrays, b.arrays, strict=True))
    return Boxes.trusted(*both), pairs + np.array([0, len(a)])


def as_each(value: ArrayLike, name: str, what: str, shape: tuple[int, ...]) -> Floats:
    """Return numbers broadcast to a shape, as a copy; ValueError if that is impossible.

    A copy, because read-only arrays would need kernels of their own.
    """
    try:
        return np.broadcast_to(np.asarray(value, np.float64), shape).copy()
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be {what}") from None
