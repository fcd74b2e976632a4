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

"""References to arrays in kernels: what counts them takes none from what does not.

A kernel that counts references frees an array that a kernel without returns to it, as if it were
its own: the heap is corrupted, and nothing says so.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
import typing
from collections.abc import Callable
from typing import Any

import obb_collision
from obb_collision import _jit
from obb_collision._numba import function_of

ARRAYS = re.compile(r"Floats|Integers|Rows|Mask|Radii|NDArray")
OTHERS = ("obb_collision.node", "obb_collision.demo", "obb_collision.benchmarks")


def load_all() -> None:
    """Import every module of the library, so that all kernels are defined."""
    for module in pkgutil.walk_packages(obb_collision.__path__, "obb_collision."):
        if not module.name.startswith(OTHERS) and not module.name.endswith("__main__"):
            importlib.import_module(module.name)


def holds_arrays(kind: Any) -> bool:
    """Return whether a type, a tuple or NamedTuple with all that is in it, holds arrays."""
    fields = getattr(kind, "__annotations__", {}) if hasattr(kind, "_fields") else {}
    if any(ARRAYS.search(str(field)) for field in fields.values()):
        return True
    within = typing.get_type_hints(kind).values() if fields else typing.get_args(kind)
    return "ndarray" in str(kind) or any(map(holds_arrays, within))


def returns_arrays(function: Callable[..., Any]) -> bool:
    """Return whether a function is declared to return arrays."""
    return holds_arrays(typing.get_type_hints(function)["return"])


def test_what_counts_references_takes_no_arrays_from_what_does_not() -> None:
    load_all()
    counts = {kernel: "_nrt" not in kernel.targetoptions for kernel in _jit.kernels}
    lends = {k for k in counts if not counts[k] and returns_arrays(function_of(k))}
    assert {function_of(kernel).__name__ for kernel in lends} >= {"borrowed_core"}
    wrong = [
        (function.__name__, function_of(kernel).__name__)
        for function in (function_of(kernel) for kernel in counts if counts[kernel])
        for kernel in lends
        if any(function.__globals__.get(name) is kernel for name in function.__code__.co_names)
    ]
    assert not wrong
