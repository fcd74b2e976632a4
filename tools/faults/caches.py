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

"""Faults of the cache of compiled kernels: unwritable, damaged, full, cold for two nodes."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import time
from pathlib import Path
from random import Random

from obb_collision._jit import kernels
from tools.faults.bench import STARTING, Bench, check

CACHE = "NUMBA_CACHE_DIR"
COLD = 1800.0
"""Seconds in which kernels that are not there are compiled, on a busy machine."""
DISK = 256 * 1024
"""Bytes of a disk that is soon full."""


def unwritable_cache(bench: Bench) -> str:
    """Start with a cache folder in which nothing can be created."""
    blocked = bench.folder / "file"
    blocked.write_text("no folder")
    return _cold(bench, blocked / "cache", "can't be kept")


def full_disk(bench: Bench) -> str:
    """Start with a cache folder on a disk that is full after 256 KiB."""
    folder = bench.folder / "disk"
    folder.mkdir()
    options = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(folder)]
    mounted = os.geteuid() == 0 and shutil.which("mount") is not None
    mounted = mounted and subprocess.run(options, capture_output=True, check=False).returncode == 0
    try:
        limit = None if mounted else DISK // 16
        how = "a real one" if mounted else "files limited in its place"
        return f"{how}: {_cold(bench, folder, 'kernels', limit)}"
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=False)


def _cold(bench: Bench, cache: Path, warning: str, limit: int | None = None) -> str:
    start = time.monotonic()
    node = bench.start(wait=False, NUMBA_CACHE_DIR=str(cache))
    if limit is not None:
        node.limit(resource.RLIMIT_FSIZE, limit)
    bench.meet(COLD)
    bench.probe(COLD)
    took = time.monotonic() - start
    check(node.said(warning), "nothing in the log")
    return f"compiled in the process and right after {took:.0f} s, with a warning"


def corrupt_cache(bench: Bench) -> str:
    """Start with a cache in which every file is damaged, each in another way."""
    cache, random = bench.folder / "cache", Random(1)
    copied = copy_cache(cache)
    check(copied > 0, "there is no cache to damage; start a node once")
    for number, file in enumerate(sorted(cache.rglob("*"))):
        if file.is_file():
            data = file.read_bytes()
            at = random.randrange(len(data))
            bad = bytes([data[at] ^ (1 << random.randrange(8))])
            damaged = (b"", data[: len(data) // 2], data[:at] + bad + data[at + 1 :], b"x" * 1000)
            file.write_bytes(damaged[number % len(damaged)])
    start = time.monotonic()
    bench.start(wait=False, NUMBA_CACHE_DIR=str(cache))
    bench.meet(COLD)
    bench.probe(COLD)
    first = time.monotonic() - start
    return f"{copied} kernels damaged; compiled anew, right after {first:.0f} s"


def copy_cache(to: Path) -> int:
    """Copy the kernels of this package from the cache; returns how many there are."""
    import obb_collision.node.node  # noqa: F401  # whatever a node uses

    found = 0
    for kernel in kernels:
        folder = Path(kernel._cache.cache_path)
        if folder.is_dir():
            shutil.copytree(folder, to / "obb_collision" / folder.name)
            found += 1
    return found


def two_on_a_cold_cache(bench: Bench) -> str:
    """Start two nodes at once on an empty cache, and then a third one."""
    cache = str(bench.folder / "cold")
    first, second = bench.namespace, f"{bench.namespace}_b"
    start = time.monotonic()
    nodes = [
        bench.start(namespace=namespace, wait=False, NUMBA_CACHE_DIR=cache)
        for namespace in (first, second)
    ]
    seen = []
    for namespace in (first, second):
        if namespace != first:
            bench.listen(namespace)
        bench.meet(COLD)
        bench.probe(COLD)
        seen.append(f"{time.monotonic() - start:.0f} s")
    for node in nodes:
        check(node.end() == 0, "a node did not end well")
    start = time.monotonic()
    bench.start(NUMBA_CACHE_DIR=cache)
    warm = time.monotonic() - start
    check(warm < STARTING, f"the third one took {warm:.0f} s")
    return f"both right, after {' and '.join(seen)}; a third one after {warm:.1f} s, by their cache"
