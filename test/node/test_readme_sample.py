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

"""The README's program with rclpy prints what it says, with a node beside it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rig import DOMAIN, spin_until

from obb_collision.node.node import CollisionNode

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_the_program_with_rclpy_prints_what_it_says(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(import rclpy\n.*?)```", README, re.DOTALL)
    (expected,) = re.findall(r"print\(.*\)  # (.*)", code)
    program = tmp_path / "first_scene.py"
    program.write_text(code)
    context = Context()
    context.init(domain_id=DOMAIN)
    executor = SingleThreadedExecutor(context=context)
    node = CollisionNode(context=context)
    executor.add_node(node)
    environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": str(ROOT)}
    started = subprocess.Popen(
        [sys.executable, str(program)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        spin_until(executor, lambda: started.poll() is not None, "the program", 60.0)
        printed, errors = started.communicate()
        assert (started.returncode, printed.splitlines()) == (0, [expected]), errors
    finally:
        started.kill()
        started.communicate()
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
