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
it calls and all constants of these, numba's version and flags (see ``_kernel_key``), the signature
and the processor. Edits elsewhere compile nothing. A file begins with a digest of the rest: one
that is damaged counts as missing and is written anew. Where nothing can be written, each process
compiles its own.
"""

from __future__ import annotations

import atexit
import glob
import hashlib
import logging
import os
import pickle
import shutil
import stat
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from itertools import product
from pathlib import Path
from time import time
from typing import Any

import numba
from numba.core import config as _config
from numba.core.caching import FunctionCache
from numba.core.compiler import CompileResult

from obb_collision._kernel_key import fields_of, kernel_key
from obb_collision._overloads import is_for_kernels, rebuilt

config: Any = _config  # its attributes are set at run time
#: Warnings for users: to stderr, where ``logging`` is not set up.
logger = logging.getLogger("obb_collision")

#: Folders kept per kernel: a few checkouts or environments side by side, not every edit ever.
KEPT_FOLDERS = 8
#: Seconds since its last use for which a folder stays anyway: a running process may still need it.
IN_USE = 86400.0
#: Seconds since its last use after which any folder goes, also of kernels that are no more. A
#: process that finds one gone compiles.
UNUSED = 90 * 86400.0
DIGEST_SIZE = 16
#: Bytes of a file at most: 60 times the largest kernel. Anything else would be read for ever.
MAX_KERNEL = 64_000_000
#: How the names of files begin of what kernels alone can call.
FOR_KERNELS = "inner-"
#: How the names of private folders begin, and the name of the file in them that is locked ...
PRIVATE, LOCK = "obb_collision-kernels-", "lock"
#: ... within so many seconds of their making.
LOCKING = 60.0
#: Bytes that are written to see whether a folder takes kernels: most have less.
PROBE = 1 << 16


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


#: Where kernels are looked for, and kept: in the first of these folders that takes them.
places: list[Path] = [home] if (home := cache_home()) is not None else []
#: Kernels that were compiled and that no folder took.
unsaved: list[str] = []
_said: set[tuple[Path | None, str]] = set()
_used: set[Path] = set()
_this_thread = threading.local()


class KernelMissingError(BaseException):
    """A kernel would have to be compiled where only loading is allowed.

    No ``Exception``: what lives through failures must not take it for one of them.
    """


@contextmanager
def only_loading() -> Iterator[None]:
    """Let this thread load kernels but compile none: KernelMissingError where it would."""
    _this_thread.only_loads = True
    try:
        yield
    finally:
        _this_thread.only_loads = False


def why_not_kept() -> str:
    """Return why the cache takes no kernels, nothing where it does."""
    if not places:
        return "there is no home folder; set NUMBA_CACHE_DIR"
    try:
        places[0].mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=places[0]) as file:
            file.write(bytes(PROBE))
    except (OSError, ValueError) as error:
        return str(error)
    return ""


@cache
def private_place() -> Path | None:
    """Return a folder of this process's own, which ends with it; None where none can be made.

    A file in it is locked for as long as the process lives, however that ends.
    """
    import fcntl  # no such thing on Windows, where no node runs either

    drop_left_places()
    try:
        folder = Path(tempfile.mkdtemp(prefix=PRIVATE))
    except OSError as error:
        _say_once(None, f"there is no temporary folder for kernels: {error}")
        return None
    with suppress(OSError):  # where nothing can be locked, nothing is taken for left either
        fcntl.flock(os.open(folder / LOCK, os.O_CREAT | os.O_RDWR, 0o600), fcntl.LOCK_EX)
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    places.append(folder)
    return folder


def drop_left_places() -> None:
    """Remove the private folders of this user whose processes are gone, as after a SIGKILL."""
    import fcntl

    for folder in Path(tempfile.gettempdir()).glob(f"{PRIVATE}*"):
        with suppress(OSError):  # of another user, locked, or gone meanwhile
            found = folder.lstat()
            is_own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
            if not is_own or time() - found.st_mtime < LOCKING:
                continue
            flags = os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK
            descriptor = os.open(folder / LOCK, flags, 0o600)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(descriptor)


def _say_once(place: Path | None, text: str) -> None:
    if (place, text) not in _said:
        _said.add((place, text))
        logger.warning(text)


def _drop_old(home: Path, name: str) -> None:
    """Remove the folders of a kernel that nobody has used for long, and unused ones of all."""
    for age, folder in _ages(home, f"{glob.escape(name)}-*")[KEPT_FOLDERS:]:
        if age > IN_USE:
            shutil.rmtree(folder, ignore_errors=True)
    _drop_unused(home)


@cache
def _drop_unused(home: Path) -> None:
    """Remove, once per process, the folders that no process has loaded from for UNUSED seconds."""
    for age, folder in _ages(home, "*-*"):
        if age > UNUSED:
            shutil.rmtree(folder, ignore_errors=True)


def _ages(home: Path, pattern: str) -> list[tuple[float, Path]]:
    """Return seconds since the last use of folders, least first."""
    ages = []
    for folder in home.glob(pattern):
        with suppress(OSError):  # another process has removed it
            ages.append((time() - folder.stat().st_mtime, folder))
    return sorted(ages)


class KernelCache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """The cache of one kernel, in place of numba's."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._py_func = kernel.py_func
        self._enabled = True

    @property
    def _folder(self) -> str:
        """Name of the folder; known once all that the kernel names is defined."""
        return f"{self.name}-{kernel_key(self._kernel)}"

    @property
    def cache_path(self) -> str:
        """Folder of the kernel, for whichever arguments."""
        return str(places[0] / self._folder) if places else ""

    def flush(self) -> None:
        """Remove the files of the kernel."""
        for place in places:
            shutil.rmtree(place / self._folder, ignore_errors=True)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel, None where it is not there or damaged."""
        target_context.refresh()
        if self._enabled:
            key = self._index_key(sig, target_context.codegen())
            names = [self._file(key)]
            if is_for_kernels(self._kernel):
                names.append(FOR_KERNELS + names[0])
            for place, name in product(places, names):
                found = self._load(place, name, key, target_context)
                if found is not None:
                    return found
        if getattr(_this_thread, "only_loads", False):
            raise KernelMissingError(self.name)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled kernel; a disk that can't take it is no reason to stop."""
        if not self._enabled or any(not lifted.can_cache for lifted in data.lifted):
            return
        if data.library.has_dynamic_globals:
            return
        key = self._index_key(sig, data.codegen)
        content = numba.core.serialize.dumps((key, data._reduce()))
        content = _digest(content) + content
        name = self._file(key)
        if is_for_kernels(self._kernel):
            name = FOR_KERNELS + name
        for place in places:
            try:
                self._write(place / self._folder, name, content)
                return
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or error
                _say_once(place, f"kernels can't be kept in {place}: {reason}")
        unsaved.append(self.name)

    @property
    def name(self) -> str:
        """Name of the kernel, without that of the package."""
        function = self._py_func
        return f"{function.__module__}.{function.__qualname__}".removeprefix("obb_collision.")

    @property
    def is_kept(self) -> bool:
        """Whether there is a file of the kernel, for whichever arguments."""
        found = (path for place in places for path in (place / self._folder).glob("*.kernel"))
        return any(path.is_file() for path in found)

    def _load(self, place: Path, name: str, key: Any, target_context: Any) -> Any:
        """Return a kernel from a folder, None where it is not there or can't be used."""
        folder = place / self._folder
        try:
            content = _content(folder / name)
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            _say_once(place, f"kernels in {place} can't be read: {reason}")
            return None
        try:
            digest, data = content[:DIGEST_SIZE], content[DIGEST_SIZE:]
            if _digest(data) != digest:
                raise ValueError("not what was written")
            known, reduced = pickle.loads(data)
            if known != key:
                return None
            rebuild = rebuilt if name.startswith(FOR_KERNELS) else CompileResult._rebuild
            result = rebuild(target_context, *reduced)
        except Exception:  # whatever a damaged or foreign file makes pickle and numba raise
            _say_once(place, f"kernels in {place} are damaged: these are compiled anew")
            return None
        if folder not in _used:
            _used.add(folder)
            with suppress(OSError):
                os.utime(folder)  # see ``_drop_old``
        return result

    def _file(self, key: Any) -> str:
        signature, *rest = key
        text = repr((str(signature), [fields_of(kind) for kind in signature], rest))
        return f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.kernel"

    def _write(self, folder: Path, name: str, content: bytes) -> None:
        if not folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            _drop_old(folder.parent, self.name)
        handle, temporary = tempfile.mkstemp(dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(temporary, folder / name)
        except BaseException:
            with suppress(OSError):
                os.unlink(temporary)
            raise


def _content(path: Path) -> bytes:
    """Return what is in a regular file, never waiting for a pipe or a device; OSError for those."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    with os.fdopen(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(f"{path.name} is no regular file")
        if found.st_size > MAX_KERNEL:
            raise OSError(f"{path.name} has {found.st_size} bytes, {MAX_KERNEL} is the limit")
        return file.read(MAX_KERNEL)


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=DIGEST_SIZE).digest()
