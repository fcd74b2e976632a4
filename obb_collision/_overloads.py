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

"""Kernels for kernels: compiled without the function of C by which Python would call them.

That is an eighth of all compiling, and most kernels are called by others only. One that Python
calls as well is compiled, or loaded, once more then.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import sigutils
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
