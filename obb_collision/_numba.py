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

"""Parts of numba that it does not document, and what happens where a version lacks them.

Nothing else in the package uses any, but for ``numba.core.types``, ``config`` and ``cgutils``, with
which numba documents extensions. Where one is missing, kernels run as well: compiled by each
process anew, or some of them slower.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from types import FunctionType
from typing import Any

try:
    from numba.core.compiler import CompileResult
    from numba.core.options import DefaultOptions
    from numba.core.runtime import rtsys
    from numba.core.serialize import dumps
except ImportError:
    CompileResult = DefaultOptions = dumps = rtsys = None

UNDOCUMENTED = ("no_cfunc_wrapper", "no_cpython_wrapper", "forceinline", "_nrt")
#: Errors of parts that a version of numba lacks.
LACKING = AttributeError, TypeError, ValueError

Key = tuple[Any, Any]
"""Types of the arguments, and the processor."""


class Cache:
    """Through it numba loads and saves the machine code of a kernel.

    load: takes a key and a function that makes a kernel of saved bytes; returns None without them.
    save: takes a key and the bytes, None for a kernel that can't be saved.
    """

    cache_path = ""

    def __init__(
        self,
        load: Callable[[Key, Callable[[bytes], Any]], Any],
        save: Callable[[Key, bytes | None], None],
    ) -> None:
        self._load, self._save = load, save

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Load a compiled kernel, None where it is missing."""
        rtsys.initialize(target)  # all that loading needs; compiling loads the registries

        def rebuilt(content: bytes) -> Any:
            _, reduced = pickle.loads(content)
            return CompileResult._rebuild(target, *reduced)

        return self._load((signature, target.codegen().magic_tuple()), rebuilt)

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Save a compiled kernel."""
        key, content = (signature, compiled.codegen.magic_tuple()), None
        try:
            if not compiled.lifted and not compiled.library.has_dynamic_globals:
                content = dumps((key, compiled._reduce()))
        except LACKING:
            pass
        self._save(key, content)

    def enable(self) -> None:
        """Do nothing: the cache is always on."""

    disable = flush = enable


def keep(kernel: Any, cache: Cache) -> None:
    """Set the cache of a kernel; where numba lacks that, each process compiles its own."""
    if can_keep() and hasattr(kernel, "_cache"):
        kernel._cache = cache


def can_keep() -> bool:
    """Return whether this version of numba lets machine code be saved."""
    return hasattr(CompileResult, "_rebuild") and hasattr(CompileResult, "_reduce")


def supported(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a kernel that this version of numba has.

    Where missing, compiling takes a tenth longer, and kernels that make no arrays count references.
    """
    names = {name for name in options if name not in UNDOCUMENTED or hasattr(DefaultOptions, name)}
    return {name: value for name, value in options.items() if name in names}


def redirect_calls(kernel: Any, inner: Callable[[], Any], general: Callable[[Any], Any]) -> None:
    """Redirect calls from kernels to another kernel, with more general types of arguments.

    inner: returns the other kernel; called only when a kernel that calls it is compiled. Where
    numba lacks that, they call the kernel itself, compiled for each literal number.
    """
    if not (hasattr(kernel, "get_call_template") and hasattr(kernel, "get_overload")):
        return

    def template(args: Any, kws: Any) -> Any:
        kinds = {name: general(kind) for name, kind in kws.items()}
        return inner().get_call_template(tuple(map(general, args)), kinds)

    kernel.get_call_template = template
    kernel.get_overload = lambda signature: inner().get_overload(signature)


def function_of(called: Any) -> Any:
    """Return the Python function of a kernel, or of what writes LLVM's code; None for others."""
    if isinstance(called, FunctionType):
        return called
    if type(called).__module__.startswith("numba."):
        return getattr(called, "__wrapped__", getattr(called, "py_func", None))
    return None
