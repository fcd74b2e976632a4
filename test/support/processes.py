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

"""Processes that a test talks to, each with a limit, one that builds for many, and programs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from threading import Lock, Timer
from typing import Any, TypeAlias

from obb_collision.commands import SUBCOMMANDS
from obb_collision.scene.building import builder
from obb_collision.scene.building.builder import Limits, WorkerProcess
from obb_collision.scene.building.jobs import Task
from obb_collision.scene_files import mesh_files

Process: TypeAlias = "subprocess.Popen[str]"
Done: TypeAlias = "subprocess.CompletedProcess[str]"
PATIENCE = 1200.0
"""Seconds that a process may take on a loaded machine, compiling kernels included."""


@contextmanager
def limited(process: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    """Yield a process that is killed at the end, or after ``PATIENCE``: what it says ends then."""
    limit = Timer(PATIENCE, process.kill)
    limit.start()
    try:
        yield process
    finally:
        limit.cancel()
        process.kill()
        process.communicate(timeout=PATIENCE)


@contextmanager
def started(*arguments: str, cwd: str | Path | None = None, **more: str) -> Iterator[Process]:
    """Start Python with arguments and more in its environment; what it says is one text."""
    process = subprocess.Popen(
        [sys.executable, *arguments], cwd=cwd, env=os.environ | more, stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    with limited(process):
        yield process


def run_python(*arguments: str, cwd: str | Path | None = None, **more: str) -> Done:
    """Run Python with arguments and more in its environment; it must end with exit code 0."""
    done = subprocess.run(
        [sys.executable, *arguments], cwd=cwd, env=os.environ | more, timeout=PATIENCE,
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done


def output_until(process: subprocess.Popen[str], word: str) -> str:
    """Return the output up to a line with a word, without which the process must not end."""
    assert process.stdout is not None
    lines: list[str] = []
    while word not in (lines or [""])[-1]:
        lines.append(process.stdout.readline())
        assert lines[-1], f"ended without {word!r}: {lines}"
    return "".join(lines)


class SharedWorker:
    """Stands for a WorkerProcess: one builds for all nodes of a run, as it takes long to start."""

    _one, _lock = WorkerProcess(), Lock()

    def run(self, task: Task, limits: Limits) -> Any:
        """Return the result of a task, as the process has it."""
        with self._lock:
            return self._one.run(task, limits)

    def stop(self) -> None:
        """Let it go on: it ends with the run."""

    close = stop


def build_by(kind: Any) -> None:
    """Set what builds for whom is made from now on: SharedWorker, or a WorkerProcess for each."""
    for module in (builder, mesh_files):
        vars(module)["WorkerProcess"] = kind


ROOT = Path(__file__).parents[2]
TOOLS = (
    *("faults", "fuzz", "goals", "known_bugs", "latency"),
    *("regions", "robots", "soak", "peers.effects", "peers.engines"),
    *("weight", "wrong_answers", "peers.sweeps"),
)
SCRIPTS = dict(
    re.findall(r'"(obb_collision\w*) = ([\w.]+:\w+)"', (ROOT / "setup.py").read_text("utf-8"))
)
PROGRAMS = {
    **SCRIPTS,
    **{f"obb_collision {name}": f"obb_collision.{at}" for name, (at, _) in SUBCOMMANDS.items()},
    **{
        f"python -m tools.{name}": f"tools.{name}"
        + (".__main__:main" if (ROOT / "tools" / name).is_dir() else ":main")
        for name in TOOLS
    },
}
NEED_ROS = {
    *("obb_collision_node", "obb_collision_merge", "obb_collision node", "obb_collision merge"),
    *(f"python -m tools.{name}" for name in ("faults", "fuzz", "latency", "regions", "soak")),
}


def function_of(program: str) -> Callable[[list[str]], int]:
    """Return the function that a program calls."""
    module, name = PROGRAMS[program].split(":")
    found: Callable[[list[str]], int] = getattr(import_module(module), name)
    return found


def program_of(words: list[str]) -> tuple[str, list[str]]:
    """Return the program that a command line calls, and its arguments."""
    length = 3 if words[:2] == ["python", "-m"] else 2 if words[0] == "obb_collision" else 1
    return " ".join(words[:length]), words[length:]
