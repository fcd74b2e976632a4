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

"""Type checks of arguments that are not arrays. Errors name the argument."""

from __future__ import annotations

from typing import Any, NoReturn, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from obb_collision.words import shown


class ArrayValue:
    """A value made of arrays: equal where all numbers are; not hashable, as arrays are mutable."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        names = self.__slots__ or vars(self)
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)

    __hash__ = None  # type: ignore[assignment]


class NotCopied:
    """What can be neither copied nor pickled: a copy would share what either of them changes."""

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        """Raise TypeError for copy.copy, copy.deepcopy and pickle."""
        name = type(self).__name__
        raise TypeError(f"a {name} can be neither copied nor pickled: make another one")


def check_kind(value: Any, kind: Any, name: str, *others: type) -> None:
    """Raise TypeError naming the argument unless a value is an instance of one of the types."""
    if not isinstance(value, (kind, *others)):
        kinds = " or ".join(one.__name__ for one in (kind, *others))
        raise TypeError(f"{name} must be {kinds}, got {shown(value)}")


def as_flag(value: object, name: str) -> bool:
    """Return True or False; TypeError naming the argument for anything else."""
    check_kind(value, bool, name, np.bool_)
    return bool(value)


def select_rows(array: NDArray[Any], rows: Any, name: str, dimensions: int) -> NDArray[Any]:
    """Return the rows that an index array, a mask or a single index selects.

    dimensions: of the result. Raises ValueError naming the argument otherwise.
    """
    try:
        found: NDArray[Any] = array[rows]
    except (IndexError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} must be rows of {len(array)}: {error}") from None
    if not isinstance(found, np.ndarray) or found.ndim != dimensions:
        raise ValueError(f"{name} must be rows of {len(array)}, got {shown(rows)}")
    return found
