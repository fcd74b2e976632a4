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

"""The node in a process of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer

from rig import DOMAIN

import obb_collision

PATIENCE = 1200.0
"""Seconds that a process may take on a loaded machine, compiling kernels included."""


def cached(folder: Path) -> dict[str, str]:
    """Return what gives a process a cache of its own."""
    return {"NUMBA_CACHE_DIR": str(folder)}


def environment(**more: str) -> dict[str, str]:
    """Return the environment of a process with this package."""
    root = str(Path(obb_collision.__file__).parents[1])
    path = os.pathsep.join([root, *sys.path[1:]])
    return {**os.environ, "PYTHONPATH": path, "ROS_DOMAIN_ID": str(DOMAIN), **more}


def command() -> list[str]:
    """Return the installed executable, or the module where the package is not installed."""
    beside = Path(sys.executable).parent / "obb_collision_node"
    found = str(beside) if beside.exists() else shutil.which("obb_collision_node")
    return [found] if found else [sys.executable, "-m", "obb_collision.commands"]


@contextmanager
def running(*arguments: str, **more: str) -> Iterator[subprocess.Popen[str]]:
    """Start the node with more in its environment; killed at the end if it still runs."""
    process = subprocess.Popen(
        [*command(), *arguments],
        env=environment(PYTHONWARNINGS="default") | more,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def output_until(process: subprocess.Popen[str], word: str) -> str:
    """Return the output up to a line with a word, without which the process must not end."""
    assert process.stdout is not None
    limit = Timer(PATIENCE, process.kill)  # then there are no more lines
    limit.start()
    lines: list[str] = []
    try:
        while word not in (lines or [""])[-1]:
            lines.append(process.stdout.readline())
            assert lines[-1], f"ended without {word!r}: {lines}"
    finally:
        limit.cancel()
    return "".join(lines)
