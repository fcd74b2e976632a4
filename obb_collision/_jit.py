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

import functools
from collections.abc import Callable
from typing import Any, TypeVar, overload

import numba
from numba import config, types
from numba.experimental import structref
from numba.extending import overload as overload_function

from obb_collision._kernel_cache import KernelCache
from obb_collision._numba import keep, redirect_calls, supported

F = TypeVar("F", bound=Callable[..., Any])

#: Of every kernel. No wrapper for callers in C, who do not exist: a tenth of all compiling.
OPTIONS = {"nogil": True, "error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}

kernels: list[Any] = []
"""All kernels defined so far; empty where numba is disabled."""
caches: list[KernelCache] = []
"""Their caches."""


@overload
def njit(function: F) -> F: ...


@overload
def njit(
    *, inline: bool = False, merge: bool = False, refcount: bool = True
) -> Callable[[F], F]: ...


def njit(
    function: Callable[..., Any] | None = None,
    *,
    inline: bool = False,
    merge: bool = False,
    refcount: bool = True,
) -> Any:
    """Compile a kernel with the options of the project.

    A kernel is compiled at most twice: for calls from Python, and for calls from kernels without
    the wrapper for Python, a seventh of all compiling. A literal number in a call makes no kernel
    of its own, as it does with numba: a quarter of all compiling. Kernels that index with such a
    number are inlined, so that no test for a negative index remains.

    inline: compile it into its callers, however long it is: LLVM vectorises only loops without
    calls. merge: copy it into its callers, one or few, before these are compiled, and never compile
    it alone. LLVM optimizes a kernel again in each that calls it, directly or not, so each level
    between saves as much as all below it. Callers may count references or not. refcount: count
    references to the arrays among the arguments, 5 ns for each that it names, as much as a test of
    two spheres. A kernel that makes or returns arrays must count.
    """
    options: dict[str, Any] = {}
    if merge:
        return lambda function: numba.njit(**supported(OPTIONS), inline="always")(function)
    if inline:
        options["forceinline"] = True
    if not refcount:
        options["_nrt"] = False
    if function is None:
        return lambda function: _compiled(function, options)
    return _compiled(function, options)


def _compiled(function: F, options: dict[str, Any]) -> F:
    kernel: Any = numba.njit(**supported({**OPTIONS, **options}))(function)
    if kernel is function:  # numba is disabled
        return function
    cache = KernelCache(kernel)
    keep(kernel, cache.for_numba())

    @functools.cache
    def inner() -> Any:
        options["no_cpython_wrapper"] = True
        result = numba.njit(**supported({**OPTIONS, **options}))(function)
        keep(result, cache.for_numba(for_kernels=True))
        return result

    redirect_calls(kernel, inner, types.unliteral)
    kernels.append(kernel)
    caches.append(cache)
    result: F = kernel
    return result


@structref.register
class HeldType(types.StructRef):  # type: ignore[misc]
    """The type of ``Held`` in kernels."""


class Held(structref.StructRefProxy):  # type: ignore[misc]
    """A NamedTuple that kernels take in 1 us; one of thirty arrays would take 8."""

    __slots__ = ()
    value: Any


class Interpreted:
    """``Held`` where numba is disabled."""

    def __init__(self, value: Any) -> None:
        self.value = value


structref.define_boxing(HeldType, Held)


def _maker(value: Any) -> Callable[[Any], Held]:
    kind = HeldType([("value", value)])

    def make(value: Any) -> Held:
        held: Held = structref.new(kind)
        held.value = value
        return held

    return make


overload_function(Held)(_maker)  # as ``structref.define_proxy`` does, in a module with a name
_held: Any = Interpreted if config.DISABLE_JIT else Held


@njit
def hold(value: Any) -> Held:
    """Return a NamedTuple as ``Held``; kernels read its ``value``."""
    held: Held = _held(value)
    return held


def loaded_kernels() -> set[str]:
    """Return the kernels that Python has called in this process, with the types of arguments."""
    pairs = zip(kernels, caches, strict=True)
    return {f"{cache.name} {kinds}" for kernel, cache in pairs for kinds in kernel.overloads}


def unkept_kernels() -> list[str]:
    """Return the names of the kernels of which the cache has no file."""
    return [cache.name for cache in caches if not cache.is_kept]
