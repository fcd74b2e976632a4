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

"""The machine code of the kernels on disk: one file per kernel and signature.

Numba's own cache looks at one source file only, so that editing a helper or a constant in another
file keeps running the old machine code; it is bound to the place and the time of the file, so that
every new environment compiles anew; and two processes that fill it at once may swap entries.

Here the names of a folder and a file say everything that the content depends on: the kernel, all
it calls and all constants of these, numba's version and flags (see ``kernel_key``), the signature
and the processor. Edits elsewhere compile nothing. A file begins with a digest of the rest: one
that is damaged counts as missing and is written anew. Where nothing can be written, each process
compiles its own.

What is read is executed, so that it must be this user's or root's: a folder or file of somebody
else, or that others may write to, counts as missing. A group that this process runs with may write,
as it is the user's alone where folders are made for groups (umask 002).
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import shutil
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import Enum
from functools import cache
from itertools import product
from pathlib import Path
from time import perf_counter, time
from types import CodeType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import config as _config
from numba.core import types as _types
from numba.experimental.structref import StructRefProxy

from obb_collision._numba import Cache, Key, can_keep, function_of
from obb_collision.words import command_line

config: Any = _config  # its attributes are set at run time
types: Any = _types
#: Warnings for users: to stderr, where ``logging`` is not set up.
logger = logging.getLogger("obb_collision")

#: Seconds since its last use after which a folder goes: edits and versions that are no more.
UNUSED = 30 * 86400.0
DIGEST_SIZE = 16
#: Prefix of files with the variant that only kernels can call.
FOR_KERNELS = "inner-"
#: Bytes that are written to see whether a folder takes kernels: most have less.
PROBE = 1 << 16
#: Seconds of compiling after which it is logged, and between two lines about it.
FIRST_LINE, NEXT_LINE = 1.0, 5.0


def cache_home() -> Path | None:
    """Return the folder of all kernels: NUMBA_CACHE_DIR, XDG_CACHE_HOME or ~/.cache decide.

    None where there is no home folder to put it in.
    """
    if config.CACHE_DIR:
        return Path(config.CACHE_DIR).absolute() / "obb_collision"
    base = os.environ.get("XDG_CACHE_HOME", "")
    if not os.path.isabs(base):  # to be ignored then, as its specification has it
        base = os.path.join(os.path.expanduser("~"), ".cache")
    return Path(base) / "obb_collision" if os.path.isabs(base) else None


#: Folders of kernels. A new one is saved in the first that takes it.
places: list[Path] = [home] if (home := cache_home()) is not None else []
#: Kernels that were compiled and that no folder took.
unsaved: list[str] = []
_said: set[tuple[Path | None, str]] = set()
_used: set[Path] = set()
_this_thread = threading.local()


class Compiled:
    """The kernels that this process compiles, and the seconds it takes; logs the progress.

    say: called whenever one is compiled.
    """

    def __init__(self) -> None:
        self.names: list[str] = []
        self.seconds = 0.0
        self.say: Callable[[], None] = self.log
        self._begun: list[str] = []  # a kernel that is compiled may need others compiled
        self._start, self._due = 0.0, FIRST_LINE

    def begin(self, name: str) -> None:
        """Note that a kernel is about to be compiled."""
        if not self._begun:
            self._start = perf_counter()
        self._begun.append(name)

    def end(self, name: str) -> None:
        """Note that a kernel is compiled; those begun since then have failed."""
        self.names.append(name)
        del self._begun[self._begun.index(name) if name in self._begun else 0 :]
        now = perf_counter()
        self.seconds, self._start = self.seconds + now - self._start, now
        self.say()

    def log(self) -> None:
        """Log the progress, if it is time to."""
        if self.seconds < self._due:
            return
        kept = f", kept in {places[0]} for the next time" if places and not unsaved else ""
        how = f" ({command_line('obb_collision warm-up')} compiles all beforehand){kept}"
        is_first, self._due = self._due == FIRST_LINE, self.seconds + NEXT_LINE
        count = len(self.names)
        logger.warning(
            "compiling kernels%s: %d so far, %.0f s", how if is_first else "", count, self.seconds
        )


compiled = Compiled()
"""What this process has compiled."""


class KernelMissingError(BaseException):
    """A kernel would have to be compiled where only loading is allowed.

    Derives from BaseException so that ``except Exception`` does not swallow it.
    """


@contextmanager
def only_loading() -> Iterator[None]:
    """Let this thread load kernels but compile none: KernelMissingError where it would."""
    _this_thread.only_loads = True
    try:
        yield
    finally:
        _this_thread.only_loads = False


def only_loads() -> bool:
    """Return whether this thread may load kernels only."""
    return getattr(_this_thread, "only_loads", False)


def why_not_kept() -> str:
    """Return why the cache takes no kernels, nothing where it does."""
    if not can_keep():
        return "this version of numba is too new for the package; install an older version"
    if not places:
        return "the home folder is missing; set NUMBA_CACHE_DIR"
    try:
        _make(places[0])
        with tempfile.TemporaryFile(dir=places[0]) as file:
            file.write(bytes(PROBE))
    except (OSError, ValueError) as error:
        return str(error)
    return ""


def _why_foreign(*paths: Path) -> str:
    """Return why another user may have written to folders or a file, "" if none can.

    paths: from the outside in; missing ones can be made. OSError where one can't be read.
    """
    shared = stat.S_IWGRP | stat.S_IWOTH
    for path in paths:
        try:
            status = path.stat()
        except FileNotFoundError:
            return ""
        if status.st_uid not in (os.geteuid(), 0):
            return f"{path} belongs to another user; set NUMBA_CACHE_DIR to a folder of your own"
        if status.st_mode & (stat.S_IWOTH if status.st_gid == os.getegid() else shared):
            return f"others may write to {path}; remove it, or NUMBA_CACHE_DIR names another folder"
    return ""


def _make(place: Path, *folders: Path) -> None:
    """Make folders that only their owner may write to; OSError where that is not possible.

    Not as root in a folder of a user, whom they would lock out (``sudo -E`` keeps HOME).
    """
    why = _why_foreign(place, *folders)
    if not why and not place.exists() and os.geteuid() == 0:
        above = next(path for path in place.parents if path.exists())
        why = _why_foreign(above) if above.stat().st_uid != 0 else ""
    if why:
        raise OSError(why)
    for folder in (place, *folders):
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)


@cache
def private_place() -> Path | None:
    """Return a temporary folder, removed when the process ends; None where none can be made."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="obb_collision-kernels-"))
    except OSError as error:
        _say_once(None, f"no temporary folder for kernels: {error}")
        return None
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    places.append(folder)
    return folder


