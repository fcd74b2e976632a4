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

"""Processes that compile, and the command: progress, failures, ends, and that no kernel is left."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from processes import run_python, started

from obb_collision import Accuracy, _child, _jit, _kernel_cache
from obb_collision.cli import INTERRUPTED
from obb_collision.warm_up import processes, steps
from obb_collision.warm_up.command import main

PATIENCE = 60.0
WITHOUT_ROS = """
import importlib.util, sys
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name in hidden else find(name, *rest)
hidden = {"rclpy", "visualization_msgs", "sensor_msgs", "geometry_msgs"}
sys.modules.update(dict.fromkeys(hidden))
from obb_collision.warm_up import steps
for step in steps.possible_steps():
    steps.task_of(step)
print(len(steps.possible_steps()))
"""


def test_the_command_leaves_no_kernel_of_the_library_and_the_node_uncompiled(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it was run before all tests, it does one step more."""
    for step in steps.possible_steps():
        steps.task_of(step)  # imports its kernels
    if not _jit.unkept_kernels():
        monkeypatch.setattr(steps, "possible_steps", lambda: [steps.accuracy_step(Accuracy.HULL)])
    assert main([]) == 0
    captured = capsys.readouterr()
    assert "kernels compiled in" in captured.out
    assert "kernels compiled" in captured.err
    assert _jit.unkept_kernels() == []


def test_no_step_warns() -> None:
    for step in steps.possible_steps():
        steps.task_of(step)()  # where warnings are errors, as in all of these tests


def test_where_nothing_can_be_kept_the_command_says_so_at_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    for places in ([], [tmp_path / "file" / "obb_collision"]):
        monkeypatch.setattr(_kernel_cache, "places", places)
        assert main([]) == 1
        assert "kernels cannot be stored: " in capsys.readouterr().err


def test_without_ros_there_is_nothing_of_ros_to_compile() -> None:
    told = run_python("-c", WITHOUT_ROS).stdout
    assert told.split()[-1] == str(len(steps.STEPS) - len(steps.NEEDS_ROS))


def test_a_process_that_fails_and_one_that_ends_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "KeyError" in processes.compile_steps(["no such step"]).failed["no such step"]
    monkeypatch.setattr(_child, "CODE", "import os; os.kill(os.getpid(), 9)")
    progress = processes.compile_steps(["a", "b", "c"], count=2)
    assert progress.failed["a"] == progress.failed["b"] == "its process: it was ended by SIGKILL"
    assert "no process was left" in progress.failed["c"]
    monkeypatch.setattr(sys, "executable", "")
    assert set(processes.compile_steps(["a", "b"]).failed) == {"a", "b"}


def test_it_stops_when_told_to_and_leaves_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[subprocess.Popen[bytes]] = []
    real = subprocess.Popen

    def noted(*args: object, **options: object) -> subprocess.Popen[bytes]:
        begun.append(real(*args, **options))  # type: ignore[call-overload]
        return begun[-1]

    monkeypatch.setattr(subprocess, "Popen", noted)
    monkeypatch.setattr(_child, "CODE", "import time; time.sleep(1000)")
    wanted = steps.with_parts([steps.BOXES])  # for a second process
    progress = processes.compile_steps(wanted, stopped=lambda: True)
    assert (progress.stopped, progress.failed) == (True, {})
    assert progress.steps == (steps.BOXES, steps.BOUNDS)
    assert begun
    assert all(process.poll() is not None for process in begun)


def test_a_process_ends_with_the_one_that_started_it(tmp_path: Path) -> None:
    code = """
import os, subprocess
from obb_collision.warm_up.processes import compile_steps
def noted(*arguments, **options):
    process = started(*arguments, **options)
    print(process.pid, flush=True)
    return process
started, subprocess.Popen = subprocess.Popen, noted
compile_steps([{step!r}], count=1, look=lambda progress: progress.kernels and os._exit(1))
"""
    code = code.format(step=steps.accuracy_step(Accuracy.MESH))
    with started("-c", code, NUMBA_CACHE_DIR=str(tmp_path)) as process:
        told, _ = process.communicate(timeout=300)
    with suppress(ProcessLookupError):  # it has ended already
        end = os.pidfd_open(int(told.splitlines()[0]))
        # its input has ended, which it notices while it compiles
        assert select.select([end], [], [], PATIENCE)[0], "it goes on"
        os.close(end)


def test_an_interrupt_while_the_command_is_imported_ends_it_with_one_line() -> None:
    with started("-X", "importtime", "-m", "obb_collision.warm_up.command") as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.split("|")[-1].strip() == "llvmlite":  # numba is being imported
                break
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == INTERRUPTED, rest
    assert rest.endswith("obb_collision warm-up: interrupted; kernels compiled so far are kept\n")
    assert "Traceback" not in rest
