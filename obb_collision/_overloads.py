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

"""Kernels for kernels: compiled without machine code and the function by which Python calls it.

Both are a third of all compiling, and most kernels are called by others only, which include what
they call: of these LLVM's code suffices. One that Python calls as well is compiled, or loaded, once
more then.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite.binding import parse_bitcode
from numba.core import sigutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.compiler_lock import global_compiler_lock

_this_thread = threading.local()


@contextmanager
def for_kernels(kernel: Any) -> Iterator[None]:
    """Have what this thread compiles of a kernel be for other kernels alone."""
    before = getattr(_this_thread, "kernel", None)
    _this_thread.kernel = kernel
    try:
        yield
    finally:
        _this_thread.kernel = before


def is_for_kernels(kernel: Any) -> bool:
    """Return whether what this thread compiles of a kernel is for other kernels alone."""
    return getattr(_this_thread, "kernel", None) is kernel


class Overloads:
    """What there is of one kernel for kernels alone; takes the place of methods of numba's."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._partial: set[Any] = set()  # kinds of arguments for which that is all there is
        self._compile, self._add = kernel.compile, kernel.add_overload
        kernel.compile, kernel.add_overload = self.compile, self.add
        kernel._compiler._customize_flags = self._flags

    def compile(self, signature: Any) -> Any:
        """Compile the kernel, or load it, if it is not there."""
        with global_compiler_lock:
            args = tuple(sigutils.normalize_signature(signature)[0])
            if args in self._partial and not is_for_kernels(self._kernel):
                self._partial.discard(args)
                del self._kernel.overloads[args]
            return self._compile(signature)

    def add(self, compiled: Any) -> None:
        """Add what was compiled or loaded: out of reach of Python, if it is for kernels alone."""
        if not is_for_kernels(self._kernel):
            self._add(compiled)
            return
        args = tuple(compiled.signature.args)
        self._partial.add(args)
        self._kernel.overloads[args] = compiled

    def _flags(self, flags: Any) -> Any:
        if is_for_kernels(self._kernel):
            flags.no_cpython_wrapper = True
        return flags


class Inner(JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """What is compiled of a kernel for kernels alone; its place among numba's is a library."""

    def _finalize_final_module(self) -> None:
        """Leave out what makes machine code of it."""
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    @property
    def codegen(self) -> Inner:
        """What would set the environment that Python code gives to machine code."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: it has no place yet."""

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """Return what ``rebuilt`` takes."""
        return self.name, "bitcode", self._get_module_for_linking().as_bitcode()


class Pipeline(Compiler):  # type: ignore[misc]
    """Numba's compiler, which makes no machine code of what only kernels call."""

    def compile_extra(self, function: Any) -> Any:
        """Compile a function."""
        if self.state.flags.no_cpython_wrapper:
            self.state["library"] = Inner(self.state.targetctx.codegen(), function.__qualname__)
        return super().compile_extra(function)


class _Target:
    """A target that makes kernels for kernels alone of what is loaded."""

    def __init__(self, target: Any) -> None:
        self._target = target

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)

    def codegen(self) -> _Target:
        return self

    def unserialize_library(self, kept: tuple[str, str, bytes]) -> Inner:
        name, _, code = kept
        library = Inner(self._target.codegen(), name)
        library._final_module = parse_bitcode(code)
        library._finalize_final_module()
        return library


def rebuilt(target: Any, *kept: Any) -> Any:
    """Return a kernel for kernels alone that was kept."""
    return CompileResult._rebuild(_Target(target), *kept)._replace(target_context=target)
