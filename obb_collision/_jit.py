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
from typing import Any, TypeVar, overload

import numba
from numba import config, types
from numba.experimental import structref
from numba.extending import overload as overload_function

from obb_collision._kernel_cache import KernelCache
from obb_collision._numba import keep, known, redirect_calls

F = TypeVar("F", bound=Callable[..., Any])

#: Of every kernel. No wrapper for callers in C, who do not exist: a tenth of all compiling.
OPTIONS = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": False,
    "no_cfunc_wrapper": True,
}

kernels: list[Any] = []
"""All kernels that have been defined so far; none where numba is disabled."""
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

    It is compiled twice at most: for Python, and for kernels that call it, without the function by
    which Python would: a seventh of all compiling.

    inline: into whatever calls it, however long it is; a loop over several numbers at once must not
    call anything. merge: into its callers, one or few, as if it stood there, before these are
    compiled, and never alone: LLVM optimizes a kernel again in each that calls it, directly or not,
    so that each level between saves as much as all below it. Its callers may count references or
    not. refcount: whether references to the arrays it is given are counted, which takes 5 ns for
    each it names, as much as a test of two spheres; not in a kernel that makes or returns any.

    A number written out in a call makes no kernel of its own, as it does with numba: a quarter of
    all compiling. What indexes with it is inlined, so that it need not ask whether it is negative.
    """
    options: dict[str, Any] = {}
    if merge:
        return lambda function: numba.njit(**known(OPTIONS), inline="always")(function)
    if inline:
        options["forceinline"] = True
    if not refcount:
        options["_nrt"] = False
    if function is None:
        return lambda function: _compiled(function, options)
    return _compiled(function, options)


def _compiled(function: F, options: dict[str, Any]) -> F:
    kernel: Any = numba.njit(**known({**OPTIONS, **options}))(function)
    if kernel is function:  # numba is disabled
        return function
    cache = KernelCache(kernel)
    keep(kernel, cache.for_numba())
    inner = numba.njit(**known({**OPTIONS, **options, "no_cpython_wrapper": True}))(function)
    keep(inner, cache.for_numba(for_kernels=True))
    redirect_calls(kernel, inner, types.unliteral)
    kernels.append(kernel)
    caches.append(cache)
    made: F = kernel
    return made


@structref.register
class HeldType(types.StructRef):  # type: ignore[misc]
    """What kernels see of ``Held``."""


class Held(structref.StructRefProxy):  # type: ignore[misc]
    """A NamedTuple as kernels take it in 1 us, be it one of thirty arrays, which alone take 8."""

    __slots__ = ()
    value: Any


class Interpreted:
    """The same where numba is disabled."""

    def __init__(self, value: Any) -> None:
        self.value = value


structref.define_boxing(HeldType, Held)


def _made(value: Any) -> Callable[[Any], Held]:
    kind = HeldType([("value", value)])

    def make(value: Any) -> Held:
        held: Held = structref.new(kind)
        held.value = value
        return held

    return make


overload_function(Held)(_made)  # as ``structref.define_proxy`` does, in a module with a name
_held: Any = Interpreted if config.DISABLE_JIT else Held


@njit
def hold(value: Any) -> Held:
    """Return a NamedTuple for kernels, which read ``value`` of it."""
    held: Held = _held(value)
    return held


def loaded_kernels() -> set[str]:
    """Return the kernels that Python has called in this process, with the types of arguments."""
    pairs = zip(kernels, caches, strict=True)
    return {f"{cache.name} {kinds}" for kernel, cache in pairs for kinds in kernel.overloads}


def unkept_kernels() -> list[str]:
    """Return the names of the kernels that the cache has for no kind of arguments."""
    return [cache.name for cache in caches if not cache.is_kept]