def _say_once(place: Path | None, text: str) -> None:
    if (place, text) not in _said:
        _said.add((place, text))
        logger.warning(text)


@cache
def _drop_unused(home: Path) -> None:
    """Remove, once per process, the folders that no process has loaded from for UNUSED seconds."""
    for folder in home.glob("*-*"):
        with suppress(OSError):  # another process has removed it
            if time() - folder.stat().st_mtime > UNUSED:
                shutil.rmtree(folder, ignore_errors=True)


class KernelCache:
    """The files of one kernel, for Python and for kernels that call it."""

    def __init__(self, kernel: Any) -> None:
        self._kernel, self._function = kernel, function_of(kernel)
        function = self._function
        name = f"{function.__module__}.{function.__qualname__}"
        self.name = name.removeprefix("obb_collision.")
        """Name of the kernel, without that of the package."""

    def for_numba(self, for_kernels: bool = False) -> Cache:
        """Return the cache for numba. for_kernels: of the variant that only kernels can call."""
        prefixes = ("", FOR_KERNELS) if for_kernels else ("",)

        def load(key: Key, rebuilt: Callable[[bytes], Any]) -> Any:
            for place, prefix in product(places, prefixes):
                kernel = self._load(place, prefix + self._file(key), rebuilt)
                if kernel is not None:
                    return kernel
            if only_loads():
                raise KernelMissingError(self.name)
            compiled.begin(self.name)
            return None

        def save(key: Key, content: bytes | None) -> None:
            if content is None or not self._save(prefixes[-1] + self._file(key), content):
                unsaved.append(self.name)
            compiled.end(self.name)

        return Cache(load, save)

    @property
    def folder(self) -> str:
        """Name of the folder; known once all that the kernel names is defined."""
        return f"{self.name}-{kernel_key(self._kernel)}"

    @property
    def is_kept(self) -> bool:
        """Whether there is a file of the kernel, for whichever arguments."""
        for place in places:
            folder = place / self.folder
            with suppress(OSError):
                if not _why_foreign(place, folder):
                    files = (path for path in folder.glob("*.kernel") if path.is_file())
                    if any(not _why_foreign(path) for path in files):
                        return True
        return False

    def _load(self, place: Path, name: str, rebuilt: Callable[[bytes], Any]) -> Any:
        """Return a kernel from a folder, None where it is not there or can't be used."""
        folder = place / self.folder
        try:
            if not (folder / name).is_file():  # a pipe or a device would be read for ever
                return None
            why = _why_foreign(place, folder, folder / name)
            if why:
                _say_once(place, f"kernels in {place} are not used: {why}")
                return None
            content = (folder / name).read_bytes()
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            _say_once(place, f"kernels in {place} can't be read: {_reason(error)}")
            return None
        try:
            digest, data = content[:DIGEST_SIZE], content[DIGEST_SIZE:]
            if _digest(data) != digest:
                raise _DamagedError
            result = _unless_interrupted(rebuilt, data)
        except _DamagedError:
            _say_once(place, f"kernels in {place} are damaged: these are compiled anew")
            return None
        if folder not in _used:
            _used.add(folder)
            with suppress(OSError):
                os.utime(folder)  # see ``_drop_unused``
        return result

    def _save(self, name: str, content: bytes) -> bool:
        """Store a compiled kernel, if a folder takes it; returns whether one does."""
        for place in places:
            try:
                self._write(place / self.folder, name, _digest(content) + content)
                return True
            except (OSError, ValueError) as error:
                _say_once(place, f"kernels can't be kept in {place}: {_reason(error)}")
        return False

    def _file(self, key: Key) -> str:
        signature, processor = key
        codes = (self._function.__code__.co_code, b"")
        rest = [processor, tuple(hashlib.sha256(code).hexdigest() for code in codes)]
        text = repr((str(signature), [fields_of(kind) for kind in signature], rest))
        return f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.kernel"

    def _write(self, folder: Path, name: str, content: bytes) -> None:
        is_new = not folder.is_dir()
        _make(folder.parent, folder)
        if is_new:
            _drop_unused(folder.parent)
        handle, temporary = tempfile.mkstemp(dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(temporary, folder / name)
        except BaseException:
            with suppress(OSError):
                os.unlink(temporary)
            raise


class _DamagedError(Exception):
    """The content of a file has changed, or can't be used."""


def _unless_interrupted(rebuilt: Callable[[bytes], Any], data: bytes) -> Any:
    """Return a kernel; _DamagedError for any error of pickle or numba in a foreign file.

    A handler of a signal may raise meanwhile, and that is raised here: it does not come again.
    """
    try:
        return rebuilt(data)
    except Exception as error:
        try:
            rebuilt(data)
        except Exception as again:
            if type(again) is type(error):
                raise _DamagedError from error
        raise


def _reason(error: OSError | ValueError) -> str:
    return getattr(error, "strerror", None) or str(error)


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=DIGEST_SIZE).digest()


