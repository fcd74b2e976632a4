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

"""What values have in common: arrays that nobody can write to, attributes that stay as they are."""

from __future__ import annotations

from dataclasses import fields
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from obb_collision.words import shown


class ArrayValue:
    """A value made of arrays: equal where all numbers are; not hashable."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        names = self.__slots__ or [one.name for one in fields(self) if one.compare]  # type: ignore[arg-type]
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)

    __hash__ = None  # type: ignore[assignment]


def read_only_view(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array for everybody to read; kernels know one kind, which may be written to."""
    view = array.view()
    view.flags.writeable = False
    return view


class ForKernels:
    """A frozen value whose arrays are there twice: for kernels, and for all to read.

    Kernels have those in ``arrays``, to which nobody writes, but anybody could: numba would compile
    kernels once more for what is read-only. The others are views of them, made when asked for.
    """

    if not TYPE_CHECKING:  # types are those that a class declares

        def __getattr__(self, name: str) -> Any:
            """Return a view of one of the arrays, or raise AttributeError."""
            arrays = vars(self).get("arrays")
            if name not in getattr(arrays, "_fields", ()):
                return self.__getattribute__(name)
            view = vars(self)[name] = read_only_view(getattr(arrays, name))
            return view

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the views, which would be arrays of their own in another process."""
        return {
            name: value for name, value in vars(self).items() if not isinstance(value, np.ndarray)
        }


class SetOnce:
    """A value that keeps what it was made with; what is computed of it can't be set either."""

    def __setattr__(self, name: str, value: object) -> None:
        """Set what is not there yet; AttributeError for what is."""
        if not name.startswith("_") and (name in vars(self) or hasattr(type(self), name)):
            raise AttributeError(f"{name} of a {type(self).__name__} can not be set")
        super().__setattr__(name, value)


class Changing:
    """What changes by methods and properties, which validate, and by nothing else.

    It can be pickled but not copied: a copy would share what either of them changes.
    """

    def __setattr__(self, name: str, value: object) -> None:
        """Set a property; AttributeError, with a guess, for what can't be set."""
        kind = type(self)
        if not (name.startswith("_") or hasattr(kind, name)):
            settable = [key for key in dir(kind) if getattr(getattr(kind, key), "fset", None)]
            close = get_close_matches(name, settable, 1)
            hint = f"; did you mean {close[0]}?" if close else f"; it has {', '.join(settable)}"
            raise AttributeError(f"{kind.__name__} has no {shown(name)} to set{hint}")
        super().__setattr__(name, value)

    def __copy__(self) -> NoReturn:
        name = type(self).__name__
        raise TypeError(f"a {name} cannot be copied: create another, or pickle it")

    def __deepcopy__(self, memo: object) -> NoReturn:
        self.__copy__()
