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

"""Numba options of the project, in one place.

``njit`` is ``numba.njit`` with the options every kernel needs: strict IEEE arithmetic (no
fastmath: the error bounds of ``queries.verdict`` rely on it), the interpreter lock released,
and machine code cached on disk by ``_kernel_cache``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import numba
from numba.core import types as _types

from obb_collision._compiling import compiled as _  # noqa: F401  # from now on it is said
from obb_collision._kernel_cache import KernelCache
from obb_collision._overloads import Overloads, Pipeline, for_kernels

F = TypeVar("F", bound=Callable[..., Any])
types: Any = _types  # numba has no types

#: Of every kernel. No wrapper for callers in C, who do not exist: a tenth of all compiling.
OPTIONS = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": False,
    "no_cfunc_wrapper": True,
}

kernels: list[Any] = []
"""All kernels that have been defined so far; none where numba is disabled."""


def njit(function: F) -> F:
    """Compile a kernel with the options of the project (see the module's docstring)."""
    return _compiled(function)


def njit_inlined(function: F) -> F:
    """Compile a kernel as ``njit`` does, but into whatever calls it, however long it is.

    A loop over several numbers at once must not call anything.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: F, **options: bool) -> F:
    compiled: Any = numba.njit(**OPTIONS, **options, pipeline_class=Pipeline)(function)
    kernel: F = compiled
    if hasattr(compiled, "_cache"):  # not where numba is disabled
        compiled._cache = KernelCache(compiled)  # in place of numba's own
        Overloads(compiled)
        get = partial(_one_template, compiled, compiled.get_call_template)
        compiled.get_call_template = get
        kernels.append(kernel)
    return kernel


def njit_borrowing(function: F) -> F:
    """Compile a kernel as ``njit_inlined`` does, for one that makes no arrays.

    It does not count references to those it is given, which takes 5 ns for each it names: as much
    as a test of two spheres.
    """
    return _compiled(function, forceinline=True, _nrt=False)


def njit_reading(function: F) -> F:
    """Compile a kernel as ``njit_borrowing`` does, but into its callers only where LLVM likes to.

    For larger ones that are called in loops, and return no arrays.
    """
    return _compiled(function, _nrt=False)


def njit_each_number(function: F) -> F:
    """Compile a kernel as ``njit`` does, but apart for every number written out in a call.

    For those that are not inlined and index with it: they need not ask whether it is negative.
    """
    kernel = njit(function)
    vars(kernel).pop("get_call_template", None)
    return kernel


def _one_template(kernel: Any, get: Callable[..., Any], args: Any, kws: Any) -> Any:
    """Return what a kernel calls: one version for all numbers that are written out in calls.

    Numba compiles ``f(x, 0)``, ``f(x, 1)`` and ``f(x, n)`` apart, a quarter of all compiling;
    LLVM puts such numbers in where it inlines, so that nothing runs faster for it.
    """
    kinds = {name: types.unliteral(kind) for name, kind in kws.items()}
    with for_kernels(kernel):
        return get(tuple(map(types.unliteral, args)), kinds)


def unkept_kernels() -> list[str]:
    """Return the names of the kernels that the cache has for no kind of arguments."""
    return [kernel._cache.name for kernel in kernels if not kernel._cache.is_kept]