# The key of a kernel. Numba compiles it from its bytecode and literals, the values that globals
# have then, the kernels that it calls, the options of the decorator, and the names that types give
# to fields. All of that is in the key, and nothing else: an edit of a docstring, of a comment or of
# Python code beside a kernel compiles nothing.

#: Settings of numba, by environment variables or files, that change what is compiled.
FLAGS = (
    *("BOUNDSCHECK", "DEBUGINFO_DEFAULT", "ENABLE_AVX", "LLVM_REFPRUNE_PASS", "LOOP_VECTORIZE"),
    *("OPT", "SLP_VECTORIZE", "USING_SVML"),
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
    """Return the parts of a kernel's key without what it calls; TypeError for an unknown part."""
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
    if isinstance(kind, types.StructRef):
        return tuple(map(fields_of, kind.field_dict.values()))
    return ()


def _globals(kernel: Any) -> list[tuple[str, Any]]:
    """Return the globals that a kernel names, and what it closes over, sorted."""
    function = function_of(kernel)
    scope = function.__globals__
    named = {name: scope[name] for name in _names(function.__code__) if name in scope}
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
    if isinstance(value, type) and issubclass(value, StructRefProxy):
        return f"holds {value.__qualname__}"
    if value is None or isinstance(value, (bool, int, float, str, np.generic)):
        return f"{type(value).__name__} {value!r}"
    module = getattr(value, "__module__", None) or ""
    if callable(value) and not module.startswith("obb_collision"):
        return f"{module}.{getattr(value, '__qualname__', value)}"  # of a library of that version
    raise TypeError(f"it is not known how machine code depends on a {type(value).__name__}")
