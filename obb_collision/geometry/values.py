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

"""Base classes of values: arrays that nobody can write to, attributes that stay as they are."""

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
        names = self.__slots__ or [f.name for f in fields(self) if f.compare]  # type: ignore[arg-type]
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)

    __hash__ = None  # type: ignore[assignment]


def read_only_view(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of an array: what a kernel takes in one type, whoever made it."""
    view = array.view()
    view.flags.writeable = False
    return view


class ForKernels:
    """A frozen value with two sets of arrays: writable ones for kernels, read-only views for users.

    Kernels take those in ``arrays``, though nobody writes to them: numba would compile kernels once
    more for read-only arrays. A view is made when an attribute of its name is first read.
    """

    if not TYPE_CHECKING:  # types are those that a class declares

        def __getattr__(self, name: str) -> Any:
            """Return a view of an array, or raise AttributeError."""
            arrays = vars(self).get("arrays")
            if name not in getattr(arrays, "_fields", ()):
                return self.__getattribute__(name)
            view = vars(self)[name] = read_only_view(getattr(arrays, name))
            return view

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without views; unpickled views would be separate arrays."""
        return {
            name: value for name, value in vars(self).items() if not isinstance(value, np.ndarray)
        }


class SetOnce:
    """A value whose attributes can be set once, when it is made; its properties never."""

    def __setattr__(self, name: str, value: object) -> None:
        """Set a new attribute; AttributeError for an existing one."""
        if not name.startswith("_") and (name in vars(self) or hasattr(type(self), name)):
            raise AttributeError(f"{name} of a {type(self).__name__} can not be set")
        super().__setattr__(name, value)


class Changing:
    """An object that only its methods and properties change, as these validate.

    It can be pickled but not copied: the copy would share mutable parts with it.
    """

    def __setattr__(self, name: str, value: object) -> None:
        """Set a property; AttributeError, with a guess at the right name, for anything else."""
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
