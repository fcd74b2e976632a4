"""Numba options of the project, in one place.

``njit`` is ``numba.njit`` with the options every kernel needs: strict IEEE arithmetic (no
fastmath: the error bounds of ``queries.separation`` rely on it), the interpreter lock released,
and machine code cached on disk.

Numba's own cache looks at one file only, so editing a helper or a constant in another file keeps
running the old machine code. The cache folder is therefore keyed to a hash of all sources of
this package. Where no folder can be written, kernels compile at first use instead.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import time
from typing import Any, TypeVar

import numba
from numba.core import config as _config

config: Any = _config  # its attributes are set at run time

F = TypeVar("F", bound=Callable[..., Any])

#: Cache folders kept: a few checkouts or virtual environments side by side, not every edit ever.
KEPT_CACHES = 8
#: Seconds since its last use for which a folder stays anyway: a running process may still need it.
IN_USE = 86400.0


def _source_hash() -> str:
    """Return a hash of every source file of the package and of numba's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    root = Path(__file__).resolve().parent
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_home() -> Path:
    if config.CACHE_DIR:
        return Path(config.CACHE_DIR) / "obb_collision"
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(base) / "obb_collision"


def _drop_old_caches(home: Path) -> None:
    folders = sorted((p for p in home.iterdir() if p.is_dir()), key=lambda p: p.stat().st_mtime)
    for folder in folders[:-KEPT_CACHES]:
        if time() - folder.stat().st_mtime < IN_USE:
            continue
        shutil.rmtree(folder, ignore_errors=True)


def _writable_cache() -> str | None:
    """Return the cache folder of these sources, or None where it can't be written."""
    try:
        folder = _cache_home() / _source_hash()
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        with tempfile.TemporaryFile(dir=folder):
            pass
        _drop_old_caches(folder.parent)
    except OSError:
        return None
    return str(folder)


CACHE_FOLDER = _writable_cache()


def njit(function: F) -> F:
    """Compile a kernel with the options of the project (see the module's docstring)."""
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": False}
    if CACHE_FOLDER is None:
        compiled: F = numba.njit(**options)(function)
        return compiled
    before = config.CACHE_DIR
    config.CACHE_DIR = CACHE_FOLDER  # read by numba at the moment of decoration only
    try:
        compiled = numba.njit(cache=True, **options)(function)
    finally:
        config.CACHE_DIR = before
    return compiled
