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

"""What a node compiles, and when: nothing after "ready", whatever the cache is like.

Each test runs processes of its own, for a kernel that one process has stays with it.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
from node_process import cached, environment, running
from processes import PATIENCE, output_until

from obb_collision import _kernel_cache

EVERYTHING = Path(__file__).with_name("everything.py")
ROBOT = Path(__file__).parents[1] / "robots" / "all_of_a_robot.py"
LONGEST_WORK = 0.1
"""Seconds that the process of a node may work between two cycles, by its own clock."""
LONGEST_SHARE = 0.2
"""Of the time that others compile: a cycle that waits for them takes about all of it."""


def run_script(script: Path, *arguments: str, cache: Path | None = None) -> Any:
    """Run a script that asks for everything; returns what it found."""
    done = subprocess.run(
        [sys.executable, str(script), *arguments],
        env=environment(**({} if cache is None else cached(cache))),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_no_cycle_loads_a_kernel_for_robots(tmp_path: Path) -> None:
    pytest.importorskip("lxml")
    pytest.importorskip("trajectory_msgs")
    assert run_script(ROBOT, str(tmp_path)) == []


def copy_kernels(folder: Path, *without: str) -> None:
    """Copy the kernels to another cache, but for some modules; what is missing is compiled."""
    for source in _kernel_cache.places[0].iterdir():
        if source.is_dir() and not source.name.startswith(without):
            shutil.copytree(source, folder / "obb_collision" / source.name)


def check_cycles(found: dict[str, Any], *stages: str) -> None:
    """Assert that the process of the node compiled nothing, and that its cycles went on.

    stages: in which others compiled; by default, whenever something was switched on.
    """
    assert found["compiled"] == []
    assert found["loaded"] > 0, "or this would show nothing"
    assert found["new"] == []
    switched = [
        (stage, numbers)
        for stage, numbers in found["stages"]
        if stage in stages or (not stages and stage.startswith(("effect ", "accuracy ")))
    ]
    for stage, numbers in switched:
        assert numbers["longest work"] < LONGEST_WORK, (stage, numbers)
    slow = [
        (stage, numbers)
        for stage, numbers in switched
        if numbers["seconds"] > 2.0 and not stage.endswith("moved")
    ]
    assert slow, "nothing took long enough to be compiled"
    for stage, numbers in slow:
        assert numbers["longest"] < LONGEST_SHARE * numbers["seconds"], (stage, numbers)


def test_no_cycle_loads_a_kernel_or_waits_for_one_that_is_compiled(tmp_path: Path) -> None:
    """Whatever is asked for is loaded before the node is ready, or beside its cycles."""
    copy_kernels(tmp_path, "queries.clearance.")
    check_cycles(run_script(EVERYTHING, cache=tmp_path), "effect clearance")


@pytest.mark.slow
def test_cycles_go_on_while_everything_is_switched_on_with_an_empty_cache(tmp_path: Path) -> None:
    check_cycles(run_script(EVERYTHING, cache=tmp_path))


def damage(files: list[Path]) -> None:
    """Damage kernels, each in one of four ways."""
    for number, file in enumerate(files):
        content = file.read_bytes()
        half = content[: len(content) // 2]
        ways = (b"", bytes(len(content)), os.urandom(len(content)), half)
        file.write_bytes(ways[number % len(ways)])


@pytest.mark.slow  # test_kernel_cache damages single files
def test_a_damaged_cache_is_said_and_built_anew(tmp_path: Path) -> None:
    copy_kernels(tmp_path)
    damage(sorted(tmp_path.rglob("*.kernel")))
    with running(**cached(tmp_path)) as process:
        output = output_until(process, "ready:")
        assert f"kernels in {tmp_path / 'obb_collision'} are damaged" in output
        assert "compiling kernels for boxes" in output
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    with running(**cached(tmp_path)) as process:
        assert "compiling" not in output_until(process, "ready:")


@pytest.mark.slow
def test_where_the_cache_takes_nothing_a_temporary_folder_does(tmp_path: Path) -> None:
    file, temporary = tmp_path / "file", tmp_path / "temporary"
    file.write_text("no folder")
    temporary.mkdir()
    with running(TMPDIR=str(temporary), **cached(file)) as process:
        output = output_until(process, "ready:")
        assert f"kernels can't be kept in {file / 'obb_collision'}" in output
        assert list(temporary.glob("obb_collision-kernels-*/*/*.kernel"))
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    assert not list(temporary.glob("obb_collision-kernels-*"))


def test_a_start_that_compiles_says_how_far_it_is_and_can_be_interrupted(tmp_path: Path) -> None:
    with running(**cached(tmp_path)) as process:
        first = output_until(process, "compiling kernels for")
        assert str(tmp_path / "obb_collision") in first
        assert "kernels and" in output_until(process, "steps done")
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, output
        assert "Traceback" not in output
        assert "ready:" not in output
