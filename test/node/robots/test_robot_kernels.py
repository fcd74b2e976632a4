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

"""Kernels of robots are loaded before the node is ready, or beside its cycles."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("lxml")
pytest.importorskip("trajectory_msgs")
from node_process import environment
from processes import PATIENCE

from obb_collision.warm_up.steps import NODE_STEPS, ROBOTS, run

ALL = Path(__file__).with_name("all_of_a_robot.py")


def test_no_cycle_loads_a_kernel_for_robots(tmp_path: Path) -> None:
    for step in (*NODE_STEPS, ROBOTS):
        run(step)  # the cache has them from now on
    done = subprocess.run(
        [sys.executable, str(ALL), str(tmp_path)],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == []
