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

Here a file's name says everything its content depends on: the kernel, its signature, the
processor, numba's version and flags, and a hash of the module of the kernel and of all modules of
this package that it imports, directly or not. Edits elsewhere compile nothing. A file begins with
a digest of the rest: one that is damaged counts as missing and is written anew.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path
from time import time
from typing import Any

import llvmlite
import numba
from numba.core import config as _config
from numba.core.caching import FunctionCache

config: Any = _config  # its attributes are set at run time

PACKAGE = Path(__file__).resolve().parent
#: Folders kept per module: a few checkouts or environments side by side, not every edit ever.
KEPT_FOLDERS = 8
#: Seconds since its last use for which a folder stays anyway: a running process may still need it.
IN_USE = 86400.0
DIGEST_SIZE = 16

_IMPORT = re.compile(r"^[ \t]*from obb_collision([\w.]*) import ([^(#\n]*|\([^)]*\))", re.MULTILINE)


def _file_of(parts: tuple[str, ...]) -> Path | None:
    """Return the file of a module of this package, None if it is none."""
    base = PACKAGE.joinpath(*parts)
    for file in (base.with_suffix(".py") if parts else base, base / "__init__.py"):
        if file.is_file():
            return file
    return None


@cache
def imports_of(file: Path) -> frozenset[Path]:
    """Return the files of this package that one of them imports."""
    found = set()
    for where, names in _IMPORT.findall(file.read_text(encoding="utf-8")):
        parts = tuple(part for part in where.split(".") if part)
        words = re.findall(r"\w+", re.sub(r"#.*|\bas \w+", "", names))
        for candidate in (parts, *((*parts, word) for word in words)):
            imported = _file_of(candidate)
            if imported is not None:
                found.add(imported)
    return frozenset(found)


@cache
def source_hash(file: Path) -> str:
    """Return a hash of a file of this package and of all it imports, and of what compiles it."""
    closure, waiting = set(), [file]
    while waiting:
        one = waiting.pop()
        if one not in closure and one != Path(__file__).resolve():  # it feeds no kernel
            closure.add(one)
            waiting.extend(imports_of(one))
    flags = (config.BOUNDSCHECK, config.OPT, config.LOOP_VECTORIZE, config.SLP_VECTORIZE)
    versions = (numba.__version__, llvmlite.__version__, sys.version_info[:2])
    digest = hashlib.sha256(repr((versions, flags)).encode())
    for one in sorted(closure):
        digest.update(one.relative_to(PACKAGE).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(one.read_bytes()).digest())
    return digest.hexdigest()[:16]


def cache_home() -> Path:
    """Return the folder of all kernels: NUMBA_CACHE_DIR, XDG_CACHE_HOME or ~/.cache decide."""
    if config.CACHE_DIR:
        return Path(config.CACHE_DIR) / "obb_collision"
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(base) / "obb_collision"


@cache
def is_writable(home: Path) -> bool:
    """Return whether files can be written below a folder, which is made."""
    try:
        home.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=home):
            return True
    except OSError:
        return False


def _drop_old(home: Path, module: str) -> None:
    """Remove the folders of a module that nobody has used for long."""
    folders = [(path.stat().st_mtime, path) for path in home.glob(f"{module}-*")]
    for used, folder in sorted(folders)[:-KEPT_FOLDERS]:
        if time() - used > IN_USE:
            shutil.rmtree(folder, ignore_errors=True)


class KernelCache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """The cache of one kernel, in place of numba's."""

    def __init__(self, function: Any) -> None:
        file = Path(function.__code__.co_filename).resolve()
        module = ".".join(file.relative_to(PACKAGE).with_suffix("").parts)
        self._py_func = function
        self._module = module
        self._folder = cache_home() / f"{module}-{source_hash(file)}"
        self._enabled = True

    @property
    def cache_path(self) -> str:
        """Folder of the module's kernels."""
        return str(self._folder)

    def flush(self) -> None:
        """Forget all kernels of the module."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel, None where it is not there or damaged."""
        target_context.refresh()
        if not self._enabled:
            return None
        key = self._index_key(sig, target_context.codegen())
        try:
            content = self._path(key).read_bytes()
            digest, data = content[:DIGEST_SIZE], content[DIGEST_SIZE:]
            if _digest(data) != digest:
                return None
            known, reduced = pickle.loads(data)
        except Exception:  # whatever a damaged or foreign file makes pickle raise
            return None
        if known != key:
            return None
        return numba.core.compiler.CompileResult._rebuild(target_context, *reduced)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled kernel; a disk that can't take it is no reason to stop."""
        if not self._enabled or any(not lifted.can_cache for lifted in data.lifted):
            return
        if data.library.has_dynamic_globals:
            return
        key = self._index_key(sig, data.codegen)
        content = numba.core.serialize.dumps((key, data._reduce()))
        try:
            self._write(self._path(key), _digest(content) + content)
        except OSError:
            return

    def _path(self, key: Any) -> Path:
        code = self._py_func.__code__
        name = re.sub(r"\W", "_", self._py_func.__qualname__)
        text = repr((str(key[0]), key[1:], code.co_firstlineno))
        return self._folder / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:24]}.kernel"

    def _write(self, path: Path, content: bytes) -> None:
        if not self._folder.is_dir():
            self._folder.mkdir(parents=True, exist_ok=True)
            _drop_old(self._folder.parent, self._module)
        handle, temporary = tempfile.mkstemp(dir=self._folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=DIGEST_SIZE).digest()
