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

from processes import limited
from rig import DOMAIN

import obb_collision
from obb_collision import _jit
from obb_collision.warm_up import steps


def cached(folder: Path) -> dict[str, str]:
    """Return what gives a process a cache of its own."""
    return {"NUMBA_CACHE_DIR": str(folder)}


def kernels_of_steps() -> set[str]:
    """Return the kernels that steps load from now on: none, and it grows."""
    loaded: set[str] = set()
    run = steps.run

    def noted(step: str) -> None:
        before = _jit.loaded_kernels()
        try:
            run(step)
        finally:
            loaded.update(_jit.loaded_kernels() - before)

    steps.run = noted  # type: ignore[assignment]
    return loaded


def environment(**more: str) -> dict[str, str]:
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
    with limited(process):
        yield process
