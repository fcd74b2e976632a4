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

"""Key of a kernel in the cache: all that its machine code depends on.

Numba compiles a kernel from its bytecode and literals, the values that globals have then, the
kernels that it calls, the options of the decorator, and the names that types give to fields. All of
that is in the key, and nothing else: an edit of a docstring, of a comment or of Python code beside
a kernel compiles nothing.
"""

from __future__ import annotations

import hashlib
import sys
from enum import Enum
from functools import cache
from types import CodeType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import config as _config
from numba.core import types as _types

from obb_collision._numba import function_of

config: Any = _config  # its attributes are set at run time
types: Any = _types

#: Settings of numba, by environment variables or files, that change what is compiled.
FLAGS = (
    "BOUNDSCHECK",
    "DEBUGINFO_DEFAULT",
    "ENABLE_AVX",
    "LLVM_REFPRUNE_PASS",
    "LOOP_VECTORIZE",
    "OPT",
    "SLP_VECTORIZE",
    "USING_SVML",
)


@cache
def kernel_key(kernel: Any) -> str:
    """Return a hash of a kernel, or function, of all it calls, and of what compiles it."""
    reached, waiting = {kernel}, [kernel]
    while waiting:
        for _, called in _globals(waiting.pop()):
            if function_of(called) is not None and called not in reached:
                reached.add(called)
                waiting.append(called)
    flags = [repr(getattr(config, name, None)) for name in FLAGS]
    versions = numba.__version__, llvmlite.__version__, sys.version_info[:2]
    parts = [repr((versions, flags)), own_key(kernel), *sorted(map(own_key, reached))]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


@cache
def own_key(kernel: Any) -> str:
    """Return what a kernel depends on but for what it calls; TypeError where that is not known."""
    function = function_of(kernel)
    values = [(name, _value(value)) for name, value in _globals(kernel)]
    options = sorted(getattr(kernel, "targetoptions", {}).items())
    options.append(("one template", "get_call_template" in vars(kernel)))  # see ``_numba``
    defaults = _value(function.__defaults__ or ())
    name = f"{function.__module__}.{function.__qualname__}"
    return repr((name, _code(function.__code__, function.__doc__), values, options, defaults))


def fields_of(kind: Any) -> tuple[Any, ...]:
    """Return the names that numba types, and those within them, give to fields.

    Compiled code has the numbers of the fields, and the name of a type says nothing about them.
    """
    if isinstance(kind, types.BaseTuple):
        return (getattr(kind, "fields", ()), *map(fields_of, kind))
    return ()


def _globals(kernel: Any) -> list[tuple[str, Any]]:
    """Return the globals that a kernel names, and what it closes over, sorted."""
    function = function_of(kernel)
    known = function.__globals__
    named = {name: known[name] for name in _names(function.__code__) if name in known}
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    return sorted(
        [*named.items(), *((name, cell.cell_contents) for name, cell in cells)],
        key=lambda item: item[0],
    )


def _names(code: CodeType) -> set[str]:
    inner = (_names(value) for value in code.co_consts if isinstance(value, CodeType))
    return set(code.co_names).union(*inner)


def _code(code: CodeType, doc: str | None = None) -> tuple[Any, ...]:
    """Return all that a code object does; not its docstring, nor where in a file it stands."""
    values = [
        _code(value) if isinstance(value, CodeType) else repr(value)
        for value in code.co_consts
        if doc is None or value != doc
    ]
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    return code.co_code.hex(), values, names, code.co_argcount, code.co_flags


def _value(value: Any) -> str:
    """Return a global as numba compiles it in."""
    called = function_of(value)
    if called is not None:
        return f"calls {called.__module__}.{called.__qualname__}"
    if isinstance(value, ModuleType):
        return f"module {value.__name__}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype.str} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_value, value))})"
    if isinstance(value, type) and issubclass(value, tuple):
        return f"fields {getattr(value, '_fields', ())}"
    if isinstance(value, type) and issubclass(value, Enum):
        return repr(list(value))
    if value is None or isinstance(value, (bool, int, float, str, np.generic)):
        return f"{type(value).__name__} {value!r}"
    module = getattr(value, "__module__", None) or ""
    if callable(value) and not module.startswith("obb_collision"):
        return f"{module}.{getattr(value, '__qualname__', value)}"  # of a library of that version
    raise TypeError(f"it is not known how machine code depends on a {type(value).__name__}")
