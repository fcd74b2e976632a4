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

"""The attack on files: the process that reads scenes or robots is watched, and a node gets some."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from tools.fuzz.files.scenes import mutated_scene
from tools.fuzz.process.child import Child
from tools.fuzz.session.client import STARTING, FoundError

READING = 10.0
"""Seconds that a file may take, without those for which its reader waits for a processor."""
REFUSED = 1
"""Exit code of a node whose scene file can't be used."""
READY = "ready: "
"""In the log of a node that has started."""


def attack_reader(what: str, folder: Path, seed: int, first: int, last: int) -> tuple[int, float]:
    """Have files read ("scene" or "robot"); returns how many were refused, the longest time (s)."""
    numbers = [str(number) for number in (seed, first, last)]
    module = "tools.fuzz.files.scenes"
    process = subprocess.Popen(
        [sys.executable, "-m", module, what, str(folder), *numbers],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    output, errors = process.communicate()
    done = [json.loads(line) for line in output.splitlines()]
    if process.returncode != 0 or len(done) != last - first:
        raise FoundError(f"{what}:{first + len(done)} ended its reader: {errors[-2000:]}")
    longest = max(done, key=lambda row: row[1])
    if longest[1] > READING:
        raise FoundError(f"{what}:{longest[0]} took {longest[1]:.1f} s")
    return sum(bool(refused) for _, _, refused in done), longest[1]


def attack_node(folder: Path, seed: int, number: int, start: Callable[[list[str]], Child]) -> bool:
    """Start a node with a scene file; returns whether it took it."""
    path = folder / "node_scene.yaml"
    path.write_bytes(mutated_scene(seed, number))
    child = start(["-p", f"scene_file:={path}"])
    end = time.monotonic() + STARTING
    while child.exit_code is None and READY not in "\n".join(child.lines()):
        if time.monotonic() > end:
            child.end()
            raise FoundError(f"a node with scene:{number} neither started nor ended")
        time.sleep(0.05)
    taken = child.exit_code is None
    code, lines = child.end(), child.lines()
    if code != (0 if taken else REFUSED) or any("Traceback" in line for line in lines):
        raise FoundError(f"a node with scene:{number} ended with {code}: {lines[-1:]}")
    return taken
