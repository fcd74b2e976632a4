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


"""What an empty kernel cache costs: seconds until the node is ready, and until all is compiled."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import obb_collision
from obb_collision.warm_up.steps import BOXES, MESSAGES, NODE_STEPS, possible_steps

#: Seconds: the default node, the same once more, what is switched on late, and everything by two
#: processes.
NODE, WARM, LATE, EVERYTHING = 12.0, 2.0, 12.0, 60.0
#: How a program compiles steps, as the node does beside its cycles.
COMPILE = "from obb_collision.warm_up.processes import compile_steps; import sys; "
COMPILE += "progress = compile_steps(sys.argv[1:]); sys.exit(bool(progress.failed))"
READY = "ready: "
#: What every node needs.
DEFAULT = [BOXES, MESSAGES, "effect separations"]


def measure_starts(show: Callable[[str], None]) -> Iterator[tuple[str, float, float]]:
    """Yield what, the seconds wanted, and those it took."""
    with TemporaryDirectory() as folder:
        home = Path(folder)
        show("empty cache: default start")
        if find_spec("rclpy"):
            yield "default node ready", NODE, _node(home / "default")
            yield "default node ready, kernels cached", WARM, _node(home / "default")
        else:
            seconds = _run(home / "default", [BOXES, "effect separations"])
            yield "kernels of a default scene", NODE, seconds
        for step in NODE_STEPS:
            if step not in DEFAULT and step in possible_steps():
                show(f"empty cache: {step}")
                shutil.copytree(home / "default", home / step)
                yield f"{step} switched on late", LATE, _run(home / step, [step])
        show("empty cache: everything")
        start = perf_counter()
        command = [sys.executable, "-m", "obb_collision.warm_up.command", "--quiet"]
        subprocess.run(command, env=_environment(home / "all"), check=True, capture_output=True)
        yield "everything by obb_collision warm-up", EVERYTHING, perf_counter() - start


def _environment(cache: Path) -> dict[str, str]:
    root = str(Path(obb_collision.__file__).parents[1])
    path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": path}


def _run(cache: Path, steps: list[str]) -> float:
    start = perf_counter()
    command = [sys.executable, "-c", COMPILE, *steps]
    subprocess.run(command, env=_environment(cache), check=True, capture_output=True)
    return perf_counter() - start


def _node(cache: Path) -> float:
    """Return the seconds from the start of a node until it says that it is ready."""
    start = perf_counter()
    command = [sys.executable, "-c", "from obb_collision.commands import node; node()"]
    with subprocess.Popen(
        command,
        env=_environment(cache),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        try:
            if any(READY in line for line in process.stdout):
                return perf_counter() - start
        finally:
            process.kill()
    raise RuntimeError("the node ended before it was ready")
